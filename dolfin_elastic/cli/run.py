"""The commands that compute: `run` and `restart`, and how they are stopped."""
# ruff: noqa: D301

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from click.exceptions import Exit

from dolfin_elastic.core.errors import SolveError, StoppedError, check_kept
from dolfin_elastic.core.petsc_options import parse_arguments
from dolfin_elastic.core.signals import INTERRUPTED, Stop
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from mpi4py import MPI

    from dolfin_elastic.case.case import Case
    from dolfin_elastic.case.run import CaseRun, InTurn
    from dolfin_elastic.cli.console import ProgressDisplay
    from dolfin_elastic.problem.state import Mode, State

AUDIT_FAILED = 5
"""Exit code of a run that came to its end and is not to be relied on."""

CaseFile = Annotated[Path, typer.Argument(metavar="CASE", hidden=True)]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results.")
]
Petsc = Annotated[list[str] | None, typer.Argument(metavar="[-- PETSC...]", hidden=True)]
Profile = Annotated[bool, typer.Option("--profile", help="Show where time and memory went.")]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Let a .geo script of your own run commands and write files."),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show only problems.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Show every attempt at a step.")]
Json = Annotated[
    bool, typer.Option("--json", help="Print problems only, and summary.json at the end.")
]


def run(
    case: CaseFile,
    petsc: Petsc = None,
    *,
    output: Output = None,
    profile: Profile = False,
    trust: Trust = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    """Compute a case file (TOML).

    \b
      dolfin-elastic run beam.toml
      dolfin-elastic run beam.toml --output /scratch/beam --profile
      mpirun -n 4 dolfin-elastic run beam.toml -- -ksp_type gmres -log_view

    Results go to CASE_results (fields for ParaView, history.csv, summary.json) unless the case or
    --output says otherwise; several analyses of a case have a folder each in it.
    Ctrl-C, SIGTERM, SIGUSR2, or a file called `stop` in that folder stop it with a checkpoint of
    the last complete step, from which `restart` goes on; SIGUSR1 makes a checkpoint and no stop.
    What follows two dashes are PETSc options; they win over the case's own.
    """
    options, at_start = parse_arguments(petsc or [])
    start(at_start)
    from dolfin_elastic.case.check.rest import read_case
    from dolfin_elastic.case.run import InTurn

    shown = _Shown(quiet=quiet or json, verbose=verbose, json=json, profile=profile)
    comm = begin(shown.quiet, verbose=verbose)
    read = read_case(case, comm=comm, trust=trust)
    folder = output if output is not None else read.results_folder()
    check_kept(folder, "--output" if output is not None else "output.folder")
    _compute_all(InTurn(read.analyses(), folder, options, comm), shown, comm)


def compute_case(case: Path, comm: MPI.Comm, *, quiet: bool) -> None:
    """Computes a case file as `run` does; leaves with an exit code that is not 0. Collective."""
    from dolfin_elastic.case.check.rest import read_case
    from dolfin_elastic.case.run import InTurn

    read = read_case(case, comm=comm)
    folder, options = read.results_folder(), parse_arguments([])[0]
    check_kept(folder, "output.folder")
    shown = _Shown(quiet=quiet, verbose=False, json=False, profile=False)
    _compute_all(InTurn(read.analyses(), folder, options, comm), shown, comm)


def restart(
    folder: Annotated[Path, typer.Argument(metavar="DIR", hidden=True)],
    petsc: Petsc = None,
    *,
    profile: Profile = False,
    trust: Trust = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    """Go on with a run that was stopped or killed.

    \b
      dolfin-elastic restart beam_results
      mpirun -n 8 dolfin-elastic restart beam_results      whatever it began on

    DIR is the folder of its results; it goes on from the last checkpoint there, and the results
    go on with it, as do the analyses of the case that come after it.  PETSc options of the first
    run hold; those after two dashes win over them.
    """
    options, at_start = parse_arguments(petsc or [])
    start(at_start)
    from dolfin_elastic.case.restart import unfinished
    from dolfin_elastic.case.run import InTurn

    shown = _Shown(quiet=quiet or json, verbose=verbose, json=json, profile=profile)
    comm = begin(shown.quiet, verbose=verbose)
    checkpoint = unfinished(folder, comm=comm, trust=trust)
    logging.getLogger("dolfin_elastic").info("%s", checkpoint.message())
    shown.since = checkpoint.step
    _compute_all(InTurn.going_on(checkpoint, options), shown, comm)


def begin(quiet: bool, *, verbose: bool = False) -> MPI.Comm:
    """Shows log messages from now on; all ranks.

    Args:
        quiet: Warnings only.
    """
    from mpi4py import MPI

    collect_garbage()
    level = logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO
    log_to_screen(MPI.COMM_WORLD.rank, level)
    return MPI.COMM_WORLD


def collect_garbage() -> None:
    """Looks for garbage from now on, but not among what importing has made; see `main`."""
    gc.freeze()
    gc.enable()


@dataclass
class _Shown:
    """What the command line shows of a run.

    Attributes:
        quiet: Show problems only.
        verbose: Show every trial of a step.
        json: Print the summary at the end.
        profile: Show time and memory per stage.
        since: Step from which it is restarted.
    """

    quiet: bool
    verbose: bool
    json: bool
    profile: bool
    since: int = 0


def _compute_all(runs: InTurn, shown: _Shown, comm: MPI.Comm) -> None:
    """Computes and shows the analyses of a case; leaves with the first exit code that is not 0.

    Collective.
    """
    from dolfin_elastic.cli import console

    codes: dict[str, int] = {one.case.analysis: 0 for one in runs.runs}
    summaries = dict[str, str]()
    try:
        with closing(runs):
            for one in runs:
                if runs.several and comm.rank == 0 and not shown.quiet:
                    of = f"({list(codes).index(one.case.analysis) + 1} of {len(codes)})"
                    console.console().print(f"{one.case.analysis} {of}", style="bold")
                with runs.trying(one):
                    codes[one.case.analysis] = _compute(one, shown, comm, summaries)
                if INTERRUPTED in codes.values():
                    break
                shown.since = 0
    finally:
        if summaries:
            each = ",\n".join(f'"{name}": {text.strip()}' for name, text in summaries.items())
            print(f"{{{each}}}" if runs.runs[0].around else each.partition(": ")[2], flush=True)
    for name, error in runs.errors.items():
        codes[name] = error.exit_code
    if ends := [code for code in codes.values() if code]:
        raise Exit(INTERRUPTED if INTERRUPTED in ends else ends[0])


def _compute(run: CaseRun, shown: _Shown, comm: MPI.Comm, summaries: dict[str, str]) -> int:
    """Computes and shows a run; returns its exit code, and its summary for --json. Collective."""
    from dolfin_elastic.results.writers.summary import mark_stopped

    case, folder, visible = run.case, run.folder, comm.rank == 0 and not shown.quiet
    stop = Stop(folder, partial(mark_stopped, folder.absolute()), around=run.around)
    before = _written(folder)
    code = INTERRUPTED
    try:
        code = _follow(run, run.states(asked=stop.wants_checkpoint), stop, shown, comm)
    except StoppedError:
        stop.acknowledge()
    except SolveError as error:
        error.add_note(f"results so far are in {folder}")
        raise
    finally:
        # A run that was refused leaves the summary of an earlier one as it is.
        if shown.json and comm.rank == 0 and _written(folder) != before:
            summaries[case.analysis] = _summary(folder)
    if shown.profile:
        _show_profile(comm)
    if visible:
        from dolfin_elastic.cli.console import show_files, show_restart

        if code != INTERRUPTED:
            _show_verdict(folder, motion=case.dynamics is not None)
        if folder.is_dir():
            show_files(folder, case.listing(folder))
        if code == INTERRUPTED:
            show_restart(folder, run.around)
    return code


def _show_verdict(folder: Path, *, motion: bool) -> None:
    """Prints the verdict; of a motion its largest stresses, which statics logs."""
    from dolfin_elastic.cli.console import TYPED
    from dolfin_elastic.results.finished.findings import lines_of_motion

    summary = loads(_summary(folder) or "{}")
    for line in lines_of_motion(summary) if motion else ():
        print(f" {line.translate(TYPED)}")
    verdict = summary.get("verdict")
    if verdict and not (motion and verdict["kind"] == "result"):
        print(verdict["text"].translate(TYPED))


def _written(folder: Path) -> tuple[int, int] | None:
    """What changes whenever a summary is written; None where there is none."""
    try:
        status = (folder / "summary.json").stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def _summary(folder: Path) -> str:
    """The summary of a run, as it stands in the folder; empty where there is none."""
    path = folder / "summary.json"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _follow(
    run: CaseRun,
    states: Generator[State | Mode, None, None],
    stop: Stop,
    shown: _Shown,
    comm: MPI.Comm,
) -> int:
    """Computes a run to its end, or until it is stopped; returns the exit code. Collective."""
    from dolfin_elastic.cli import console
    from dolfin_elastic.core import timing
    from dolfin_elastic.problem.state import Mode

    case, visible = run.case, comm.rank == 0 and not shown.quiet
    progress = _progress_display(case, visible, verbose=shown.verbose)
    state, newton, most, modes = None, 0, 0.0, []
    with closing(progress), closing(states) as results:
        for result in results:
            if isinstance(result, Mode):
                modes.append(result)
            else:
                state = result
                newton += state.newton
                most = max(most, state.max_displacement)
                progress.show(state)
            if result.done < 1.0 and stop.agreed(comm):
                return INTERRUPTED
    if visible and modes:
        from dolfin_elastic.cli.console_modes import show_modes

        show_modes(modes, loads(_summary(run.folder))["modes"], timing.totals())
    elif visible and state is not None:
        console.show_end(
            state,
            motion=case.dynamics is not None,
            seconds=timing.totals(),
            newton=newton,
            since=shown.since,
            most=most,
        )
    if state is None or not state.failure:
        return 0
    if shown.quiet:
        logging.getLogger("dolfin_elastic").error("audit FAIL: %s", state.failure)
    return AUDIT_FAILED


def _progress_display(case: Case, visible: bool, *, verbose: bool) -> ProgressDisplay:
    """A bar on a terminal, lines in a file or pipe, nothing if not visible."""
    from dolfin_elastic.cli import console
    from dolfin_elastic.results.verdict import follows_curves

    if not visible:
        return console.ProgressDisplay()
    handlers = logging.getLogger("dolfin_elastic").handlers
    handler = next((one for one in handlers if isinstance(one, console.LogHandler)), None)
    timed, curves = case.timed, follows_curves(case.to_dict())
    display: ProgressDisplay = console.ProgressLines(timed, curves)
    if handler is not None and handler.screen.is_terminal and sys.stdout.isatty():
        display = console.ProgressBar(timed, handler.screen, curves)
        handler.print_above_bar()
    if handler is not None and not verbose:
        handler.show_searches(display)
    return display


def _show_profile(comm: MPI.Comm) -> None:
    """Prints time per stage and peak memory. Collective."""
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
    """Prints what the package logs, on rank 0.

    Args:
        level: Lowest level that is shown, of `logging`.
    """
    from dolfin_elastic.cli.console import LogHandler, console

    log = logging.getLogger("dolfin_elastic")
    log.handlers = [LogHandler(rank, lambda: console(stderr=True))]
    log.setLevel(level)
    log.propagate = False
