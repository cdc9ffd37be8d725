"""Initial conditions: displacement and velocity at time 0, and supports that do not fit them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import agree, first_of, largest, total
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.model.values import Component
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.messages import MIRRORED, SEES_INVERSION
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

EPS = float(np.finfo(float).eps)

SMALL = 1e-6
"""Difference over the largest value of the motion up to which two values are the same.

Round-off of formulas and of differences in time is far below, and so small a shock is none."""

SUDDEN = 0.1
"""A support jumps if it does more than this share of a step's displacement in 1e-4 of the step."""

SAMPLES = 8
"""Intervals of the motion at whose ends supports are evaluated for how far they move."""


def nodal_values(V: fem.FunctionSpace, values: tuple[Component, ...], where: str) -> FloatArray:
    """A vector given by components at every local node, unrolled. Not collective.

    Args:
        values: Components: numbers, or formulas in x, y, z.

    Raises:
        InputError: The number of components is not the body's.
    """
    bs = V.dofmap.index_map_bs
    check_components(values, bs, where)
    places = V.tabulate_dof_coordinates()
    # DOLFINx finds them in the cells, to round-off; 1/x is to be infinite at x = 0.
    places[np.abs(places) < 64 * EPS * np.max(np.abs(places), initial=0.0)] = 0.0
    x, y, z = places.T
    out = np.empty((len(x), bs))
    with np.errstate(all="ignore"):  # callers check that all is finite
        for i, value in enumerate(values):
            formula = value if isinstance(value, Formula) else None
            out[:, i] = formula.evaluate(x=x, y=y, z=z, t=0.0) if formula else value
    return out.reshape(-1)


def set_initial(
    problem: Problem,
    v: fem.Function,
    displacement: tuple[Component, ...],
    velocity: tuple[Component, ...],
    span: float,
    *,
    given: tuple[FloatArray, FloatArray] | None = None,
) -> list[SupportJump]:
    """Puts a problem into its initial state. Collective.

    Prescribed entries get displacement and velocity of their supports.

    Args:
        problem: Its displacement is set, and its time to 0.
        displacement: Components or formulas in x, y, z; none: at rest where it is.
        velocity: The same for the velocity.
        span: Duration of the motion [s]: a part of it serves to differentiate supports.
        given: Displacement and velocity of all local nodes, where neither of the above says more.

    Returns:
        Supports whose displacement or velocity differs from the initial conditions.

    Raises:
        InputError: A value is not finite, or the displacement turns cells inside out.
    """
    u, constraints = problem.u, problem.constraints
    if displacement:
        _set_nodal(problem, u, displacement, "dynamics.initial_displacement")
    v.x.array[:] = 0.0
    if given is not None:
        u.x.array[:], v.x.array[:] = given
        _check_finite(problem, u, "dynamics.start")
        _check_finite(problem, v, "dynamics.start")
    if velocity:
        _set_nodal(problem, v, velocity, "dynamics.initial_velocity")
    with np.errstate(all="ignore"):  # finite values are checked below
        far = support_travel(problem, span)
        speeds, unsure = _speeds(problem, 1e-7 * span)
    problem.set_time(0.0)
    constraints.check_finite()
    result = [
        *_imposed(problem, u, "displacement", constraints.targets, SMALL * far),
        *_imposed(problem, v, "velocity", speeds, SMALL * far / span + unsure),
    ]
    u.x.scatter_forward()
    v.x.scatter_forward()
    problem.unknowns.u_to_w()
    _check_finite(problem, v, "dynamics.initial_velocity")
    if (displacement or given) and not problem.linear:
        _check_upright(problem, "start" if given else "initial_displacement")
    return result


def _check_upright(problem: Problem, key: str) -> None:
    J, place = JacobianWatch(problem).refused()
    if J > 0.0:
        return
    what = f"it turns elements inside out: det F = {J:.3g} at {problem.body.unit.point(place)}"
    expected = "det F > 0 everywhere"
    if any(part.law.blind_to_inversion for part in problem.regions):
        what, expected = f"{what}; {MIRRORED}", f"{expected}, or {SEES_INVERSION}"
    raise InputError(what, where=f"dynamics.{key}", expected=expected)


def _speeds(problem: Problem, moment: float) -> tuple[FloatArray, float]:
    """Velocities of prescribed entries at time 0, and a bound of their round-off [m/s]. Collective.

    By a one-sided difference of second order.

    Args:
        moment: Duration of the difference [s].
    """
    start, half, whole = problem.constraints.targets_at((0.0, moment / 2, moment))
    size = largest(problem.body.comm, float(np.max(np.abs(whole), initial=0.0)))
    speeds = np.asarray((4 * (half - start) - (whole - start)) / moment, dtype=np.float64)
    return speeds, 64 * EPS * size / moment


def _imposed(
    problem: Problem, field: fem.Function, what: str, values: FloatArray, least: float
) -> Iterator[SupportJump]:
    """Sets prescribed entries; yields the supports where they were different. Collective.

    Args:
        what: "velocity" or "displacement".
        values: Prescribed, like `Constraints.targets`.
        least: Differences up to this are none.
    """
    size = problem.V.dofmap.index_map.size_local * problem.V.dofmap.index_map_bs
    before = field.x.array[:size].copy()
    problem.constraints.impose(field.x.array, values)
    scale = largest(problem.body.comm, float(np.max(np.abs(before), initial=0.0)))
    yield from support_jumps(problem, what, field.x.array[:size] - before, least + SMALL * scale)


def _set_nodal(
    problem: Problem, field: fem.Function, values: tuple[Component, ...], where: str
) -> None:
    """Sets nodal values; a formula that fails on one rank fails on all. Collective.

    Raises:
        InputError: A value is not finite.
    """
    error = None
    try:
        field.x.array[:] = nodal_values(problem.V, values, where)
    except InputError as caught:
        error = caught
    agree(problem.body.comm, error)
    _check_finite(problem, field, where)  # also where supports prescribe another value


def _check_finite(problem: Problem, field: fem.Function, where: str) -> None:
    bad = int(total(problem.body.comm, int(~np.isfinite(field.x.array).all())))
    if bad:
        raise InputError(
            "the formula is not finite at some nodes",
            where=where,
            expected="a formula that gives a number at every node",
        )


# --- supports that the body cannot follow ---


@dataclass(frozen=True)
class SupportJump:
    """A support whose motion differs from the body's at the start, or that jumps later.

    Attributes:
        support: Its label.
        what: "velocity" or "displacement".
        most: Largest difference [m/s, m].
        place: Where that is in the undeformed body [m].
        unit: Of the mesh.
    """

    support: str
    what: str
    most: float
    place: tuple[float, ...]
    unit: LengthUnit

    def __str__(self) -> str:
        speed = self.what == "velocity"
        most = f"{self.most:.3g} m/s" if speed else self.unit.length(self.most)
        follows = {
            "velocity": "its nodes move with the support at once, and a shock runs into the body",
            "displacement": "its nodes are put there at once, and the elements beside them strained"
            ": a shock runs into the body",
        }[self.what]
        return (
            f"at the start the support '{self.support}' and the body differ in {self.what}, by "
            f"{most} at {self.unit.point(self.place)}: {follows}. Was that meant? "
            f"Else dynamics.initial_{self.what} fits it, or a curve that begins gently"
        )


def support_travel(problem: Problem, span: float) -> float:
    """How far supports move within a time, from where they start [m]. Collective.

    Args:
        problem: Whose supports; their time is 0 afterwards.
        span: The time [s].
    """
    constraints, most = problem.constraints, 0.0
    start, *later = constraints.targets_at(span * k / SAMPLES for k in range(SAMPLES + 1))
    for there in later:
        gone = np.abs(there - start)
        most = max(most, float(np.max(gone, initial=0.0, where=np.isfinite(gone))))
    constraints.set_time(0.0)
    return largest(problem.body.comm, most)


def support_jump(problem: Problem, t: float, step: float) -> str:
    """Message about the support that jumps furthest just after a time; empty: none. Collective.

    Args:
        t: Time [s]; it is the problem's afterwards.
        step: Usual step of the motion [s].
    """
    constraints = problem.constraints
    start, *later = constraints.targets_at((t, t + 1e-4 * step, t + step))
    problem.set_time(t)
    sudden, whole = (np.nan_to_num(there - start) for there in later)
    far = max(float(np.max(np.abs(gone), initial=0.0)) for gone in (sudden, whole))
    change = np.zeros(problem.V.dofmap.index_map.size_local * problem.body.dim)
    constraints.impose(change, sudden)
    least = SUDDEN * largest(problem.body.comm, far)
    jumps = list(support_jumps(problem, "displacement", change, least))
    if not jumps:
        return ""
    most = max(jumps, key=lambda one: one.most)
    at = f"by {most.unit.length(most.most)} at {most.unit.point(most.place)}"
    return f"the support '{most.support}' jumps there, {at}"


def support_jumps(
    problem: Problem, what: str, change: FloatArray, least: float
) -> Iterator[SupportJump]:
    """Supports by which displacement or velocity of the body is changed. Collective.

    Args:
        what: "velocity" or "displacement".
        change: Change by the supports, owned entries.
        least: Differences up to this are none.
    """
    x, dim = problem.places, problem.body.dim
    for label, rows in _by_support(problem, change):
        sizes = np.linalg.norm(rows, axis=1)
        most = largest(problem.body.comm, float(np.max(sizes, initial=0.0)))
        if not most > least:
            continue
        # Of nodes with equal differences the first by coordinates: the same on any number of ranks.
        alike = x[: len(sizes)][sizes >= most * (1 - 1e-9)]
        place = first_of(problem.body.comm, map(tuple, alike.round(12).tolist()))
        assert place is not None  # some rank has the largest
        yield SupportJump(label, what, most, place[:dim], problem.body.unit)


def _by_support(problem: Problem, change: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Each support's label, and its part of the change at the owned nodes, shape (nodes, dim).

    Args:
        change: By all supports, owned entries.
    """
    for label in problem.constraints.labels:
        rows = np.zeros((len(change) // problem.body.dim, problem.body.dim))
        for support, nodes, part in problem.constraints.reactions(change):
            if support.label == label:
                rows[nodes] += part
        yield label, rows
