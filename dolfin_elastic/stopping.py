"""Signals, and the file, that end a run after its step or ask for a checkpoint."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI

INTERRUPTED = 130
"""Exit code of a run that was stopped."""


class Stop:
    """Notes signals and a file called "stop"; a second signal to stop ends the program at once.

    Args:
        folder: Folder of the results, where a file called "stop" may appear.
    """

    def __init__(self, folder: Path) -> None:
        self.asked, self._checkpoint, self._file = False, False, folder / "stop"
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2):
            signal.signal(number, self._ask)
        signal.signal(signal.SIGUSR1, self._want)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            os._exit(INTERRUPTED)
        self.asked = True
        if launched_rank() == 0:  # not by `print`, which may be interrupted in the midst of one
            os.write(2, b"\nstopping after this step; once more: at once\n")

    def _want(self, number: int, frame: FrameType | None) -> None:
        self._checkpoint = True

    def wants_checkpoint(self) -> bool:
        """Whether this rank was asked for a checkpoint since the last call. Not collective."""
        wanted, self._checkpoint = self._checkpoint, False
        return wanted

    def agreed(self, comm: MPI.Comm) -> bool:
        """True on all ranks when one was asked to stop. Collective."""
        from dolfin_elastic.parallel import largest

        if comm.rank == 0 and self._file.exists():
            self.asked = True
            with suppress(OSError):  # somebody else's file: it has done what it is for
                self._file.unlink()
        return largest(comm, float(self.asked)) > 0


def launched_rank() -> int:
    """Rank of this process as its launcher says, without starting MPI; 0 without a launcher."""
    for name in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0
