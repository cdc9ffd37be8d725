"""Signals and a file by which a user ends a run after its step, or asks for a checkpoint."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI

INTERRUPTED = 130
"""Exit code of a run that was stopped."""

STOP_FILE = "stop"
"""File in the folder of results that ends a run there."""

SAME_SIGNAL = 0.5
"""Signals closer than this [s] count as one: a launcher forwards what the group got already."""


class Stop:
    """Records signals and a file "stop"; the second signal to stop ends the process at once.

    Args:
        folder: Folder of the results, where a file called "stop" may appear.
    """

    def __init__(self, folder: Path) -> None:
        self.asked, self._checkpoint, self._file = False, False, folder / STOP_FILE
        self._since = 0.0
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2):
            signal.signal(number, self._request_stop)
        signal.signal(signal.SIGUSR1, self._request_checkpoint)

    def _request_stop(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            if time.monotonic() - self._since > SAME_SIGNAL:
                os._exit(INTERRUPTED)
            return
        self.asked, self._since = True, time.monotonic()
        if launched_rank() == 0:
            # Not `print`: it is not reentrant, and the signal may have interrupted one.
            with suppress(OSError):  # the terminal may be closed
                os.write(2, b"\nstopping after this step; once more: at once\n")

    def _request_checkpoint(self, number: int, frame: FrameType | None) -> None:
        self._checkpoint = True

    def wants_checkpoint(self) -> bool:
        """Whether this rank got SIGUSR1 since the last call. Not collective."""
        wanted, self._checkpoint = self._checkpoint, False
        return wanted

    def agreed(self, comm: MPI.Comm) -> bool:
        """Whether any rank got a signal to stop, or the file exists; same on all. Collective."""
        from dolfin_elastic.core.parallel import largest

        if comm.rank == 0 and self._file.exists():
            self.asked = True
            with suppress(OSError):  # the terminal may be closed
                os.write(2, f"stopping: there was a file {self._file}\n".encode())
            remove_stop_file(self._file.parent)  # or the next run would stop at once
        return largest(comm, float(self.asked)) > 0


def remove_stop_file(folder: Path) -> None:
    """Removes the file "stop" from a folder of results.

    It has stopped a run, or was to stop one that ended before.
    """
    with suppress(OSError):  # another user's file may not be removable
        (folder / STOP_FILE).unlink(missing_ok=True)


def launched_rank() -> int:
    """Rank of this process as its launcher says, without starting MPI; 0 without a launcher."""
    for name in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0
