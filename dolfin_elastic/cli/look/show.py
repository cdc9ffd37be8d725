"""What the command line shows of a body, in the unit of its file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.console import console, show_described, show_table

if TYPE_CHECKING:
    from dolfin_elastic.case.look.listing import FaceRow, Look, PartRow

_AXES = ("x", "y", "z")


def show_look(found: Look) -> None:
    """Prints the list."""
    screen = console()
    unit = found.unit
    title = f"{found.case}: {found.source}" if found.case else found.source
    screen.tell(title, style="bold")
    sides = " x ".join(f"{side / found.metres:.4g}" for side in found.extent)
    screen.tell(f"  extent {sides} {unit}, {found.dim}D, {found.cells} cells")
    for text in found.information:
        screen.tell(f"  {text}")
    if found.faces:
        show_table(screen, _faces(found, found.faces))
    things = (
        ("surface", "facets"),
        ("region", "cells"),
        ("edge", "mesh edges"),
        ("point", "nodes"),
    )
    for kind, members in things:
        rows: Sequence[PartRow] = getattr(found, f"{kind}s")
        if rows:
            show_table(screen, _parts(found, kind, members, rows))
    show_described(screen, found.described)
    if found.faces and not found.case:
        one = next((f.number for f in found.faces if f.form), found.faces[0].number)
        screen.print(f"A case names faces like this:  [surfaces]  name = {{faces = [{one}]}}")
    for note in found.notes:
        screen.tell(f"note: {note}")
    if found.picture:
        screen.tell(f"picture in {found.picture}")


def _table(heads: Sequence[tuple[str, bool]]) -> Table:
    """A table of columns with their heads, and whether they hold numbers."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for text, number in heads:
        table.add_column(text, justify="right" if number else "left")
    return table


def _faces(found: Look, rows: Sequence[FaceRow]) -> Table:
    thing, power = ("face", "^2") if found.dim == 3 else ("curve", "")
    table = _table(
        [
            (thing, True),
            ("kind", False),
            (f"[{found.unit}{power}]", True),
            (f"centroid [{found.unit}]", False),
            ("normal or axis", False),
            ("names", False),
        ]
    )
    for row in rows:
        flat = row.kind == "plane" or not row.axis
        direction = _direction(row.normal) if flat else f"axis {_direction(row.axis)}"
        table.add_row(
            str(row.number),
            row.description,
            _size(row.area, found, found.dim - 1),
            _place(row.centroid, found),
            direction,
            ", ".join(row.names),
        )
    return table


def _parts(found: Look, kind: str, members: str, rows: Sequence[PartRow]) -> Table:
    power = {"surface": found.dim - 1, "region": found.dim, "edge": 1, "point": 0}[kind]
    unit = f"[{found.unit}{f'^{power}' if power > 1 else ''}]"
    surface, use = kind == "surface", any(row.use for row in rows)
    faces = surface and bool(found.faces)
    heads = [(kind, False), (members, True), *([(unit, True)] if power else [])]
    heads += [(f"centroid [{found.unit}]", False)]
    heads += [("normal", False)] if surface else []
    heads += [("faces", False)] if faces else []
    heads += [("used by", False)] if use else []
    table = _table(heads)
    for row in rows:
        cells = [row.name, str(row.count)]
        cells += [_size(row.size, found, power)] if power else []
        cells += [_place(row.centroid, found)]
        cells += [_direction(row.normal)] if surface else []
        cells += [_numbers(row.faces)] if faces else []
        cells += [row.use] if use else []
        table.add_row(*cells)
    return table


def _size(value: float, found: Look, power: int) -> str:
    return f"{value / found.metres**power:.4g}"


def _place(point: Sequence[float], found: Look) -> str:
    span = max(found.extent)
    parts = (f"{x / found.metres:.4g}" if abs(x) > 1e-6 * span else "0" for x in point)
    return f"({', '.join(parts)})" if point else ""


def _direction(vector: Sequence[float]) -> str:
    """A unit vector: "-x" along an axis, else its components."""
    for i, x in enumerate(vector):
        if abs(abs(x) - 1.0) < 1e-6:
            return f"{'-' if x < 0 else '+'}{_AXES[i]}"
    parts = (f"{x:.2f}" if abs(x) >= 0.005 else "0" for x in vector)
    return f"({', '.join(parts)})" if vector else ""


def _numbers(numbers: Iterable[int]) -> str:
    every = list(numbers)
    return ", ".join(map(str, every[:8])) + (" ..." if len(every) > 8 else "")
