"""The command `sweep`: its options, its lines and table, and its exit code."""
# ruff: noqa: D301

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from contextlib import closing
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from click.exceptions import Exit

from dolfin_elastic.cli.run import AUDIT_FAILED, CaseFile, Output, Petsc, Quiet, Trust, begin
from dolfin_elastic.core.errors import InputError, StoppedError, check_kept
from dolfin_elastic.core.petsc_options import parse_arguments
from dolfin_elastic.core.signals import INTERRUPTED, Stop
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.study.sweep.rows import Row
    from dolfin_elastic.study.sweep.sweep import Sweep
    from dolfin_elastic.study.sweep.table import Results

_OF_MPI = ("PMIX_", "PRTE_", "OMPI_COMM_", "OMPI_UNIVERSE", "PMI_", "SLURM_")
"""Variables by which a launcher tells a process that it is one of several ranks."""
_MOST_ROWS, _MOST_SHOWN = 40, 3
"""Rows and results of the table on the terminal; the file has all of them."""
_PAGE = "sweep.html"


def sweep(
    case: CaseFile,
    petsc: Petsc = None,
    *,
    settings: Annotated[
        list[str],
        typer.Option("--set", metavar='KEY="A,B"', help="A key of the case and its values."),
    ],
    tell: Annotated[
        list[str] | None,
        typer.Option("--tell", metavar="RESULT", help='A result to tell: "von_mises on hole".'),
    ] = None,
    together: Annotated[
        bool, typer.Option("--zip", help="First values together, second ones together, ...")
    ] = False,
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=2, metavar="N", help="Samples of what scatters (20)."),
    ] = None,
    sobol: Annotated[
        int | None,
        typer.Option("--sobol", min=2, metavar="N", help="Sobol's indices by N (d + 2) runs."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the samples.")] = 0,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, metavar="N", help="Runs at the same time.")
    ] = 1,
    slurm: Annotated[
        Path | None,
        typer.Option("--slurm", metavar="FILE", help="Write an array job; compute nothing."),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Compute again what has failed before.")
    ] = False,
    row: Annotated[int | None, typer.Option("--row", min=1, metavar="K", hidden=True)] = None,
    worker: Annotated[bool, typer.Option("--worker", hidden=True)] = False,
    output: Output = None,
    trust: Trust = False,
    quiet: Quiet = False,
) -> None:
    """Compute a case again and again with other values, and put the results into one table.

    \b
      dolfin-elastic sweep mount.toml --set materials.rubber.E="1 MPa,2 MPa" \\
                                      --set mesh.size="4 mm,2 mm"      each with each
      dolfin-elastic sweep bracket.toml --set load[0].value[2]="-1 kN,-2 kN" --jobs 2
      dolfin-elastic sweep bracket.toml --set materials.steel.E="normal(210 GPa, 3 %)" \\
                                        --samples 40 --tell "von_mises on fillet"

    KEY is a key of the case file with dots, numbers of rows in brackets or their names.  Values
    are separated by commas; normal(MEAN, DEVIATION), lognormal(...) and uniform(FROM, TO) scatter,
    and normal(3 %) does so around the case's own value.
    RESULT is as `converge --until` takes it, a column of history.csv, or frequency_1; by default
    those by which a part is judged, and probes.
    The table, a plot and a folder for each run go to CASE_sweep.  What is there already is not
    computed again, also after a kill; a run that fails stays in the table with its cause, and
    --retry computes it again.
    """
    options, at_start = parse_arguments(petsc or [])
    start(at_start)
    from dolfin_elastic.case.check.rest import read_case
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.study.sweep.settings import design, read_setting, with_means
    from dolfin_elastic.study.sweep.sweep import planned

    comm = begin(quiet=True)
    read = read_case(case, comm=comm, trust=trust)
    folder = output if output is not None else read.folder_beside("sweep")
    check_kept(folder, "--output" if output is not None else "output.folder")
    if comm.size > 1 and jobs > 1:
        raise InputError(
            f"{comm.size} ranks compute one run after the other together",
            where="--jobs",
            expected="--jobs without mpirun, or mpirun without --jobs",
        )
    means = with_means(read, [read_setting(*_split(text)) for text in settings])
    plan = design(means, together=together, samples=samples, sobol=sobol, seed=seed)
    sweeping = planned(
        read,
        plan,
        output=folder,
        tell=tell or (),
        petsc=options,
        # Of several processes the first one has said it already, and a task is about its own row.
        retry=lambda one: retry and not worker and slurm is None and row in (None, one.number),
        comm=comm,
    )
    visible = comm.rank == 0 and not quiet
    if slurm is not None:
        on_root(comm, partial(_write_slurm, slurm, len(sweeping.rows)))
        return
    if visible and not worker:
        print(_headline(sweeping), flush=True)
    stop = Stop(folder)
    stopped, lost = False, 0
    try:
        if jobs > 1 and not worker:
            lost = _in_processes(jobs, stop)
        else:
            _one_by_one(sweeping, row, visible=visible, alone=worker or row is not None)
    except StoppedError:
        stop.acknowledge()
        stopped = True
    if not worker and row is None:
        _end(sweeping, visible=visible, stopped=stopped)
    if stopped:
        raise Exit(INTERRUPTED)
    if lost:
        raise Exit(lost)


def _split(text: str) -> tuple[str, str]:
    """Key and values of an option.

    Raises:
        InputError: There is no equals sign.
    """
    key, sign, values = text.partition("=")
    if not sign or not key.strip():
        raise InputError(
            f"'{text}' gives no key a value",
            where="--set",
            expected='for example --set materials.steel.E="200 GPa,210 GPa"',
        )
    return key.strip(), values


def _headline(sweeping: Sweep) -> str:
    from dolfin_elastic.core.si_text import counted

    of = [
        f"{one.key} ({one.spread.kind if one.spread else counted(len(one.values), 'value')})"
        for one in sweeping.design.settings
    ]
    done = sum(row.ended for row in sweeping.rows)
    known = f", {done} of them known" if done else ""
    return f"{counted(len(sweeping.rows), 'run')}{known}: {', '.join(of)}"


def _one_by_one(sweeping: Sweep, only: int | None, *, visible: bool, alone: bool) -> None:
    """Computes and shows rows. Collective.

    Args:
        alone: Without the table, which another process writes.
    """
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.study.sweep.table import TableAtTimes

    comm, table = sweeping.comm, TableAtTimes()
    with closing(sweeping.run(only)) as rows:
        for row in rows:
            if visible:
                print(_line(sweeping, row), flush=True)
            if not alone:
                on_root(comm, partial(table.write, sweeping.so_far))


def _line(sweeping: Sweep, row: Row) -> str:
    """One run, when it has ended."""
    from dolfin_elastic.cli.console import TYPED
    from dolfin_elastic.core.si_text import percent, quantity
    from dolfin_elastic.study.sweep.numbers import unit_of
    from dolfin_elastic.study.sweep.settings import short_names, worded

    settings = sweeping.design.settings
    short = short_names([one.key for one in settings])
    of = ", ".join(f"{short[one.key]} = {worded(row.values[one.key], one)}" for one in settings)
    numbers = [
        f"{name} {quantity(value, unit_of(name))}"
        + (f" ± {percent(row.errors[name])}" if row.errors.get(name, -1.0) >= 0.0 else "")
        for name, value in list(row.numbers.items())[:_MOST_SHOWN]
        if isfinite(value)
    ]
    if row.cause:
        numbers.insert(0, f"{row.status}: {row.cause.partition(chr(10))[0]}")
    return f"{row.number:>4} of {len(sweeping.rows)}  {of}: {', '.join(numbers)}".translate(TYPED)


def _end(sweeping: Sweep, *, visible: bool, stopped: bool) -> None:
    """Writes and shows the table; leaves with an exit code if no row is to be relied on."""
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.study.sweep.table import write_table

    results = sweeping.results()
    title = str(sweeping.case.title or sweeping.case.name)
    on_root(sweeping.comm, partial(write_table, results, plot=True))
    on_root(sweeping.comm, partial(_write_page, results, title))
    if visible:
        _show(results)
    if stopped:
        return
    results.check()
    if all(row.status in ("audit", "failed") for row in results.rows):
        raise Exit(AUDIT_FAILED)


def _write_page(results: Results, title: str) -> None:
    """Writes the page of all runs. On rank 0."""
    from dolfin_elastic.report.sweep_page import write_sweep_page
    from dolfin_elastic.study.sweep.table import PLOT

    texts, plot = results.texts(), results.folder / PLOT
    write_sweep_page(
        results.folder / _PAGE,
        title,
        list(texts),
        list(zip(*texts.values(), strict=True)),
        lines=[*results.remarks(), *results.lines()],
        causes=[f"run {row.number}: {row.cause}" for row in results.failed],
        picture=plot if plot.is_file() else None,
    )


def _show(results: Results) -> None:
    """Prints the table, what samples say, and what was written."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from dolfin_elastic.cli.console import TYPED, console, show_files, show_table
    from dolfin_elastic.core.si_text import counted
    from dolfin_elastic.study.sweep.table import FILES, TABLE

    texts, table = results.texts(_MOST_SHOWN, errors=False), Table(box=SIMPLE_HEAD, pad_edge=False)
    for head in texts:
        table.add_column(head, justify="left" if head == "status" else "right")
    for row in list(zip(*texts.values(), strict=True))[:_MOST_ROWS]:
        table.add_row(*row)
    screen = console()
    show_table(screen, table)
    if len(results.rows) > _MOST_ROWS:
        screen.tell(f"{len(results.rows) - _MOST_ROWS} further rows are in the file")
    for line in (*results.remarks(), *results.lines()):
        screen.tell(line.translate(TYPED))
    if results.failed:
        screen.tell(f"{counted(len(results.failed), 'run')} without a solution: `cause` in {TABLE}")
    if results.missing:
        screen.tell(f"{counted(results.missing, 'run')} not computed: the same command goes on")
    present = [name for name in (*FILES, _PAGE) if (results.folder / name).is_file()]
    show_files(results.folder, [*present, f"{results.rows[0].folder} ..."])


# --- several processes ---


def _in_processes(jobs: int, stop: Stop) -> int:
    """Computes rows in processes of their own, each of one rank, until all have ended.

    Returns:
        The first exit code that is not 0.

    Raises:
        StoppedError: A signal has asked for the end; the processes have ended, too.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(_OF_MPI)}
    environment.setdefault("OMP_NUM_THREADS", "1")
    command = [sys.executable, "-P", "-m", "dolfin_elastic", "sweep", "--worker", *sys.argv[2:]]
    running = [subprocess.Popen(command, env=environment) for _ in range(jobs)]
    try:
        while any(process.poll() is None for process in running):
            if stop.asked_here():
                raise StoppedError("a signal has asked for the end")
            time.sleep(0.05)
    finally:
        for process in running:
            if process.poll() is None:
                process.terminate()
        codes = [abs(process.wait()) for process in running]  # a signal is negative
    if INTERRUPTED in codes:
        raise StoppedError("a signal has asked for the end")
    worst = next((code for code in codes if code), 0)
    if worst:
        log = logging.getLogger("dolfin_elastic")
        log.warning("a process of the sweep has ended with exit code %d", worst)
    return worst


# --- on a cluster ---


def _write_slurm(path: Path, count: int) -> None:
    """Writes an array job of Slurm, a run each. On rank 0.

    Raises:
        OutputError: It cannot be written.
    """
    import shlex

    from dolfin_elastic.results.files import replace_text

    words, left = sys.argv[1:], ("--slurm", "--jobs", "-j")
    kept = [
        word
        for before, word in zip(["", *words], words, strict=False)
        if not (before in left or word in left or word.startswith(("--slurm=", "--jobs=")))
    ]
    again = shlex.join(["dolfin-elastic", *(word for word in kept if word != "--retry")])
    one, rest = shlex.join(["dolfin-elastic", kept[0]]), shlex.join(kept[1:])
    text = f"""\
#!/bin/bash
#SBATCH --job-name=sweep
#SBATCH --array=1-{count}
#SBATCH --ntasks=1
# Each task computes one run, on as many ranks as --ntasks says.  When all have ended,
#   {again}
# computes nothing that is there already, and writes the table.
export OMP_NUM_THREADS=1
srun {one} --row "$SLURM_ARRAY_TASK_ID" {rest}
"""
    replace_text(path, text)
    print(f"{path} written: sbatch {path}, and then the same command without --slurm")
