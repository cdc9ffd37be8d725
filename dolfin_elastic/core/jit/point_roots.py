"""Fields that follow from the unknowns by equations at each point, which are solved in each cell.

A law whose step has no closed form is a function of F and of unknowns z of its own, which r(F, z) =
0 determines.  z and the inverse of dr/dz are coefficients of the forms; before a kernel reads them
`roots.c` solves the equations at all points, by Newton's method in compiled code whose r and dr/dz
FFCx has written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit.cell_integrals import CellExpression, Following, Loops
from dolfin_elastic.core.jit.compile import JitOptions
from dolfin_elastic.core.types import FloatArray, IndexArray

ENOUGH = 1e-9
"""Last step over the size of what is solved for: it is taken, and Newton's method squares it."""
SMALL = 1e-3
"""Of the largest value of a variable: below it the size of a value does not count."""
LEAST = 1e-6
"""The same of variables that are zero everywhere: round-off of strains is below 1e-15 then."""


class PointRoots:
    """Equations at the points of integration of some cells. Collective to make.

    Args:
        equations: r and dr/dz, row by row, one UFL vector, of z, of the unknowns and of what else
            varies.
        result: Receive z at nodes of discontinuous elements, and the inverse of dr/dz, row by row,
            at the same nodes.
        points: Of the reference cell, shape (points, dim).
        tables: Values at the points from those at the nodes, shape (points, nodes), and the way
            back.
        variables: To which variable each number belongs, from 0 on.
        start: Gives z at the nodes from which the iteration begins, shape (rows of cells, size).

    Attributes:
        lost: Points at which no root was found last.
    """

    def __init__(
        self,
        equations: Expr,
        result: tuple[fem.Function, fem.Function],
        points: FloatArray,
        tables: tuple[FloatArray, FloatArray],
        variables: Sequence[int],
        cells: IndexArray,
        start: Callable[[], FloatArray],
        *,
        w: fem.Function,
        jit_options: JitOptions,
    ) -> None:
        (self._found, self._inverse), self._cells, self._start = result, cells, start
        self._w, size = w, len(variables)
        sizes = {"N": size, "NQ": len(points), "NN": tables[0].shape[1]}
        loops = Loops("roots.c", sizes)
        self._kernel = CellExpression(equations, points, w, jit_options, loops, follows=False)
        dofmap = self._found.function_space.dofmap
        self._rows = np.ascontiguousarray(dofmap.list[cells]).reshape(-1)
        self._tables = (
            np.ascontiguousarray(tables[0]),
            np.ascontiguousarray(tables[1]),
            np.asarray(variables, dtype=np.int32),
        )
        self._list = np.ascontiguousarray(dofmap.list)
        self.lost, self._place = 0, self._kernel.place_of(self._found)
        if self._kernel.kernel is None or self._place < 0:
            raise InputError(
                "the equations of a history depend on a field that is not evaluated in them",
                where="materials",
                expected="a field on the body's mesh, of scalars",
            )
        self._known: tuple[FloatArray, FloatArray] | None = None  # unknowns and constants

    def renew(self) -> None:
        """What else the equations depend on has changed. Not collective."""
        self._known = None

    def solve(self) -> None:
        """Solves at the present unknowns, unless that is done already. Not collective.

        Where a point has no root z is NaN.
        """
        w, constants = self._w.x.array, self._kernel.constants
        if self._known is not None:
            before, numbers = self._known
            if np.array_equal(before, w) and np.array_equal(numbers, constants):
                return
        start, largest = self._start(), np.zeros(len(self._tables[2]))
        self.lost = self._solve(start, np.abs(start).max(axis=0, initial=0.0), largest)
        if self.lost:
            # Where the size of z was not known by the start, points may only seem to be lost.
            self.lost = self._solve(start, largest.copy(), largest)
        self._known = w.copy(), constants

    def _solve(self, start: FloatArray, sizes: FloatArray, largest: FloatArray) -> int:
        """Solves at all points; how many are lost.

        Args:
            start: See `PointRoots`.
            sizes: Of each number of z.
            largest: Receives the same of what is found.
        """
        found, size = self._found.x.array, len(sizes)
        found.reshape(-1, size)[self._rows] = start
        variable = self._tables[2]
        of_variable = np.zeros(variable.max() + 1)
        np.maximum.at(of_variable, variable, sizes)
        least = np.maximum(SMALL * of_variable, LEAST)[variable]
        where = (self._place, *self._tables, least, np.array([ENOUGH]), self._list)
        values = (len(found) // size, found, self._inverse.x.array, largest)
        return self._kernel.call("solve", self._cells, *where, *values)


class OfPoints(Following):
    """A coefficient that `PointRoots` finds; without any it stays as it is.

    Attributes:
        make: Makes the equations; collective.
    """

    make: Callable[[], PointRoots] | None = None
    roots: PointRoots | None = None

    def prepare(self) -> None:
        """See `Following`."""
        if self.roots is None and self.make is not None:
            self.roots = self.make()

    def follow(self) -> None:
        """See `Following`."""
        if self.roots is not None:
            self.roots.solve()
