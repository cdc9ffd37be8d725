"""Every other format, through meshio: .vtu, .vtk, .med, .mesh, .bdf ... with their names."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.fields import as_columns
from dolfin_elastic.mesh.formats.losses import check_before, check_cells, check_warnings
from dolfin_elastic.mesh.formats.raw import Block, MeshFile

if TYPE_CHECKING:
    import meshio

# Integer cell data that are references of the format itself: their number is the name.
REFERENCES = ("gmsh:physical", "medit:ref", "nastran:ref", "tetgen:ref", "cell_tags")
IGNORED = ("gmsh:geometrical",)
_MOST = 200  # more distinct integers than this are data, not names


def read_meshio(path: Path) -> MeshFile:
    """Reads a file with meshio. Local: one rank reads.

    Raises:
        MeshError: meshio does not know the format or cannot read the file.
    """
    mesh = _read(path)
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or len(points) == 0:
        raise MeshError("the mesh has no points", where=path.name)
    blocks = [
        Block(cells.type, _nodes(cells, path), _parts(mesh, i), _cell_data(mesh, i))
        for i, cells in enumerate(mesh.cells)
    ]
    sets: dict[str, IntArray] = {
        str(name): np.asarray(rows, dtype=np.int64).reshape(-1)
        for name, rows in (mesh.point_sets or {}).items()
    }
    sets.update(_tagged(mesh.point_data.get("point_tags"), getattr(mesh, "point_tags", {})))
    data = {
        str(name): as_columns(values, len(points), str(name))
        for name, values in mesh.point_data.items()
        if name != "point_tags" and is_number(np.asarray(values))
    }
    check_cells(path, sum(len(block.nodes) for block in blocks))
    return MeshFile(points, blocks, point_sets=sets, point_data=data)


def is_number(data: AnyArray) -> bool:
    """Whether an array holds numbers."""
    return data.dtype.kind in "fiu"


def _cell_data(mesh: meshio.Mesh, i: int) -> dict[str, FloatArray]:
    """Cell data that are fields; integers name parts instead, see `sets_by_value`."""
    found = {}
    for name, blocks in mesh.cell_data.items():
        if name in IGNORED or name in REFERENCES or i >= len(blocks):
            continue
        data = np.asarray(blocks[i])
        if is_number(data) and not sets_by_value(data, name, {}):
            found[str(name)] = as_columns(data, len(mesh.cells[i].data), str(name))
    return found


def check_hdf5(path: Path, where: str) -> None:
    """Refuses an HDF5 file that leads out of itself, or states more than it can hold. Local.

    Args:
        path: The HDF5 file, which meshio is to read.
        where: The file that names it, or itself, for the message.

    Raises:
        MeshError: It is such a file, or damaged.
    """
    try:
        hdf5.check(path)
    except OSError as error:
        raise MeshError(
            f"the HDF5 file '{path.name}' cannot be read: {error}",
            where=where,
            expected="the file as it was written, without links to other files",
        ) from None


def _read(path: Path) -> meshio.Mesh:
    import meshio

    if hdf5.is_hdf5(path):
        check_hdf5(path, path.name)
    check_before(path)
    output = io.StringIO()
    try:
        with ExitStack() as stack:
            # meshio prints its errors and ends the process.
            stack.enter_context(contextlib.redirect_stdout(output))
            stack.enter_context(contextlib.redirect_stderr(output))
            stack.enter_context(warnings.catch_warnings())
            # What numpy says of words amid numbers, from which on it reads nothing.
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            mesh = meshio.read(path)
    except SystemExit:
        raise MeshError(
            f"meshio cannot read it: {' '.join(output.getvalue().split())[:300]}", where=path.name
        ) from None
    except Exception as error:  # readers fail in any way on damaged files
        raise MeshError(
            f"meshio cannot read it: {_reason(path, error)}",
            where=path.name,
            expected="formats: .msh, .xdmf, .inp, .unv, .vtu, .vtk, .med, .mesh, .bdf; "
            ".geo, .step, .brep",
        ) from None
    check_warnings(output.getvalue(), path)
    return mesh


def _reason(path: Path, error: Exception) -> str:
    if "deduce file format" in str(error):
        return f"unknown suffix '{path.suffix}'"
    return " ".join(f"{type(error).__name__} {error}".split())[:300]


def _nodes(cells: meshio.CellBlock, path: Path) -> IntArray:
    try:
        nodes = np.asarray(cells.data, dtype=np.int64)
    except (ValueError, TypeError):  # ragged: polyhedra
        return np.zeros((len(cells.data), 1), dtype=np.int64)
    return nodes.reshape(len(nodes), -1)


def _parts(mesh: meshio.Mesh, i: int) -> dict[str, IntArray]:
    parts: dict[str, IntArray] = {}
    for name, sets in (mesh.cell_sets or {}).items():
        # meshio's own helper sets are no names of the user.
        if not name.startswith("gmsh:") and i < len(sets) and sets[i] is not None:
            _add(parts, str(name), np.asarray(sets[i], dtype=np.int64).reshape(-1))
    dim = Block(mesh.cells[i].type, np.empty((0, 0), dtype=np.int64)).dim
    for key, data in mesh.cell_data.items():
        if key in IGNORED or i >= len(data):
            continue
        names = _numbered(key, mesh, dim)
        for name, rows in sets_by_value(np.asarray(data[i]), key, names).items():
            _add(parts, name, rows)
    return parts


def _add(parts: dict[str, IntArray], name: str, rows: IntArray) -> None:
    parts[name] = np.union1d(rows, parts[name]) if name in parts else rows


def _numbered(key: str, mesh: meshio.Mesh, dim: int) -> Mapping[int, Sequence[str]]:
    """Names of the values of integer cell data, where the format has some."""
    if key == "cell_tags":
        return getattr(mesh, "cell_tags", {}) or {}
    if key == "gmsh:physical":
        return {int(tag): [name] for name, (tag, d) in (mesh.field_data or {}).items() if d == dim}
    return {}


def sets_by_value(
    data: AnyArray, key: str, names: Mapping[int, Sequence[str]]
) -> dict[str, IntArray]:
    """Splits integer cell data into named sets of rows.

    Args:
        data: One number for each cell of a block.
        names: Names of values, where the format has them; others are called "3" in data that the
            format uses as references, and else "key_3".

    Returns:
        Name to rows; empty for data that are no integers or have more than 200 values.
    """
    whole = np.issubdtype(data.dtype, np.integer) or (
        key in REFERENCES and bool(np.all(data == np.round(data)))
    )
    if data.ndim != 1 or not whole:
        return {}
    values = np.unique(data)
    if len(values) > _MOST:
        return {}
    parts: dict[str, IntArray] = {}
    for value in values:
        if key in REFERENCES and value == 0:
            continue
        plain = [str(int(value))] if key in REFERENCES else [f"{key}_{int(value)}"]
        for name in names.get(int(value), plain):
            _add(parts, name, np.flatnonzero(data == value))
    return parts


def _tagged(tags: IntArray | None, names: Mapping[int, Sequence[str]]) -> dict[str, IntArray]:
    """Groups of points of MED files."""
    sets: dict[str, IntArray] = {}
    if tags is None:
        return sets
    for value, groups in (names or {}).items():
        for name in groups:
            _add(sets, name, np.flatnonzero(np.asarray(tags) == value))
    return sets
