"""STL files, binary and text."""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup, check_count, content

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
_HEAD = 84


def read_stl(path: Path) -> Soup:
    """Reads an STL file; a text with several solids names their triangles. Local.

    Raises:
        MeshError: It is damaged.
    """
    data = content(path)
    stated = int.from_bytes(data[80:_HEAD], "little") if len(data) >= _HEAD else 0
    # The size decides: many programs write "solid" at the head of binary files, and some a few
    # bytes behind the last triangle.
    if 0 <= len(data) - (_HEAD + 50 * stated) < 50:
        check_count(stated, path.name)
        corners = np.frombuffer(data, _RECORD, stated, _HEAD)["corners"]
        rows = np.arange(3 * stated, dtype=np.int64).reshape(-1, 3)
        return Soup.of(corners.reshape(-1, 3).astype(np.float64), rows)
    if data[:512].lstrip(b"\xef\xbb\xbf \t\r\n")[:5].lower() == b"solid" and b"\0" not in data:
        return _text(data, path.name)
    raise MeshError(
        "it is no STL file, or a part of one: it is no text that begins with 'solid', and as a "
        f"binary file it states {stated} triangles, which are {_HEAD + 50 * stated} bytes; it has "
        f"{len(data)}",
        where=path.name,
        expected="all of the file, as it was written",
    )


def _text(data: bytes, name: str) -> Soup:
    numbers, groups, names = array("d"), array("q"), dict[str, int]()
    facets, number, now = 0, 0, 0
    for number, line in enumerate(data.splitlines(), start=1):
        word, _, rest = line.strip().partition(b" ")
        word = word.lower()
        if word == b"vertex":
            numbers.extend(_vertex(rest, line, name, number))
        elif word == b"solid":
            now = names.setdefault(" ".join(rest.decode("utf-8", "replace").split()), len(names))
        elif word == b"endloop":
            facets += 1
            groups.append(now)
            if len(numbers) != 9 * facets:
                raise _cut(
                    f"a loop has {len(numbers) // 3 - 3 * (facets - 1)} corners", name, number
                )
        elif word == b"outer" and len(numbers) != 9 * facets:
            raise _cut("a loop has no end", name, number)
    if len(numbers) != 9 * facets or b"endsolid" not in data[-400:].lower().replace(b" ", b""):
        raise _cut("it ends before its solid does", name, number)
    check_count(facets, name)
    rows = np.arange(3 * facets, dtype=np.int64).reshape(-1, 3)
    points = np.frombuffer(numbers, dtype=np.float64).reshape(-1, 3)
    # Of one solid the name is that of the part or of the program, and of no surface.
    several = len(names) > 1
    return Soup.of(
        points,
        rows,
        np.frombuffer(groups, dtype=np.int64) if several else None,
        tuple(names) if several else ("",),
    )


def _vertex(rest: bytes, line: bytes, name: str, number: int) -> list[float]:
    try:
        values = [float(word) for word in rest.split()]
    except ValueError:
        values = []
    if len(values) != 3:
        text = line.strip()[:80].decode("latin-1")
        raise MeshError(
            f"'{text}' is no vertex of three numbers",
            where=f"{name}:{number}",
            expected='for example "vertex 0.5 0 1.25"',
        )
    return values


def _cut(what: str, name: str, line: int) -> MeshError:
    return MeshError(
        what, where=f"{name}:{line}", expected="facets of three corners, and endsolid at the end"
    )
