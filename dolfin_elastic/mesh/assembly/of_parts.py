"""`parts_body`: several bodies, each with its own placement, as one body of separate meshes.

Every rank brings the elements that it has of each body, and all are distributed anew together:
no rank has more than its part of the whole.  Names and fields are sent with the elements, as those
of coarse elements are to finer ones (`refine.parts`): here each element is the whole of its parent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from dolfinx import fem, la
from dolfinx.common import IndexMap

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import RankExchange
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.assembly.overlap import overlapping
from dolfin_elastic.mesh.assembly.placement import Placed, check_names
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.geometry.boundary_shape import KnownSurface
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets
from dolfin_elastic.mesh.refine.division import barycentric, lagrange
from dolfin_elastic.mesh.refine.parts import carry_parts, carry_surface
from dolfin_elastic.mesh.refine.refinement import CellLinks

T = TypeVar("T")
OfPart = Callable[[AnyArray], AnyArray]
"""Rows of the local cells of a part to rows of all cells; 0 or NaN outside of the part."""


def parts_body(parts: Mapping[str, Body | Placed], *, unit: LengthUnit | None = None) -> Body:
    """Several bodies as one, which share no nodes: contact and ties join them. Collective.

    Each part is a region and a surface, its whole boundary, of its own name; its own names and
    fields come after this name and a point: "pin", "pin.foot".  One body may be there several
    times.  Straight elements become quadratic where other parts have quadratic ones.

    Args:
        parts: Name to a body, or to one that is turned and moved; all of one dimension.
        unit: Unit of length for messages and bare numbers; None: that of all parts, if they have
            the same, else metres.

    Raises:
        MeshError: There is none, a name has a point, the parts are of several dimensions, or a
            placement has another dimension; with the dotted key behind `mesh.parts`.

    Example:
        pin = read_body("pin.msh", scale=1e-3)
        both = parts_body({"plate": read_body("plate.vtu"), "pin": Placed(pin, [0, 0, "12 mm"])})
    """
    placed = {name: p if isinstance(p, Placed) else Placed(p) for name, p in parts.items()}
    check_names(placed)
    bodies = {name: one.body for name, one in placed.items()}
    _check_dimensions(bodies)
    order = max(_order(body) for body in bodies.values())
    joined = _Joined([*placed.items()], order)
    named = {kind: dict[str, IndexArray]() for kind in ("regions", "surfaces", "edges", "points")}
    fields = dict[str, MeshField]()
    facets = boundary_facets(joined.mesh)
    beside, _ = cells_beside_facets(joined.mesh, facets)
    for number, (name, one) in enumerate(placed.items()):
        of_part = joined.of_part(number)
        inside = joined.part_of_cell == number
        named["regions"][name] = np.flatnonzero(inside).astype(np.int32)
        named["surfaces"][name] = np.sort(facets[inside[beside]])
        for kind, found in carry_parts(one.body, joined.mesh, joined.corners, of_part).items():
            named[kind] |= _named(name, found)
        for field, values in one.body.fields.items():
            fields[f"{name}.{field}"] = joined.field(one, values, of_part)
    raised = [name for name, body in bodies.items() if _order(body) < order]
    return Body(
        joined.mesh,
        named["regions"],
        named["surfaces"],
        "parts " + ", ".join(bodies),
        (
            *(f"part '{n}': {text}" for n, body in bodies.items() for text in body.notes),
            *(
                f"the parts '{a}' and '{b}' overlap: is that meant?"
                for a, b in overlapping(joined.mesh, {n: named["regions"][n] for n in bodies})
            ),
        ),
        fields,
        edges=named["edges"],
        points=named["points"],
        uncovered=_all_named({name: body.uncovered for name, body in bodies.items()}),
        incomplete=_all_named({name: body.incomplete for name, body in bodies.items()}),
        unit=unit or _common_unit(bodies),
        information=(
            *(f"part '{n}': {text}" for n, body in bodies.items() for text in body.information),
            *(f"part '{n}': its elements are made quadratic, as others are" for n in raised),
        ),
        known_surface=joined.known_surface(beside),
    )


def _check_dimensions(bodies: Mapping[str, Body]) -> None:
    """Refuses parts of several dimensions."""
    (first, body), *others = bodies.items()
    for name, other in others:
        if other.dim != body.dim:
            raise MeshError(
                f"the part is {other.dim}-dimensional, '{first}' {body.dim}-dimensional",
                where=name,
                expected="parts of one dimension",
            )


def _order(body: Body) -> int:
    return int(body.mesh.geometry.cmap.degree)


def _named(part: str, table: Mapping[str, T]) -> dict[str, T]:
    return {f"{part}.{name}": value for name, value in table.items()}


def _all_named(tables: Mapping[str, Mapping[str, T]]) -> dict[str, T]:
    return {name: v for part, table in tables.items() for name, v in _named(part, table).items()}


def _common_unit(bodies: Mapping[str, Body]) -> LengthUnit:
    units = {body.unit.metres: body.unit for body in bodies.values()}
    stated = all(body.unit.stated for body in bodies.values())
    return replace(next(iter(units.values())), stated=stated) if len(units) == 1 else METRE


class _Joined:
    """The mesh of all parts, and how rows of their cells get to it. Collective to make.

    Args:
        order: 2 where one of the parts has quadratic elements, else 1.

    Attributes:
        mesh: All parts, numbered one after the other, as their files have their cells.
        corners: See `carry_parts`: each cell is its own parent.
        part_of_cell: The number of the part of each local cell.
    """

    def __init__(self, parts: Sequence[tuple[str, Placed]], order: int) -> None:
        self._parts, comm = [one for _, one in parts], parts[0][1].body.comm
        owned = [len(one.body.owned_cells()) for one in self._parts]
        self._ends = np.cumsum([0, *owned])
        nodes = [_nodes(one, order, name) for name, one in parts]
        first = sum(comm.allgather(sum(len(part.x) for part in nodes))[: comm.rank])
        rows, before = list[IntArray](), 0
        for one, part, count in zip(self._parts, nodes, owned, strict=True):
            original = np.asarray(one.body.mesh.topology.original_cell_index)[:count] + before
            rows.append(np.column_stack([original, part.numbered(first)[:count]]))
            before, first = before + one.body.num_cells, first + len(part.x)
        # In equal runs of their numbers, by which results and checkpoints put them in order.
        every = np.concatenate(rows)
        self._exchange = RankExchange(comm, every[:, 0] * comm.size // max(before, 1))
        received = self._exchange.send(every)
        self._in_order = np.argsort(received[:, 0])
        cells = np.ascontiguousarray(received[self._in_order, 1:])
        x = np.ascontiguousarray(np.concatenate([part.x for part in nodes]))
        self.mesh = make_mesh(comm, cells, x, order)
        original = np.asarray(self.mesh.topology.original_cell_index)
        self._links = CellLinks(comm, len(cells), original)
        parts_of = np.repeat(np.arange(len(owned)), owned)[:, None]
        self.part_of_cell = self._links(self._exchange.send(parts_of)[self._in_order])[:, 0]
        d = self.mesh.topology.dim
        self.corners = np.tile(np.eye(d + 1), (len(original), 1, 1))

    def of_part(self, number: int) -> OfPart:
        """How rows of the local cells of a part get to the cells of the mesh; see `OfPart`."""
        start, stop = self._ends[number : number + 2]

        def rows_of(rows: AnyArray) -> AnyArray:
            fill = np.nan if rows.dtype.kind == "f" else 0
            every = np.full((self._ends[-1], *rows.shape[1:]), fill, dtype=rows.dtype)
            every[start:stop] = rows[: stop - start]
            width = int(np.prod(rows.shape[1:], dtype=int))
            sent = self._exchange.send(every.reshape(len(every), width))[self._in_order]
            return self._links(sent.reshape(len(sent), *rows.shape[1:]))

        return rows_of

    def field(self, part: Placed, field: MeshField, of_part: OfPart) -> MeshField:
        """A field of a part on the mesh, NaN elsewhere; vectors are turned. Collective."""
        mesh, values = part.body.mesh, field.values
        if field.columns in (2, 3) and field.columns >= part.body.dim:
            field = replace(field, values=part.vectors(values))
        if field.centre == "cell":
            return MeshField("cell", of_part(field.values))
        geometry = self.mesh.geometry
        points = lagrange(part.body.dim, int(geometry.cmap.degree)).points
        cells = np.arange(len(mesh.geometry.dofmap), dtype=np.int32)
        result = np.full((len(geometry.x), field.columns), np.nan)
        result[geometry.dofmap] = of_part(field.at(mesh, cells, points))
        return MeshField("point", result)

    def known_surface(self, beside: IndexArray) -> KnownSurface | None:
        """What is known of the surfaces of the parts; None where they have facets only. Collective.

        Args:
            beside: The cell of each facet of the boundary.
        """
        if all(one.body.known_surface is None for one in self._parts):
            return None
        d, count = self.mesh.topology.dim, len(beside)
        normals, gap = np.full((count, d, d), np.nan), np.full(count, np.nan)
        arcs, off = np.zeros((count, d), dtype=bool), np.zeros(count)
        for number, one in enumerate(self._parts):
            of_part = self.of_part(number)
            known = carry_surface(one.body, self.mesh, self.corners, of_part)
            assert known.arcs is not None  # since it is of a shape
            mine = self.part_of_cell[beside] == number
            normals[mine], gap[mine] = one.vectors(known.normals[mine]), known.gap[mine]
            arcs[mine], off[mine] = known.arcs[mine], known.off[mine]
        return KnownSurface(normals, arcs, gap, off)


@dataclass(frozen=True)
class _Nodes:
    """Nodes of a part.

    Attributes:
        of_cells: Of each local cell, in DOLFINx's order.
        index: How they are distributed.
        x: Final positions of the owned ones [m].
    """

    of_cells: IndexArray
    index: IndexMap
    x: FloatArray

    def numbered(self, first: int) -> IntArray:
        """Numbers in the whole of the nodes of each local cell. Collective.

        Args:
            first: Number of the first one that this rank owns.
        """
        numbers = la.vector(self.index, 1, dtype=np.float64)
        numbers.array[: len(self.x)] = first + np.arange(len(self.x))
        numbers.scatter_forward()
        return np.asarray(np.rint(numbers.array).astype(np.int64)[self.of_cells])


def _nodes(part: Placed, order: int, name: str) -> _Nodes:
    """Nodes of a part; of straight elements beside quadratic ones midside nodes, too. Collective.

    Raises:
        MeshError: See `Placed.points`.
    """
    mesh, d = part.body.mesh, part.body.dim
    if _order(part.body) == order:
        of_cells, x, index = mesh.geometry.dofmap, mesh.geometry.x, mesh.geometry.index_map()
    else:
        space = fem.functionspace(mesh, ("Lagrange", order))
        of_cells, index = space.dofmap.list, space.dofmap.index_map
        # Means of both ends: the same to the last bit from each element, on any ranks.
        ends = [np.flatnonzero(row)[[0, -1]] for row in barycentric(lagrange(d, order).points)]
        corners = mesh.geometry.x[mesh.geometry.dofmap[:, np.array(ends)]].mean(axis=2)
        x = np.empty((index.size_local + index.num_ghosts, 3))
        x[of_cells] = corners
    try:
        placed = part.points(x[: index.size_local, :d])
    except MeshError as error:
        raise error.at(name) from None
    return _Nodes(np.asarray(of_cells), index, placed)
