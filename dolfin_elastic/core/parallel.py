"""Acting together: no rank may fail alone and leave the others waiting."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterable
from typing import TypeVar, cast

from mpi4py import MPI

T = TypeVar("T")

# Every rank logs the same: rank 0 says it for all.
logging.getLogger("dolfin_elastic").addFilter(lambda record: MPI.COMM_WORLD.rank == 0)


def agree(comm: MPI.Comm, error: Exception | None) -> None:
    """Raises on every rank what any rank has found wrong.

    Collective.

    Args:
        comm: The ranks that agree.
        error: What this rank found, or None.

    Raises:
        Exception: The error of the lowest rank that has one.
    """
    error = _sendable(error)
    found = comm.allgather(error)
    first = next((e for e in found if e is not None), None)
    if first is not None:
        raise error if error is first else first


def _sendable(error: Exception | None) -> Exception | None:
    """The error, or its text where it cannot travel: a rank that cannot send leaves all waiting."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever pickling a foreign error raises
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Does something on rank 0 only and gives every rank the result or the error.

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
    """The sum of a number or array over all ranks. Collective."""
    return comm.allreduce(value, op=MPI.SUM)


def largest(comm: MPI.Comm, value: float) -> float:
    """The largest value of all ranks. Collective."""
    return float(comm.allreduce(value, op=MPI.MAX))


def smallest(comm: MPI.Comm, value: float) -> float:
    """The smallest value of all ranks. Collective."""
    return float(comm.allreduce(value, op=MPI.MIN))


def first_of(comm: MPI.Comm, mine: Iterable[T]) -> T | None:
    """The least of all ranks' things that can be compared, None without any. Collective."""
    own = min(mine, default=None)  # type: ignore[type-var]
    return min((one for one in comm.allgather(own) if one is not None), default=None)
