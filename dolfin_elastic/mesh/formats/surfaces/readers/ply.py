"""PLY files: text, and binary of both byte orders."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.surfaces.readers.polygons import cut
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup, check_count, content

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
    **{"int64": "i8", "uint64": "u8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_ROWS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    count_kind: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _Columns:
    """Numbers of an element: of a list the numbers of all rows, and how many each has."""

    plain: dict[str, AnyArray] = field(default_factory=dict)
    lists: dict[str, tuple[IntArray, AnyArray]] = field(default_factory=dict)


def read_ply(path: Path) -> Soup:
    """Reads a PLY file. Local.

    Raises:
        MeshError: It is damaged.
    """
    data, name = content(path), path.name
    order, elements, start, line = _header(data, name)
    read = _Text(data[start:], name, line) if order == "" else _Binary(data, start, order, name)
    found: dict[str, _Columns] = {}
    filled = (element.name for element in elements if element.count)
    kind = next((name for name in filled if name in ("face", "tristrips")), "face")
    for element in elements:
        try:
            found[element.name] = read.element(element)
        except MeshError:
            raise
        except (ValueError, OverflowError) as error:  # of names, types and counts of its header
            raise MeshError(
                f"its elements of the kind {element.name[:40]} cannot be read: {error}", where=name
            ) from None
        if {"vertex", kind} <= set(found):
            break
    if not {"vertex", kind} <= set(found):
        raise MeshError(
            f"it has no {'faces' if 'vertex' in found else 'vertices'}",
            where=name,
            expected="a surface of triangles; a cloud of points has none",
        )
    points = _points(found["vertex"], name)
    counts, corners = _polygons(found[kind], name)
    if kind == "tristrips":
        counts, corners = _triangles(counts, corners)
    check_count(int(np.maximum(counts - 2, 0).sum()), name)
    if len(bad := np.flatnonzero((corners < 0) | (corners >= len(points)))):
        face = int(np.searchsorted(np.cumsum(counts), bad[0], side="right"))
        raise MeshError(
            f"face {face} refers to vertex {corners[bad[0]]}, which does not exist; there are "
            f"{len(points)}",
            where=name,
        )
    return Soup.of(points, cut(points, counts, corners, name)[0])


def _header(data: bytes, name: str) -> tuple[str, list[_Element], int, int]:
    """Byte order, elements, where their numbers begin, and after which line."""
    end = re.search(rb"(?:\r\n|\n|\r)end_header[ \t]*(?:\r\n|\n|\r)", data[: 1 << 20])
    if not data.startswith(b"ply") or end is None:
        raise MeshError("it is no PLY file: it has no header", where=name)
    order, elements, number = None, list[_Element](), 0
    lines = data[: end.end()].decode("latin-1").splitlines()
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = _ORDERS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2])))
            elif words[:2] == ["property", "list"]:
                kinds = _TYPES[words[3]], _TYPES[words[2]]
                elements[-1].properties.append(_Property(words[4], *kinds))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
        except (IndexError, KeyError, ValueError):
            raise _no_line(line, f"{name}:{number}") from None
        if elements and not 0 <= elements[-1].count < 1 << 40:
            raise _no_line(line, f"{name}:{number}")
    if order is None:
        raise MeshError("its header has no format", where=name)
    return order, elements, end.end(), number


def _no_line(line: str, where: str) -> MeshError:
    return MeshError(f"'{line.strip()[:80]}' is no line of a PLY header", where=where)


class _Text:
    def __init__(self, data: bytes, name: str, line: int) -> None:
        self._lines, self._name, self._line = iter(data.splitlines()), name, line

    def element(self, element: _Element) -> _Columns:
        """The next element: each row is a line."""
        plain: dict[str, list[float]] = {p.name: [] for p in element.properties}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_kind}
        for _ in range(element.count):
            words = self._next(element)
            try:
                for one in element.properties:
                    count = 1
                    if one.count_kind:
                        count = int(next(words))
                        counts[one.name].append(count)
                    plain[one.name].extend(float(next(words)) for _ in range(count))
            except (ValueError, RuntimeError, OverflowError):
                raise MeshError(
                    f"this is no {element.name} as the header describes it",
                    where=f"{self._name}:{self._line}",
                ) from None
        every = {n: np.array(values, dtype=np.float64) for n, values in plain.items()}
        lists = {n: (np.array(c, dtype=np.int64), every.pop(n)) for n, c in counts.items()}
        return _Columns(dict(every), dict(lists))

    def _next(self, element: _Element) -> _Words:
        for line in self._lines:
            self._line += 1
            if line.strip():
                return _Words(line.split())
        raise MeshError(
            f"it ends after line {self._line}, within {element.count} of the kind {element.name}",
            where=self._name,
            expected="all of the file",
        )


class _Words:
    """Words of a line; one too many is a fault."""

    def __init__(self, words: list[bytes]) -> None:
        self._words, self._at = words, 0

    def __iter__(self) -> _Words:
        return self

    def __next__(self) -> bytes:
        if self._at == len(self._words):
            raise ValueError
        self._at += 1
        return self._words[self._at - 1]


class _Binary:
    def __init__(self, data: bytes, start: int, order: str, name: str) -> None:
        self._data, self._at, self._order, self._name = data, start, order, name

    def element(self, element: _Element) -> _Columns:
        """The next element: rows of the same length at once, others one by one."""
        if not element.count:
            return _Columns()
        least = sum(np.dtype(p.count_kind or p.kind).itemsize for p in element.properties)
        self._check(element, max(least, 1) * element.count)
        if not any(p.count_kind for p in element.properties):
            rows = self._rows(element, {})
            return _Columns({p.name: rows[p.name] for p in element.properties})
        return self._equal(element) or self._unequal(element)

    def _check(self, element: _Element, size: int) -> None:
        if self._at + size > len(self._data):
            raise MeshError(
                f"it ends within {element.count} of the kind {element.name}, which need at least "
                f"{size} bytes; {len(self._data) - self._at} are left",
                where=self._name,
                expected="all of the file",
            )

    def _rows(self, element: _Element, lengths: dict[str, int]) -> AnyArray:
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for one in element.properties:
            if one.count_kind:
                fields.append((f"{one.name}#", self._order + one.count_kind))
                fields.append((one.name, self._order + one.kind, (lengths[one.name],)))
            else:
                fields.append((one.name, self._order + one.kind))
        kind = np.dtype(fields)
        self._check(element, kind.itemsize * element.count)
        rows = np.frombuffer(self._data, kind, element.count, self._at)
        self._at += kind.itemsize * element.count
        return rows

    def _equal(self, element: _Element) -> _Columns | None:
        """All rows, if each list is as long in all of them."""
        begin = self._at
        lengths: dict[str, int] = {}
        for one in element.properties:
            if one.count_kind:
                lengths[one.name] = self._number(element, one.count_kind)
                self._at += lengths[one.name] * np.dtype(one.kind).itemsize
            else:
                self._at += np.dtype(one.kind).itemsize
        size, self._at = self._at - begin, begin
        if begin + size * element.count > len(self._data):
            return None
        rows = self._rows(element, lengths)
        if any((rows[f"{name}#"] != length).any() for name, length in lengths.items()):
            self._at = begin
            return None
        plain = {p.name: rows[p.name] for p in element.properties if not p.count_kind}
        full = {n: np.full(element.count, length) for n, length in lengths.items()}
        return _Columns(plain, {n: (full[n], rows[n].reshape(-1)) for n in lengths})

    def _number(self, element: _Element, kind: str) -> int:
        size = np.dtype(kind).itemsize
        self._check(element, size)
        value = int(np.frombuffer(self._data, self._order + kind, 1, self._at)[0])
        self._at += size
        if value < 0:
            raise MeshError(f"a list of {element.name} has {value} numbers", where=self._name)
        return value

    def _unequal(self, element: _Element) -> _Columns:
        parts: dict[str, list[AnyArray]] = {p.name: [] for p in element.properties}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_kind}
        for _ in range(element.count):
            for one in element.properties:
                count = 1
                if one.count_kind:
                    count = self._number(element, one.count_kind)
                    counts[one.name].append(count)
                size = count * np.dtype(one.kind).itemsize
                self._check(element, size)
                parts[one.name].append(
                    np.frombuffer(self._data, self._order + one.kind, count, self._at)
                )
                self._at += size
        every = {name: np.concatenate(rows) for name, rows in parts.items()}
        lists = {n: (np.array(c, dtype=np.int64), every.pop(n)) for n, c in counts.items()}
        return _Columns(every, lists)


def _points(vertex: _Columns, name: str) -> FloatArray:
    try:
        columns = [np.asarray(vertex.plain[axis], dtype=np.float64) for axis in "xyz"]
    except KeyError:
        raise MeshError("its vertices have no x, y and z", where=name) from None
    return np.stack(columns, axis=1)


def _polygons(face: _Columns, name: str) -> tuple[IntArray, IntArray]:
    for key in _ROWS:
        if key in face.lists:
            counts, rows = face.lists[key]
            return counts, rows.astype(np.int64)
    if not face.lists and not face.plain:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    raise MeshError(f"its faces have no list {' or '.join(_ROWS)}", where=name)


def _triangles(counts: IntArray, corners: IntArray) -> tuple[IntArray, IntArray]:
    """Faces of strips, in each of which every other triangle is turned; -1 ends a strip, too."""
    rows = np.insert(corners, np.cumsum(counts)[:-1], -1)
    places = np.arange(len(rows))
    begins = np.maximum.accumulate(np.where(rows < 0, places + 1, 0))
    found = np.stack([rows[:-2], rows[1:-1], rows[2:]], axis=1)
    turned = (places - begins)[:-2] % 2 == 1
    found[turned] = found[turned][:, [1, 0, 2]]
    flat = (found == np.roll(found, 1, axis=1)).any(axis=1)  # they join parts of a strip
    found = found[(found >= 0).all(axis=1) & ~flat]
    return np.full(len(found), 3, dtype=np.int64), found.reshape(-1)
