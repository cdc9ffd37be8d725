"""Parts of the ranks of a session as communicators of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

WORLD = MPI.COMM_WORLD
SIZES = sorted({1, min(2, WORLD.size), WORLD.size})


def on_ranks(count: int, action: Callable[[MPI.Comm], Any]) -> Any:
    """What the first so many ranks find together, on every rank."""
    part = WORLD.Split(0 if WORLD.rank < count else 1)
    found = action(part) if WORLD.rank < count else None
    part.Free()
    return WORLD.bcast(found)
