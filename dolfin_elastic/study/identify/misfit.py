"""How far displacements at points are off, with derivatives by the unknowns of the problem."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.study.gradient.functionals import Functional, at_displacements
from dolfin_elastic.study.identify.measured import MeasuredField
from dolfin_elastic.study.identify.points import LocatedPoints


class PointMisfit(Functional):
    """sum w (u - u_measured)^2/(n s^2), as `LeastSquares` has it, at the end of the run.

    Args:
        sets: Displacement fields, and where their points are.
    """

    def __init__(self, problem: Problem, sets: list[tuple[MeasuredField, LocatedPoints]]) -> None:
        super().__init__("misfit", "", problem)
        self._sets = sets
        self.residuals: list[FloatArray] = []

    def value(self, forces: FloatArray) -> float:
        """See `Functional`."""
        self.residuals, result = [], 0.0
        for field, points in self._sets:
            found = points.displacements(self.problem.u)[:, list(field.components)]
            self.residuals.append(found - field.values)
            result += _factor(field) * float(np.sum(self.residuals[-1] ** 2))
        return result

    def by_unknowns(self, assembler: Assembler) -> FloatArray:
        """See `Functional`."""
        V, dim = self.problem.V, self.problem.body.dim
        result = np.zeros(assembler.size)
        for (field, points), off in zip(self._sets, self.residuals, strict=True):
            forces = np.zeros((len(points.mine), 1, dim))
            forces[:, 0, list(field.components)] = 2 * _factor(field) * off[points.mine]
            nodes, shapes = points.shapes(V)
            rows = summed(V.dofmap.index_map, nodes, shapes[:, :, None] * forces)
            result += at_displacements(assembler, rows)
        return result


def _factor(field: MeasuredField) -> float:
    return field.weight / float(np.sum(field.values**2))
