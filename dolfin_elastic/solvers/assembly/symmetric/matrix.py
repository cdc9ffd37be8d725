"""Tangents by the half of their blocks, assembled again and again."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.matrix import Conditions
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks
from dolfin_elastic.solvers.assembly.two_stage.form import TwoStageForm


class SymmetricMatrix:
    """A tangent of a displacement as `SymmetricBlocks`; see `matrix.TangentMatrix`. Collective.

    Args:
        problem: Whose displacement is the only unknown.

    Attributes:
        petsc: The PETSc matrix, of type "python", owned here.
        blocks: Its blocks.
    """

    def __init__(self, problem: Problem, form: TwoStageForm) -> None:
        self._form, self.blocks = form, SymmetricBlocks(problem, form.form)
        blocks = self.blocks
        size = (blocks.halo.owned * blocks.dim, None)
        self.petsc = PETSc.Mat().createPython((size, size), blocks, problem.body.comm)
        self.petsc.setBlockSize(blocks.dim)
        self.petsc.setUp()

    def assemble(self, bcs: Conditions) -> None:
        """Assembles the form, with ones on the diagonal of constrained rows. Collective.

        Args:
            bcs: Dirichlet conditions, whose rows and columns are zero.
        """
        blocks = self.blocks
        self._form.assemble_half(blocks, bcs)
        owned = [bc.dof_indices() for bc in bcs]
        prescribed = np.concatenate([dofs[:count] for dofs, count in owned]) if owned else []
        blocks.assembled(np.unique(np.asarray(prescribed, dtype=np.int32)))
        self.petsc.stateIncrease()
        self.petsc.assemble()

    def aij(self) -> PETSc.Mat:
        """The same as an AIJ matrix, which the caller destroys. Collective."""
        return self.blocks.aij()

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        self.petsc.destroy()
