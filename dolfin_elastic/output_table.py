"""The table [output]: what is written, where, and how often, and how all of it is opened."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator

from dolfin_elastic.errors import (
    ElasticError,
    InputError,
    MeshError,
    OutputError,
    SolveError,
    nearest,
)
from dolfin_elastic.meshes import Body
from dolfin_elastic.meshes.places import locate
from dolfin_elastic.parallel import on_root
from dolfin_elastic.problem import Problem
from dolfin_elastic.results.checkpoints import Checkpoint
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.outputs import History, Picture, Summary, Xdmf
from dolfin_elastic.results.outputs import Output as File
from dolfin_elastic.results.probes import Probe, ProbePoint
from dolfin_elastic.results.writer import Writer
from dolfin_elastic.results.xdmf import remove
from dolfin_elastic.schema import Record, within
from dolfin_elastic.state import State

log = logging.getLogger("dolfin_elastic")
Count = Annotated[int, Field(gt=0)]
_FAILED = "failed_state.xdmf"


class Output(Record):
    """The table [output]: what is written, where, and how often.

    Attributes:
        folder: Folder of the results, relative to the case file's; by default the case file's
            name with "_results", in the folder where the run is started.
        fields: Fields for ParaView; by default displacement and stresses.
        every: Fields are written every so many steps, and at the end; by default every step, with
            an explicit scheme about 200 states.
        pictures: Pictures of the deformed body.
        probes: Name to a point of the undeformed body, where fields are read off at every step.
        checkpoint: When all is written that a run needs to go on; false: never.
    """

    folder: str | None = None
    fields: tuple[str, ...] | None = None
    every: Count | None = None
    pictures: list[Picture] = Field(default=[])
    probes: dict[str, ProbePoint] = Field(default={})
    checkpoint: Checkpoint = Checkpoint()

    @field_validator("fields")
    @classmethod
    def _known(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for index, name in enumerate(names or ()):
            if name not in FIELDS:
                raise InputError(
                    f"unknown field '{name}'", where=f"[{index}]", expected=nearest(name, FIELDS)
                )
        return names

    def check_probes(self, body: Body, scale: float) -> None:
        """Finds the probes' points in the body. Collective.

        Raises:
            MeshError: A point lies outside, or has too few coordinates.
        """
        try:
            locate(body, {name: probe.place(scale) for name, probe in self.probes.items()})
        except MeshError as error:
            raise within("output.probes", error) from None

    def probe(self, problem: Problem, scale: float) -> Probe:
        """What reads the fields off. Collective.

        Args:
            problem: The problem that is solved.
            scale: Metres per unit of the mesh.
        """
        points = {name: probe.place(scale) for name, probe in self.probes.items()}
        return Probe(problem, points, {n: probe.fields for n, probe in self.probes.items()})

    def files(self, frames: int | None = None, title: str = "") -> list[File]:
        """Everything that is written.

        Args:
            frames: Thins the fields unless `every` says how.
            title: Of pictures that have none of their own.
        """
        every = {"frames": frames} if self.every is None else {"every": self.every}
        pictures = [
            p if p.title is not None else p.model_copy(update={"title": title})
            for p in self.pictures
        ]
        return [Xdmf(fields=self.fields, **every), History(), *pictures, Summary()]

    def listing(self, folder: Path) -> list[str]:
        """What a run has written to its folder, as a user reads it. Not collective."""
        return sorted({name for file in self.files() for name in file.listing(folder)})

    @contextmanager
    def opened(
        self,
        problem: Problem,
        folder: Path,
        files: Sequence[File],
        kept: Sequence[Mapping[str, Any]] | None = None,
    ) -> Iterator[list[Writer]]:
        """Opens all files and closes them with how it ended: completed, failed or stopped.

        Args:
            problem: The problem that is solved.
            folder: Of the results.
            files: From `files`.
            kept: What their writers said at the checkpoint that the run goes on from.
        """
        writers: list[Writer] = []
        ending: tuple[str, object] = ("completed", None)
        try:
            for index, file in enumerate(files):
                writers.append(
                    file.reopen(problem, folder, kept[index])
                    if kept is not None
                    else file.open(problem, folder)
                )
            on_root(problem.body.comm, lambda: remove(folder / _FAILED))
            yield writers
        except ElasticError as error:
            ending = ("failed", error)
            if isinstance(error, SolveError) and isinstance(error.state, State):
                try:
                    _write_failed(problem, folder, error.state)
                    error.add_note(f"the state that failed is in {folder / _FAILED}")
                except OutputError as second:
                    log.warning("%s", second)
            raise
        except GeneratorExit:
            ending = ("stopped", "on request")
            raise
        except BaseException:
            writers.clear()  # perhaps on this rank alone: closing together would wait for ever
            raise
        finally:
            _close(writers, ending)


def _close(writers: Iterable[Writer], ending: tuple[str, object]) -> None:
    """Closes all; a file that cannot be closed does not keep the others open, nor hide a cause."""
    fault: OutputError | None = None
    for writer in writers:
        try:
            writer.close(*ending)
        except OutputError as error:
            fault = fault or error
            log.warning("%s", error)
    if fault is not None and ending[0] == "completed":
        raise fault


def _write_failed(problem: Problem, folder: Path, state: State) -> None:
    """The state that is no solution, in a file of its own. Collective."""
    fields = ["displacement", "jacobian", "von_mises"]
    fields += ["residual"] * (state.v is None) + ["energy_density"] * problem.has_energy
    writer = Xdmf(file=_FAILED, fields=tuple(fields)).open(problem, folder)
    writer.write(state)
    writer.close("failed", None)
