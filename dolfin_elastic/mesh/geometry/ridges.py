"""Ridges, where facets meet: edges of tetrahedra, in the plane vertices.

Angles at those of the boundary; and sums over all cells of all ranks at chosen ones, without tables
of all edges of the mesh, most of which are inside of a body that is made of one material.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import RankExchange
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.simplices import EDGE_ENDS, boundary_facets, outward_normals


def ridge_angles(mesh: Mesh) -> FloatArray:
    """Angle [rad] between the normals of two facets of the boundary, at each ridge between them.

    Collective; each ridge is on exactly one rank, and those of more than two facets are on none.
    """
    d = mesh.topology.dim
    facets = boundary_facets(mesh)
    mesh.topology.create_entities(d - 2)
    mesh.topology.create_connectivity(d - 1, d - 2)
    ridges = mesh.topology.connectivity(d - 1, d - 2).array.reshape(-1, d)[facets]
    index = mesh.topology.index_map(d - 2)
    rows = np.column_stack([outward_normals(mesh, facets), np.ones(len(facets))])
    owned = summed(index, ridges, rows[:, None, :])[: index.size_local]  # normals, and how many
    between = owned[owned[:, d] == 2, :d]
    # Two unit normals at an angle a have a sum of length 2 cos(a/2).
    return np.asarray(2 * np.arccos(np.minimum(np.linalg.norm(between, axis=1) / 2, 1.0)))


def cell_ridges(dim: int) -> IntArray:
    """Corners of each ridge of a cell, shape (ridges, dim - 1).

    Args:
        dim: 2: triangle, 3: tetrahedron.
    """
    return np.array(EDGE_ENDS if dim == 3 else [(0,), (1,), (2,)], dtype=np.int64)


def sums_by_row(rows: IndexArray | IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sums of the values that belong to each row of a table, shape (count, columns).

    Args:
        rows: Row of each value, any shape.
        values: The same shape and (columns,).
    """
    flat, table = rows.reshape(-1), values.reshape(rows.size, values.shape[-1])
    # Not by a sparse matrix: importing scipy takes longer.
    result = np.empty((count, table.shape[1]))
    for column in range(table.shape[1]):
        result[:, column] = np.bincount(flat, table[:, column], minlength=count)
    return result


class Ridges:
    """Ridges that are given as parts of cells, each as often as one likes. Collective.

    Args:
        mesh: The mesh, with the links of cells to vertices.
        cells: Local cells, shape (rows,).
        numbers: Local ridge in each, shape (rows,).

    Attributes:
        count: Number of different ridges here; other ranks may have some of them, too.
    """

    def __init__(self, mesh: Mesh, cells: IndexArray, numbers: IndexArray) -> None:
        topology, dim = mesh.topology, mesh.topology.dim
        vertices = topology.index_map(0)
        corners = topology.connectivity(dim, 0).array.reshape(-1, dim + 1)[cells]
        ends = np.take_along_axis(corners, cell_ridges(dim)[numbers], axis=1)
        ends = vertices.local_to_global(ends.ravel()).reshape(ends.shape)
        ends.sort(axis=1)
        keys = ends[:, 0] if dim == 2 else ends[:, 0] * vertices.size_global + ends[:, 1]
        keys, first, self._of_row = np.unique(keys, return_index=True, return_inverse=True)
        self.count = len(keys)
        self._cells, self._numbers = cells[first], numbers[first]
        # Sums are made by a rank that follows from the ridge alone.
        self._exchange = RankExchange(
            mesh.comm, ends[first, 0] * mesh.comm.size // vertices.size_global
        )
        here = self._exchange.send(keys[:, None])[:, 0]
        different, self._here = np.unique(here, return_inverse=True)
        self._different = len(different)

    def sums(self, rows: slice, values: FloatArray) -> FloatArray:
        """Sums over some of the rows, of each ridge on all ranks. Collective.

        Args:
            values: Shape (these rows, columns).

        Returns:
            Shape (count, columns).
        """
        parts = self._exchange.send(sums_by_row(self._of_row[rows], values, self.count))
        whole = sums_by_row(self._here, parts, self._different)
        return np.asarray(self._exchange.send_back(whole[self._here]))

    def of_rows(self, values: FloatArray) -> FloatArray:
        """For each row that was given the sum over those of the same ridge. Collective.

        Args:
            values: Shape (..., columns), where the rows may have any shape.

        Returns:
            Of the same shape.
        """
        # The columns are named: a rank without rows cannot count them.
        table = values.reshape(len(self._of_row), values.shape[-1])
        return self.sums(slice(None), table)[self._of_row].reshape(values.shape)

    def nodes(self, V: fem.FunctionSpace) -> IndexArray:
        """Local nodes of each ridge, shape (count, nodes of a ridge). Local.

        Args:
            V: Space of continuous Lagrange elements on the mesh.
        """
        dim, layout = V.mesh.topology.dim, V.dofmap.dof_layout
        count = len(cell_ridges(dim))
        closure = np.array([layout.entity_closure_dofs(dim - 2, i) for i in range(count)])
        return np.asarray(V.dofmap.list[self._cells[:, None], closure[self._numbers]])
