"""Largest and smallest values, means and integrals of fields over surfaces and regions.

Integrals are over the undeformed part, of a plane body over its thickness and of an axisymmetric
one around the axis, by quadrature.  Fields with a formula, stresses and strains, are evaluated at
the quadrature points inside the cells; of stresses that is closer to equilibrium than the recovered
ones.  Other fields of nodes are interpolated by the shape functions, those of cells are constant.

Extremes of fields of nodes, recovered stresses too, are sought among the nodes of the part, those
of fields of cells among the quadrature points, as are those of stresses over a region of a body of
several materials, whose nodes show the larger stress of two.  Of a vector it is that of its length,
and that of each of its components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.jit.compile import compile_expression
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.model.kinematics import weight
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.cell_fields import CellKernel, cell_kernel, unknowns_of_outputs
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS, component_names

if TYPE_CHECKING:
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

Statistic = Literal["max", "min", "mean", "integral"]
"""What is asked for of a field over a part."""
_TRIPLES = ("principal_stresses", "principal_stretches")
"""Fields of three numbers that are no vector: they have no length."""
_WHERE = "output.probes"


@dataclass(frozen=True)
class _Piece:
    """The part of a surface or region in one material.

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
        fields: Names from `FIELDS`.

    Raises:
        InputError: A field that a material of the part does not have.
        MeshError: The part is empty.
    """

    def __init__(
        self,
        problem: Problem,
        kind: str,
        part: str,
        fields: Sequence[str],
        statistics: Sequence[Statistic],
    ) -> None:
        self.problem, self.kind, self.fields = problem, kind, tuple(fields)
        self.statistics = tuple(statistics)
        self._w = unknowns_of_outputs(problem)
        self._inside = tuple(name for name in fields if FIELDS[name].formula is not None)
        others = [n for n in fields if n not in self._inside or FIELDS[n].centre == "node"]
        self._evaluator = Evaluator(problem, others) if others else None
        self._points, self._reference = self._quadrature()
        body = problem.body
        sides = (
            integration_entities(body.mesh, np.asarray(body.owned_facets(part))).reshape(-1, 2)
            if kind == "surface"
            else np.column_stack([body.owned_cells(part), np.zeros_like(body.owned_cells(part))])
        )
        if not total(body.comm, len(sides)):
            raise MeshError(
                f"the {kind} '{part}' is empty", where=_WHERE, expected="a name that has members"
            )
        self._nodes = self._nodes_of(part)
        self._pieces = [self._piece(region, sides) for region in problem.regions]
        shapes = problem.V.element.basix_element.tabulate(0, self._points.reshape(-1, body.dim))
        self._shapes = np.asarray(shapes)[0, :, :, 0].reshape(*self._points.shape[:2], -1)

    def _quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Points in the reference cell, shape (sides, points, dim), and their weights (points,)."""
        dim, degree = self.problem.body.dim, 2 * self.problem.context.order
        simplex = (basix.CellType.interval, basix.CellType.triangle, basix.CellType.tetrahedron)
        if self.kind == "region":
            points, weights = basix.make_quadrature(simplex[dim - 1], degree)
            return np.asarray(points)[None], np.asarray(weights)
        points, weights = basix.make_quadrature(simplex[dim - 2], degree)
        corners = np.asarray(basix.geometry(simplex[dim - 1]))
        facets = basix.topology(simplex[dim - 1])[dim - 1]
        sides = [
            corners[facet[0]] + points @ (corners[facet[1:]] - corners[facet[0]])
            for facet in facets
        ]
        return np.array(sides), np.asarray(weights)

    def _nodes_of(self, part: str) -> IndexArray:
        """Nodes of the part that this rank has, ghosts too. Collective."""
        problem = self.problem
        if self.kind == "surface":
            facets = problem.body.surface(part)
            dim = problem.body.mesh.topology.dim
            return np.asarray(fem.locate_dofs_topological(problem.V, dim - 1, facets))
        return np.unique(problem.V.dofmap.list[problem.body.owned_cells(part)])

    def _piece(self, region: MaterialRegion, sides: AnyArray) -> _Piece:
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
        return _Piece(cells, here[:, 1], kernel, self._weights(cells, here[:, 1]))

    def _weights(self, cells: IndexArray, side: AnyArray) -> FloatArray:
        """Weights of the quadrature points [m^2 or m^3]; shape (cells, points). Collective.

        Args:
            cells: Owned cells.
            side: Number of the facet of each.
        """
        problem, mesh = self.problem, self.problem.body.mesh
        dim = problem.body.dim
        J = ufl.Jacobian(mesh)
        across = weight(problem.geometry, problem.X, None)
        columns = [J[i, j] for i in range(dim) for j in range(dim)]
        columns.append(ufl.as_ufl(1.0) if across is None else across)
        points = self._points.reshape(-1, dim)
        expression = compile_expression(mesh.comm, ufl.as_vector(columns), points, problem.jit)
        shape = (len(cells), len(points), dim * dim + 1)
        everywhere = np.asarray(expression.eval(mesh, cells)).reshape(shape)
        table = self._of_side(everywhere, side)
        jacobians = table[..., :-1].reshape(*table.shape[:2], dim, dim)
        scale = table[..., -1] * (1.0 if across is not None else problem.thickness)
        if self.kind == "region":
            return np.asarray(np.abs(np.linalg.det(jacobians)) * scale * self._reference)
        kind = basix.CellType.triangle if dim == 2 else basix.CellType.tetrahedron
        corners, facets = np.asarray(basix.geometry(kind)), basix.topology(kind)[dim - 1]
        edges = np.array([corners[f[1:]] - corners[f[0]] for f in facets])[side]
        tangents = np.einsum("fpij,fkj->fpki", jacobians, edges)
        gram = np.einsum("fpki,fpli->fpkl", tangents, tangents)
        return np.asarray(np.sqrt(np.linalg.det(gram)) * scale * self._reference)

    def _of_side(self, table: FloatArray, side: AnyArray) -> FloatArray:
        """Of values at the points of all sides those of one side a cell."""
        sides = table.reshape(len(table), *self._points.shape[:2], table.shape[2])
        return np.asarray(sides[np.arange(len(table)), side])

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Ending "FIELD_STATISTIC" of columns to their numbers in SI units, same on every rank."""
        self._w.x.array[:] = (state.w or state.u).x.array
        rows = {} if self._evaluator is None else self._evaluator(state)
        grid = None if self._evaluator is None else self._evaluator.grid
        nodal = {
            name: grid.with_ghosts(np.asarray(values, dtype=np.float64))
            for name, values in rows.items()
            if grid is not None and FIELDS[name].centre == "node"
        }
        inside = [self._evaluated(piece) for piece in self._pieces]
        found: dict[str, FloatArray] = {}
        for name in self.fields:
            values = [
                self._at_points(name, piece, known, nodal, rows)
                for piece, known in zip(self._pieces, inside, strict=True)
            ]
            found |= self._numbers(name, values, nodal.get(name))
        return found

    def _evaluated(self, piece: _Piece) -> dict[str, FloatArray]:
        """Fields with a formula at the points of a piece. Not collective."""
        widths = [FIELDS[name].evaluated for name in self._inside]
        shape = piece.weights.shape
        table = np.full((*shape, sum(widths)), np.nan)
        if piece.kernel is not None and len(piece.cells):
            table[..., piece.kernel.columns] = self._of_side(piece.kernel(piece.cells), piece.side)
        parts = np.split(table, np.cumsum(widths)[:-1], axis=2) if widths else []
        found = {}
        for name, part in zip(self._inside, parts, strict=True):
            rows = FIELDS[name].finished(part.reshape(shape[0] * shape[1], part.shape[2]))
            found[name] = rows.reshape(*shape, rows.shape[1])
        return found

    def _at_points(
        self,
        name: str,
        piece: _Piece,
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
        comm, width = self.problem.body.comm, FIELDS[name].columns
        own = np.zeros(width + 1)
        for piece, table in zip(self._pieces, values, strict=True):
            own[:-1] += np.einsum("fp,fpc->c", piece.weights, table)
            own[-1] += piece.weights.sum()
        sums = np.asarray(total(comm, own))
        everywhere = np.concatenate([table.reshape(-1, width) for table in values])
        # At a node between two materials stands the stress of the one where it is larger.
        several = self.kind == "region" and name in self._inside and len(self._pieces) > 1
        among = everywhere if nodal is None or several else nodal[self._nodes]
        size = self._plane(name, width)
        found: dict[str, FloatArray] = {}
        over = "area" if self.kind == "surface" else "volume"
        for statistic in self.statistics:
            if statistic == "mean":
                found[f"{name}_mean"] = (sums[:-1] / sums[-1])[:size]
            elif statistic == "integral":
                found[f"{name}_{over}_integral"] = sums[:-1][:size]
            else:
                sign = 1.0 if statistic == "max" else -1.0
                found[f"{name}_{statistic}"] = _largest(comm, sign * among[:, :size]) * sign
                if width == 3 and name not in _TRIPLES:
                    lengths = np.linalg.norm(among, axis=1, keepdims=True)
                    found[f"{name}_length_{statistic}"] = _largest(comm, sign * lengths) * sign
        return found

    def _plane(self, name: str, width: int) -> int:
        """Number of components that are shown: vectors of a plane body have two."""
        flat = FIELDS[name].shape == "vector" and FIELDS[name].formula is None
        return self.problem.body.dim if flat else width


def _largest(comm: MPI.Comm, rows: FloatArray) -> FloatArray:
    """Largest value of each column on all ranks; nan where no row has one. Collective."""
    known = np.where(np.isnan(rows), -np.inf, rows)
    found = np.max(comm.allgather(known.max(axis=0, initial=-np.inf)), axis=0)
    return np.where(np.isinf(found), np.nan, found)


def columns_of(stem: str, values: Mapping[str, FloatArray], *, plain: bool) -> dict[str, float]:
    """Columns of the history.

    Args:
        values: What `PartNumbers` gives.
        plain: Means have the name of the field alone.
    """
    return {
        column: float(number)
        for name, numbers in values.items()
        for column, number in zip(
            component_names(
                f"{stem}_{name.removesuffix('_mean') if plain else name}", len(numbers)
            ),
            numbers,
            strict=True,
        )
    }
