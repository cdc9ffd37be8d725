"""How much memory a solution will need, about."""

from __future__ import annotations

from dataclasses import dataclass

from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.linear import Choice

_BASE = 0.12e9


@dataclass(frozen=True)
class Memory:
    """An estimate, see `memory`.

    Attributes:
        total: Of all ranks together [byte].
        solver: "direct", "iterative" or "explicit".
    """

    total: float
    solver: str


def memory(problem: Problem, choice: Choice | None) -> Memory:
    """What a solution will need. Collective."""
    n = problem.num_dofs
    solver = "explicit" if choice is None else "direct" if choice.direct else "iterative"
    return Memory(_BASE * problem.body.comm.size + 7e3 * n, solver)
