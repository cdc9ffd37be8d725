"""What the command line shows: progress, tables, log lines.  Only rank 0 shows anything."""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import textwrap
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import ElasticError, SolveError

if TYPE_CHECKING:
    from dolfin_elastic.problem.state import State

WIDTH = 100
FIRST_LINES = 20
"""Steps that get a line of their own in any case; later ones at most one a second."""


def console(*, stderr: bool = False) -> Console:
    """A console that is as wide as the terminal, or 100 columns in a file."""
    stream = sys.stderr if stderr else sys.stdout
    # Launchers forward through terminals of their own: what arrives may well be a file.
    launched = "OMPI_COMM_WORLD_RANK" in os.environ or "PMI_RANK" in os.environ
    plain = launched or not stream.isatty()
    width, terminal = (WIDTH, False) if plain else (None, None)
    return Console(
        stderr=stderr,
        width=width,
        force_terminal=terminal,
        highlight=False,
        markup=False,
        emoji=False,
    )


# --- progress ---


class Meter(Protocol):
    """Shows states as they come."""

    def show(self, state: State) -> None:
        """Takes one step."""

    def close(self) -> None:
        """Ends the display."""


class Silent:
    """Shows nothing: on other ranks, or when asked to be quiet."""

    def show(self, state: State) -> None:
        """Takes one step."""

    def close(self) -> None:
        """Ends the display."""


class Estimate:
    """Time to the end, by the steps from the first state on.

    What is done once counts for nothing: meshes, and forms that are compiled on the way.
    """

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def left(self, done: float) -> str:
        """Rough time to the end in words, see `time_left`.

        Args:
            done: Share of the run that is done.
        """
        seconds = timing.totals()
        once = sum(seconds.get(name, 0.0) for name in ("mesh", "compile"))
        spent = seconds.get("total", 0.0) - once
        if self._first is None:
            self._first = spent, done
        return time_left(spent - self._first[0], done, self._first[1])


class Lines:
    """One line a step, for files and pipes."""

    def __init__(self, motion: bool) -> None:
        self.motion, self._estimate, self._shown, self._count = motion, Estimate(), 0.0, 0

    def show(self, state: State) -> None:
        """Takes one step."""
        now = time.monotonic()
        left = self._estimate.left(state.done)
        due = self._count < FIRST_LINES or now - self._shown > 1.0 or state.done >= 1.0
        if state.step and due:
            self._shown, self._count = now, self._count + 1
            print(f"{step_text(state, motion=self.motion)}  {left}", flush=True)

    def close(self) -> None:
        """Ends the display."""


class Bar:
    """A bar that moves, for terminals."""

    def __init__(self, motion: bool, screen: Console) -> None:
        self.motion, self._estimate = motion, Estimate()
        self._progress = Progress(
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.description}", markup=False),
            console=screen,
        )
        self._task = self._progress.add_task("starting", total=1.0)
        self._progress.start()

    def show(self, state: State) -> None:
        """Takes one step."""
        left = self._estimate.left(state.done)
        text = re.sub("  +", "  ", f"{step_text(state, motion=self.motion)}  {left}")
        self._progress.update(self._task, completed=state.done, description=text)

    def close(self) -> None:
        """Ends the display."""
        self._progress.stop()


def step_text(state: State, *, motion: bool) -> str:
    """Step, time or load factor, iterations, largest displacement."""
    place = f"t {state.t:.5g} s" if motion else f"load {100 * state.load_factor:.4g} %"
    counts = {"Newton": state.newton, "linear": state.krylov}
    still = not motion and state.step > 0  # a step that needed none has its count, too
    work = ", ".join(
        f"{number} {name}"
        for name, number in counts.items()
        if number or (still and name[0] == "N")
    )
    return f"step {state.step:>4}   {place:<15} {work:<20} max |u| {state.max_displacement:.4g} m"


def time_left(spent: float, done: float, before: float = 0.0) -> str:
    """Rough time to the end, nothing where it cannot be said.

    Args:
        spent: Since the first state [s].
        done: Share of the run that is done.
        before: Share that was done then.
    """
    if not before < done < 1.0:
        return ""
    seconds = round(spent * (1.0 - done) / (done - before))
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    text = f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
    return f"  {text} left"


# --- log ---


class Handler(logging.Handler):
    """Shows log records of rank 0; warnings are called so."""

    def __init__(self, rank: int, screen: Console) -> None:
        super().__init__()
        self.addFilter(lambda record: rank == 0)
        self.screen = screen

    def emit(self, record: logging.LogRecord) -> None:
        """Shows one record."""
        mark = "warning: " if record.levelno >= logging.WARNING else ""
        self.screen.print(f"{mark}{record.getMessage()}", soft_wrap=True)


# --- errors ---


def error_text(error: ElasticError) -> str:
    """An error with its notes; the long lines of a failed solve are folded."""
    notes = "".join(f"\n  {note}" for note in getattr(error, "__notes__", ()))
    text = f"error: {error}{notes}"
    return _folded(text) if isinstance(error, SolveError) else text


def _folded(text: str) -> str:
    """Long lines in several, the later ones indented; words and paths stay whole."""
    folded = (
        textwrap.wrap(
            line,
            WIDTH,
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for line in text.splitlines()
    )
    return "\n".join(part for lines in folded for part in lines)


# --- tables ---


def show_table(screen: Console, table: Table) -> None:
    """A table, in files without blanks at the ends of its lines."""
    if screen.is_terminal:
        screen.print(table)
        return
    with screen.capture() as captured:
        screen.print(table)
    for line in captured.get().splitlines():
        screen.print(line.rstrip(), soft_wrap=True)


def show_end(
    state: State, *, motion: bool, seconds: Mapping[str, float], newton: int, since: int = 0
) -> None:
    """The run in a few lines.

    Args:
        state: The last one.
        motion: Whether it moves.
        seconds: Where the time went.
        newton: Newton iterations.
        since: Step that it has gone on from.
    """
    screen = console()
    table = Table(box=None, show_header=False, pad_edge=True)
    for name, value in _end_rows(state, motion):
        table.add_row(name, value)
    iterations = f", {count(newton, 'Newton iteration')}" if newton else ""
    again = f" since step {since}" if since else ""
    screen.print(f"done: {count(state.step, 'step')}{iterations}{again}")
    show_table(screen, table)
    # Longer than a column is wide.
    screen.print(f" time: {_times(seconds)}", soft_wrap=True)


def count(number: int, thing: str) -> str:
    """A number of things."""
    return f"{number} {thing}" + ("" if number == 1 else "s")


def _end_rows(state: State, motion: bool) -> list[tuple[str, str]]:
    when = " at the end" if motion else ""
    rows = [(f"largest displacement{when}", f"{state.max_displacement:.5g} m")]
    for name in ("strain", "kinetic", "contact", "total", "external"):
        known = math.isfinite(state.energies.get(name, math.nan))
        if known and (motion or name == "strain"):
            label = "work of loads and supports" if name == "external" else f"{name} energy"
            rows.append((label, f"{state.energies[name]:.5g} J"))
    for name, force in state.reactions.items():
        rows.append((f"reaction of {name}", vector_text(force) + " N"))
    if state.audit is not None:
        rows += [("audit", reason) for reason in state.audit.so_far or ("pass",)]
    return rows


def vector_text(vector: Iterable[float]) -> str:
    """Components with five digits; round-off of the others is shown as 0."""
    parts = [float(v) for v in vector]
    limit = 1e-9 * max(map(abs, parts), default=0.0)
    return "(" + ", ".join(f"{v:.5g}" if abs(v) > limit else "0" for v in parts) + ")"


def _times(seconds: Mapping[str, float]) -> str:
    total = seconds.get("total", 0.0)
    stages = [
        f"{name} {value:.2g}"
        for name, value in seconds.items()
        if name != "total" and value >= 0.005
    ]
    return f"{total:.3g} s" + (f" ({', '.join(stages)})" if stages else "")


def show_profile(rows: Sequence[tuple[str, float, float]], memory: Mapping[str, int]) -> None:
    """Where the time went, with the fastest and the slowest rank, and the memory used."""
    table = Table("stage", box=SIMPLE_HEAD, pad_edge=False)
    for head in ("fastest rank [s]", "slowest rank [s]", "share"):
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
    """What a run has written to its folder."""
    print(f"results in {folder}: {', '.join(names)}")


def show_restart(folder: Path) -> None:
    """How a run that was stopped can go on."""
    from dolfin_elastic.results.checkpoint.checkpoints import last_step

    if (step := last_step(folder)) is not None:
        print(f"to go on after step {step}: dolfin-elastic restart {folder}")


def show_versions(found: Mapping[str, Any]) -> None:
    """Name and value, one a line."""
    width = max(map(len, found))
    for name, value in found.items():
        print(f"{name:<{width}}  {value}")
