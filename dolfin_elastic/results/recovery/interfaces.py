"""Edges at which materials meet each other or the surface, and the stress is singular.

Two materials that are bonded strain each other: where their interface ends at the surface, or has a
corner, the stress grows like r^(lambda - 1), by their moduli and angles; see `stress_exponent`.
Flat interfaces inside the body leave it bounded, and corners of less than a margin count as flat,
for facets of a round interface meet at angles, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.ridges import cell_ridges
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.problem.material_regions import poisson, shear_modulus
from dolfin_elastic.results.recovery.wedge import Face, Wedge, stress_exponent

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_MARGIN = np.deg2rad(30.0)
"""Angle by which an interface may be bent inside the body and count as flat."""
_STEP = np.deg2rad(5.0)
"""Angles are rounded to this: exponents change little with them."""
_WEAKEST = 0.95
"""Exponents above it count as 1: the stress grows by less than 4 % where cells are halved."""
_FACES: tuple[Face, Face, Face] = ("free", "held", "roller")


def material_corners(
    problem: Problem,
    angles: FloatArray,
    facets: FloatArray,
    whole: FloatArray,
    some: FloatArray,
) -> BoolArray:
    """At which edges (vertices in the plane) materials make the stress singular. Local.

    Args:
        angles: That each region fills at each of them, shape (edges, regions) [rad].
        facets: Number of boundary facets at each of them.
    """
    singular = np.zeros(len(facets), dtype=bool)
    if len(problem.regions) < 2:
        return singular
    angles = np.round(angles / _STEP).astype(int)
    alike = np.column_stack([facets - whole - some, whole, some])
    around, straight = round(2 * np.pi / _STEP), round(np.pi / _STEP)
    margin = round(_MARGIN / _STEP)
    chosen = np.flatnonzero(((angles > 0).sum(axis=1) == 2) & ((facets == 2) | (facets == 0)))
    face = np.where(facets == 0, -1, np.where(alike.max(axis=1) == 2, alike.argmax(axis=1), -2))
    keys = np.column_stack([face[chosen], angles[chosen]])
    for key in np.unique(keys, axis=0):
        regions = np.flatnonzero(key[1:])
        sizes = key[1:][regions]
        inside, mirrored = key[0] == -1, key[0] == _FACES.index("roller")
        bent = np.abs(sizes - straight).max() > margin and abs(sizes.sum() - around) <= margin
        flat = mirrored and np.abs(2 * sizes - straight).max() <= margin  # with its mirror image
        if key[0] == -2 or (inside and not bent) or flat:
            continue
        wedges = [_wedge(problem, r, float(s * _STEP)) for r, s in zip(regions, sizes, strict=True)]
        weakest = stress_exponent(*wedges, None if inside else _FACES[key[0]])
        singular[chosen[(keys == key).all(axis=1)]] = weakest < _WEAKEST
    return singular


def _wedge(problem: Problem, region: int, angle: float) -> Wedge:
    law = problem.regions[region].typical
    nu = min(max(poisson(law), 0.0), 0.5)
    kappa = (3 - nu) / (1 + nu) if problem.geometry == "plane-stress" else 3 - 4 * nu
    return Wedge(angle, shear_modulus(law), kappa)


def angles_at_interfaces(problem: Problem) -> list[tuple[IndexArray, IndexArray, FloatArray]]:
    """Angles of cells at their edges (vertices in the plane) where materials may meet. Collective.

    Returns:
        Of each region a row for each cell and each edge whose ends touch several regions: cell;
        local edge of that cell; and its angle, shape (rows, 1) [rad].
    """
    mesh, dim = problem.body.mesh, problem.body.dim
    if len(problem.regions) < 2:
        none = np.empty(0, dtype=np.int32)
        return [(none, none, np.empty((0, 1)))]
    vertices = mesh.topology.connectivity(dim, 0).array.reshape(-1, dim + 1)
    shared = _touch_several(problem, vertices)
    result: list[tuple[IndexArray, IndexArray, FloatArray]] = []
    for part in problem.regions:
        several = shared[vertices[part.cells]]
        numbers, rows = np.nonzero([several[:, ridge].all(axis=1) for ridge in cell_ridges(dim)])
        angles = np.empty((len(rows), 1))
        for number, ridge in enumerate(cell_ridges(dim)):
            here = numbers == number
            angles[here, 0] = _angle(cell_corners(mesh, part.cells[rows[here]]), ridge)
        result.append((part.cells[rows], numbers.astype(np.int32), angles))
    return result


def _touch_several(problem: Problem, vertices: IndexArray) -> BoolArray:
    """Which local vertices cells of several regions share, on any ranks. Collective.

    Args:
        vertices: Of the local cells, shape (cells, corners).
    """
    width = len(problem.regions)
    rows = np.zeros((len(vertices), 1, width))
    for region, part in enumerate(problem.regions):
        rows[part.cells, :, region] = 1.0
    table = summed(problem.body.mesh.topology.index_map(0), vertices, rows)
    return np.asarray(np.count_nonzero(table, axis=1) > 1)


def _angle(corners: FloatArray, ridge: IntArray) -> FloatArray:
    """Angle of cells at one of their edges (vertices in the plane) [rad], shape (cells,).

    Args:
        corners: Shape (cells, corners, dim).
    """
    a, b = (k for k in range(corners.shape[1]) if k not in ridge)
    foot = corners[:, ridge[0]]
    arms = [corners[:, k] - foot for k in (a, b)]
    if len(ridge) == 2:
        along = corners[:, ridge[1]] - foot
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        arms = [arm - np.sum(arm * along, axis=1, keepdims=True) * along for arm in arms]
    lengths = np.linalg.norm(arms[0], axis=1) * np.linalg.norm(arms[1], axis=1)
    return np.asarray(np.arccos(np.clip(np.sum(arms[0] * arms[1], axis=1) / lengths, -1.0, 1.0)))
