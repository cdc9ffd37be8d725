"""`overlapping`: regions of a mesh of which one lies in another one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np
from dolfinx import geometry
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.types import FloatArray, IndexArray

_MOST = 1000
"""Elements of a rank whose middles are looked at, for each pair of regions."""


def overlapping(mesh: Mesh, regions: Mapping[str, IndexArray]) -> Iterator[tuple[str, str]]:
    """Pairs of regions where the middle of an element of one is in the other. Collective.

    Regions that touch, or overlap by less than half an element, are not found; of many elements
    some are looked at.

    Args:
        regions: Name to local cells.
    """
    nodes = mesh.geometry.x[mesh.geometry.dofmap]
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    own = {name: cells[: _owned(mesh, cells)] for name, cells in regions.items()}
    boxes = {name: _box(mesh.comm, low[cells], high[cells]) for name, cells in own.items()}
    for pair in combinations(own, 2):
        lower = np.maximum(*(boxes[name][0] for name in pair))
        upper = np.minimum(*(boxes[name][1] for name in pair))
        if (lower > upper).any():
            continue
        near = [
            cells[((high[cells] >= lower) & (low[cells] <= upper)).all(axis=1)]
            for cells in (own[name] for name in pair)
        ]
        first = _inside(mesh, near[0], nodes, near[1])
        found = _inside(mesh, near[1], nodes, near[0]) or first  # both: they are collective
        if mesh.comm.allreduce(found, op=MPI.LOR):
            yield pair


def _owned(mesh: Mesh, cells: IndexArray) -> int:
    return int(np.searchsorted(cells, mesh.topology.index_map(mesh.topology.dim).size_local))


def _box(comm: MPI.Comm, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates of cells on all ranks. Collective."""
    ends = np.concatenate([low.min(axis=0, initial=np.inf), -high.max(axis=0, initial=-np.inf)])
    every = np.empty_like(ends)
    comm.Allreduce(ends, every, op=MPI.MIN)
    return every[:3], -every[3:]


def _inside(mesh: Mesh, cells: IndexArray, nodes: FloatArray, others: IndexArray) -> bool:
    """Whether the middle of a cell of some rank is in another one of this rank. Collective."""
    some = cells[:: 1 + len(cells) // _MOST]
    middles = np.concatenate(mesh.comm.allgather(nodes[some].mean(axis=1)))
    if not len(others) or not len(middles):
        return False
    tree = geometry.bb_tree(mesh, mesh.topology.dim, entities=others)
    near = geometry.compute_collisions_points(tree, middles)
    return len(geometry.compute_colliding_cells(mesh, near, middles).array) > 0
