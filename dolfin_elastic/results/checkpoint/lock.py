"""`FolderLease`: one run at a time writes into a folder of results; rank 0 has the lease."""

from __future__ import annotations

import errno
import logging
import os
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

from mpi4py import MPI

from dolfin_elastic.core.errors import RestartError
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.lease import Lease
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.signals import STOP_FILE
from dolfin_elastic.results.files import make_folder, writing

log = logging.getLogger("dolfin_elastic")

LOCK = ".lock"
PATIENCE = 2.0
"""Seconds to wait for another process, for one that has just been killed may not be gone yet."""


class FolderLease:
    """Exclusive right to write into a folder, from `acquire` to `close` or the process's end.

    Args:
        comm: The ranks that compute.
        files: Names in it that the case gives.
    """

    def __init__(self, comm: MPI.Comm, folder: Path, files: Iterable[str] = ()) -> None:
        self._comm, self._folder, self._files = comm, folder, tuple(files)
        self._lease = Lease(folder / LOCK)
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
            _lock(self._folder, self._lease)
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
        self._lease.close()
        self._locked = False


def check_free(folder: Path) -> None:
    """Checks that no run writes into a folder. Not collective.

    Raises:
        RestartError: One does.
    """
    # If it cannot be opened, the first file that is written reports that.
    with suppress(OSError), closing(Lease(folder / LOCK)) as lease:
        if (folder / LOCK).exists():
            _lock(folder, lease)


def _lock(folder: Path, lease: Lease) -> None:
    if not lease.acquire(PATIENCE):
        who = ""
        if owner := lease.owner():
            who = f" (process {owner['pid']} on {owner['host']}, since {owner['since']})"
        raise RestartError(
            f"a run is still going in this folder{who}",
            where=str(folder),
            expected=f"wait for its end, or stop it: touch {folder / STOP_FILE}",
        )
