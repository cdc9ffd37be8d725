"""`FolderLock`: one run at a time writes into a folder of results.

Rank 0 locks the file `.lock` in it (flock, which network file systems know, too) and writes into it
which process that is.  The operating system releases the lock when the process ends in any way, so
the file of a killed run locks nothing.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import socket
import time
from collections.abc import Iterable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.core.errors import RestartError
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.files.regular import open_regular
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.signals import STOP_FILE
from dolfin_elastic.results.files import make_folder, writing

log = logging.getLogger("dolfin_elastic")

LOCK = ".lock"
PATIENCE = 2.0
"""Seconds to wait for a lock of another process."""
_ATTEMPTS = 100
"""Attempts to lock a file that other processes remove at the same time."""


class FolderLock:
    """Exclusive right to write into a folder, from `acquire` to `close` or the process's end.

    Args:
        comm: The ranks that compute.
        files: Names in it that the case gives.
    """

    def __init__(self, comm: MPI.Comm, folder: Path, files: Iterable[str] = ()) -> None:
        self._comm, self._folder, self._files = comm, folder, tuple(files)
        self._descriptor: int | None = None
        self._locked = False

    def acquire(self, *, create: bool = False) -> None:
        """Locks the folder, unless it is locked by this run or does not exist. Collective.

        Raises:
            RestartError: Another run writes into it.
            InputError: A name in it stands for a file elsewhere.
            OutputError: The folder cannot be made.
        """
        if not self._locked:
            self._locked = on_root(self._comm, lambda: self._acquire(create))

    def _acquire(self, create: bool) -> bool:
        refuse_links(self._folder, self._files)
        if create:
            make_folder(self._folder)
        with writing(self._folder):  # a name that is too long, or of a folder that is closed
            if not self._folder.is_dir():
                return False
        try:
            self._descriptor = _locked(self._folder / LOCK)
        except OSError as error:
            if error.errno in (errno.EPERM, errno.EACCES, errno.EROFS) and not create:
                return False  # the error of the first file that is written is clearer
            log.warning(
                "%s cannot be locked (%s): nothing keeps a second run out of it",
                self._folder,
                os.strerror(error.errno or 0).lower(),
            )
        return True

    def close(self) -> None:
        """Releases the lock. Not collective."""
        if self._descriptor is not None:
            with suppress(OSError):
                (self._folder / LOCK).unlink()
            os.close(self._descriptor)
        self._descriptor, self._locked = None, False


def check_free(folder: Path) -> None:
    """Checks that no run writes into a folder. Not collective.

    Raises:
        RestartError: One does.
    """
    try:
        descriptor = open_regular(folder / LOCK, os.O_RDWR)
    except OSError:
        return  # no lock file; or it cannot be opened, which the first written file reports
    try:
        _lock(descriptor)
    except BlockingIOError:
        raise _folder_in_use(folder, descriptor) from None
    except OSError:
        return
    finally:
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Descriptor of a lock file, which is locked as long as the descriptor is open.

    Raises:
        RestartError: Another process has locked it.
        OSError: It cannot be locked.
    """
    for _ in range(_ATTEMPTS):
        descriptor = open_regular(path, os.O_RDWR | os.O_CREAT)
        try:
            _lock(descriptor)
            if _has_name(path, descriptor):
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps(_owner()).encode(), 0)
                return descriptor
        except OSError as error:
            busy = isinstance(error, BlockingIOError)
            fault = _folder_in_use(path.parent, descriptor) if busy else error
            # An empty file was created above: a process that locks one writes into it.
            if not busy and not os.fstat(descriptor).st_size:
                with suppress(OSError):
                    path.unlink()
            os.close(descriptor)
            raise fault from None
        os.close(descriptor)
    raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))


def _lock(descriptor: int) -> None:
    """Locks a file; waits a little, for a process that has just been killed may not be gone yet.

    Raises:
        BlockingIOError: Another process has locked it.
        OSError: It cannot be locked.
    """
    until = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until:
                raise
            time.sleep(0.05)
        else:
            return


def _has_name(path: Path, descriptor: int) -> bool:
    """Whether the locked file still has its name: its former owner may have removed it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _owner() -> dict[str, str | int]:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    return {"host": socket.gethostname(), "pid": os.getpid(), "since": since}


def _folder_in_use(folder: Path, descriptor: int) -> RestartError:
    who = ""
    with suppress(OSError, ValueError, KeyError, TypeError):
        owner = json.loads(os.pread(descriptor, 4096, 0))
        who = f" (process {owner['pid']} on {owner['host']}, since {owner['since']})"
    return RestartError(
        f"a run is still going in this folder{who}",
        where=str(folder),
        expected=f"wait for its end, or stop it: touch {folder / STOP_FILE}",
    )
