"""TetGen: nodes (.node), tetrahedra (.ele) and faces with markers (.face) beside each other.

Read here rather than through meshio 5.3, which takes tetrahedra of four nodes only and leaves out
all faces.  Source: H. Si, TetGen, A Quality Tetrahedral Mesh Generator, Version 1.5 User's Manual
(2013), on file formats.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find_all
from dolfin_elastic.mesh.formats.text.lines import Lines, by_number

_EDGES = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]
"""Corners of the edges in the order of the midside nodes of VTK."""
_LOOKED_AT = 1000
"""Elements that show on which edges midside nodes lie."""


def read_tetgen(path: Path) -> MeshFile:
    """Reads the mesh of which one file is named. Local: one rank reads.

    Raises:
        MeshError: Nodes or elements are missing or damaged.
    """
    for suffix in (".node", ".ele"):
        if not path.with_suffix(suffix).is_file():
            raise MeshError(
                f"there is no '{path.with_suffix(suffix).name}' beside it", where=path.name
            )
    lines = Lines(path.with_suffix(".node"))
    count, dim, attributes, marked, *_ = _head(lines, 4)
    if dim != 3:
        raise lines.error(f"nodes in {dim} dimensions are not read", "meshes of tetrahedra")
    table = _table(lines, count, 4 + attributes)
    order = np.argsort(table[:, 0], kind="stable")
    table = table[order]
    labels = _whole(lines, table[:, 0])
    if len(np.unique(labels)) < len(labels):
        raise lines.error("a node stands twice")
    data = {f"tetgen:attr{k + 1}": table[:, 4 + k : 5 + k] for k in range(attributes)}
    blocks = [_cells(path.with_suffix(".ele"), labels, table[:, 1:4])]
    if path.with_suffix(".face").is_file():
        blocks.append(_faces(path.with_suffix(".face"), labels))
    notes = ["markers of nodes are not read: those of faces (.face) name surfaces"]
    return MeshFile(
        table[:, 1:4],
        blocks,
        information=notes if _marks(table, attributes, marked) else [],
        point_data=data,
    )


def _marks(table: FloatArray, attributes: int, marked: int) -> bool:
    """Whether nodes have markers other than 0, behind their attributes."""
    return marked > 0 and bool(np.any(table[:, 4 + attributes :]))


def _whole(lines: Lines, numbers: FloatArray) -> IntArray:
    """Numbers of nodes.

    Raises:
        MeshError: One is no whole number.
    """
    if (wrong := numbers != np.trunc(numbers)).any():
        raise lines.error(f"{numbers[wrong][0]:g} is no number of a node")
    return numbers.astype(np.int64)


def _cells(path: Path, labels: IntArray, points: FloatArray) -> Block:
    lines = Lines(path)
    count, corners, attribute, *_ = _head(lines, 3)
    if corners not in (4, 10):
        raise lines.error(f"elements of {corners} nodes are not read", "4 or 10 nodes")
    table = _table(lines, count, width := 1 + corners + attribute)
    if table.shape[1] > width:
        raise lines.error(
            f"the lines have {table.shape[1]} numbers, {width} after the first line of the file"
        )
    nodes = find_all(
        labels, _whole(lines, table[:, 1 : corners + 1].reshape(-1)).reshape(-1, corners)
    )
    part = table[:, corners + 1] if attribute > 0 else np.zeros(count)
    if corners == 4:
        return by_number("tetra", nodes, part)
    order = _order(nodes[:_LOOKED_AT], points)
    if len(np.unique(order)) < len(order):
        raise lines.error("the midside nodes lie on no edges", "straight elements of ten nodes")
    return by_number("tetra10", nodes[:, order], part)


def _order(nodes: IntArray, points: FloatArray) -> IntArray:
    """Places of ten nodes in the order of VTK: midside nodes lie in the middle of their edges."""
    middles, own = points[nodes[:, _EDGES]].mean(axis=2), points[nodes[:, 4:]]
    off = np.linalg.norm(middles[:, :, None, :] - own[:, None, :, :], axis=3).mean(axis=0)
    return np.concatenate([np.arange(4), 4 + off.argmin(axis=1)])


def _faces(path: Path, labels: IntArray) -> Block:
    """Faces of three or six nodes, behind which the marker stands, and two neighbours may stand."""
    lines = Lines(path)
    count, marked, *_ = _head(lines, 2)
    table = _table(lines, count, 4 + (marked > 0))
    width = table.shape[1] - 1 - (marked > 0)
    if width not in (3, 5, 6, 8):
        raise lines.error(f"faces of {table.shape[1]} numbers are not understood")
    corners = 3 if width < 6 else 6
    marker = table[:, 1 + corners] if marked > 0 else np.zeros(count)
    nodes = find_all(labels, _whole(lines, table[:, 1:4].reshape(-1)).reshape(-1, 3))
    return by_number("triangle", nodes, marker)


def _head(lines: Lines, least: int) -> list[int]:
    """The numbers of the first line; those that are left out are 0."""
    numbers = lines.integers(lines.row())
    if numbers[0] < 1 or min(numbers) < 0:
        raise lines.error(f"{numbers[0]} is no number of lines")
    return numbers + [0] * (least - len(numbers))


def _table(lines: Lines, count: int, least: int) -> FloatArray:
    table = lines.table(count)
    if table.shape[1] < least:
        raise lines.error(f"the lines have {table.shape[1]} numbers, {least} are needed")
    return table
