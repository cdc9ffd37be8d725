"""Volumes, normals and shapes of simplices, from plain arrays or from a mesh."""

from __future__ import annotations

from itertools import combinations
from math import factorial

import numpy as np
from dolfinx.fem import FunctionSpace
from dolfinx.mesh import Mesh, exterior_facet_indices

from dolfin_elastic.core.types import FloatArray, IndexArray

_REGULAR = {2: 4 / np.sqrt(3), 3: 6 * np.sqrt(2)}  # 1 / volume of the regular simplex of edge 1


def signed_volumes(corners: FloatArray) -> FloatArray:
    """Signed volume (area in 2D) of straight simplices.

    Args:
        corners: Vertex coordinates, shape (n, d + 1, d).

    Returns:
        Shape (n,); negative where the vertices run the other way round.
    """
    edges = corners[:, 1:] - corners[:, :1]
    return determinants(edges) / factorial(corners.shape[2])


def determinants(matrices: FloatArray) -> FloatArray:
    """Those of 2 x 2 and 3 x 3 matrices, shape (...); numpy's function takes five times as long.

    Args:
        matrices: Shape (..., d, d).
    """
    rows = np.moveaxis(matrices, (-2, -1), (0, 1))
    if len(rows) != 3:
        return np.asarray(np.linalg.det(matrices))
    (a, b, c), (d, e, f), (g, h, i) = rows
    return np.asarray(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g))


def longest_edges(corners: FloatArray) -> FloatArray:
    """Longest edge of each simplex, shape (n,)."""
    longest = np.zeros(len(corners))
    for i, j in combinations(range(corners.shape[1]), 2):
        np.maximum(longest, np.linalg.norm(corners[:, i] - corners[:, j], axis=1), out=longest)
    return longest


def qualities(corners: FloatArray) -> FloatArray:
    """Volume over longest edge to the power d: 1 for a regular simplex, 0 for a flat one."""
    size = np.maximum(longest_edges(corners), np.finfo(float).tiny ** 0.25)
    d = corners.shape[2]
    return np.asarray(np.abs(signed_volumes(corners)) / size**d * _REGULAR[d])


def cell_corners(mesh: Mesh, cells: IndexArray | None = None) -> FloatArray:
    """Vertex coordinates of local cells [m], shape (n, d + 1, d). Local.

    Args:
        cells: Local cells; by default all.
    """
    d = mesh.topology.dim
    nodes = mesh.geometry.dofmap[:, : d + 1]
    return np.asarray(mesh.geometry.x[nodes if cells is None else nodes[cells], :d])


def prepare_facets(mesh: Mesh) -> None:
    """Creates the facets and their links to cells. Collective."""
    d = mesh.topology.dim
    mesh.topology.create_entities(d - 1)
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)


def boundary_facets(mesh: Mesh) -> IndexArray:
    """Local facets on the boundary of the body, each on exactly one rank, sorted. Collective."""
    prepare_facets(mesh)
    return np.sort(np.asarray(exterior_facet_indices(mesh.topology), dtype=np.int32))


def cells_beside_facets(mesh: Mesh, facets: IndexArray) -> tuple[IndexArray, IndexArray]:
    """One cell beside each local facet, and the facet's local index in it.

    The index is that of the opposite vertex, too.  Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).

    Returns:
        Local cells and local indices, shape (n,) each.
    """
    d = mesh.topology.dim
    links = mesh.topology.connectivity(d - 1, d)
    cells = links.array[links.offsets[facets]]
    around = mesh.topology.connectivity(d, d - 1).array.reshape(-1, d + 1)[cells]
    local = np.argmax(around == np.asarray(facets)[:, None], axis=1)
    return cells, local.astype(np.int32)


def dofs_on_facets(V: FunctionSpace, facets: IndexArray) -> IndexArray:
    """Local nodes of a space on local facets, vertices first.  Local, after `prepare_facets`.

    Args:
        facets: Shape (n,).

    Returns:
        Shape (n, nodes of a facet).
    """
    layout, d = V.dofmap.dof_layout, V.mesh.topology.dim
    closure = np.array([layout.entity_closure_dofs(d - 1, i) for i in range(d + 1)], dtype=np.int32)
    cells, local = cells_beside_facets(V.mesh, facets)
    return np.asarray(V.dofmap.list[cells[:, None], closure[local]])


def facet_nodes(mesh: Mesh, facets: IndexArray) -> IndexArray:
    """Geometry nodes at the vertices of local facets, shape (n, d).

    Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).
    """
    d = mesh.topology.dim
    cells, local = cells_beside_facets(mesh, facets)
    others = np.array([[k for k in range(d + 1) if k != i] for i in range(d + 1)])
    nodes = mesh.geometry.dofmap[:, : d + 1][cells]
    return np.asarray(np.take_along_axis(nodes, others[local], axis=1))


EDGE_ENDS = ((2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1))
"""Vertices of the edges of a tetrahedron, as Basix numbers them."""


def prepare_edges(mesh: Mesh) -> None:
    """Creates the edges of tetrahedra and their links to cells. Collective."""
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(1, 3)
    mesh.topology.create_connectivity(3, 1)


def cells_beside_edges(mesh: Mesh, edges: IndexArray) -> tuple[IndexArray, IndexArray]:
    """One cell beside each local edge, and the edge's local index in it.

    Local, after `prepare_edges`.

    Args:
        edges: Local edges, shape (n,).

    Returns:
        Local cells and local indices, shape (n,) each.
    """
    links = mesh.topology.connectivity(1, 3)
    cells = links.array[links.offsets[edges]]
    around = mesh.topology.connectivity(3, 1).array.reshape(-1, 6)[cells]
    local = np.argmax(around == np.asarray(edges)[:, None], axis=1)
    return cells, local.astype(np.int32)


def edge_nodes(mesh: Mesh, edges: IndexArray) -> IndexArray:
    """Geometry nodes at both ends of local edges, shape (n, 2). Local, after `prepare_edges`.

    Args:
        edges: Local edges, shape (n,).
    """
    cells, local = cells_beside_edges(mesh, edges)
    nodes = mesh.geometry.dofmap[:, :4][cells]
    return np.asarray(np.take_along_axis(nodes, np.array(EDGE_ENDS)[local], axis=1))


def node_cells(mesh: Mesh, nodes: IndexArray) -> tuple[IndexArray, IndexArray]:
    """The first local cell with each geometry node, and the node's local index in it. Local.

    Args:
        nodes: Local geometry nodes, shape (n,).

    Returns:
        Local cells and local indices, shape (n,) each.
    """
    rows = np.asarray(mesh.geometry.dofmap)
    first = np.full(len(mesh.geometry.x), rows.size, dtype=np.int64)
    np.minimum.at(first, rows.ravel(), np.arange(rows.size))
    offsets = first[nodes]
    width = rows.shape[1]
    return (offsets // width).astype(np.int32), (offsets % width).astype(np.int32)


def facet_corners(mesh: Mesh, facets: IndexArray) -> FloatArray:
    """Vertex coordinates of local facets [m], shape (n, d, d). Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).
    """
    return np.asarray(mesh.geometry.x[facet_nodes(mesh, facets), : mesh.topology.dim])


def facet_normals(mesh: Mesh, facets: IndexArray) -> FloatArray:
    """Normals of straight local facets, to one side or the other, of the length of their area.

    Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).

    Returns:
        Shape (n, d) [m^2], in a plane [m].
    """
    corners = facet_corners(mesh, facets)
    a = corners[:, 1] - corners[:, 0]
    if mesh.topology.dim == 2:
        return np.stack([a[:, 1], -a[:, 0]], axis=1)
    b = corners[:, 2] - corners[:, 0]
    turned = [a[:, i] * b[:, j] - a[:, j] * b[:, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.stack(turned, axis=1) / 2


def outward_normals(mesh: Mesh, facets: IndexArray) -> FloatArray:
    """Unit normals of straight local facets, outward of the cell beside them, shape (n, d).

    Local, after `prepare_facets`.

    Args:
        facets: Local facets, shape (n,).
    """
    normals = facet_normals(mesh, facets)
    cells, local = cells_beside_facets(mesh, facets)
    corners = cell_corners(mesh, cells)
    opposite = corners[np.arange(len(facets)), local]
    on_it = corners[np.arange(len(facets)), np.where(local == 0, 1, 0)]
    inward = np.einsum("ij,ij->i", normals, opposite - on_it) > 0
    normals[inward] *= -1
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, 1.0))
