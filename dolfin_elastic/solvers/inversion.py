"""Watching det F: a cell that has turned inside out is no solution."""

from __future__ import annotations

import basix
import numpy as np
import numpy.typing as npt
import ufl

from dolfin_elastic.compiler import compile_expression
from dolfin_elastic.problem import Problem
from dolfin_elastic.timing import stage


class JacobianWatch:
    """Smallest det F of a body, at the points where the energy is integrated.

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

    def smallest(self) -> tuple[float, npt.NDArray[np.float64]]:
        """Smallest det F and the reference place of its cell [m]. Collective."""
        mesh = self._problem.body.mesh
        with stage("assemble"):
            values = self._J.eval(mesh, self._cells)
        values = values.reshape(len(self._cells), len(self._points)).min(axis=1)
        mine = (np.inf, np.zeros(3))
        if len(values):
            worst = int(np.argmin(values))
            nodes = mesh.geometry.dofmap[self._cells[worst]]
            mine = (float(values[worst]), mesh.geometry.x[nodes].mean(axis=0))
        return min(mesh.comm.allgather(mine), key=lambda pair: pair[0])
