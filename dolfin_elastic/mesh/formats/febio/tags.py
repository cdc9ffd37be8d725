"""The tags of an FEBio file with the line of each, and its lists of nodes and elements as numbers.

Read by expat rather than into a tree of the standard library, which states no lines and needs half
a kilobyte for each node and element.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from dolfin_elastic.core.errors import MeshError, not_shown, why_no_file

_LISTS = frozenset(("Nodes", "Elements", "NodeSet", "Surface", "Edge", "ElementSet"))
"""Tags whose children are rows of numbers."""
_DEEPEST = 40
_CHUNK = 1 << 20
SPECIFICATIONS = ("2.0", "2.5", "3.0", "4.0")


@dataclass(slots=True)
class Rows:
    """Children of one name in a list.

    Attributes:
        ids: Their numbers; 0: without one.
        values: What they contain, one after the other.
        counts: Number of values of each.
        lines: Line of each.
    """

    ids: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    counts: array[int] = field(default_factory=lambda: array("l"))
    lines: array[int] = field(default_factory=lambda: array("l"))


@dataclass(slots=True)
class Tag:
    """A tag.

    Attributes:
        text: What it contains beside children, without blanks around it.
        children: In their order; those of lists are `rows`.
        rows: Name to the children of a list.
    """

    name: str
    attributes: dict[str, str]
    file: str
    line: int
    text: str = ""
    children: list[Tag] = field(default_factory=list)
    rows: dict[str, Rows] = field(default_factory=dict)

    def error(self, what: str, expected: str = "", line: int = 0) -> MeshError:
        """An error that names file and line."""
        return MeshError(what, where=f"{self.file}:{line or self.line}", expected=expected)

    def all(self, *names: str) -> Iterator[Tag]:
        """Children of these names."""
        return (child for child in self.children if child.name in names)

    def first(self, name: str) -> Tag | None:
        """The first child of a name."""
        return next(self.all(name), None)

    def content(self, name: str, default: str = "") -> str:
        """Text of the first child of a name."""
        child = self.first(name)
        return default if child is None else child.text


def read_tags(path: Path) -> Tag:
    """The file as a tree, with the sections that it includes from files beside it. Not collective.

    Raises:
        MeshError: It is no FEBio file, cannot be read, or is of a specification that is not read.
    """
    root = _Parser(path).root()
    version = root.attributes.get("version", "")
    if root.name != "febio_spec" or version not in SPECIFICATIONS:
        what = f"version {version}" if root.name == "febio_spec" else f"<{root.name}>"
        raise root.error(
            f"this is no FEBio file of the specifications {', '.join(SPECIFICATIONS)}: {what}",
            "the model saved anew by FEBio Studio",
        )
    root.children = [section for child in root.children for section in _included(path, child)]
    return root


def _included(path: Path, section: Tag) -> list[Tag]:
    """A section, or those of the file that it names."""
    everything = section.name == "Include"
    name = section.text if everything else section.attributes.get("from", "")
    if not name:
        return [section]
    inner = path.parent / name
    if name != inner.name or inner.is_symlink() or why_no_file(inner, sys.maxsize):
        raise section.error(
            f"the included file '{name[:80]}' is not in the folder of this file",
            "copy it there, and write its name without a folder",
        )
    if not inner.is_file():
        raise section.error(f"there is no included file '{name}'", not_shown(inner))
    found = [s for s in _Parser(inner).root().children if everything or s.name == section.name]
    for other in found:
        if other.name == "Include" or other.attributes.get("from"):
            raise other.error("an included file includes another one", "all of it in one file")
    if not found:
        raise section.error(f"'{name}' has no section <{section.name}>")
    return found


class _Parser:
    """Reads one file.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stack: list[Tag] = []
        self._text: list[str] = []
        self._row: tuple[str, int, int] | None = None
        self._root: Tag | None = None
        parser = self._parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text.append
        parser.EntityDeclHandler = self._refuse

    def root(self) -> Tag:
        """The outermost tag."""
        if fault := why_no_file(self._path, sys.maxsize):
            raise MeshError(fault, where=self._path.name)
        try:
            with self._path.open("rb") as file:
                while chunk := file.read(_CHUNK):
                    self._parser.Parse(chunk, False)
            self._parser.Parse(b"", True)
        except expat.ExpatError as error:
            raise MeshError(
                f"the XML file is damaged: {expat.ErrorString(error.code)}",
                where=f"{self._path.name}:{error.lineno}",
                expected="the file as it was written",
            ) from None
        assert self._root is not None  # expat refuses a file without an element
        return self._root

    def _error(self, what: str, expected: str = "") -> MeshError:
        where = f"{self._path.name}:{self._parser.CurrentLineNumber}"
        return MeshError(what, where=where, expected=expected)

    def _refuse(self, *_: object) -> None:
        raise self._error("definitions of entities (<!ENTITY) are not read", "a file without them")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        if self._row is not None or len(self._stack) == _DEEPEST:
            raise self._error(f"<{name[:40]}> stands too deep")
        if self._stack and self._stack[-1].name in _LISTS:
            number = attributes.get("id", "0")
            if not number.isdecimal() or len(number) > 18:
                raise self._error(f'id="{number[:40]}" is no whole number')
            self._stack[-1].text += "".join(self._text)
            self._text.clear()
            self._row = name, int(number), line
            return
        tag = Tag(name, attributes, self._path.name, line)
        if self._stack:
            self._stack[-1].text += "".join(self._text).strip()
            self._stack[-1].children.append(tag)
        else:
            self._root = tag
        self._text.clear()
        self._stack.append(tag)

    def _end(self, _: str) -> None:
        text = "".join(self._text).strip()
        self._text.clear()
        if self._row is None:
            tag = self._stack.pop()
            tag.text = (tag.text + text).strip()
            return
        name, number, line = self._row
        self._row = None
        try:
            values = [float(word) for word in text.split(",")] if text else []
        except ValueError:
            raise self._error(
                f"'{text[:60]}' are no numbers", "numbers with commas between them"
            ) from None
        rows = self._stack[-1].rows.setdefault(name, Rows())
        rows.ids.append(number)
        rows.values.extend(values)
        rows.counts.append(len(values))
        rows.lines.append(line)
