"""Every other format, through meshio: .vtk, .med, .mesh, .cgns ... with their names."""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.fields import as_columns
from dolfin_elastic.mesh.formats import med
from dolfin_elastic.mesh.formats.raw import Block, MeshFile

if TYPE_CHECKING:
    import meshio

# Integer cell data that are references of the format itself: their number is the name.
REFERENCES = ("gmsh:physical", "medit:ref", "nastran:ref", "tetgen:ref", "cell_tags")
IGNORED = ("gmsh:geometrical",)
_MOST = 200  # more distinct integers than this are data, not names


def read_meshio(path: Path, kind: str | None = None) -> MeshFile:
    """Reads a file with meshio. Local: one rank reads.

    Args:
        kind: The format in the words of meshio; None: that of the suffix.

    Raises:
        MeshError: meshio does not know the format or cannot read the file.
    """
    mesh = _read(path, kind)
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
    _check_cells(path, sum(len(block.nodes) for block in blocks))
    notes = med.left_out(path) if path.suffix.lower() == ".med" else []
    return MeshFile(points, blocks, notes, point_sets=sets, point_data=data)


def is_number(data: AnyArray) -> bool:
    """Whether an array holds numbers."""
    return data.dtype.kind in "fiu"


def _cell_data(mesh: meshio.Mesh, i: int) -> dict[str, FloatArray]:
    """Cell data that are fields; integers name parts instead, see `sets_by_value`."""
    result = {}
    for name, blocks in mesh.cell_data.items():
        if name in IGNORED or name in REFERENCES or i >= len(blocks):
            continue
        data = np.asarray(blocks[i])
        if is_number(data) and not sets_by_value(data, name, {}):
            result[str(name)] = as_columns(data, len(mesh.cells[i].data), str(name))
    return result


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


def _read(path: Path, kind: str | None) -> meshio.Mesh:
    import meshio

    if hdf5.is_hdf5(path):
        check_hdf5(path, path.name)
    _check_before(path)
    output = io.StringIO()
    try:
        with ExitStack() as stack:
            # meshio prints its errors and ends the process.
            stack.enter_context(contextlib.redirect_stdout(output))
            stack.enter_context(contextlib.redirect_stderr(output))
            stack.enter_context(warnings.catch_warnings())
            # What numpy says of words amid numbers, from which on it reads nothing.
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            whole = med.completed(path) if path.suffix.lower() == ".med" else None
            mesh = meshio.med.read(whole) if whole else meshio.read(path, kind)
    except SystemExit:
        raise MeshError(
            f"meshio cannot read it: {' '.join(output.getvalue().split())[:300]}", where=path.name
        ) from None
    except Exception as error:  # readers fail in any way on damaged files
        raise MeshError(
            f"meshio cannot read it: {_reason(path, error)}",
            where=path.name,
            expected="formats: .msh, .xdmf, .inp, .unv, .vtu, .vtk, .med, .mesh, .bdf, .exo; "
            ".geo, .step, .brep; surfaces: .stl, .obj, .ply, .3mf",
        ) from None
    _check_warnings(output.getvalue(), path)
    return mesh


def _reason(path: Path, error: Exception) -> str:
    if "deduce file format" in str(error):
        return f"unknown suffix '{path.suffix}'"
    return " ".join(f"{type(error).__name__} {error}".split())[:300]


def _nodes(cells: meshio.CellBlock, path: Path) -> IntArray:
    try:
        nodes = np.asarray(cells.data, dtype=np.int64)
    except OverflowError:
        raise MeshError("numbers of nodes are too large", where=path.name) from None
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


# --- what meshio 5.3 would leave out in silence, or tell where nobody reads it ---

_HARMLESS = re.compile(
    r"Experimental file format|legacy format|deprecated|tag data|Appending zeros|Comment with #"
    r"|know (?:Gmf|keyword )(?:Corners|Ridges|Required\w+|Normals?\w*|Tangents?\w*|SubDomain\w+"
    r"|\w+OnGeometric\w+|Identifier|Geometry)\b"
)
"""Warnings of meshio about names, features and formats, not about nodes or elements."""


def _check_warnings(text: str, path: Path) -> None:
    """Refuses a file of which meshio has left nodes or elements out."""
    for warning in re.split(r"Warning:", " ".join(text.split()))[1:]:
        if not _HARMLESS.search(warning):
            raise MeshError(
                f"meshio leaves a part of it out: {warning.strip()[:300]}",
                where=path.name,
                expected="save the mesh in another format, for example .msh or .vtu",
            )


def _check_before(path: Path) -> None:
    """Refuses what meshio passes over in formats where it reads the first of several."""
    check = _CHECKS.get(path.suffix.lower())
    if check is not None:
        check(path)


def _check_cells(path: Path, cells: int) -> None:
    """Refuses another number of cells than a legacy VTK file states."""
    if path.suffix.lower() != ".vtk":
        return
    stated = re.search(rb"^CELL_TYPES[ \t]+(\d+)", path.read_bytes(), re.MULTILINE | re.IGNORECASE)
    if stated and int(stated[1]) != cells:
        raise MeshError(f"{cells} cells are read, CELL_TYPES states {int(stated[1])}")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line."""
    with path.open(encoding="latin-1") as file:
        for number, line in enumerate(file, start=1):
            yield number, line.strip()


def _check_cgns(path: Path) -> None:
    """Of CGNS the first zone of the first base is read, under the names that meshio gives them."""
    if not hdf5.is_hdf5(path):
        raise MeshError(
            "it is no HDF5 file", where=path.name, expected="CGNS in HDF5: adf2hdf converts ADF"
        )
    with hdf5.opened(path) as file:
        zones = [name for base in file.values() for name in _groups(base)]
        sections = _groups(file["Base/Zone1"]) if "Base/Zone1" in file else []
        elements = [name for name in sections if "ElementConnectivity" in file["Base/Zone1"][name]]
        known = "Base/Zone1/GridElements" in file
    if not known:
        raise MeshError(
            "this layout of CGNS is not read: it has no Base/Zone1/GridElements",
            where=path.name,
            expected="save the mesh in another format, for example .msh, .vtu or .exo",
        )
    if len(zones) > 1 or len(elements) > 1:
        raise MeshError(
            f"it has {len(zones)} zones with {len(elements)} sections of elements",
            where=path.name,
            expected="one zone with one section",
        )


def _groups(group: object) -> list[str]:
    import h5py

    if not isinstance(group, h5py.Group):
        return []
    return [name for name, one in group.items() if isinstance(one, h5py.Group)]


def _check_medit(path: Path) -> None:
    """Gmsh writes quadratic elements in the lines of linear ones, which meshio cannot split."""
    words = {"Triangles": 4, "Tetrahedra": 5}
    lines = (line for _, line in _lines(path) if line)
    for line in lines:
        count = next(lines, "") if line in words else ""
        first = next(lines, "").split() if count.isdecimal() and int(count) else []
        if len(first) > words.get(line, len(first)):
            raise MeshError(
                f"its {line} have {len(first) - 1} nodes each",
                where=path.name,
                expected="linear elements, or another format, for example .msh or .vtu",
            )


def _check_tecplot(path: Path) -> None:
    """Of Tecplot the first zone is read."""
    zones = [number for number, line in _lines(path) if line.upper().startswith("ZONE")]
    if len(zones) > 1:
        raise MeshError(
            "a second ZONE is not read", where=f"{path.name}:{zones[1]}", expected="one zone"
        )


def _check_su2(path: Path) -> None:
    """Of SU2 all zones are read as one with the numbers of each."""
    for number, line in _lines(path):
        key, _, value = line.partition("=")
        if key.strip().upper() == "NZONE" and value.strip() != "1":
            raise MeshError(
                "several zones are not read", where=f"{path.name}:{number}", expected="one zone"
            )


def _check_vtk(path: Path) -> None:
    """Of legacy VTK the last grid is read."""
    if path.read_bytes().upper().count(b"\nDATASET ") > 1:
        raise MeshError("it has several grids", where=path.name, expected="one DATASET")


_CHECKS: dict[str, Callable[[Path], None]] = {
    ".med": med.check,
    ".cgns": _check_cgns,
    ".mesh": _check_medit,
    ".dat": _check_tecplot,
    ".tec": _check_tecplot,
    ".su2": _check_su2,
    ".vtk": _check_vtk,
}
