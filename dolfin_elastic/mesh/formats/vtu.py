"""VTK's XML files of unstructured grids (.vtu)."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.fields import as_columns
from dolfin_elastic.mesh.formats.meshio import (
    IGNORED,
    REFERENCES,
    is_number,
    sets_by_value,
)
from dolfin_elastic.mesh.formats.raw import Block, MeshFile
from dolfin_elastic.mesh.formats.vtk_xml import TYPES, VtkXml, count_of

_KINDS = {
    (1, 1): "vertex",
    (3, 2): "line",
    (5, 3): "triangle",
    (8, 4): "quad",
    (9, 4): "quad",
    (10, 4): "tetra",
    (11, 8): "hexahedron",
    (12, 8): "hexahedron",
    (13, 6): "wedge",
    (14, 5): "pyramid",
    (21, 3): "line3",
    (22, 6): "triangle6",
    (23, 8): "quad8",
    (24, 10): "tetra10",
    (25, 20): "hexahedron20",
    (26, 15): "wedge15",
    (27, 13): "pyramid13",
    (28, 9): "quad9",
    (29, 27): "hexahedron27",
    (68, 2): "line",
    (68, 3): "line3",
    (69, 3): "triangle",
    (69, 6): "triangle6",
    (71, 4): "tetra",
    (71, 10): "tetra10",
}
"""Number of VTK's cell type and of its nodes: linear, quadratic, and Lagrange's of any order."""
_NAMES = {2: "polyvertex", 4: "polyline", 6: "triangle strip", 7: "polygon", 34: "triangle"}
_NAMES |= {15: "pentagonal prism", 16: "hexagonal prism", 69: "triangle", 71: "tetra"}
"""Shape of types that are not read, for messages and, of plane ones, for their dimension."""
ONE_PIECE = "save it as one .vtu file (in ParaView: Merge Blocks, Clean to Grid, Save Data)"
_GHOSTS = "vtkGhostType"
_DUPLICATE = 1  # flag of a cell that another file has


def read_vtu(path: Path) -> MeshFile:
    """Reads an unstructured grid. Local: one rank reads.

    Raises:
        MeshError: The file is damaged, of another kind, or in several pieces.
    """
    try:
        return _File(path.read_bytes()).mesh()
    except MeshError as error:
        raise error if error.where else error.at(path.name) from None


class _File:
    """One file."""

    def __init__(self, content: bytes) -> None:
        self._xml = VtkXml(content, "UnstructuredGrid")

    def mesh(self) -> MeshFile:
        """Points, cells and data."""
        pieces = self._xml.root.findall("UnstructuredGrid/Piece")
        if len(pieces) != 1:
            raise MeshError(
                f"the grid is in {len(pieces)} pieces",
                expected=ONE_PIECE,
            )
        piece = pieces[0]
        count, cells = (count_of(piece, key) for key in ("NumberOfPoints", "NumberOfCells"))
        if not count or not cells:
            raise MeshError("the mesh has no points or no cells")
        places = piece.find("Points/DataArray")
        if places is None:
            raise MeshError("there are no Points")
        points = self._xml.array(places, count, 3).astype(np.float64).reshape(count, -1)
        if points.shape[1] not in (2, 3):
            raise MeshError(f"the points have {points.shape[1]} coordinates")
        keep, nodes, kinds = self._cells(piece, cells, count)
        data = self._data(piece, "CellData", cells)
        if _GHOSTS in data:
            keep &= (data.pop(_GHOSTS).astype(np.int64) & _DUPLICATE) == 0
        blocks = [
            _block(kind, nodes_of, rows[keep[rows]], keep[rows], data)
            for (kind, rows), nodes_of in zip(kinds, nodes, strict=True)
        ]
        at_points = self._data(piece, "PointData", count)
        at_points.pop(_GHOSTS, None)
        fields = {name: as_columns(a, count, name) for name, a in at_points.items()}
        return MeshFile(points, blocks, point_data=fields)

    def _cells(
        self, piece: ElementTree.Element, cells: int, points: int
    ) -> tuple[AnyArray, list[IntArray], list[tuple[str, IntArray]]]:
        """All cells (true), and for each kind the nodes and the numbers of its cells."""
        arrays = {a.get("Name"): a for a in piece.findall("Cells/DataArray")}
        absent = [name for name in ("types", "offsets", "connectivity") if name not in arrays]
        if absent:
            raise MeshError(f"the Cells have no array '{absent[0]}'")
        types = self._xml.array(arrays["types"], cells, 1).astype(np.int64)
        ends = self._xml.array(arrays["offsets"], cells, 1).astype(np.int64)
        sizes = np.diff(ends, prepend=0)
        if (sizes < 0).any():
            raise MeshError("the offsets of the cells do not ascend")
        total = int(ends[-1])
        every = self._xml.array(arrays["connectivity"], total, 1).astype(np.int64)
        if len(every) and not 0 <= every.min() <= every.max() < points:
            bad = every.min() if every.min() < 0 else every.max()
            raise MeshError(f"elements refer to the point {bad}, but there are {points} points")
        nodes: list[IntArray] = []
        kinds: list[tuple[str, IntArray]] = []
        for number, size in np.unique(np.stack([types, sizes]), axis=1).T.tolist():
            rows = np.flatnonzero((types == number) & (sizes == size))
            kinds.append((_kind(number, size), rows))
            nodes.append(every[(ends[rows] - size)[:, None] + np.arange(size)])
        return np.ones(cells, dtype=bool), nodes, kinds

    def _data(self, piece: ElementTree.Element, part: str, rows: int) -> dict[str, AnyArray]:
        """Numbers of all cells or points; texts are left out."""
        result = {}
        for array in piece.findall(f"{part}/DataArray"):
            if array.get("type") in TYPES and rows:
                columns = count_of(array, "NumberOfComponents", 1)
                values = self._xml.array(array, rows, columns)
                result[array.get("Name", "")] = values.reshape(rows, -1) if columns > 1 else values
        return result


def _kind(number: int, size: int) -> str:
    return _KINDS.get((number, size), f"{_NAMES.get(number, 'polyhedron')}{size}")


def _block(
    kind: str, nodes: IntArray, rows: IntArray, keep: AnyArray, data: dict[str, AnyArray]
) -> Block:
    """A block of the cells of one kind, with sets by the values of integers, and fields."""
    parts: dict[str, IntArray] = {}
    fields: dict[str, FloatArray] = {}
    for name, values in data.items():
        if name in IGNORED:
            continue
        own = values[rows]
        sets = sets_by_value(own, name, {})
        if sets:
            parts.update(sets)
        elif is_number(own) and name not in REFERENCES:
            fields[name] = as_columns(own, len(rows), name)
    return Block(kind, nodes[keep], parts, fields)
