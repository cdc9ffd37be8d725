"""Reads what `writers/xdmf.py` has written, by its XML and the HDF5 files that this refers to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.files.regular import irregular
from dolfin_elastic.core.files.xml import read_xml
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import AnyArray

if TYPE_CHECKING:
    import pyvista

# XDMF's name of a cell -> VTK's number, dimension, nodes.
_CELLS = {
    "Triangle": (5, 2, 3),
    "Triangle_6": (22, 2, 6),
    "Tetrahedron": (10, 3, 4),
    "Tetrahedron_10": (24, 3, 10),
}


_COLUMNS = 9
"""Numbers of a value, at most: those of a tensor."""
_NAME = re.compile(r"\w[\w .-]{0,99}")


@dataclass(frozen=True)
class Stored:
    """An array in an HDF5 file.

    Attributes:
        file: Relative to the folder of the results.
        name: In the file.
        shape: Rows and columns.
        centre: "node" or "cell".
    """

    file: str
    name: str
    shape: tuple[int, ...]
    centre: str = "node"


@dataclass(frozen=True)
class Frame:
    """One step.

    Attributes:
        number: Of the step in the run.
        t: Time [s], or load parameter.
        kind: XDMF's name of the cells.
        points: Places of the nodes.
        cells: Nodes of each cell in VTK's order.
        arrays: Name of a field to its numbers.
    """

    number: int
    t: float
    kind: str
    points: Stored
    cells: Stored
    arrays: Mapping[str, Stored]

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return _CELLS[self.kind][1]


def damaged(what: str, where: str) -> InputError:
    """The error about a file of results that is not as the run has written it.

    Args:
        where: The file, and what of it.
    """
    return InputError(what, where=where, expected="the files as the run has left them")


def read_frames(path: Path) -> list[Frame]:
    """The steps of an XDMF file; none if there is no file.

    Args:
        path: A file from `XdmfWriter` or of a mode.

    Raises:
        InputError: It is no such file.
    """
    if not path.exists():
        return []
    try:
        return [_frame(grid) for grid in read_xml(path).iterfind(".//Grid/Grid")]
    except (OSError, ElementTree.ParseError, KeyError, ValueError, AttributeError) as error:
        raise InputError(
            f"cannot be read: {error}", where=str(path), expected="expected a file from a run"
        ) from None


def _frame(grid: ElementTree.Element) -> Frame:
    topology, geometry, time = (_child(grid, name) for name in ("Topology", "Geometry", "Time"))
    kind = topology.attrib["TopologyType"]
    if kind not in _CELLS:
        raise ValueError(f"unknown cells '{kind}'")
    arrays = {
        _name(row): _stored(row, row.attrib["Center"].lower()) for row in grid.iterfind("Attribute")
    }
    number = int(grid.attrib["Name"].rpartition(" ")[2])
    t = float(time.attrib["Value"])
    return Frame(number, t, kind, _stored(geometry), _stored(topology, "cell"), arrays)


def _name(row: ElementTree.Element) -> str:
    """Name of a field; names of pictures are made of it."""
    name = row.attrib["Name"]
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name[:100]!r} is no name of a field")
    return name


def _child(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    element = parent.find(name)
    if element is None:
        raise ValueError(f"a step has no {name}")
    return element


def _stored(parent: ElementTree.Element, centre: str = "node") -> Stored:
    item = _child(parent, "DataItem")
    file, _, name = (item.text or "").rpartition(":/")
    if not file or Path(file).is_absolute() or ".." in Path(file).parts:
        raise ValueError(f"'{item.text}' is no data set of a file beside it")
    shape = tuple(int(size) for size in item.attrib["Dimensions"].split())
    return Stored(file, name, shape, centre)


def read_array(folder: Path, stored: Stored, start: int = 0, stop: int | None = None) -> AnyArray:
    """The numbers of an array.

    Args:
        stored: Where they are.
        stop: The row after the last one; None: all of them.

    Raises:
        InputError: The file is missing or damaged.
    """
    path = folder / stored.file
    above = [folder / part for part in Path(stored.file).parents[:-1]]
    if kind := next(filter(None, map(irregular, (*above, path))), ""):
        raise damaged(f"this is {kind}, which is not followed", str(path))
    try:
        result = hdf5.read_rows(path, stored.name, start, stop)
    except OSError as error:
        raise InputError(
            f"cannot be read: {error}",
            where=f"{path}:/{stored.name}",
            expected="keep results.xdmf and the folder results_data together",
        ) from None
    rows = stored.shape[0] if stop is None else stop
    if result.shape != (shape := (rows - start, *stored.shape[1:])):
        raise damaged(f"it has the shape {result.shape}, not {shape}", f"{path}:/{stored.name}")
    return result


def read_grid(folder: Path, frame: Frame) -> pyvista.UnstructuredGrid:
    """The undeformed body with the fields of a step, see `FinishedRun.grid`."""
    with elsewhere():
        import pyvista as pv

    cells, points = read_array(folder, frame.cells), read_array(folder, frame.points)
    for array, columns, where in (
        (cells, _CELLS[frame.kind][2], frame.cells),
        (points, 3, frame.points),
    ):
        if array.shape[1:] != (columns,):
            raise damaged(
                f"it has the shape {array.shape}, not (n, {columns})",
                f"{folder / where.file}:/{where.name}",
            )
    if cells.size and not 0 <= cells.min() <= cells.max() < len(points):
        raise damaged("cells have nodes that are not there", str(folder / frame.cells.file))
    kinds = np.full(len(cells), _CELLS[frame.kind][0], dtype=np.uint8)
    rows = np.insert(cells.astype(np.int64), 0, cells.shape[1], axis=1)
    grid = pv.UnstructuredGrid(rows.ravel(), kinds, points)
    sizes: dict[str, tuple[int, Any]] = {
        "node": (len(points), grid.point_data),
        "cell": (len(cells), grid.cell_data),
    }
    for name, stored in frame.arrays.items():
        count, data = sizes[stored.centre]
        values = read_array(folder, stored)
        if len(values) != count or values.ndim != 2 or not 1 <= values.shape[1] <= _COLUMNS:
            raise damaged(f"'{name}' has the shape {values.shape}, not ({count}, n)", str(folder))
        data[name] = values[:, 0] if values.shape[1] == 1 else values
    return grid
