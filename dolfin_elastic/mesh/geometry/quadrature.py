"""Points at which cells and facets of any geometric degree are integrated, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import (
    cell_jacobians,
    facet_points,
    rule,
    tabulated,
)
from dolfin_elastic.mesh.geometry.simplices import facet_places


@dataclass(frozen=True)
class Points:
    """Quadrature points of some local cells or facets, in the reference configuration.

    Attributes:
        X: Places [m], shape (entities, points, dim).
        weights: Volumes, areas or lengths that the points stand for, shape (entities, points).
        cells: The cell of each entity, shape (entities,).
        local: For cells, the points in the reference cell, shape (points, dim); else None.
        N: For facets, outward unit normals, shape of X; else None.
    """

    X: FloatArray
    weights: FloatArray
    cells: IndexArray
    local: FloatArray | None = None
    N: FloatArray | None = None


def points_of_cells(mesh: Mesh, cells: IndexArray, degree: int) -> Points:
    """Points that integrate polynomials of a degree over local cells. Local.

    On curved cells the degree counts for the integrand times the determinant of the map.
    """
    d, curved = mesh.topology.dim, mesh.geometry.cmap.degree
    local, weights = rule(d, degree + d * (curved - 1))
    nodes = mesh.geometry.x[mesh.geometry.dofmap[cells], :d]
    X = np.einsum("pn,cnj->cpj", tabulated(mesh, local), nodes)
    size = np.abs(cell_jacobians(mesh, local, cells)) * weights
    return Points(X, size, cells, local=local)


def points_of_facets(mesh: Mesh, facets: IndexArray, degree: int) -> Points:
    """The same over local facets, with normals that point out of the cell beside.

    Local, after `prepare_facets`.  On curved facets the rule's degree is 8 higher, where the
    integrand is no polynomial any more.
    """
    d, curved = mesh.topology.dim, mesh.geometry.cmap.degree
    local, weights = rule(d - 1, degree + (8 if curved > 1 else 0))
    X, slopes = facet_points(mesh, facets, local)
    if d == 2:
        along = slopes[..., 0]
        normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    else:
        normals = np.asarray(np.cross(slopes[..., 0], slopes[..., 1]), dtype=np.float64)
    size = np.linalg.norm(normals, axis=-1)
    cells, opposite = facet_places(mesh, facets)
    corner = mesh.geometry.x[mesh.geometry.dofmap[cells, opposite], :d]
    inward = np.einsum("fpj,fpj->fp", normals, corner[:, None] - X) > 0
    normals = np.where(inward[..., None], -normals, normals)
    return Points(X, size * weights, cells, N=normals / np.where(size > 0, size, 1.0)[..., None])
