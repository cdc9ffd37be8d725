"""Loss of ellipticity of a law, and laws of the same constants that remain elliptic."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.laws.blatz_ko import BlatzKo
from dolfin_elastic.model.materials.laws.corotated import Corotated
from dolfin_elastic.model.materials.laws.fixed_corotated import FixedCorotated
from dolfin_elastic.model.materials.laws.hencky import Hencky
from dolfin_elastic.model.materials.laws.neo_hookean import NeoHookean
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.point.ellipticity import acoustic_eigenvalues
from dolfin_elastic.model.point.tested import with_finite_moduli
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

LARGE_STRAINS: tuple[type[Isotropic], ...] = (
    NeoHookean,
    Hencky,
    FixedCorotated,
    BlatzKo,
    Corotated,
)
"""Laws of two constants for large strains, in the order of the strains up to which they serve."""

SMALLEST = 0.05
"""Stretch down to which compression is looked at."""

_FURTHER = 1.5
"""Multiple of the logarithmic strain up to which an alternative law must be elliptic."""


def law_in_words(law: Law) -> str:
    """A law by its name in case files, or the energy that a user has written."""
    field = type(law).model_fields.get("law")
    named = field is not None and isinstance(field.default, str)
    return f"the law '{type(law).name()}'" if named else "its energy"


def least_eigenvalues(law: Law, F: AnyArray, *, flat: bool = False) -> AnyArray:
    """Smallest eigenvalue of a law's acoustic tensor over that at rest, of shape (n,).

    Args:
        law: With numbers only.
        F: Deformation gradients, shape (n, 3, 3).
        flat: See `acoustic_eigenvalues`.
    """
    point = LawAtPoints(with_finite_moduli(law))
    rest = acoustic_eigenvalues(point, np.eye(3)[None], flat=flat)[0]
    return np.asarray(acoustic_eigenvalues(point, F, flat=flat) / rest)


def limit_in_compression(law: Law) -> float | None:
    """Stretch below which the stress of a law squeezed one way, and held sideways, falls again.

    Of St. Venant-Kirchhoff 1/sqrt(3): P = (lambda + 2 mu) s (s^2 - 1)/2 has its extremum there.

    Args:
        law: With numbers only.

    Returns:
        The stretch to three digits; None where there is none down to `SMALLEST`.
    """
    stretches = np.linspace(1.0, SMALLEST, 951)
    F = np.tile(np.eye(3), (len(stretches), 1, 1))
    F[:, 0, 0] = stretches
    with np.errstate(all="ignore"):
        stiffness = LawAtPoints(with_finite_moduli(law)).tangent(F)[:, 0, 0, 0, 0]
    falling = np.flatnonzero(stiffness < 0.0)
    return float(stretches[falling[0]]) if len(falling) else None


def elliptic_laws(law: Law, F: AnyArray, *, flat: bool = False) -> tuple[str, ...]:
    """Laws of the same two constants that are strongly elliptic there and further on.

    Args:
        law: The one that is not; with numbers only.
        F: Deformation gradients, shape (n, 3, 3); those without det F > 0 are left out.
        flat: See `acoustic_eigenvalues`.

    Returns:
        Their names in case files, at most two; none where the law is not isotropic with two
        constants.
    """
    if not isinstance(law, Isotropic):
        return ()
    F = F[np.linalg.det(F) > 0.0]
    u, s, v = np.linalg.svd(F)
    further = np.concatenate([F, (u * s[:, None, :] ** _FURTHER) @ v])
    result = []
    for kind in LARGE_STRAINS:
        if isinstance(law, kind):
            continue
        with np.errstate(all="ignore"):
            other = kind(E=law.E, nu=law.nu)
            if np.all(least_eigenvalues(other, further, flat=flat) > 0.0):
                result.append(kind.name())
    return tuple(result[:2])
