"""Checkpoints with given content, and restart states saved without a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfin_elastic.problem.state import RestartState, State, StateCopy
from dolfin_elastic.results.checkpoint.checkpoints import (
    Checkpoints,
    CheckpointSettings,
    RunDescription,
)


def saved(
    comm: MPI.Comm, folder: Path, restart: RestartState, step: int = 3, **keys: Any
) -> Checkpoints:
    """Writes a checkpoint."""
    to = Checkpoints(comm, folder, CheckpointSettings(**keys), RunDescription("", "", dict, {}))
    to.save(State(step, 0.5, next(iter(restart.fields.values())), done=0.5), restart, [{}])
    return to


def through_json(state: RestartState) -> StateCopy:
    """A copy in memory, whose numbers have been JSON text, as in a checkpoint."""
    return StateCopy(RestartState(state.fields, json.loads(json.dumps(dict(state.numbers)))))
