"""What a motion begins with, and what looks wrong about it."""

from __future__ import annotations

from dolfinx import fem

from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.contact import check_start
from dolfin_elastic.solvers.dynamics import DynamicsSettings
from dolfin_elastic.solvers.initial import set_initial


def start_notes(problem: Problem, settings: DynamicsSettings) -> tuple[str, ...]:
    """Supports that the body does not begin with; leaves the body at rest. Collective.

    Raises:
        InputError: It cannot begin so: a formula is not finite, or it lies deep in an obstacle.
    """
    v, s = fem.Function(problem.V), settings
    shocks = set_initial(problem, v, s.displacement, s.velocity, s.end)
    check_start(problem, moving=True)
    problem.u.x.array[:] = 0.0
    problem.unknowns.take()
    return (*([s.limited] if s.limited else []), *(str(shock) for shock in shocks))
