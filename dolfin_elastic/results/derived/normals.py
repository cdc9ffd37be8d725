"""Outward normals of the body's surface at its nodes."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices

from dolfin_elastic.core.types import FloatArray


class NodalNormals:
    """Unit normals of the deformed surface at the nodes on it; zeros inside.  Collective.

    At a node it is the direction of the sum of the area vectors that its facets have there: on an
    edge of the body the mean of its faces' normals, by the areas of the facets beside it.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        mesh, tdim = V.mesh, V.mesh.topology.dim
        self._V, self._dim = V, tdim
        mesh.topology.create_connectivity(tdim - 1, tdim)
        mesh.topology.create_connectivity(tdim, tdim - 1)
        facets = exterior_facet_indices(mesh.topology)
        cell_of = mesh.topology.connectivity(tdim - 1, tdim)
        facets_of = mesh.topology.connectivity(tdim, tdim - 1)
        cells = [int(cell_of.links(facet)[0]) for facet in facets]
        local = [
            int(np.flatnonzero(facets_of.links(cell) == facet)[0])
            for cell, facet in zip(cells, facets, strict=True)
        ]
        element = V.element.basix_element
        closure = [np.asarray(element.entity_closure_dofs[tdim - 1][i]) for i in range(tdim + 1)]
        lists = V.dofmap.list
        width = len(closure[0])
        self._nodes = np.array(
            [lists[cell, closure[i]] for cell, i in zip(cells, local, strict=True)], dtype=np.int64
        ).reshape(-1, width)
        self._opposite = np.array(
            [lists[cell, i] for cell, i in zip(cells, local, strict=True)], dtype=np.int64
        )
        kind = basix.CellType.interval if tdim == 2 else basix.CellType.triangle
        facet = basix.create_element(
            basix.ElementFamily.P,
            kind,
            V.element.basix_element.degree,
            basix.LagrangeVariant.equispaced,
        )
        self._slopes = np.asarray(facet.tabulate(1, facet.points)[1:, :, :, 0])
        self._places = np.asarray(V.tabulate_dof_coordinates())

    def __call__(self, u: fem.Function) -> FloatArray:
        """Normals at the owned nodes, shape (nodes, 3).

        Args:
            u: The displacement [m], ghosts up to date.
        """
        dim = self._dim
        x = self._places.copy()
        x[:, :dim] += u.x.array.reshape(-1, dim)
        # Tangents at the nodes: the derivatives of the shape functions times the nodes' places.
        tangents = np.einsum("dpn,fni->dfpi", self._slopes, x[self._nodes])
        out_of_plane = np.broadcast_to([0.0, 0.0, 1.0], tangents[0].shape)
        areas = np.cross(tangents[0], tangents[1] if dim == 3 else out_of_plane)
        outward = x[self._nodes].mean(axis=1) - x[self._opposite]
        turned = np.einsum("fpi,fi->f", areas, outward) < 0
        areas[turned] *= -1.0
        work = la.vector(self._V.dofmap.index_map, 3)
        table = work.array.reshape(-1, 3)
        np.add.at(table, self._nodes, areas)
        work.scatter_reverse(la.InsertMode.add)
        own = table[: self._V.dofmap.index_map.size_local]
        lengths = np.linalg.norm(own, axis=1, keepdims=True)
        return np.asarray(own / np.where(lengths > 0, lengths, 1.0))
