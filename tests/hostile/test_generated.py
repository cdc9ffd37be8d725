"""Broken cases and hostile meshes in one process: codes 0, 2 or 3, never 1, never over 20 s."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.hostile import Hostile, broken_cases, good_ones, hostile_meshes
from mpi4py import MPI

from dolfin_elastic.cli.app import guarded
from dolfin_elastic.core import signals
from dolfin_elastic.core.parallel import on_root

COMM = MPI.COMM_WORLD
BLOCKS = 10
LONGEST = 20.0
"""Time that one of them may take [s]."""
STOP = 8.0
"""Time after which a run is asked to stop [s]: a good case may have a million steps."""
STOPPED, AUDIT_FAILED = 130, 5
SHARED = 25
"""How many of each several ranks read."""

CASES, MESHES, GOOD = broken_cases(), hostile_meshes(), good_ones()


def test_there_are_enough() -> None:
    assert len(CASES) >= 500
    assert len({case.text for case in CASES}) >= 480
    assert len(MESHES) >= 120


def code_of(words: list[str], monkeypatch: pytest.MonkeyPatch) -> tuple[int, str]:
    """Exit code of a command line in this process, and what it has printed."""
    out = io.StringIO()
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", *words])
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = guarded()
    if MPI.COMM_WORLD.size > 1:
        gc.disable()  # which the command has enabled: see `pytest_collection_finish`
    return code, out.getvalue()


@contextlib.contextmanager
def stopped_in_time(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Asks a run to stop when it takes long, and leaves no handler of signals behind."""
    numbers = (*signals.ENDING, signal.SIGUSR1)
    before = {number: signal.getsignal(number) for number in numbers}
    monkeypatch.setattr(signals, "_current", [])

    def ask() -> None:
        if signals.watched():  # else it reads the case yet, which is soon over
            os.kill(os.getpid(), signal.SIGTERM)

    timer = threading.Timer(STOP, ask)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        for number, handler in before.items():
            signal.signal(number, handler)
        monkeypatch.setattr(signals, "_current", [])


def read(
    found: Hostile, folder: Path, monkeypatch: pytest.MonkeyPatch, command: str = "check"
) -> str:
    """What is wrong with how it was read, or computed; nothing, if all is well.  Collective."""

    def write() -> Path:
        place = folder / f"{len(list(folder.iterdir()))}"
        place.mkdir()
        return found.write(place)

    path = on_root(COMM, write)
    monkeypatch.chdir(path.parent)
    begin = time.monotonic()
    try:
        with stopped_in_time(monkeypatch):
            code, said = code_of([command, "case.toml"], monkeypatch)
    except BaseException as error:  # what is no refusal would have been code 1
        return f"{type(error).__name__}: {error}"
    seconds = time.monotonic() - begin
    codes = COMM.allgather(code)
    late = command == "run" and COMM.allreduce(seconds, op=MPI.MAX) > STOP
    audited = command == "run" and "audit" in said  # its results are told to be unreliable
    others = [*([{STOPPED}] if late else []), *([{AUDIT_FAILED}] if audited else [])]
    if set(codes) not in ({0}, {2}, {3}, *others):
        return f"codes {codes}: {said}"
    if seconds > LONGEST:
        return f"{seconds:.3g} s"
    told = re.findall("^error: .*", said, re.MULTILINE)
    wrong = bool(code) and code not in (STOPPED, AUDIT_FAILED)
    most = len(set(told)) if code == 2 else int(wrong)  # all errors of a case, each of them once
    if COMM.rank == 0 and (bool(told) != wrong or len(told) > most or "Traceback" in said):
        return f"not one message each: {said}"
    left = sorted(p.name for p in path.parent.iterdir() if p.name not in ("case.toml", found.file))
    if command == "run":
        left = [name for name in left if name.startswith("trace")]
    return f"left behind: {left}" if left else ""


def failures(
    chosen: list[Hostile], folder: Path, monkeypatch: pytest.MonkeyPatch, command: str = "check"
) -> list[str]:
    """Those that were not read as they should be, with the reason."""
    told = [(found.name, read(found, folder, monkeypatch, command)) for found in chosen]
    return [f"{name}: {text[:500]}" for name, text in told if text]


@pytest.mark.parametrize("block", range(BLOCKS))
def test_broken_cases(folder: Path, serial_only: None, monkeypatch, block: int) -> None:
    assert failures(CASES[block::BLOCKS], folder, monkeypatch) == []


@pytest.mark.parametrize("block", range(BLOCKS))
def test_hostile_meshes(folder: Path, serial_only: None, monkeypatch, block: int) -> None:
    assert failures(MESHES[block::BLOCKS], folder, monkeypatch) == []


@pytest.mark.parametrize("found", [CASES, MESHES], ids=["cases", "meshes"])
def test_on_several_ranks(folder: Path, monkeypatch, found: list[Hostile]) -> None:
    """The same codes on all ranks, and none waits for another."""
    if COMM.size == 1:
        pytest.skip("one rank reads all of them")
    chosen = found[:: len(found) // SHARED][:SHARED]
    assert failures(chosen, folder, monkeypatch) == []


@pytest.mark.long
@pytest.mark.parametrize("block", range(BLOCKS))
@pytest.mark.parametrize("found", [CASES, MESHES], ids=["cases", "meshes"])
def test_run(folder: Path, monkeypatch, found: list[Hostile], block: int) -> None:
    """All of them through `run`; on several ranks as many as through `check`."""
    chosen = found if COMM.size == 1 else found[:: len(found) // SHARED][:SHARED]
    assert failures(chosen[block::BLOCKS], folder, monkeypatch, "run") == []


@pytest.mark.parametrize("name", GOOD)
def test_what_is_broken_was_good(folder: Path, monkeypatch, name: str) -> None:
    """Else all of them would be refused for one and the same reason."""
    path = on_root(COMM, lambda: GOOD[name].write(folder))
    code, said = code_of(["check", str(path)], monkeypatch)
    assert code == 0, said
