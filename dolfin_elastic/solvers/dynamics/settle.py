"""Scalar fields that go with an initial displacement."""

from __future__ import annotations

from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.dynamics.consistent_start import exactly
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.newton import Newton


def settle(problem: Problem, assembler: Assembler) -> None:
    """Finds the scalar fields that belong to an initial displacement. Collective.

    Args:
        problem: Its scalar fields are changed.
        assembler: Whose `balance` is assembled anew.
    """
    if not problem.unknowns.extras or exactly(problem) or assembler.max_displacement() == 0.0:
        return  # an exactly incompressible body's pressure does not follow from its shape
    still = Assembler(problem, still=True)
    newton = Newton(still, choose(problem, LinearSettings(method="direct")), Tolerance())
    start = problem.prescribed.values.x.array.copy()
    try:
        problem.prescribed.values.x.array[:] = problem.u.x.array
        newton.solve("basic")
    finally:
        problem.prescribed.values.x.array[:] = start
        newton.destroy()
        still.destroy()
    assembler.assemble_balance()
