"""Reductions, exchange of rows, and errors that all ranks raise together so that none waits."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterable
from typing import TypeVar, cast

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.together import end_all_at_exceptions
from dolfin_elastic.core.types import AnyArray, IntArray

T = TypeVar("T")

if MPI.COMM_WORLD.size > 1:
    end_all_at_exceptions()

# Every rank logs the same messages: only those of rank 0 are shown, and those of one rank alone.
logging.getLogger("dolfin_elastic").addFilter(
    lambda record: MPI.COMM_WORLD.rank == 0 or hasattr(record, "every_rank")
)


def agree(comm: MPI.Comm, error: Exception | None) -> None:
    """Raises an error on every rank if any rank has one.

    Collective.

    Args:
        comm: The ranks that take part.
        error: The error of this rank, or None.

    Raises:
        Exception: The error of the lowest rank that has one.
    """
    error = _sendable(error)
    found = comm.allgather(error)
    first = next((e for e in found if e is not None), None)
    if first is not None:
        raise error if error is first else first


def _sendable(error: Exception | None) -> Exception | None:
    """The error, or its text if it cannot be pickled: sending it would fail on this rank alone."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever pickling a foreign error raises
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Calls a function on rank 0 and gives every rank its result or its error.

    Collective.

    Args:
        comm: The ranks that take part.
        action: Called on rank 0; its result must be picklable.

    Returns:
        What `action` returned.

    Raises:
        Exception: What `action` raised, on every rank.
    """
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as caught:  # re-raised on all ranks just below
            error = _sendable(caught)
    error, result = comm.bcast((error, result))
    if error is not None:
        raise error
    return cast(T, result)


def total(comm: MPI.Comm, value: T) -> T:
    """Sum over all ranks. Collective.

    Args:
        comm: The ranks.
        value: This rank's number, or array of the same shape on all ranks.
    """
    return comm.allreduce(value, op=MPI.SUM)


def largest(comm: MPI.Comm, value: float) -> float:
    """Largest number of all ranks. Collective.

    Args:
        comm: The ranks.
        value: This rank's number.
    """
    return float(comm.allreduce(value, op=MPI.MAX))


def smallest(comm: MPI.Comm, value: float) -> float:
    """Smallest number of all ranks. Collective.

    Args:
        comm: The ranks.
        value: This rank's number.
    """
    return float(comm.allreduce(value, op=MPI.MIN))


def first_of(comm: MPI.Comm, mine: Iterable[T]) -> T | None:
    """Least item of all ranks, None if there are none. Collective.

    Args:
        comm: The ranks.
        mine: This rank's items, which can be compared and pickled.
    """
    own = min(mine, default=None)  # type: ignore[type-var]
    return min((one for one in comm.allgather(own) if one is not None), default=None)


class RankExchange:
    """Sends rows of an array to other ranks, and rows back. All of it is collective.

    Args:
        comm: The ranks.
        to: Destination rank of each of this rank's rows, shape (rows,).
    """

    def __init__(self, comm: MPI.Comm, to: AnyArray) -> None:
        self._comm = comm
        self._order = np.argsort(to, kind="stable")
        self._sent = np.bincount(to, minlength=comm.size).astype(np.int64)
        self._received = np.empty_like(self._sent)
        comm.Alltoall(self._sent, self._received)

    @property
    def received(self) -> int:
        """Number of rows that this rank receives."""
        return int(self._received.sum())

    def send(self, rows: AnyArray) -> AnyArray:
        """The rows that this rank receives, in the order of their ranks. Collective."""
        return self._exchange(np.ascontiguousarray(rows[self._order]), self._sent, self._received)

    def send_back(self, rows: AnyArray) -> AnyArray:
        """Sends received rows back, into their order before `send`. Collective."""
        found = self._exchange(np.ascontiguousarray(rows), self._received, self._sent)
        put = np.empty_like(found)
        put[self._order] = found
        return put

    def _exchange(self, rows: AnyArray, sent: IntArray, received: IntArray) -> AnyArray:
        columns = rows.shape[1]
        found = np.empty((int(received.sum()), columns), dtype=rows.dtype)
        given = [rows, (sent * columns).tolist()]
        self._comm.Alltoallv(given, [found, (received * columns).tolist()])
        return found
