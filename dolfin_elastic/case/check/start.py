"""What a run begins with and where its supports go, and what looks wrong about it."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.case.case import Case
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.probes import named_twice
from dolfin_elastic.solvers.dynamics.dynamics import DynamicsSettings
from dolfin_elastic.solvers.dynamics.initial_conditions import set_initial
from dolfin_elastic.solvers.nonlinear.contact import buried, check_start

TIMES = 41
"""Times of a motion, or of statics, at which supports and loads are looked at."""


def check_probes(case: Case, problem: Problem) -> None:
    """No probe has the column of a reaction or a momentum. Not collective.

    Raises:
        InputError: One has.
    """
    taken = {f"reaction_{support.label}" for support in problem.supports}
    taken |= {f"reaction_{touch.label}" for touch in problem.touching}
    if case.dynamics is not None:
        taken |= {"momentum", "angular_momentum"}
    if twice := taken & case.output.probes.keys():
        raise named_twice(f"{min(twice)}_x")


def check_supports(case: Case, problem: Problem) -> None:
    """Looks whether supports have values all the way; ends as at the start. Collective.

    Raises:
        InputError: A formula gives no finite number somewhere.
    """
    if all(support.at_rest for support in problem.supports):
        return
    end, default = (case.dynamics.end, CONSTANT) if case.dynamics else (case.full, PROPORTIONAL)
    held = problem.prescribed
    for t in np.linspace(0.0, end, TIMES):
        held.move_to(float(t), default)
        held.check_finite()
    held.move_to(0.0, default)


def start_notes(problem: Problem, settings: DynamicsSettings) -> tuple[str, ...]:
    """Supports and obstacles that the body does not begin with; leaves it at rest. Collective.

    Raises:
        InputError: It cannot begin so: a formula is not finite, or it lies deep in an obstacle.
    """
    v, s = fem.Function(problem.V), settings
    shocks = set_initial(problem, v, s.displacement, s.velocity, s.end)
    gaps = zip(problem.touching, check_start(problem, moving=True), strict=True)
    deep = [buried(touch, gap, at) for touch, (gap, at) in gaps if gap < -touch.tolerance]
    problem.u.x.array[:] = 0.0
    problem.unknowns.take()
    return (*([s.limited] if s.limited else []), *(str(shock) for shock in shocks), *deep)
