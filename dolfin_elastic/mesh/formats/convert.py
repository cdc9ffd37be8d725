"""From a format that one rank reads to XDMF, which all ranks read in parallel."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from dolfinx import cpp
from dolfinx.mesh import CellType
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError, OutputError
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.distribute import Permutation, is_cad
from dolfin_elastic.mesh.formats.cad.process import Permission
from dolfin_elastic.mesh.formats.cleaning import clean
from dolfin_elastic.mesh.formats.raw import MeshFile, RawMesh, assemble
from dolfin_elastic.mesh.formats.surfaces.options import is_surface
from dolfin_elastic.mesh.formats.xdmf import PARTS, is_shared
from dolfin_elastic.mesh.formats.xdmf_arrays import UNIT
from dolfin_elastic.mesh.read import XDMF, check_file, reader, stated_unit_of

if TYPE_CHECKING:
    import h5py

_CELLS = {3: "Triangle", 6: "Triangle_6", 4: "Tetrahedron", 10: "Tetrahedron_10"}
_FACETS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle"}
_SHAPES = {1: "Scalar", 3: "Vector", 9: "Tensor"}
_NUMBERS = {"f": "Float", "i": "Int", "u": "UChar"}


@dataclass(frozen=True)
class Conversion:
    """What was written.

    Attributes:
        cells: Number of cells.
        points: Number of points.
        parts: Kind of part to the names, of those that there are.
        fields: Names of the fields.
        notes: Faults of the old file that are corrected in the new one, and what is doubtful.
        unit: Unit of length that the old file stated; empty: none.
    """

    cells: int
    points: int
    parts: dict[str, list[str]]
    fields: list[str]
    notes: tuple[str, ...]
    unit: str


def convert_mesh(
    path: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    force: bool = False,
) -> Conversion:
    """Writes a mesh as XDMF that all ranks read in shares, with names, fields and unit.

    Rank 0 reads and writes, the others wait.  Collective.  What is corrected when a mesh is read
    is corrected in the new file; numbers stay in the unit of the old one.

    Args:
        path: A finished mesh of any format of `read_body`.
        target: The .xdmf file; its arrays go into a .h5 file beside it.

    Raises:
        MeshError: It is no finished mesh, cannot be read, or is not fit for use; or the target
            exists, or is no .xdmf file.
        OutputError: The new files cannot be written.
    """
    return on_root(comm, lambda: _converted(Path(path), Path(target), force=force))


def _converted(path: Path, target: Path, *, force: bool) -> Conversion:
    check_file(path)
    _check_target(path, target, force=force)
    read, permutation = reader(path, _no_cad, Permission())
    try:
        mesh = clean(assemble(read(), source=path.name))
    except MeshError as error:
        raise error if error.where else error.at(path.name) from None
    # What is still doubtful in the corrected mesh is said whenever that is read.
    lasting = clean(replace(mesh, notes=(), information=()))
    unit = stated_unit_of(path)
    _write(lasting, target, unit, permutation)
    return _conversion(mesh, unit.name if unit else "")


def _conversion(raw: RawMesh, unit: str) -> Conversion:
    kinds = dict(zip(PARTS, (raw.regions, raw.surfaces, raw.edges, raw.nodes), strict=True))
    return Conversion(
        len(raw.cells),
        len(raw.points),
        {kind: list(parts) for kind, parts in kinds.items() if parts},
        [*raw.cell_data, *raw.point_data],
        (*raw.notes, *raw.information),
        unit,
    )


def _no_cad() -> MeshFile:
    raise AssertionError("no CAD file gets here")


def _check_target(path: Path, target: Path, *, force: bool) -> None:
    """Refuses what is no finished mesh, or need not be converted, and files that exist."""
    if is_surface(path):
        raise MeshError(
            "a surface of triangles has no mesh yet",
            where=str(path),
            expected="[mesh] file = ... fills it; gmsh -3 meshes what it can read",
        )
    if is_cad(path):
        raise MeshError(
            "a CAD file has no mesh yet",
            where=str(path),
            expected=f"mesh it first, for example: gmsh -3 {path.name} -o {path.stem}.msh",
        )
    if target.suffix.lower() not in XDMF:
        raise MeshError(
            f"'{target}' is no .xdmf file",
            where="TARGET",
            expected=f"for example '{target.with_suffix('.xdmf').name}': the format that all ranks "
            "read in parallel",
        )
    if not target.parent.is_dir():
        raise MeshError(
            f"there is no folder '{target.parent}'", where="TARGET", expected="make it first"
        )
    files = (target, target.with_suffix(".h5"))
    if path.resolve() in [one.resolve() for one in files]:
        raise MeshError("this is the mesh itself", where=str(target), expected="another name")
    if path.suffix.lower() in XDMF and is_shared(path, None):
        raise MeshError(
            "all ranks already read this file in parallel", where=str(path), expected="use it"
        )
    there = [str(one) for one in files if one.exists()]
    if there and not force:
        raise MeshError(
            "this file exists already",
            where=there[0],
            expected="choose another name, or --force to overwrite it",
        )


# --- writing ---


def _write(raw: RawMesh, path: Path, unit: LengthUnit | None, permutation: Permutation) -> None:
    """Writes a mesh with its names and unit, see `formats/xdmf.py`. Local: one rank writes."""
    import h5py

    data = path.with_suffix(".h5")
    drafts = {one: one.with_name(f".{one.name}.part") for one in (data, path)}
    try:
        with h5py.File(fresh(drafts[data]), "w") as file:
            tree = _Writer(file, data.name, raw).document(raw, unit, permutation)
        fresh(drafts[path]).write_bytes(tostring(tree, "utf-8", xml_declaration=True))
        for final, draft in drafts.items():
            draft.replace(final)
    except (OSError, RuntimeError) as error:
        number = error.errno if isinstance(error, OSError) else None
        text = os.strerror(number).lower() if number else str(error)
        raise OutputError(f"cannot write {path}: {text}") from None
    finally:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)


class _Writer:
    """Writes arrays into an HDF5 file, and makes the XML that refers to them."""

    def __init__(self, file: h5py.File, name: str, raw: RawMesh) -> None:
        self._file, self._name, self._axes = file, name, "XYZ"[: raw.dim]
        self._root = Element("Xdmf", Version="3.0")
        self._domain = SubElement(self._root, "Domain")
        file.create_dataset("points", data=raw.points)

    def document(self, raw: RawMesh, unit: LengthUnit | None, permutation: Permutation) -> Element:
        """The whole document; see `_write` for the arguments."""
        width = raw.cells.shape[1]
        kind = CellType.tetrahedron if raw.dim == 3 else CellType.triangle
        # From the file's order to DOLFINx's, and from there to that of VTK, which XDMF has.
        order = np.asarray(permutation(kind, width))[np.argsort(cpp.io.perm_vtk(kind, width))]
        main = self._grid("mesh", _CELLS[width], "cells", raw.cells[:, order])
        said = [(UNIT, repr(unit.metres), "")] if unit is not None else []
        said += [("note", note, "") for note in raw.notes]
        said += [("uncovered", name, str(count)) for name, count in raw.uncovered.items()]
        said += [("incomplete", name, reason) for name, reason in raw.incomplete.items()]
        for one in said:
            _say(main, *one)
        for centre, tables in (("Cell", raw.cell_data), ("Node", raw.point_data)):
            for k, (name, table) in enumerate(tables.items()):
                self._attribute(main, name, centre, f"{centre.lower()}_data_{k}", table)
        for k, (name, cells) in enumerate(raw.regions.items()):
            marks = np.zeros((len(raw.cells), 1), dtype=np.uint8)
            marks[cells] = 1
            _say(self._attribute(main, name, "Cell", f"region_{k}", marks), "part", "region")
        for part, parts in zip(PARTS[1:], (raw.surfaces, raw.edges, raw.nodes), strict=True):
            full = {name: members for name, members in parts.items() if len(members)}
            for k, (name, members) in enumerate(full.items()):
                rows = np.unique(np.sort(members.reshape(len(members), -1), axis=1), axis=0)
                grid = self._grid(name, _FACETS[rows.shape[1]], f"{part}_{k}", rows)
                _say(grid, "part", part)
                ones = np.ones((len(rows), 1), np.int32)
                self._attribute(grid, name, "Cell", f"{part}_{k}_values", ones)
        return self._root

    def _grid(self, name: str, kind: str, path: str, rows: AnyArray) -> Element:
        grid = SubElement(self._domain, "Grid", Name=name, GridType="Uniform")
        count, width = map(str, rows.shape)
        topology = SubElement(
            grid, "Topology", TopologyType=kind, NumberOfElements=count, NodesPerElement=width
        )
        self._file.create_dataset(path, data=np.ascontiguousarray(rows, dtype=np.int64))
        self._refer(topology, path)
        self._refer(SubElement(grid, "Geometry", GeometryType=self._axes), "points")
        return grid

    def _attribute(
        self, grid: Element, name: str, centre: str, path: str, values: AnyArray
    ) -> Element:
        shape = _SHAPES.get(values.shape[1], "Matrix")
        element = SubElement(grid, "Attribute", Name=name, AttributeType=shape, Center=centre)
        self._file.create_dataset(path, data=values)
        self._refer(element, path)
        return element

    def _refer(self, parent: Element, path: str) -> None:
        values = self._file[path]
        item = SubElement(
            parent,
            "DataItem",
            Dimensions=" ".join(map(str, values.shape)),
            NumberType=_NUMBERS[values.dtype.kind],
            Precision=str(values.dtype.itemsize),
            Format="HDF",
        )
        item.text = f"{self._name}:/{path}"


def _say(element: Element, name: str, value: str, text: str = "") -> None:
    """Adds what is said of a grid or an attribute."""
    SubElement(element, "Information", Name=name, Value=value).text = text or None
