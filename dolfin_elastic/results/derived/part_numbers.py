"""Largest and smallest values, percentiles, means and integrals over surfaces and regions.

Integrals are over the undeformed part, of a plane body over its thickness and of an axisymmetric
one around the axis, by quadrature.  Fields with a formula, stresses and strains, are evaluated at
the quadrature points inside the cells; of stresses that is closer to equilibrium than the recovered
ones.  Other fields of nodes are interpolated by the shape functions, those of cells are constant.

Extremes of fields of nodes, recovered stresses too, are sought among the nodes of the part, those
of fields of cells among the quadrature points, as are those of stresses over a region of a body of
several materials, whose nodes show the larger stress of two.  A recovered field is smoother than
that of the mean: where it does not reach the mean, the mean is the extreme.  Of a vector it is that
of its length, and that of each of its components.  What is asked for is a row of `REDUCTIONS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.ghosts import marked, with_ghosts
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import cell_gradients, quadrature_rule, shape_functions
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.problem.spaces import part_nodes
from dolfin_elastic.problem.state import State
from dolfin_elastic.problem.terms.at_points import facet_sets
from dolfin_elastic.results.cell_fields import CellKernel, cell_kernel, unknowns_of_outputs
from dolfin_elastic.results.derived.reduction import Samples
from dolfin_elastic.results.derived.reductions import ending, reduction_of
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.field import Field
from dolfin_elastic.results.fields import table_of

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

NODAL = {"displacement": "u", "velocity": "v", "acceleration": "a"}
"""Fields that are functions of the state: name to attribute of `State`."""
_TRIPLES = ("principal_stresses", "principal_stretches")
"""Fields of three numbers that are no vector: they have no length."""
_WHERE = "output.probes"


def has_length(name: str, field: Field) -> bool:
    """Whether a field is a vector."""
    return field.shape == "vector" and name not in _TRIPLES


def nodal_function(state: State, field: str) -> fem.Function:
    """The function of a state that is a field of `NODAL`.

    Raises:
        InputError: A field of motion is asked for in statics.
    """
    function: fem.Function | None = getattr(state, NODAL[field])
    if function is None:
        raise InputError(
            f"there is no '{field}' in statics",
            where=_WHERE,
            expected="leave it out, or use [dynamics]",
        )
    return function


@dataclass(frozen=True)
class Piece:
    """The part of a surface or region in one material, on this rank.

    Attributes:
        cells: Owned cells, one of each facet of a surface.
        side: Number of the facet in its cell, 0 of a region.
        kernel: Fields with a formula at the points of all sides; None: there are none.
        weights: Of the quadrature points [m^2 or m^3], shape (cells, points).
    """

    cells: IndexArray
    side: AnyArray
    kernel: CellKernel | None
    weights: FloatArray


class PartNumbers:
    """Numbers of fields over one surface or region; see the module.  All of it is collective.

    Args:
        kind: "surface" or "region".
        part: Its name; None: the whole body.
        fields: Names of `field_table`.
        statistics: Names of reductions, see `REDUCTIONS`.

    Attributes:
        pieces: The part in each material of the problem.
        size: Area [m^2] or volume [m^3] of the undeformed part.

    Raises:
        InputError: A field that a material of the part does not have.
        MeshError: The part is empty.
    """

    def __init__(
        self,
        problem: Problem,
        kind: str,
        part: str | None,
        fields: Sequence[str],
        statistics: Sequence[str],
    ) -> None:
        self.problem, self.kind, self.fields = problem, kind, tuple(fields)
        self._reductions = {name: reduction_of(name) for name in statistics}
        self._w, self._table = unknowns_of_outputs(problem), table_of(problem)
        self._inside = tuple(name for name in fields if self._table[name].formula is not None)
        # Of fields with a formula the values at nodes are needed for their extremes alone.
        sought = {"max", "min"} & {*statistics}
        others = [
            name
            for name in fields
            if name not in self._inside or (sought and self._table[name].centre == "node")
        ]
        self._evaluator = Evaluator(problem, others) if others else None
        body, degree = problem.body, 2 * problem.context.order
        sides = sides_of(problem, kind, part)
        if not total(body.comm, len(sides)):
            raise MeshError(
                f"the {kind} '{part}' is empty", where=_WHERE, expected="a name that has members"
            )
        self._nodes = members(problem, kind, part, "node")
        # Points in the reference cell, shape (sides, points, dim), and their weights (points,).
        points, self._reference = quadrature_rule(body.dim - (kind == "surface"), degree)
        self._points = facet_sets(body.dim, points) if kind == "surface" else points[None]
        self.pieces = [self._piece(region, sides) for region in problem.regions]
        self.size = float(total(body.comm, sum(piece.weights.sum() for piece in self.pieces)))
        shapes = problem.V.element.basix_element.tabulate(0, self._points.reshape(-1, body.dim))
        self._shapes = np.asarray(shapes)[0, :, :, 0].reshape(*self._points.shape[:2], -1)

    def _piece(self, region: MaterialRegion, sides: AnyArray) -> Piece:
        """The part in one material. Collective.

        Args:
            sides: Cell and number of its facet of the whole part, shape (n, 2).
        """
        here = sides[np.isin(sides[:, 0], region.cells)]
        cells = np.asarray(here[:, 0], dtype=np.int32)
        points = self._points.reshape(-1, self.problem.body.dim)
        kernel = (
            cell_kernel(self.problem, region, self._w, self._inside, points, _WHERE)
            if self._inside
            else None
        )
        return Piece(cells, here[:, 1], kernel, self._weights(cells, here[:, 1]))

    def _weights(self, cells: IndexArray, side: AnyArray) -> FloatArray:
        """Weights of the quadrature points [m^2 or m^3]; shape (cells, points).

        Args:
            cells: Owned cells.
            side: Number of the facet of each.
        """
        mesh, dim = self.problem.body.mesh, self.problem.body.dim
        points = self._points.reshape(-1, dim)
        nodes = np.asarray(mesh.geometry.x[mesh.geometry.dofmap[cells], :dim])
        gradients = cell_gradients(nodes, mesh.geometry.cmap.degree, points)
        table = gradients.reshape(len(cells), len(points), dim * dim)
        J = self._of_side(table, side).reshape(len(cells), len(self._reference), dim, dim)
        across: FloatArray | float = self.problem.thickness
        if self.problem.geometry == "axisymmetric":
            radii = nodes[..., 0] @ shape_functions(mesh, points).T
            across = 2 * np.pi * self._of_side(radii[..., None], side)[..., 0]
        if self.kind == "region":
            return np.asarray(np.abs(np.linalg.det(J)) * across * self._reference)
        corners = facet_sets(dim, np.vstack([np.zeros(dim - 1), np.eye(dim - 1)]))
        tangents = np.einsum("fpij,fkj->fpki", J, (corners[:, 1:] - corners[:, :1])[side])
        gram = np.einsum("fpki,fpli->fpkl", tangents, tangents)
        return np.asarray(np.sqrt(np.linalg.det(gram)) * across * self._reference)

    def _of_side(self, table: FloatArray, side: AnyArray) -> FloatArray:
        """Of values at the points of all sides those of one side a cell."""
        sides = table.reshape(len(table), *self._points.shape[:2], table.shape[2])
        return np.asarray(sides[np.arange(len(table)), side])

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Ending "FIELD_STATISTIC" of columns to their numbers in SI units, same on every rank."""
        for name in {*self.fields} & {*NODAL}:
            nodal_function(state, name)  # raises
        self._w.x.array[:] = (state.w or state.u).x.array
        rows = {} if self._evaluator is None else self._evaluator(state)
        grid = None if self._evaluator is None else self._evaluator.grid
        nodal = {
            name: with_ghosts(self.problem.V.dofmap.index_map, values)
            for name, values in rows.items()
            if grid is not None and self._table[name].centre == "node"
        }
        inside = [self._evaluated(piece) for piece in self.pieces]
        result: dict[str, FloatArray] = {}
        for name in self.fields:
            values = [
                self._at_points(name, piece, known, nodal, rows)
                for piece, known in zip(self.pieces, inside, strict=True)
            ]
            result |= self._numbers(name, values, nodal.get(name))
        return result

    def _evaluated(self, piece: Piece) -> dict[str, FloatArray]:
        """Fields with a formula at the points of a piece. Not collective."""
        widths = [self._table[name].evaluated for name in self._inside]
        shape = piece.weights.shape
        table = np.full((*shape, sum(widths)), np.nan)
        if piece.kernel is not None and len(piece.cells):
            table[..., piece.kernel.columns] = self._of_side(piece.kernel(piece.cells), piece.side)
        parts = np.split(table, np.cumsum(widths)[:-1], axis=2) if widths else []
        result = {}
        for name, part in zip(self._inside, parts, strict=True):
            rows = self._table[name].finished(part.reshape(shape[0] * shape[1], part.shape[2]))
            result[name] = rows.reshape(*shape, rows.shape[1])
        return result

    def _at_points(
        self,
        name: str,
        piece: Piece,
        inside: Mapping[str, FloatArray],
        nodal: Mapping[str, FloatArray],
        rows: Mapping[str, AnyArray],
    ) -> FloatArray:
        """A field at the quadrature points, shape (cells, points, components). Not collective."""
        if name in inside:
            return inside[name]
        if name in nodal:
            corners = nodal[name][self.problem.V.dofmap.list[piece.cells]]
            return np.einsum("fpn,fnc->fpc", self._shapes[piece.side], corners)
        values = np.asarray(rows[name], dtype=np.float64)[piece.cells]
        return np.repeat(values[:, None], piece.weights.shape[1], axis=1)

    def _numbers(
        self, name: str, values: Sequence[FloatArray], nodal: FloatArray | None
    ) -> dict[str, FloatArray]:
        """All that is asked for of a field. Collective.

        Args:
            values: At the quadrature points of each piece.
            nodal: At the local nodes, of a field of nodes.
        """
        width = self._table[name].columns
        size = self._plane(name, width)

        def columns(table: FloatArray) -> FloatArray:
            return np.column_stack([table[:, :size], np.linalg.norm(table, axis=1)])

        points = columns(np.concatenate([table.reshape(-1, width) for table in values]))
        # At a node between two materials stands the stress of the one where it is larger.
        several = self.kind == "region" and name in self._inside and len(self.pieces) > 1
        peaks = points if nodal is None or several else columns(nodal[self._nodes])
        weights = np.concatenate([piece.weights.ravel() for piece in self.pieces])
        samples = Samples(self.problem.body.comm, self.size, weights, points, peaks)
        result: dict[str, FloatArray] = {}
        for statistic, (reduction, number) in self._reductions.items():
            end = ending(statistic, "area" if self.kind == "surface" else "volume")
            numbers = reduction(samples, number)
            result[f"{name}_{end}"] = numbers[:size]
            if has_length(name, self._table[name]) and reduction.factor is None:
                result[f"{name}_length_{end}"] = numbers[size:]
        return result

    def _plane(self, name: str, width: int) -> int:
        """Number of components that are shown: vectors of a plane body have two."""
        flat = self._table[name].shape == "vector" and self._table[name].formula is None
        return self.problem.body.dim if flat else width


def sides_of(problem: Problem, kind: str, part: str | None) -> AnyArray:
    """Owned cells of a region, or beside owned facets, and the facets' numbers. Collective.

    Returns:
        Shape (n, 2); the number is 0 of a region.
    """
    body = problem.body
    if kind == "surface":
        prepare_facets(body.mesh)
        facets = np.asarray(body.owned_facets(str(part)))
        return integration_entities(body.mesh, facets).reshape(-1, 2)
    cells = body.owned_cells(part)  # of the whole body without a name
    return np.column_stack([cells, np.zeros_like(cells)])


def members(problem: Problem, kind: str, part: str | None, centre: str) -> IndexArray:
    """Owned nodes or cells of a part; cells of a surface are those beside it. Collective.

    Args:
        kind: "region", or another one: of a node all parts of the name that are no regions.
        part: Its name; None: the whole body.
        centre: "node" or "cell".

    Raises:
        MeshError: There is no such part, or it has no cells.
    """
    body, V = problem.body, problem.V
    if centre == "cell":
        cells = np.unique(sides_of(problem, kind, part)[:, 0])
        return cells[cells < len(body.owned_cells())].astype(np.int32)
    owned = V.dofmap.index_map.size_local
    if part is None:
        return np.arange(owned, dtype=np.int32)
    if kind != "region":
        nodes = part_nodes(body, V, part)
        return np.asarray(nodes[nodes < owned], dtype=np.int32)
    nodes = V.dofmap.list[body.owned_cells(part)]
    return np.flatnonzero(marked(V.dofmap.index_map, nodes)[:owned]).astype(np.int32)


def check_surface(body: Body, name: str, where: str = "") -> None:
    """Checks that numbers over a surface are defined. Collective.

    Args:
        where: Key of the case file, for the message.

    Raises:
        MeshError: The body has no such surface, or it has no facets.
    """
    try:
        body.surface(name)
    except MeshError as error:
        raise error.at(where) from None
    if not total(body.comm, len(body.owned_facets(name))):
        raise MeshError(
            f"the surface '{name}' has no facets", where=where, expected="a surface with facets"
        )
