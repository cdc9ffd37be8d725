"""What the bulk data of a Nastran file say of the mesh, and the entries of supports and loads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.nastran.elements import (
    KINDS,
    USUAL,
    Kind,
    is_of_a_case,
    misunderstood,
)
from dolfin_elastic.mesh.formats.nastran.entries import Entry
from dolfin_elastic.mesh.formats.nastran.systems import System, Systems, systems_of

CELAS = ("CELAS1", "CELAS2")
RIGID = ("RBE2", "RBE3")
GROUPED = ("SPC", "SPC1", "SPCD", "FORCE", "FORCE1", "PLOAD4", "PLOAD", *RIGID, *CELAS)
"""Entries that name nodes and faces, see `groups.py`."""


@dataclass
class Elements:
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
class Bulk:
    """Content of the file in its own numbering.

    Attributes:
        grids: Number of a node to its entry.
        systems: Number of a coordinate system to its definition.
        default: GRDSET, whose fields hold for nodes that leave them blank.
        elements: Kind to elements.
        grouped: Entries of `GROUPED`.
        others: Entries that are not read, and how many.
        unread: Such that a case has no need of, or that are misspelt.
    """

    grids: dict[int, Entry] = field(default_factory=dict)
    systems: dict[int, System] = field(default_factory=dict)
    default: Entry | None = None
    elements: dict[str, Elements] = field(default_factory=dict)
    grouped: list[Entry] = field(default_factory=list)
    others: Counter[str] = field(default_factory=Counter)
    unread: Counter[str] = field(default_factory=Counter)

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

    def basic(self) -> Systems:
        """Its coordinate systems."""
        return Systems(self.systems, self.point)

    def supports_at(self, grid: Entry) -> str:
        """Components that a node itself prescribes to be 0 (PS)."""
        everywhere = self.default.text(6) if self.default else ""
        return (grid.text(6) or everywhere).strip("0")


def bulk_of(entries: Iterable[Entry]) -> Bulk:
    """Sorts entries.

    Raises:
        MeshError: One would define something of the mesh that is not understood.
    """
    bulk = Bulk()
    for entry in entries:
        _take(bulk, entry)
    return bulk


def _take(bulk: Bulk, entry: Entry) -> None:
    if (take := _TAKE.get(entry.name)) is not None:
        take(bulk, entry)
    elif entry.name in KINDS:
        _take_element(bulk, entry, KINDS[entry.name])
    elif is_of_a_case(entry.name):
        bulk.others[entry.name] += 1
        if entry.name in GROUPED:
            bulk.grouped.append(entry)
    elif what := misunderstood(entry.name):
        raise entry.error(f"{what} is not understood", "GRID, CORD1 and CORD2, CTETRA, CTRIA3 ...")
    elif not entry.name.startswith(USUAL):
        bulk.unread[entry.name.split()[0][:8]] += 1


def _take_grid(bulk: Bulk, entry: Entry) -> None:
    number = entry.integer(0)
    before = bulk.grids.setdefault(number, entry)
    if before is not entry and before.fields[:5] != entry.fields[:5]:
        raise entry.error(f"the node {number} stands twice", "each node once")


def _take_default(bulk: Bulk, entry: Entry) -> None:
    bulk.default = entry


def _take_system(bulk: Bulk, entry: Entry) -> None:
    for number, system in systems_of(entry).items():
        if number in bulk.systems:
            raise entry.error(f"the coordinate system {number} stands twice", "each of them once")
        bulk.systems[number] = system


_TAKE: dict[str, Callable[[Bulk, Entry], None]] = {
    "GRID": _take_grid,
    "GRDSET": _take_default,
    **{f"CORD{i}{kind}": _take_system for i in (1, 2) for kind in "RCS"},
}


def _take_element(bulk: Bulk, entry: Entry, kind: Kind) -> None:
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
    elements = bulk.elements.setdefault(name, Elements())
    elements.nodes.append(nodes)
    elements.parts.append(entry.integer(1, 0) if kind.part else 0)
    elements.entries.append(entry)
