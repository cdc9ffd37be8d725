"""VTKHDF: a series of states that ParaView reads from HDF5, quadratic cells with VTK's order.

Files:

    results.vtkhdf            the file to open: sizes, times and virtual arrays
    results_vtkhdf/mesh.h5    points and cells
    results_vtkhdf/000000.h5  fields of the first written state ...

The format wants each field's states one behind the other in one array.  It is a virtual one
(HDF5 1.10), put together from files of one state each, which all ranks write at once: a file that
grows with the run would be lost with it.  `results.vtkhdf` holds nothing but references, and is
replaced as a whole after each state.

Source: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/, version 2.0,
UnstructuredGrid with Steps.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.types import IntArray
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results.files import sync, writing
from dolfin_elastic.results.grid import Grid
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.writers.xdmf import Hdf5Series

if TYPE_CHECKING:
    import h5py

TYPES = {"Triangle": 5, "Triangle_6": 22, "Tetrahedron": 10, "Tetrahedron_10": 24}
"""XDMF's name of a cell to VTK's number of it."""
ROOT = "VTKHDF"
"""The group that holds all of it."""


class _Frame(TypedDict):
    """Entry of a state: its time, its files, and the sizes of the arrays in these."""

    t: float
    mesh: str
    file: str
    points: int
    cells: tuple[int, int]
    """Number of cells, and of nodes of each."""
    fields: dict[str, tuple[int, str]]
    """Name to number of columns and type."""


_MESH: dict[str, tuple[str, int, Callable[[_Frame], int]]] = {
    "Points": ("<f8", 3, lambda frame: frame["points"]),
    "Connectivity": ("<i8", 1, lambda frame: frame["cells"][0] * frame["cells"][1]),
    "Offsets": ("<i8", 1, lambda frame: frame["cells"][0] + 1),
    "Types": ("|u1", 1, lambda frame: frame["cells"][0]),
}
"""Arrays of a mesh: type, columns, and rows in the mesh of a frame."""
_FRAMES = "frames"
_SIZES = {
    "NumberOfPoints": "Points",
    "NumberOfCells": "Types",
    "NumberOfConnectivityIds": "Connectivity",
}


class VtkhdfWriter(Hdf5Series):
    """Writes states of a problem as VTKHDF; see the module.  All of it is collective.

    See `SeriesWriter`.
    """

    folder = "_vtkhdf"

    def _mesh_arrays(self, grid: Grid) -> dict[str, Rows]:
        cells = grid.rows("cell", grid.cells().astype(np.int64))
        count, width = cells.shape
        own = len(cells.values)
        last = cells.first + own == count and (own > 0 or grid.mesh.comm.rank == 0)
        ends = width * np.arange(cells.first, cells.first + own + last, dtype=np.int64)
        kinds = np.full((own, 1), TYPES[grid.kind], dtype=np.uint8)
        return {
            "Points": grid.rows("node", grid.points()),
            "Connectivity": Rows(cells.values.reshape(-1, 1), width * cells.first, width * count),
            "Offsets": Rows(ends[:, None], cells.first, count + 1),
            "Types": Rows(kinds, cells.first, count),
        }

    def _mesh_of(self, entry: str) -> str:
        return str(json.loads(entry)["mesh"])

    def _entry(self, state: State, file: str, rows: Mapping[str, Rows]) -> str:
        grid = self._evaluate.grid
        points, cells = grid.V.dofmap.index_map.size_global, grid.rows("cell", grid.cells()).shape
        content: _Frame = {
            "t": plain(state.t),
            "mesh": self.mesh_file,
            "file": file,
            "points": int(points),
            "cells": cells,
            "fields": {name: (r.shape[1], r.values.dtype.str) for name, r in rows.items()},
        }
        return json.dumps(content)

    def _named(self, entry: str) -> list[str]:
        content = json.loads(entry)
        return [content["mesh"], content["file"]]

    def _entries(self) -> list[str]:
        # Its virtual arrays name the files of the states; these are not read here.
        with hdf5.opened(self.path, virtual=True) as file:
            return [text.decode() for text in file[_FRAMES][:]]

    def _replace_index(self, frames: Sequence[str]) -> None:
        import h5py

        draft = self.path.with_name(f".{self.path.name}.part")
        with writing(self.path):
            try:
                with h5py.File(fresh(draft), "w") as file:
                    file[_FRAMES] = [entry.encode() for entry in frames]
                    self._fill(file.create_group(ROOT), [json.loads(entry) for entry in frames])
            except RuntimeError as error:  # what h5py raises where closing fails
                raise OutputError(f"cannot write {self.path}: {error}") from error
            sync(draft)
            draft.replace(self.path)

    def _fill(self, root: h5py.Group, frames: Sequence[_Frame]) -> None:
        """Writes sizes, times and virtual arrays of all states. On rank 0."""
        meshes = list({frame["mesh"]: frame for frame in frames}.values())
        names = [frame["mesh"] for frame in meshes]
        mesh = np.array([names.index(frame["mesh"]) for frame in frames], dtype=np.int64)
        starts = {}
        for name, (kind, columns, rows) in _MESH.items():
            parts = [_Source(self._place(f["mesh"]), name, rows(f), columns) for f in meshes]
            _virtual(root, name, kind, parts)
            starts[name] = _starts(parts)
        describe(root, [frame["t"] for frame in frames], mesh, starts)
        for name in frames[0]["fields"]:
            self._fill_field(
                root, name, meshes if self._evaluate.table[name].fixed else frames, mesh
            )

    def _fill_field(
        self, root: h5py.Group, name: str, frames: Sequence[_Frame], mesh: IntArray
    ) -> None:
        """Writes the virtual array of a field. On rank 0.

        Args:
            frames: Those whose values are written: all, or of a fixed field one of each mesh.
            mesh: Number of the mesh of each state.
        """
        field = self._evaluate.table[name]
        group = "PointData" if field.centre == "node" else "CellData"
        columns, kind = frames[0]["fields"][name]
        parts = [
            _Source(
                self._place(frame["mesh"] if field.fixed else frame["file"]),
                name,
                frame["points"] if field.centre == "node" else frame["cells"][0],
                columns,
            )
            for frame in frames
        ]
        _virtual(root.require_group(group), name, kind, parts)
        starts = _starts(parts)
        offsets = starts[mesh] if field.fixed else starts[:-1]
        root["Steps"].require_group(f"{group}Offsets")[name] = offsets

    def _place(self, file: str) -> str:
        return f"{self.data.name}/{file}"


def describe(
    root: h5py.Group, times: Sequence[float], mesh: IntArray, starts: Mapping[str, IntArray]
) -> None:
    """Writes version, times, sizes, and which mesh each state has. Not collective.

    Args:
        mesh: Number of the mesh of each state.
        starts: "Points", "Connectivity" and "Types" to the first row of each mesh in these arrays,
            and the number of all rows.
    """
    root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(len(times))
    steps["Values"] = np.array(times, dtype=np.float64)
    for size, name in _SIZES.items():
        root[size] = np.diff(starts[name])
    steps["PartOffsets"] = mesh
    steps["NumberOfParts"] = np.ones_like(mesh)
    steps["PointOffsets"] = starts["Points"][mesh]
    steps["CellOffsets"] = starts["Types"][mesh][:, None]
    steps["ConnectivityIdOffsets"] = starts["Connectivity"][mesh][:, None]


@dataclass(frozen=True)
class _Source:
    """A part of a virtual array.

    Attributes:
        file: Relative to the file with the virtual array.
        name: Of the array in it.
        rows: Of the array there.
        columns: Of the array there.
    """

    file: str
    name: str
    rows: int
    columns: int


def _starts(parts: Sequence[_Source]) -> IntArray:
    """First row of each part in the virtual array, and behind them the number of all rows."""
    return np.concatenate([[0], np.cumsum([part.rows for part in parts])]).astype(np.int64)


def _virtual(group: h5py.Group, name: str, kind: str, parts: Sequence[_Source]) -> None:
    """Creates an array that consists of parts in other files; of one column it is a plain one.

    Args:
        kind: Type of its numbers, as NumPy writes it.
        parts: With the same number of columns.
    """
    import h5py

    starts, columns = _starts(parts), parts[0].columns
    across = (columns,) if columns > 1 else ()
    space = h5py.h5s.create_simple((int(starts[-1]), *across))
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    for first, part in zip(starts, parts, strict=False):
        space.select_hyperslab((int(first), *(0 for _ in across)), (part.rows, *across))
        source = h5py.h5s.create_simple((part.rows, columns))
        properties.set_virtual(space, part.file.encode(), part.name.encode(), source)
    space.select_all()
    number = h5py.h5t.py_create(np.dtype(kind))
    h5py.h5d.create(group.id, name.encode(), number, space, dcpl=properties)
