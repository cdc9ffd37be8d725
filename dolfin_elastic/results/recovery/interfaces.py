"""Edges at which materials meet each other or the surface, and the stress is singular.

Two materials that are bonded strain each other: where their interface ends at the surface, or has a
corner, the stress grows like r^(lambda - 1), by their moduli and angles; see `stress_exponent`.
Flat interfaces inside the body leave it bounded, and corners of less than a margin count as flat,
for facets of a round interface meet at angles, too.
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import la

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.problem.material_regions import poisson, shear_modulus
from dolfin_elastic.results.recovery.patches import cell_edges
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
    problem: Problem, facets: FloatArray, whole: FloatArray, some: FloatArray
) -> BoolArray:
    """Local edges of the mesh (vertices in the plane) that are singular so. Collective.

    Args:
        problem: The problem that is solved.
        facets: Number of boundary facets at each of them.
        whole: Which of these are held.
        some: Which are held in some directions.
    """
    singular = np.zeros(len(facets), dtype=bool)
    if len(problem.regions) < 2:
        return singular
    angles = np.round(_angles(problem, len(facets)) / _STEP).astype(int)
    alike = np.column_stack([facets - whole - some, whole, some])
    around, straight = round(2 * np.pi / _STEP), round(np.pi / _STEP)
    margin = round(_MARGIN / _STEP)
    chosen = np.flatnonzero(((angles > 0).sum(axis=1) == 2) & ((facets == 2) | (facets == 0)))
    face = np.where(facets == 0, -1, np.where(alike.max(axis=1) == 2, alike.argmax(axis=1), -2))
    keys = np.column_stack([face[chosen], angles[chosen]])
    for key in np.unique(keys, axis=0):
        regions = np.flatnonzero(key[1:])
        sizes = key[1:][regions]
        inside = key[0] == -1
        bent = np.abs(sizes - straight).max() > margin and abs(sizes.sum() - around) <= margin
        if key[0] == -2 or (inside and not bent):
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


def _angles(problem: Problem, count: int) -> FloatArray:
    """Angle that each region fills at each local edge, shape (edges, regions) [rad]. Collective.

    Args:
        problem: The problem that is solved.
        count: Number of local edges (vertices in the plane).
    """
    mesh, dim = problem.body.mesh, problem.body.dim
    corners = cell_corners(mesh)
    around = mesh.topology.connectivity(dim, dim - 2).array.reshape(-1, comb(dim + 1, dim - 1))
    width = len(problem.regions)
    work = la.vector(mesh.topology.index_map(dim - 2), width)
    table = work.array.reshape(count, width)
    for number, ridge in enumerate(cell_edges(dim) if dim == 3 else np.arange(3)[:, None]):
        a, b = (k for k in range(dim + 1) if k not in ridge)
        foot = corners[:, ridge[0]]
        arms = [corners[:, k] - foot for k in (a, b)]
        if dim == 3:
            along = corners[:, ridge[1]] - foot
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            arms = [arm - np.sum(arm * along, axis=1, keepdims=True) * along for arm in arms]
        lengths = np.linalg.norm(arms[0], axis=1) * np.linalg.norm(arms[1], axis=1)
        angle = np.arccos(np.clip(np.sum(arms[0] * arms[1], axis=1) / lengths, -1.0, 1.0))
        for region, part in enumerate(problem.regions):
            np.add.at(table[:, region], around[part.cells, number], angle[part.cells])
    work.scatter_reverse(la.InsertMode.add)
    work.scatter_forward()
    return np.asarray(table)
