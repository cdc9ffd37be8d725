"""Where motion starts: displacement and velocity at time 0."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.errors import InputError
from dolfin_elastic.formulas import Formula
from dolfin_elastic.model.components import Component
from dolfin_elastic.parallel import agree, total
from dolfin_elastic.problem import Problem

Vector = npt.NDArray[np.float64]


def nodal(V: fem.FunctionSpace, values: tuple[Component, ...], where: str) -> Vector:
    """A vector given by components at every local node, unrolled. Not collective.

    Raises:
        InputError: The number of components is not the body's.
    """
    bs = V.dofmap.index_map_bs
    if len(values) != bs:
        raise InputError(f"{len(values)} components given, the body has {bs}", where=where)
    x, y, z = V.tabulate_dof_coordinates().T
    out = np.empty((len(x), bs))
    for i, value in enumerate(values):
        out[:, i] = value.evaluate(x=x, y=y, z=z, t=0.0) if isinstance(value, Formula) else value
    return out.reshape(-1)


def set_initial(
    problem: Problem,
    v: fem.Function,
    displacement: tuple[Component, ...],
    velocity: tuple[Component, ...],
    span: float,
) -> None:
    """Puts a problem into its initial state. Collective.

    Prescribed entries start where, and as fast as, their supports say.

    Args:
        problem: Its displacement is set, and its time to 0.
        v: Velocity, set.
        displacement: Components or formulas in x, y, z; none: at rest where it is.
        velocity: The same for the velocity.
        span: Duration of the motion [s]: a part of it serves to differentiate supports.
    """
    u, held = problem.u, problem.prescribed
    if displacement:
        _put(problem, u, displacement, "dynamics.initial_displacement")
    v.x.array[:] = 0.0
    if velocity:
        _put(problem, v, velocity, "dynamics.initial_velocity")
    moment = 1e-7 * span
    problem.set_time(moment)
    later = held.targets
    problem.set_time(0.0)
    held.check_finite()
    held.impose(u.x.array, held.targets)
    held.impose(v.x.array, (later - held.targets) / moment)
    u.x.scatter_forward()
    v.x.scatter_forward()
    problem.unknowns.take()
    _check_finite(problem, "displacement", u)
    _check_finite(problem, "velocity", v)


def _put(problem: Problem, field: fem.Function, values: tuple[Component, ...], where: str) -> None:
    """Nodal values; a formula that fails on one rank fails on all. Collective."""
    error = None
    try:
        field.x.array[:] = nodal(problem.V, values, where)
    except InputError as caught:
        error = caught
    agree(problem.body.comm, error)


def _check_finite(problem: Problem, what: str, field: fem.Function) -> None:
    bad = int(total(problem.body.comm, int(~np.isfinite(field.x.array).all())))
    if bad:
        raise InputError(
            "the formula is not finite at some nodes", where=f"dynamics.initial_{what}"
        )
