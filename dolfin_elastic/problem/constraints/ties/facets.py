"""The facets of both sides of a tie or contact, brought to the ranks that integrate over them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, prepare_facets

_REVERSED = {2: [1, 0, 2], 3: [1, 0, 2, 4, 3, 5]}
"""Nodes of a facet that is seen from its other side."""


@dataclass(frozen=True)
class Facets:
    """Facets of a surface.

    Attributes:
        x: Places of their geometry nodes [m], shape (facets, nodes, dim): vertices, so ordered
            that the normal points outward, then midside nodes of curved ones.
        nodes: Global nodes of the displacement's space, shape (facets, nodes).
    """

    x: FloatArray
    nodes: IntArray

    def __getitem__(self, which: BoolArray | IntArray) -> Facets:
        return Facets(self.x[which], self.nodes[which])


def owned(body: Body, V: fem.FunctionSpace, names: Iterable[str]) -> Facets:
    """The facets of surfaces that this rank owns. Collective.

    Raises:
        MeshError: There is no such surface.
    """
    mesh, d = body.mesh, body.dim
    prepare_facets(mesh)
    facets = np.unique(np.concatenate([body.owned_facets(name) for name in names]))
    cells, local = cells_beside_facets(mesh, facets.astype(np.int32))
    layouts = mesh.geometry.cmap.create_dof_layout(), V.dofmap.dof_layout
    geometry, space = (
        np.array([layout.entity_closure_dofs(d - 1, i) for i in range(d + 1)], dtype=np.int64)
        for layout in layouts
    )
    places = mesh.geometry.dofmap[cells[:, None], geometry[local]]
    nodes = V.dofmap.list[cells[:, None], space[local]]
    corners = mesh.geometry.x[places[:, :d]][:, :, :d]
    inside = mesh.geometry.x[mesh.geometry.dofmap[cells, local], None, :d]
    edges = np.concatenate([corners[:, 1:], inside], axis=1) - corners[:, :1]
    inward = np.linalg.det(edges) * (-1) ** d < 0
    for table in (places, nodes):
        table[inward] = table[inward][:, _REVERSED[d][: table.shape[1]]]
    numbers = V.dofmap.index_map.local_to_global(nodes.astype(np.int32).ravel())
    return Facets(mesh.geometry.x[places][:, :, :d], np.asarray(numbers).reshape(nodes.shape))


def opposite(comm: MPI.Comm, near: Facets, far: Facets, margin: float) -> Facets:
    """The facets of all ranks that may lie opposite this rank's. Collective.

    Each rank sends what lies in the bounding box of another's; nothing is gathered.

    Args:
        comm: The ranks.
        near: This rank's facets of one surface.
        margin: By which the boxes are widened [m].
    """
    d = near.x.shape[2]
    low = near.x.min(axis=(0, 1), initial=np.inf) - margin
    high = near.x.max(axis=(0, 1), initial=-np.inf) + margin
    if not len(near.x):
        low, high = np.full(d, np.inf), np.full(d, -np.inf)
    boxes = comm.allgather((low, high))
    parts = []
    for lowest, highest in boxes:
        inside = np.all((far.x.max(axis=1) >= lowest) & (far.x.min(axis=1) <= highest), axis=1)
        parts.append((far.x[inside], far.nodes[inside]))
    result = comm.alltoall(parts)
    return Facets(np.concatenate([x for x, _ in result]), np.concatenate([n for _, n in result]))


def areas(facets: Facets, *, axisymmetric: bool = False) -> FloatArray:
    """Areas of facets, of curved ones those between their vertices [m^(d-1)].

    Args:
        axisymmetric: Areas are those of rings about the axis, per radian.
    """
    d = facets.x.shape[2]
    sides = facets.x[:, 1:d] - facets.x[:, :1]
    squares = np.linalg.det(np.einsum("nic,njc->nij", sides, sides))
    radii = facets.x[:, :d, 0].mean(axis=1) if axisymmetric else 1.0
    return np.asarray(radii * np.sqrt(np.abs(squares)) / (d - 1))


def longest_edge(comm: MPI.Comm, *surfaces: Facets) -> float:
    """Longest edge of all facets of all ranks [m]. Collective.

    Args:
        comm: The ranks.
    """
    longest = 0.0
    for facets in surfaces:
        corners = facets.x[:, : facets.x.shape[2]]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        longest = max(longest, float(sides.max(initial=0.0)))
    return largest(comm, longest)
