"""Watching det F: a cell that has turned inside out is no solution."""

from __future__ import annotations

import basix
import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI

from dolfin_elastic.compiler import compile_expression
from dolfin_elastic.problem import Problem
from dolfin_elastic.timing import stage

Floats = npt.NDArray[np.float64]
Extreme = tuple[float, Floats]
"""A value and the place of its cell in the reference configuration [m]."""


class JacobianWatch:
    """Smallest and largest det F of a body, at the points where the energy is integrated.

    Args:
        problem: Whose displacement is watched.
    """

    def __init__(self, problem: Problem) -> None:
        mesh = problem.body.mesh
        kind = getattr(basix.CellType, mesh.topology.cell_name())
        points, _ = basix.make_quadrature(kind, max(problem.rule(part) for part in problem.parts))
        J = ufl.det(problem.F(problem.w))
        self._J = compile_expression(mesh.comm, J, points, problem.jit)
        self._problem, self._points = problem, points
        self._cells = problem.body.owned_cells()

        self._seen: Floats | None = None
        self._found: tuple[Extreme, Extreme] | None = None

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

    def _state(self) -> Floats:
        """All that F depends on."""
        fields, cell = self._problem.w.x.array, self._problem.cell
        return fields if cell is None else np.append(fields, cell.H.value)

    def _evaluated(self) -> tuple[Extreme, Extreme]:
        mesh = self._problem.body.mesh
        with stage("assemble"):
            values = self._J.eval(mesh, self._cells)
        values = values.reshape(len(self._cells), len(self._points))
        values[np.isnan(values)] = -np.inf  # as bad as can be, on whichever rank
        low, high = values.min(axis=1), values.max(axis=1)
        mine: tuple[Extreme, Extreme] = (np.inf, np.zeros(3)), (-np.inf, np.zeros(3))
        if len(values):
            mine = (self._at(low, int(np.argmin(low))), self._at(high, int(np.argmax(high))))
        found = mesh.comm.allgather(mine)
        return (
            min((low for low, _ in found), key=lambda pair: pair[0]),
            max((high for _, high in found), key=lambda pair: pair[0]),
        )

    def _at(self, values: Floats, row: int) -> Extreme:
        mesh = self._problem.body.mesh
        nodes = mesh.geometry.dofmap[self._cells[row]]
        return float(values[row]), mesh.geometry.x[nodes].mean(axis=0)
