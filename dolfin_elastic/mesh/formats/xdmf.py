"""XDMF: read in parts by all ranks, with the tags that DOLFINx, meshio and `convert` put beside.

Tags are integers of the cells of a grid: of the mesh itself, or of facets, edges and points.  Those
of value v of a tag `part` are the part ``part_v``, unless the grid or the tag is marked by
``<Information Name="part" Value="surface"/>``, as `dolfin-elastic convert` writes them: then those
of value 1 are the part of that very name.  Further elements `Information` of the first grid hold
the unit of length, notes, sets of nodes that facets do not cover, and parts that are not whole.

Read here rather than by DOLFINx 0.9, which takes the arrays from the file that has the name of the
`.xdmf`, whatever file the text names, and of several data of a grid always the first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from dolfinx import cpp, graph, la
from dolfinx.io import distribute_entity_data
from dolfinx.mesh import CellType, Mesh, meshtags_from_entities
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files.xml import read_xml
from dolfin_elastic.core.parallel import agree, first_row, on_root, total
from dolfin_elastic.core.types import AnyArray, BoolArray, IndexArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import build_body, left_out, make_mesh
from dolfin_elastic.mesh.formats.cleaning import (
    check_distributed,
    straight,
    unused_points,
    unused_text,
    without,
)
from dolfin_elastic.mesh.formats.raw import RawMesh, assemble, check_step, is_step
from dolfin_elastic.mesh.formats.xdmf_arrays import (
    Array,
    check_arrays,
    data_files,
    dimensions,
    distributed,
    hdf_rows,
    is_flat,
    refers_to,
    same_points,
    time_of,
)
from dolfin_elastic.mesh.geometry.simplices import prepare_edges

_KINDS = {
    "tetrahedron": (CellType.tetrahedron, 4),
    "tetrahedron_10": (CellType.tetrahedron, 10),
    "tet_10": (CellType.tetrahedron, 10),
    "triangle": (CellType.triangle, 3),
    "triangle_6": (CellType.triangle, 6),
    "tri_6": (CellType.triangle, 6),
    "polyline": (CellType.interval, 2),
    "edge_3": (CellType.interval, 3),
    "polyvertex": (CellType.point, 1),
}
"""Shape of the cells of a topology, and number of their nodes."""
_DIMS = {
    name: {CellType.tetrahedron: 3, CellType.triangle: 2, CellType.interval: 1}.get(kind, 0)
    for name, (kind, _) in _KINDS.items()
}
PARTS = ("region", "surface", "edge", "point")
_NOWHERE = Array("", "", (0,))
_MOST = 200  # more distinct values than this are data, not names


@dataclass(frozen=True)
class _Tags:
    """Integer data of the cells of one grid.

    Attributes:
        attribute: Name of the data.
        kind: Of the cells.
        cells: Nodes of each cell.
        values: One number for each cell.
        named: The cells of value 1 are a part of that name.
    """

    attribute: str
    kind: str
    cells: Array
    values: Array
    named: bool = False

    @property
    def dim(self) -> int:
        """Of the cells."""
        return _DIMS[self.kind]

    def name_of(self, value: int) -> str:
        """Of the part whose cells have a value."""
        return self.attribute if self.named else f"{self.attribute}_{value}"


@dataclass(frozen=True)
class _Data:
    """Numbers of cells or points in an HDF5 file."""

    name: str
    centre: Literal["cell", "point"]
    array: Array


@dataclass(frozen=True)
class _Contents:
    """Content of the file, without its arrays.

    Attributes:
        kind: Of the cells; empty if the file is not of those that ranks read in shares: then
            meshio must.
        cells: Nodes of each cell.
        points: Coordinates of the points, in the file's unit.
        tags: Integer data of cells and of facets, edges and points.
        data: Fields.
        notes: How it was read, and what is doubtful.
        uncovered: See `Body`.
        incomplete: See `Body`.
        flat: Points of plane cells have a third coordinate, which is 0.
    """

    kind: str = ""
    cells: Array = _NOWHERE
    points: Array = _NOWHERE
    tags: tuple[_Tags, ...] = ()
    data: tuple[_Data, ...] = ()
    notes: tuple[str, ...] = ()
    uncovered: Mapping[str, int] = field(default_factory=dict)
    incomplete: Mapping[str, str] = field(default_factory=dict)
    flat: bool = False

    @property
    def dim(self) -> int:
        """Of the cells."""
        return _DIMS[self.kind]

    @property
    def order(self) -> int:
        """Geometric degree of the cells, 0 where it is not known."""
        return (2 if self.kind.endswith(("_6", "_10")) else 1) if self.kind else 0

    def shared(self, dim: int | None) -> bool:
        """Whether all ranks read the file in shares.

        Args:
            dim: See `read_xdmf`.
        """
        if not self.kind or self.dim != (dim or self.dim):
            return False
        return self.flat or self.points.columns == self.dim

    def arrays(self) -> list[Array]:
        """All arrays that are read."""
        return [
            self.cells,
            self.points,
            *(array for tags in self.tags for array in (tags.cells, tags.values)),
            *(data.array for data in self.data),
        ]


def read_xdmf(
    path: Path,
    *,
    comm: MPI.Comm,
    unit: LengthUnit,
    dim: int | None,
    straight_cells: bool = False,
    time: float | None = None,
) -> Body:
    """Reads a mesh and its tags. Collective.

    Args:
        path: The .xdmf file, with its .h5 beside it.
        unit: Unit of length of the file.
        dim: 2 or 3 to choose the elements; by default the highest dimension.
        straight_cells: Quadratic cells are read as straight ones, on one rank.
        time: Of fields at several time steps, which one; None: the last.

    Raises:
        MeshError: The file cannot be read.
    """
    contents = on_root(comm, lambda: _contents(path, time))
    if straight_cells and contents.order != 1:
        return build_body(lambda: _straight(path, dim), comm=comm, unit=unit, source=path.name)
    if not contents.shared(dim):
        if time is not None:
            raise MeshError(
                "its fields are not read at a time",
                where=path.name,
                expected="time left out; or arrays in HDF5, and plane points with two coordinates",
            )
        return build_body(lambda: _by_meshio(path, dim), comm=comm, unit=unit, source=path.name)
    try:
        mesh, unused = _mesh(comm, path, contents, unit.metres)
        body = Body(
            mesh,
            source=path.name,
            unit=unit,
            notes=contents.notes,
            uncovered=contents.uncovered,
            incomplete=contents.incomplete,
        )
        if len(unused):
            said = unused_text(len(unused), contents.points.rows)
            body = replace(body, information=(*body.information, said))
        body = _tagged(body, path, contents, unused)
        fields = {}
        for data in contents.data:
            what, left = f"the field '{data.name}'", unused if data.centre == "point" else None
            fields[data.name] = distributed(body, data.centre, path, data.array, what, left)
        return replace(body, fields=fields)
    except MeshError as error:
        raise error.at(path.name) from None


def _mesh(comm: MPI.Comm, path: Path, contents: _Contents, scale: float) -> tuple[Mesh, IntArray]:
    """The mesh, and the points of the file that it is without. Collective."""
    width = _KINDS[contents.kind][1]
    cells = _cells(comm, path, contents.kind, contents.cells)
    share = _share(comm, path, contents.points)[:, : contents.dim]
    x = np.ascontiguousarray(share, dtype=np.float64)
    order = 1 if width == contents.dim + 1 else 2
    check_distributed(comm, cells, len(x), contents.dim)
    unused = unused_points(comm, cells, len(x))
    first = first_row(comm, contents.points.rows)
    x = x[~np.isin(np.arange(first, first + len(x)), unused)]
    bad = int(np.count_nonzero(~np.isfinite(x).all(axis=1)))
    if count := int(total(comm, bad)):
        raise MeshError(f"{count} points have coordinates that are not numbers")
    return make_mesh(comm, without(cells, unused), x * scale, order), unused


def _cells(comm: MPI.Comm, path: Path, kind: str, cells: Array) -> IntArray:
    """This rank's share of the cells of a grid, in DOLFINx's node order. Collective."""
    rows = _share(comm, path, cells)
    if rows.dtype.kind not in "iu":
        raise MeshError(f"the cells in '{cells.file}:{cells.path}' are no whole numbers")
    order = cpp.io.perm_vtk(*_KINDS[kind]) if _DIMS[kind] > 1 else slice(None)
    return np.ascontiguousarray(rows[:, order], dtype=np.int64)


def _share(comm: MPI.Comm, path: Path, array: Array) -> AnyArray:
    """This rank's share of the rows of an array, as DOLFINx divides them. Collective."""
    start, stop = (first_row(comm, array.rows, rank) for rank in (comm.rank, comm.rank + 1))
    rows: AnyArray = np.empty((0, array.columns))
    error = None
    try:
        rows = hdf_rows(path, array, start, stop)
    except OSError as caught:
        error = MeshError(f"the array '{array.file}:{array.path}' cannot be read: {caught}")
    agree(comm, error)
    return rows


def _contents(path: Path, time: float | None = None) -> _Contents:
    try:
        result = _in(read_xml(path), path, time)
        if result.kind:
            check_arrays(path, result.arrays())
            plane = result.dim == 2 and result.points.columns == 3
            return replace(result, flat=plane and is_flat(path, result.points))
        return result
    except ElementTree.ParseError as error:
        raise MeshError(f"this is no XML file: {error}", where=path.name) from None
    except OSError as error:
        raise MeshError(f"cannot be read: {error}", where=path.name) from None
    except MeshError as error:
        raise error if error.where else error.at(path.name) from None


def _in(root: ElementTree.Element, path: Path, time: float | None) -> _Contents:
    grids = [
        g
        for g in root.iter("Grid")
        if g.get("GridType", "Uniform") == "Uniform" and g.find("Topology") is not None
    ]
    if not grids:
        raise MeshError("there is no mesh (no Grid with a Topology)", where=path.name)
    data_files(path, root)
    main = grids[0]
    kind = _kind(main)
    notes = _others(root, main, grids[1:])
    for topology in root.iter("Topology"):
        for key in ("BaseOffset", "Order"):
            if topology.get(key, "0").strip() != "0":
                raise MeshError(
                    f"a Topology with {key} = '{topology.get(key)}' is not understood",
                    expected="nodes numbered from 0, in XDMF's own order",
                )
    cells, points = main.find("Topology/DataItem"), main.find("Geometry/DataItem")
    plain = all(item.get("Format") == "HDF" for item in root.iter("DataItem"))
    if kind not in _DIMS or not plain or cells is None or points is None or not _width(main):
        return _Contents()
    small = [g for g in grids[1:] if _DIMS.get(_kind(g), 4) <= _DIMS[kind]]
    tags = [*_tags(main), *(t for g in small for t in _tags_on(path, main, g))]
    steps = [g for g in root.iter("Grid") if _is_step(main, g)]
    check_step(time, map(time_of, [main, *steps]))
    data = _data(main, [g for g in [main, *steps] if is_step(time_of(g), time)])
    contents = _topology(kind, cells)
    said = [*_information(main)]
    return _Contents(
        kind,
        contents,
        Array.of(points),
        tuple(tags),
        tuple(data),
        (*notes, *(value for name, value, _ in said if name == "note")),
        {value: _count(value, text) for name, value, text in said if name == "uncovered"},
        {value: text for name, value, text in said if name == "incomplete"},
    )


def _is_step(main: ElementTree.Element, grid: ElementTree.Element) -> bool:
    """Whether a grid has functions on the main one, at a time of its own."""
    if grid.find("Topology") is None:
        return refers_to(main, grid)
    same = all(_texts(grid, part) == _texts(main, part) for part in ("Topology", "Geometry"))
    return grid is not main and same and grid.find("Time") is not None


def _information(element: ElementTree.Element) -> Iterator[tuple[str, str, str]]:
    """Name, value and text of what is said of a grid or an attribute."""
    for one in element.findall("Information"):
        yield one.get("Name", ""), one.get("Value", ""), one.text or ""


def _is_named(element: ElementTree.Element) -> bool:
    """Whether a grid or an attribute is a part with a name."""
    for key, kind, _ in _information(element):
        if key == "part" and kind not in PARTS:
            raise MeshError(
                f"'{element.get('Name')}' is a part of kind '{kind}'", expected=", ".join(PARTS)
            )
        if key == "part":
            return True
    return False


def _count(name: str, text: str) -> int:
    """Number of nodes of a set that facets do not cover."""
    if not text.strip().isdecimal():
        raise MeshError(
            f"facets do not cover '{text}' nodes of '{name}'", expected="a whole number of nodes"
        )
    return int(text)


def _topology(kind: str, item: ElementTree.Element) -> Array:
    """The nodes of the cells of a grid, as many to a cell as its kind has."""
    array, width = Array.of(item), _KINDS[kind][1]
    if len(array.shape) == 1 and array.rows % width == 0:
        array = replace(array, shape=(array.rows // width, width))
    if array.columns != width:
        raise MeshError(
            f"cells of the kind {kind} have {width} nodes, not {array.columns} as in "
            f"'{array.file}:{array.path}'"
        )
    return array


def _others(
    root: ElementTree.Element, main: ElementTree.Element, others: list[ElementTree.Element]
) -> list[str]:
    """Notes on grids with cells that are not read; refuses further parts of the body."""
    blocks = {
        grid
        for collection in root.iter("Grid")
        if collection.get("CollectionType", "").lower() == "spatial"
        or collection.get("GridType", "").lower() == "tree"
        for grid in collection.iter("Grid")
    }
    left = []
    for grid in others:
        same = _texts(grid, "Geometry") in (_texts(main, "Geometry"), [])
        if same and _is_part(main, grid):
            continue
        if main in blocks or same:
            raise MeshError(
                f"the cells of the grid '{grid.get('Name', '')}' are beside those of "
                f"'{main.get('Name', '')}'",
                expected="one grid with all cells (in ParaView: Merge Blocks)",
            )
        left.append(grid.get("Name", ""))
    names = ", ".join(dict.fromkeys(left))
    return [f"of {1 + len(left)} meshes in the file the first is read, not {names}"] if left else []


def _is_part(main: ElementTree.Element, grid: ElementTree.Element) -> bool:
    """Whether a grid has cells of the main one, or facets, edges and points of it."""
    here, dim = _DIMS.get(_kind(grid), 3), _DIMS.get(_kind(main), 3)
    alike = bool(_tags(grid)) or _texts(grid, "Topology") == _texts(main, "Topology")
    return here < dim or (here == dim and alike)


def _texts(grid: ElementTree.Element, part: str) -> list[str]:
    """Where the arrays of a grid are."""
    return ["".join((item.text or "").split()) for item in grid.findall(f"{part}/DataItem")]


def is_shared(path: Path, dim: int | None) -> bool:
    """Whether all ranks read a file in shares. Local.

    Args:
        dim: See `read_xdmf`.
    """
    return _contents(path).shared(dim)


def _tags(grid: ElementTree.Element) -> list[_Tags]:
    """Cell data of a grid that may be integers; DOLFINx writes tags without a number type."""
    result: list[_Tags] = []
    cells = grid.find("Topology/DataItem")
    for attribute in grid.findall("Attribute"):
        item = attribute.find("DataItem")
        if item is None or cells is None or _kind(grid) not in _DIMS:
            continue
        kind = item.get("NumberType", item.get("DataType", "Int"))
        if attribute.get("Center") == "Cell" and kind in ("Int", "UInt", "Char", "UChar"):
            topology = _topology(_kind(grid), cells)
            values = Array.of(item)
            if values.shape not in ((topology.rows,), (topology.rows, 1)):
                continue
            name, named = attribute.get("Name", ""), _is_named(grid) or _is_named(attribute)
            result.append(_Tags(name, _kind(grid), topology, values, named))
    return result


def _tags_on(path: Path, main: ElementTree.Element, grid: ElementTree.Element) -> list[_Tags]:
    """Tags of a further grid; none of the cells of another mesh, which a note says is not read.

    Raises:
        MeshError: They are of facets, edges or points of another mesh.
    """
    tags, item = _tags(grid), grid.find("Geometry/DataItem")
    if not tags or (refers_to(main, grid) if item is None else same_points(path, main, item)):
        return tags
    if item is not None and _DIMS[_kind(grid)] == _DIMS[_kind(main)]:
        return []
    raise MeshError(
        f"the tags '{tags[0].attribute}' are those of another mesh than "
        f"'{main.get('Name', '')}', which is read",
        expected="a file of one mesh and its tags",
    )


def _data(main: ElementTree.Element, grids: list[ElementTree.Element]) -> list[_Data]:
    """Fields of the mesh's grid and of functions on it; of several time steps the last."""
    result: dict[str, _Data] = {}
    counts = {"cell": _rows(main, "Topology"), "point": _rows(main, "Geometry")}
    for grid in grids:
        for attribute in grid.findall("Attribute"):
            # Without a type it is a float in XDMF; but of a mesh's own grid, DOLFINx's tags.
            data = _one(attribute, "Int" if grid is main else "Float")
            if data is None or (grid is not main and data.array.rows != counts[data.centre]):
                continue
            result[data.name] = data
    return list(result.values())


def _one(attribute: ElementTree.Element, usual: str) -> _Data | None:
    centre = {"Cell": "cell", "Node": "point"}.get(attribute.get("Center", "Node"))
    item = attribute.find("DataItem")
    if centre is None or item is None or not (item.text or "").strip():
        return None
    if centre == "cell" and item.get("NumberType", item.get("DataType", usual)) != "Float":
        return None  # numbers of regions
    return _Data(attribute.get("Name", ""), centre, Array.of(item))  # type: ignore[arg-type]


def _rows(grid: ElementTree.Element, part: str) -> int:
    item = grid.find(f"{part}/DataItem")
    return dimensions(item)[0] if item is not None else 0


def _kind(grid: ElementTree.Element) -> str:
    topology = grid.find("Topology")
    assert topology is not None
    return str(topology.get("TopologyType", topology.get("Type", ""))).lower()


def _width(grid: ElementTree.Element) -> int:
    geometry = grid.find("Geometry")
    kind = "" if geometry is None else geometry.get("GeometryType", geometry.get("Type", "XYZ"))
    return {"XY": 2, "XYZ": 3}.get(str(kind).upper(), 0)


def _straight(path: Path, dim: int | None) -> RawMesh:
    """Read by meshio, which knows files of a single grid. On one rank."""
    try:
        return straight(_by_meshio(path, dim))
    except MeshError as error:
        raise MeshError(
            f"its quadratic cells are not read as straight ones: {error.what}",
            where=path.name,
            expected="save the mesh as .vtu, or with linear cells",
        ) from None


def _by_meshio(path: Path, dim: int | None) -> RawMesh:
    from dolfin_elastic.mesh.formats.meshio import check_hdf5, read_meshio

    for name in data_files(path, read_xml(path)):
        check_hdf5(path.parent / name, path.name)
    return assemble(read_meshio(path), source=path.name, dim=dim)


def _tagged(body: Body, path: Path, contents: _Contents, unused: IntArray) -> Body:
    incomplete: dict[str, str] = {}
    for tags in contents.tags:
        parts, lost = _parts(body, path, tags, contents, unused)
        incomplete |= lost
        low = contents.dim - tags.dim
        kind = "points" if tags.dim == 0 else {0: "regions", 1: "surfaces"}.get(low, "edges")
        whole = {n: rows for n, rows in parts.items() if n not in {*lost, *contents.incomplete}}
        body = body.named(**{kind: whole})
    incomplete |= contents.incomplete
    notes = (*body.notes, *left_out(incomplete))
    return replace(body, incomplete=incomplete, notes=notes)


def _parts(
    body: Body, path: Path, tags: _Tags, contents: _Contents, unused: IntArray
) -> tuple[dict[str, IndexArray], dict[str, str]]:
    """Name to local entities, of points nodes; and to what is missing of it. Collective."""
    mesh, lost = body.mesh, dict[str, str]()
    if tags.cells == contents.cells:
        what = f"the region '{tags.attribute}'"
        local = distributed(body, "cell", path, tags.values, what).values[:, 0]
        result = {v: np.flatnonzero(local == v).astype(np.int32) for v in _values(mesh.comm, local)}
    else:
        cells = _cells(mesh.comm, path, tags.kind, tags.cells)
        numbers: IndexArray = _share(mesh.comm, path, tags.values).reshape(-1).astype(np.int32)
        _check_nodes(mesh, cells, tags, contents.points.rows)
        gone = np.asarray(np.isin(cells, unused).any(axis=1))
        lost = _lost(mesh.comm, tags, numbers, gone)
        cells, numbers = without(cells[~gone], unused), numbers[~gone]
        values = _values(mesh.comm, numbers)
        if tags.dim == 0:
            result = _nodes(mesh, cells[:, 0], numbers, values)
        else:
            result = _entities(mesh, tags.dim, cells, numbers, values)
            lost = _missing(mesh, tags, cells, numbers, result) | lost
    if tags.named:
        return {tags.attribute: result[1]} if 1 in result else {}, lost
    return {tags.name_of(value): rows for value, rows in result.items()}, lost


def _values(comm: MPI.Comm, numbers: AnyArray) -> list[int]:
    """Different numbers of all ranks; none of them if they are data, not names. Collective."""
    local = np.unique(numbers[np.isfinite(numbers)])
    values = np.unique(np.concatenate(comm.allgather(local[: _MOST + 1])))
    return [int(value) for value in values] if len(values) <= _MOST else []


def _nodes(
    mesh: Mesh, points: IntArray, numbers: IndexArray, values: Sequence[int]
) -> dict[int, IndexArray]:
    """Local nodes of each value of points, by their rows in the file. Collective."""
    rows, every = (np.concatenate(mesh.comm.allgather(part)) for part in (points, numbers))
    own = mesh.geometry.input_global_indices
    return {v: np.flatnonzero(np.isin(own, rows[every == v])).astype(np.int32) for v in values}


def _entities(
    mesh: Mesh, dim: int, cells: IntArray, numbers: IndexArray, values: Sequence[int]
) -> dict[int, IndexArray]:
    """Local edges, facets or cells of each value, those that ranks share on all. Collective."""
    if dim == 1 and mesh.topology.dim == 3:
        prepare_edges(mesh)
    if dim < mesh.topology.dim:
        mesh.topology.create_connectivity(dim, mesh.topology.dim)
    mesh.topology.create_connectivity(dim, 0)
    entities, at = distribute_entity_data(mesh, dim, cells, numbers)
    result = {}
    for value in values:  # one by one: an entity of two values would have one of them
        here = at == value
        found = meshtags_from_entities(mesh, dim, graph.adjacencylist(entities[here]), at[here])
        result[value] = _shared(mesh, dim, found.indices)
    return result


def _missing(
    mesh: Mesh, tags: _Tags, cells: IntArray, numbers: IndexArray, result: Mapping[int, IndexArray]
) -> dict[str, str]:
    """Name to what is missing of a part whose members are none of the mesh. Collective."""
    lost, comm, size = dict[str, str](), mesh.comm, mesh.topology.index_map(tags.dim).size_local
    things = {0: "cells", 1: "facets"}.get(mesh.topology.dim - tags.dim, "edges")
    for value in [1] if tags.named else result:
        own, rows = result.get(value, np.empty(0, np.int32)) < size, cells[numbers == value]
        here, count = total(comm, np.array([np.count_nonzero(own), len(rows)]))
        if here < count:  # unless the file has some of them twice
            every = comm.allgather(np.unique(np.sort(rows, axis=1), axis=0))
            count = len(np.unique(np.concatenate(every), axis=0))
        if here < count:
            text = f"{count - here} of its {count} {things} are no {things} of "
            lost[tags.name_of(value)] = text + ("the mesh" if things == "cells" else "an element")
    return lost


def _lost(comm: MPI.Comm, tags: _Tags, numbers: IndexArray, gone: BoolArray) -> dict[str, str]:
    """Name to what a part has lost with points that no cell uses. Collective."""
    result = {}
    for value in _values(comm, numbers[gone]):
        local = np.array([np.sum(gone & (numbers == value)), np.sum(numbers == value)])
        count, every = total(comm, local)
        result[tags.name_of(value)] = f"{count} of its {every} members belong to no element"
    return result


def _check_nodes(mesh: Mesh, cells: IntArray, tags: _Tags, points: int) -> None:
    """Refuses data of cells whose points do not exist. Collective."""
    bad = int(np.count_nonzero((cells < 0) | (cells >= points)))
    if total(mesh.comm, bad):
        raise MeshError(
            f"the cells of '{tags.attribute}' have points that do not exist",
            expected=f"{points} points, numbered from 0",
        )


def _shared(mesh: Mesh, dim: int, entities: IndexArray) -> IndexArray:
    """Adds entities that this rank shares with a rank that has them. Collective."""
    index = mesh.topology.index_map(dim)
    marks = la.vector(index, 1)
    marks.array[:] = 0
    marks.array[entities] = 1
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return np.flatnonzero(marks.array > 0).astype(np.int32)
