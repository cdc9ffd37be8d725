"""XDMF with names: what `dolfin-elastic convert` writes, and `read_xdmf` finds in it.

The file has the mesh as a first grid, as DOLFINx reads it, with its fields, and

* regions as attributes of 0 and 1 at its cells,
* surfaces, edges and points as further grids, whose cells are their vertices, and nodes,

each marked by ``<Information Name="part" Value="region"/>``, with its name as that of the attribute
or grid; and by further elements `Information` the unit of length, notes, sets of nodes that facets
do not cover, and parts that are not whole.  All arrays are in an HDF5 file beside it.

Cells, points and fields are read in shares.  Surfaces, edges and points are known to all ranks
while a mesh is read, as they are of other formats: they are a small part of it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.etree import ElementTree

import numpy as np
from dolfinx import cpp
from dolfinx.mesh import CellType

from dolfin_elastic.core.errors import MeshError, OutputError, not_shown
from dolfin_elastic.core.files import hdf5
from dolfin_elastic.core.files.regular import fresh
from dolfin_elastic.core.files.xml import read_xml
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import Permutation, left_out, local_parts
from dolfin_elastic.mesh.fields import MeshField, distribute_rows
from dolfin_elastic.mesh.formats.raw import RawMesh

if TYPE_CHECKING:
    import h5py

_CELLS = {3: "Triangle", 6: "Triangle_6", 4: "Tetrahedron", 10: "Tetrahedron_10"}
_PARTS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle"}
_SHAPES = {1: "Scalar", 3: "Vector", 9: "Tensor"}
_UNIT = "metres per unit of length"


@dataclass(frozen=True)
class Array:
    """An array in an HDF5 file, as the text of the `.xdmf` states it.

    Attributes:
        file: The HDF5 file, relative to the folder of the `.xdmf`.
        path: Of the array in it.
        shape: Its shape.
        flat: It is stored in one dimension, row after row.
    """

    file: str
    path: str
    shape: tuple[int, ...]
    flat: bool = False

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


@dataclass(frozen=True)
class NamedPart:
    """A named part in the file.

    Attributes:
        kind: "region", "surface", "edge" or "point".
        name: As the mesh had it.
        array: Its rows: cells of the mesh, for a region; else facets, edges or nodes.
    """

    kind: str
    name: str
    array: Array


@dataclass(frozen=True)
class Names:
    """What the file says beside cells, points and fields.

    Attributes:
        parts: The named parts.
        notes: What is doubtful.
        uncovered: See `Body`.
        incomplete: See `Body`.
    """

    parts: tuple[NamedPart, ...] = ()
    notes: tuple[str, ...] = ()
    uncovered: Mapping[str, int] = field(default_factory=dict)
    incomplete: Mapping[str, str] = field(default_factory=dict)


# --- reading ---


def check_arrays(path: Path, arrays: Iterable[Array], names: Names) -> dict[Array, Array]:
    """Looks at the files of arrays, and at whether they are as the text states. Local.

    Args:
        path: The `.xdmf` file.
        arrays: All that are to be read.
        names: What the text says of parts, whose arrays are looked at where they are read.

    Returns:
        The same arrays, with `flat` as they are stored.

    Raises:
        MeshError: A file is not there, is none to be read, or an array is of another shape.
    """
    found: dict[Array, Array] = {}
    wanted = set(arrays)
    for name in sorted({array.file for array in (*wanted, *(p.array for p in names.parts))}):
        try:
            with hdf5.opened(path.parent / name) as file:
                for array in (one for one in wanted if one.file == name):
                    shape = hdf5.shape_in(file, array.path)
                    flat = shape == (math.prod(array.shape),) != array.shape
                    if not flat and (shape[0], math.prod(shape[1:])) != (array.rows, array.columns):
                        raise MeshError(
                            f"the array '{array.file}:{array.path}' has the shape {shape}, the "
                            f"text says {array.shape}",
                            expected="the .xdmf and the .h5 of the same mesh",
                        )
                    found[array] = replace(array, flat=flat)
        except OSError as error:
            raise MeshError(
                f"its data file '{name}' cannot be read: {error}",
                expected="the .h5 as it was written, without links to other files",
            ) from None
    return found


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


def _count(name: str, text: str) -> int:
    """Number of nodes of a set that facets do not cover. Local."""
    if not text.strip().isdecimal():
        raise MeshError(
            f"facets do not cover '{text}' nodes of '{name}'", expected="a whole number of nodes"
        )
    return int(text)


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
        file: The `.xdmf` file.
        stop: The row after the last one; None: all of them.

    Returns:
        Shape (stop - start, columns).

    Raises:
        OSError: It cannot be read.
    """
    count, columns = array.rows, array.columns
    stop = count if stop is None else stop
    flat = columns if array.flat else 1
    found = hdf5.read_rows(
        file.parent / array.file, array.path, start * flat, stop * flat, checked=True
    )
    return found.reshape(stop - start, columns)


def distributed(
    body: Body,
    centre: Literal["cell", "point"],
    file: Path,
    array: Array,
    unused: IntArray | None = None,
) -> MeshField:
    """A field whose rows rank 0 reads in pieces. Collective.

    Args:
        body: Read from the same file.
        file: The `.xdmf` file.
        unused: Rows of the file that the mesh is without, sorted; None: it has all of them.

    Raises:
        MeshError: It cannot be read, or has another number of rows.
    """
    kept = None
    if unused is not None and len(unused):
        kept = np.setdiff1d(np.arange(array.rows), unused)

    def read(start: int, stop: int) -> FloatArray:
        """Some rows, of shape (stop - start, columns).

        Args:
            stop: The row after the last one.
        """
        if kept is None:
            return np.asarray(hdf_rows(file, array, start, stop), dtype=np.float64)
        rows = kept[start:stop]
        found = hdf_rows(file, array, int(rows[0]), int(rows[-1]) + 1)
        return np.asarray(found[rows - rows[0]], dtype=np.float64)

    shape = array.rows if kept is None else len(kept), array.columns
    return distribute_rows(body.mesh, centre, shape, read if body.comm.rank == 0 else None)


def kind_of(element: ElementTree.Element) -> str:
    """Kind of the part that a grid or an attribute is; empty: it is none."""
    return next((value for name, value, _ in _information(element) if name == "part"), "")


def names_in(root: ElementTree.Element) -> Names:
    """What a file says of its parts. Local."""
    grids = [grid for grid in root.iter("Grid") if grid.find("Topology") is not None]
    if not grids:
        return Names()
    main = grids[0]
    found = [*main.findall("Attribute"), *grids[1:]]
    parts = [_part(kind, one) for one in found if (kind := kind_of(one))]
    said = [*_information(main)]
    return Names(
        tuple(parts),
        tuple(value for name, value, _ in said if name == "note"),
        {value: _count(value, text) for name, value, text in said if name == "uncovered"},
        {value: text for name, value, text in said if name == "incomplete"},
    )


def unit_of_xdmf(path: Path) -> LengthUnit | None:
    """The unit of length that a converted mesh states. Local; None where it states none.

    Raises:
        MeshError: It is no length.
    """
    try:
        for element in read_xml(path).iter("Information"):
            if element.get("Name") == _UNIT:
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


def named(body: Body, path: Path, names: Names) -> Body:
    """The body with the parts that its file names. Collective.

    Args:
        body: Read from the file.
        path: The `.xdmf` file.
    """
    if names == Names():
        return body
    count, dim = body.mesh.geometry.index_map().size_global, body.dim
    tables = on_root(body.comm, lambda: _tables(path, names.parts, count, dim))
    surfaces, edges, points, lost = local_parts(
        body.mesh, tables["surface"], tables["edge"], tables["point"]
    )
    incomplete = {**lost, **names.incomplete}
    regions = {part.name: _region(body, path, part) for part in names.parts if _is_region(part)}
    whole = [
        {name: rows for name, rows in parts.items() if name not in incomplete}
        for parts in (regions, surfaces, edges, points)
    ]
    body = body.named(regions=whole[0], surfaces=whole[1], edges=whole[2], points=whole[3])
    return replace(
        body,
        uncovered=names.uncovered,
        incomplete=incomplete,
        notes=(*body.notes, *names.notes, *left_out(incomplete)),
    )


def _is_region(part: NamedPart) -> bool:
    return part.kind == "region"


def _information(element: ElementTree.Element) -> Iterator[tuple[str, str, str]]:
    """Name, value and text of what is said of a grid or an attribute."""
    for one in element.findall("Information"):
        yield one.get("Name", ""), one.get("Value", ""), one.text or ""


def _part(kind: str, element: ElementTree.Element) -> NamedPart:
    item = element.find("DataItem" if kind == "region" else "Topology/DataItem")
    if item is None or not item.text:
        raise MeshError(f"the {kind} '{element.get('Name')}' has no array")
    return NamedPart(kind, element.get("Name", ""), Array.of(item))


def _tables(
    path: Path, parts: tuple[NamedPart, ...], points: int, dim: int
) -> dict[str, dict[str, IntArray]]:
    """Kind and name to vertices, or nodes, by their rows in the file. On rank 0.

    Args:
        path: The `.xdmf` file.
    """
    widths = {"surface": dim, "edge": 2, "point": 1}
    found: dict[str, dict[str, IntArray]] = {kind: {} for kind in widths}
    for part in parts:
        if _is_region(part):
            continue
        if part.kind not in widths:
            known = ", ".join(("region", *widths))
            raise MeshError(f"'{part.name}' is a part of kind '{part.kind}'", expected=known)
        try:
            rows = hdf5.read_rows(path.parent / part.array.file, part.array.path, checked=True)
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise MeshError(f"the {part.kind} '{part.name}' cannot be read: {error}") from None
        if rows.dtype.kind not in "iu" or rows.shape != (part.array.rows, widths[part.kind]):
            raise MeshError(
                f"the array of the {part.kind} '{part.name}' has the shape {rows.shape} and the "
                f"type {rows.dtype}",
                expected=f"({part.array.rows}, {widths[part.kind]}) and integers",
            )
        if rows.size and not 0 <= rows.min() <= rows.max() < points:
            raise MeshError(
                f"the {part.kind} '{part.name}' has points that do not exist",
                expected=f"numbers from 0 to {points - 1}",
            )
        rows = rows.astype(np.int64)
        found[part.kind][part.name] = rows[:, 0] if part.kind == "point" else rows
    return found


def _region(body: Body, path: Path, part: NamedPart) -> AnyArray:
    """Local cells of a region, read on rank 0 in pieces. Collective."""
    try:
        marks = distributed(body, "cell", path, part.array)
    except MeshError as error:
        raise MeshError(f"the region '{part.name}': {error}") from None
    return np.flatnonzero(marks.values[:, 0]).astype(np.int32)


# --- writing ---


def write_named(
    raw: RawMesh, path: Path, unit: LengthUnit | None, permutation: Permutation
) -> None:
    """Writes a mesh with its names. Local: one rank writes.

    Args:
        path: The `.xdmf` file; its arrays go into a file `.h5` beside it.
        unit: Unit of length that its own file states, or None.
        permutation: The node order of its quadratic cells: `cpp.io.perm_vtk` or `perm_gmsh`.

    Raises:
        OutputError: A file cannot be written.
    """
    import h5py

    data = path.with_suffix(".h5")
    drafts = {one: one.with_name(f".{one.name}.part") for one in (data, path)}
    try:
        with h5py.File(fresh(drafts[data]), "w") as file:
            tree = _Writer(file, data.name).document(raw, unit, permutation)
        fresh(drafts[path]).write_bytes(ElementTree.tostring(tree, "utf-8", xml_declaration=True))
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
    """Writes arrays into an HDF5 file, and makes the XML that refers to them.

    Args:
        name: Of the file.
    """

    def __init__(self, file: h5py.File, name: str) -> None:
        self._file, self._name = file, name

    def document(
        self, raw: RawMesh, unit: LengthUnit | None, permutation: Permutation
    ) -> ElementTree.Element:
        """The whole document; see `write_named` for the arguments."""
        root = ElementTree.Element("Xdmf", Version="3.0")
        domain = ElementTree.SubElement(root, "Domain")
        main = self._mesh(domain, raw, permutation)
        if unit is not None:
            _say(main, _UNIT, repr(unit.metres))
        for note in raw.notes:
            _say(main, "note", note)
        for name, count in raw.uncovered.items():
            _say(main, "uncovered", name, str(count))
        for name, reason in raw.incomplete.items():
            _say(main, "incomplete", name, reason)
        for centre, tables in (("Cell", raw.cell_data), ("Node", raw.point_data)):
            for k, (name, table) in enumerate(tables.items()):
                self._attribute(main, name, centre, f"{centre.lower()}_data_{k}", table)
        for k, (name, cells) in enumerate(raw.regions.items()):
            marks = np.zeros((len(raw.cells), 1), dtype=np.uint8)
            marks[cells] = 1
            _say(self._attribute(main, name, "Cell", f"region_{k}", marks), "part", "region")
        parts = {"surface": raw.surfaces, "edge": raw.edges, "point": raw.nodes}
        for kind, named_parts in parts.items():
            for k, (name, rows) in enumerate(named_parts.items()):
                self._grid(domain, kind, name, f"{kind}_{k}", rows.reshape(len(rows), -1))
        return root

    def _mesh(
        self, domain: ElementTree.Element, raw: RawMesh, permutation: Permutation
    ) -> ElementTree.Element:
        width = raw.cells.shape[1]
        kind = CellType.tetrahedron if raw.dim == 3 else CellType.triangle
        # From the file's order to DOLFINx's, and from there to that of VTK, which XDMF has.
        order = np.asarray(permutation(kind, width))[np.argsort(cpp.io.perm_vtk(kind, width))]
        grid = _grid(domain, "mesh")
        self._topology(grid, _CELLS[width], "cells", raw.cells[:, order])
        geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ"[: raw.dim])
        self._item(geometry, "points", raw.points)
        return grid

    def _grid(
        self, domain: ElementTree.Element, kind: str, name: str, path: str, rows: IntArray
    ) -> None:
        """Adds a surface, edge or point.

        Args:
            rows: Vertices, or nodes, by their rows in `points`, shape (n, 1 to 3).
        """
        grid = _grid(domain, name)
        _say(grid, "part", kind)
        self._topology(grid, _PARTS[rows.shape[1]], path, rows)
        points = self._file["points"]
        geometry = ElementTree.SubElement(
            grid, "Geometry", GeometryType="XYZ"[: int(points.shape[1])]
        )
        self._refer(geometry, "points")
        # For DOLFINx, whose `read_meshtags` asks for values.
        self._attribute(grid, name, "Cell", f"{path}_values", np.ones((len(rows), 1), np.int32))

    def _topology(self, grid: ElementTree.Element, kind: str, path: str, rows: AnyArray) -> None:
        count, width = rows.shape
        topology = ElementTree.SubElement(
            grid,
            "Topology",
            TopologyType=kind,
            NumberOfElements=str(count),
            NodesPerElement=str(width),
        )
        self._item(topology, path, np.asarray(rows, dtype=np.int64))

    def _attribute(
        self, grid: ElementTree.Element, name: str, centre: str, path: str, values: AnyArray
    ) -> ElementTree.Element:
        shape = _SHAPES.get(values.shape[1], "Matrix")
        found = ElementTree.SubElement(
            grid, "Attribute", Name=name, AttributeType=shape, Center=centre
        )
        self._item(found, path, values)
        return found

    def _item(self, parent: ElementTree.Element, path: str, values: AnyArray) -> None:
        self._file.create_dataset(path, data=np.ascontiguousarray(values))
        self._refer(parent, path)

    def _refer(self, parent: ElementTree.Element, path: str) -> None:
        values = self._file[path]
        kind = {"f": "Float", "i": "Int", "u": "UChar"}[values.dtype.kind]
        item = ElementTree.SubElement(
            parent,
            "DataItem",
            Dimensions=" ".join(str(n) for n in values.shape),
            NumberType=kind,
            Precision=str(values.dtype.itemsize),
            Format="HDF",
        )
        item.text = f"{self._name}:/{path}"


def _grid(domain: ElementTree.Element, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(domain, "Grid", Name=name, GridType="Uniform")


def _say(element: ElementTree.Element, name: str, value: str, text: str = "") -> None:
    """Adds what is said of a grid or an attribute."""
    ElementTree.SubElement(element, "Information", Name=name, Value=value).text = text or None
