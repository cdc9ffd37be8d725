"""Where the time of a run goes: seconds per stage, and the same stages in PETSc's log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar

STAGES = ("mesh", "compile", "assemble", "solve", "output")


class Stopwatch:
    """Seconds per stage.  Time in a stage inside another counts for the inner one only."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.seconds: dict[str, float] = dict.fromkeys(STAGES, 0.0)
        self._inner: list[float] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the time spent inside to a stage."""
        begin = time.perf_counter()
        self._inner.append(0.0)
        try:
            yield
        finally:
            spent = time.perf_counter() - begin
            self.add(name, spent, inner=self._inner.pop())

    def add(self, name: str, seconds: float, *, inner: float = 0.0) -> None:
        """Adds time to a stage.

        Args:
            name: The stage, one of `STAGES` or a new one.
            inner: Part of this time that stages inside it have counted already.
        """
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds - inner
        if self._inner:
            self._inner[-1] += seconds

    def totals(self) -> dict[str, float]:
        """Seconds per stage on this rank, and "total" since the watch was made."""
        return {**self.seconds, "total": time.perf_counter() - self.start}


_watch: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


@contextmanager
def timed() -> Iterator[Stopwatch]:
    """Measures everything inside with a fresh watch."""
    watch = Stopwatch()
    token = _watch.set(watch)
    try:
        yield watch
    finally:
        _watch.reset(token)


def begin() -> Stopwatch:
    """Starts a fresh watch for the rest of this context, for example a whole run."""
    watch = Stopwatch()
    _watch.set(watch)
    return watch


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Adds the time spent inside to a stage of the current watch, if there is one, and of PETSc.

    Args:
        name: One of `STAGES`, or another; `-log_view` shows what PETSc did inside under this name.
    """
    with ExitStack() as inside:
        inside.enter_context(_petsc_stage(name))
        if (watch := _watch.get()) is not None:
            inside.enter_context(watch.stage(name))
        yield


@contextmanager
def _petsc_stage(name: str) -> Iterator[None]:
    # Not imported: this would start PETSc, before its options are known and even for --help.
    petsc = sys.modules.get("petsc4py.PETSc")
    if petsc is None:
        yield
        return
    log_stage = petsc.Log.Stage(name)
    log_stage.push()
    try:
        yield
    finally:
        log_stage.pop()


def add(name: str, seconds: float) -> None:
    """Adds time that the caller has measured: for loops in which a `stage` would cost too much.

    Args:
        name: The stage; PETSc's log counts this time to the stage around it.
        seconds: Wall time [s].
    """
    watch = _watch.get()
    if watch is not None:
        watch.add(name, seconds)


def totals() -> dict[str, float]:
    """Seconds per stage of the current watch (empty without one)."""
    watch = _watch.get()
    return watch.totals() if watch else {}
