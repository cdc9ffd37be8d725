"""I-DEAS universal files (.unv), as Salome, Gmsh, NX and Ansys write them.

It reads nodes (datasets 15, 781, 2411), elements (780, 2412), groups (752, 2417, 2429, 2430, 2432,
2435, 2452, 2467, 2477) and the unit of length (164), and skips all other datasets.
Source: Structural Dynamics Research Corporation, Universal File Datasets, I-DEAS Master Series.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.core.units import LENGTHS, LengthUnit
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find, find_all, joined, missing

_NODES = (15, 781, 2411)
_ELEMENTS = {780: (8, 5), 2412: (6, 3)}  # numbers in the first record, and in that of beams
_GROUPS = dict.fromkeys((752, 2417, 2429, 2430, 2432), 2) | dict.fromkeys(
    (2435, 2452, 2467, 2477), 4
)
"""Numbers that each dataset of groups has for an entity."""
_UNITS, _UNREAD = 164, (71,)
_NODE, _ELEMENT = 7, 8  # kinds of entities in groups
_BEAMS = range(11, 33)  # rods, beams and pipes
_OTHERS = (*range(121, 123), *range(136, 143), *range(151, 153))
"""Rigid bars and elements, springs, dampers and gaps: no elements of a body."""

# Descriptor of the element; quadratic ones list corners and midside nodes in turns around a face.
_LINEAR = {
    "triangle": (41, 51, 61, 74, 81, 91),
    "triangle6": (42, 52, 62, 72, 82, 92),
    "quad": (44, 54, 64, 71, 84, 94),
    "quad8": (45, 55, 65, 75, 85, 95),
    "tetra": (111,),
    "tetra10": (118,),
    "wedge": (101, 112),
    "wedge15": (102, 113),
    "hexahedron": (104, 115),
    "hexahedron20": (105, 116),
    "vertex": (161,),
    "line": (171,),  # axisymmetric shells, as Cubit writes the edges of a body
    "line3": (172,),
}
_KINDS = {number: kind for kind, numbers in _LINEAR.items() for number in numbers}
_SIZES = {
    "vertex": 1,
    "line": 2,
    "line3": 3,
    "triangle": 3,
    "triangle6": 6,
    "quad": 4,
    "quad8": 8,
    "tetra": 4,
    "tetra10": 10,
    "wedge": 6,
    "wedge15": 15,
    "hexahedron": 8,
    "hexahedron20": 20,
}
_ORDER = {
    "line3": [0, 2, 1],
    "triangle6": [0, 2, 4, 1, 3, 5],
    "tetra10": [0, 2, 4, 9, 1, 3, 5, 6, 7, 8],
}
"""Places of the nodes in the file in the order of VTK: corners, then middles of the edges."""


@dataclass(frozen=True)
class _Dataset:
    """Lines of a dataset; the first of them is line `start` of the file."""

    number: int
    start: int
    lines: list[str]
    file: str

    def error(self, what: str, row: int = 0) -> MeshError:
        """An error that names file and line.

        Args:
            row: Index of the line in the dataset.
        """
        return MeshError(f"dataset {self.number}: {what}", where=f"{self.file}:{self.start + row}")

    def floats(self) -> FloatArray:
        """All numbers in it, of any exponent letter."""
        return np.asarray(self._numbers(np.float64), dtype=np.float64)

    def integers(self, first: int = 0, last: int | None = None) -> IntArray:
        """All whole numbers in some lines.

        Args:
            first: Index of the first line in the dataset.
            last: Index of the line after the last one; None: to the end.
        """
        return np.asarray(self._numbers(np.int64, first, last), dtype=np.int64)

    def _numbers(
        self, kind: type[np.int64] | type[np.float64], first: int = 0, last: int | None = None
    ) -> AnyArray:
        rows = [line.upper().replace("D", "E") for line in self.lines[first:last]]
        try:
            return np.array(" ".join(rows).split(), dtype=kind)
        except (ValueError, OverflowError):
            for row, line in enumerate(rows, start=first):
                for word in line.split():
                    self._check(word, kind, row)
            raise

    def _check(self, word: str, kind: type[np.int64] | type[np.float64], row: int) -> None:
        try:
            np.array([word], dtype=kind)
        except (ValueError, OverflowError):
            raise self.error(f"'{word}' is no number of the expected kind", row) from None


@dataclass
class _Contents:
    """Content of the file in its own numbering.

    Attributes:
        labels: Of the nodes.
        points: Coordinates of the nodes, shape (n, 3) each.
        elements: Descriptor and number of nodes, to labels and nodes of elements.
        first: Descriptor and number of nodes to the file and line of its dataset.
        groups: Name to the labels of the nodes, and of the elements, of a group.
        lost: Name of a group to the reason why it is not whole.
    """

    labels: list[IntArray] = field(default_factory=list)
    points: list[FloatArray] = field(default_factory=list)
    elements: dict[tuple[int, int], tuple[list[int], list[list[int]]]] = field(default_factory=dict)
    first: dict[tuple[int, int], str] = field(default_factory=dict)
    groups: dict[str, tuple[list[IntArray], list[IntArray]]] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)


def read_unv(path: Path) -> MeshFile:
    """Reads a universal file. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, or has no nodes or elements.
    """
    contents = _Contents()
    for dataset in _datasets(path):
        if dataset.number in _NODES:
            _take_nodes(contents, dataset)
        elif dataset.number in _ELEMENTS:
            _take_elements(contents, dataset)
        elif dataset.number in _GROUPS:
            _take_groups(contents, dataset)
        elif dataset.number in _UNREAD:
            raise dataset.error("elements of this kind of dataset are not read")
    if not contents.points or not contents.elements:
        raise MeshError(
            "there are no nodes (dataset 2411) or no elements (dataset 2412)", where=path.name
        )
    return _mesh(contents, path)


def _datasets(path: Path) -> Iterator[_Dataset]:
    """The datasets between lines with nothing but -1, one at a time."""
    start, count, lines = 0, 0, list[str]()  # start: line of the -1 before, 0 outside a dataset
    stray: tuple[int, str] | None = None
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, start=1):
            if line.strip() != "-1":
                if not start and line.strip():
                    stray = stray or (number, line.strip()[:60])
                lines.append(line)
                continue
            if start:
                yield _dataset(path, start, lines)
                count += 1
            start, lines = 0 if start else number, []
    if start:
        raise MeshError("the last dataset has no end", where=f"{path.name}:{start}")
    if not count:
        raise MeshError("this is no universal file: no dataset between lines -1", where=path.name)
    if stray:  # where a line -1 is missing, all that follows would be of no dataset
        raise MeshError(
            f"'{stray[1]}' stands outside of a dataset",
            where=f"{path.name}:{stray[0]}",
            expected="datasets between lines -1",
        )


def _dataset(path: Path, start: int, lines: list[str]) -> _Dataset:
    head = lines[0].split() if lines else []
    if not head or not head[0].isdigit():
        raise MeshError("a dataset has no number", where=f"{path.name}:{start + 1}")
    return _Dataset(int(head[0]), start + 2, lines[1:], path.name)


def _take_nodes(contents: _Contents, dataset: _Dataset) -> None:
    numbers = dataset.floats()
    if len(numbers) % 7:
        raise dataset.error("the nodes are cut short", len(dataset.lines) - 1)
    rows = numbers.reshape(-1, 7)
    labels = rows[:, 0].astype(np.int64)
    if (labels != rows[:, 0]).any():
        raise dataset.error("a node's label is no whole number")
    systems = np.unique(rows[:, 1])
    if dataset.number != 2411 and (systems > 1).any():  # of 2411, coordinates are of the part
        raise dataset.error(f"nodes in the coordinate system {systems[-1]:g}, which is not read")
    contents.labels.append(labels)
    contents.points.append(np.asarray(rows[:, 4:], dtype=np.float64))


def _take_elements(contents: _Contents, dataset: _Dataset) -> None:
    width, beam = _ELEMENTS[dataset.number]
    numbers = [int(n) for n in dataset.integers()]
    at = 0
    while at < len(numbers):
        head = numbers[at : at + width]
        if len(head) < width:
            raise dataset.error("the elements are cut short", len(dataset.lines) - 1)
        label, kind, count = head[0], head[1], head[-1]
        at += width + (beam if kind in _BEAMS else 0)
        if count < 0 or at + count > len(numbers):
            raise dataset.error(f"the element {label} is cut short", len(dataset.lines) - 1)
        contents.first.setdefault((kind, count), f"{dataset.file}:{dataset.start}")
        labels, nodes = contents.elements.setdefault((kind, count), ([], []))
        labels.append(label)
        nodes.append(numbers[at : at + count])
        at += count


def _take_groups(contents: _Contents, dataset: _Dataset) -> None:
    width, row, lines = _GROUPS[dataset.number], 0, dataset.lines
    while row < len(lines):
        if not lines[row].strip():  # SALOME writes one for the members of an empty group
            row += 1
            continue
        head = dataset.integers(row, row + 1)
        if not len(head) or row + 1 >= len(lines):
            raise dataset.error("a group is cut short", row)
        name, count = lines[row + 1].strip() or str(head[0]), int(head[-1])
        last = row + 2 - (-count * width // 8)
        if count < 0 or last > len(lines):
            raise dataset.error(f"the group '{name}' is cut short", row)
        numbers = dataset.integers(row + 2, last)
        if len(numbers) != count * width:
            raise dataset.error(f"the group '{name}' has not {count} entities of {width} numbers")
        _take_group(contents, name, numbers.reshape(-1, width))
        row = last


def _take_group(contents: _Contents, name: str, rows: IntArray) -> None:
    nodes, elements = contents.groups.setdefault(name, ([], []))
    nodes.append(rows[rows[:, 0] == _NODE, 1])
    elements.append(rows[rows[:, 0] == _ELEMENT, 1])
    others = len(rows) - len(nodes[-1]) - len(elements[-1])
    if others:
        contents.lost[name] = f"{others} of its {len(rows)} members are neither nodes nor elements"


def unit_of_unv(path: Path) -> LengthUnit | None:
    """The unit of length that a universal file states (dataset 164). Local.

    Returns:
        None where it states none.

    Raises:
        MeshError: The file, or its factor of length, is damaged.
    """
    for dataset in _datasets(path):
        if dataset.number == _UNITS:
            return _unit(dataset)
    return None


def _unit(dataset: _Dataset) -> LengthUnit:
    """Metres are the lengths of the file over the factor of length."""
    words = dataset.lines[1].upper().replace("D", "E").split() if len(dataset.lines) > 1 else []
    try:
        factor = float(words[0])
    except (ValueError, IndexError):
        raise dataset.error("there is no factor of length", 1) from None
    if not 0 < factor < np.inf:
        raise dataset.error(f"the factor of length is {factor:g}", 1)
    named = (unit for unit in LENGTHS.values() if math.isclose(unit * factor, 1, rel_tol=1e-6))
    return LengthUnit.of(next(named, 1 / factor), stated=True)


def _mesh(contents: _Contents, path: Path) -> MeshFile:
    labels, first = np.unique(np.concatenate(contents.labels), return_index=True)
    if len(labels) < sum(map(len, contents.labels)):
        raise MeshError("nodes stand twice", where=path.name)
    points = np.concatenate(contents.points)[first]
    blocks, left_out = [], []
    members = {name: np.unique(joined(elements)) for name, (_, elements) in contents.groups.items()}
    present = []
    for (number, count), (own, nodes) in contents.elements.items():
        kind = _kind(number, count)
        if kind is None and number not in _OTHERS:
            raise MeshError(
                f"{len(own)} elements of the type {number} with {count} nodes, such as {own[0]}, "
                "are not understood",
                where=contents.first[number, count],
                expected="tetrahedra (111, 118) or triangles (41, 91, 42, 92 ...)",
            )
        if kind is None:
            left_out.append(f"{len(own)} of type {number}")
            continue
        rows = find_all(labels, np.array(nodes, dtype=np.int64))
        numbers = np.array(own, dtype=np.int64)
        present.append(numbers)
        parts = {name: np.flatnonzero(np.isin(numbers, m)) for name, m in members.items()}
        blocks.append(Block(kind, rows[:, _ORDER.get(kind, slice(None))], parts))
    every, lost, sets = np.unique(joined(present)), dict(contents.lost), {}
    empty = list[str]()
    for name, (nodes_of, _) in contents.groups.items():
        wanted = np.unique(joined(nodes_of))
        rows = find(labels, wanted)
        if len(wanted):
            sets[name] = rows[rows >= 0]
        elements = members[name]
        if not len(wanted) + len(elements) and name not in lost:
            empty.append(name)
        reasons = [
            missing(wanted[rows < 0], len(wanted), "nodes"),
            missing(np.setdiff1d(elements, every), len(elements), "elements"),
        ]
        if any(reasons):
            lost[name] = next(filter(None, reasons))
    notes = [f"elements left out: {', '.join(left_out)}"] if left_out else []
    if empty:
        notes.append(f"groups without members: {', '.join(empty)}")
    return MeshFile(points, blocks, notes, point_sets=sets, incomplete=lost)


def _kind(number: int, count: int) -> str | None:
    """Kind of an element in the words of meshio; None: it is no element of a mesh."""
    kind = {2: "line", 3: "line3"}.get(count) if number in _BEAMS else _KINDS.get(number)
    return kind if kind and _SIZES[kind] == count else None
