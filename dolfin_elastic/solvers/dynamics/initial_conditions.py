"""Where motion starts: displacement and velocity at time 0."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import agree, largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.values import Component
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.impulsive_supports import (
    SMALL,
    SupportJump,
    misfits,
    reach,
)
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

EPS = float(np.finfo(float).eps)


def nodal(V: fem.FunctionSpace, values: tuple[Component, ...], where: str) -> FloatArray:
    """A vector given by components at every local node, unrolled. Not collective.

    Raises:
        InputError: The number of components is not the body's.
    """
    bs = V.dofmap.index_map_bs
    if len(values) != bs:
        raise InputError(f"{len(values)} components given, the body has {bs}", where=where)
    places = V.tabulate_dof_coordinates()
    # DOLFINx finds them in the cells, to round-off; 1/x is to be infinite at x = 0.
    places[np.abs(places) < 64 * EPS * np.max(np.abs(places), initial=0.0)] = 0.0
    x, y, z = places.T
    out = np.empty((len(x), bs))
    with np.errstate(all="ignore"):  # what is not finite is told by who asks
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
) -> list[SupportJump]:
    """Puts a problem into its initial state. Collective.

    Prescribed entries start where, and as fast as, their supports say.

    Args:
        problem: Its displacement is set, and its time to 0.
        v: Velocity, set.
        displacement: Components or formulas in x, y, z; none: at rest where it is.
        velocity: The same for the velocity.
        span: Duration of the motion [s]: a part of it serves to differentiate supports.

    Returns:
        Where supports and what was asked for differ.
    """
    u, held = problem.u, problem.prescribed
    if displacement:
        _put(problem, u, displacement, "dynamics.initial_displacement")
    v.x.array[:] = 0.0
    if velocity:
        _put(problem, v, velocity, "dynamics.initial_velocity")
    with np.errstate(all="ignore"):  # what is not finite at the start is told below
        far = reach(problem, span)
        speeds, unsure = _speeds(problem, 1e-7 * span)
    problem.set_time(0.0)
    held.check_finite()
    found = [
        *_imposed(problem, u, "displacement", held.targets, SMALL * far),
        *_imposed(problem, v, "velocity", speeds, SMALL * far / span + unsure),
    ]
    u.x.scatter_forward()
    v.x.scatter_forward()
    problem.unknowns.take()
    _check_finite(problem, v, "dynamics.initial_velocity")
    if displacement and not problem.linear:
        _check_upright(problem)
    return found


def _check_upright(problem: Problem) -> None:
    J, place = JacobianWatch(problem).smallest()
    if not J > 0.0:
        raise InputError(
            f"it turns cells inside out: det F = {J:.3g} at {coordinates(place)} m",
            where="dynamics.initial_displacement",
            expected="det F > 0 everywhere",
        )


def _speeds(problem: Problem, moment: float) -> tuple[FloatArray, float]:
    """Velocities of prescribed entries at time 0, and how far round-off lets them be off [m/s].

    By a one-sided difference of second order over a moment [s]. Collective.
    """
    start, half, whole = problem.prescribed.targets_at((0.0, moment / 2, moment))
    size = largest(problem.body.comm, float(np.max(np.abs(whole), initial=0.0)))
    speeds = np.asarray((4 * (half - start) - (whole - start)) / moment, dtype=np.float64)
    return speeds, 64 * EPS * size / moment


def _imposed(
    problem: Problem, field: fem.Function, what: str, values: FloatArray, least: float
) -> Iterator[SupportJump]:
    """Makes prescribed entries what supports say; tells where they were not. Collective."""
    size = problem.V.dofmap.index_map.size_local * problem.V.dofmap.index_map_bs
    before = field.x.array[:size].copy()
    problem.prescribed.impose(field.x.array, values)
    scale = largest(problem.body.comm, float(np.max(np.abs(before), initial=0.0)))
    yield from misfits(problem, what, field.x.array[:size] - before, least + SMALL * scale)


def _put(problem: Problem, field: fem.Function, values: tuple[Component, ...], where: str) -> None:
    """Nodal values; a formula that fails on one rank fails on all. Collective."""
    error = None
    try:
        field.x.array[:] = nodal(problem.V, values, where)
    except InputError as caught:
        error = caught
    agree(problem.body.comm, error)
    _check_finite(problem, field, where)  # held nodes too, though supports overrule it there


def _check_finite(problem: Problem, field: fem.Function, where: str) -> None:
    bad = int(total(problem.body.comm, int(~np.isfinite(field.x.array).all())))
    if bad:
        raise InputError("the formula is not finite at some nodes", where=where)
