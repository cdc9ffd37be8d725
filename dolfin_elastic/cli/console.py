"""What the command line shows: progress, tables, log lines.  Only rank 0 shows anything.

Rich is imported by what draws: it takes 3 MB, and a rank that shows nothing needs none of it.
"""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import ElasticError, InputError, SolveError
from dolfin_elastic.core.si_text import counted, number, percent

if TYPE_CHECKING:
    from rich.padding import Padding
    from rich.table import Table

    from dolfin_elastic.case.described import Described
    from dolfin_elastic.cli.terminal import Screen
    from dolfin_elastic.problem.state import State

WIDTH = 100
TYPED = str.maketrans({"−": "-", "²": "^2", "³": "^3", "µ": "u", "±": "+-", "‘": "'", "’": "'"})
"""Signs of pages as they are typed, searched for, and printed by any terminal."""
_LEAST = 0.05
"""Share of a run that is to be done before the time left can be told."""
BETWEEN = 30.0
"""Seconds from one line to the next, at most, of a motion whose steps are all alike."""
FIRST_LINES = 20
"""Steps that get a line of their own in any case; later ones at most one a second."""


def console(*, stderr: bool = False) -> Screen:
    """A console that is as wide as the terminal, or 100 columns in a file."""
    from dolfin_elastic.cli.terminal import Screen

    stream = sys.stderr if stderr else sys.stdout
    # Launchers forward through terminals of their own: what arrives may well be a file.
    launched = "OMPI_COMM_WORLD_RANK" in os.environ or "PMI_RANK" in os.environ
    plain = launched or not stream.isatty()
    width, terminal = (WIDTH, False) if plain else (None, None)
    return Screen(stream, width, terminal)


# --- progress ---


class ProgressDisplay:
    """Shows the progress of a run, state by state; this one nothing, as others than rank 0 do."""

    def show(self, state: State) -> None:
        """Shows one state."""

    def search(self, text: str) -> None:
        """Shows a trial on the way to the next state, in place of the one before."""

    def close(self) -> None:
        """Ends the display."""


class Estimate:
    """Estimates the remaining time from the time per share of the run since the first state.

    Meshing and compiling are not counted: they are done once.
    """

    def __init__(self) -> None:
        self._known: list[tuple[float, float]] = []

    def left(self, done: float) -> str:
        """The remaining time as text, see `time_left`; empty where it may be twice as long.

        That is before a twentieth is done, and where the second half of the time so far has gone
        twice as fast or as slowly as all of it: the first steps may be hard ones.

        Args:
            done: Share of the run that is done.
        """
        seconds = timing.totals()
        setup = sum(seconds.get(name, 0.0) for name in ("mesh", "compile"))
        spent = seconds.get("total", 0.0) - setup
        self._known.append((spent, done))
        begin, before = self._known[0]
        half = begin + (spent - begin) / 2
        later = next((one for one in self._known[:-1] if one[0] >= half), self._known[-2:][0])
        share, recent = done - before, done - later[1]
        if share < _LEAST or recent <= 0 or spent <= later[0]:
            return ""
        faster = recent / (spent - later[0]) / (share / (spent - begin))
        return time_left(spent - begin, done, before) if 1 / 2 <= faster <= 2 else ""


class ProgressLines(ProgressDisplay):
    """One line a step, for files and pipes."""

    def __init__(self, motion: bool, curves: bool = False) -> None:
        self.motion, self.curves = motion, curves
        self._estimate, self._shown, self._count = Estimate(), 0.0, 0
        self._searching = False

    def search(self, text: str) -> None:
        """See `ProgressDisplay`; a file gets one line of a search."""
        if not self._searching:
            print(f"{text} ... (-v shows every trial)", flush=True)
        self._searching = True

    def show(self, state: State) -> None:
        """Shows one state."""
        self._searching = False
        now = time.monotonic()
        left = self._estimate.left(state.done)
        due = self._count < FIRST_LINES or now - self._shown > 1.0 or state.done >= 1.0
        if state.between:  # the first one tells that the run is alive
            due = self._count == 0 or now - self._shown >= BETWEEN
            left = left or f"  {100 * state.done:.2g} % done"
        if state.step and due:
            self._shown, self._count = now, self._count + 1
            text = step_text(state, motion=self.motion, curves=self.curves)
            print(f"{text}  {left}", flush=True)


class ProgressBar(ProgressDisplay):
    """A bar that moves, for terminals."""

    def __init__(self, motion: bool, screen: Screen, curves: bool = False) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        self.motion, self.curves, self._estimate = motion, curves, Estimate()
        self._progress = Progress(
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.description}", markup=False),
            console=screen,
        )
        self._task = self._progress.add_task("starting", total=1.0)
        self._progress.start()

    def show(self, state: State) -> None:
        """Shows one state."""
        left = self._estimate.left(state.done)
        line = step_text(state, motion=self.motion, curves=self.curves)
        text = re.sub("  +", "  ", f"{line}  {left}")
        self._progress.update(self._task, completed=state.done, description=text)

    def search(self, text: str) -> None:
        """See `ProgressDisplay`."""
        self._progress.update(self._task, description=f"searching: {text}")

    def close(self) -> None:
        """Ends the display."""
        self._progress.stop()


def step_text(state: State, *, motion: bool, curves: bool = False) -> str:
    """Step, time or load factor, iterations, largest displacement.

    Args:
        motion: It has a time; otherwise a load factor.
        curves: Loads follow curves over the load factor, so that it is no share of theirs.
    """
    factor = state.load_factor
    load = f"parameter {factor:.4g}" if curves else f"load {100 * factor:.4g} %"
    place = f"t {seconds_text(state.t, 5)} s" if motion else load
    counts = {"Newton": state.newton, "linear": state.krylov}
    equilibrium = not motion and state.step > 0  # its Newton iterations are shown even if 0
    work = ", ".join(
        f"{number} {name}"
        for name, number in counts.items()
        if number or (equilibrium and name == "Newton")
    )
    far = state.unit.length(state.max_displacement, 4)
    return f"step {state.step:>4}   {place:<15} {work:<20} max |u| {far}"


def seconds_text(t: float, digits: int) -> str:
    """A time [s] without its unit, "150" and not "1.5e+02"; with ASCII's minus, to be searched for.

    Args:
        t: The time [s].
    """
    return number(t, digits).translate(TYPED)


def time_left(spent: float, done: float, before: float = 0.0) -> str:
    """Estimate of the remaining time as text; empty before there is any.

    Args:
        spent: Time since the first state [s].
        done: Share of the run that is done now.
        before: Share that was done at the first state.
    """
    if not before < done < 1.0:
        return ""
    seconds = round(spent * (1.0 - done) / (done - before))
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    text = f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
    return f"  {text} left"


# --- log ---


class LogHandler(logging.Handler):
    """Prints log records of rank 0, warnings with the word in front.

    Trials on the way to a state are shown where the progress is, see `show_searches`; what belongs
    to the results goes where the rest of them is printed.

    Args:
        screen: Makes what it prints on, once there is something to print.
    """

    def __init__(self, rank: int, screen: Callable[[], Screen]) -> None:
        super().__init__()
        self._display: ProgressDisplay | None = None
        self._above_bar = False
        self.addFilter(lambda record: rank == 0 or hasattr(record, "every_rank"))
        self._make_screen = screen

    @cached_property
    def screen(self) -> Screen:
        """Where it prints."""
        return self._make_screen()

    def show_searches(self, display: ProgressDisplay) -> None:
        """Shows trials by this display from now on, in place of a line for each."""
        self._display = display

    def print_above_bar(self) -> None:
        """Prints results, too, on the terminal of the bar from now on: rich puts them above it."""
        self._above_bar = True

    def emit(self, record: logging.LogRecord) -> None:
        """Shows one record."""
        if self._display is not None and getattr(record, "search", False):
            self._display.search(record.getMessage())
            return
        mark = {logging.WARNING: "warning: ", logging.ERROR: "error: "}.get(record.levelno, "")
        apart = getattr(record, "result", False) and not self._above_bar
        (console() if apart else self.screen).tell(mark + record.getMessage())


# --- errors ---


def error_text(error: ElasticError) -> str:
    """An error with its notes; wrapped for a terminal, elsewhere where it is a `SolveError`."""
    from dolfin_elastic.cli.terminal import wrapped

    notes = "".join(f"\n  {note}" for note in getattr(error, "__notes__", ()))
    each = [one.text for one in error.each] if isinstance(error, InputError) else [str(error)]
    text, screen = "\n".join(f"error: {one}" for one in each) + notes, console(stderr=True)
    if screen.is_terminal:
        return wrapped(text, screen.width)
    return wrapped(text, WIDTH) if isinstance(error, SolveError) else text


# --- tables ---


def show_table(screen: Screen, table: Table | Padding) -> None:
    """Prints a table, in files without trailing blanks.

    Args:
        screen: Where to.
    """
    if screen.is_terminal:
        screen.print(table)
        return
    with screen.capture() as captured:
        screen.print(table)
    for line in captured.get().splitlines():
        screen.print(line.rstrip(), soft_wrap=True)


def show_tables(screen: Screen, tables: Sequence[Table]) -> None:
    """Prints tables with a blank line before each and behind the last.

    Args:
        screen: Where to.
    """
    from rich.padding import Padding

    for table in tables:
        table.show_edge = False
        show_table(screen, Padding(table, (1, 0, 0, 1)))
    if tables:
        screen.print()


def described_tables(rows: Sequence[Described]) -> list[Table]:
    """What supports, loads, contacts and ties do, in a table; none of none."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table("key", "on", "what it does", box=SIMPLE_HEAD, pad_edge=False)
    for row in rows:
        on = ", ".join(row.on) or "(whole body)"
        table.add_row(row.key, on, row.text.translate(TYPED))
    return [table] if rows else []


def show_end(
    state: State,
    *,
    motion: bool,
    seconds: Mapping[str, float],
    newton: int,
    since: int = 0,
    most: float = 0.0,
) -> None:
    """Prints a summary of a run.

    Args:
        motion: It has a time; otherwise a load factor.
        seconds: Time per stage, see `core/timing.py`.
        newton: Newton iterations of all steps.
        since: Step from which the run was restarted.
        most: Largest displacement of all states [m].
    """
    from rich.table import Table

    screen = console()
    table = Table(box=None, show_header=False, pad_edge=True)
    for name, value in _end_rows(state, motion, most):
        table.add_row(name, value)
    iterations = f", {counted(newton, 'Newton iteration')}" if newton else ""
    mine = f"{state.step - since} of them{iterations.replace(',', ' and')}"
    done = f"done: {counted(state.step, 'step')}"
    screen.print(f"{done}, {mine} since step {since}" if since else f"{done}{iterations}")
    show_table(screen, table)
    # Not in the table: the line is longer than a column may be.
    screen.tell(f" time: {_times(seconds)}")


_ENERGIES = {
    "damping": "dissipated by damping",
    "bulk_viscosity": "of it by bulk viscosity",
    "external": "work of loads and supports",
}


def _end_rows(state: State, motion: bool, most: float = 0.0) -> list[tuple[str, str]]:
    when = " at the end" if motion or state.max_displacement < most / 2 else ""
    rows = [(f"largest displacement{when}", state.unit.length(state.max_displacement, 5))]
    for name in ("strain", "kinetic", "contact", "total", *_ENERGIES):
        known = math.isfinite(state.energies.get(name, math.nan))
        nothing = name != "external" and name in _ENERGIES and not state.energies.get(name)
        if known and not nothing and (motion or name == "strain"):
            label = _ENERGIES.get(name, f"{name} energy")
            rows.append((label, f"{state.energies[name]:.5g} J"))
    largest = _force_scale(state)
    for name, force in state.reactions.items():
        rows.append((f"reaction of {name}", vector_text(force, largest) + " N"))
    for column, value in state.numbers.items():
        if column.startswith(head := "obstacle_displacement_"):
            rows.append(
                (f"displacement of {column.removeprefix(head)}", state.unit.length(value, 5))
            )
    if added := state.numbers.get("added_mass_fraction"):
        rows.append(("mass added by scaling", percent(added)))
    if (strain := state.numbers.get("max_plastic_strain")) is not None:
        share = percent(state.numbers["yielded_fraction"])
        rows.append(("yielded", f"{share} of the volume, plastic strain up to {strain:.3g}"))
    rows += _section_rows(state, largest)
    if state.stability is not None and state.stability.verdict == "unstable":
        rows.append(("stability", str(state.stability)))
    return rows + audit_rows(state)


def _section_rows(state: State, largest: float) -> list[tuple[str, str]]:
    """Forces and moments across sections."""
    result: dict[tuple[str, str], list[float]] = {}
    for column, value in state.numbers.items():
        for kind, unit in (("force", "N"), ("moment", "N m")):
            if column.startswith(head := f"section_{kind}_"):
                name = column.removeprefix(head).rpartition("_")[0]
                result.setdefault((f"{kind} at {name}", unit), []).append(value)
    return [
        (label, f"{vector_text(values, largest if unit == 'N' else 0.0)} {unit}")
        for (label, unit), values in result.items()
    ]


def _force_scale(state: State) -> float:
    """A force to which reactions are compared: the largest of them, or energy over displacement.

    The latter is where loads balance each other and all reactions are round-off.
    """
    largest = max((abs(float(v)) for force in state.reactions.values() for v in force), default=0.0)
    energy = state.energies.get("strain", math.nan)
    if math.isfinite(energy) and state.max_displacement > 0:
        largest = max(largest, energy / state.max_displacement)
    return largest


def audit_rows(state: State) -> list[tuple[str, str]]:
    """The worst of each check of a run, a failure first, or that all have passed."""
    reasons = state.audit.so_far or ("pass",) if state.audit is not None else ()
    if not state.failure:
        return [("audit", reason) for reason in reasons]
    return [("audit FAIL", state.failure), *(("audit", reason) for reason in reasons[1:])]


def vector_text(vector: Iterable[float], largest: float = 0.0) -> str:
    """Components with five digits; round-off of the others is shown as 0.

    Args:
        largest: Of what they are compared to, beside the largest of them.
    """
    parts = [float(v) for v in vector]
    limit = 1e-9 * max([largest, *map(abs, parts)])
    return "(" + ", ".join(f"{v:.5g}" if abs(v) > limit else "0" for v in parts) + ")"


def _times(seconds: Mapping[str, float]) -> str:
    total = seconds.get("total", 0.0)
    stages = [
        f"{name} {seconds_text(value, 2)}"
        for name, value in seconds.items()
        if name != "total" and value >= 0.005
    ]
    return f"{seconds_text(total, 3)} s" + (f" ({', '.join(stages)})" if stages else "")


def show_profile(rows: Sequence[tuple[str, float, float]], memory: Mapping[str, int]) -> None:
    """Prints time per stage and peak memory.

    Args:
        rows: Stage, and its time on the fastest and on the slowest rank [s].
        memory: "sum" over all ranks and "largest_rank" [byte].
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table("stage", box=SIMPLE_HEAD, pad_edge=False)
    for head in ("fastest rank [s]", "slowest rank [s]", "fraction"):
        table.add_column(head, justify="right")
    total = max((most for name, _, most in rows if name == "total"), default=0.0) or 1.0
    for name, least, most in rows:
        table.add_row(name, f"{least:.3f}", f"{most:.3f}", f"{100 * most / total:.0f} %")
    screen = console()
    show_table(screen, table)
    screen.print(
        f"peak memory {memory['sum'] / 1e6:.0f} MB together, "
        f"{memory['largest_rank'] / 1e6:.0f} MB on the largest rank"
    )


def show_files(folder: Path, names: Iterable[str]) -> None:
    """Prints what a run has written."""
    print(f"results in {folder}: {', '.join(names)}")


def show_restart(folder: Path, around: Path | None) -> None:
    """Prints how a stopped run can be restarted.

    Args:
        around: Folder of all analyses of the case, if it has several.
    """
    from dolfin_elastic.results.checkpoint.checkpoints import last_step

    if (step := last_step(folder)) is not None:
        print(f"to go on after step {step}: dolfin-elastic restart {around or folder}")
