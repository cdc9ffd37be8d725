"""Macroscopic stress of a periodic cell.

The macroscopic first Piola-Kirchhoff stress is the mean of P over the reference volume of the cell,
where holes count with P = 0; it is work-conjugate to the macroscopic deformation gradient: the
lemma of R. Hill, Proc. R. Soc. Lond. A 326 (1972) 131.
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem


class CellStress:
    """Mean stress of a periodic problem. Collective to make."""

    def __init__(self, problem: Problem) -> None:
        assert problem.cell is not None
        self.problem, self.cell = problem, problem.cell
        self._selector = problem.constant([[0.0] * 3] * 3)
        F = problem.weak_form.F(problem.w)
        self.mean = sum(
            ufl.inner(self._selector, problem.weak_form.response(region, problem.w).stress(F))
            * problem.weak_form.volume(region, problem.weak_form.rule(region))
            for region in problem.regions
        )
        self._form = self.compiled([self.mean])[0]

    def compiled(self, forms: list[ufl.Form]) -> list[fem.Form]:
        """Compiles forms. Collective."""
        return compile_forms(self.problem.body.comm, forms, self.problem.jit)

    def select(self, i: int, j: int) -> None:
        """Makes `mean` the integral of P_ij.

        Args:
            i: Row, from 0.
            j: Column, from 0.
        """
        self._selector.value[:] = 0.0
        self._selector.value[i, j] = 1.0

    def component(self, i: int, j: int) -> float:
        """Mean of P_ij over the cell [Pa]. Collective.

        Args:
            i: Row, from 0.
            j: Column, from 0.
        """
        self.select(i, j)
        self.follow()
        own = float(fem.assemble_scalar(self._form))
        return float(total(self.problem.body.comm, own)) / self.cell.volume

    def follow(self) -> None:
        """Solves what materials determine at points, at the present state. Collective."""
        if self.problem.history is not None:
            self.problem.history.follow()

    def stress(self) -> FloatArray:
        """Mean of P over the cell, dim x dim [Pa]. Collective."""
        dims = range(self.problem.body.dim)
        return np.array([[self.component(i, j) for j in dims] for i in dims])

    def force(self) -> float:
        """Size of the nodal forces that neighbours exert on the cell [N]. Collective.

        A face carries the stress times its area, spread over its nodes.  A state without a finite
        stress is no equilibrium, whatever the forces.
        """
        stress = self.stress()
        own = np.abs(stress).max() if np.isfinite(stress).all() else 0.0
        given = np.nan_to_num(np.abs(self.cell.stress)).max()
        area = self.cell.volume / self.cell.length
        return float(max(own, given) * area / np.sqrt(self.cell.pairing.face_nodes))

    def work(self) -> tuple[FloatArray, FloatArray]:
        """Forces V P/L [N] that do work on the cell, and displacements F L [m]. Collective.

        All of them are on one rank; the others have nothing.
        """
        length, local = self.cell.length, slice(None if self.problem.body.comm.rank == 0 else 0)
        forces = np.asarray(self.cell.volume * self.stress().reshape(-1) / length)
        return forces[local], self.cell.gradient.reshape(-1)[local] * length

    def numbers(self) -> dict[str, float]:
        """Macroscopic stress [Pa] and deformation gradient by name. Collective."""
        dims = range(self.problem.body.dim)
        P, F = self.stress(), self.cell.gradient
        result = {f"P{i + 1}{j + 1}": float(P[i, j]) for i in dims for j in dims}
        if len(dims) == 2:
            result["P33"] = self.component(2, 2)
        return result | {f"F{i + 1}{j + 1}": float(F[i, j]) for i in dims for j in dims}
