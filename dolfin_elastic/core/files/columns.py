"""Columns of numbers in CSV files: cells as texts, each row with its line."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import (
    CaseError,
    InputError,
    UnitError,
    nearest,
    nearest_file,
    not_shown,
    why_no_file,
)
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import is_quantity, to_si

_MOST_BYTES = 1 << 26
_HEAD = re.compile(r"(?P<name>[^\[(]*?)\s*[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]\s*")


@dataclass(frozen=True)
class CsvTable:
    """A file's cells.

    Attributes:
        head: The headings, if there are any.
        rows: Number of the line and cells, without comments and empty lines.
        mark: Separator of the cells.
    """

    head: Sequence[str] | None
    rows: Sequence[tuple[int, list[str]]]
    mark: str

    def index(self, name: str, default: int) -> int:
        """Index of the column with a heading; without a name, the default.

        Raises:
            InputError: There are no headings, or not this one.
        """
        if not name:
            return default
        if self.head is None:
            raise InputError(
                f"the file has no headings, so no column '{name}'",
                expected="names of the columns in the first line",
            )
        if name not in self.head:
            raise InputError(f"there is no column '{name}'", expected=nearest(name, self.head))
        return self.head.index(name)

    def numbers(self, at: Sequence[int]) -> list[tuple[int, list[str]]]:
        """Number of the line, and cells of some columns: numbers, which may have units.

        Raises:
            InputError: There are no rows, a line is too short, or a cell is no number.
        """
        for line, row in self.rows:
            if len(row) <= max(at):
                raise InputError(
                    f"line {line} ends too early: {self.mark.join(row)!r}",
                    expected="all columns in every line",
                )
        if not self.rows:
            raise InputError(
                "there are headings but no numbers", expected="for example a line 0.1, 2.5"
            )
        result = [(line, [row[i] for i in at]) for line, row in self.rows]
        for (line, row), (_, cells) in zip(self.rows, result, strict=True):
            for cell in cells:
                if not is_quantity(cell):
                    comma = "," in cell and is_quantity(cell.replace(",", "."))
                    raise InputError(
                        f"'{cell}' is not a number, in line {line}: {self.mark.join(row)!r}",
                        expected="decimal points, not commas" if comma else "for example 0.1, 2.5",
                    )
        return result


def numbers(
    table: CsvTable, index: int, unit: str, where: str, *, factor: float = 1.0
) -> FloatArray:
    """A column in SI units, shape (n,).

    Args:
        unit: SI unit of its numbers, in which texts with a unit are read; empty: pure numbers.
        where: File and column, for messages.
        factor: SI units per unit of bare numbers.

    Raises:
        CaseError: A cell is no finite number; with its line.
    """
    result = []
    for line, row in table.rows:
        cell = row[index] if index < len(row) else ""
        try:
            result.append(factor * float(cell) if is_number(cell) else to_si(cell, unit))
        except UnitError as error:
            hint = "decimal points" if "," in cell else "a number, for example 1.5"
            what = f"line {line}: {error.what if cell else 'the cell is empty'}"
            raise CaseError(what, where=where, expected=hint) from None
        if not math.isfinite(result[-1]):
            what = f"line {line}: '{cell}' is not a finite number"
            raise CaseError(what, where=where, expected="leave the line out")
    return np.array(result)


def read_csv(path: Path) -> CsvTable:
    """Reads a file of at least two columns. Not collective.

    The separator is the first of ; tab and comma in the first line; a first line that does not
    begin with a number holds headings.

    Raises:
        InputError: It cannot be read, or has a single column.
    """
    if fault := why_no_file(path, _MOST_BYTES):
        raise InputError(fault)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        others = sorted(p.name for p in path.parent.glob("*.csv"))
        near = nearest_file(path.name, others) if others else "paths are relative to the case file"
        hint = not_shown(path) or near
        raise InputError("there is no such file", expected=hint) from None
    except (OSError, UnicodeDecodeError):
        raise InputError(
            "this is no text file that can be read", expected="columns of numbers, saved in UTF-8"
        ) from None
    lines = {
        number: line
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    }
    first = next(iter(lines.values()), "")
    mark = next((m for m in ";\t," if m in first), ",")
    numbers, reader = [*lines], csv.reader(lines.values(), delimiter=mark, quoting=csv.QUOTE_NONE)
    try:
        rows = [(numbers[reader.line_num - 1], [cell.strip() for cell in row]) for row in reader]
    except csv.Error:  # a cell of more than 100,000 characters
        raise InputError(
            "this is no text file that can be read", expected="columns of numbers, saved in UTF-8"
        ) from None
    if not rows:
        raise InputError("the table is empty", expected="for example a line 0.1, 2.5")
    line, first_row = rows[0]
    if len(first_row) < 2:
        blanks = len(first_row[0].split()) > 1
        raise InputError(
            f"line {line}: a table needs two columns",
            expected="a comma, semicolon or tab between columns, not blanks"
            if blanks
            else "for example a line 0.1, 2.5",
        )
    head = None if is_number(first_row[0]) or is_quantity(first_row[0]) else rows.pop(0)[1]
    if head is not None:
        _check_widths(head, rows, mark)
    return CsvTable(head, rows, mark)


def _check_widths(head: Sequence[str], rows: Sequence[tuple[int, list[str]]], mark: str) -> None:
    """Refuses cells beyond the last heading, as a decimal comma makes them.

    Raises:
        InputError: A line has some.
    """
    for line, row in rows:
        if any(row[len(head) :]):
            raise InputError(
                f"line {line} has {len(row)} cells below {len(head)} headings: {mark.join(row)!r}",
                expected="decimal points, not commas; and a heading for each column",
            )


def heading(text: str) -> tuple[str, str]:
    """Name and unit of a heading such as "stress [MPa]"; the unit is empty where it has none."""
    match = _HEAD.fullmatch(text)
    return (match["name"].strip(), match["unit"]) if match else (text.strip(), "")


def is_number(text: str) -> bool:
    """Whether a text is a number without a unit; nan and inf are."""
    try:
        float(text)
    except ValueError:
        return False
    return True
