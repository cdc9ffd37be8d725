"""Cells and facets of any geometric degree: quadrature points, volumes and areas."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.simplices import (
    EDGE_ENDS,
    cells_beside_edges,
    cells_beside_facets,
    determinants,
    node_cells,
)

_SHAPES = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}

_CHUNK = 16384
"""Cells that are treated at once, which bounds the memory."""


def _element(dim: int, degree: int) -> basix.finite_element.FiniteElement:
    return basix.create_element(
        basix.ElementFamily.P, _SHAPES[dim], degree, basix.LagrangeVariant.equispaced
    )


def quadrature_rule(dim: int, degree: int) -> tuple[FloatArray, FloatArray]:
    """Quadrature rule on the reference simplex.

    Args:
        dim: 1, 2 or 3.
        degree: Polynomials up to this degree are integrated exactly.

    Returns:
        Points, shape (points, dim), and weights, shape (points,).
    """
    points, weights = basix.make_quadrature(_SHAPES[dim], degree)
    return (
        np.asarray(points, dtype=np.float64).reshape(-1, dim),
        np.asarray(weights, dtype=np.float64),
    )


def cell_gradients(nodes: FloatArray, degree: int, points: FloatArray) -> FloatArray:
    """Jacobian matrices dx/dX of isoparametric simplices.

    Args:
        nodes: Coordinates of their nodes [m], shape (n, k, gdim).
        points: Points of the reference simplex, shape (points, tdim).

    Returns:
        Shape (n, points, gdim, tdim).
    """
    tdim = points.shape[1]
    slopes = _slopes(tdim, degree, points).transpose(1, 0, 2)  # by node, point and direction
    rows = nodes.transpose(0, 2, 1).reshape(-1, nodes.shape[1])  # one product, not one a cell
    result = (rows @ slopes.reshape(len(slopes), -1)).reshape(-1, nodes.shape[2], len(points), tdim)
    return result.transpose(0, 2, 1, 3)


def shape_functions(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Shape functions of the geometry of a mesh's cells. Local.

    Args:
        points: Points of the reference cell, shape (points, dim).

    Returns:
        Shape (points, nodes of a cell).
    """
    element = _element(mesh.topology.dim, mesh.geometry.cmap.degree)
    return np.asarray(element.tabulate(0, points)[0, :, :, 0], dtype=np.float64)


def shape_gradients(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Gradients of the shape functions of the geometry, in the reference cell. Local.

    Args:
        points: Points of the reference cell, shape (points, dim).

    Returns:
        Shape (points, nodes of a cell, dim), contiguous.
    """
    return np.ascontiguousarray(_slopes(mesh.topology.dim, mesh.geometry.cmap.degree, points))


def _slopes(dim: int, degree: int, points: FloatArray) -> FloatArray:
    """Gradients of shape functions of a reference simplex, shape (points, nodes, dim)."""
    table = np.asarray(_element(dim, degree).tabulate(1, points), dtype=np.float64)
    return table[1 : dim + 1, :, :, 0].transpose(1, 2, 0)


def cell_jacobians(mesh: Mesh, points: FloatArray, cells: IndexArray | None = None) -> FloatArray:
    """det(dx/dX) of local cells. Local.

    Args:
        points: Points of the reference cell, shape (points, dim).
        cells: Local cells; by default all.

    Returns:
        Shape (cells, points).
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    rows = mesh.geometry.dofmap if cells is None else mesh.geometry.dofmap[cells]
    result = np.empty((len(rows), len(points)))
    for first in range(0, len(rows), _CHUNK):
        some = slice(first, first + _CHUNK)
        nodes = np.asarray(mesh.geometry.x[rows[some], :d], dtype=np.float64)
        result[some] = determinants(cell_gradients(nodes, degree, points))
    return result


def cell_volumes(mesh: Mesh) -> FloatArray:
    """Volume (area in 2D) of each local cell, exact for curved cells too. Local."""
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    points, weights = quadrature_rule(d, d * (degree - 1))
    return np.asarray(np.abs(cell_jacobians(mesh, points)) @ weights)


def smallest_jacobians(mesh: Mesh) -> FloatArray:
    """Smallest det(dx/dX) of each local cell, relative to its mean, at nodes and inside.

    Local.  Zero or negative where a curved cell folds over itself.
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    inside, _ = quadrature_rule(d, 4)
    values = cell_jacobians(mesh, np.concatenate([_element(d, degree).points, inside]))
    mean = values.mean(axis=1, keepdims=True)
    return np.asarray((values / np.where(mean == 0, 1.0, mean)).min(axis=1))


def facet_areas(mesh: Mesh, facets: IndexArray) -> FloatArray:
    """Area (length in 2D) of local facets [m^2]. Local, after `prepare_facets`.

    Exact for straight facets; by a rule of degree 8 for curved ones.

    Args:
        facets: Local facets, shape (n,).
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    points, weights = quadrature_rule(d - 1, 8 if degree > 1 else 0)
    slopes = cell_gradients(mesh.geometry.x[_facet_nodes(mesh, facets), :d], degree, points)
    metric = np.einsum("npgs,npgt->npst", slopes, slopes)
    return np.asarray(np.sqrt(np.linalg.det(metric)) @ weights)


def facet_points(
    mesh: Mesh, facets: IndexArray, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points and tangents dx/dX of local facets. Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (facets,).
        points: Points of the reference facet, shape (points, d - 1).

    Returns:
        Shapes (facets, points, d) and (facets, points, d, d - 1).
    """
    d, degree = mesh.topology.dim, mesh.geometry.cmap.degree
    nodes = mesh.geometry.x[_facet_nodes(mesh, facets), :d]
    table = facet_shape_functions(d, degree, points)
    coordinates = np.einsum("pk,fkj->fpj", table, nodes)
    return np.asarray(coordinates), cell_gradients(nodes, degree, points)


def facet_shape_functions(dim: int, degree: int, points: FloatArray) -> FloatArray:
    """Values of Lagrange's shape functions on a facet, nodes in the order of its closure.

    Args:
        points: Points of the reference facet, shape (points, dim - 1).

    Returns:
        Shape (points, nodes).
    """
    return np.asarray(_element(dim - 1, degree).tabulate(0, points)[0, :, :, 0], dtype=np.float64)


def _facet_nodes(mesh: Mesh, facets: IndexArray) -> IndexArray:
    """All nodes of facets, shape (n, k)."""
    d = mesh.topology.dim
    cells, local = cells_beside_facets(mesh, facets)
    closure = np.array(_element(d, mesh.geometry.cmap.degree).entity_closure_dofs[d - 1])
    return np.take_along_axis(mesh.geometry.dofmap[cells], closure[local], axis=1)


@dataclass(frozen=True)
class QuadraturePoints:
    """Quadrature points of some local cells or facets, in the reference configuration.

    Attributes:
        X: Places [m], shape (entities, points, dim).
        weights: Quadrature weight times volume, area or length element, shape (entities, points).
        cells: The cell of each entity, shape (entities,).
        local: The points in the reference cell or facet, shape (points, its dimension).
        nodes: The mesh's nodes of each entity, shape (entities, nodes).
        shapes: Their shape functions at the points, shape (points, nodes).
        N: For facets, outward unit normals, shape of X; else None.
    """

    X: FloatArray
    weights: FloatArray
    cells: IndexArray
    local: FloatArray
    nodes: IndexArray
    shapes: FloatArray
    N: FloatArray | None = None


def cell_quadrature(mesh: Mesh, cells: IndexArray, degree: int) -> QuadraturePoints:
    """Points that integrate polynomials of a degree over local cells. Local.

    Args:
        cells: Local cells, shape (n,).
        degree: Degree in X of polynomials that straight cells integrate exactly; on curved ones
            the rule is raised by the degree of the determinant of the map.
    """
    d, curved = mesh.topology.dim, mesh.geometry.cmap.degree
    local, weights = quadrature_rule(d, degree + d * (curved - 1))
    nodes, shapes = mesh.geometry.dofmap[cells], shape_functions(mesh, local)
    X = np.einsum("pn,cnj->cpj", shapes, mesh.geometry.x[nodes, :d])
    size = np.abs(cell_jacobians(mesh, local, cells)) * weights
    return QuadraturePoints(X, size, cells, local, nodes, shapes)


def facet_quadrature(
    mesh: Mesh, facets: IndexArray, degree: int, *, raised: bool = True
) -> QuadraturePoints:
    """Quadrature points over local facets, with normals outward of the cell beside.

    Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).
        degree: Degree of polynomials that straight facets integrate exactly.
        raised: On curved facets, where the integrand is no polynomial, the rule is 8 degrees
            higher; else it is that of a form's measure of this degree.
    """
    d, curved = mesh.topology.dim, mesh.geometry.cmap.degree
    local, weights = quadrature_rule(d - 1, degree + (8 if raised and curved > 1 else 0))
    X, slopes = facet_points(mesh, facets, local)
    if d == 2:
        along = slopes[..., 0]
        normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    else:
        normals = np.asarray(np.cross(slopes[..., 0], slopes[..., 1]), dtype=np.float64)
    size = np.linalg.norm(normals, axis=-1)
    cells, opposite = cells_beside_facets(mesh, facets)
    corner = mesh.geometry.x[mesh.geometry.dofmap[cells, opposite], :d]
    inward = np.einsum("fpj,fpj->fp", normals, corner[:, None] - X) > 0
    normals = np.where(inward[..., None], -normals, normals)
    nodes, shapes = _facet_nodes(mesh, facets), facet_shape_functions(d, curved, local)
    normals = normals / np.where(size > 0, size, 1.0)[..., None]
    return QuadraturePoints(X, size * weights, cells, local, nodes, shapes, normals)


@dataclass(frozen=True)
class PointsInCells:
    """Points of some nodes or edges, in one cell beside each.

    Attributes:
        X: Places [m], shape (entities, points, dim).
        weights: Of each point: 1 of a node, quadrature weight times length element of an edge [m];
            shape (entities, points).
        cells: The cell of each entity, shape (entities,).
        local: The points in the reference cell, shape of X.
    """

    X: FloatArray
    weights: FloatArray
    cells: IndexArray
    local: FloatArray


def node_points(mesh: Mesh, nodes: IndexArray) -> PointsInCells:
    """Geometry nodes in the first local cell of each. Local.

    Args:
        nodes: Local geometry nodes, shape (n,).
    """
    d, cells, local = mesh.topology.dim, *node_cells(mesh, nodes)
    reference = reference_nodes(mesh)[local][:, None]
    X = np.asarray(mesh.geometry.x[nodes, :d])[:, None]
    return PointsInCells(X, np.ones((len(nodes), 1)), cells, reference)


def reference_nodes(mesh: Mesh) -> FloatArray:
    """Nodes of the geometry in the reference cell, shape (nodes of a cell, dim)."""
    points = _element(mesh.topology.dim, mesh.geometry.cmap.degree).points
    return np.asarray(points, dtype=np.float64)


def edge_rule(mesh: Mesh, degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points on the edges of the reference tetrahedron.

    Args:
        degree: Degree of polynomials that straight edges integrate exactly; on curved ones, where
            the length element is no polynomial, the rule is 8 degrees higher.

    Returns:
        Points, shape (6, points, 3), weights, shape (points,), and the vectors along the edges, of
        their length, shape (6, 3).
    """
    s, weights = quadrature_rule(1, degree + (8 if mesh.geometry.cmap.degree > 1 else 0))
    corners = np.asarray(_element(3, 1).points, dtype=np.float64)
    start, end = (corners[[ends[k] for ends in EDGE_ENDS]] for k in (0, 1))
    along = end - start
    return start[:, None] + s[None] * along[:, None], weights, along


def edge_points(mesh: Mesh, edges: IndexArray, degree: int) -> PointsInCells:
    """Quadrature points along local edges of tetrahedra. Local, after `prepare_edges`.

    Args:
        edges: Local edges, shape (n,).
        degree: See `edge_rule`.
    """
    points, weights, along = edge_rule(mesh, degree)
    cells, local = cells_beside_edges(mesh, edges)
    X, size = np.empty((len(edges), len(weights), 3)), np.empty((len(edges), len(weights)))
    for i in range(len(EDGE_ENDS)):
        here = local == i
        nodes = np.asarray(mesh.geometry.x[mesh.geometry.dofmap[cells[here]]])
        X[here] = np.einsum("pn,cnj->cpj", shape_functions(mesh, points[i]), nodes)
        slopes = cell_gradients(nodes, mesh.geometry.cmap.degree, points[i]) @ along[i]
        size[here] = np.linalg.norm(slopes, axis=-1) * weights
    return PointsInCells(X, size, cells, points[local])
