"""Gmsh's .msh files, versions 2 and 4.1, ASCII and binary, with every physical name.

Read here rather than through Gmsh, which gives all elements of one entity the same groups (files
of version 2 may differ) and ends the process on some damaged files; and rather than through meshio
5.3, whose answers to damaged and partitioned files are IndexError, KeyError and ValueError.
Format: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, check_step, is_step


@dataclass(frozen=True)
class View:
    """A post-processing view of Gmsh: values of elements or points, by their tags."""

    tags: IntArray
    values: FloatArray

    def rows(self, tags: IntArray) -> FloatArray | None:
        """Values of the given tags, NaN where there is none; None if there is none at all."""
        order = np.argsort(self.tags)
        at = np.minimum(np.searchsorted(self.tags, tags, sorter=order), len(order) - 1)
        hit = self.tags[order[at]] == tags
        if not hit.any():
            return None
        return np.where(hit[:, None], self.values[order[at]], np.nan)


def data_rows(views: Mapping[str, View], tags: IntArray) -> dict[str, FloatArray]:
    """Values of elements or points, of the views that have some.

    Args:
        tags: Tags of elements or points, shape (n,).

    Returns:
        Name to values, shape (n, columns).
    """
    result = {name: view.rows(tags) for name, view in views.items() if len(view.tags)}
    return {name: rows for name, rows in result.items() if rows is not None}


def views(
    heads: Sequence[_Head], *, binary: bool, swap: bool, time: float | None
) -> dict[str, View]:
    """Reads all sections of a kind; of several time steps of one name the last.

    Args:
        binary: The file is binary.
        time: Which time step; None: the last.

    Raises:
        MeshError: A section is damaged.
    """
    chosen = [head for head in heads if is_step(head.time, time)]
    return {head.name: _view(head, binary=binary, swap=swap) for head in chosen}


def _view(head: _Head, *, binary: bool, swap: bool) -> View:
    body, count, columns = head.body, head.rows, head.columns
    if binary:
        order = ">" if swap else "<"
        record = np.dtype([("tag", order + "i4"), ("values", order + "f8", (columns,))])
        if len(body) < count * record.itemsize:
            raise MeshError(f"section ${head.kind} of '{head.name}' ends too early or is damaged")
        rows = np.frombuffer(body, record, count)
        return View(rows["tag"].astype(np.int64), rows["values"].astype(np.float64))
    try:
        table = np.array(body.split(), dtype=np.float64).reshape(count, 1 + columns)
    except ValueError:
        raise MeshError(
            f"section ${head.kind} of '{head.name}' does not hold {count} rows of {columns} numbers"
        ) from None
    return View(np.nan_to_num(table[:, 0], nan=-1).astype(np.int64), table[:, 1:])


@dataclass(frozen=True)
class _Head:
    """What a section of data says of itself, and its data.

    Attributes:
        kind: "ElementData" or "NodeData".
        time: Of its time step.
        name: Of the view.
        columns: Numbers of a row.
        rows: Number of them.
        body: The data.
    """

    kind: str
    time: float
    name: str
    columns: int
    rows: int
    body: bytes


def _head(data: bytes, kind: str) -> _Head:
    """The tags of a section of data, which are text in binary files too."""
    tags: list[list[bytes]] = []
    try:
        for _ in range(3):  # texts, real numbers, whole numbers
            line, _, data = data.partition(b"\n")
            count = int(line)
            *lines, data = data.split(b"\n", count)
            tags.append(lines)
        (name, *_), times, (_, columns, rows, *_) = tags
        text = name.strip().strip(b'"').decode("utf-8", "replace")
        time = float(times[0]) if times else 0.0
        head = _Head(kind, time, text, int(columns), int(rows), data)
        if head.columns < 1 or head.rows < 0:
            raise ValueError
    except ValueError:
        raise MeshError(f"section ${kind} is damaged (in its tags)") from None
    return head


_TYPES = {
    1: ("line", 2),
    2: ("triangle", 3),
    3: ("quad", 4),
    4: ("tetra", 4),
    5: ("hexahedron", 8),
    6: ("wedge", 6),
    7: ("pyramid", 5),
    8: ("line3", 3),
    9: ("triangle6", 6),
    10: ("quad9", 9),
    11: ("tetra10", 10),
    12: ("hexahedron27", 27),
    13: ("wedge18", 18),
    14: ("pyramid14", 14),
    15: ("vertex", 1),
    16: ("quad8", 8),
    17: ("hexahedron20", 20),
    18: ("wedge15", 15),
    19: ("pyramid13", 13),
    20: ("triangle9", 9),
    21: ("triangle10", 10),
    22: ("triangle12", 12),
    23: ("triangle15", 15),
    24: ("triangle15i", 15),
    25: ("triangle21", 21),
    26: ("line4", 4),
    27: ("line5", 5),
    28: ("line6", 6),
    29: ("tetra20", 20),
    30: ("tetra35", 35),
    31: ("tetra56", 56),
    36: ("quad16", 16),
    92: ("hexahedron64", 64),
}


@dataclass(frozen=True)
class _Run:
    """Elements of one type.

    Attributes:
        kind: Gmsh's number of the type.
        tags: Tags in the file, shape (n,).
        groups: Physical groups of each element, shape (n,) or (n, groups); 0: none.
        nodes: Tags of the nodes, shape (n, k).
        entity: Number of the point, curve, surface or volume that they mesh; 0: not known.
    """

    kind: int
    tags: IntArray
    groups: IntArray
    nodes: IntArray
    entity: int = 0


class OtherVersionError(Exception):
    """The file is of a version that only Gmsh itself reads."""


class _Numbers:
    """Reads the numbers of one section in order, from text or binary."""

    def __init__(self, data: bytes, name: str, *, binary: bool, swap: bool) -> None:
        self._name, self._binary, self._at = name, binary, 0
        self._order = ">" if swap else "<"
        self._data = data
        self._values = np.empty(0) if binary else _numbers(data, name)

    def take(self, count: int, code: str) -> npt.NDArray[np.float64 | np.int64]:
        """The next numbers, of shape (count,).

        Args:
            code: i4 (int), u8 (size_t) or f8 (double).

        Raises:
            MeshError: The section ends before.
        """
        wide = np.dtype(self._order + code)
        size = wide.itemsize if self._binary else 1
        have = (len(self._data) if self._binary else len(self._values)) - self._at
        if count < 0 or count * size > have:
            raise MeshError(f"section ${self._name} ends too early or is damaged")
        start, self._at = self._at, self._at + count * size
        if self._binary:
            part = np.frombuffer(self._data, wide, count, start)
        else:
            part = self._values[start : self._at]
        return part.astype(np.float64 if code == "f8" else np.int64)

    def ints(self, count: int) -> IntArray:
        """The next integers of 4 bytes."""
        return self.take(count, "i4")  # type: ignore[return-value]

    def sizes(self, count: int) -> IntArray:
        """The next integers of 8 bytes."""
        return self.take(count, "u8")  # type: ignore[return-value]

    def doubles(self, count: int) -> FloatArray:
        """The next floating-point numbers."""
        return self.take(count, "f8")  # type: ignore[return-value]

    def points(self, count: int) -> tuple[IntArray, FloatArray]:
        """Numbered points of a binary file of version 2."""
        kind = np.dtype([("tag", self._order + "i4"), ("x", self._order + "f8", 3)])
        if len(self._data) - self._at < count * kind.itemsize:
            raise MeshError(f"section ${self._name} ends too early or is damaged")
        rows = np.frombuffer(self._data, kind, count, self._at)
        return rows["tag"].astype(np.int64), rows["x"].astype(np.float64)

    def rest(self) -> IntArray:
        """All remaining integers of 4 bytes."""
        have = len(self._data) - self._at
        return self.ints(have // 4 if self._binary else len(self._values) - self._at)

    def end(self) -> None:
        """Checks that nothing is left.

        Raises:
            MeshError: The section has more than it states.
        """
        left = self._data[self._at :].strip() if self._binary else self._values[self._at :]
        if len(left):
            raise MeshError(f"section ${self._name} holds more than the numbers that it states")

    def line(self) -> int:
        """An integer that stands as text on a line of its own, in binary files too."""
        if not self._binary:
            return int(self.ints(1)[0])
        end = self._data.find(b"\n", self._at)
        text, self._at = self._data[self._at : end], end + 1
        if end < 0 or not text.strip().isdigit():
            raise MeshError(f"section ${self._name} is damaged")
        return int(text)


def _numbers(data: bytes, name: str) -> FloatArray:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(data.decode("latin-1"), sep=" ")
        except (DeprecationWarning, ValueError):
            raise MeshError(f"section ${name} holds something that is not a number") from None


def read_msh(path: Path, time: float | None = None) -> MeshFile:
    """Reads a .msh file. Local: one rank reads.

    Args:
        time: Of the data at several time steps, which one; None: the last.

    Raises:
        MeshError: The file is damaged.
        OtherVersionError: The file is of version 1, 3 or 4.0.
    """
    data = path.read_bytes()
    version, binary, swap = _header(data)
    every = _sections(data)
    sections = {name: parts[0] for name, parts in every.items()}
    names = _names(sections.get("PhysicalNames", b""))
    for name in ("Nodes", "Elements", "Entities"):
        if len(every.get(name, [])) > 1:
            raise MeshError(f"there are {len(every[name])} sections ${name}", expected="one")
    if "PartitionedEntities" in sections:
        raise MeshError(
            "the mesh is partitioned",
            expected="save one file of all partitions (in Gmsh: Mesh > Unpartition)",
        )

    def numbers(name: str) -> _Numbers:
        if name not in sections:
            raise MeshError(f"there is no section ${name}; the file is damaged or cut short")
        return _Numbers(sections[name], name, binary=binary, swap=swap)

    if version < 3:
        tags, points = _nodes2(numbers("Nodes"), binary)
        elements = list(_elements2(numbers("Elements"), binary))
    else:
        groups = _entities4(numbers("Entities")) if sections.get("Entities", b"").strip() else {}
        tags, points = _nodes4(numbers("Nodes"))
        elements = list(_elements4(numbers("Elements"), groups))
    heads = [
        [_head(data, kind) for data in every.get(kind, [])] for kind in ("ElementData", "NodeData")
    ]
    check_step(time, [head.time for rows in heads for head in rows])
    of_cells, of_points = (views(rows, binary=binary, swap=swap, time=time) for rows in heads)
    mesh = _named(points, tags, elements, names, of_cells)
    return replace(mesh, point_data=data_rows(of_points, tags))


_BEFORE = re.compile(rb"\s*(?:\$Comments\b.*?\$EndComments\s*)*", re.DOTALL)
"""What may stand before the header."""


def mesh_alone(data: bytes) -> bytes:
    """The file from its header on: by its first line Gmsh takes it for a mesh, or for a script.

    Raises:
        MeshError: There is no header.
    """
    match = _BEFORE.match(data)
    mesh = data[match.end() if match else 0 :]
    if not re.match(rb"\$(?:NOD|MeshFormat)[ \t\r]*\n", mesh):
        for sign, program in ((rb"MESH\b", "GiD"), (rb"\([012]\s", "Fluent")):
            if re.match(sign, mesh, re.IGNORECASE):
                raise MeshError(
                    f"this is a mesh of {program}, not of Gmsh",
                    expected="the mesh in another format, for example .vtu, .unv or .inp",
                )
        raise MeshError("this is not a Gmsh mesh (no $MeshFormat at the start)")
    return mesh


def _header(data: bytes) -> tuple[float, bool, bool]:
    head = re.match(
        rb"\$MeshFormat\s+([\d.]+)\s+([01])\s+(\d+)[^\n]*\n(....)?", mesh_alone(data), re.DOTALL
    )
    if head is None:
        if mesh_alone(data).startswith(b"$NOD"):
            raise OtherVersionError("1")
        raise MeshError("section $MeshFormat is damaged")
    try:
        version, binary = float(head[1]), head[2] == b"1"
    except ValueError:
        raise MeshError("section $MeshFormat is damaged") from None
    if not (2 <= version < 3 or version == 4.1):
        raise OtherVersionError(head[1].decode())
    return version, binary, binary and head[4] == b"\0\0\0\1"


def _sections(data: bytes) -> dict[str, list[bytes]]:
    """Name to the contents of all sections of that name."""
    result: dict[str, list[bytes]] = {}
    at = 0
    while (start := data.find(b"$", at)) >= 0:
        line_end = data.find(b"\n", start)
        name = data[start + 1 : line_end].strip().decode("latin-1")
        end = data.find(f"$End{name}".encode("latin-1"), line_end)
        if line_end < 0 or end < 0:
            raise MeshError(f"section ${name[:40]} has no end; the file is damaged or cut short")
        result.setdefault(name, []).append(data[line_end + 1 : end])
        at = end + len(name) + 4
    return result


def _names(data: bytes) -> dict[tuple[int, int], str]:
    rows = re.findall(r'^\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', data.decode("utf-8", "replace"), re.M)
    return {(int(dim), int(tag)): name for dim, tag, name in rows}


def _nodes2(numbers: _Numbers, binary: bool) -> tuple[IntArray, FloatArray]:
    count = numbers.line()
    if not binary:
        rows = numbers.doubles(4 * count).reshape(-1, 4)
        numbers.end()
        return rows[:, 0].astype(np.int64), rows[:, 1:]
    return numbers.points(count)


def _elements2(numbers: _Numbers, binary: bool) -> Iterator[_Run]:
    """Elements of a file of version 2, in runs of one type and number of tags."""
    count, words, at = numbers.line(), numbers.rest(), 0
    while count > 0:
        head = words[at : at + 3]
        if len(head) < 3:
            raise MeshError("section $Elements ends too early or is damaged")
        kind, tags = (int(head[0]), int(head[2])) if binary else (int(head[1]), int(head[2]))
        size = _nodes_of(kind)
        if tags < 0:
            raise MeshError("section $Elements is damaged (a negative number of tags)")
        blocked = binary and head[1] > 1
        skip = 3 if blocked else 0
        lead = 1 if blocked else 4 if binary else 3
        width = lead + tags + size
        alike = [] if blocked else [0, 1, 2] if binary else [1, 2]
        rows = _run(words[at + skip :], width, alike, int(head[1]) if blocked else count, blocked)
        groups = rows[:, lead] if tags > 0 else np.zeros(len(rows), dtype=np.int64)
        own = rows[:, 3 if binary and not blocked else 0]
        yield _Run(kind, own, groups, rows[:, lead + tags :])
        at += skip + rows.size
        count -= len(rows)
    if at < len(words):
        raise MeshError("section $Elements holds more than the numbers that it states")


def _run(words: IntArray, width: int, alike: list[int], most: int, whole: bool) -> IntArray:
    """Leading rows that agree with the first one in some columns; `whole`: all `most` are there."""
    rows = words[: min(most, len(words) // width) * width].reshape(-1, width)
    if len(rows) == 0 or (whole and len(rows) < most):
        raise MeshError("section $Elements ends too early or is damaged")
    differs = (rows[:, alike] != rows[0, alike]).any(axis=1)
    return rows[: int(np.argmax(differs))] if differs.any() else rows


def _nodes_of(kind: int) -> int:
    if kind not in _TYPES:
        raise MeshError(
            f"section $Elements has the unknown element type {kind}",
            expected="elements of order 1 or 2 (in Gmsh: Mesh.ElementOrder)",
        )
    return _TYPES[kind][1]


def _entities4(numbers: _Numbers) -> dict[tuple[int, int], IntArray]:
    """(dimension, entity) to its physical groups."""
    groups = {}
    for dim, count in enumerate(numbers.sizes(4)):
        for _ in range(count):
            tag = int(numbers.ints(1)[0])
            numbers.doubles(3 if dim == 0 else 6)
            groups[dim, tag] = np.abs(numbers.ints(int(numbers.sizes(1)[0])))
            if dim > 0:
                numbers.ints(int(numbers.sizes(1)[0]))
    return groups


def _nodes4(numbers: _Numbers) -> tuple[IntArray, FloatArray]:
    blocks = numbers.sizes(4)[0]
    tags: list[IntArray] = [np.empty(0, dtype=np.int64)]
    points: list[FloatArray] = [np.empty((0, 3))]
    for _ in range(blocks):
        dim, _, parametric = numbers.ints(3)
        count = int(numbers.sizes(1)[0])
        width = 3 + (int(dim) if parametric else 0)
        tags.append(numbers.sizes(count))
        points.append(numbers.doubles(width * count).reshape(-1, width)[:, :3])
    numbers.end()
    return np.concatenate(tags), np.concatenate(points)


def _elements4(numbers: _Numbers, entities: dict[tuple[int, int], IntArray]) -> Iterator[_Run]:
    """Blocks of elements of a file of version 4.1; groups are those of the block's entity."""
    for _ in range(numbers.sizes(4)[0]):
        dim, entity, kind = (int(n) for n in numbers.ints(3))
        width = 1 + _nodes_of(kind)
        rows = numbers.sizes(width * int(numbers.sizes(1)[0])).reshape(-1, width)
        groups = entities.get((dim, entity), np.empty(0, dtype=np.int64))
        of_each = np.broadcast_to(groups, (len(rows), len(groups)))
        yield _Run(kind, rows[:, 0], of_each, rows[:, 1:], entity)
    numbers.end()


def _named(
    points: FloatArray,
    tags: IntArray,
    file: list[_Run],
    names: dict[tuple[int, int], str],
    data: dict[str, View],
) -> MeshFile:
    order = np.argsort(tags)
    blocks, used = [], set()
    for run in file:
        block = Block(_TYPES[run.kind][0], _rows(tags, order, run.nodes))
        parts: dict[str, IntArray] = {}
        for group in np.unique(run.groups[run.groups != 0]):
            rows = np.flatnonzero((run.groups.reshape(len(run.nodes), -1) == group).any(axis=1))
            name = names.get((block.dim, int(group)), str(group))
            parts[name] = np.union1d(rows, parts.get(name, rows))
            used.add((block.dim, int(group)))
        of_elements = data_rows(data, run.tags)
        blocks.append(Block(block.kind, block.nodes, parts, of_elements, run.entity))
    empty = [name for key, name in names.items() if key not in used]
    notes = (
        [f"no elements carry the name{'s' if len(empty) > 1 else ''} {', '.join(empty)} (left out)"]
        if empty
        else []
    )
    return MeshFile(points, blocks, notes)


def _rows(tags: IntArray, order: IntArray, nodes: IntArray) -> IntArray:
    """Rows of `points` for tags of nodes of any shape; `order` sorts the tags of all."""
    if len(tags) == 0:
        raise MeshError("the mesh has no points")
    at = np.searchsorted(tags, nodes, sorter=order)
    rows = order[np.minimum(at, len(tags) - 1)]
    missing = np.unique(nodes[tags[rows] != nodes])
    if len(missing):
        raise MeshError(
            f"elements refer to {len(missing)} points that do not exist, for example {missing[0]}"
        )
    return np.asarray(rows)
