"""Checkpoints, from which a run is continued on any number of ranks.

Files in the folder `checkpoints` of the results:

    case.toml           the case, with absolute paths
    step_000012.h5      the solver's fields after step 12, in the dof ordering of mesh_order.py
    step_000012.json    all other restart data, and the checksums of the fields

Each file is written under another name, brought to the disk (fsync), and renamed.  A checkpoint
exists once its `.json` has its name, which is last, and an older one is removed only after that.
So a kill at any moment leaves a whole checkpoint behind, if there has been one before.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from pydantic import Field, model_validator

from dolfin_elastic.core import __version__
from dolfin_elastic.core.errors import InputError, RestartError
from dolfin_elastic.core.files.hdf5 import UnsafeHdf5Error
from dolfin_elastic.core.parallel import agree, largest, on_root
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import Record, UnusedKeys, refuse_unused_keys
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.core.units import Time
from dolfin_elastic.problem.state import RestartState, State
from dolfin_elastic.results import hdf5
from dolfin_elastic.results.checkpoint.checksums import array_checksum
from dolfin_elastic.results.checkpoint.contents import fault_of
from dolfin_elastic.results.checkpoint.mesh_order import DofOrdering
from dolfin_elastic.results.files import (
    make_folder,
    replace_text,
    sync,
    writing,
)
from dolfin_elastic.results.writer import StepInterval, Steps

log = logging.getLogger("dolfin_elastic")

FOLDER, CASE = "checkpoints", "case.toml"
FORMAT = 7
"""Raised where content, fields or defaults of cases change: such a run is not gone on with."""
_NAME = re.compile(r"step_(\d{6,})\.json")
FIRST = 10.0
"""Seconds to the first checkpoint, where the user has not chosen."""

SHORTEST = 30.0
"""Seconds from one to the next, at least."""

COST = 0.05
"""Share of the time that checkpoints may cost."""

_UNREADABLE = (OSError, KeyError, RuntimeError, TypeError, ValueError)


class CheckpointSettings(Record):
    """When checkpoints are written.  A case file may give false or a text with the time instead.

    Attributes:
        time: Wall time from one checkpoint to the next [s]; None: as short as costs at most 5 % of
            the time, with the first one after ten seconds.
        every: If given, there is also one of the first state at or after each n-th step.
        keep: Number of checkpoints on disk, the newest.
        off: No checkpoints are written.
    """

    time: Time | None = Field(default=None, gt=0)
    every: Steps | None = None
    keep: int = Field(default=2, ge=1)
    off: bool = False

    @model_validator(mode="before")
    @classmethod
    def _from_short_form(cls, value: object) -> object:
        if isinstance(value, bool):
            return {"off": not value}
        if isinstance(value, int | float):
            raise InputError(
                f"{value:g} is wrong",
                expected=f'for example "10 min", {{every = {value:g}}} for steps, or false',
            )
        return {"time": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _check_off(self) -> Self:
        if self.off:
            rule = UnusedKeys(["time", "every", "keep"], "there are no checkpoints with off = true")
            refuse_unused_keys(self, [rule])
        return self


@dataclass
class RunDescription:
    """What a run computes, as its checkpoints record it.

    Attributes:
        case: The case file's text; empty for a case with Python functions.
        file: The case file it was read from; empty for one made in Python.
        fingerprint: Makes that of the mesh, see `checksums.fingerprint`. Collective.
        petsc: PETSc options from outside the case.
        analysis: Which of the case's analyses it is.
    """

    case: str
    file: str
    fingerprint: Callable[[], Mapping[str, Any]]
    petsc: PetscOptions
    analysis: str = ""

    @cached_property
    def mesh(self) -> Mapping[str, Any]:
        """The mesh's fingerprint, made once, when it is needed: few runs write a checkpoint.

        Collective.
        """
        return self.fingerprint()


class DofOrderings:
    """The dof orderings of several spaces, each made once."""

    def __init__(self) -> None:
        self._known: list[tuple[fem.FunctionSpace, DofOrdering]] = []

    def order(self, V: fem.FunctionSpace) -> DofOrdering:
        """The ordering of a space. Collective."""
        for space, order in self._known:
            if space is V or space == V:
                return order
        self._known.append((V, DofOrdering(V)))
        return self._known[-1][1]


class Checkpoints:
    """Writes the checkpoints of one run.  All of it is collective.

    Args:
        comm: The ranks that compute.
        step: Step of the checkpoint from which the run continues.

    Attributes:
        saved: Step of the last checkpoint; 0: none, for there is none of the initial state.
        off: No checkpoints are written.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        folder: Path,
        settings: CheckpointSettings,
        run: RunDescription,
        *,
        step: int = 0,
    ) -> None:
        self._comm, self._folder, self._settings, self._run = comm, folder, settings, run
        self._path = folder / FOLDER
        self._orderings, self._written = DofOrderings(), time.monotonic()
        self._interval = settings.time or FIRST
        self._every = StepInterval(settings.every or 1)
        self._every.takes(step)
        self.saved, self.off = step, settings.off

    def due(self, state: State, *, asked: bool = False) -> bool:
        """Whether a checkpoint of a state is due; call it once for each state.

        Args:
            state: The state that has been reached; of the last one there is no checkpoint.
            asked: The user asks for one, on any rank.
        """
        if self.off:
            return False
        by_step = self._every.takes(state.step) and self._settings.every is not None
        # Clocks differ between ranks: the first one decides for all.
        late = time.monotonic() - self._written >= self._interval and self._comm.rank == 0
        wanted = largest(self._comm, float(asked or late or by_step)) > 0
        return wanted and state.done < 1.0

    def save(
        self, state: State, restart: RestartState, outputs: Sequence[Mapping[str, Any]]
    ) -> None:
        """Writes a checkpoint, unless there is one of this step.

        Args:
            outputs: Restart states of the writers, in their order.

        Raises:
            OutputError: It cannot be written.
        """
        if state.step == self.saved:
            return
        begin = time.monotonic()
        with stage("output"):
            mesh = self._run.mesh
            on_root(self._comm, self._begin)
            orders = {
                name: self._orderings.order(f.function_space) for name, f in restart.fields.items()
            }
            rows = {name: orders[name].rows(f) for name, f in restart.fields.items()}
            draft = self._path / ".part.h5"
            hdf5.write(self._comm, draft, rows, durable=True)
            arrays = {
                name: {"shape": list(r.shape), "sum": array_checksum(self._comm, r)}
                for name, r in rows.items()
            }
            content = {
                "step": state.step,
                "t": state.t,
                "done": state.done,
                "written": datetime.now(UTC).isoformat(timespec="seconds"),
                "ranks": self._comm.size,
                "version": __version__,
                "mesh": mesh,
                "case": digest(self._run.case),
                "analysis": self._run.analysis,
                "case_text": self._run.case,
                "file": self._run.file,
                "petsc": self._run.petsc,
                "arrays": arrays,
                "numbers": restart.numbers,
                "outputs": list(outputs),
            }
            on_root(self._comm, lambda: self._commit(state.step, draft, content))
            self.saved, self._written = state.step, time.monotonic()
        if self._settings.time is None:
            self._interval = max(SHORTEST, (self._written - begin) / COST)
        log.debug("checkpoint of step %d in %s", state.step, self._path)

    def _begin(self) -> None:
        make_folder(self._path)
        case = self._path / CASE
        if not case.is_file() or case.read_text(encoding="utf-8") != self._run.case:
            _replace(case, self._run.case)

    def _commit(self, step: int, draft: Path, content: Mapping[str, Any]) -> None:
        """Renames the files, which makes them a checkpoint, and removes old ones. On rank 0."""
        fields, manifest = _files(self._path, step)
        with writing(fields):
            sync(draft)
            draft.replace(fields)
        text = json.dumps(content, ensure_ascii=False, default=_plain)
        _replace(manifest, json.dumps({"format": FORMAT, "digest": digest(text), "text": text}))
        steps = _steps(self._path)
        _remove(self._path, steps[self._settings.keep :])

    def remove_later(self) -> None:
        """Removes checkpoints after the one that the run continues from."""
        on_root(
            self._comm,
            lambda: _remove(self._path, [s for s in _steps(self._path) if s > self.saved]),
        )

    def clear(self) -> int:
        """Removes all checkpoints in the folder, of earlier runs, too, and returns their number."""
        return on_root(self._comm, lambda: clear(self._folder))


def clear(folder: Path) -> int:
    """Removes all checkpoints in a folder of results; returns their number. Not collective."""
    path = folder / FOLDER
    if not path.is_dir():
        return 0
    steps = _steps(path)
    with writing(path):
        _remove(path, steps)
        ours = [*path.glob("step_*.h5"), path / ".part.h5", path / CASE, *path.glob(".*.part")]
        for file in ours:
            file.unlink(missing_ok=True)
        if not any(path.iterdir()):
            path.rmdir()
    return len(steps)


@dataclass(frozen=True)
class Checkpoint:
    """A whole checkpoint; it is a `SavedState`.

    Attributes:
        comm: The ranks that continue the run.
        path: File of its fields.
        content: Everything else, from its `.json`.
    """

    comm: MPI.Comm
    path: Path
    content: Mapping[str, Any]

    @property
    def numbers(self) -> Mapping[str, Any]:
        """See `SavedState`."""
        return dict(self.content["numbers"])

    def fill(self, fields: Mapping[str, fem.Function]) -> None:
        """See `SavedState`. Collective.

        Args:
            fields: Names to functions of any mesh with the same cells, on any ranks.

        Raises:
            RestartError: The checkpoint has no such field, or its file cannot be read.
        """
        spaces = DofOrderings()
        for name, function in fields.items():
            order = spaces.order(function.function_space)
            shape = [order.count, function.function_space.dofmap.index_map_bs]
            if self.content["arrays"].get(name, {}).get("shape") != shape:
                raise RestartError(
                    f"it has no field '{name}' of {order.count} values",
                    where=str(self.path),
                    expected="a checkpoint of this very case",
                )
            rows: AnyArray = np.empty((0, shape[1]))
            error = None
            try:
                rows = hdf5.read(self.path, name, order.first, order.mine)
            except _UNREADABLE as caught:
                error = RestartError(f"cannot be read: {caught}", where=str(self.path))
            agree(self.comm, error)
            order.fill(function, rows)


def newest_checkpoint(comm: MPI.Comm, folder: Path) -> Checkpoint | None:
    """The newest whole checkpoint in a folder of results, if there is one. Collective.

    All values are read and compared with the checksums; damaged checkpoints are logged and passed
    over.

    Args:
        comm: The ranks that continue the run.

    Raises:
        RestartError: Another version of the program has written them all.
    """
    path = folder / FOLDER
    steps = on_root(comm, lambda: _steps(path))
    on_root(comm, lambda: _check_formats(path, steps))
    for step in steps:
        fields, manifest = _files(path, step)
        content, fault = on_root(comm, partial(_content, manifest, step))
        fault = fault or _damage(comm, fields, content["arrays"])
        if not fault:
            return Checkpoint(comm, fields, content)
        log.warning("the checkpoint of step %d is damaged (%s): going back further", step, fault)
    return None


def _check_formats(path: Path, steps: Sequence[int]) -> None:
    """Refuses checkpoints of which all have another format. Not collective.

    Raises:
        RestartError: Another version of the program has written them.
    """
    result = set()
    for step in steps:
        try:
            result.add(int(json.loads(_files(path, step)[1].read_text(encoding="utf-8"))["format"]))
        except _UNREADABLE:
            return
    if not result or FORMAT in result:
        return
    written = ", ".join(map(str, sorted(result)))
    which = "a newer" if min(result) > FORMAT else "an older"
    raise RestartError(
        f"{which} version of the program, with other defaults and fields, has written its "
        f"checkpoints (format {written}, this one knows {FORMAT})",
        where=str(path),
        expected="go on with that version, or compute the case anew",
    )


def _content(manifest: Path, step: int) -> tuple[dict[str, Any], str]:
    """Content of a checkpoint's `.json`, or what is wrong with it. Not collective.

    Args:
        manifest: The file.
    """
    try:
        outer = json.loads(manifest.read_text(encoding="utf-8"))
        if outer["format"] != FORMAT:
            return {}, f"it has the format {outer['format']}, this program knows {FORMAT}"
        if digest(outer["text"]) != outer["digest"]:
            return {}, f"{manifest.name} has been changed"
        content = json.loads(outer["text"])
        fault = fault_of(content, step)
        return ({}, f"{manifest.name}: {fault}") if fault else (content, "")
    except _UNREADABLE as error:
        return {}, f"{manifest.name} cannot be read: {error}"


def _damage(comm: MPI.Comm, fields: Path, arrays: Mapping[str, Any]) -> str:
    """What is wrong with the fields of a checkpoint; empty if nothing is. Collective."""
    for name, known in arrays.items():
        count, rows = known["shape"][0], None
        first, last = (count * rank // comm.size for rank in (comm.rank, comm.rank + 1))
        why = ""
        try:
            values = hdf5.read(fields, name, first, last - first)
            alike = values.dtype == np.float64 and list(values.shape[1:]) == known["shape"][1:]
            if alike and np.isfinite(values).all():
                rows = hdf5.Rows(values, first, count)
        except _UNREADABLE as error:
            why = f": {error}" if isinstance(error, UnsafeHdf5Error) else ""
        answers = comm.allgather((rows is not None, why))  # one text, though ranks read other rows
        whole = all(good for good, _ in answers)
        if not whole or rows is None or array_checksum(comm, rows) != known["sum"]:
            said = next((text for _, text in answers if text), "")
            return f"{fields.name} is not as it was written{said}"
    return ""


def read_case_text(folder: Path) -> str:
    """Text of the case file in a folder's checkpoints. Not collective.

    Raises:
        RestartError: It cannot be read.
    """
    file = folder / FOLDER / CASE
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RestartError(f"cannot be read: {error}", where=str(file)) from None


def last_step(folder: Path) -> int | None:
    """Step of the newest checkpoint in a folder, whole or not; None without. Not collective."""
    return next(iter(_steps(folder / FOLDER)), None)


def _files(path: Path, step: int) -> tuple[Path, Path]:
    """The `.h5` and the `.json` of a checkpoint."""
    return path / f"step_{step:06d}.h5", path / f"step_{step:06d}.json"


def _steps(path: Path) -> list[int]:
    """Steps of the checkpoints in a folder, the newest first. Not collective."""
    if not path.is_dir():
        return []
    steps = [int(m[1]) for file in path.iterdir() if (m := _NAME.fullmatch(file.name))]
    return sorted(steps, reverse=True)


def _remove(path: Path, steps: Sequence[int]) -> None:
    """Removes checkpoints, the `.json` first, so that no part of one is left. Not collective."""
    for step in steps:
        fields, manifest = _files(path, step)
        with writing(manifest):
            manifest.unlink(missing_ok=True)
            fields.unlink(missing_ok=True)


def _replace(path: Path, text: str) -> None:
    """As `replace_text`; file and folder are brought to the disk (fsync)."""
    replace_text(path, text, durable=True)
    sync(path.parent)


def _plain(value: object) -> object:
    """Values without a JSON type: numpy's numbers become Python's, PETSc options text."""
    return value.item() if isinstance(value, np.generic) else str(value)


def digest(text: str) -> str:
    """Hash of a text, which identifies it."""
    return hashlib.sha256(text.encode()).hexdigest()
