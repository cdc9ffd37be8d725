"""Reductions, exchange of rows, and errors that all ranks raise together so that none waits."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from typing import TypeVar, cast

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import ElasticError
from dolfin_elastic.core.together import end_all_at_exceptions
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray

A = TypeVar("A")
R = TypeVar("R")
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
    errors = comm.allgather(error)
    first = next((e for e in errors if e is not None), None)
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


def led(comm: MPI.Comm, lead: Callable[[Callable[[A], T]], R], together: Callable[[A], T]) -> R:
    """Rank 0 decides what all ranks compute next. Collective.

    For what decides by numbers that may differ from rank to rank in their last digit.

    Args:
        comm: The ranks that take part.
        lead: Called on rank 0 with a function that has all ranks call `together`; its result must
            be picklable.
        together: Collective; where it raises, it does so on all ranks.

    Returns:
        What `lead` returned, on every rank.

    Raises:
        Exception: What `lead` raised, on every rank.
    """
    if comm.rank:
        while True:
            ended, error, value = comm.bcast(None)
            if error is not None:
                raise error
            if ended:
                return cast(R, value)
            with suppress(ElasticError):  # rank 0 has it, too, and decides
                together(value)

    def ask(value: A) -> T:
        comm.bcast((False, None, value))
        return together(value)

    try:
        result = lead(ask)
    except Exception as error:
        comm.bcast((True, _sendable(error), None))
        raise
    comm.bcast((True, None, result))
    return result


def total(comm: MPI.Comm, value: T) -> T:
    """Sum over all ranks. Collective.

    Args:
        comm: The ranks.
        value: This rank's number, or array of the same shape on all ranks.
    """
    if comm.size == 1:  # pickling took a twentieth of a step of a small body in motion
        return copy(value)
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


def first_of(comm: MPI.Comm, local: Iterable[T]) -> T | None:
    """Least item of all ranks, None if there are none. Collective.

    Args:
        comm: The ranks.
        local: This rank's items, which can be compared and pickled.
    """
    own = min(local, default=None)  # type: ignore[type-var]
    return min((one for one in comm.allgather(own) if one is not None), default=None)


EQUAL = 1e-6
"""Difference of two numbers, over the largest one, below which round-off may decide which of them
is larger: iterative solvers agree no better on other ranks."""

_SAME_PLACE = 1e-9
"""The same of distances and coordinates, over the largest one: these differ by round-off only."""


@dataclass(frozen=True)
class LargestRow:
    """The largest number of all ranks.

    Attributes:
        value: The number.
        rank: Rank of its row.
        row: Its row there.
        place: Its place [m].
    """

    value: float
    rank: int
    row: int
    place: tuple[float, ...]


def first_row(comm: MPI.Comm, rows: int, rank: int | None = None) -> int:
    """The first of the rows of a rank, by default this one, of rows in equal parts. Not collective.

    Args:
        comm: The ranks among which they are divided, as DOLFINx does.
        rows: Of all ranks.
    """
    rank, (each, more) = comm.rank if rank is None else rank, divmod(rows, comm.size)
    return rank * each + min(rank, more)


def largest_row(
    comm: MPI.Comm,
    values: FloatArray,
    places: Callable[[IntArray], FloatArray],
    *,
    least: float = 0.0,
    about: float = 0.0,
) -> LargestRow | None:
    """The largest number, whose place is the same on any number of ranks. Collective.

    Of equal numbers that nearest to the origin is taken, and of equally near ones the first along
    x, then y, then z: which is larger by round-off does not matter.

    Args:
        comm: The ranks.
        values: This rank's numbers; what is -inf or nan does not count.
        places: Places [m] of some of its rows, shape (rows, dim).
        least: Absolute difference below which numbers are equal, beside the relative one.
        about: Number whose difference from the largest one the relative one is of.

    Returns:
        None where no number counts.
    """
    known = np.where(np.isnan(values), -np.inf, values)
    top = largest(comm, float(known.max(initial=-np.inf)))
    if top == -np.inf:
        return None
    near = max(EQUAL * abs(top - about), least) if np.isfinite(top) else 0.0
    rows = np.flatnonzero(known >= top - near if near else known == top)
    x = np.asarray(places(rows)) if len(rows) else np.empty((0, 1))
    local = None
    if len(rows):
        best = _nearest_to_origin(x)
        local = (tuple(float(a) for a in x[best]), comm.rank, int(rows[best]))
    every = [one for one in comm.allgather(local) if one is not None]
    place, rank, row = every[_nearest_to_origin(np.array([one[0] for one in every]))]
    return LargestRow(top, rank, row, place)


def _nearest_to_origin(x: FloatArray) -> int:
    """Row of the place nearest to the origin, of equally near ones the first along x, y, z."""
    kept = np.arange(len(x))
    size = float(np.abs(x).max(initial=0.0))
    for key in (np.linalg.norm(x, axis=1), *x.T):
        kept = kept[key[kept] <= key[kept].min() + _SAME_PLACE * size]
    return int(kept[0])


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
        result = self._exchange(np.ascontiguousarray(rows), self._received, self._sent)
        put = np.empty_like(result)
        put[self._order] = result
        return put

    def _exchange(self, rows: AnyArray, sent: IntArray, received: IntArray) -> AnyArray:
        columns = rows.shape[1]
        result = np.empty((int(received.sum()), columns), dtype=rows.dtype)
        given = [rows, (sent * columns).tolist()]
        self._comm.Alltoallv(given, [result, (received * columns).tolist()])
        return result
