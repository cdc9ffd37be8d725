"""What the command line shows of modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.console import console, seconds_text
from dolfin_elastic.core.si_text import counted, percent

if TYPE_CHECKING:
    from dolfin_elastic.problem.state import Mode

THROUGH = " through "
"""Separates a rotation from a point of its axis in the name of a rigid-body mode."""

SHOWN = 40
"""Largest number of modes in the table."""


def show_modes(
    modes: Sequence[Mode], rows: Sequence[Mapping[str, Any]], seconds: Mapping[str, float]
) -> None:
    """Prints the modes of a run as a table, with their effective masses and in words.

    Args:
        modes: At least one.
        rows: Their rows of `summary.json`.
        seconds: Time per stage, see `core/timing.py`.
    """
    screen, buckling = console(), modes[0].kind == "buckling"
    whole = {name: mass for name, mass in modes[0].whole.items() if mass > 0.0}
    heads = [name.replace("r", "about ") for name in whole]
    table = Table("mode", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for head in ["load factor"] if buckling else ["[Hz]", *heads]:
        table.add_column(head, justify="right")
    table.add_column("shape")
    for mode, row in zip(modes[:SHOWN], rows, strict=False):
        table.add_row(str(mode.number), *_cells(mode, row["shape"]))
    screen.print(
        f"done: {counted(len(modes), 'mode')}, {seconds_text(seconds.get('total', 0.0), 3)} s"
    )
    for solver in dict.fromkeys(mode.solver for mode in modes):
        screen.print(f"solver: {solver}")
    screen.print(table)
    if len(modes) > SHOWN:
        screen.print(f"{len(modes) - SHOWN} more are in modes.csv")
    if not buckling:
        sums = [sum(m.effective[name] for m in modes) / mass for name, mass in whole.items()]
        parts = [f"{head} {percent(share)}" for head, share in zip(heads, sums, strict=True)]
        carried = "all of it" if min(sums) > 1 - 1e-6 else ", ".join(parts)
        for line in _axis_points(modes):
            screen.print(line)
        screen.print(
            "x, y, z: % of the body's mass that a mode moves along them; about: % of its moment of "
            f"inertia that it turns; together {carried}"
        )
    what = "buckling loads" if buckling else "modes"
    screen.print(f"the error by the size of the elements is not estimated for {what}")


def _axis_points(modes: Sequence[Mode]) -> list[str]:
    """Points of the axes of rigid rotations, as lines of their own: too wide for the table."""
    result: dict[str, list[str]] = {}
    for mode in modes[:SHOWN]:
        _, through, place = mode.name.partition(THROUGH)
        if through:
            result.setdefault(place, []).append(str(mode.number))
    return [
        f"axes of modes {', '.join(numbers)} go through {place}"
        for place, numbers in result.items()
    ]


def _cells(mode: Mode, shape: str) -> list[str]:
    if mode.kind == "buckling":
        return [f"{mode.load_factor:.6g}", shape]
    shares = [f"{100 * mode.effective[n] / m:.2f}" for n, m in mode.whole.items() if m > 0.0]
    name = mode.name.partition(THROUGH)[0] or shape
    note = name if mode.kind == "elastic" else f"{mode.kind}: {name}"
    return [f"{mode.frequency:.6g}", *shares, note]
