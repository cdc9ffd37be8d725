"""Fields of selected states in files: what all formats share.

A format has an index, the file that users open, and mostly a folder of the arrays that it refers
to.  A step's arrays are complete before the index names them, and the index is replaced as a whole:
a run that is killed loses the step that it is writing, and none before.
"""

from __future__ import annotations

import logging
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.files.regular import fresh, open_regular
from dolfin_elastic.core.parallel import agree, on_root, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import IN_MOTION, default_fields, name_in_results
from dolfin_elastic.results.files import (
    make_folder,
    missing_results,
    open_together,
    sync,
    write_at,
    writing,
)
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writer import LastState, Numbers, StepInterval

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

log = logging.getLogger("dolfin_elastic")


def add_text(comm: MPI.Comm, path: Path, text: str, start: int) -> int:
    """Adds the ranks' texts to a file, one behind the other. Collective.

    The first byte of all is written last: until then readers find a byte 0 in its place.

    Args:
        comm: The ranks.
        path: The file; what it holds behind `start` is lost.
        text: This rank's part.
        start: Size of the file before [bytes]; 0: it is made.

    Returns:
        Its size then.

    Raises:
        OutputError: On all ranks, when one of them could not write its part.
    """
    own = np.frombuffer(text.encode(), dtype=np.uint8)
    before = int(cast(MPI.Intracomm, comm).exscan(len(own)) or 0)
    size = total(comm, len(own))
    on_root(comm, lambda: _cut(path, start))
    if not size:
        return start
    file = open_together(comm, path)
    held = 1 if before == 0 and len(own) else 0
    error = write_at(file, path, start + before + held, own[held:])
    errors = comm.allgather(error is not None)
    if held and not any(errors):
        error = write_at(file, path, start, own[:1])
    file.Close()
    agree(comm, error)
    return start + size


def _cut(path: Path, size: int) -> None:
    with writing(path):
        descriptor = open_regular(path if size else fresh(path), os.O_RDWR)
        try:
            os.ftruncate(descriptor, size)
        finally:
            os.close(descriptor)


def lines_of(table: FloatArray, first: IntArray, between: str = " ") -> str:
    """Rows of numbers as lines of text, with all digits.

    Args:
        table: Shape (rows, columns).
        first: A whole number for the beginning of each line, shape (rows,).
        between: What stands between two numbers.
    """
    line = between.join(["%d", *["%.17g"] * table.shape[1]]) + "\n"
    rows = zip(
        cast("list[int]", first.tolist()), cast("list[list[float]]", table.tolist()), strict=True
    )
    return "".join([line % (number, *row) for number, row in rows])


@dataclass(frozen=True)
class SeriesFiles:
    """The index of a series and the files that it refers to.  None of it is collective.

    Attributes:
        index: The file that users open.
        folder: Of the arrays; None: they are in the index itself.
        own: Names of files there that belong to the series; others stay.
    """

    index: Path
    folder: Path | None
    own: re.Pattern[str]

    def clear(self) -> None:
        """Removes the results of an earlier run, first the index.

        Raises:
            OutputError: They cannot be removed.
        """
        with writing(self.index):
            self.index.unlink(missing_ok=True)
        self.keep(())

    def keep(self, names: Iterable[str]) -> None:
        """Removes the files in the folder but those named."""
        if self.folder is None or not self.folder.is_dir():
            return
        kept = set(names)
        with writing(self.folder):
            for file in self.folder.iterdir():
                if self.own.fullmatch(file.name) and file.name not in kept:
                    file.unlink()

    def remove(self) -> None:
        """As `clear`; the folder is removed, too, if it is empty."""
        self.clear()
        if self.folder is not None and self.folder.is_dir():
            with writing(self.folder):
                if not any(self.folder.iterdir()):
                    self.folder.rmdir()


class SeriesWriter(ABC):
    """Writes the fields of selected states.  All of it is collective.

    Args:
        path: The file that users open.
        fields: Names of `field_table`; None: those of `default_fields`, in motion also velocity.
        every: Steps between written states, see `StepInterval`; the last state is always written.
        frames: If given, so many states evenly over the run are written instead, and the last.
        saved: Its restart state: later steps are cut off.

    Attributes:
        files: Of the series.

    Raises:
        InputError: An unknown field.
        RestartError: Steps from before the checkpoint are missing.
        OutputError: The folder cannot be written to.
    """

    folder: ClassVar[str] = ""
    """What is added to the index's name for that of the folder; empty: there is none."""
    own: ClassVar[re.Pattern[str]] = re.compile("")
    """Names of the files in the folder."""

    def __init__(
        self,
        problem: Problem,
        path: Path,
        *,
        fields: tuple[str, ...] | None = None,
        every: int = 1,
        frames: int | None = None,
        saved: Numbers | None = None,
    ) -> None:
        self.problem, self.path, self.fields, self.frames = problem, path, fields, frames
        self.every = StepInterval(every, -1 if saved is None else saved["taken"])
        self.comm, self.files = problem.body.comm, self.files_of(path)
        self._frames: list[str] = []
        self._synced = 0
        self._last_state = LastState()
        self._pending = False
        with stage("output"):
            usual = default_fields(region.law for region in problem.regions)
            self._evaluate = Evaluator(problem, fields or usual)
            if saved is None:
                body = problem.body
                for name in fields or ():
                    if name in body.fields and (own := name_in_results(name, body)) != name:
                        log.warning(
                            "'%s' in results is that of the results; the field of the body is '%s'",
                            name,
                            own,
                        )
                on_root(self.comm, self._clear)
            else:
                self._frames = self._resume(saved)
                self._synced = len(self._frames)

    @classmethod
    def files_of(cls, path: Path) -> SeriesFiles:
        """The files of a series. Not collective.

        Args:
            path: The index; it need not exist.
        """
        folder = path.with_name(f"{path.stem}{cls.folder}") if cls.folder else None
        return SeriesFiles(path, folder, cls.own)

    def _clear(self) -> None:
        make_folder(self.files.folder or self.path.parent)
        self.files.clear()

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        on_root(self.comm, self._sync)
        self._synced = len(self._frames)
        return {"frames": len(self._frames), "taken": self.every.taken}

    def write(self, state: State) -> None:
        """Writes one step, if it is due: on return it is complete."""
        with stage("output"):
            self._pending = not self._due(state)
            if self._pending:
                self._last_state.copy(state)
            else:
                self._write(state)

    def _due(self, state: State) -> bool:
        if self.frames is None:
            return self.every.takes(state.step)
        return state.done * self.frames >= len(self._frames)

    def _write(self, state: State) -> None:
        grid = self._evaluate.grid
        default_in_motion = self.fields is None and state.v is not None
        values = self._evaluate(state, more=IN_MOTION if default_in_motion else ())
        rows = {name: grid.rows(self._evaluate.table[name].centre, v) for name, v in values.items()}
        self._frames.append(self._add(state, rows))
        on_root(self.comm, self._commit)

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; writes the last step, if it was not due."""
        if self._pending and self._last_state.state:
            with stage("output"):
                self._write(self._last_state.state)
            self._pending = False

    @abstractmethod
    def _add(self, state: State, rows: Mapping[str, Rows]) -> str:
        """Writes the arrays of a frame, and returns its entry in the index. Collective.

        Args:
            rows: Name of a field to this rank's rows.
        """

    @abstractmethod
    def _commit(self) -> None:
        """Makes the last frame known to readers. On rank 0."""

    @abstractmethod
    def _resume(self, saved: Numbers) -> list[str]:
        """Removes all frames but those of a checkpoint, and returns their entries. Collective."""

    @abstractmethod
    def _sync(self) -> None:
        """Brings the frames since the last checkpoint to the disk. On rank 0."""


class IndexedSeries(SeriesWriter):
    """A series with an index and a folder of arrays.  All of it is collective.

    See `SeriesWriter`.
    """

    @property
    def data(self) -> Path:
        """The folder."""
        assert self.files.folder is not None
        return self.files.folder

    def _commit(self) -> None:
        self._replace_index(self._frames)

    def _resume(self, saved: Numbers) -> list[str]:
        return on_root(self.comm, lambda: self._cut(int(saved["frames"])))

    def _cut(self, count: int) -> list[str]:
        make_folder(self.data)
        with writing(self.path):
            entries = self._entries() if self.path.is_file() else []
        frames = entries[:count]
        needed = {name for entry in frames for name in self._named(entry)}
        if len(frames) < count or any(not (self.data / name).is_file() for name in needed):
            raise missing_results(self.path, "steps")
        if not count:
            self.files.clear()
        else:
            self._replace_index(frames)
            self.files.keep(needed)
        return frames

    def _sync(self) -> None:
        fresh = self._frames[self._synced :]
        for name in sorted({name for entry in fresh for name in self._named(entry)}):
            sync(self.data / name)
        if self._frames:
            sync(self.path)

    @abstractmethod
    def _named(self, entry: str) -> list[str]:
        """Names of the files that an entry of the index refers to. Not collective."""

    @abstractmethod
    def _entries(self) -> list[str]:
        """The entries in the index, which is there. On rank 0."""

    @abstractmethod
    def _replace_index(self, frames: Sequence[str]) -> None:
        """Replaces the index by one of these entries. On rank 0."""
