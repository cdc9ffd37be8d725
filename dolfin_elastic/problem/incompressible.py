"""Which materials of a body cannot change their volume, so that their pressure is an unknown."""

from __future__ import annotations

from dolfin_elastic.problem.problem import Problem


def partly_incompressible(problem: Problem) -> bool:
    """Whether some region is incompressible, so that its pressure is a Lagrange multiplier.

    Such a pressure does not follow from the displacement.  In plane stress it does: the stretch out
    of the plane gives way. Not collective.
    """
    if problem.unknowns.has("stretch"):
        return False
    return any(part.incompressible for part in problem.regions)


def wholly_incompressible(problem: Problem) -> bool:
    """Whether every region is incompressible. Not collective."""
    return all(part.incompressible for part in problem.regions)
