"""What one material region remembers, at its points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.jit.compile import JitOptions
from dolfin_elastic.core.jit.point_roots import OfPoints, PointRoots
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.materials.memory import (
    ImplicitMemory,
    ImplicitStep,
    Memory,
    Root,
    Variable,
    in_a_row,
)
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.problem.material_regions import MaterialRegion

ROUND_OFF = 1e-12
"""What a value may differ from its start by and count as unchanged."""
_WELL_POSED = 10.0
"""Condition up to which points determine orthonormal polynomials: rules of tetrahedra up to degree
11 have 1 to 9 for polynomials of half their degree, and 30 to 200 where there are hardly more
points than polynomials."""
_DEPENDENT = 1e-9
"""Singular value over the largest one below which rows are linearly dependent."""


def polynomials_through(
    kind: basix.CellType, points: FloatArray
) -> tuple[int, FloatArray, FloatArray]:
    """Polynomials of the least degree that take any values at some points of a cell.

    They may be more than the points: six of a triangle may lie on one conic, so that cubics are
    needed.  Then the values choose a polynomial of the highest degree that the points determine, by
    least squares, and what is left at the points is taken by further polynomials as small as they
    can be in L2.  So values of a polynomial of that degree give it everywhere, equal ones a
    constant; the smallest polynomial of all would be one only at the points.

    Args:
        points: Shape (points, dim).

    Returns:
        The degree, values at the points of those at the nodes of the discontinuous element of that
        degree, shape (points, nodes), and the way back, shape (nodes, points).
    """

    def of_degree(degree: int, places: FloatArray = points) -> FloatArray:
        """Orthonormal polynomials at places, the lowest degree first."""
        legendre = basix.PolynomialType.legendre
        return np.asarray(basix.tabulate_polynomials(legendre, kind, degree, places).T)

    order = next(n for n in count() if np.linalg.matrix_rank(of_degree(n)) == len(points))
    low = next(table for n in range(order, -1, -1) if _determined(table := of_degree(n)))
    high, first = of_degree(order)[:, low.shape[1] :], np.linalg.pinv(low)
    left = np.eye(len(points)) - low @ first
    rest = np.linalg.pinv(left @ high, rcond=_DEPENDENT) @ left
    fit = np.vstack([first @ (np.eye(len(points)) - high @ rest), rest])
    element = basix.ufl.element("DG", kind, order)
    table = np.asarray(element.tabulate(0, points)[0]).reshape(len(points), -1)
    return order, table, of_degree(order, element.basix_element.points) @ fit


def _determined(table: FloatArray) -> bool:
    """Whether values at points determine polynomials, without multiplying their errors.

    Args:
        table: Orthonormal polynomials at the points, shape (points, polynomials).
    """
    return table.shape[1] <= len(table) and bool(np.linalg.cond(table) < _WELL_POSED)


class RegionHistory:
    """The history of one material region. Collective to make.

    Its values are polynomials in each cell, discontinuous, see `polynomials_through`: at the points
    of integration they are exact, and the stress has a value everywhere.

    Args:
        degree: Of the quadrature of the region's internal forces.

    Attributes:
        name: That of the material region, as the case has it.
        memory: What the region's law remembers.
        law: The region's law over a step.
        points: Of the reference cell, shape (points, dim).
        cells: The owned ones.
        values: Of the variables, at the nodes of these cells.
        step: Constants of the law over a step, by name.
    """

    def __init__(self, body: Body, region: MaterialRegion, degree: int) -> None:
        mesh, kind = body.mesh, body.mesh.basix_cell()
        memory, self.name = region.law.memory, region.name
        assert memory is not None
        self.memory: Memory = memory
        self.points = basix.make_quadrature(kind, degree)[0]
        order, self._table, self._to_nodes = polynomials_through(kind, self.points)
        self.cells = region.cells
        self._spaces = {
            size: fem.functionspace(mesh, ("DG", order, (size,)))
            for size in {v.size for v in (*memory.variables, *memory.seen, *memory.told)}
        }
        dofmap = next(iter(self._spaces.values())).dofmap
        rows = dofmap.list[region.cells].reshape(-1)
        self._size = len(rows)
        # One region has all rows in their order, which a slice copies several times as fast.
        whole = np.array_equal(rows, np.arange(self._size))
        self._rows: IndexArray | slice = slice(self._size) if whole else rows
        every = (*memory.seen, *memory.told)
        self._past = {v.name: fem.Function(self._spaces[v.size]) for v in every}
        numbers = memory.step(0.0, passes=False)
        self.step = {name: fem.Constant(mesh, value) for name, value in numbers.items()}
        past = {v.name: v.value(self._past[v.name]) for v in every}
        self._order = order
        self._found: OfPoints | None = None
        law = memory.over_step(past, self.step)
        if isinstance(memory, ImplicitMemory):
            law = memory.with_root(past, self.step, self._make_root(memory.unknowns))
        assert isinstance(law, SteppedLaw)
        self.law = law
        self.values: dict[str, FloatArray] = {}
        self._room: FloatArray | None = None  # of what is evaluated at the end of a step
        self._start()

    def _make_root(self, unknowns: tuple[Variable, ...]) -> Root:
        """The unknowns of equations at the points, as coefficients of forms."""
        mesh, size = next(iter(self._spaces.values())).mesh, sum(v.size for v in unknowns)
        spaces = [fem.functionspace(mesh, ("DG", self._order, (n,))) for n in (size, size * size)]
        self._found, self._inverse = OfPoints(spaces[0]), fem.Function(spaces[1])
        start = np.concatenate([v.at_start for v in unknowns])
        self._found.x.array.reshape(-1, size)[:] = start
        return Root(unknowns, self._found, self._inverse)

    def solves_by(self, F: Callable[[], Expr], w: fem.Function, jit_options: JitOptions) -> None:
        """Says of which F equations at the points are, where there are any.

        Args:
            F: Gives the deformation gradient without growth.
        """
        if self._found is not None:
            self._found.make = lambda: self._make_roots(F(), w, jit_options)

    def renew(self) -> None:
        """What equations at the points depend on has changed. Not collective."""
        if self._found is not None and self._found.roots is not None:
            self._found.roots.renew()

    @property
    def solves(self) -> bool:
        """There are equations at the points."""
        return self._found is not None

    def follow(self) -> int:
        """Solves them; how many points of this rank have no root. Collective."""
        assert self._found is not None
        self._found.prepare()
        self._found.follow()
        return 0 if self._found.roots is None else self._found.roots.lost

    def _make_roots(self, F: Expr, w: fem.Function, jit_options: JitOptions) -> PointRoots:
        """Compiles the equations at the points. Collective."""
        assert isinstance(self.law, ImplicitStep)
        root, law = self.law.root, self.law
        return PointRoots(
            root.to_solve(law.equations(F)),
            (self._found, self._inverse),
            self.points,
            (self._table, self._to_nodes),
            [k for k, v in enumerate(root.variables) for _ in range(v.size)],
            self.cells,
            lambda: np.hstack([self._rows_of(v) for v in root.variables]),
            w=w,
            jit_options=jit_options,
        )

    def _rows_of(self, variable: Variable) -> FloatArray:
        """What the law over a step sees of a variable, at the nodes of the region."""
        values = self._past[variable.name].x.array.reshape(-1, variable.size)
        return np.asarray(values[self._rows])

    def _start(self) -> None:
        """The body at rest, outside of the region, too, where no law is to divide by zero."""
        at_rest = {v.name: v.at_start[None] for v in self.memory.variables}
        for name, values in self.memory.fold(at_rest, 0.0).items():
            self._past[name].x.array.reshape(-1, values.shape[1])[:] = values
        self.reset()

    def reset(self) -> None:
        """Forgets all: the body at rest. Not collective."""
        self.values = {v.name: np.tile(v.at_start, (self._size, 1)) for v in self.memory.variables}

    @property
    def changed(self) -> bool:
        """Whether a value differs from the start by more than round-off. Not collective."""
        memory = self.memory
        own = memory.unknowns if isinstance(memory, ImplicitMemory) else memory.variables
        return any(
            np.any(np.abs(self.values[v.name] - v.at_start) > ROUND_OFF * max(abs(v.start), 1.0))
            for v in own
        )

    def begin_step(self, dt: float, *, passes: bool, elastic: bool = False) -> None:
        """Sets the constants of the law over a step of a length [s]. Not collective.

        Args:
            passes: See `Memory.step`.
            elastic: See `Memory.elastic_step`.
        """
        constants = self.memory.step(dt, passes=passes)
        constants |= self.memory.elastic_step() if elastic else {}
        for name, value in constants.items():
            self.step[name].value = value

    def fold(self, dt: float) -> None:
        """Sets what the law over a step of a length [s] sees of the history. Not collective."""
        past = {v.name: self._past[v.name].x.array.reshape(-1, v.size) for v in self.memory.seen}
        if isinstance(self._rows, slice):
            out = {name: values[self._rows] for name, values in past.items()}
            self.memory.fold_into(self.values, dt, out)
            return
        for name, values in self.memory.fold(self.values, dt).items():
            past[name][self._rows] = values

    def tell(self, dt: float) -> None:
        """Sets what the energies of the law over a step need beside `past`. Not collective.

        Args:
            dt: Length of the step [s].
        """
        if not self.memory.told:
            return
        at_points = {name: self._at_points(values) for name, values in self.values.items()}
        for name, values in self.memory.tell(at_points, dt).items():
            told = self._past[name].x.array.reshape(-1, values.shape[1])
            told[self._rows] = self._at_nodes(values)

    def _at_points(self, values: FloatArray) -> FloatArray:
        """Of all points in a row, from those at nodes; of one-point rules both are the same."""
        return values if len(self.points) == 1 else self._moved(self._table, values)

    def _at_nodes(self, values: FloatArray) -> FloatArray:
        """The inverse."""
        return values if len(self.points) == 1 else self._moved(self._to_nodes, values)

    def _moved(self, table: FloatArray, values: FloatArray) -> FloatArray:
        size = values.shape[1]
        rows = values.reshape(len(self.cells), table.shape[1], size)
        return np.einsum("kn,cnj->ckj", table, rows).reshape(-1, size)

    @property
    def past(self) -> list[fem.Function]:
        """What the law over a step sees of the history, see `Memory.seen`."""
        return list(self._past.values())

    def numbers_at_end(self, law: SteppedLaw, F: Expr) -> Expr:
        """All that `commit` takes, as one UFL vector."""
        return in_a_row(self.memory.found, law.at_end(F))

    def commit(self, numbers: CellExpression, dt: float) -> None:
        """Takes over the present state at the end of a step. Not collective.

        Args:
            numbers: Of `numbers_at_end`, at the points.
            dt: Length of the step [s].
        """
        found = self.memory.found
        size = sum(v.size for v in found)
        if self._room is None:
            self._room = np.empty((len(self.cells), len(self.points) * size))
        now: FloatArray = numbers.eval(self.cells, self._room).reshape(-1, size)
        values = self.values
        if self.memory.pointwise:
            values = {name: self._at_points(x) for name, x in values.items()}
        else:
            now = self._at_nodes(now)
        parts = np.split(now, np.cumsum([v.size for v in found])[:-1], axis=1)
        by_name = {v.name: part for v, part in zip(found, parts, strict=True)}
        followed = self.memory.follow(values, by_name, dt)
        if self.memory.pointwise:
            followed = {name: self._at_nodes(x) for name, x in followed.items()}
        # What is no variable's own array stands in the room of the next evaluation.
        self.values = {
            name: values if values is self.values.get(name) else np.array(values)
            for name, values in followed.items()
        }

    def largest(self, name: str) -> float:
        """Largest value of a scalar at the points of this rank; 0 where there is none."""
        if name not in self.values or not len(self.cells):
            return 0.0
        nodal = self.values[name].reshape(len(self.cells), -1)
        return float((nodal @ self._table.T).max())

    def functions(self) -> dict[str, fem.Function]:
        """The variables as functions, 0 outside of the region: copies."""
        result = {}
        for v in self.memory.variables:
            result[v.name] = fem.Function(self._spaces[v.size])
            result[v.name].x.array.reshape(-1, v.size)[self._rows] = self.values[v.name]
        return result

    def take(self, functions: Mapping[str, fem.Function]) -> None:
        """Takes over what `functions` gave."""
        for v in self.memory.variables:
            self.values[v.name] = functions[v.name].x.array.reshape(-1, v.size)[self._rows].copy()
