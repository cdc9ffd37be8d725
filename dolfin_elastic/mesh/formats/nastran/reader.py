"""`read_nastran`: from the bulk data of a Nastran file to its mesh.

Read here rather than through meshio 5.3, which takes all coordinates for rectangular ones, passes
over INCLUDE and whatever else it does not know, and mistakes continuations that begin with a blank
field.  What defines nodes, elements or coordinates and is not understood is an error here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.nastran.elements import (
    KINDS,
    SOLIDS,
    Kind,
    is_of_a_case,
    misunderstood,
)
from dolfin_elastic.mesh.formats.nastran.entries import Entry, read_entries
from dolfin_elastic.mesh.formats.nastran.systems import System, Systems, systems_of
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find

_NO_NODES = np.empty((0, 0), dtype=np.int64)


@dataclass
class _Elements:
    """Elements of one kind.

    Attributes:
        nodes: Numbers of the nodes of each.
        parts: Number of the property of each; 0: none.
        entries: Of each, for messages.
    """

    nodes: list[list[int]] = field(default_factory=list)
    parts: list[int] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)


@dataclass
class _Bulk:
    """Content of the file in its own numbering.

    Attributes:
        grids: Number of a node to its entry.
        systems: Number of a coordinate system to its definition.
        default: GRDSET, whose fields hold for nodes that leave them blank.
        elements: Kind to elements.
        others: Entries that are not read, and how many.
    """

    grids: dict[int, Entry] = field(default_factory=dict)
    systems: dict[int, System] = field(default_factory=dict)
    default: Entry | None = None
    elements: dict[str, _Elements] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)

    def system_of(self, entry: Entry, index: int = 1) -> int:
        """Number of the coordinate system of a node.

        Args:
            index: Of the field: 1 of its coordinates, 5 of the directions at it.
        """
        default = self.default.integer(index, 0) if self.default and not entry.text(index) else 0
        return entry.integer(index, default)

    def point(self, number: int) -> tuple[int, FloatArray] | None:
        """System and coordinates of a node; None: it does not exist."""
        entry = self.grids.get(number)
        if entry is None:
            return None
        return self.system_of(entry), np.array([entry.real(i) for i in (2, 3, 4)])


def read_nastran(path: Path) -> MeshFile:
    """Reads bulk data and what they include. Local: one rank reads.

    Raises:
        MeshError: A line cannot be read, or would define something of the mesh that is not
            understood.
    """
    bulk = _Bulk()
    for entry in read_entries(path):
        _take(bulk, entry)
    if not bulk.grids or not bulk.elements:
        raise MeshError("there are no GRID or no elements", where=path.name)
    numbers, points = _points(bulk)
    _check_solids(bulk)
    blocks = [_block(kind, elements, numbers) for kind, elements in bulk.elements.items()]
    return MeshFile(points, blocks, information=_information(bulk))


def _take(bulk: _Bulk, entry: Entry) -> None:
    if (take := _TAKE.get(entry.name)) is not None:
        take(bulk, entry)
    elif entry.name in KINDS:
        _take_element(bulk, entry, KINDS[entry.name])
    elif is_of_a_case(entry.name):
        bulk.others[entry.name] += 1
    elif what := misunderstood(entry.name):
        raise entry.error(f"{what} is not understood", "GRID, CORD1 and CORD2, CTETRA, CTRIA3 ...")


def _take_grid(bulk: _Bulk, entry: Entry) -> None:
    number = entry.integer(0)
    before = bulk.grids.setdefault(number, entry)
    if before is not entry and before.fields[:5] != entry.fields[:5]:
        raise entry.error(f"the node {number} stands twice", "each node once")


def _take_default(bulk: _Bulk, entry: Entry) -> None:
    bulk.default = entry


def _take_system(bulk: _Bulk, entry: Entry) -> None:
    for number, system in systems_of(entry).items():
        if number in bulk.systems:
            raise entry.error(f"the coordinate system {number} stands twice", "each of them once")
        bulk.systems[number] = system


_TAKE: dict[str, Callable[[_Bulk, Entry], None]] = {
    "GRID": _take_grid,
    "GRDSET": _take_default,
    **{f"CORD{i}{kind}": _take_system for i in (1, 2) for kind in "RCS"},
}


def _take_element(bulk: _Bulk, entry: Entry, kind: Kind) -> None:
    entry.integer(0)
    (name, corners), whole = kind.linear, kind.quadratic
    words = [entry.text(kind.first + i) for i in range(whole[1] if whole else corners)]
    given = [word not in ("", "0") for word in words]
    if whole is not None and any(given[corners:]):
        name, corners = whole
    if not all(given[:corners]):
        missing = given[:corners].count(False)
        raise entry.error(f"{missing} of its {corners} nodes are missing")
    nodes = [entry.integer(kind.first + i) for i in range(corners)]
    if kind.order is not None:
        nodes = [nodes[i] for i in kind.order]
    elements = bulk.elements.setdefault(name, _Elements())
    elements.nodes.append(nodes)
    elements.parts.append(entry.integer(1, 0) if kind.part else 0)
    elements.entries.append(entry)


def _points(bulk: _Bulk) -> tuple[IntArray, FloatArray]:
    """Numbers of the nodes in ascending order, and their basic coordinates, shape (n, 3)."""
    labels = sorted(bulk.grids)
    numbers, entries = np.array(labels, dtype=np.int64), [bulk.grids[label] for label in labels]
    x = np.array([[entry.real(i) for i in (2, 3, 4)] for entry in entries])
    of = np.array([bulk.system_of(entry) for entry in entries])
    systems, points = Systems(bulk.systems, bulk.point), np.empty_like(x)
    for number in np.unique(of).tolist():
        rows = np.flatnonzero(of == number)
        points[rows] = systems.place(number, x[rows], entries[int(rows[0])])
    return numbers, points


def _dims(bulk: _Bulk) -> dict[str, int]:
    """Dimension of each kind of elements."""
    return {kind: Block(kind, _NO_NODES).dim for kind in bulk.elements}


def _check_solids(bulk: _Bulk) -> None:
    """Refuses bodies of hexahedra and the like, with the first of them."""
    dims = _dims(bulk)
    for kind, elements in bulk.elements.items():
        if dims[kind] == max(2, *dims.values()) and kind not in SOLIDS:
            raise elements.entries[0].error(
                f"this kind of element is not supported; there are {len(elements.nodes)} of "
                f"{len(elements.nodes[0])} nodes",
                "a mesh of CTETRA, or of CTRIA3 or CTRIA6",
            )


def _block(kind: str, elements: _Elements, numbers: IntArray) -> Block:
    nodes, parts = np.array(elements.nodes, dtype=np.int64), np.array(elements.parts)
    rows = find(numbers, nodes)
    if (rows < 0).any():
        element, node = np.argwhere(rows < 0)[0].tolist()
        raise elements.entries[element].error(f"there is no GRID {nodes[element, node]}")
    named = {str(part): np.flatnonzero(parts == part) for part in np.unique(parts).tolist() if part}
    return Block(kind, rows, named)


def _information(bulk: _Bulk) -> list[str]:
    """Elements without stiffness, and entries that are not read."""
    dims = _dims(bulk)
    everywhere = bulk.default.text(6) if bulk.default else ""
    fixed = sum((grid.text(6) or everywhere).strip("0") != "" for grid in bulk.grids.values())
    if fixed:
        bulk.others["GRID with supports (PS)"] = fixed
    low = Counter(
        entry.name
        for kind, elements in bulk.elements.items()
        if dims[kind] < max(dims.values())
        for entry in elements.entries
    )
    texts = {
        "elements that name parts only and have no stiffness": low,
        "not read, because the case file states it": bulk.others,
    }
    result = [
        f"{text}: {', '.join(f'{count} {name}' for name, count in elements.items())}"
        for text, elements in texts.items()
        if elements
    ]
    if turned := sum(bulk.system_of(grid, 5) != 0 for grid in bulk.grids.values()):
        result.append(
            f"{turned} GRID with directions in a coordinate system of their own (CD): supports and "
            "loads of the case file are in basic directions"
        )
    return result
