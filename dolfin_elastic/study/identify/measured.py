"""What was measured of a part: curves of two numbers of its run, and displacements at points."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import CaseError, InputError, UnitError, nearest
from dolfin_elastic.core.files.columns import CsvTable, heading, is_number, numbers, read_csv
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import to_base, unit_to_si
from dolfin_elastic.results.finished.run import column_unit
from dolfin_elastic.study.wanted import Wanted

_AXES = ("x", "y", "z")
_SHIFTS = ("ux", "uy", "uz")
_TIMES = ("t", "time")
_FACTOR = re.compile(r"\s*([-+]?)\s*(?:([\d.]+(?:[eE][-+]?\d+)?)\s*\*?)?\s*(\S.*)")
_COLON = re.compile(r"(?<!percentile):")
_OF = "--of"


@dataclass(frozen=True)
class Number:
    """A number of a run by its name, possibly times a factor, such as "-4*reaction_x of top".

    Attributes:
        text: As it was written.
        wanted: The number.
        factor: By which it is multiplied.
    """

    text: str
    wanted: Wanted
    factor: float = 1.0

    @classmethod
    def read(cls, text: str, option: str = _OF) -> Number:
        """From the command line or a heading.

        Args:
            option: Where it was given, for messages.

        Raises:
            InputError: It is no name of a number of a run.
        """
        match = _FACTOR.fullmatch(text)
        if match is None:
            raise InputError("a name is missing", where=option, expected=_FOR_EXAMPLE)
        try:
            factor = float(match[1] + (match[2] or "1"))
        except ValueError:
            what = f"'{match[2]}' is no factor"
            raise InputError(what, where=option, expected=_FOR_EXAMPLE) from None
        name = "t" if match[3].strip() in _TIMES else match[3]
        return cls(text.strip(), Wanted.read(name, option), factor)

    @property
    def is_time(self) -> bool:
        """It is the time, in statics the load parameter."""
        return self.wanted.name == "t"

    @property
    def unit(self) -> str:
        """SI unit; empty of a pure number, and where none is known."""
        if self.is_time:
            return ""
        return self.wanted.unit or column_unit(self.wanted.name, timed=False)


_FOR_EXAMPLE = 'for example --of "t:reaction_x of right" or --of "tip_x:-4*reaction_left_x"'


@dataclass(frozen=True)
class MeasuredCurve:
    """A number of the run over another one.

    Attributes:
        x: What the curve is over: it grows or falls all the time.
        y: What was measured.
        at: Of x, SI units, shape (n,).
        values: Of y, SI units, shape (n,).
        weight: Of its mean square error in the sum that is made least.
        source: Its file; empty: it was given in Python.
        bare: Headings whose numbers have no unit, and were read in SI units.
        lines: Where they stand in the file, shape (n,), for messages.
        column: Of x in the file, the same.
    """

    x: Number
    y: Number
    at: FloatArray
    values: FloatArray
    weight: float = 1.0
    source: str = ""
    bare: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()
    column: str = ""

    def __post_init__(self) -> None:
        """Refuses a curve that says nothing."""
        _check_numbers(self.values, self.label)

    @property
    def label(self) -> str:
        """What it is called."""
        name = f"{self.y.text} over {self.x.text}"
        return f"{Path(self.source).name}: {name}" if self.source else name


@dataclass(frozen=True)
class MeasuredField:
    """Displacements at points of the undeformed body, as digital image correlation has them.

    Attributes:
        points: [m], or in the unit of the mesh, shape (n, dim).
        values: [m], shape (n, c), of the components.
        components: Numbers of these, 0 for x.
        times: When, shape (n,), in statics load parameters; nan: at the end.
        lines: Where they stand in the file, shape (n,), for messages.
        in_mesh_unit: The points are in the unit of the mesh.
        weight: See `MeasuredCurve`, as for `source` and `bare`.
        column: Of the times in the file, for messages.
    """

    points: FloatArray
    values: FloatArray
    components: tuple[int, ...]
    times: FloatArray
    lines: tuple[int, ...]
    in_mesh_unit: bool = False
    weight: float = 1.0
    source: str = ""
    bare: tuple[str, ...] = ()
    column: str = ""

    def __post_init__(self) -> None:
        """Refuses a field that says nothing."""
        _check_numbers(self.values, self.label)

    @property
    def label(self) -> str:
        """What it is called."""
        return f"{Path(self.source).name}: displacements" if self.source else "displacements"

    def only(self, rows: IntArray) -> MeasuredField:
        """Some of its points, by their numbers."""
        return replace(
            self,
            points=self.points[rows],
            values=self.values[rows],
            times=self.times[rows],
            lines=tuple(self.lines[i] for i in rows),
        )


Measured = MeasuredCurve | MeasuredField


def place_of(one: Measured, row: int) -> tuple[str, str]:
    """Where a row stands, for messages: file and column, and "line 3: "; of no file its label."""
    if not one.source:
        return one.label, ""
    return f"{one.source}: {one.column}", f"line {one.lines[row]}: "


def _check_numbers(values: FloatArray, where: str) -> None:
    if not values.size:
        raise CaseError("there are no points", where=where, expected="what was measured")
    if not values.any():
        raise CaseError("all numbers are 0", where=where, expected="what was measured")


# --- from files ---


def read_measured(path: Path, of: Iterator[str | None]) -> list[Measured]:
    """Curves or a displacement field from a CSV file. Not collective.

    A file with columns x, y and ux or uy is a field; of others the first column is what all others
    are over.

    Args:
        of: Of files of curves "X:Y" or "Y", the numbers of the run that the first two columns have;
            None: the headings name them.

    Raises:
        InputError: With file, line and column.
    """
    file = str(path)
    try:
        table = read_csv(path)
    except InputError as error:
        hint = error.expected.replace("paths are relative to the case file", "")
        raise CaseError(error.what, where=file, expected=hint) from None
    if not table.rows:
        raise CaseError("there are headings but no numbers", where=f"{file}: line 1")
    names = [_plain(head) for head in table.head or ()]
    if any(name in _SHIFTS for name in names) and ("x" in names or "y" in names):
        return [_field(table, names, file)]
    return [*_curves(table, next(of), file)]


def _plain(head: str) -> str:
    name = heading(head)[0].casefold().replace("_", "").replace(" ", "")
    return name.replace("displacement", "u")


def _curves(table: CsvTable, of: str | None, file: str) -> list[MeasuredCurve]:
    """All curves of a file."""
    if of is not None:
        parts = _COLON.split(of, maxsplit=1)
        names = parts if len(parts) == 2 else [_heads(table, file)[0], of]
        options = [_OF if len(parts) == 2 else f"{file}: line 1", _OF]
    else:
        names = _heads(table, file)
        options = [f"{file}: line 1"] * len(names)
    if table.rows and min(len(row) for _, row in table.rows) < len(names):
        line = next(line for line, row in table.rows if len(row) < len(names))
        raise CaseError(
            f"line {line} ends too early", where=file, expected="all columns in every line"
        )
    x, *others = [Number.read(n, o) for n, o in zip(names, options, strict=True)]
    at, bare = _column(table, 0, x.unit, file)
    result = []
    for i, y in enumerate(others, start=1):
        values, also = _column(table, i, y.unit, file)
        lines, column = tuple(line for line, _ in table.rows), _name(table, 0)
        result.append(
            MeasuredCurve(
                x,
                y,
                at,
                values,
                source=file,
                bare=(*bare, *also),
                lines=lines,
                column=column,
            )
        )
    return result


def _heads(table: CsvTable, file: str) -> list[str]:
    if table.head is None:
        raise CaseError(
            "the file has no headings, and --of does not name its columns",
            where=file,
            expected=_FOR_EXAMPLE,
        )
    return [heading(head)[0] for head in table.head]


def _field(table: CsvTable, names: Sequence[str], file: str) -> MeasuredField:
    """A displacement field; `names` are those of the columns."""
    axes = [axis for axis in _AXES if axis in names]
    if axes not in (["x", "y"], ["x", "y", "z"]):
        known = ", ".join(table.head or ())
        missing = "y" if "x" in axes else "x"
        raise CaseError(
            f"no column has the {missing} of the points: {known}",
            where=f"{file}: line 1",
            expected="columns x, y (and z) beside ux, uy (and uz)",
        )
    for name in names:
        if name not in (*_AXES, *_SHIFTS, *_TIMES):
            raise CaseError(
                f"a displacement field has no column '{name}'",
                where=f"{file}: line 1",
                expected=nearest(name, (*_AXES, *_SHIFTS, *_TIMES)),
            )
    shifts = [name for name in _SHIFTS if name in names]
    if "uz" in shifts and "z" not in axes:
        raise CaseError("uz has no z of its points", where=f"{file}: line 1", expected="a column z")
    columns = {n: _column(table, names.index(n), "m", file) for n in (*axes, *shifts)}
    bare = [not heading((table.head or ())[names.index(axis)])[1] for axis in axes]
    if any(bare) and not all(bare):
        raise CaseError(
            "some places have a unit, others have none",
            where=f"{file}: line 1",
            expected="a unit in all headings, for example x [mm], or in none",
        )
    time = next((names.index(name) for name in _TIMES if name in names), None)
    never = np.full(len(table.rows), np.nan)
    times = never if time is None else _column(table, time, "", file)[0]
    return MeasuredField(
        np.column_stack([columns[axis][0] for axis in axes]),
        np.column_stack([columns[name][0] for name in shifts]),
        tuple(_SHIFTS.index(name) for name in shifts),
        times,
        tuple(line for line, _ in table.rows),
        in_mesh_unit=all(bare),
        source=file,
        bare=tuple(head for name in shifts for head in columns[name][1]),
        column="" if time is None else _name(table, time),
    )


def _name(table: CsvTable, index: int) -> str:
    """A column for messages."""
    return f"column '{table.head[index]}'" if table.head else f"column {index + 1}"


def _column(table: CsvTable, index: int, unit: str, file: str) -> tuple[FloatArray, list[str]]:
    """A column in SI units, shape (n,), and its heading where its numbers have no unit."""
    head = table.head[index] if table.head else ""
    where = f"{file}: {_name(table, index)}"
    given = heading(head)[1]
    if given and not unit and heading(head)[0].casefold() in _TIMES:
        unit = "s"
    factor = 1.0
    if given:
        try:
            factor = unit_to_si(given, unit) if unit else to_base(f"1 {given}")
        except UnitError as error:
            raise CaseError(error.what, where=where, expected=error.expected) from None
    result = numbers(table, index, unit, where, factor=factor)
    bare = bool(unit) and not given and all(is_number(row[index]) for _, row in table.rows)
    return result, [head or f"column {index + 1}"] if bare else []


# --- what a caller gives ---


def as_measured(
    data: object, of: Sequence[str] = (), weights: Mapping[str, float] | None = None
) -> list[Measured]:
    """All that was measured, with its weights. Not collective.

    Args:
        data: A path, a `MeasuredCurve` or `MeasuredField`, or a list of these.
        of: For each file of curves "X:Y", see `read_measured`; one alone stands for all; none:
            their headings name the numbers.
        weights: Name of a file, with or without its folder and suffix, to its weight; 1 by default.

    Raises:
        InputError: A file or a weight is wrong, or there is nothing.
    """
    given = [*data] if isinstance(data, list | tuple) else [data]
    named = itertools.repeat(of[0] if of else None) if len(of) < 2 else iter(of)
    result: list[Measured] = []
    for one in given:
        if isinstance(one, MeasuredCurve | MeasuredField):
            result.append(one)
        elif isinstance(one, str | Path):
            try:
                result += read_measured(Path(one), named)
            except StopIteration:
                raise _not_each(of) from None
        else:
            raise CaseError(f"{one!r} is nothing that was measured", expected="a path, or a curve")
    if len(of) > 1 and next(named, None) is not None:
        raise _not_each(of)
    if not result:
        raise CaseError("nothing was measured", expected="for example --measured curve.csv")
    return _weighed(result, weights or {})


def _not_each(of: Sequence[str]) -> CaseError:
    return CaseError(
        f"--of is given {len(of)} times, which is not the number of files with curves",
        where=_OF,
        expected="once for each of them, in their order, or once for all",
    )


def _weighed(sets: list[Measured], weights: Mapping[str, float]) -> list[Measured]:
    factors = [1.0] * len(sets)
    for name, weight in weights.items():
        if not (np.isfinite(weight) and weight > 0):
            raise CaseError(
                f"{name}: {weight:g} is no weight", where="--weight", expected="above 0"
            )
        sources = [Path(one.source) for one in sets]
        hits = [i for i, s in enumerate(sources) if name in (str(s), s.name, s.stem)]
        if not hits:
            raise CaseError(
                f"there is no file '{name}' to weigh",
                where="--weight",
                expected=nearest(name, [s.name for s in sources]),
            )
        for i in hits:
            factors[i] = weight
    return [replace(one, weight=one.weight * f) for one, f in zip(sets, factors, strict=True)]
