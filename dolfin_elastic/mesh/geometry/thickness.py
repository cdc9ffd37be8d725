"""Thickness of a body around each of its cells, and the extent of cells across it and along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.jit import compile_c, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, SingleArray
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    outward_normals,
)
from dolfin_elastic.mesh.geometry.thickness_loops import DECLARATIONS, SOURCE

_STEPS = 40
"""Steps of the random walk: it goes about 2.5 cells far, and sees walls of up to seven cells."""


@dataclass(frozen=True)
class Thickness:
    """Thickness of the body at its owned cells, and extents of these cells; arrays of shape (n,).

    Attributes:
        volumes: Of the cells [m^3] ([m^2] in a plane).
        thickness: Of the body there [m]; infinite far from its boundary.
        across: Root mean square of the cells' edges in the direction of the thickness [m].
        along: The same in the direction across it in which it is largest.
    """

    volumes: FloatArray
    thickness: FloatArray
    across: FloatArray
    along: FloatArray


def local_thickness(mesh: Mesh, without: IndexArray) -> Thickness:
    """Thickness of a body around each owned cell. Collective.

    It is 2 V/a, with a the largest eigenvalue of the integral of n n over the boundary of a part of
    volume V: exact for plates, bars of square or round section, cubes and balls.  The parts are
    weighted means around a cell: each step of a random walk leads from a cell to its vertices in
    equal shares, and from a vertex to its cells in proportion to their volumes, which keeps V.
    The result does not depend on how the mesh is shared by ranks, but for rounding.

    Args:
        mesh: The mesh; curved cells count by their corners and true volumes.
        without: Local boundary facets that do not count, such as planes of symmetry.
    """
    facets = np.setdiff1d(boundary_facets(mesh), without)
    beside, _ = cells_beside_facets(mesh, facets)
    normals = outward_normals(mesh, facets)
    faces = np.einsum("f,fi,fj->fij", facet_areas(mesh, facets), normals, normals)
    walk = _Walk(mesh)
    # Single cells of an irregular mesh are oblong at random; their neighbourhood is what bends.
    return walk.thickness(
        walk.steps(walk.added(beside, faces), _STEPS - 1), walk.steps(walk.edges, 1)
    )


class _Walk:
    """Means of tensors over the neighbourhood of cells. Steps are collective.

    Args:
        mesh: The mesh.

    Attributes:
        edges: Mean over the edges e of the cells around each vertex of e e [m^2]; arrays of
            vertices have a row for each local one, with the upper triangle of a tensor.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._dim, comm = mesh.topology.dim, mesh.comm
        mesh.topology.create_connectivity(self._dim, 0)
        self._loops = compile_c(comm, DECLARATIONS, SOURCE, {"DIM": self._dim}, options(comm))
        self._alone = comm.size == 1
        width = 8 if self._dim == 3 else 4
        self._sums = la.vector(mesh.topology.index_map(0), width, dtype=np.float32)
        self._vertices = mesh.topology.connectivity(self._dim, 0).array
        self._upper = [(i, j) for j in range(self._dim) for i in range(j + 1)]
        self._volumes = self._volumes_of(mesh)
        count, volume = total(comm, np.array([len(self._volumes), self._volumes.sum()]))
        self._mean = float(volume) / float(count) if volume > 0 else 1.0
        # Relative to their mean they suit single precision in any unit.
        self._relative = volumes = self._volumes / self._mean
        nodes, sums = mesh.geometry.dofmap, self._rows()
        where = (nodes.shape[1], nodes, mesh.geometry.x, self._vertices, volumes)
        self._loops.call("add_cells", len(volumes), *where, sums)
        sums = self._gathered(sums)
        around = sums[:, len(self._upper)]
        # A vertex without cells on any rank has no volume, and no cell asks for its mean.
        filled = np.where(around > 0, around, np.float32(1.0))
        self._inverse: SingleArray = np.reciprocal(filled)[:, None]
        self.edges: SingleArray = sums * self._inverse

    def _volumes_of(self, mesh: Mesh) -> FloatArray:
        """Volumes of the owned cells; of straight ones by the loop: a tenth of the time."""
        owned = mesh.topology.index_map(self._dim).size_local
        if mesh.geometry.cmap.degree > 1:
            return cell_volumes(mesh)[:owned]
        found, nodes = np.empty(owned), mesh.geometry.dofmap
        self._loops.call("take_volumes", owned, nodes.shape[1], nodes, mesh.geometry.x, found)
        return found

    def _rows(self) -> SingleArray:
        """Zeros for all local vertices."""
        width = self._sums.block_size
        return np.zeros((len(self._sums.array) // width, width), dtype=np.float32)

    def _gathered(self, values: SingleArray) -> SingleArray:
        """Sums over the ranks of rows of the vertices."""
        if self._alone:
            return values
        self._sums.array[:] = values.ravel()
        self._sums.scatter_reverse(la.InsertMode.add)
        self._sums.scatter_forward()
        return np.array(self._sums.array).reshape(values.shape)

    def added(self, cells: IndexArray, tensors: FloatArray) -> SingleArray:
        """Rows of the vertices: means of tensors that are given as integrals over cells.

        They are times the mean volume of a cell.

        Args:
            cells: Owned cells, repeated or not, shape (n,).
            tensors: Shape (n, d, d).
        """
        rows = self._rows()
        around = self._vertices.reshape(-1, self._dim + 1)[cells]
        for column, (i, j) in enumerate(self._upper):
            shares = np.repeat(tensors[:, i, j], self._dim + 1)
            rows[:, column] = np.bincount(around.ravel(), shares, len(rows))
        return self._gathered(rows) * self._inverse

    def steps(self, rows: SingleArray, count: int) -> SingleArray:
        """Rows of the vertices after further steps."""
        for _ in range(count):
            sums = self._rows()
            where = (self._vertices, self._relative)
            self._loops.call("walk", len(self._volumes), *where, rows, sums)
            rows = self._gathered(sums)
            rows *= self._inverse
        return rows

    def thickness(self, density: SingleArray, metric: SingleArray) -> Thickness:
        """What follows for each cell from the means of its vertices. Not collective.

        Args:
            density: Of the boundary's n n, times the mean volume of a cell [m^2].
            metric: Of the edges' e e [m^2].
        """
        found = [np.empty(len(self._volumes)) for _ in range(3)]
        self._loops.call("at_cells", len(self._volumes), self._vertices, density, metric, *found)
        found[0] *= self._mean
        return Thickness(self._volumes, *found)
