"""XDMF: read in parts by all ranks; with the meshtags that DOLFINx and meshio put beside."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from dolfinx import la
from dolfinx.io import XDMFFile
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfin_elastic.core.compat import read_meshtags, reads_attributes_by_name
from dolfin_elastic.core.errors import MeshError, not_shown
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import build_body, make_mesh
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.formats.cleaning import check_distributed, straight
from dolfin_elastic.mesh.formats.raw import RawMesh, assemble
from dolfin_elastic.mesh.formats.xdmf_named import (
    Names,
    dimensions,
    distributed,
    kind_of,
    named,
    names_in,
    place_of,
)
from dolfin_elastic.mesh.geometry.simplices import prepare_edges, vertex_nodes

_DIMS = {
    "tetrahedron": 3,
    "tetrahedron_10": 3,
    "tet_10": 3,
    "triangle": 2,
    "triangle_6": 2,
    "tri_6": 2,
    "polyline": 1,
    "polyvertex": 0,
}
_MOST = 200  # more distinct values than this are data, not names


@dataclass(frozen=True)
class _Tags:
    """Integer cell data of one grid: name of the grid, name of the data, dimension of the cells."""

    grid: str
    attribute: str
    dim: int


@dataclass(frozen=True)
class _Data:
    """Numbers of cells or points in an HDF5 file."""

    name: str
    centre: Literal["cell", "point"]
    file: str
    path: str
    shape: tuple[int, int]


@dataclass(frozen=True)
class _Contents:
    """Content of the file; `grid` is empty if DOLFINx cannot read it, and meshio must.

    `order` is the geometric degree of its cells, 0 where it is not known; `names` is what
    `dolfin-elastic convert` has put into it.
    """

    grid: str
    dim: int
    spatial: int
    tags: tuple[_Tags, ...]
    data: tuple[_Data, ...] = ()
    order: int = 0
    names: Names = field(default_factory=Names)

    def shared(self, dim: int | None) -> bool:
        """Whether all ranks read the file in shares.

        Args:
            dim: See `read_xdmf`.
        """
        return bool(self.grid) and self.spatial == self.dim and (dim or self.dim) == self.dim


def read_xdmf(
    path: Path,
    *,
    comm: MPI.Comm,
    unit: LengthUnit,
    dim: int | None,
    straight_cells: bool = False,
) -> Body:
    """Reads a mesh and its tags; each value v of the tags `facets` becomes ``facets_v``.

    Collective.  Parts of a converted mesh keep their names, see `xdmf_named`.

    Args:
        path: The .xdmf file, with its .h5 beside it.
        comm: The ranks that share the mesh.
        unit: Unit of length of the file.
        dim: 2 or 3 to choose the elements; by default the highest dimension.
        straight_cells: Quadratic cells are read as straight ones, on one rank.

    Raises:
        MeshError: The file cannot be read.
    """
    contents = on_root(comm, lambda: _contents(path))
    if straight_cells and contents.order != 1:
        return build_body(lambda: _straight(path, dim), comm=comm, unit=unit, source=path.name)
    if not contents.shared(dim):
        return build_body(lambda: _by_meshio(path, dim), comm=comm, unit=unit, source=path.name)
    try:
        with XDMFFile(comm, str(path), "r") as file:
            body = Body(_mesh(file, contents, unit.metres), source=path.name, unit=unit)
            body = named(_tagged(body, file, contents), path, contents.names)
        return replace(body, fields={d.name: _field(body, path, d) for d in contents.data})
    except RuntimeError as error:
        raise MeshError(f"cannot be read: {error}", where=path.name) from None
    except MeshError as error:
        raise error.at(path.name) from None


def _mesh(file: XDMFFile, contents: _Contents, scale: float) -> Mesh:
    _, order = file.read_cell_type(contents.grid)
    cells = np.ascontiguousarray(file.read_topology_data(contents.grid), dtype=np.int64)
    x = np.ascontiguousarray(file.read_geometry_data(contents.grid), dtype=np.float64)
    check_distributed(file.comm, cells, len(x), contents.dim)
    return make_mesh(file.comm, cells, x * scale, order)


def _contents(path: Path) -> _Contents:
    try:
        return _in(ElementTree.parse(path).getroot(), path)
    except ElementTree.ParseError as error:
        raise MeshError(f"this is no XML file: {error}", where=path.name) from None
    except MeshError as error:
        raise error if error.where else error.at(path.name) from None


def _in(root: ElementTree.Element, path: Path) -> _Contents:
    grids = [
        g
        for g in root.iter("Grid")
        if g.get("GridType", "Uniform") == "Uniform" and g.find("Topology") is not None
    ]
    if not grids:
        raise MeshError("there is no mesh (no Grid with a Topology)", where=path.name)
    _data_files(path, root)
    main = grids[0]
    kind = _kind(main)
    width = _width(main)
    plain = all(item.get("Format") == "HDF" for item in root.iter("DataItem"))
    if kind not in _DIMS or not plain or main.find("Geometry") is None:
        return _Contents("", 0, 0, ())
    if len(_tags(main)) > 1 and not reads_attributes_by_name():
        return _Contents("", 0, 0, ())
    tags = [t for g in grids if _kind(g) in _DIMS and not kind_of(g) for t in _tags(g)]
    data = _data(main, [g for g in root.iter("Grid") if g.find("Topology") is None])
    order = 2 if kind.endswith(("_6", "_10")) else 1
    return _Contents(
        main.get("Name", ""), _DIMS[kind], width, tuple(tags), tuple(data), order, names_in(root)
    )


def is_shared(path: Path, dim: int | None) -> bool:
    """Whether all ranks read a file in shares. Local.

    Args:
        path: The .xdmf file.
        dim: See `read_xdmf`.
    """
    return _contents(path).shared(dim)


def _tags(grid: ElementTree.Element) -> list[_Tags]:
    """Cell data of a grid that may be integers; DOLFINx writes tags without a number type."""
    found = []
    for attribute in grid.findall("Attribute"):
        item = attribute.find("DataItem")
        kind = "Float" if item is None else item.get("NumberType", item.get("DataType", "Int"))
        if kind_of(attribute):
            continue
        if attribute.get("Center") == "Cell" and kind in ("Int", "UInt", "Char", "UChar"):
            found.append(_Tags(grid.get("Name", ""), attribute.get("Name", ""), _DIMS[_kind(grid)]))
    return found


def _data(main: ElementTree.Element, functions: list[ElementTree.Element]) -> list[_Data]:
    """Fields of the mesh's grid and of DOLFINx's functions; of several time steps the last."""
    found: dict[str, _Data] = {}
    counts = {"cell": _rows(main, "Topology"), "point": _rows(main, "Geometry")}
    for grid in [main, *functions]:
        for attribute in grid.findall("Attribute"):
            # Without a type it is a float in XDMF; but of a mesh's own grid, DOLFINx's tags.
            data = _one(attribute, "Int" if grid is main else "Float")
            if data is None or (grid is not main and data.shape[0] != counts[data.centre]):
                continue
            found[data.name] = data
    return list(found.values())


def _one(attribute: ElementTree.Element, usual: str) -> _Data | None:
    centre = {"Cell": "cell", "Node": "point"}.get(attribute.get("Center", "Node"))
    item = attribute.find("DataItem")
    if centre is None or item is None or not (item.text or "").strip():
        return None
    if centre == "cell" and item.get("NumberType", item.get("DataType", usual)) != "Float":
        return None  # numbers of regions
    file, path = place_of(item)
    rows, *columns = dimensions(item)
    width = int(np.prod(columns, dtype=np.int64))
    return _Data(attribute.get("Name", ""), centre, file, path, (rows, width))  # type: ignore[arg-type]


def _rows(grid: ElementTree.Element, part: str) -> int:
    item = grid.find(f"{part}/DataItem")
    return dimensions(item)[0] if item is not None else 0


def _field(body: Body, path: Path, data: _Data) -> MeshField:
    """Reads a field on rank 0, in pieces. Collective."""
    try:
        return distributed(body, data.centre, data.shape, path.parent / data.file, data.path)
    except MeshError as error:
        raise MeshError(f"the field '{data.name}': {error}") from None


def _kind(grid: ElementTree.Element) -> str:
    topology = grid.find("Topology")
    assert topology is not None
    return str(topology.get("TopologyType", topology.get("Type", ""))).lower()


def _width(grid: ElementTree.Element) -> int:
    geometry = grid.find("Geometry")
    kind = "" if geometry is None else geometry.get("GeometryType", geometry.get("Type", "XYZ"))
    return {"XY": 2, "XYZ": 3}.get(str(kind).upper(), 0)


def _data_files(path: Path, root: ElementTree.Element) -> None:
    for item in root.iter("DataItem"):
        if item.get("Format") == "HDF" and item.text:
            name, _ = place_of(item)
            if not (path.parent / name).is_file():
                raise MeshError(
                    f"its data file '{name}' is not beside it",
                    where=path.name,
                    expected=not_shown(path.parent / name) or "keep the .xdmf and the .h5 together",
                )


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
    from dolfin_elastic.mesh.formats.meshio import read_meshio

    return assemble(read_meshio(path), source=path.name, dim=dim)


def _tagged(body: Body, file: XDMFFile, contents: _Contents) -> Body:
    for tags in contents.tags:
        parts = _parts(body.mesh, file, tags)
        low = contents.dim - tags.dim
        kind = "points" if tags.dim == 0 else {0: "regions", 1: "surfaces"}.get(low, "edges")
        if kind == "points":
            nodes = vertex_nodes(body.mesh)
            parts = {name: np.sort(nodes[vertices]) for name, vertices in parts.items()}
        body = body.named(**{kind: parts})
    return body


def _parts(mesh: Mesh, file: XDMFFile, tags: _Tags) -> dict[str, IndexArray]:
    if tags.dim == 1 and mesh.topology.dim == 3:
        prepare_edges(mesh)
    found = read_meshtags(file, mesh, tags.grid, tags.attribute)
    values = np.unique(np.concatenate(mesh.comm.allgather(np.unique(found.values))))
    if len(values) > _MOST:
        return {}
    return {
        f"{tags.attribute}_{value}": _shared(mesh, tags.dim, found.find(value)) for value in values
    }


def _shared(mesh: Mesh, dim: int, entities: IndexArray) -> IndexArray:
    """Adds entities that this rank shares with a rank that has them. Collective."""
    index = mesh.topology.index_map(dim)
    marks = la.vector(index, 1)
    marks.array[:] = 0
    marks.array[entities] = 1
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    return np.flatnonzero(marks.array > 0).astype(np.int32)
