"""Which materials of a body cannot change their volume, so that their pressure is an unknown."""

from __future__ import annotations

from dolfinx import fem

from dolfin_elastic.problem.problem import Problem


def is_incompressible(compliance: object) -> bool:
    """Whether a compliance 1/k is exactly zero. Not collective.

    Args:
        compliance: Of a material region [1/Pa]; None where the region has no pressure.
    """
    return isinstance(compliance, fem.Constant) and float(compliance.value) == 0.0


def partly_incompressible(problem: Problem) -> bool:
    """Whether some region is incompressible, so that its pressure is a Lagrange multiplier.

    Such a pressure does not follow from the displacement.  In plane stress it does: the stretch out
    of the plane gives way. Not collective.
    """
    if problem.unknowns.has("stretch"):
        return False
    return any(is_incompressible(part.compliance) for part in problem.regions)


def wholly_incompressible(problem: Problem) -> bool:
    """Whether every region is incompressible. Not collective."""
    return all(is_incompressible(part.compliance) for part in problem.regions)
