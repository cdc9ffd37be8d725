"""Cells dealt out to the ranks without order, so that nearly all nodes are shared.

What one rank does not hear from the others is then missed: all must be as on one rank.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.ranks import SIZES, on_ranks
from mpi4py import MPI

from dolfin_elastic.core.compat import adjacency
from dolfin_elastic.mesh import distribute, generate


def _ranks_of(_: MPI.Comm, parts: int, kinds: Any, cells: Any) -> object:
    """The rank of a cell follows from the sum of its corners' numbers."""
    count = {2: 3, 3: 4}[_dimension(kinds)]
    corners = np.asarray(cells[0]).reshape(-1, count)
    return adjacency(((corners.sum(axis=1) * 7 // 3) % parts).astype(np.int32)[:, None])


def _dimension(kinds: Any) -> int:
    return 2 if "triangle" in str(kinds[0]) else 3


def deal_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes, and meshes of plain arrays, are so divided."""
    monkeypatch.setattr(
        generate, "_partitioner", lambda comm, _: None if comm.size == 1 else _ranks_of
    )
    monkeypatch.setattr(distribute, "cell_partitioner", lambda _: _ranks_of)


def rows_at(comm: MPI.Comm, x: Any, values: Any) -> Any:
    """Places and values of all ranks, in the order of the places."""
    table = np.column_stack([np.round(x, 9) + 0.0, np.asarray(values, dtype=float)])
    table = np.concatenate(comm.allgather(table))
    return table[np.lexsort(table[:, 2::-1].T)]


def same_on_any_ranks(found: Callable[[MPI.Comm], Any], **tolerance: float) -> None:
    """Compares with one rank."""
    alone = on_ranks(1, found)
    assert np.size(alone) > 0
    for count in SIZES[1:]:
        np.testing.assert_allclose(
            on_ranks(count, found), alone, **{"rtol": 1e-9, "atol": 1e-12, **tolerance}
        )
