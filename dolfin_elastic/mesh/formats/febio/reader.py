"""`read_febio`: nodes, elements, sets and surfaces of an FEBio file.

Tetrahedra of ten nodes list these as VTK does, triangles of six too.  Names of node sets, surfaces
and parts may be the same.  Source: FEBio User Manual, version 4, section 3.6 (Mesh); for the older
specifications the same manual of versions 2.9 and 3.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.febio.tags import Rows, Tag, read_tags
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find, joined, missing

_SOLIDS = {"tet4": ("tetra", 4), "tet10": ("tetra10", 10), "ut4": ("tetra", 4)}
_SHELLS = {"tri3": ("triangle", 3), "tri6": ("triangle6", 6), "tri3s": ("triangle", 3)}
_LINES = {"truss2": ("line", 2), "line2": ("line", 2), "line3": ("line3", 3)}
_EDGES = {"line2": ("line", 2), "line3": ("line3", 3), "edge2": ("line", 2), "edge3": ("line3", 3)}
_NOT_READ = ("Part", "Instance")
_SETS = ("NodeSet", "Surface", "Edge", "ElementSet")
_MOST = 2 * 10**7
"""Nodes or elements of one set that ranges may name."""


@dataclass
class _Mesh:
    """What has been found.

    Attributes:
        numbers: Of the nodes, in ascending order.
        blocks: Elements and facets, with rows of nodes.
        elements: Numbers of the elements of each block of solids.
        sets: Name to rows of nodes.
        lost: Name of a set to what is missing in it.
        low: Number of elements without stiffness by their type.
    """

    numbers: IntArray
    blocks: list[Block] = field(default_factory=list)
    elements: list[IntArray] = field(default_factory=list)
    sets: dict[str, IntArray] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    low: dict[str, int] = field(default_factory=dict)


def read_febio(path: Path) -> MeshFile:
    """Reads the mesh of an FEBio file. Local: one rank reads.

    Raises:
        MeshError: It cannot be read, or has elements that are not understood.
    """
    sections = [tag for tag in read_tags(path).children if tag.name in ("Mesh", "Geometry")]
    lists = [child for section in sections for child in section.children]
    for tag in lists:
        if tag.name in _NOT_READ:
            raise tag.error(
                f"<{tag.name}> is not read", "the model saved anew by FEBio Studio, in one mesh"
            )
    numbers, points = _nodes([tag for tag in lists if tag.name == "Nodes"], path.name)
    mesh = _Mesh(numbers)
    parts = [tag for tag in lists if tag.name == "Elements"]
    _check_kinds(parts)
    for tag in parts:
        _take_elements(mesh, tag)
    for tag in lists:
        if tag.name in _SETS:
            _take_set(mesh, tag)
    for tag in lists:
        ids = np.array(tag.rows["node"].ids if tag.name == "Nodes" else (), dtype=np.int64)
        if 0 < len(ids) < len(numbers) and (name := tag.attributes.get("name", "")):
            mesh.sets.setdefault(name, np.unique(find(numbers, ids)))
    low = ", ".join(f"{count} {kind}" for kind, count in mesh.low.items())
    return MeshFile(
        points,
        mesh.blocks,
        point_sets=mesh.sets,
        information=[f"elements that name parts only and have no stiffness: {low}"] if low else [],
        incomplete=mesh.lost,
        numbers=numbers,
    )


def name_of(tag: Tag) -> str:
    """Name of a list, of elements also that of their set or the number of their material."""
    attributes = tag.attributes
    return attributes.get("name") or attributes.get("elset") or attributes.get("mat", "")


def elements_of(tag: Tag) -> Iterator[tuple[str, Rows]]:
    """Type of the elements of a list, and its rows, which may be named by their type."""
    for name, rows in tag.rows.items():
        kind = tag.attributes.get("type", "") if name in ("elem", "e") else name
        yield kind.lower().split("g")[0] if kind.upper().startswith("TET") else kind, rows


def _nodes(lists: Iterable[Tag], source: str) -> tuple[IntArray, FloatArray]:
    """Numbers of the nodes in ascending order, and their coordinates, shape (n, 3)."""
    ids, values = list[IntArray](), list[FloatArray]([np.empty((0, 3))])
    for tag in lists:
        if other := [name for name in tag.rows if name != "node"]:
            raise tag.error(f"<{other[0]}> is not understood in <Nodes>", "<node>")
        rows = tag.rows.setdefault("node", Rows())
        values.append(_table(tag, rows, 3))
        ids.append(np.array(rows.ids, dtype=np.int64))
    every, points = joined(ids), np.concatenate(values)
    if not len(every):
        raise MeshError("the FEBio file has no nodes", where=source)
    numbers, first = np.unique(every, return_index=True)
    if len(numbers) < len(every):
        twice = np.setdiff1d(np.arange(len(every)), first)[0]
        raise MeshError(f"the node {every[twice]} stands twice", where=source)
    if not np.isfinite(points).all():
        at = every[~np.isfinite(points).all(axis=1)][0]
        raise MeshError(f"coordinates of the node {at} are not finite", where=source)
    return numbers, points[first]


def _table(tag: Tag, rows: Rows, width: int) -> FloatArray:
    """Values of rows, shape (n, width)."""
    counts = np.array(rows.counts)
    if (counts != width).any():
        at = int(np.flatnonzero(counts != width)[0])
        raise tag.error(f"{counts[at]} numbers, not {width}", line=rows.lines[at])
    return np.array(rows.values, dtype=np.float64).reshape(-1, width)


def _check_kinds(parts: Iterable[Tag]) -> None:
    """Refuses elements that no body may have, all of them in one message."""
    other = {
        (kind, tag.line): (tag, len(rows.ids))
        for tag in parts
        for kind, rows in elements_of(tag)
        if kind not in _SOLIDS | _SHELLS | _LINES
    }
    if not other:
        return
    names = ", ".join(
        f"{count} {kind or 'without a type'} (line {line})"
        for (kind, line), (_, count) in other.items()
    )
    first = next(tag for tag, _ in other.values())
    raise first.error(
        f"elements other than tetrahedra are not supported: {names}",
        "the part meshed with tet4 or tet10",
    )


def _take_elements(mesh: _Mesh, tag: Tag) -> None:
    for kind, rows in elements_of(tag):
        name, width = (_SOLIDS | _SHELLS | _LINES)[kind]
        nodes = _rows_of(mesh, tag, rows, width)
        named = {label: np.arange(len(nodes))} if (label := name_of(tag)) else {}
        mesh.blocks.append(Block(name, nodes, named))
        mesh.elements.append(np.array(rows.ids, dtype=np.int64))
        if kind not in _SOLIDS:
            mesh.low[kind] = mesh.low.get(kind, 0) + len(nodes)


def _rows_of(mesh: _Mesh, tag: Tag, rows: Rows, width: int) -> IntArray:
    """Rows of the nodes of elements or facets, shape (n, width)."""
    nodes = _table(tag, rows, width).astype(np.int64)
    found = find(mesh.numbers, nodes)
    if (found < 0).any():
        at, column = np.argwhere(found < 0)[0].tolist()
        raise tag.error(f"there is no node {nodes[at, column]}", line=rows.lines[at])
    return found


def _take_set(mesh: _Mesh, tag: Tag) -> None:
    name = tag.attributes.get("name", "")
    if not name:
        raise tag.error(f"<{tag.name}> has no name", 'name="..."')
    if tag.name == "NodeSet":
        wanted = np.unique(members(tag))
        rows = find(mesh.numbers, wanted)
        mesh.sets[name] = rows[rows >= 0]
        if reason := missing(wanted[rows < 0], len(wanted), "nodes"):
            mesh.lost[name] = reason
    elif tag.name == "ElementSet":
        _name_elements(mesh, name, np.unique(members(tag)))
    else:
        _take_facets(mesh, tag, name)


def members(tag: Tag) -> IntArray:
    """Numbers in a set of nodes or elements: ids of its rows, or a list in which a:b:c are ranges.

    Raises:
        MeshError: They are no numbers, or far more than a file can define.
    """
    parts_of = [np.array(rows.ids, dtype=np.int64) for rows in tag.rows.values()]
    total = 0
    for word in tag.text.replace(",", " ").split():
        parts = word.split(":")
        if len(parts) > 3 or not all(p.isdecimal() and len(p) < 16 for p in parts):
            raise tag.error(f"'{word[:40]}' is no number of a node or element")
        first, last, *step = (int(p) for p in (parts if len(parts) > 1 else parts * 2))
        steps = range(first, last + 1, max(step[0], 1) if step else 1)
        total += len(steps)
        if total > _MOST:
            raise tag.error(f"'{word[:40]}' are more nodes or elements than a file has")
        parts_of.append(np.arange(steps.start, steps.stop, steps.step, dtype=np.int64))
    return joined(parts_of)


def _name_elements(mesh: _Mesh, name: str, wanted: IntArray) -> None:
    present = list[IntArray]()
    for i, numbers in enumerate(mesh.elements):
        own = np.isin(numbers, wanted)
        present.append(numbers[own])
        block = mesh.blocks[i]
        if own.any() and name not in block.parts:
            parts = {**block.parts, name: np.flatnonzero(own)}
            mesh.blocks[i] = Block(block.kind, block.nodes, parts)
    lost = np.setdiff1d(wanted, joined(present))
    if reason := missing(lost, len(wanted), "elements"):
        mesh.lost[name] = reason


def _take_facets(mesh: _Mesh, tag: Tag, name: str) -> None:
    known = _EDGES if tag.name == "Edge" else _SHELLS
    for kind, rows in tag.rows.items():
        if kind not in known:
            mesh.lost[name] = f"{len(rows.ids)} of its facets are {kind} (line {rows.lines[0]})"
            continue
        word, width = known[kind]
        facets = _rows_of(mesh, tag, rows, width)
        mesh.blocks.append(Block(word, facets, {name: np.arange(len(facets))}))
