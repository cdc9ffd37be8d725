"""Signals and the file that end a run after its step, and who may say so."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI

INTERRUPTED = 130
"""Exit code of a run that was stopped."""


class Stop:
    """Notes Ctrl-C, SIGTERM and a file called "stop"; a second signal ends the program at once.

    Args:
        folder: Folder of the results, where a file called "stop" may appear.
    """

    def __init__(self, folder: Path) -> None:
        self.asked, self._file = False, folder / "stop"
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            os._exit(INTERRUPTED)
        self.asked = True
        if launched_rank() == 0:
            print("\nstopping after this step; once more: at once", file=sys.stderr, flush=True)

    def agreed(self, comm: MPI.Comm) -> bool:
        """True on all ranks when one was asked to stop. Collective."""
        from dolfin_elastic.parallel import largest

        if comm.rank == 0 and self._file.exists():
            self.asked = True
            self._file.unlink(missing_ok=True)
        return largest(comm, float(self.asked)) > 0


def launched_rank() -> int:
    """Rank of this process as its launcher says, without starting MPI; 0 without a launcher."""
    for name in ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0
