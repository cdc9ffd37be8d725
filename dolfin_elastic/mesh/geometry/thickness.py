"""Thickness of a body around each of its cells, and the extent of cells across it and along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    cells_beside_facets,
    outward_normals,
)

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
    d, owned = mesh.topology.dim, mesh.topology.index_map(mesh.topology.dim).size_local
    volumes = cell_volumes(mesh)[:owned]
    facets = np.setdiff1d(boundary_facets(mesh), without)
    beside, _ = cells_beside_facets(mesh, facets)
    normals = outward_normals(mesh, facets)
    faces = np.zeros((owned, d, d))
    np.add.at(faces, beside, np.einsum("f,fi,fj->fij", facet_areas(mesh, facets), normals, normals))
    walk = _Walk(mesh, volumes)
    density = walk.steps(faces / volumes[:, None, None], _STEPS)
    values, directions = np.linalg.eigh(density)
    with np.errstate(divide="ignore"):
        thickness = np.where(values[:, -1] > 0, 2 / np.abs(values[:, -1]), np.inf)
    # Single cells of an irregular mesh are oblong at random; their neighbourhood is what bends.
    metric = walk.steps(_edges(cell_corners(mesh, np.arange(owned, dtype=np.int32))), 2)
    turned = directions.transpose(0, 2, 1) @ metric @ directions
    along = np.linalg.eigvalsh(turned[:, :-1, :-1])[:, -1]
    return Thickness(volumes, thickness, np.sqrt(turned[:, -1, -1]), np.sqrt(along))


def _edges(corners: FloatArray) -> FloatArray:
    """Mean over the edges e of simplices of e e, shape (n, d, d).

    The sum over the edges is d + 1 times that over the corners, taken from the barycentre.
    """
    arms = corners - corners.mean(axis=1, keepdims=True)
    return np.asarray(arms.transpose(0, 2, 1) @ arms) * (2 / (corners.shape[1] - 1))


class _Walk:
    """Means of tensors over the neighbourhood of cells. Steps are collective.

    Args:
        mesh: The mesh.
        volumes: Of the owned cells.
    """

    def __init__(self, mesh: Mesh, volumes: FloatArray) -> None:
        d = mesh.topology.dim
        self._map = mesh.topology.index_map(0)
        vertices = mesh.topology.connectivity(d, 0).array.reshape(-1, d + 1)[: len(volumes)]
        shape = (len(volumes), self._map.size_local + self._map.num_ghosts)
        start = np.arange(0, vertices.size + 1, d + 1)
        from scipy.sparse import csr_array

        self._mean = csr_array(
            (np.full(vertices.size, 1 / (d + 1)), vertices.ravel(), start), shape=shape
        )
        weights = csr_array((np.repeat(volumes, d + 1), vertices.ravel(), start), shape=shape)
        self._weights = weights.T.tocsr()
        # From vertices to vertices: a third of the numbers of both steps through the cells.
        self._between = self._weights @ self._mean
        around = self._gathered(self._weights @ np.ones((len(volumes), 1)))
        # A vertex without cells on any rank has no volume, and no cell asks for its mean.
        self._around = np.where(around > 0, around, 1.0)

    def _gathered(self, values: FloatArray) -> FloatArray:
        """Sums over the ranks of values at the vertices, shape (vertices, columns)."""
        sums = la.vector(self._map, values.shape[1])
        sums.array[:] = values.ravel()
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
        return np.array(sums.array).reshape(-1, values.shape[1])

    def steps(self, tensors: FloatArray, count: int) -> FloatArray:
        """The symmetric tensors of the cells, shape (n, d, d), after `count` steps."""
        d = tensors.shape[1]
        upper = np.triu_indices(d)
        values = tensors[:, upper[0], upper[1]]
        at_vertices = self._gathered(self._weights @ values) / self._around
        for _ in range(count - 1):
            at_vertices = self._gathered(self._between @ at_vertices) / self._around
        values = self._mean @ at_vertices
        found = np.empty_like(tensors)
        found[:, upper[0], upper[1]] = found[:, upper[1], upper[0]] = values
        return found
