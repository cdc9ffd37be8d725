"""Volumes and areas of cells and facets of any geometric degree, by quadrature."""

from __future__ import annotations

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfin_elastic.meshes.shapes import Floats, Indices, facet_places

_SHAPES = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def _element(dim: int, degree: int) -> basix.finite_element.FiniteElement:
    return basix.create_element(
        basix.ElementFamily.P, _SHAPES[dim], degree, basix.LagrangeVariant.equispaced
    )


def _rule(dim: int, degree: int) -> tuple[Floats, Floats]:
    points, weights = basix.make_quadrature(_SHAPES[dim], degree)
    return (
        np.asarray(points, dtype=np.float64).reshape(-1, dim),
        np.asarray(weights, dtype=np.float64),
    )


def cell_gradients(nodes: Floats, degree: int, points: Floats) -> Floats:
    """dx/dX at points of the reference simplex; nodes (n, k, gdim) -> (n, points, gdim, tdim)."""
    tdim = points.shape[1]
    table = np.asarray(_element(tdim, degree).tabulate(1, points), dtype=np.float64)
    return np.asarray(np.einsum("nkg,tpk->npgt", nodes, table[1 : tdim + 1, :, :, 0]))


def tabulated(mesh: Mesh, points: Floats) -> Floats:
    """Shape functions of the mesh's cells at reference points, shape (points, nodes). Local."""
    element = _element(mesh.topology.dim, mesh.geometry.cmap.degree)
    return np.asarray(element.tabulate(0, points)[0, :, :, 0], dtype=np.float64)


def cell_jacobians(mesh: Mesh, points: Floats) -> Floats:
    """det(dx/dX) of each local cell at reference points, shape (cells, points). Local."""
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    nodes = np.asarray(mesh.geometry.x[mesh.geometry.dofmap, :d], dtype=np.float64)
    return np.asarray(np.linalg.det(cell_gradients(nodes, degree, points)))


def cell_volumes(mesh: Mesh) -> Floats:
    """Volume (area in 2D) of each local cell, exact for curved cells too. Local."""
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    points, weights = _rule(d, d * (degree - 1))
    return np.asarray(np.abs(cell_jacobians(mesh, points)) @ weights)


def smallest_jacobians(mesh: Mesh) -> Floats:
    """Smallest det(dx/dX) of each local cell, relative to its mean, at nodes and inside.

    Local.  Zero or negative where a curved cell folds over itself.
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    inside, _ = _rule(d, 4)
    values = cell_jacobians(mesh, np.concatenate([_element(d, degree).points, inside]))
    mean = values.mean(axis=1, keepdims=True)
    return np.asarray((values / np.where(mean == 0, 1.0, mean)).min(axis=1))


def facet_areas(mesh: Mesh, facets: npt.NDArray[np.int32]) -> Floats:
    """Area (length in 2D) of local facets. Local, after `prepare_facets`.

    Exact for straight facets; by a rule of degree 8 for curved ones.
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    points, weights = _rule(d - 1, 8 if degree > 1 else 0)
    slopes = cell_gradients(_facet_nodes(mesh, facets), degree, points)
    metric = np.einsum("npgs,npgt->npst", slopes, slopes)
    return np.asarray(np.sqrt(np.linalg.det(metric)) @ weights)


def _facet_nodes(mesh: Mesh, facets: Indices) -> Floats:
    """Coordinates of all nodes of facets, shape (n, k, d)."""
    d = mesh.topology.dim
    cells, local = facet_places(mesh, facets)
    closure = np.array(_element(d, mesh.geometry.cmap.degree).entity_closure_dofs[d - 1])
    nodes = np.take_along_axis(mesh.geometry.dofmap[cells], closure[local], axis=1)
    return np.asarray(mesh.geometry.x[nodes, :d])
