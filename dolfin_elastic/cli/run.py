"""The commands that compute: `run` and `restart`, and how they are stopped."""
# ruff: noqa: D301

from __future__ import annotations

import logging
import sys
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from click.exceptions import Exit

from dolfin_elastic.core.errors import SolveError
from dolfin_elastic.core.petsc_options import parse_arguments, start_petsc
from dolfin_elastic.core.signals import INTERRUPTED, Stop

if TYPE_CHECKING:
    from mpi4py import MPI

    from dolfin_elastic.case.case import Case
    from dolfin_elastic.problem.state import Mode, State

Petsc = Annotated[list[str] | None, typer.Argument(metavar="[-- PETSC...]", hidden=True)]
Profile = Annotated[bool, typer.Option("--profile", help="Show where time and memory went.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show only problems.")]


def run(
    case: Annotated[Path, typer.Argument(metavar="CASE", hidden=True)],
    petsc: Petsc = None,
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results.")
    ] = None,
    profile: Profile = False,
    quiet: Quiet = False,
) -> None:
    """Compute a case file (TOML).

    \b
      dolfin-elastic run beam.toml
      dolfin-elastic run beam.toml --output /scratch/beam --profile
      mpirun -n 4 dolfin-elastic run beam.toml -- -ksp_type gmres -log_view

    Results go to CASE_results (fields for ParaView, history.csv, summary.json) unless the case or
    --output says otherwise.  Ctrl-C, SIGTERM, SIGUSR2, or a file called `stop` in that folder stop
    it after the current step, with a checkpoint from which `restart` goes on; SIGUSR1 makes a
    checkpoint and no stop.
    What follows two dashes are PETSc options; they win over the case's own.
    """
    options, at_start = parse_arguments(petsc or [])
    start_petsc(at_start)
    from dolfin_elastic.case.case import read_case
    from dolfin_elastic.case.run import run as run_case

    comm = _begin(quiet)
    read = read_case(case, comm=comm)
    folder = output if output is not None else read.results_folder()

    stop = Stop(folder)
    states = run_case(read, output=folder, petsc=options, asked=stop.wants_checkpoint)
    _compute(_Job(read, folder, states, stop, quiet=quiet, profile=profile), comm)


def restart(
    folder: Annotated[Path, typer.Argument(metavar="DIR", hidden=True)],
    petsc: Petsc = None,
    *,
    profile: Profile = False,
    quiet: Quiet = False,
) -> None:
    """Go on with a run that was stopped or killed.

    \b
      dolfin-elastic restart beam_results
      mpirun -n 8 dolfin-elastic restart beam_results      whatever it began on

    DIR is the folder of its results; it goes on from the last checkpoint there, and the results
    go on with it.  PETSc options of the first run hold; those after two dashes win over them.
    """
    options, at_start = parse_arguments(petsc or [])
    start_petsc(at_start)
    from dolfin_elastic.case.restart import unfinished
    from dolfin_elastic.case.run import restart as restart_case

    comm = _begin(quiet)
    found = unfinished(folder, comm=comm)
    logging.getLogger("dolfin_elastic").info("%s", found.message())

    stop = Stop(folder)
    states = restart_case(found, petsc=options, asked=stop.wants_checkpoint)
    job = _Job(found.case, folder, states, stop, quiet=quiet, profile=profile, since=found.step)
    _compute(job, comm)


def _begin(quiet: bool) -> MPI.Comm:
    from mpi4py import MPI

    log_to_screen(MPI.COMM_WORLD.rank, logging.WARNING if quiet else logging.INFO)
    return MPI.COMM_WORLD


@dataclass
class _Job:
    """A run as the command line shows it.

    Attributes:
        case: What is computed.
        folder: Of the results.
        states: What is yielded.
        stop: Who may stop it.
        quiet: Only problems are shown.
        profile: Where the time went is shown.
        since: Step that it goes on from.
    """

    case: Case
    folder: Path
    states: Generator[State | Mode, None, None]
    stop: Stop
    quiet: bool
    profile: bool
    since: int = 0


def _compute(job: _Job, comm: MPI.Comm) -> None:
    """Runs a case, shows it, and ends with its exit code. Collective."""
    loud = comm.rank == 0 and not job.quiet
    code = _followed(job, comm, loud=loud)
    if job.profile:
        _show_profile(comm)
    if loud:
        from dolfin_elastic.cli.console import show_files, show_restart

        show_files(job.folder, job.case.listing(job.folder))
        if code == INTERRUPTED:
            show_restart(job.folder)
    if code:
        raise Exit(code)


def _followed(job: _Job, comm: MPI.Comm, *, loud: bool) -> int:
    """Follows a run to its end, or until it is stopped; returns the exit code."""
    from contextlib import closing

    from dolfin_elastic.cli import console
    from dolfin_elastic.cli.console_modes import show_modes
    from dolfin_elastic.core import timing
    from dolfin_elastic.problem.state import Mode

    motion = job.case.dynamics is not None
    meter = _meter(motion, loud)
    state, newton, modes = None, 0, []
    try:
        with closing(job.states) as found:
            for one in found:
                if isinstance(one, Mode):
                    modes.append(one)
                else:
                    state = one
                    newton += state.newton
                    meter.show(state)
                if one.done < 1.0 and job.stop.agreed(comm):
                    return INTERRUPTED
    except SolveError as error:
        error.add_note(f"results so far are in {job.folder}")
        raise
    finally:
        meter.close()
    if loud and modes:
        show_modes(modes, timing.totals())
    elif loud and state is not None:
        console.show_end(
            state, motion=motion, seconds=timing.totals(), newton=newton, since=job.since
        )
    return 0


def _meter(motion: bool, loud: bool) -> Any:
    from dolfin_elastic.cli import console

    if not loud:
        return console.Silent()
    shared = next(
        (
            handler.screen
            for handler in logging.getLogger("dolfin_elastic").handlers
            if isinstance(handler, console.Handler)
        ),
        None,
    )
    if shared is not None and shared.is_terminal and sys.stdout.isatty():
        return console.Bar(motion, shared)
    return console.Lines(motion)


def _show_profile(comm: MPI.Comm) -> None:
    """Collective."""
    from dolfin_elastic.cli import console
    from dolfin_elastic.core import timing
    from dolfin_elastic.core.parallel import largest, smallest
    from dolfin_elastic.results.writers.summary import peak_memory

    seconds = timing.totals()
    rows = [
        (name, smallest(comm, seconds[name]), largest(comm, seconds[name]))
        for name in [n for n in seconds if n != "total"] + ["total"]
    ]
    memory = peak_memory(comm)
    if comm.rank == 0:
        console.show_profile(rows, memory)


def log_to_screen(rank: int, level: int) -> None:
    """Shows what is logged, on rank 0."""
    from dolfin_elastic.cli.console import Handler, console

    log = logging.getLogger("dolfin_elastic")
    log.handlers = [Handler(rank, console(stderr=True))]
    log.setLevel(level)
    log.propagate = False
