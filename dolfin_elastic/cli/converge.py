"""The command `converge`: its options, its table, and its exit code."""
# ruff: noqa: D301

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from click.exceptions import Exit

from dolfin_elastic.cli.run import AUDIT_FAILED, CaseFile, Output, Petsc, Quiet, Trust, begin
from dolfin_elastic.core.errors import StoppedError, check_kept
from dolfin_elastic.core.petsc_options import parse_arguments
from dolfin_elastic.core.signals import INTERRUPTED, Stop
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.study.converge.report import Level, Progress

NOT_REACHED = 6


def converge(
    case: CaseFile,
    petsc: Petsc = None,
    *,
    until: Annotated[
        tuple[str, str],
        typer.Option(
            "--until", metavar="QUANTITY SHARE", help='Result and accuracy: "von_mises on hole" 3%.'
        ),
    ],
    refinements: Annotated[
        int,
        typer.Option("--refinements", min=1, metavar="N", help="Largest number of refinements."),
    ] = 8,
    unknowns: Annotated[
        float,
        typer.Option(
            "--unknowns",
            min=1,
            metavar="N",
            help="Largest number of unknowns of a mesh.",
            show_default="500 000",
        ),
    ] = 5e5,
    output: Output = None,
    trust: Trust = False,
    quiet: Quiet = False,
) -> None:
    """Refine the mesh of a static case until a result is accurate to, say, 3 %.

    \b
      dolfin-elastic converge bracket.toml --until "von_mises on fillet" 3%
      dolfin-elastic converge bracket.toml --until "displacement of tip" 1% --unknowns 2e6
      mpirun -n 4 dolfin-elastic converge bracket.toml --until strain_energy 0.1%

    QUANTITY is a field, whose largest value is meant, `FIELD on SURFACE` or `on REGION`,
    `displacement of PROBE`, `FIELD of PROBE`, `reaction of SUPPORT`, or a column of history.csv.
    Before FIELD may stand which number of it: max, min, mean, integral, percentile:95 (0 to 100),
    share_above:0.01 or size_above:0.01 (SI units).
    The mesh is refined where the estimated error is.  The table of all meshes, a plot and the
    results of the last one go to CASE_converged.  Exit code 6: not known as well as wanted.
    What stops `run` stops it, too, with the results of the last complete mesh and exit code 130.
    """
    options, at_start = parse_arguments(petsc or [])
    start(at_start)
    from dolfin_elastic.case.case import read_case
    from dolfin_elastic.results.writers.summary import mark_stopped
    from dolfin_elastic.study.converge.converge import Goal
    from dolfin_elastic.study.converge.converge import converge as converge_case
    from dolfin_elastic.study.wanted import Wanted, tolerance

    goal = Goal(Wanted.read(until[0]), tolerance(until[1]), refinements, int(unknowns))
    comm = begin(quiet)
    read = read_case(case, comm=comm, trust=trust)
    folder = output if output is not None else read.folder_beside("converged")
    check_kept(folder, "--output" if output is not None else "output.folder")
    visible = comm.rank == 0 and not quiet
    shown, progress = 0, None
    Stop(folder, partial(mark_stopped, folder.absolute()))
    try:
        with closing(converge_case(read, goal, output=folder, petsc=options, comm=comm)) as levels:
            for progress in levels:
                if visible and len(progress.levels) > shown:
                    shown = len(progress.levels)
                    print(_line(progress, progress.last), flush=True)
    except StoppedError:
        if progress is None:
            raise Exit(INTERRUPTED) from None
        progress = replace(progress, verdict="stopped", reason="stopped on request")
    assert progress is not None
    if visible:
        show_table_of(progress, folder)
    if progress.verdict == "stopped":
        raise Exit(INTERRUPTED)
    if progress.verdict != "reached":
        raise Exit(AUDIT_FAILED if progress.verdict == "audit" else NOT_REACHED)


def _line(progress: Progress, level: Level) -> str:
    """One mesh while it goes on."""
    return (
        f"mesh {level.number}: {level.cells} elements, {level.unknowns} unknowns, "
        f"{progress.quantity} {_with_unit(level.value, progress)}{_estimate(level)}"
    )


def _with_unit(value: float, progress: Progress) -> str:
    from dolfin_elastic.core.si_text import scaled_unit

    factor, unit = scaled_unit(value, progress.quantity.unit)
    return f"{value / factor:.5g} {unit}".rstrip()


def _estimate(level: Level) -> str:
    return f", estimated error {_percent(level.error)}" if math.isfinite(level.error) else ""


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if math.isfinite(share) else ""


def show_table_of(progress: Progress, folder: Path) -> None:
    """Prints the table of all meshes, the verdict, and what was written."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from dolfin_elastic.cli.console import console, show_files, show_table
    from dolfin_elastic.study.converge.report import FILES

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for head in ("mesh", "elements", "unknowns", progress.head, "estimated error", "in energy"):
        table.add_column(head, justify="right")
    for level in progress.levels:
        table.add_row(
            str(level.number),
            str(level.cells),
            str(level.unknowns),
            f"{level.value:.5g}",
            _percent(level.error),
            _percent(level.energy_error),
        )
    screen = console()
    show_table(screen, table)
    for line in _ending(progress):
        screen.tell(line)
    show_files(folder, [*FILES, "summary.json"])


def _ending(progress: Progress) -> list[str]:
    last, wanted = progress.last, _percent(progress.tolerance)
    value = f"{progress.quantity} = {_with_unit(last.value, progress)}{_estimate(last)}"
    lines = []
    if math.isfinite(last.limit):
        lines.append(f"extrapolated: {_with_unit(last.limit, progress)}")
    if progress.verdict == "reached":
        return [f"reached: {value} (wanted {wanted})", *lines]
    if progress.verdict == "singular":
        return [f"not reached: {progress.reason}"]
    return [f"not reached: {value}, wanted {wanted}; {progress.reason}", *lines]
