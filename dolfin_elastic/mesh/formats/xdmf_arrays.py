"""Arrays in HDF5 files that the text of an `.xdmf` names, and the unit of length that it states."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from dolfin_elastic.core.errors import MeshError, not_shown, why_no_file
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.files.xml import read_xml
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.fields import MeshField, distribute_rows

UNIT = "metres per unit of length"
"""Name of the element `Information` that states it."""
_ROWS = 1 << 20
"""Of arrays that are compared at a time."""


@dataclass(frozen=True)
class Array:
    """An array in an HDF5 file, as the text of the `.xdmf` states it.

    Attributes:
        file: The HDF5 file, relative to the folder of the `.xdmf`.
        path: Of the array in it.
        shape: Its shape; it may be stored in one dimension, row after row.
    """

    file: str
    path: str
    shape: tuple[int, ...]

    @classmethod
    def of(cls, item: ElementTree.Element) -> Array:
        """The array that a `DataItem` states.

        Raises:
            MeshError: It has no shape, or is in no file beside the `.xdmf`.
        """
        return cls(*place_of(item), dimensions(item))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.shape[0]

    @property
    def columns(self) -> int:
        """Numbers of a row."""
        return math.prod(self.shape[1:])


def check_arrays(path: Path, arrays: Iterable[Array]) -> None:
    """Looks at the files of arrays, and at whether they are as the text states. Local.

    Args:
        arrays: All that are to be read.

    Raises:
        MeshError: A file is not there, is none to be read, or an array is of another shape.
    """
    wanted = dict.fromkeys(arrays)
    for name in sorted({array.file for array in wanted}):
        try:
            with hdf5.opened(path.parent / name) as file:
                for array in (one for one in wanted if one.file == name):
                    shape = hdf5.shape_in(file, array.path)
                    rows = shape[0], math.prod(shape[1:])
                    if rows != (array.rows, array.columns) and shape != (math.prod(array.shape),):
                        raise MeshError(
                            f"the array '{array.file}:{array.path}' has the shape {shape}, the "
                            f"text says {array.shape}",
                            expected="the .xdmf and the .h5 of the same mesh",
                        )
        except OSError as error:
            raise MeshError(
                f"its data file '{name}' cannot be read: {error}",
                expected="the .h5 as it was written, without links to other files",
            ) from None


def dimensions(item: ElementTree.Element) -> tuple[int, ...]:
    """Shape of an array, as the file states it. Local."""
    text = item.get("Dimensions", "0")
    try:
        shape = tuple(int(n) for n in text.split())
    except ValueError:
        shape = ()
    if not shape or min(shape) < 0:
        raise MeshError(f"an array has the Dimensions '{text}'", expected="for example '100 3'")
    return shape


def place_of(item: ElementTree.Element) -> tuple[str, str]:
    """The HDF5 file that has an array, and its path in there. Local.

    Raises:
        MeshError: The file is not beside the `.xdmf` or below.
    """
    text = (item.text or "").strip()
    file, _, path = text.partition(":")
    if not file or not path or Path(file).is_absolute() or ".." in Path(file).parts:
        raise MeshError(
            f"its data file '{text[:100]}' is not beside it",
            expected=(file and not_shown(file)) or "for example 'body.h5:/points'",
        )
    return file, path


def hdf_rows(file: Path, array: Array, start: int = 0, stop: int | None = None) -> AnyArray:
    """Some rows of an array in a file that `check_arrays` has looked at. Local.

    Args:
        stop: The row after the last one; None: all of them.

    Returns:
        Shape (stop - start, columns).

    Raises:
        OSError: It cannot be read.
    """
    stop = array.rows if stop is None else stop
    with hdf5.opened(file.parent / array.file, checked=True) as data:
        flat = len(hdf5.shape_in(data, array.path)) == 1
        each = array.columns if flat else 1
        result = hdf5.rows_of(data, array.path, start * each, stop * each)
    return result.reshape(stop - start, array.columns)


def refers_to(main: ElementTree.Element, grid: ElementTree.Element) -> bool:
    """Whether all grids that a grid includes arrays of by their names have that of the main one."""
    pointers = [one.get("xpointer", "") for one in grid.findall(".//{*}include")]
    names = re.findall(r"@Name='([^']*)'", " ".join(pointers))
    return {*names} <= {main.get("Name")}


def same_points(file: Path, main: ElementTree.Element, item: ElementTree.Element) -> bool:
    """Whether an array has the points of the main grid, if only as a copy. Local.

    Raises:
        MeshError: An array is not as the text states it.
        OSError: It cannot be read.
    """
    points = main.find("Geometry/DataItem")
    assert points is not None
    a, b = Array.of(points), Array.of(item)
    if a == b or a.shape != b.shape:
        return a == b
    check_arrays(file, [a, b])
    return all(np.array_equal(hdf_rows(file, a, *e), hdf_rows(file, b, *e)) for e in _pieces(a))


def is_flat(file: Path, points: Array) -> bool:
    """Whether the third coordinate of points is 0. Local.

    Raises:
        OSError: They cannot be read.
    """
    return not any(hdf_rows(file, points, *ends)[:, 2].any() for ends in _pieces(points))


def _pieces(array: Array) -> list[tuple[int, int]]:
    """First row and end of pieces that are looked at one after the other."""
    return [(i, min(i + _ROWS, array.rows)) for i in range(0, array.rows, _ROWS)]


def distributed(
    body: Body,
    centre: Literal["cell", "point"],
    file: Path,
    array: Array,
    what: str,
    unused: IntArray | None = None,
) -> MeshField:
    """A field whose rows rank 0 reads in pieces. Collective.

    Args:
        body: Read from the same file.
        unused: Rows of the file that the mesh is without, sorted; None: it has all of them.

    Raises:
        MeshError: It cannot be read, or has another number of rows.
    """
    kept = None
    if unused is not None and len(unused):
        kept = np.setdiff1d(np.arange(array.rows), unused)

    def read(start: int, stop: int) -> FloatArray:
        if kept is None:
            return np.asarray(hdf_rows(file, array, start, stop), dtype=np.float64)
        rows = kept[start:stop]
        result = hdf_rows(file, array, int(rows[0]), int(rows[-1]) + 1)
        return np.asarray(result[rows - rows[0]], dtype=np.float64)

    shape = array.rows if kept is None else len(kept), array.columns
    try:
        return distribute_rows(body.mesh, centre, shape, read if body.comm.rank == 0 else None)
    except MeshError as error:
        raise MeshError(f"{what}: {error}") from None


def unit_of_xdmf(path: Path) -> LengthUnit | None:
    """The unit of length that a converted mesh states. Local; None where it states none.

    Raises:
        MeshError: It is no length.
    """
    try:
        for element in read_xml(path).iter("Information"):
            if element.get("Name") == UNIT:
                return _unit(element.get("Value", ""), path)
    except ElementTree.ParseError:
        pass  # the reader says what is wrong
    return None


def _unit(text: str, path: Path) -> LengthUnit:
    try:
        metres = float(text)
    except ValueError:
        metres = np.nan
    if not (np.isfinite(metres) and metres > 0.0):
        raise MeshError(
            f"the unit of length has '{text}' metres",
            where=path.name,
            expected="a positive number, for example 0.001",
        )
    return LengthUnit.of(metres, stated=True)


def time_of(grid: ElementTree.Element) -> float | None:
    """The time of the functions of a grid, if it states one."""
    element = grid.find("Time")
    text = None if element is None else element.get("Value")
    try:
        return None if text is None else float(text)
    except ValueError:
        raise MeshError(f"a grid has the time '{text}'", expected="a number") from None


def data_files(path: Path, root: ElementTree.Element) -> list[str]:
    """The HDF5 files that the text names, which are beside it."""
    result = {}
    for item in root.iter("DataItem"):
        if item.get("Format") == "Binary":
            _check_binary(path, Path((item.text or "").strip()))
        if item.get("Format") == "HDF" and item.text:
            name, _ = place_of(item)
            if not (path.parent / name).is_file():
                raise MeshError(
                    f"its data file '{name}' is not beside it",
                    where=path.name,
                    expected=not_shown(path.parent / name) or "keep the .xdmf and the .h5 together",
                )
            result[name] = True
    return list(result)


def _check_binary(path: Path, named: Path) -> None:
    """Refuses a raw file, which meshio looks for in the current folder, but beside the `.xdmf`."""
    beside = path.parent / named.name
    if why_no_file(beside, sys.maxsize) or not beside.is_file():
        fault = f"its data file '{named}' is not beside it"
    elif not named.exists() or not named.samefile(beside):
        fault = f"its data file '{named}' is looked for in the current folder, not beside it"
    else:
        return
    raise MeshError(fault, where=path.name, expected="save it with its arrays in HDF5")
