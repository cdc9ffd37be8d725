"""The linear solver inside Newton's method: what it is given, thrown away, and given up for."""

from __future__ import annotations

import logging

from petsc4py import PETSc

from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import (
    GMRES,
    LAST_DIRECT,
    PMultigrid,
    factorising,
    rigid_body_modes,
)
from dolfin_elastic.solvers.linear.schur import SchurSplit
from dolfin_elastic.solvers.petsc.options import Options

log = logging.getLogger("dolfin_elastic")


class LinearSolver:
    """A KSP for the tangent of one assembler.

    Args:
        assembler: Of the tangent.
        options: PETSc's, in force while it is set up.
        ksp: The solver; owned elsewhere.
        snes: Whose preconditioner's age is set.

    Attributes:
        direct: It factorises.
    """

    def __init__(
        self, assembler: Assembler, options: Options, ksp: PETSc.KSP, snes: PETSc.SNES
    ) -> None:
        self._assembler, self._options, self.ksp, self._snes = assembler, options, ksp, snes
        self._multigrid: PMultigrid | SchurSplit | None = None
        self._prepared, self.direct = False, False

    def set_up(self) -> None:
        """Takes its options, and multigrid if it wants that; with the options in force."""
        self.ksp.setFromOptions()
        pc = self.ksp.getPC()
        if pc.getType() == "python" and self._multigrid is None:
            problem = self._assembler.problem
            self._multigrid = (
                SchurSplit(problem, self._assembler) if problem.mixed else PMultigrid(problem)
            )
            pc.setPythonContext(self._multigrid)
            self.ksp.setFromOptions()
            pc.setFromOptions()
        self.direct = self.ksp.getType() == "preonly"  # the user may have chosen otherwise
        if not self.direct:
            self._attach_modes()

    def factorise_each_tangent(self) -> None:
        """Factorises each tangent: an old factorisation alone makes no Newton's method."""
        if self.direct:
            self._options.update({"snes_lag_preconditioner": 1})
            with self._options.in_force():
                self._snes.setFromOptions()

    def _attach_modes(self) -> None:
        """Rigid-body modes of the current places, which multigrid must keep."""
        problem = self._assembler.problem
        if problem.degree == 1 and not problem.mixed:
            modes = rigid_body_modes(problem.unknowns.U, problem.unknowns.moved)
            self._assembler.matrix.setNearNullSpace(modes)
            modes.destroy()

    def set_tangent(self, tangent: PETSc.Mat) -> None:
        """Uses a tangent that SNES does not hand on, with the preconditioner that is there."""
        # SNES would lag the preconditioner of its own linear solver only.
        self.ksp.getPC().setReusePreconditioner(self._prepared and not self.direct)
        self.ksp.setOperators(tangent)
        self._prepared = True

    def refresh(self) -> None:
        """Throws the preconditioner away and takes the rigid-body modes anew. Collective."""
        if not self.direct:
            self._attach_modes()
            self._prepared = False
            self.ksp.getPC().reset()
            if self._multigrid is not None:
                self._multigrid.refresh()

    def fall_back(self, reason: str) -> bool:
        """Goes to a linear solver that stands more. Collective.

        From conjugate gradients, which an indefinite tangent breaks, to GMRES, and from there to
        a factorisation where the problem is not too large for one.

        Args:
            reason: Why the present one failed.

        Returns:
            False if there is nothing left to fall back to.
        """
        if self.direct or "ksp_type" in self._options.users or "pc_type" in self._options.users:
            return False
        if self.ksp.getType() == "cg":
            log.info("conjugate gradients failed (%s): GMRES from here on", reason)
            self._options.update(GMRES)
            self.refresh()
            return True
        problem = self._assembler.problem
        if problem.num_dofs > LAST_DIRECT[problem.body.dim]:
            return False
        log.info("the iterative solver failed (%s): factorising", reason)
        self._options.update(factorising(problem.symmetric))
        with self._options.in_force(), self._options.input_errors():
            self.set_up()
        self.factorise_each_tangent()
        return True

    def destroy(self) -> None:
        """Frees what it owns, not the KSP. Collective."""
        if self._multigrid is not None:
            self._multigrid.destroy()
