"""One run at a time writes into a folder of results.

The file `.lock` in it is locked by rank 0 (flock, on network file systems too) and says who is at
work.  The operating system lets go of the lock when the process ends, however it ends: what a
killed run leaves behind keeps nobody out.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import socket
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.core.errors import RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.signals import FILE
from dolfin_elastic.results.files import make_folder

log = logging.getLogger("dolfin_elastic")

LOCK = ".lock"
PATIENCE = 2.0
"""How long a lock may last that somebody holds [s], before it is refused."""
_ATTEMPTS = 100
"""Tries to lock a file that others remove at the same time."""


class FolderLock:
    """The right to write into a folder, from `acquire` to `close` or the end of the process.

    Args:
        comm: The ranks that compute.
        folder: Of the results.
    """

    def __init__(self, comm: MPI.Comm, folder: Path) -> None:
        self._comm, self._folder = comm, folder
        self._descriptor: int | None = None
        self._taken = False

    def acquire(self, *, create: bool = False) -> None:
        """Takes it, unless it is taken already, or there is no such folder. Collective.

        Args:
            create: Make the folder first.

        Raises:
            RestartError: Another run is going there.
            OutputError: The folder cannot be made.
        """
        if not self._taken:
            self._taken = on_root(self._comm, lambda: self._acquire(create))

    def _acquire(self, create: bool) -> bool:
        if create:
            make_folder(self._folder)
        if not self._folder.is_dir():
            return False
        try:
            self._descriptor = _locked(self._folder / LOCK)
        except OSError as error:
            if error.errno in (errno.EPERM, errno.EACCES, errno.EROFS) and not create:
                return False  # whoever writes there says it better
            log.warning(
                "%s cannot be locked (%s): nothing keeps a second run out of it",
                self._folder,
                os.strerror(error.errno or 0).lower(),
            )
        return True

    def close(self) -> None:
        """Gives it back. Not collective."""
        if self._descriptor is not None:
            with suppress(OSError):
                (self._folder / LOCK).unlink()
            os.close(self._descriptor)
        self._descriptor, self._taken = None, False


def check_free(folder: Path) -> None:
    """Whether no run is going there. Not collective.

    Raises:
        RestartError: One is.
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR)
    except OSError:
        return  # there is none, or whoever writes there says what is wrong
    try:
        _lock(descriptor)
    except BlockingIOError:
        raise _going(folder, descriptor) from None
    except OSError:
        return
    finally:
        os.close(descriptor)


def _locked(path: Path) -> int:
    """A descriptor of the file, which is locked as long as that is open.

    Raises:
        RestartError: Somebody else has locked it.
        OSError: It cannot be locked.
    """
    for _ in range(_ATTEMPTS):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(descriptor)
            if _is_still(path, descriptor):
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps(_myself()).encode(), 0)
                return descriptor
        except OSError as error:
            busy = isinstance(error, BlockingIOError)
            fault = _going(path.parent, descriptor) if busy else error
            if not busy and not os.fstat(descriptor).st_size:  # ours: who locks one writes into it
                with suppress(OSError):
                    path.unlink()
            os.close(descriptor)
            raise fault from None
        os.close(descriptor)
    raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))


def _lock(descriptor: int) -> None:
    """Locks a file; what was killed just now gets a moment to be gone.

    Raises:
        BlockingIOError: Somebody else has locked it.
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


def _is_still(path: Path, descriptor: int) -> bool:
    """The file that was locked is the one with this name: who held it before has removed it."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _myself() -> dict[str, str | int]:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    return {"host": socket.gethostname(), "pid": os.getpid(), "since": since}


def _going(folder: Path, descriptor: int) -> RestartError:
    who = ""
    with suppress(OSError, ValueError, KeyError, TypeError):
        told = json.loads(os.pread(descriptor, 4096, 0))
        who = f" (process {told['pid']} on {told['host']}, since {told['since']})"
    return RestartError(
        f"a run is still going in this folder{who}",
        where=str(folder),
        expected=f"wait for its end, or stop it: touch {folder / FILE}",
    )
