"""A direct solver for tangents that are nearly symmetric: of pressures that follow a surface.

The factors L D L^T of the symmetric part S = (A + A^T)/2 cost two thirds of those of A, and their
pivots count the negative eigenvalues of S, by which stability is judged.  GMRES with S^-1 then
needs few iterations to solve with A: the skew part is of the size of the pressures, S of the
moduli.

Source: Y. Saad, Iterative Methods for Sparse Linear Systems (2003), section 9.3.
"""

from __future__ import annotations

import logging

from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.solvers.assembly.assembler import Assembler

log = logging.getLogger("dolfin_elastic")

DIGITS = 1e-12
"""Residual of a solution over its right-hand side: about that of factors."""

LIMIT = 6
"""Iterations beyond which factors of A cost less: those of S save a third, of which each iteration
takes a sixth (three-dimensional body of 10,000 unknowns)."""

PAUSE = 8
"""Tangents that are factorised themselves before S is tried again: at most an eighth is lost."""

_ROOM, _ROOT, _NULL, _RIGHT_HAND_SIDE, _DETERMINANT = 14, 13, 24, 20, 33
"""Indices of MUMPS's ICNTL."""


def factorise(pc: PETSc.PC, matrix: PETSc.Mat, *, symmetric: bool) -> bool:
    """Makes a PC the factors of a matrix, by MUMPS. Collective.

    Returns:
        Whether they exist and are finite on all ranks.
    """
    pc.setOperators(matrix)
    pc.setType("cholesky" if symmetric else "lu")
    pc.setFactorSolverType("mumps")
    pc.setFactorSetUpSolverType()
    factors = pc.getFactorMatrix()
    factors.setMumpsIcntl(_ROOM, 80)  # for pivots
    factors.setMumpsIcntl(_ROOT, 1)  # without ScaLAPACK, which hides signs
    factors.setMumpsIcntl(_NULL, 1)  # null pivots are met
    factors.setMumpsIcntl(_RIGHT_HAND_SIDE, 0)  # distributed ones can fail (dolfinx#4362)
    factors.setMumpsIcntl(_DETERMINANT, int(not symmetric))
    try:
        pc.setUp()
        good = pc.getFailedReason() == PETSc.PC.FailedReason.NOERROR
    except PETSc.Error:
        good = False
    return largest(matrix.comm.tompi4py(), float(not good)) == 0.0


def symmetric_part(A: PETSc.Mat, before: PETSc.Mat | None = None) -> PETSc.Mat:
    """(A + A^T)/2, owned by the caller. Collective.

    Args:
        before: That of a matrix with the same entries, which is overwritten and returned.
    """
    how = PETSc.Mat.Structure
    S = A.transpose(PETSc.Mat() if before is None else before)
    S.axpy(1.0, A, how.DIFFERENT_NONZERO_PATTERN if before is None else how.SAME_NONZERO_PATTERN)
    S.scale(0.5)
    S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return S


class SymmetricPart:
    """A PC of type "python": A^-1 by GMRES and factors of S. Collective to make.

    Where GMRES takes more than `LIMIT` iterations, A itself is factorised, and so are the next
    `PAUSE` tangents, each time twice as many, before S is tried again: a step too large may pass by
    states that are far from symmetric.

    Attributes:
        factors: A PC: those of the last S, or of the last A.
    """

    def __init__(self, assembler: Assembler, pc: PETSc.PC) -> None:
        self._tangent = assembler.tangent
        self._S: PETSc.Mat | None = None
        self._ksp, self.factors = (of().create(assembler.comm) for of in (PETSc.KSP, PETSc.PC))
        self._ksp.setType("gmres")
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setTolerances(rtol=DIGITS, atol=0.0, max_it=LIMIT)
        self._ksp.setPC(self.factors)
        self._left, self._pause, self._pattern = 0, PAUSE, 0
        pc.setType("python")
        pc.setPythonContext(self)

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorises. Collective."""
        A = pc.getOperators()[1]
        if self._left:
            self._left -= 1
        else:
            if self._pattern != self._tangent.pattern:
                self._free()  # blocks are of other pairs of nodes now
                self._pattern = self._tangent.pattern
            # In the same matrix, so that MUMPS need not analyse it again.
            self._S = symmetric_part(A, self._S)
            if factorise(self.factors, self._S, symmetric=True):
                self._ksp.setOperators(A, self._S)
                return
        self._factorise(pc, A)

    def _factorise(self, pc: PETSc.PC, A: PETSc.Mat) -> None:
        self._free()
        if not factorise(self.factors, A, symmetric=False):
            pc.setFailedReason(PETSc.PC.FailedReason.SUBPC_ERROR)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = A^-1 x. Collective."""
        if self._S is not None:
            self._ksp.solve(x, y)
            if self._ksp.getConvergedReason() > 0:
                return
            self._left, self._pause = self._pause, 2 * self._pause
            log.info(
                "the tangent is far from symmetric: the next %d are factorised by LU, in place of "
                "LDL^T of their symmetric part",
                self._left,
            )
            self._factorise(pc, pc.getOperators()[1])
        self.factors.apply(x, y)

    def _free(self) -> None:
        if self._S is not None:
            self._S.destroy()
        self._S = None

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Frees what it owns. Collective."""
        self._free()
        self._ksp.destroy()
        self.factors.destroy()
