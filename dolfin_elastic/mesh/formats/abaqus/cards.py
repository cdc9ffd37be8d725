"""Keyword lines of an Abaqus input file with the data lines below them."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dolfin_elastic.core.errors import MeshError, not_shown, why_no_file
from dolfin_elastic.core.types import FloatArray, IntArray

Number = TypeVar("Number", np.int64, np.float64)
_DEEPEST = 5  # files within files
_WITH_INPUT = ("NODE", "ELEMENT", "NSET", "ELSET")


@dataclass
class Card:
    """One keyword line and the data lines below it.

    Attributes:
        word: The keyword in capitals, without its star.
        options: Parameters of the keyword line; keys in capitals.
        file: Name of the file that it stands in.
        line: Number of the keyword line, from 1.
        lines: Data lines.
        at: Number of each data line, from 1.
    """

    word: str
    options: dict[str, str]
    file: str
    line: int
    lines: list[str] = field(default_factory=list)
    at: list[int] = field(default_factory=list)

    def error(self, what: str, *, row: int | None = None, expected: str = "") -> MeshError:
        """An error that names the file and the line.

        Args:
            row: Index of the data line that is wrong; by default the keyword line is.
        """
        line = self.line if row is None else self.at[row]
        return MeshError(f"*{self.word}: {what}", where=f"{self.file}:{line}", expected=expected)

    def option(self, key: str) -> str:
        """Value of a required parameter."""
        if not self.options.get(key):
            raise self.error(f"{key}= is missing", expected=f"write {key}=NAME behind the keyword")
        return self.options[key]

    def fields(self) -> Iterator[tuple[int, str]]:
        """Comma-separated entries that are not blank, each after the index of its line."""
        for row, line in enumerate(self.lines):
            for word in line.split(","):
                if word := word.strip():
                    yield row, word

    def integers(self, width: int) -> IntArray:
        """All entries as integers, shape (n, width)."""
        text = ",".join(line.rstrip().rstrip(",") for line in self.lines)
        numbers = _parsed(text, np.int64)
        try:
            if numbers is None:
                numbers = np.array([word for _, word in self.fields()], dtype=np.int64)
        except (ValueError, OverflowError):
            row, word = next((row, word) for row, word in self.fields() if not _is_whole(word))
            raise self.error(f"'{word}' is no whole number", row=row) from None
        self._check_rows(width)
        return numbers.reshape(-1, width)

    def _check_rows(self, width: int) -> None:
        """Refuses a line that ends one row of numbers and begins the next: its kind has others."""
        counts = [line.count(",") + 1 for line in self.lines]
        if all(count == width for count in counts) and not any(
            line.rstrip().endswith(",") for line in self.lines
        ):
            return
        before = 0
        for row, line in enumerate(self.lines):
            before += sum(bool(word.strip()) for word in line.split(","))
            last = row + 1 == len(self.lines)
            if before > width or (last and before != width):
                raise self.error(
                    f"{before} numbers do not make rows of {width}; "
                    "the file is damaged or cut short, or the elements are of another type",
                    row=row,
                )
            before = 0 if before == width else before

    def integer(self, row: int | None, word: str) -> int:
        """An entry of a data line, or without one of the keyword line, as an integer."""
        if not _is_whole(word):
            raise self.error(f"'{word}' is no whole number", row=row)
        return int(word)

    def first_integers(self) -> IntArray:
        """The first entry of each row; a line that ends with a comma goes on."""
        result, begins = [], True
        for row, line in enumerate(self.lines):
            word = line.partition(",")[0].strip()
            result += [self.integer(row, word)] if begins else []
            begins = not line.rstrip().endswith(",")
        return np.array(result, dtype=np.int64)

    def numbers(self, width: int) -> FloatArray:
        """The first entries of each line; what is blank or left out is zero.

        Args:
            width: Number of entries; the first may not be blank.

        Returns:
            Shape (lines, width).
        """
        if all(line.count(",") == width - 1 for line in self.lines):
            numbers = _parsed(",".join(self.lines), np.float64)
            if numbers is not None:
                return numbers.reshape(-1, width)
        rows = [[*line.split(","), *[""] * width][:width] for line in self.lines]
        try:
            return np.array(rows, dtype=np.float64).reshape(-1, width)
        except ValueError:  # blank fields, exponents of Fortran, or no numbers
            return np.array([self._number_row(i, words) for i, words in enumerate(rows)])

    def _number_row(self, row: int, words: list[str]) -> list[float]:
        words = [words[0].strip(), *(word.strip() or "0" for word in words[1:])]
        try:
            return [float(word.upper().replace("D", "E", 1)) for word in words]
        except ValueError:
            raise self.error(
                f"'{self.lines[row].strip()[:60]}' is not a row of numbers",
                row=row,
                expected="for example 12, 0.5, 0., 1.25; a blank field is zero",
            ) from None


def _parsed(text: str, kind: type[Number]) -> npt.NDArray[Number] | None:
    """Numbers between commas, ten times as fast as word by word; None if some are no numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(text, dtype=kind, sep=",")
        except (ValueError, DeprecationWarning):
            return None
    return numbers if len(numbers) == text.count(",") + 1 else None


def _is_whole(word: str) -> bool:
    try:
        return abs(int(word)) < 1 << 63
    except ValueError:
        return False


def read_cards(path: Path, depth: int = 0, above: Card | None = None) -> Iterator[Card]:
    """Keywords of a file, and of those that it includes, in their order.

    Args:
        depth: Number of the files that include this one.
        above: The keyword before it, whose data lines may go on in it.

    Raises:
        MeshError: A file that is included does not exist, or includes itself.
    """
    if depth > _DEEPEST:
        raise MeshError(
            "*INCLUDE goes round in a circle",
            where=path.name,
            expected="leave out that of a file that includes this one",
        )
    card = _goes_on(above, path, 1)
    continued = ""
    if fault := why_no_file(path, sys.maxsize):
        raise MeshError(fault, where=path.name)
    for number, line in enumerate(_text(path), start=1):
        if _is_comment(line):
            continue
        if not continued and not line.lstrip().startswith("*"):
            card.lines.append(line)
            card.at.append(number)
            continue
        continued += line.strip()
        if continued.endswith(","):  # the keyword line goes on
            continue
        yield from _complete(card, path)
        last = card
        card, continued = _card(continued, path.name, number), ""
        if card.word == "INCLUDE":
            inner = _input(card, path)
            for inside in read_cards(inner, depth + 1, last):
                yield inside
                last = inside
            card = _goes_on(last, path, number)
    yield from _complete(card, path)


def _text(path: Path) -> list[str]:
    """Lines of a file, without the mark of UTF-8 that editors of Windows put before the first."""
    return path.read_bytes().removeprefix(b"\xef\xbb\xbf").decode("latin-1").splitlines()


def _is_comment(line: str) -> bool:
    """Whether a line is blank or a comment, which some programs indent."""
    return not line.strip() or line.lstrip().startswith("**")


def _goes_on(above: Card | None, path: Path, line: int) -> Card:
    """A card for data lines that belong to a keyword in another file; often there are none."""
    if above is None or above.word not in _WITH_INPUT:
        return Card("", {}, path.name, line)
    options = {key: value for key, value in above.options.items() if key != "INPUT"}
    return Card(above.word, options, path.name, line)


def _complete(card: Card, path: Path) -> Iterator[Card]:
    """A keyword with its data lines, and those of the file that its INPUT names."""
    if card.word not in _WITH_INPUT or "INPUT" not in card.options:
        yield card
        return
    inner = _input(card, path)
    options = {key: value for key, value in card.options.items() if key != "INPUT"}
    yield replace(card, options=options)
    data = [
        (number, line) for number, line in enumerate(_text(inner), start=1) if not _is_comment(line)
    ]
    result = Card(card.word, options, inner.name, 1)
    result.lines, result.at = [line for _, line in data], [number for number, _ in data]
    for row, line in enumerate(result.lines):
        if line.lstrip().startswith("*"):
            raise result.error(
                "a keyword in a file of INPUT=", row=row, expected="data lines, or *INCLUDE"
            )
    yield result


def _input(card: Card, path: Path) -> Path:
    """The file that a keyword reads."""
    inner = path.parent / card.option("INPUT").replace("\\", "/")  # as Windows writes it
    if not inner.is_file():
        hint = not_shown(inner) or "the file that it names, beside the deck"
        raise card.error(f"there is no file '{inner}'", expected=hint)
    return inner


def _card(text: str, file: str, line: int) -> Card:
    word, *options = (part.strip() for part in text.lstrip("*").split(","))
    pairs = (option.partition("=") for option in options)
    values = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs if key}
    return Card(" ".join(word.upper().split()), values, file, line)
