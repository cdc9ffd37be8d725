"""Symmetry of the load stiffness: where a pressure that follows its surface has a potential.

For a uniform pressure p the skew part of the load stiffness is the integral of p (v x du) . dx
along the boundary of the deformed surface (in a plane: p v x du at its end points).  An edge of
that boundary contributes nothing where virtual displacements have one direction only, or where they
stay in the plane in which the edge lies.

Source: Schweizerhof & Ramm, Displacement dependent pressure loads in nonlinear finite element
analyses, Computers & Structures 18 (1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.model.amplitude import RAMP
from dolfin_elastic.problem.constraints.rows import Constraints

_MOMENTS = (0.3141, 0.8314)
"""Load parameters at which prescribed values are compared."""


def follower_pressure_has_potential(
    body: Body, constraints: Constraints, surfaces: Sequence[str]
) -> bool:
    """Whether supports fix a surface's edge so that uniform pressure has a potential. Collective.

    Args:
        surfaces: Names of the surfaces that together are loaded.
    """
    edges = boundary_edges(body, surfaces)
    supports = _Supports(body, constraints)
    free = sum(not supports.make_symmetric(edge) for edge in edges)
    return not total(body.comm, int(free))


def boundary_edges(body: Body, surfaces: Sequence[str]) -> IndexArray:
    """Owned edges (in a plane: points) that belong to one facet of a surface only. Collective."""
    topology, dim = body.mesh.topology, body.dim
    topology.create_entities(dim - 2)
    topology.create_connectivity(dim - 1, dim - 2)
    edges_of = topology.connectivity(dim - 1, dim - 2)
    index_map = topology.index_map(dim - 2)
    facets = np.unique(np.concatenate([body.owned_facets(name) for name in surfaces]))
    edges = edges_of.array.reshape(-1, dim)[facets]  # a simplex has dim facets
    count = summed(index_map, edges, np.ones((1, 1)))  # ranks share edges, but no facet twice
    return np.flatnonzero(count[: index_map.size_local, 0] == 1.0).astype(np.int32)


@dataclass
class _Supports:
    """The constraints that supports put on edges. Collective to make."""

    body: Body
    constraints: Constraints

    def __post_init__(self) -> None:
        mesh, dim = self.body.mesh, self.body.dim
        V = self.constraints.values.function_space
        mesh.topology.create_connectivity(dim - 2, dim)
        mesh.topology.create_connectivity(dim, dim - 2)
        self._cells = mesh.topology.connectivity(dim - 2, dim)
        self._edges = mesh.topology.connectivity(dim, dim - 2)
        self._dofmap, self._nodes = V.dofmap, mesh.geometry.dofmap
        self._layout = mesh.geometry.cmap.create_dof_layout()
        self._tolerance = 1e-9 * span(self.body)
        entries = np.zeros(len(self.constraints.values.x.array), dtype=bool)
        entries[self.constraints.dofs] = True
        self._fixed = entries.reshape(-1, dim)
        values = self.constraints.values_at(_MOMENTS, RAMP)
        self._values = [value.reshape(-1, dim) for value in values]

    def make_symmetric(self, edge: int) -> bool:
        """The skew part of the tangent vanishes along an edge. Not collective."""
        dim = self.body.dim
        cell = self._cells.links(edge)[0]
        local = int(np.flatnonzero(self._edges.links(cell) == edge)[0])
        points = self._dofmap.cell_dofs(cell)[
            self._dofmap.dof_layout.entity_closure_dofs(dim - 2, local)
        ]
        fixed = self._fixed[points].all(axis=0)
        if np.count_nonzero(fixed) >= dim - 1:
            return True
        nodes = self._nodes[cell][self._layout.entity_closure_dofs(dim - 2, local)]
        return any(self._in_plane(axis, nodes, points) for axis in np.flatnonzero(fixed))

    def _in_plane(self, axis: int, nodes: IndexArray, points: IndexArray) -> bool:
        """The edge lies in a plane normal to the axis, at all prescribed values."""
        coordinates = [self.body.mesh.geometry.x[nodes, axis]]
        coordinates += [values[points, axis] for values in self._values]
        return all(np.ptp(place) <= self._tolerance for place in coordinates)
