"""Ranks that a user's Python drives: an exception on one of them ends all, with its traceback.

The others would wait for it for ever, in the next collective call of a solver, and a solver that is
closed on one rank alone would wait for them.  And Ctrl-C amid a loop over states.
"""

from __future__ import annotations

import atexit
import gc
import math
import sys
import time
import traceback
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, nullcontext
from types import FrameType, TracebackType
from typing import TypeVar

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import ElasticError, StoppedError
from dolfin_elastic.core.signals import PythonStop

T = TypeVar("T")

PATIENCE = 4.0
"""Seconds for all ranks to arrive with an exception that all of them have."""

_GOES_ON, _LEAVES, _FAILS = 0, 1, 2


def loop_together(comm: MPI.Comm, states: Generator[T, None, None]) -> Generator[T, None, None]:
    """A generator of states whose loop all ranks leave together.  Collective.

    An exception on one rank in the body of the loop ends all ranks, with its traceback, before any
    of the solver's objects is freed, for which the others would be waited for.  Ctrl-C ends what
    is being solved on all ranks together, and then raises KeyboardInterrupt; in the body of the
    loop it does so at once.  Loops inside another one leave all that to the outermost.

    Args:
        comm: The ranks of the loop.

    Raises:
        RuntimeError: A rank has left the loop alone.
        KeyboardInterrupt: The user has asked for the end.
    """
    if _computing:
        yield from states
        return
    stop = PythonStop.where_nobody_listens(comm)
    with closing(states):
        for state in _computed(comm, states, stop):
            try:
                with _inside(comm):
                    yield state
            except GeneratorExit:
                _leave_together(comm)
                raise
            _go_on_together(comm)


_bodies: list[MPI.Comm] = []
"""Ranks of the loops in whose body this one is, or was when it left it and kept the generator."""


@contextmanager
def _inside(comm: MPI.Comm) -> Iterator[None]:
    """The body of a loop over states.  Not collective.

    Args:
        comm: The ranks of the loop.
    """
    atexit.unregister(_leave_at_exit)
    atexit.register(_leave_at_exit)  # the last one is called first: before PETSc waits for all
    _bodies.append(comm)
    try:
        yield
    finally:
        _bodies.remove(comm)


def _leave_at_exit() -> None:
    """Ends all ranks where this one ends in the body of a loop, as by sys.exit, and others do not.

    `sys.excepthook` does not hear of that, and PETSc and MPI would wait for the others.
    """
    for comm in reversed(_bodies):
        if comm.size > 1 and not MPI.Is_finalized() and _ask(comm, _LEAVES) != (_LEAVES, _LEAVES):
            sys.stderr.write(f"rank {comm.rank} has ended in a loop over states, others have not\n")
            sys.stderr.flush()
            MPI.COMM_WORLD.Abort(1)


_computing: list[object] = []
"""Loops over states whose next state is being computed."""


def _computed(
    comm: MPI.Comm, states: Generator[T, None, None], stop: PythonStop | None
) -> Iterator[T]:
    """The states that are for the body of the loop. Collective.

    Args:
        comm: The ranks of the loop.
    """
    nothing = object()
    while True:
        _computing.append(states)
        try:
            with nullcontext() if stop is None else stop.listening():
                state = next(states, nothing)
        except StoppedError:
            if stop is None:
                raise
            raise KeyboardInterrupt from None
        finally:
            _computing.remove(states)
        if state is not nothing and (stop is None or not getattr(state, "between", False)):
            yield state  # type: ignore[misc]  # what is between is for commands
        if stop is not None and stop.agreed(comm):  # the solver has not heard it
            raise KeyboardInterrupt
        if state is nothing:
            return


def _go_on_together(comm: MPI.Comm) -> None:
    """Lets a loop over states go on, if all ranks do. Collective, with `_leave_together`."""
    if comm.size > 1:
        _raise_if_different(_ask(comm, _GOES_ON), _GOES_ON)


def _leave_together(comm: MPI.Comm) -> None:
    """Lets all ranks leave a loop over states. Called where its generator is closed.

    Collective, with `_go_on_together`.  It waits for ranks that are late, but not where this one
    leaves the loop by an exception and the others do not: then it ends all of them.
    """
    if comm.size == 1:
        return
    fault = _leaving_by()
    if fault is None:
        _raise_if_different(_ask(comm, _LEAVES), _LEAVES)
    elif _ask(comm, _FAILS, PATIENCE) != (_FAILS, _FAILS):
        traceback.print_exception(fault)
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)


def _ask(comm: MPI.Comm, local: int, patience: float = math.inf) -> tuple[int, int] | None:
    """Least and largest answer of all ranks; None if they do not all answer in time [s]."""
    sent, got = np.array([local, -local]), np.zeros(2, dtype=int)
    request = comm.Iallreduce(sent, got, op=MPI.MAX)
    if not _ends(request, patience):
        return None
    return -int(got[1]), int(got[0])


def _ends(request: MPI.Request, patience: float) -> bool:
    if patience == math.inf:
        request.Wait()
        return True
    until = time.monotonic() + patience
    while time.monotonic() < until:
        if request.Test():
            return True
        time.sleep(0.01)
    return False


def _raise_if_different(answers: tuple[int, int] | None, local: int) -> None:
    if answers is not None and answers[1] == _FAILS:
        time.sleep(PATIENCE)  # the rank that fails shows why, and ends this one
    if answers != (local, local):
        raise RuntimeError(
            "another rank has left the loop over the states: all ranks must leave it together"
        )


def _leaving_by() -> BaseException | None:
    """The exception because of which the generator is dropped that is being closed; or None.

    `close` in a with or finally block has it as the context of its GeneratorExit.  A generator
    that only a loop refers to is closed as the loop is unwound, where Python hides the exception:
    then there is one whose traceback has the loop's frame, at its present instruction.
    """
    cause = sys.exception()
    while isinstance(cause, GeneratorExit):  # also of generators that loop over this one
        cause = cause.__context__
    if cause is not None:
        return cause
    frame: FrameType | None = sys._getframe()
    places = set()
    while frame is not None:
        places.add((id(frame), frame.f_lasti))
        frame = frame.f_back
    for one in gc.get_objects():
        if isinstance(one, BaseException) and not isinstance(one, GeneratorExit):
            trace = one.__traceback__
            while trace is not None:
                if (id(trace.tb_frame), trace.tb_lasti) in places:
                    return one
                trace = trace.tb_next
    return None


def all_ranks_arrive(comm: MPI.Comm, patience: float = PATIENCE) -> bool:
    """Whether all ranks arrive here in time. Collective, if they do.

    Args:
        comm: All ranks.
        patience: How long to wait [s].
    """
    return _ends(comm.Ibarrier(), patience)


def end_all_if_alone(comm: MPI.Comm) -> None:
    """Prints the exception being handled and ends all ranks, unless all have one.

    Args:
        comm: The ranks that may have it.
    """
    if comm.size > 1 and not all_ranks_arrive(comm):
        traceback.print_exc()
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)


@contextmanager
def failing_together(comm: MPI.Comm) -> Iterator[None]:
    """Ends all ranks by an exception inside that this one has alone.

    To be left before what all ranks free together.  Errors of this package are the same on all.

    Args:
        comm: The ranks that work together.
    """
    try:
        yield
    except (ElasticError, GeneratorExit):
        raise
    except BaseException:
        end_all_if_alone(comm)
        raise


class _Hook:
    """Shows an exception that nobody has caught, and ends all ranks unless all have one."""

    def __init__(self) -> None:
        self._shown_before = sys.excepthook

    def __call__(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        """See `sys.excepthook`."""
        self._shown_before(kind, error, trace)
        sys.stderr.flush()
        if not MPI.Is_finalized() and not all_ranks_arrive(MPI.COMM_WORLD):
            MPI.COMM_WORLD.Abort(1)


def end_all_at_exceptions() -> None:
    """Makes an exception that nobody catches on one rank end all of them."""
    if not isinstance(sys.excepthook, _Hook):
        sys.excepthook = _Hook()
