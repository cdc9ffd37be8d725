"""Faults of a mesh that is read in shares by all ranks and never stands on one of them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.types import IntArray


def check_shares(comm: MPI.Comm, cells: IntArray, points: int, dim: int) -> None:
    """Refuses what would end DOLFINx's mesh creation in C++.

    Collective.

    Args:
        comm: The ranks that read.
        cells: This rank's share of the cells (global points, vertices first).
        points: Number of points in this rank's share.
        dim: 2 or 3.

    Raises:
        MeshError: Points that do not exist, cells that stand twice, or facets between three cells.
    """
    agree(comm, _out_of_range(cells, int(total(comm, points))))
    corners = np.sort(cells[:, : dim + 1], axis=1)
    collapsed = int(total(comm, int((corners[:, 1:] == corners[:, :-1]).any(axis=1).sum())))
    if collapsed:
        raise MeshError(f"{collapsed} cells use the same point twice", expected="remesh")
    twice = int(total(comm, _repeated(comm, corners, 1)))
    if twice:
        raise MeshError(f"{twice} cells stand twice", expected="save each cell once")
    facets = np.concatenate([np.delete(corners, i, axis=1) for i in range(dim + 1)])
    branching = int(total(comm, _repeated(comm, facets, 2)))
    if branching:
        raise MeshError(
            f"{branching} facets lie between three or more cells: the mesh overlaps itself",
            expected="remesh",
        )


def _out_of_range(cells: IntArray, points: int) -> MeshError | None:
    bad = cells[(cells < 0) | (cells >= points)]
    if len(bad) == 0:
        return None
    return MeshError(f"elements refer to the point {bad[0]}, but there are {points} points")


def _repeated(comm: MPI.Comm, rows: IntArray, most: int) -> int:
    """How many rows, among those this rank is told to look at, stand more than `most` times.

    Collective.  Equal rows are sent to the same rank.
    """
    target = rows.sum(axis=1) % comm.size
    parts = comm.alltoall([rows[target == rank] for rank in range(comm.size)])
    _, counts = np.unique(np.concatenate(parts), axis=0, return_counts=True)
    return int(np.count_nonzero(counts > most))
