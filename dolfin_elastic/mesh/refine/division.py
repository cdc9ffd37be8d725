"""`divide`: finer cells in coarse ones, and finite element functions on both.

DOLFINx divides the straight skeleton of the mesh; each finer cell lies in one cell of the coarse
mesh, with corners at corners or at midpoints of edges.

Source: A. Plaza and G. F. Carey, Local refinement of simplicial grids based on the skeleton,
Appl. Numer. Math. 32 (2000) 195.
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import cpp
from dolfinx.fem import coordinate_element
from dolfinx.mesh import Mesh, RefinementOption, compute_incident_entities, refine

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.distribute import before_partitioning
from dolfin_elastic.mesh.geometry.simplices import cell_corners

_STRETCH = np.eye(3) + 1e-6 * np.array([[0.0, 0.31, 0.17], [0.31, 0.73, 0.57], [0.17, 0.57, 1.37]])
_SHAPES = {2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def lagrange(dim: int, degree: int) -> basix.finite_element.FiniteElement:
    """The Lagrange element of geometry and displacements on triangles or tetrahedra.

    Args:
        dim: 2 or 3.
    """
    return basix.create_element(
        basix.ElementFamily.P, _SHAPES[dim], degree, basix.LagrangeVariant.equispaced
    )


def barycentric(points: FloatArray) -> FloatArray:
    """Barycentric coordinates of points of the reference simplex, shape (..., dim + 1).

    Args:
        points: Shape (..., dim).
    """
    return np.concatenate([1.0 - points.sum(axis=-1, keepdims=True), points], axis=-1)


@dataclass(frozen=True)
class Division:
    """The finer mesh as DOLFINx makes it: straight, each cell on the rank of its parent.

    Attributes:
        mesh: The straight finer mesh.
        parents: Local cell of the coarse mesh for each finer cell, shape (cells,).
        corners: Barycentric coordinates of the corners of each finer cell in its parent, multiples
            of 1/2, shape (cells, d + 1, d + 1): corner, coordinate.
    """

    mesh: Mesh
    parents: IndexArray
    corners: FloatArray

    def places(self, points: FloatArray) -> FloatArray:
        """Points of the finer cells in their parents.

        Args:
            points: Of the reference cell, shape (k, d).

        Returns:
            Barycentric coordinates, shape (cells, k, d + 1).
        """
        return np.asarray(np.einsum("kv,cvj->ckj", barycentric(points), self.corners))


def divide(mesh: Mesh, cells: IndexArray) -> Division:
    """Halves all edges of cells, and those of neighbours that it takes to leave no node hanging.

    Collective.

    Args:
        cells: Local cells of this rank.
    """
    d = mesh.topology.dim
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(d, 1)
    mesh.topology.create_connectivity(1, d)
    edges = compute_incident_entities(mesh.topology, np.asarray(cells, dtype=np.int32), d, 1)
    skeleton = _skeleton(mesh)
    before_partitioning(mesh.comm)
    finer, given, _ = refine(
        skeleton,
        np.unique(edges).astype(np.int32),
        partitioner=None,
        option=RefinementOption.parent_cell,
    )
    count = finer.topology.index_map(d).size_local
    # DOLFINx returns the parents in the order of the cells before it renumbers them.
    first = mesh.comm.exscan(count) or 0
    parents = np.asarray(given)[np.asarray(finer.topology.original_cell_index) - first]
    coarse, fine = cell_corners(skeleton, parents), cell_corners(finer)
    axes = np.swapaxes(coarse[:, 1:] - coarse[:, :1], 1, 2)
    local = np.linalg.solve(axes[:, None], (fine - coarse[:, :1])[..., None])[..., 0]
    corners = np.round(2 * barycentric(np.asarray(local, dtype=np.float64))) / 2
    return Division(finer, parents.astype(np.int32), np.asarray(corners, dtype=np.float64))


def _skeleton(mesh: Mesh) -> Mesh:
    """The mesh with straight edges between its corners, stretched a little.

    DOLFINx bisects the longest edge of a cell first, and chooses among equally long ones by numbers
    that depend on the ranks; after the stretch no two are equally long.  Barycentric coordinates do
    not change with it.  The topology is the same object.
    """
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d, 0)
    index = mesh.topology.index_map(0)
    vertices = mesh.topology.connectivity(d, 0).array.reshape(-1, d + 1)
    x = np.zeros((index.size_local + index.num_ghosts, d))
    x[vertices.reshape(-1)] = cell_corners(mesh).reshape(-1, d) @ _STRETCH[:d, :d]
    numbers = index.local_to_global(np.arange(len(x), dtype=np.int32))
    element = coordinate_element(lagrange(d, 1))._cpp_object
    geometry = cpp.mesh.Geometry_float64(index, vertices.astype(np.int32), element, x, numbers)
    straight = cpp.mesh.Mesh_float64(mesh.comm, mesh.topology._cpp_object, geometry)
    return Mesh(straight, ufl.Mesh(basix.ufl.element("Lagrange", mesh.basix_cell(), 1, shape=(d,))))


def interpolated(dim: int, degree: int, coordinates: FloatArray, values: AnyArray) -> FloatArray:
    """Values of a Lagrange element at points of its cells.

    Args:
        dim: 2 or 3.
        coordinates: Barycentric coordinates, shape (cells, k, dim + 1).
        values: At the nodes of the cells, shape (cells, nodes, columns).

    Returns:
        Shape (cells, k, columns).
    """
    points = np.ascontiguousarray(coordinates[..., 1:]).reshape(-1, dim)
    # Finer cells have only a few positions in their parents: each is tabulated once.
    unique, inverse = np.unique(points, axis=0, return_inverse=True)
    table = lagrange(dim, degree).tabulate(0, unique)[0, :, :, 0]
    shapes = table[inverse.reshape(-1)].reshape(*coordinates.shape[:2], table.shape[1])
    return np.asarray(np.einsum("ckn,cnj->ckj", shapes, values))
