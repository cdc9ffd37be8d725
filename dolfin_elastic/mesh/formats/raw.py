"""The content of a mesh file before it is distributed: plain arrays on one rank."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.cad.faces import CadFace

_SHOWN = 5
"""Times of steps that a message names."""


def joined(parts: Sequence[IntArray]) -> IntArray:
    """The numbers of several arrays, of none too, one after the other."""
    return np.concatenate([np.empty(0, dtype=np.int64), *parts])


def is_step(at: float | None, time: float | None) -> bool:
    """Whether data are those of a time step.

    Args:
        at: Their time; None: the same at all steps.
        time: The one that is wanted; None: any.
    """
    return at is None or time is None or math.isclose(at, time, rel_tol=1e-9, abs_tol=1e-12)


def check_step(time: float | None, known: Iterable[float | None]) -> None:
    """Refuses a time at which a file has no step.

    Args:
        time: The one that is wanted; None: any.
        known: Times of the data in the file.

    Raises:
        MeshError: With the times that it has.
    """
    times = sorted({at for at in known if at is not None})
    if time is None or any(is_step(at, time) for at in times):
        return
    near = sorted(sorted(times, key=lambda at: abs(at - time))[:_SHOWN])
    raise MeshError(
        f"it has no time step at {time:g}",
        expected=f"one of {len(times)}, such as {', '.join(f'{at:.9g}' for at in near)}"
        if times
        else "leave time out: its fields are of one step without a time",
    )


def find(labels: IntArray, wanted: IntArray) -> IntArray:
    """Index of each number in a table, -1 where it is not in it.

    Args:
        labels: The table: different numbers in ascending order, shape (n,).
        wanted: Numbers of any shape.
    """
    if not len(labels):
        return np.full(wanted.shape, -1, dtype=np.int64)
    rows = np.minimum(np.searchsorted(labels, wanted), len(labels) - 1)
    return np.where(labels[rows] == wanted, rows, -1)


def find_all(labels: IntArray, wanted: IntArray) -> IntArray:
    """Rows of the nodes of elements in a table of nodes.

    Args:
        labels: Numbers of all nodes in ascending order, shape (n,).
        wanted: Numbers of the elements' nodes, of any shape.

    Returns:
        Shape of `wanted`.

    Raises:
        MeshError: A node does not exist.
    """
    rows = find(labels, wanted)
    lost = np.unique(wanted[rows < 0])
    if len(lost):
        raise MeshError(
            f"elements refer to {len(lost)} points that do not exist, for example {lost[0]}"
        )
    return rows


def missing(lost: IntArray, count: int, what: str) -> str:
    """The reason why a set is not whole, or nothing.

    Args:
        lost: Members that do not exist.
        count: Number of all members.
    """
    if not len(lost):
        return ""
    return f"{len(lost)} of its {count} {what} do not exist in the file, for example {lost[0]}"


Array = TypeVar("Array", bound=AnyArray)
_DIMS = {
    "vertex": 0,
    "line": 1,
    "triangle": 2,
    "quad": 2,
    "polygon": 2,
    "tetra": 3,
    "hexahedron": 3,
    "wedge": 3,
    "pyramid": 3,
    "polyhedron": 3,
}
_CELLS = {2: {"triangle": 1, "triangle6": 2}, 3: {"tetra": 1, "tetra10": 2}}
_KIND_NAMES = {
    "tetra": "tetrahedra",
    "tetra10": "10-node tetrahedra",
    "triangle": "triangles",
    "triangle6": "6-node triangles",
    "hexahedron": "hexahedra",
    "quad": "quadrilaterals",
    "wedge": "wedges (prisms)",
    "pyramid": "pyramids",
    "line": "lines",
    "vertex": "points",
}


def kind_name(kind: str) -> str:
    """Name of a kind of elements: 20-node hexahedra of hexahedron20."""
    shape = kind.rstrip("0123456789")
    known = _KIND_NAMES.get(shape, shape)
    return _KIND_NAMES.get(kind) or f"{kind.removeprefix(shape)}-node {known}".removeprefix(
        "-node "
    )


@dataclass(frozen=True)
class Block:
    """Elements of one kind and the named parts some of them belong to.

    Attributes:
        kind: Element kind in the words of meshio: tetra, tetra10, triangle, triangle6, line ...
        nodes: Rows of `points` (shape (n, k)), vertices first.
        parts: Name to the rows of `nodes` that carry it; names may overlap.
        data: Name to numbers of each element, shape (n, columns).
        entity: Number of the entity of a CAD model that they mesh; 0: not known.
        normals: Normals of that entity at the vertices, of either side, shape (n, vertices, 3); NaN
            where they are not known.
    """

    kind: str
    nodes: IntArray
    parts: Mapping[str, IntArray] = field(default_factory=dict)
    data: Mapping[str, FloatArray] = field(default_factory=dict)
    entity: int = 0
    normals: FloatArray | None = None

    @property
    def dim(self) -> int:
        """Dimension of the elements: 3 for an unknown kind, so that it is not overlooked."""
        return _DIMS.get(self.kind.rstrip("0123456789"), 3)


@dataclass(frozen=True)
class MeshFile:
    """Content of a mesh file, as its reader finds it.

    Attributes:
        points: Coordinates in the file's unit, shape (N, 2) or (N, 3).
        blocks: All elements, with their named parts and data.
        notes: Faults, and what is doubtful.
        information: How the mesh was made.
        point_sets: Name to rows of `points`; each becomes a set of nodes, and the
            surface of the boundary's facets within it if there are any.
        point_data: Name to numbers of each point, shape (N, columns).
        incomplete: Name of a set whose members are not all there, to the reason with their number.
        faces: Of the CAD model that was meshed.
        numbers: Of the points in the file, as results of other programs name them, shape (N,);
            None where they are not known.
    """

    points: FloatArray
    blocks: Sequence[Block]
    notes: Sequence[str] = ()
    information: Sequence[str] = ()
    point_sets: Mapping[str, IntArray] = field(default_factory=dict)
    point_data: Mapping[str, FloatArray] = field(default_factory=dict)
    incomplete: Mapping[str, str] = field(default_factory=dict)
    faces: Sequence[CadFace] = ()
    numbers: IntArray | None = None


@dataclass(frozen=True)
class RawMesh:
    """One body as plain arrays.

    Attributes:
        points: Coordinates in the file's unit, shape (N, dim).
        cells: Rows of `points` for each cell, in the file's node order, shape (M, k).
        order: Geometric degree, 1 or 2.
        regions: Name to rows of `cells`.
        surfaces: Name to the facets' vertices (rows of `points`), shape (F, dim).
        notes: Faults found, and what is doubtful.
        information: How the mesh was made, and corrections without effect.
        unit: Name of the file's unit of length, for messages.
        cell_data: Name to numbers of each cell, shape (M, columns).
        point_data: Name to numbers of each point, shape (N, columns).
        edges: In 3D, name to both end vertices of each edge (rows of `points`), shape (E, 2).
        nodes: Name to rows of `points`, midside nodes too, shape (n,).
        uncovered: Name of a set of nodes that is in `surfaces` too, to how many of its nodes no
            facet of it holds; only where there are some.
        incomplete: Name of a part of which members are missing, to the reason with their number.
        faces: Of the CAD model that was meshed.
        face_facets: Number of a face to its facets' vertices (rows of `points`), shape (F, dim).
        face_normals: Number of a face to its normals at these vertices, shape (F, dim, 3), see
            `Block`; of all faces, or of none.
    """

    points: FloatArray
    cells: IntArray
    order: int
    regions: Mapping[str, IntArray] = field(default_factory=dict)
    surfaces: Mapping[str, IntArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    cell_data: Mapping[str, FloatArray] = field(default_factory=dict)
    point_data: Mapping[str, FloatArray] = field(default_factory=dict)
    edges: Mapping[str, IntArray] = field(default_factory=dict)
    nodes: Mapping[str, IntArray] = field(default_factory=dict)
    uncovered: Mapping[str, int] = field(default_factory=dict)
    incomplete: Mapping[str, str] = field(default_factory=dict)
    information: tuple[str, ...] = ()
    unit: str = "m"
    faces: tuple[CadFace, ...] = ()
    face_facets: Mapping[int, IntArray] = field(default_factory=dict)
    face_normals: Mapping[int, FloatArray] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        """Dimension of the cells, 2 or 3."""
        return {3: 2, 6: 2, 4: 3, 10: 3}[self.cells.shape[1]]


def assemble(file: MeshFile, *, source: str, dim: int | None = None) -> RawMesh:
    """Assembles the elements of the highest dimension to one mesh.

    Local.  Elements one dimension lower give the named surfaces, lines in 3D the edges, and
    elements of one node the points; data of points are left out where cells have data of that name.

    Args:
        dim: 2 or 3 to choose the elements; by default the highest found.

    Raises:
        MeshError: There are no triangles or tetrahedra, or others beside them.
    """
    blocks = [b for b in file.blocks if len(b.nodes)]
    dim = max((b.dim for b in blocks), default=0) if dim is None else dim
    solid = [b for b in blocks if b.dim == dim]
    order = _order(solid, blocks, dim, source)
    below = [b for b in blocks if b.dim == dim - 1]
    surfaces = _gather(below, [b.nodes[:, :dim] for b in below])
    lines = [b for b in blocks if b.dim == 1 < dim - 1]
    edges = _gather(lines, [b.nodes[:, :2] for b in lines])
    single = [b for b in blocks if b.dim == 0]
    nodes = {n: np.unique(rows) for n, rows in _gather(single, [b.nodes for b in single]).items()}
    uncovered: dict[str, int] = {}
    for name, rows in file.point_sets.items():
        nodes[name] = np.union1d(nodes.get(name, rows), rows)
    for name, (facets, missed) in _from_points(solid, dim, file.point_sets).items():
        if name not in surfaces:
            surfaces[name] = facets
            uncovered |= {name: missed} if missed else {}
    starts = np.cumsum([0] + [len(b.nodes) for b in solid])
    own = [np.arange(len(b.nodes)) + start for b, start in zip(solid, starts, strict=False)]
    regions = {name: np.unique(r) for name, r in _gather(solid, own).items()}
    cells = np.concatenate([b.nodes for b in solid])
    notes = (*file.notes, *_left_out(blocks, dim))
    cell_data = _cell_data(solid)
    at_points = {n: data for n, data in file.point_data.items() if n not in cell_data}
    return RawMesh(
        file.points,
        cells,
        order,
        regions,
        surfaces,
        notes,
        cell_data,
        at_points,
        edges=edges,
        nodes=nodes,
        uncovered=uncovered,
        incomplete=file.incomplete,
        information=tuple(file.information),
        faces=tuple(file.faces),
        face_facets=_of_faces(below, lambda b: b.nodes[:, :dim]) if file.faces else {},
        face_normals=_of_faces(below, lambda b: _normals(b, dim)) if file.faces else {},
    )


def _of_faces(below: Sequence[Block], rows: Callable[[Block], Array]) -> dict[int, Array]:
    """Number of a CAD face to rows of its facets."""
    result: dict[int, list[Array]] = {}
    for block in below:
        if block.entity:
            result.setdefault(block.entity, []).append(rows(block))
    return {number: cast("Array", np.concatenate(parts)) for number, parts in result.items()}


def _normals(block: Block, dim: int) -> FloatArray:
    """Normals of a block's facets, see `Block`; NaN where it has none."""
    if block.normals is None:
        return np.full((len(block.nodes), dim, 3), np.nan)
    return block.normals


def _cell_data(solid: Sequence[Block]) -> dict[str, FloatArray]:
    """Data of all blocks concatenated, NaN where a block has none."""
    result = {}
    for name in dict.fromkeys(name for block in solid for name in block.data):
        width = max(block.data[name].shape[1] for block in solid if name in block.data)
        rows = [block.data.get(name, np.full((len(block.nodes), width), np.nan)) for block in solid]
        if all(part.shape[1] == width for part in rows):
            result[name] = np.concatenate(rows)
    return result


def _order(solid: Sequence[Block], blocks: Sequence[Block], dim: int, source: str) -> int:
    known = _CELLS.get(dim, {})
    other = sorted({b.kind for b in solid} - set(known))
    if not solid or not known:
        raise MeshError(
            f"the mesh has no tetrahedra and no triangles ({_found(blocks)})",
            where=source,
            expected="save the volume (or 2D) elements too",
        )
    if high := [_high_order(kind, dim) for kind in other]:
        if all(high):
            raise MeshError(
                f"the elements are of order {', '.join(high)}: {_found(solid)}",
                where=source,
                expected="order 1 or 2 (in Gmsh: Mesh.ElementOrder = 2)",
            )
        raise MeshError(
            f"the mesh has elements other than simplices: {_found(solid)}",
            where=source,
            expected=_advice(dim),
        )
    orders = {known[b.kind] for b in solid}
    if len(orders) > 1:
        raise MeshError(
            f"linear and quadratic elements are mixed: {_found(solid)}",
            where=source,
            expected="mesh the whole body with one order",
        )
    return orders.pop()


def _high_order(kind: str, dim: int) -> str:
    """Order of simplices with more nodes than are read, from 3; empty for other elements."""
    shape = {2: "triangle", 3: "tetra"}[dim]
    count = kind.removeprefix(shape)
    known = {math.comb(order + dim, dim): order for order in range(3, 11)}
    return str(known.get(int(count), "")) if kind.startswith(shape) and count.isdigit() else ""


def _advice(dim: int) -> str:
    if dim == 2:
        return "3- or 6-node triangles are needed (in Gmsh: no 'Recombine')"
    return (
        "4- or 10-node tetrahedra are needed (in Gmsh: no 'Recombine', no extruded layers; "
        "in other tools: mesh with tetrahedra)"
    )


def _found(blocks: Iterable[Block]) -> str:
    counts: Counter[str] = Counter()
    for block in blocks:
        counts[block.kind] += len(block.nodes)
    return "found " + (", ".join(f"{n} {kind_name(k)}" for k, n in counts.items()) or "none")


def _gather(blocks: Sequence[Block], items: Sequence[IntArray]) -> dict[str, IntArray]:
    result: dict[str, list[IntArray]] = {}
    for block, item in zip(blocks, items, strict=True):
        for name, rows in block.parts.items():
            if len(rows):
                result.setdefault(name, []).append(item[rows])
    return {name: np.concatenate(parts) for name, parts in result.items()}


def _left_out(blocks: Sequence[Block], dim: int) -> list[str]:
    high = sorted({name for b in blocks if b.dim > dim for name in b.parts})
    return [f"left out, of too high a dimension: {', '.join(high)}"] if high else []


MIDSIDES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""End vertices of the midside nodes of quadratic cells in the order of Abaqus, VTK and MED."""


def _from_points(
    solid: Sequence[Block], dim: int, point_sets: Mapping[str, IntArray]
) -> dict[str, tuple[IntArray, int]]:
    """The boundary facets within each set of points, and how many points none of them holds.

    Of quadratic cells a set has all midside nodes of a facet, or no midside node at all.
    """
    if not point_sets:
        return {}
    facets = boundary([b.nodes[:, : dim + 1] for b in solid])
    midsides = _midsides(solid, dim, facets)
    result = {}
    for name, rows in point_sets.items():
        held = np.isin(facets, rows).all(axis=1)
        if np.isin(midsides, rows).any():
            held &= np.isin(midsides, rows).all(axis=1)
        if held.any():
            nodes = np.concatenate([facets[held].ravel(), midsides[held].ravel()])
            result[name] = (facets[held], len(np.setdiff1d(rows, nodes)))
    return result


def _midsides(solid: Sequence[Block], dim: int, facets: IntArray) -> IntArray:
    """Midside nodes of facets, sorted vertices: shape (F, sides); of linear cells (F, 0)."""
    if solid[0].nodes.shape[1] == dim + 1:
        return np.empty((len(facets), 0), dtype=np.int64)
    columns = MIDSIDES[: solid[0].nodes.shape[1] - dim - 1]
    ends = np.concatenate([np.sort(b.nodes[:, pair], axis=1) for b in solid for pair in columns])
    middles = np.concatenate([b.nodes[:, dim + 1 + k] for b in solid for k in range(len(columns))])
    ends, first = np.unique(ends, axis=0, return_index=True)
    sides = [(0, 1), (0, 2), (1, 2)] if dim == 3 else [(0, 1)]
    at = [match_rows(ends, facets[:, side]) for side in sides]
    return np.asarray(middles[first][np.stack(at, axis=1)])


def boundary(cells: Sequence[IntArray]) -> IntArray:
    """Facets that belong to one cell only, as sorted vertices, shape (F, d)."""
    corners = np.concatenate(list(cells))
    d = corners.shape[1] - 1
    facets = np.sort(np.concatenate([np.delete(corners, i, axis=1) for i in range(d + 1)]), axis=1)
    order = np.lexsort(facets.T)
    facets = facets[order]
    same = np.zeros(len(facets) + 1, dtype=bool)
    same[1:-1] = (facets[1:] == facets[:-1]).all(axis=1)
    return np.asarray(facets[~same[:-1] & ~same[1:]])


def match_rows(table: IntArray, rows: IntArray) -> IntArray:
    """Index of each row in a table, or -1.

    Args:
        table: Rows that are all different, shape (n, k).
        rows: Rows to look up, shape (m, k).

    Returns:
        Shape (m,).
    """
    both = np.concatenate([table, rows])
    _, group = np.unique(both, axis=0, return_inverse=True)
    group = group.reshape(-1)
    offset = np.full(len(both), -1, dtype=np.int64)
    offset[group[: len(table)]] = np.arange(len(table))
    return np.asarray(offset[group[len(table) :]])


def format_points(points: npt.ArrayLike, count: int, unit: str) -> str:
    """The first five points as text, for messages.

    Args:
        points: Coordinates in the file's unit, shape (n, dim).
        count: Number of all points; "..." is added if it exceeds those shown.
        unit: Name of that unit.
    """
    rows = np.asarray(points, dtype=float)[:5]
    text = ", ".join("(" + ", ".join(f"{x:.4g}" for x in row) + ")" for row in rows)
    return f"near {text} {unit}{' ...' if count > len(rows) else ''}"
