"""The nodes of a body with their fields: .frd as CalculiX writes it, and one table as CSV.

Both are text, written in blocks of nodes.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.results.exports.moving import chosen, mesh_of, nodal
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.fields import component_names, field_in_file
from dolfin_elastic.results.files import drafted
from dolfin_elastic.results.finished.run import FinishedRun

_BLOCK = 1 << 14
"""Nodes whose lines are in memory at once."""


def _lines(form: str, rows: AnyArray, first: int) -> Iterator[str]:
    """Rows as lines of text, a block at a time.

    Args:
        first: Number in front of the first row.
    """
    for start in range(0, len(rows), _BLOCK):
        block = rows[start : start + _BLOCK].tolist()
        yield "".join([form % (first + start + i, *row) for i, row in enumerate(block)])


def _left_out(run: FinishedRun) -> tuple[str, ...]:
    arrays = run.frame().arrays
    names = [name for name, stored in arrays.items() if stored.centre == "cell"]
    return (f"fields of elements are left out: {', '.join(names)}",) if names else ()


def _at_nodes(run: FinishedRun, step: int) -> dict[str, FloatArray]:
    names = [n for n, one in run.frame(step).arrays.items() if one.centre == "node"]
    return {name: nodal(run, step, name) for name in names}


# --- CSV ---


def write_csv(run: FinishedRun, settings: ExportSettings, file: Path) -> tuple[str, ...]:
    """Writes one table: node, time or load, place at rest [m], fields, in SI units. Not collective.

    Returns:
        What is left out.

    Raises:
        OutputError: It cannot be written.
    """
    points, _ = mesh_of(run)
    with drafted(file) as draft, draft.open("w", encoding="utf-8", newline="\n") as out:
        for k, step in enumerate(chosen(run, settings.frames)):
            fields = _at_nodes(run, step)
            if not k:
                names = [n for f, v in fields.items() for n in component_names(f, v.shape[1])]
                out.write(",".join(["node", "t", "x", "y", "z", *names]) + "\n")
            t = np.full(len(points), run.frame(step).t)
            rows = np.column_stack([t, points, *fields.values()])
            form = ",".join(["%d", *["%.17g"] * rows.shape[1]]) + "\n"
            out.writelines(_lines(form, rows, 0))
    return _left_out(run)


# --- .frd ---

_KINDS = {3: 7, 6: 8, 4: 3, 10: 6}
"""Nodes of a cell to CalculiX's number of its kind; the order of the nodes is that of VTK."""
_NAMES = {"displacement": "DISP", "velocity": "VELO", "cauchy_stress": "STRESS"}
"""Fields that programs know by these names."""
_SCALES = {"m": 1e3, "m/s": 1e3, "m/s^2": 1e3, "Pa": 1e-6}
"""From SI units to mm, N, MPa and s, which FreeCAD expects."""
_SIX = [0, 4, 8, 1, 5, 6]
"""xx, yy, zz, xy, yz, zx of the nine components of a tensor."""
_TENSOR = 9
_PARTS = {"XX": (1, 1), "YY": (2, 2), "ZZ": (3, 3), "XY": (1, 2), "YZ": (2, 3), "ZX": (3, 1)}
_TINY = 1e-99
"""Numbers below have an exponent of three digits, for which there is no room."""
_PLAIN = (1e-2, 1e9)
"""Between these, numbers have more digits without an exponent."""


def write_frd(run: FinishedRun, settings: ExportSettings, file: Path) -> tuple[str, ...]:
    """Writes mesh and fields of nodes in mm, N, MPa and s, with at least six digits.

    Not collective.  FreeCAD takes a state only where its time is above the one before, and above 0,
    and modes by their numbers.

    Source: G. Dhondt, CalculiX CrunchiX User's Manual 2.21; K. Wittig, CalculiX GraphiX 2.21,
    "Result Format".

    Returns:
        What is left out or changed.

    Raises:
        OutputError: It cannot be written.
    """
    points, cells = mesh_of(run)
    steps = chosen(run, settings.frames)
    times, notes = [run.steps[step] for step in steps], _left_out(run)
    if not run.modal:
        times = [max(t, _TINY) for t in times]
        if (np.diff(times) <= 0).any():
            times = [float(k + 1) for k in range(len(steps))]
            text = (
                "t does not grow from state to state: in its place they have the numbers 1, 2 ..."
            )
            notes += (text,)
    with (
        drafted(file) as draft,
        draft.open("w", encoding="ascii", errors="replace", newline="\n") as out,
    ):
        _write_mesh(out, points * _SCALES["m"], cells)
        for k, (step, t) in enumerate(zip(steps, times, strict=True)):
            mode = run.frames[step].number if run.modal else None
            _write_step(out, k + 1, t, _at_nodes(run, step), settings.scale, mode)
        out.write(" 9999\n")
    return notes


def _write_mesh(out: IO[str], points: FloatArray, cells: AnyArray) -> None:
    out.write("    1C\n    1UPGM               dolfin_elastic\n")
    out.write("    1UUNITS             mm, N, MPa, s\n")
    out.write(f"    2C{'':18}{len(points):12d}{'':37}1\n")
    out.writelines(_numbered(np.arange(len(points)), points))
    out.write(f" -3\n    3C{'':18}{len(cells):12d}{'':37}1\n")
    width = cells.shape[1]
    form = f" -1%10d{_KINDS[width]:5d}    0    1\n -2" + "%10d" * width + "\n"
    out.writelines(_lines(form, cells + 1, 1))
    out.write(" -3\n")


def _write_step(
    out: IO[str],
    number: int,
    t: float,
    fields: Mapping[str, FloatArray],
    scale: float,
    mode: int | None,
) -> None:
    titles: list[str] = []
    for name, values in fields.items():
        factor = _SCALES.get(field_in_file(name).unit, 1.0)
        rows = values * (factor * scale if name == "displacement" else factor)
        lines = _components(rows.shape[1])
        if rows.shape[1] == _TENSOR:
            rows = rows[:, _SIX]
        titles.append(_title(name, titles))
        # Nodes where a field has no value are not listed.
        known = np.flatnonzero(np.isfinite(rows).all(axis=1))
        out.write(f"    1PSTEP{number:26d}{1:12d}{number:12d}\n")
        out.write("" if mode is None else f"    1PMODE{mode:26d}\n")
        kind = 0 if mode is None else 2  # frequencies
        head = (
            f"  100CL{number:5d}{_twelve(t)}{len(known):12d}{'':20}{kind:2d}{number:5d}{'':10} 1\n"
        )
        out.write(f"{head} -4  {titles[-1]:8s}{len(lines):5d}{1:5d}\n")
        out.writelines(lines)
        out.writelines(_numbered(known, rows[known]))
        out.write(" -3\n")


def _title(name: str, others: Sequence[str]) -> str:
    """Name of a field in eight characters, unlike those of others."""
    title = _NAMES.get(name, name.upper()[:8])
    free = (f"{title[: 8 - len(str(k))]}{k}" for k in itertools.count(2))
    return title if title not in others else next(one for one in free if one not in others)


def _numbered(nodes: AnyArray, rows: AnyArray) -> Iterator[str]:
    """Lines of nodes, counted from 0, with their values."""
    for start in range(0, len(rows), _BLOCK):
        block = slice(start, start + _BLOCK)
        pairs = zip((nodes[block] + 1).tolist(), rows[block].tolist(), strict=True)
        yield "".join([f" -1{node:10d}{''.join(map(_twelve, row))}\n" for node, row in pairs])


def _twelve(number: float) -> str:
    """A number in twelve characters: columns are told by their width, as CalculiX's own are."""
    size = abs(number)
    if _PLAIN[0] <= size < _PLAIN[1]:
        return f"{number: .10f}"[:12]
    short = f"{number if size >= _TINY else 0.0: .6E}".replace("E-0", "E-").replace("E+0", "E+")
    return short if len(short) == 12 else f"{number: .5E}"


def _components(columns: int) -> list[str]:
    """Lines about the components of a field: name, whether of a vector or tensor, and which."""
    if columns == 1:
        return [f" -5  VALUE   {1:5d}{1:5d}{0:5d}{0:5d}\n"]
    if columns == _TENSOR:
        return [f" -5  S{a}     {1:5d}{4:5d}{i:5d}{j:5d}\n" for a, (i, j) in _PARTS.items()]
    one = [f" -5  D{i + 1}      {1:5d}{2:5d}{i + 1:5d}{0:5d}\n" for i in range(columns)]
    return [*one, f" -5  ALL     {1:5d}{2:5d}{0:5d}{0:5d}{1:5d}ALL\n"]
