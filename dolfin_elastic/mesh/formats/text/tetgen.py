"""TetGen and Triangle: nodes (.node), elements (.ele) and their marked facets beside each other.

Facets are the faces of tetrahedra (.face), and the edges (.edge) or else segments (.poly) of
triangles.  Read here rather than through meshio 5.3, which takes tetrahedra of four nodes only and
leaves out all faces.  Sources: H. Si, TetGen, A Quality Tetrahedral Mesh Generator, Version 1.5
User's Manual (2013), on file formats; J. R. Shewchuk, Triangle, Version 1.6 (2005), likewise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, find_all
from dolfin_elastic.mesh.formats.text.lines import Lines, by_number

_EDGES = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]
"""Corners of the edges in the order of the midside nodes of VTK; those of triangles come first."""
_FACETS = {2: (".edge", ".poly"), 3: (".face",)}
"""Files of the facets of triangles and of tetrahedra; the first one that is there is read."""
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
                f"there is no '{path.with_suffix(suffix).name}' beside it",
                where=path.name,
                expected="nodes (.node) and elements (.ele) beside each other, under one name",
            )
    lines = Lines(path.with_suffix(".node"))
    count, dim, attributes, marked, *_ = _head(lines, 4)
    if dim not in (2, 3):
        raise lines.error(
            f"nodes in {dim} dimensions are not read", "meshes of triangles or of tetrahedra"
        )
    table = _table(lines, count, 1 + dim + attributes)
    order = np.argsort(table[:, 0], kind="stable")
    table = table[order]
    labels = _whole(lines, table[:, 0])
    if len(np.unique(labels)) < len(labels):
        raise lines.error("a node stands twice")
    points, behind = table[:, 1 : 1 + dim], table[:, 1 + dim :]
    data = {f"tetgen:attr{k + 1}": behind[:, k : k + 1] for k in range(attributes)}
    blocks = [_cells(path.with_suffix(".ele"), labels, points), *_facets(path, labels, dim)]
    notes = [f"markers of nodes are not read: those of facets ({_FACETS[dim][0]}) name surfaces"]
    marks = marked > 0 and np.any(behind[:, attributes:])  # markers other than 0
    return MeshFile(points, blocks, information=notes if marks else [], point_data=data)


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
    vertices = 1 + points.shape[1]
    if corners not in (vertices, whole := vertices * (vertices + 1) // 2):
        raise lines.error(
            f"elements of {corners} nodes are not read", f"{vertices} or {whole} nodes"
        )
    table = _table(lines, count, width := 1 + corners + attribute)
    if table.shape[1] > width:
        raise lines.error(
            f"the lines have {table.shape[1]} numbers, {width} after the first line of the file"
        )
    nodes = find_all(
        labels, _whole(lines, table[:, 1 : corners + 1].reshape(-1)).reshape(-1, corners)
    )
    part = table[:, corners + 1] if attribute > 0 else np.zeros(count)
    kind = {3: "triangle", 4: "tetra"}[vertices]
    if corners == vertices:
        return by_number(kind, nodes, part)
    order = _order(nodes[:_LOOKED_AT], points)
    if len(np.unique(order)) < len(order):
        raise lines.error(
            "the midside nodes lie on no edges", f"straight elements of {corners} nodes"
        )
    return by_number(f"{kind}{corners}", nodes[:, order], part)


def _order(nodes: IntArray, points: FloatArray) -> IntArray:
    """Places of all nodes in the order of VTK: midside nodes lie in the middle of their edges."""
    vertices = 1 + points.shape[1]
    own = points[nodes[:, vertices:]]
    middles = points[nodes[:, _EDGES[: own.shape[1]]]].mean(axis=2)
    off = np.linalg.norm(middles[:, :, None, :] - own[:, None, :, :], axis=3).mean(axis=0)
    return np.concatenate([np.arange(vertices), vertices + off.argmin(axis=1)])


def _facets(path: Path, labels: IntArray, dim: int) -> list[Block]:
    """Faces of tetrahedra or sides of triangles; none where no file holds them.

    The marker stands behind the nodes, and two neighbours may stand behind that of a face.
    """
    files = (path.with_suffix(suffix) for suffix in _FACETS[dim])
    if not (file := next((file for file in files if file.is_file()), None)):
        return []
    lines = Lines(file)
    if file.suffix == ".poly":
        for _ in range(lines.integers(lines.row())[0]):  # nodes, which .node holds too
            lines.row()
    count, marked, *_ = _head(lines, 2, fewest=0)
    if not count:
        return []
    table = _table(lines, count, 1 + dim + (marked > 0))
    marked = marked or int(table.shape[1] == 5 == dim + 2)  # some have a marker, the head none
    width = table.shape[1] - 1 - (marked > 0)
    whole = dim * (dim + 1) // 2  # nodes of a quadratic facet
    if width not in ((dim, whole) if dim == 2 else (dim, dim + 2, whole, whole + 2)):
        raise lines.error(f"facets of {table.shape[1]} numbers are not understood")
    marker = table[:, 1 + (dim if width < whole else whole)] if marked > 0 else np.zeros(count)
    nodes = find_all(labels, _whole(lines, table[:, 1 : 1 + dim].reshape(-1)).reshape(-1, dim))
    return [by_number({2: "line", 3: "triangle"}[dim], nodes, marker)]


def _head(lines: Lines, least: int, fewest: int = 1) -> list[int]:
    """The numbers of the first line; those that are left out are 0."""
    numbers = lines.integers(lines.row())
    if numbers[0] < fewest or min(numbers) < 0:
        raise lines.error(f"{numbers[0]} is no number of lines")
    return numbers + [0] * (least - len(numbers))


def _table(lines: Lines, count: int, least: int) -> FloatArray:
    table = lines.table(count)
    if table.shape[1] < least:
        raise lines.error(f"the lines have {table.shape[1]} numbers, {least} are needed")
    return table
