"""The nodes of a body with their fields: .frd as CalculiX writes it, and one table as CSV.

Both are text, written in blocks of nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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


def _lines(form: str, rows: AnyArray, first: int | None = None) -> Iterator[str]:
    """Rows as lines of text, a block at a time.

    Args:
        first: Number in front of the first row; None: there are no numbers.
    """
    for start in range(0, len(rows), _BLOCK):
        block = rows[start : start + _BLOCK].tolist()
        if first is None:
            yield "".join([form % tuple(row) for row in block])
        else:
            yield "".join([form % (first + start + i, *row) for i, row in enumerate(block)])


def left_out(run: FinishedRun) -> str:
    """What of a run is not in these files; empty: nothing."""
    arrays = run.frame().arrays
    names = [name for name, stored in arrays.items() if stored.centre == "cell"]
    return f"fields of elements are left out: {', '.join(names)}" if names else ""


def _at_nodes(run: FinishedRun, step: int) -> dict[str, FloatArray]:
    names = [n for n, one in run.frame(step).arrays.items() if one.centre == "node"]
    return {name: nodal(run, step, name) for name in names}


# --- CSV ---


def write_csv(run: FinishedRun, settings: ExportSettings, file: Path) -> list[Path]:
    """Writes one table: node, time or load, place at rest [m], fields, in SI units. Not collective.

    Returns:
        The file.

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
    return [file]


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


def write_frd(run: FinishedRun, settings: ExportSettings, file: Path) -> list[Path]:
    """Writes mesh and fields of nodes in mm, N, MPa and s, with six digits. Not collective.

    Source: G. Dhondt, CalculiX CrunchiX User's Manual 2.21; K. Wittig, CalculiX GraphiX 2.21,
    "Result Format".

    Returns:
        The file.

    Raises:
        OutputError: It cannot be written.
    """
    points, cells = mesh_of(run)
    with (
        drafted(file) as draft,
        draft.open("w", encoding="ascii", errors="replace", newline="\n") as out,
    ):
        _write_mesh(out, points * _SCALES["m"], cells)
        for k, step in enumerate(chosen(run, settings.frames)):
            _write_step(out, k + 1, run.frame(step).t, _at_nodes(run, step), settings.scale)
        out.write(" 9999\n")
    return [file]


def _write_mesh(out: IO[str], points: FloatArray, cells: AnyArray) -> None:
    out.write("    1C\n    1UPGM               dolfin_elastic\n")
    out.write("    1UUNITS             mm, N, MPa, s\n")
    out.write(f"    2C{'':18}{len(points):12d}{'':37}1\n")
    out.writelines(_lines(" -1%10d" + "%12.5E" * 3 + "\n", _representable(points), 1))
    out.write(f" -3\n    3C{'':18}{len(cells):12d}{'':37}1\n")
    width = cells.shape[1]
    form = f" -1%10d{_KINDS[width]:5d}    0    1\n -2" + "%10d" * width + "\n"
    out.writelines(_lines(form, cells + 1, 1))
    out.write(" -3\n")


def _write_step(
    out: IO[str], number: int, t: float, fields: Mapping[str, FloatArray], scale: float
) -> None:
    for name, values in fields.items():
        factor = _SCALES.get(field_in_file(name).unit, 1.0)
        rows = values * (factor * scale if name == "displacement" else factor)
        lines = _components(rows.shape[1])
        if rows.shape[1] == _TENSOR:
            rows = rows[:, _SIX]
        title = _NAMES.get(name, name.upper()[:8])
        # Nodes where a field has no value are not listed.
        known = np.flatnonzero(np.isfinite(rows).all(axis=1))
        table = np.column_stack([known + 1.0, _representable(rows[known])])
        out.write(f"    1PSTEP{number:26d}{1:12d}{number:12d}\n")
        head = f"  100CL{number:5d}{t:12.5E}{len(known):12d}{'':20} 0{number:5d}{'':10} 1\n"
        out.write(f"{head} -4  {title:8s}{len(lines):5d}{1:5d}\n")
        out.writelines(lines)
        out.writelines(_lines(" -1%10d" + "%12.5E" * rows.shape[1] + "\n", table))
        out.write(" -3\n")


def _components(columns: int) -> list[str]:
    """Lines about the components of a field: name, whether of a vector or tensor, and which."""
    if columns == 1:
        return [f" -5  VALUE   {1:5d}{1:5d}{0:5d}{0:5d}\n"]
    if columns == _TENSOR:
        return [f" -5  S{a}     {1:5d}{4:5d}{i:5d}{j:5d}\n" for a, (i, j) in _PARTS.items()]
    one = [f" -5  D{i + 1}      {1:5d}{2:5d}{i + 1:5d}{0:5d}\n" for i in range(columns)]
    return [*one, f" -5  ALL     {1:5d}{2:5d}{0:5d}{0:5d}{1:5d}ALL\n"]


def _representable(values: FloatArray) -> FloatArray:
    return np.where(np.abs(values) < _TINY, 0.0, values)
