"""Evidence of a material instability: a law has lost strong ellipticity in some cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import coordinates
from dolfin_elastic.model.point.alternatives import (
    elliptic_laws,
    law_in_words,
    least_eigenvalues,
    limit_in_compression,
)
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.diagnostics.evidence import Cells, plain

MOST = 300
"""Deformation gradients of each material and rank that are looked at: the most strained ones."""

NEARLY = 0.5
"""Share of the ellipticity at rest below which the last equilibrium is near its loss, if the body's
stability, or a later iterate's ellipticity, is lost."""


@dataclass(frozen=True)
class SoftSpot:
    """The place where a material is nearest to losing ellipticity, the same on every rank.

    Attributes:
        share: Smallest eigenvalue of the acoustic tensor there over that at rest.
        place: Middle of its cell, in the reference configuration [m].
        material: Name of the material.
        F: Deformation gradients of that material, the one of this place first, shape (n, 3, 3).
    """

    share: float
    place: tuple[float, ...]
    material: str
    F: FloatArray

    @property
    def lost(self) -> bool:
        """Ellipticity is lost."""
        return self.share < 0.0

    def in_words(self, problem: Problem) -> tuple[str, str]:
        """What has happened there, and what to try."""
        part = next(p for p in problem.regions if p.name == self.material)
        stretch, along = _principal_stretch(self.F[0], problem.body.dim)
        how = "squeezed" if stretch < 1.0 else "stretched"
        left = "is not elliptic any more" if self.lost else "is hardly elliptic any more"
        text = (
            f"material instability: near {problem.body.unit.point(self.place)} "
            f"{messages.material(problem, [part.name])} is {how} to {stretch:.3g} of its length "
            f"along {coordinates(along)}, where {law_in_words(part.typical)} {left}"
        )
        if named := part.typical.destabilising():
            return f"{text} ({' and '.join(named)})", messages.constants(named)
        limit = limit_in_compression(part.typical) if stretch < 1.0 else None
        if limit is not None:
            text += f"; squeezed one way, its stress falls again below a stretch of {limit:.3g}"
        others = elliptic_laws(part.typical, self.F, flat=problem.body.dim == 2)
        return text, messages.another_law(others)


def softest_spot(cells: Cells) -> SoftSpot | None:
    """The place where the present state is nearest to losing ellipticity. Collective.

    Cells are looked at with the mean of what varies in space; of plane and axisymmetric bodies only
    motions in their plane count.  A pressure has no part in it: it resists no motion a x N, along
    which the cofactor of F does not change, but one of volume, which its law does as well.

    Source: for the pressure, det (F + s a x N) is affine in s: J. M. Ball, Arch. Ration. Mech.
    Anal. 63 (1977) 337, section 4.
    """
    F, problem = cells.gradients(), cells.problem
    local = [spot for part in problem.regions if (spot := _of_region(cells, part, F)) is not None]
    least = min(local, key=_order, default=None)
    every: list[SoftSpot] = [one for one in cells.comm.allgather(least) if one is not None]
    return min(every, key=_order, default=None)


def _order(spot: SoftSpot) -> tuple[float, tuple[float, ...]]:
    return float(f"{spot.share:.6e}"), spot.place


def _of_region(cells: Cells, part: MaterialRegion, F: FloatArray) -> SoftSpot | None:
    points, inside = F.shape[1], F[part.cells].reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        strain = np.linalg.norm(inside - np.eye(3), axis=(1, 2))
        upright = np.flatnonzero(np.linalg.det(inside) > 0.0)
    if not len(upright):
        return None
    chosen = upright[np.argsort(-strain[upright], kind="stable")[:MOST]]
    with np.errstate(all="ignore"):
        shares = least_eigenvalues(part.typical, inside[chosen], flat=cells.problem.body.dim == 2)
    first = int(np.argmin(np.round(shares, 9)))
    order = [first, *(k for k in range(len(chosen)) if k != first)]
    place = plain(cells.middles[part.cells[chosen[first] // points]])
    return SoftSpot(float(shares[first]), place, part.name, inside[chosen[order]])


def _principal_stretch(F: FloatArray, dim: int) -> tuple[float, tuple[float, ...]]:
    """The principal stretch that is farthest from 1, and its direction in the undeformed body."""
    _, stretches, directions = np.linalg.svd(F)
    k = int(np.argmax(np.abs(np.log(stretches))))
    axis = directions[k]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    size = dim if np.linalg.norm(axis[dim:]) < 0.5 else 3
    return float(stretches[k]), tuple(float(x) for x in axis[:size].round(3) + 0.0)
