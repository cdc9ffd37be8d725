"""`Export`: an output of a case that is made when the run has ended, from the files of the run.

Rank 0 alone makes it, by the function behind `convert`: what a killed run has left can be exported
afterwards as well, and no rank has to share a surface with the others at every step.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field, field_validator

from dolfin_elastic.core.errors import InputError, OutputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.timing import stage
from dolfin_elastic.results.exports.export import SUFFIXES, Exported, check_export, export
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.files import writing
from dolfin_elastic.results.outputs import check_suffix, limits_of
from dolfin_elastic.results.writer import Numbers, Output

if TYPE_CHECKING:
    from mpi4py import MPI

    from dolfin_elastic.problem.problem import Problem
    from dolfin_elastic.problem.state import State

log = logging.getLogger("dolfin_elastic")


class Export(Output):
    """Results for another program, written at the end of a run: a surface that moves, or nodes.

    Attributes:
        file: The file: .glb, .usdc or .usda, .ply or .obj (one a state), .frd, .csv or .vtkhdf.
        field: Field that colours the surface, one of those that are written; by default the von
            Mises stress, or the displacement where that is not written.
        of: A surface that follows the body in place of its own: .obj, .ply, .stl, in the mesh's
            unit where it states none.
        frames: So many states evenly over the run; by default all that are written.
        scale: Magnification of the displacement.
        fps: States a second; by default motion is shown as it was, and statics with 24.
        range: Ends of the colours in the field's SI unit; by default smallest and largest value.
    """

    file: str = "surface.glb"
    field: str | None = None
    of: str | None = None
    frames: int | None = Field(default=None, ge=1)
    scale: float = Field(default=1.0, ge=0)
    fps: float | None = Field(default=None, gt=0)
    range: list[float | str] | None = None

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str) -> str:
        return check_suffix(file, *SUFFIXES)

    @field_validator("range")
    @classmethod
    def _check_range(cls, ends: list[float | str] | None) -> list[float | str] | None:
        if ends is not None and limits_of(ends).share:
            raise InputError(
                "percentiles are for pictures and films", expected="for example [0, 2e8]"
            )
        return ends

    @property
    def settings(self) -> ExportSettings:
        """How it is exported."""
        limits = None if self.range is None else limits_of(self.range).ends
        skin = None if self.of is None else Path(self.of)
        return ExportSettings(self.field, self.frames, self.scale, self.fps, limits, skin)

    def in_folder(self, folder: Path) -> Export:
        """The same, with the path of `of` relative to a folder."""
        return self if self.of is None else self.model_copy(update={"of": str(folder / self.of)})

    def check(self, folder: Path) -> None:
        """Checks that it can be made, and that its surface can be read. Not collective.

        Args:
            folder: What `of` is relative to.

        Raises:
            InputError: It cannot.
        """
        check_export(Path(self.file), self.settings, "file")
        if self.of is not None:
            from dolfin_elastic.results.exports.skin import read_skin

            try:
                read_skin(folder / self.of, 1.0)
            except InputError as error:
                raise InputError(
                    f"{self.of}: {error.what}", where="of", expected=error.expected
                ) from None

    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> ExportWriter:
        """See `Output.open`."""
        on_root(problem.body.comm, lambda: self.remove(folder))
        return ExportWriter(problem.body.comm, self, folder)

    def remove(self, folder: Path) -> None:
        """See `Output.remove`."""
        with writing(folder):
            for path in self._files(folder):
                path.unlink()

    def listing(self, folder: Path) -> list[str]:
        """See `Output.listing`; of a series the first and the last."""
        names = sorted(str(path.relative_to(folder)) for path in self._files(folder))
        return names if len(names) < 2 else [f"{names[0]} ... {names[-1]} ({len(names)} files)"]

    def _files(self, folder: Path) -> Iterator[Path]:
        path = folder / self.file
        name = re.compile(rf"{re.escape(path.stem)}(_\d{{4,}})?{re.escape(path.suffix)}")
        for one in path.parent.iterdir() if path.parent.is_dir() else ():
            if name.fullmatch(one.name):
                yield one


class ExportWriter:
    """Makes an export when the run ends; see `Writer`.  All of it is collective."""

    def __init__(self, comm: MPI.Comm, output: Export, folder: Path) -> None:
        self._comm, self._output, self._folder = comm, output, folder

    def write(self, state: State) -> None:
        """See `Writer`; the state is in the run's own files."""

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        return {}

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; of what a run has written before it failed, too."""
        with stage("output"):
            for note in on_root(self._comm, self._export).notes:
                log.warning("%s: %s", self._output.file, note)

    def _export(self) -> Exported:
        from dolfin_elastic.results.finished.findings import modes_of
        from dolfin_elastic.results.finished.run import FinishedRun

        file = self._folder / self._output.file
        try:
            run = FinishedRun(self._folder)
            if not (run.frames or modes_of(run)):
                return Exported([], "")
            return export(run, file, self._output.settings)
        except InputError as error:  # it would hide how the run has ended
            raise OutputError(f"cannot write {file}: {error}") from None
