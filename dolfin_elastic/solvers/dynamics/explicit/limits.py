"""What explicit schemes cannot compute, and what they need not look at again."""

from __future__ import annotations

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.problem import Problem


def check_explicit(problem: Problem, scheme: str) -> None:
    """They need a lumped mass, and displacements as the only unknowns.

    Args:
        problem: What is to move.
        scheme: Name of the scheme.

    Raises:
        InputError: They cannot compute this problem.
    """
    if problem.degree != 1:
        raise InputError(
            f"'{scheme}' needs linear elements: quadratic ones have no positive lumped mass",
            where="mesh.degree",
            expected="degree = 1",
        )
    if problem.w is not problem.u:
        stretch = problem.unknowns.has("stretch")
        raise InputError(
            f"'{scheme}' solves for displacements only",
            where="mesh.geometry" if stretch else "mesh.formulation",
            expected=f"{'not plane stress' if stretch else 'displacement'}, or the scheme "
            "'generalized-alpha'",
        )
    for part in problem.parts:
        if part.law.viscosity is not None:
            raise InputError(
                f"the scheme '{scheme}' knows no viscosity",
                where=f"materials.{part.name}.viscosity",
                expected='leave it out, or dynamics.scheme = "generalized-alpha"',
            )


def changes(problem: Problem) -> bool:
    """Something depends on time: loads, supports, springs or obstacles."""
    return (
        (bool(problem.loads) and problem.loads_change)
        or any(not support.at_rest for support in problem.supports)
        or any(touch.contact.values for touch in problem.touching)
    )
