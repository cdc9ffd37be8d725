"""What explicit schemes need of a problem, and what supports that move ask of them."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import FormulaError, InputError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.problem.problem import Problem


def check_explicit(problem: Problem, scheme: str) -> None:
    """Refuses problems without a positive lumped mass, or with unknowns beside the displacement.

    Raises:
        InputError: Explicit schemes cannot compute this problem.
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
    for part in problem.regions:
        if part.law.viscosity is not None:
            raise InputError(
                f"the scheme '{scheme}' knows no viscosity",
                where=f"materials.{part.name}.viscosity",
                expected='leave it out, or dynamics.scheme = "generalized-alpha"',
            )


def changes(problem: Problem) -> bool:
    """Whether loads, supports, springs or obstacles depend on time."""
    return (
        (bool(problem.loads) and problem.loads_change)
        or any(not support.at_rest for support in problem.supports)
        or any(pair.contact.values for pair in problem.contact_pairs)
    )


def mean_acceleration(
    problem: Problem, v: fem.Function, t: float, dt: float, interval: float
) -> FloatArray:
    """Mean acceleration that supports prescribe [m/s^2]. Collective.

    It is that of the next step; where a curve or formula has no value any more, that of the last
    steps.

    Args:
        v: Velocity [m/s].
        t: Time [s].
        dt: The last step [s].
        interval: From the time of the velocity to the middle of its next step [s].
    """
    held = problem.dirichlet
    here, now = held.extract(problem.u.x.array), held.extract(v.x.array)

    def targets(time: float) -> FloatArray:
        try:
            return np.asarray(held.targets_at((time,))[0])
        except FormulaError:  # of a curve or an angle: on all ranks
            return np.full_like(here, np.nan)

    found: AnyArray = ((targets(t + dt) - here) / dt - now) / interval
    if not np.all(np.isfinite(found)):
        back: AnyArray = np.zeros_like(here)
        if t > 1.5 * dt:
            back = (here - 2 * targets(t - dt) + targets(max(t - 2 * dt, 0.0))) / dt**2
        found = np.where(np.isfinite(found), found, back)
    problem.set_time(t)
    return np.asarray(found, dtype=np.float64)
