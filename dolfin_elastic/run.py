"""The pipe: case, body, problem, solver, results."""

from __future__ import annotations

import logging
from collections.abc import Generator, Mapping
from contextlib import closing
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, cast

from mpi4py import MPI

from dolfin_elastic import timing
from dolfin_elastic.case import Case, located
from dolfin_elastic.check import check
from dolfin_elastic.opening import opened
from dolfin_elastic.results.writer import ModeWriter, Writer
from dolfin_elastic.state import Mode, State

log = logging.getLogger("dolfin_elastic")
States = Generator[State | Mode, None, None]


def run(
    case: Case,
    *,
    output: str | PathLike[str] | None = None,
    petsc: Mapping[str, Any] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> States:
    """Solves a case and yields its states, and its modes, each written already.  Collective.

    Args:
        case: From `read_case`, or made in Python.
        output: Folder of the results; by default what the case says.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that work together.

    Raises:
        InputError: The case is wrong; nothing has been written.
        SolveError: No solution was found; the results so far are complete.
        OutputError: Results cannot be written.
    """
    timing.begin()
    with timing.stage("mesh"):
        body = case.read_body(comm)
    for note in body.notes:
        log.info("mesh: %s", note)
    for note in check(case, body):
        log.warning("%s", note)
    problem = case.make_problem(body)
    solver = case.make_solver(problem, petsc=petsc)
    folder = Path(output) if output is not None else case.results_folder()
    steps = cast(States, solver.steps())
    with located(case.file), closing(steps):
        first = next(steps)  # a fault that only shows at the start leaves no folder behind
        probe = case.output.probe(problem, case.mesh.scale)
        with opened(case.files(), problem, folder) as writers:
            for step in chain([first], steps):
                found = probe.onto(step) if isinstance(step, State) else step
                for writer in writers:
                    _write(writer, found)
                yield found


def _write(writer: Writer, found: State | Mode) -> None:
    if isinstance(found, State):
        writer.write(found)
    elif isinstance(writer, ModeWriter):
        writer.write_mode(found)
