"""A checkpoint with given content."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfin_elastic.problem.restart_state import Kept
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.checkpoint.checkpoints import (
    About,
    Checkpoint,
    Checkpoints,
)


def saved(comm: MPI.Comm, folder: Path, kept: Kept, step: int = 3, **keys: Any) -> Checkpoints:
    """Writes a checkpoint."""
    to = Checkpoints(comm, folder, Checkpoint(**keys), About("", "", {}, {}))
    to.save(State(step, 0.5, next(iter(kept.fields.values())), done=0.5), kept, [{}])
    return to
