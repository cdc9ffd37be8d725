"""What the command line shows of modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.console import console, seconds_text
from dolfin_elastic.core.si_text import counted

if TYPE_CHECKING:
    from dolfin_elastic.problem.state import Mode

THROUGH = " through "
"""Separates a rotation from a point of its axis in the name of a rigid-body mode."""

SHOWN = 40
"""Largest number of modes in the table."""


def show_modes(modes: Sequence[Mode], seconds: Mapping[str, float]) -> None:
    """Prints the modes of a run as a table, with their effective masses.

    Args:
        modes: At least one.
        seconds: Time per stage, see `core/timing.py`.
    """
    screen, buckling = console(), modes[0].kind == "buckling"
    directions = [name for name, mass in modes[0].whole.items() if mass > 0.0]
    table = Table("mode", box=SIMPLE_HEAD, pad_edge=False)
    for head in ["load factor"] if buckling else ["[Hz]", *directions, ""]:
        table.add_column(head, justify="left" if not head else "right")
    for mode in modes[:SHOWN]:
        table.add_row(str(mode.number), *_cells(mode))
    screen.print(
        f"done: {counted(len(modes), 'mode')}, {seconds_text(seconds.get('total', 0.0), 3)} s"
    )
    screen.print(table)
    if len(modes) > SHOWN:
        screen.print(f"{len(modes) - SHOWN} more are in modes.csv")
    if not buckling:
        sums = {n: sum(m.effective[n] for m in modes) / modes[0].whole[n] for n in directions}
        carried = ", ".join(f"{100 * share:.3g} % in {n}" for n, share in sums.items())
        if min(sums.values()) > 1 - 1e-6:
            carried = "all of it"
        for line in _axis_points(modes):
            screen.print(line)
        screen.print(
            "columns: % of the body's mass that a mode moves along x, y, z, or about them (rx, "
            f"ry, rz); together {carried}"
        )


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


def _cells(mode: Mode) -> list[str]:
    if mode.kind == "buckling":
        return [f"{mode.load_factor:.6g}"]
    shares = [
        f"{100 * mode.effective[name] / mass:.2f}"
        for name, mass in mode.whole.items()
        if mass > 0.0
    ]
    note = mode.kind if mode.kind != "elastic" else ""
    name = mode.name.partition(THROUGH)[0]
    return [f"{mode.frequency:.6g}", *shares, f"{note}: {name}" if name else note]
