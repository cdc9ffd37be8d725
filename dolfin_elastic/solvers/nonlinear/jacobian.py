"""Watching det F: a cell that has turned inside out is no solution."""

from __future__ import annotations

import basix
import numpy as np
import ufl
from mpi4py import MPI

from dolfin_elastic.core.jit import compile_expression
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem

Extreme = tuple[float, FloatArray]
"""A value and the place of its cell in the reference configuration [m]."""


class JacobianWatch:
    """Smallest and largest det F of a body, at the points where the energy is integrated.

    Where there are laws for small strains it sees the largest displacement gradient in their cells
    as well, for what they leave out are its squares.

    Args:
        problem: Whose displacement is watched.
    """

    def __init__(self, problem: Problem) -> None:
        mesh = problem.body.mesh
        kind = getattr(basix.CellType, mesh.topology.cell_name())
        points, _ = basix.make_quadrature(kind, max(problem.rule(part) for part in problem.parts))
        F = problem.F(problem.w)
        small = [part.cells for part in problem.parts if part.law.linear]
        self._small = np.concatenate(small) if small else None
        seen = [ufl.det(F)]
        if self._small is not None:
            H = F - ufl.Identity(3)
            seen.append(ufl.inner(H, H))
        self._columns = len(seen)
        self._seen_in = compile_expression(mesh.comm, ufl.as_vector(seen), points, problem.jit)
        self._problem, self._points = problem, points
        self._cells = problem.body.owned_cells()

        self._seen: FloatArray | None = None
        self._found: tuple[Extreme, Extreme] | None = None
        self._steepest: Extreme = (0.0, np.zeros(3))

    def smallest(self) -> Extreme:
        """Smallest det F and the reference place of its cell [m]. Collective."""
        return self.extremes()[0]

    def extremes(self) -> tuple[Extreme, Extreme]:
        """Smallest and largest det F and the reference places of their cells [m]. Collective.

        Asked again before anything has moved, nothing is evaluated again.
        """
        now = self._state()
        same = self._seen is not None and np.array_equal(self._seen, now)
        comm = self._problem.body.comm
        if self._found is None or not comm.allreduce(same, op=MPI.LAND):
            self._seen, self._found = now.copy(), self._evaluated()
        return self._found

    def steepest(self) -> Extreme:
        """Largest |grad u| in cells of linear laws, 0 without any, and its place [m]. Collective.

        The Frobenius norm: strains and rotations count alike.
        """
        self.extremes()
        return self._steepest

    def _state(self) -> FloatArray:
        """All that F depends on."""
        fields, cell = self._problem.w.x.array, self._problem.cell
        return fields if cell is None else np.append(fields, cell.H.value)

    def _evaluated(self) -> tuple[Extreme, Extreme]:
        mesh = self._problem.body.mesh
        with stage("assemble"):
            found = self._seen_in.eval(mesh, self._cells)
        found = found.reshape(len(self._cells), len(self._points), self._columns)
        self._steepest = self._largest(found)
        values = found[:, :, 0]
        values[np.isnan(values)] = -np.inf  # as bad as can be, on whichever rank
        low, high = values.min(axis=1), values.max(axis=1)
        mine: tuple[Extreme, Extreme] = (np.inf, np.zeros(3)), (-np.inf, np.zeros(3))
        if len(values):
            mine = (self._at(low, int(np.argmin(low))), self._at(high, int(np.argmax(high))))
        everywhere = mesh.comm.allgather(mine)
        return (
            min((low for low, _ in everywhere), key=lambda pair: pair[0]),
            max((high for _, high in everywhere), key=lambda pair: pair[0]),
        )

    def _largest(self, found: FloatArray) -> Extreme:
        """See `steepest`. Collective."""
        if self._small is None:
            return 0.0, np.zeros(3)
        steep = np.zeros(len(found))
        steep[self._small] = np.nan_to_num(np.sqrt(found[self._small, :, 1].max(axis=1)))
        mine: Extreme = (0.0, np.zeros(3))
        if len(steep):
            mine = self._at(steep, int(np.argmax(steep)))
        return max(self._problem.body.comm.allgather(mine), key=lambda pair: pair[0])

    def _at(self, values: FloatArray, row: int) -> Extreme:
        mesh = self._problem.body.mesh
        nodes = mesh.geometry.dofmap[self._cells[row]]
        return float(values[row]), mesh.geometry.x[nodes].mean(axis=0)
