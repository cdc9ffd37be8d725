"""Curves and records in CSV files: times in one column, values in another."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from dolfin_elastic.core.errors import (
    CaseError,
    InputError,
    keyed,
    nearest,
    nearest_file,
    not_shown,
    why_no_file,
)
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.units import is_quantity
from dolfin_elastic.model.amplitude import Amplitude, CurveFile
from dolfin_elastic.model.records import RecordTable

R = TypeVar("R", bound=Record)

CURVED = ("support", "load", "contact", "periodic")
"""Keys of a case whose tables, or whose lists' tables, may have a `curve` or records."""


def with_curves(case: R, folder: Path) -> R:
    """The same case, its curves and records read from their files. Not collective.

    Args:
        case: A record with the keys `CURVED`.
        folder: Folder that the paths are relative to.

    Raises:
        InputError: A file that cannot be read, or that has no such columns.
    """
    read: dict[str, Any] = {}
    for key in CURVED:
        found = getattr(case, key)
        if isinstance(found, list):
            rows = [_with_files(row, f"{key}[{i}]", folder) for i, row in enumerate(found)]
            if any(row is not old for row, old in zip(rows, found, strict=True)):
                read[key] = rows
        elif found is not None and (table := _with_files(found, key, folder)) is not found:
            read[key] = table
    return case.model_copy(update=read) if read else case


def has_curve_files(case: Record) -> bool:
    """Whether `with_curves` reads files.

    Args:
        case: A record with the keys `CURVED`.
    """
    curve = [getattr(case, key) for key in CURVED]
    rows = [row for table in curve for row in (table if isinstance(table, list) else [table])]
    return any(_unread(row) is not None or [*_unread_records(row)] for row in rows)


def _unread(row: object) -> Amplitude | None:
    """The curve of a table whose file is still to be read."""
    curve = getattr(row, "curve", None)
    is_unread = isinstance(curve, Amplitude) and curve.source is not None and not curve.rows
    return curve if is_unread else None


def _unread_records(row: object) -> Iterator[str]:
    """Keys of a table that hold records whose files are still to be read."""
    for key in type(row).model_fields if isinstance(row, Record) else ():
        value = getattr(row, key)
        parts = value if isinstance(value, list | tuple) else [value]
        if any(_is_unread(part) for part in parts):
            yield key


def _is_unread(value: object) -> bool:
    if not isinstance(value, Mapping) or "field" in value:  # one of a mesh: see `field_files`
        return False
    return "file" in value and not isinstance(value, RecordTable)


def _with_files(row: R, where: str, folder: Path) -> R:
    curve, read = _unread(row), dict[str, Any]()
    if curve is not None:
        assert curve.source is not None
        with _of_file(curve.source.file, f"{where}.curve"):
            read["curve"] = curve.with_rows(_columns(curve.source, folder / curve.source.file))
    for key in _unread_records(row):
        value = getattr(row, key)
        if isinstance(value, list | tuple):
            place = f"{where}.{key}[{{}}]"
            read[key] = [_with_rows(part, place.format(i), folder) for i, part in enumerate(value)]
        else:
            read[key] = _with_rows(value, f"{where}.{key}", folder)
    if not read:
        return row
    with keyed(where):  # made anew, for it has read the value
        return type(row)(**{key: getattr(row, key) for key in row.model_fields_set} | read)


def _with_rows(value: object, where: str, folder: Path) -> object:
    """A record with the rows of its file; anything else as it is."""
    if not _is_unread(value):
        return value
    assert isinstance(value, Mapping)
    result = RecordTable(value)
    source = CurveFile(*(str(value.get(key, "")) for key in ("file", "time", "value")))
    with _of_file(source.file, where):
        result.rows = _columns(source, folder / source.file)
    return result


@contextmanager
def _of_file(name: str, where: str) -> Iterator[None]:
    """Errors that are raised inside name a file and the key that refers to it."""
    try:
        yield
    except InputError as error:
        raise CaseError(f"{name}: {error.what}", where=where, expected=error.expected) from None


_MOST_BYTES = 1 << 26
"""Size of a file of a curve."""


def _columns(source: CurveFile, path: Path) -> list[list[str]]:
    """Rows of time and value as texts, which may have units.

    The separator is the first of ; tab and comma in the first line; a first line that does not
    begin with a number holds headings.
    """
    if fault := why_no_file(path, _MOST_BYTES):
        raise InputError(fault)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        others = sorted(p.name for p in path.parent.glob("*.csv"))
        near = nearest_file(path.name, others) if others else "paths are relative to the case file"
        hint = not_shown(path) or near
        raise InputError("there is no such file", expected=hint) from None
    except (OSError, UnicodeDecodeError):
        raise InputError(
            "this is no text file that can be read", expected="columns of numbers, saved in UTF-8"
        ) from None
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    mark = next((m for m in ";\t," if lines and m in lines[0]), ",")
    table = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    if not table or len(table[0]) < 2:
        raise InputError("a curve needs two columns", expected="for example a line 0.1, 2.5")
    head = None if _number(table[0][0]) else table.pop(0)
    at = [_column_index(source.time, head, 0), _column_index(source.value, head, 1)]
    if short := [row for row in table if len(row) <= max(at)]:
        raise InputError(
            f"the line {mark.join(short[0])!r} ends too early",
            expected="both columns in every line",
        )
    if not table:
        raise InputError(
            "there are headings but no numbers", expected="for example a line 0.1, 2.5"
        )
    _check_numbers(table, at, mark)
    if mark == "," and all(len(row) > 2 for row in table) and not source.time + source.value:
        _refuse_commas(lines, head)
    return [[row[i] for i in at] for row in table]


def _check_numbers(table: list[list[str]], at: list[int], mark: str) -> None:
    """Refuses cells that are no numbers, with advice where a decimal comma is the reason."""
    for row in table:
        for cell in (row[i] for i in at):
            if not is_quantity(cell):
                comma = "," in cell and is_quantity(cell.replace(",", "."))
                raise InputError(
                    f"'{cell}' is not a number, in the line {mark.join(row)!r}",
                    expected="decimal points, not commas" if comma else "for example 0.1, 2.5",
                )


def _refuse_commas(lines: list[str], head: list[str] | None) -> None:
    """Refuses four unnamed columns of whole numbers: they may be two with decimal commas."""
    cells = [line.split(",") for line in lines]
    whole = all(cell.strip().lstrip("+-").isdigit() for row in cells for cell in row)
    if head is None and whole and all(len(row) == 4 for row in cells):
        raise InputError(
            f"the line {lines[0]!r} has 4 columns: are its commas decimal ones?",
            expected="decimal points; or name the columns by headings, and by time and value",
        )


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _column_index(name: str, head: list[str] | None, default: int) -> int:
    """Index of the column with a heading; without a name, of the default one."""
    if not name:
        return default
    if head is None:
        raise InputError(
            f"the file has no headings, so no column '{name}'",
            expected="names of the columns in the first line, or leave time and value out",
        )
    if name not in head:
        raise InputError(f"there is no column '{name}'", expected=nearest(name, head))
    return head.index(name)
