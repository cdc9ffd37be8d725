"""Bulk data entries of a Nastran file, in small, large and free field format.

Source: MSC Nastran 2021, Quick Reference Guide, section 5, "Format of Bulk Data Entries".
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dolfin_elastic.core.errors import MeshError, not_shown, why_no_file

_DEEPEST = 5  # files within files
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EeDd]?([+-]\d+)|[EeDd](\d+))?")


@dataclass(frozen=True)
class _Line:
    """A line without its comment: number from 1, and the file that it stands in."""

    text: str
    file: str
    number: int

    def error(self, what: str, expected: str = "") -> MeshError:
        """An error that names file and line."""
        return MeshError(what, where=f"{self.file}:{self.number}", expected=expected)


@dataclass(frozen=True)
class Entry:
    """One entry with its continuations.

    Attributes:
        name: In capitals, without a star.
        fields: Its fields from the second one on, without those that continue it; blank ones are
            empty.  A line gives eight, or four of large ones.
        line: Its first line.
    """

    name: str
    fields: list[str]
    line: _Line

    def error(self, what: str, expected: str = "") -> MeshError:
        """An error that names file and line."""
        return self.line.error(f"{self.name}: {what}", expected)

    @property
    def place(self) -> tuple[str, int]:
        """File and line."""
        return self.line.file, self.line.number

    def text(self, index: int) -> str:
        """A field; empty where it is blank or left out."""
        return self.fields[index] if index < len(self.fields) else ""

    def integer(self, index: int, default: int | None = None) -> int:
        """A whole number that is not negative.

        Args:
            index: Of the field: 0 is the second one of the entry.
            default: Value of a blank one; None: it is needed.
        """
        word = self.text(index)
        if not word and default is not None:
            return default
        if not word.removeprefix("+").isdecimal() or len(word) > 18:
            raise self.error(f"field {index + 2} is '{word}', no whole number")
        return int(word)

    def real(self, index: int) -> float:
        """A number, with exponents as in "1.5-3"; a blank one is 0."""
        word = self.text(index)
        match = _NUMBER.fullmatch(word) if word else None
        if word and not match:
            raise self.error(
                f"field {index + 2} is '{word}', no number",
                expected="for example 1.5, -2.E3 or 1.5-3",
            )
        value = float(f"{match[1]}e{match[2] or match[3] or 0}") if match else 0.0
        if not math.isfinite(value):
            raise self.error(f"field {index + 2} is '{word}', no finite number")
        return value


@dataclass(frozen=True)
class Command:
    """A line of executive or case control.

    Attributes:
        text: Without its comment, in capitals but for titles.
        file: The file that it stands in.
        number: Its line, from 1.
    """

    text: str
    file: str
    number: int


def read_control(path: Path) -> list[Command]:
    """Executive and case control of a file; none where it is bulk data as a whole. Local.

    Raises:
        MeshError: See `read_entries`.
    """
    found = list[Command]()
    for line in _lines(path):
        if line.text.upper().split()[0] == "BEGIN":
            return found
        found.append(Command(line.text.strip(), line.file, line.number))
    return []


def read_entries(path: Path) -> Iterator[Entry]:
    """All entries of the bulk data of a file, and of those that it includes, in their order.

    Executive and case control are passed over; a file without them is bulk data as a whole.

    Raises:
        MeshError: A line cannot be read, an included file is not there, or the end is missing.
    """
    last: _Line | None = None
    entry: Entry | None = None
    mark = ""
    for line in _bulk(path):
        last = line
        if line.text.split()[0].upper() == "ENDDATA":
            if entry:
                yield entry
            return
        name, fields, following = _split(line)
        if name[:1] in ("", "+", "*"):
            _continue(entry, line, name, fields, mark)
            mark = following
            continue
        if entry:
            yield entry
        # Most entries are not of the mesh: only their names are looked at.
        entry, mark = Entry(name.rstrip("*").strip().upper(), fields, line), following
    where = last or _Line("", path.name, 1)
    raise where.error("there is no ENDDATA: the file may be cut short", "ENDDATA as its last line")


def _continue(entry: Entry | None, line: _Line, name: str, fields: list[str], mark: str) -> None:
    """Adds the fields of a line to the entry whose last field was the mark."""
    if entry is None:
        raise line.error("this line continues none")
    own, wanted = (text.lstrip("+*").strip().upper() for text in (name, mark))
    if own and wanted and own not in (wanted, mark[1:].upper()):  # + is any letter
        raise line.error(
            f"the continuation '{name}' does not follow its line, which ends in '{mark}'",
            "continuations below their lines",
        )
    entry.fields.extend(fields)


def _split(line: _Line) -> tuple[str, list[str], str]:
    """First field of a line, its fields of data, and its last one, which marks a continuation."""
    text = line.text
    if text.startswith("="):
        raise line.error("entries made by replication (=) are not understood", "write them out")
    if "," in text:
        words = [word.strip() for word in text.split(",")]
        count = 4 if words[0].endswith("*") or words[0].startswith("*") else 8
        while len(words) > count + 2 and not words[-1]:
            words.pop()
        if len(words) > count + 2:
            raise line.error(
                f"the line has {len(words)} fields, more than {count + 2}",
                "the rest on the next line",
            )
        mark = words[count + 1] if len(words) > count + 1 else ""
        return words[0], (words[1 : count + 1] + [""] * count)[:count], mark
    text = text.expandtabs(8)
    name = text[:8].strip()
    large = name.endswith("*") or name.startswith("*")
    width, count = (16, 4) if large else (8, 8)
    ends = range(8, 8 + width * count, width)
    return name, [text[at : at + width].strip() for at in ends], text[72:80].strip()


def _bulk(path: Path) -> Iterator[_Line]:
    """The lines of the bulk data."""
    lines, before = _lines(path), list[_Line]()
    for line in lines:
        words = line.text.upper().replace("=", " ").split()
        if words[:2] == ["BEGIN", "BULK"] or words[:1] == ["BEGIN"]:
            if len(words) > 2 or words[1:] != ["BULK"]:
                raise line.error(
                    f"'{' '.join(words)}': superelements are not understood", "BEGIN BULK"
                )
            before = []
            break
        before.append(line)
    yield from before  # there is no BEGIN: all of it is bulk data
    for line in lines:
        if line.text.upper().split()[:1] == ["BEGIN"]:
            raise line.error("a second section of bulk data is not understood", "one mesh")
        yield line


def _lines(path: Path, depth: int = 0) -> Iterator[_Line]:
    """Lines that are neither blank nor comments, those of included files in their place."""
    if depth > _DEEPEST:
        raise MeshError(
            "INCLUDE goes round in a circle",
            where=path.name,
            expected="leave out that of a file that includes this one",
        )
    if fault := why_no_file(path, sys.maxsize):
        raise MeshError(fault, where=path.name)
    quoted: tuple[_Line, str] | None = None
    # Editors of Windows put a mark of UTF-8 before the first line.
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    for number, text in enumerate(content.splitlines(), start=1):
        line = _Line(text.partition("$")[0].rstrip(), path.name, number)
        if quoted is not None:
            first, name = quoted[0], quoted[1] + line.text.strip()
        elif line.text.lstrip()[:7].upper() == "INCLUDE":
            first, name = line, line.text.lstrip()[7:].strip().lstrip("=").strip()
        else:
            if line.text.strip():
                yield line
            continue
        if name[:1] in "'\"" and (len(name) < 2 or name[-1] != name[0]):
            quoted = first, name  # the name goes on
            continue
        quoted = None
        yield from _included(path, first, name.strip("'\""), depth)
    if quoted is not None:
        raise quoted[0].error("the name of the included file has no end", "INCLUDE 'part.bdf'")


def _included(path: Path, line: _Line, name: str, depth: int) -> Iterator[_Line]:
    inner = path.parent / name.replace("\\", "/")  # as Windows writes it
    if not name or not inner.is_file():
        hint = not_shown(inner) or f"the file that it names, at '{inner}'"
        raise line.error(f"INCLUDE: there is no file '{name}'", hint)
    yield from _lines(inner, depth + 1)
