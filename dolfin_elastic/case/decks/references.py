"""Results of another program: displacements at nodes, forces there, frequencies, buckling factors.

`.frd` and `.dat` of CalculiX, or a table as `.csv`, in units of the deck.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from dolfin_elastic.core.errors import MeshError, nearest, why_no_file

MOST_BYTES = 1 << 31
_TABLE = re.compile(r"\s*(displacements|forces) \((?:vx|fx).*\) for set (.*?) and time\s+(\S+)")
_MODES = {"EIGENVALUEOUTPUT": 3, "BUCKLINGFACTOROUTPUT": 1}
"""Title of a table of `.dat`, without blanks, to the column of its numbers."""
_FIRST, _WIDTH = 13, 12
"""Columns of `.frd`: where the numbers of a node begin, and how wide each is."""


@dataclass
class Table:
    """Vectors at nodes.

    Attributes:
        nodes: Numbers, shape (n,).
        vectors: Shape (n, 3); NaN in the columns that a table lacks.
    """

    nodes: list[int] = field(default_factory=list)
    vectors: list[list[float]] = field(default_factory=list)


@dataclass
class Reference:
    """Results of another program, in units of the deck.

    Attributes:
        points: Place of each node, by its number; empty if the file has none.
        displacements: A table for each state that it has, the last of each step among them.
        forces: The same for the forces of supports at nodes.
        modes: Frequencies or buckling factors, a list for each step with any.
    """

    points: dict[int, list[float]] = field(default_factory=dict)
    displacements: list[Table] = field(default_factory=list)
    forces: list[Table] = field(default_factory=list)
    modes: list[list[float]] = field(default_factory=list)


def read_reference(path: Path) -> Reference:
    """Results of another program. Not collective.

    Raises:
        MeshError: There are none, or they are damaged.
    """
    suffix = Path(path.name.removesuffix(".ref")).suffix.lower()
    if suffix not in _READERS:
        known = nearest(suffix, _READERS)
        raise MeshError("results of this suffix are not read", where=str(path), expected=known)
    if fault := why_no_file(path, MOST_BYTES):
        raise MeshError(fault, where=str(path))
    if not path.is_file():
        raise MeshError("there are no such results", where=str(path))
    lines = enumerate(path.read_text("latin-1").splitlines(), start=1)
    try:
        result = _READERS[suffix](lines)
    except csv.Error as error:
        raise MeshError(f"this is no table: {error}", where=str(path)) from None
    except _WrongLineError as error:
        raise MeshError("this line is damaged", where=f"{path}:{error.args[0]}") from None
    for tables in (result.displacements, result.forces):
        tables[:] = [table for table in tables if table.nodes]
    if not (result.displacements or result.forces or result.modes):
        raise MeshError("it has no displacements, forces or modes", where=str(path))
    return result


class _WrongLineError(Exception):
    """A line, by its number, that is no row of numbers."""


Lines = Iterator[tuple[int, str]]


def _numbers(words: list[str], line: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise _WrongLineError(line) from None
    if not all(map(math.isfinite, values)):
        raise _WrongLineError(line)
    return values


def _frd(lines: Lines) -> Reference:
    """Nodes in block 2C, fields in blocks that begin with -4."""
    result, table = Reference(), Table()
    inside = ""
    for number, line in lines:
        key = line[:3].strip()
        if line[:6].strip() == "2C":
            inside = "nodes"
        elif key == "-4":
            name = line[5:13].strip().upper()
            inside = {"DISP": "disp", "FORC": "forc"}.get(name, "")
            table = Table()
            if inside:
                (result.displacements if inside == "disp" else result.forces).append(table)
        elif key == "-3":
            inside = ""
        elif inside and key == "-1":
            node, vector = _node(line, number)
            if inside == "nodes":
                result.points[node] = vector
            else:
                table.nodes.append(node)
                table.vectors.append(vector)
    return result


def _node(line: str, number: int) -> tuple[int, list[float]]:
    words = [line[i : i + _WIDTH] for i in range(_FIRST, _FIRST + 3 * _WIDTH, _WIDTH)]
    return int(_numbers([line[3:_FIRST]], number)[0]), _numbers(words, number)


def _dat(lines: Lines) -> Reference:
    """Tables below a line that says what they are."""
    result, table, column, begun = Reference(), Table(), -1, False
    for number, line in lines:
        if match := _TABLE.match(line):
            table, column, begun = Table(), -1, False
            every = result.displacements if match[1] == "displacements" else result.forces
            every.append(table)
            continue
        title, words = line.replace(" ", ""), line.split()
        if title in _MODES:
            column, table = _MODES[title], Table()
            result.modes.append([])
        elif words and words[0].isdecimal() and column >= 0 and len(words) > column:
            result.modes[-1].append(_numbers([words[column]], number)[0])
            begun = True
        elif words and words[0].isdecimal() and len(words) >= 4 and column < 0:
            table.nodes.append(int(words[0]))
            table.vectors.append(_numbers(words[1:4], number))
        elif words and begun:
            column, begun = -2, False  # the table of participation below that of frequencies
            table = Table()
        elif words and column < 0 and not words[0].isdecimal():
            table = Table()
    result.modes = [modes for modes in result.modes if modes]
    return result


_COLUMNS = {
    "node": ("node", "number", "nid"),
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "ux": ("ux", "u1", "displacement_x", "vx"),
    "uy": ("uy", "u2", "displacement_y", "vy"),
    "uz": ("uz", "u3", "displacement_z", "vz"),
    "frequency": ("frequency", "freq", "hz"),
    "factor": ("factor", "buckling factor", "load factor"),
}


def _csv(lines: Lines) -> Reference:
    """Columns by their headings: node or x, y, z; ux, uy, uz; frequency; factor."""
    rows = [(number, line) for number, line in lines if line.strip()]
    heads = [word.strip().casefold() for word in next(csv.reader([rows[0][1]]), [])] if rows else []
    found = {
        name: heads.index(word)
        for name, words in _COLUMNS.items()
        for word in words
        if word in heads
    }
    result, table, modes = Reference(), Table(), list[float]()
    parts = dict.fromkeys(("ux", "uy", "uz")).keys()
    for index, (number, line) in enumerate(rows[1:], start=1):
        words = next(csv.reader([line]), [])
        if len(words) < len(heads):
            raise _WrongLineError(number)
        values = {name: _numbers([words[i]], number)[0] for name, i in found.items()}
        node = int(values.get("node", index))
        if {"x", "y", "z"} <= values.keys():
            result.points[node] = [values[name] for name in "xyz"]
        if parts & values.keys():
            table.nodes.append(node)
            table.vectors.append([values.get(name, math.nan) for name in parts])
        modes += [values[name] for name in ("frequency", "factor") if name in values]
    result.displacements = [table] if table.nodes else []
    result.modes = [modes] if modes else []
    return result


_READERS: dict[str, Callable[[Lines], Reference]] = {".frd": _frd, ".dat": _dat, ".csv": _csv}
