"""A folder of results belongs to one run at a time."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import Any

import pytest
from helpers.runs import begun, case
from mpi4py import MPI

from dolfin_elastic import restart, run
from dolfin_elastic.case.restart import unfinished
from dolfin_elastic.core import lease
from dolfin_elastic.core.errors import RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.results.checkpoint import lock
from dolfin_elastic.results.checkpoint.lock import LOCK, FolderLease, check_free

WORLD = MPI.COMM_WORLD
GOING = r"a run is still going in this folder \(process \d+ on .*, since 20.*\); wait for its"


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "PATIENCE", 0.0)


def contents(folder: Path) -> dict[str, bytes]:
    """All files, the same on every rank. Collective."""

    def read() -> dict[str, bytes]:
        files = [path for path in folder.rglob("*") if path.is_file() and path.name != LOCK]
        return {str(path): path.read_bytes() for path in files}

    return on_root(WORLD, read)


def test_one_run_at_a_time(folder: Path) -> None:
    """On all ranks alike; whoever gives it back leaves nothing behind."""
    first, second = FolderLease(WORLD, folder), FolderLease(WORLD, folder)
    first.acquire()
    first.acquire(create=True)  # once is enough
    with pytest.raises(RestartError, match=GOING):
        second.acquire(create=True)
    first.close()
    assert on_root(WORLD, lambda: os.listdir(folder)) == []
    second.acquire(create=True)
    second.close()


def test_a_folder_that_does_not_exist_yet(folder: Path) -> None:
    """It is made only when it is asked for."""
    one = FolderLease(WORLD, folder / "new")
    one.acquire()
    assert not on_root(WORLD, (folder / "new").exists)
    one.acquire(create=True)
    assert on_root(WORLD, (folder / "new" / LOCK).exists)
    one.close()


def test_a_file_left_behind_locks_nothing(folder: Path) -> None:
    """What a killed run leaves is a file that nobody has locked."""
    on_root(WORLD, lambda: (folder / LOCK).write_text('{"pid": 1'))
    on_root(WORLD, lambda: check_free(folder))
    one = FolderLease(WORLD, folder)
    one.acquire()
    with pytest.raises(RestartError, match=GOING):
        on_root(WORLD, lambda: check_free(folder))
    one.close()


def test_another_date_and_another_name(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock set back and a host renamed change nothing: the lock is that of the file."""
    one = FolderLease(WORLD, folder)
    one.acquire()
    monkeypatch.setattr(lease.time, "time", lambda: 0.0)
    monkeypatch.setattr(lease.socket, "gethostname", lambda: "renamed")
    with pytest.raises(RestartError, match=GOING):
        on_root(WORLD, lambda: check_free(folder))
    one.close()
    on_root(WORLD, lambda: check_free(folder))
    on_root(WORLD, lambda: (folder / LOCK).write_text('{"pid": 1, "host": "old", "since": "2099"}'))
    one.acquire()
    one.close()


def test_a_file_that_was_removed_is_no_lock(folder: Path, monkeypatch: Any) -> None:
    """Between opening and locking the one before has ended: it is locked anew by its name."""
    original, calls = fcntl.flock, []

    def flock(descriptor: int, how: int) -> None:
        original(descriptor, how)
        if not calls:
            (folder / LOCK).unlink()
        calls.append(descriptor)

    monkeypatch.setattr(fcntl, "flock", flock)
    one = FolderLease(WORLD, folder)
    one.acquire()
    assert on_root(WORLD, lambda: len(calls)) == 2
    monkeypatch.undo()
    monkeypatch.setattr(lock, "PATIENCE", 0.0)
    with pytest.raises(RestartError, match=GOING):
        FolderLease(WORLD, folder).acquire()
    one.close()


def test_a_file_system_without_locks(folder: Path, monkeypatch: Any, caplog: Any) -> None:
    """The run goes on, and the log says what that means."""

    def flock(descriptor: int, how: int) -> None:
        raise OSError(errno.EOPNOTSUPP, "not supported")

    monkeypatch.setattr(fcntl, "flock", flock)
    states = list(run(case(statics={"steps": 1}), output=folder))
    assert states[-1].done == 1.0
    if WORLD.rank == 0:
        said = [r.getMessage() for r in caplog.records if "locked" in r.getMessage()]
        assert said == [
            f"{folder} cannot be locked (operation not supported): nothing keeps a second run "
            "out of it"
        ]
    assert not on_root(WORLD, (folder / LOCK).exists)
    on_root(WORLD, lambda: [(folder / LOCK).write_text('{"pid": 1'), None][1])
    one = FolderLease(WORLD, folder)
    one.acquire()
    one.close()
    assert on_root(WORLD, (folder / LOCK).exists)  # somebody else's


def test_neither_run_nor_restart_touches_a_folder_in_use(folder: Path) -> None:
    """A generator that is open is a run that is going; once it is closed it can go on."""
    states = run(case(statics={"steps": 4}, output={"checkpoint": {"every": 1}}), output=folder)
    for _ in range(3):
        next(states)
    before = contents(folder)
    with pytest.raises(RestartError, match=GOING):
        next(run(case(), output=folder))
    with pytest.raises(RestartError, match=GOING):
        next(restart(folder))
    assert contents(folder) == before
    states.close()
    assert [state.step for state in restart(folder)] == [3, 4]
    assert not on_root(WORLD, (folder / LOCK).exists)


def test_a_run_that_was_continued_by_another_process(folder: Path) -> None:
    """Between the look at the checkpoint and the run."""
    begun(case(statics={"steps": 4}, output={"checkpoint": {"every": 1}}), folder, 2)
    found = unfinished(folder)
    other = restart(folder)
    next(other)
    other.close()
    with pytest.raises(RestartError, match="another run has gone on from these checkpoints"):
        next(restart(found))
    found = unfinished(folder)
    list(restart(folder))
    with pytest.raises(RestartError, match="this run is complete"):
        next(restart(found))
