"""Thickness of a body around each of its cells, and the extent of cells across it and along it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from dolfinx import la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.jit import compile_c, options
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, SingleArray
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    facet_normals,
)

_STEPS = 40
"""Steps of the random walk: it goes about 2.5 cells far, and sees walls of up to seven cells."""

_ROUNDED = 1e-4
"""Share of what the walk starts with that may be amiss after its last step."""


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
    walk = _Walk(mesh)
    # Single cells of an irregular mesh are oblong at random; their neighbourhood is what bends.
    return walk.thickness(walk.far(walk.added(beside, _faces(mesh, facets))), walk.step(walk.edges))


def _faces(mesh: Mesh, facets: IndexArray) -> FloatArray:
    """Integrals of n n over local facets [m^2], shape (n, d, d), n the normal of their corners."""
    normals = facet_normals(mesh, facets)
    area = np.linalg.norm(normals, axis=1)
    weights = area if mesh.geometry.cmap.degree == 1 else facet_areas(mesh, facets)
    weights = weights / np.where(area > 0, area, 1.0) ** 2
    return np.asarray(np.einsum("f,fi,fj->fij", weights, normals, normals))


class _Walk:
    """Means of tensors over the neighbourhood of cells. Steps are collective.

    Attributes:
        edges: Mean over the edges e of the cells around each vertex of e e [m^2]; arrays of
            vertices have a row for each local one, with the upper triangle of a tensor.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._dim, comm = mesh.topology.dim, mesh.comm
        mesh.topology.create_connectivity(self._dim, 0)
        self._loops = compile_c(comm, "thickness.c", {"DIM": self._dim}, options(comm))
        index_map, width = mesh.topology.index_map(0), 8 if self._dim == 3 else 4
        self._shape = index_map.size_local + index_map.num_ghosts, width
        self._sums = {
            kind: None if comm.size == 1 else la.vector(index_map, width, dtype=kind)
            for kind in (np.float64, np.float32)
        }
        self._vertices = mesh.topology.connectivity(self._dim, 0).array
        self._upper = [(i, j) for j in range(self._dim) for i in range(j + 1)]
        self._volumes = self._volumes_of(mesh)
        count, volume = total(comm, np.array([len(self._volumes), self._volumes.sum()]))
        mean = float(volume) / float(count) if volume > 0 else 1.0
        # Relative to their mean, and areas to its power, they suit single precision in any unit.
        self._length = mean ** (1 / self._dim)
        self._relative_volumes = volumes = self._volumes / mean
        nodes, sums = mesh.geometry.dofmap, self._rows(np.float64)
        where = (nodes.shape[1], nodes, len(mesh.geometry.x), mesh.geometry.x, self._vertices)
        self._loops.call("add_cells", len(volumes), *where, volumes, len(sums), sums)
        sums = self._gathered(sums)
        around = sums[:, len(self._upper)]
        # A vertex without cells on any rank has no volume, and no cell asks for its mean.
        self._inverse: FloatArray = 1 / np.where(around > 0, around, 1.0)[:, None]
        self.edges: FloatArray = sums * self._inverse

    def _volumes_of(self, mesh: Mesh) -> FloatArray:
        """Volumes of the owned cells; of straight ones by the loop: a tenth of the time."""
        owned = mesh.topology.index_map(self._dim).size_local
        if mesh.geometry.cmap.degree > 1:
            return cell_volumes(mesh)[:owned]
        result, nodes, x = np.empty(owned), mesh.geometry.dofmap, mesh.geometry.x
        self._loops.call("take_volumes", owned, nodes.shape[1], nodes, len(x), x, result)
        return result

    def _rows(self, kind: type[np.float64 | np.float32]) -> AnyArray:
        """Zeros for all local vertices, of some precision, until the next ones of it."""
        sums = self._sums[kind]
        if sums is None:
            return np.zeros(self._shape, dtype=kind)
        sums.array[:] = 0
        return np.asarray(sums.array).reshape(self._shape)

    def _gathered(self, rows: AnyArray) -> AnyArray:
        """The last `_rows`, summed over the ranks."""
        sums = self._sums[rows.dtype.type]
        if sums is not None:
            sums.scatter_reverse(la.InsertMode.add)
            sums.scatter_forward()
        return rows

    def added(self, cells: IndexArray, tensors: FloatArray) -> FloatArray:
        """Rows of the vertices: tensors that are given as integrals over cells, by volume.

        The volume is one relative to the mean of all cells.

        Args:
            cells: Owned cells, repeated or not, shape (n,).
            tensors: Shape (n, d, d).
        """
        rows = self._rows(np.float64)
        around = self._vertices.reshape(-1, self._dim + 1)[cells]
        for column, (i, j) in enumerate(self._upper):
            shares = np.repeat(tensors[:, i, j], self._dim + 1)
            rows[:, column] = np.bincount(around.ravel(), shares, len(rows))
        return np.asarray(self._gathered(rows) * self._inverse)

    def step(self, rows: FloatArray) -> FloatArray:
        """Rows of the vertices after a further step."""
        sums = self._rows(np.float64)
        where = (self._vertices, self._relative_volumes)
        self._loops.call("step", len(self._volumes), *where, len(rows), rows, sums)
        return np.asarray(self._gathered(sums) * self._inverse)

    def far(self, rows: FloatArray) -> SingleArray:
        """Rows of the vertices after the rest of the steps, in single precision and without unit.

        The step is D^-1 B W B^T with positive diagonals D and W, and keeps constants: its
        eigenvalues are in [0, 1], where a polynomial of much lower degree serves for its power.
        """
        inverse, where = self._inverse.astype(np.float32), (self._vertices, self._relative_volumes)

        def stepped(rows: SingleArray) -> SingleArray:
            sums = self._rows(np.float32)
            self._loops.call("rounded_step", len(self._volumes), *where, len(rows), rows, sums)
            return np.asarray(self._gathered(sums))

        weights = _power(_STEPS - 1)
        before = (rows / self._length ** (self._dim - 1)).astype(np.float32)
        now = 2 * stepped(before) * inverse - before  # Chebyshev polynomials of 2 x - 1
        result = weights[0] * before + weights[1] * now
        for degree in range(2, len(weights)):
            sums = stepped(now)
            last = (inverse, sums, degree, weights, before, now, result)
            self._loops.call("next_polynomial", len(inverse), *last)
        return result

    def thickness(self, density: SingleArray, metric: FloatArray) -> Thickness:
        """What follows for each cell from the means of its vertices. Not collective.

        Args:
            density: Of the boundary's n n by relative volume, as `far` has it.
            metric: Of the edges' e e [m^2].
        """
        result = [np.empty(len(self._volumes)) for _ in range(3)]
        means = (len(density), density, metric)
        self._loops.call("at_cells", len(self._volumes), self._vertices, *means, *result)
        result[0] *= self._length
        return Thickness(self._volumes, *result)


def _power(n: int) -> SingleArray:
    """Weights of Chebyshev polynomials of 2 x - 1 whose sum is x^n in [0, 1], but for `_ROUNDED`.

    x = cos^2 a, and cos^2n a = sum over k of C(2 n, n - k) cos(2 k a) / 4^n from -n to n: as of a
    random walk of 2 n steps, those beyond a few sqrt(n) are small.  Constants are kept.
    Source: D. J. Newman and T. J. Rivlin, Aequationes Mathematicae 14 (1976) 451.

    Args:
        n: At least 1.
    """
    weights = [math.comb(2 * n, n - k) * (2 if k else 1) / 4**n for k in range(n + 1)]
    left = np.cumsum(weights[::-1])[::-1]
    kept = np.array(weights)[left > _ROUNDED]
    return np.asarray(kept / kept.sum(), dtype=np.float32)
