"""Preconditioner for displacement and pressure: block triangular with a scaled mass matrix.

    P = | K  B^T |      S = - integral of (1/mu + 1/k) p q
        | 0   S  |

K is approximated by one multigrid cycle, S by its row sums.  S is spectrally equivalent to the
Schur complement whatever the compressibility: Silvester & Wathen, SIAM J. Numer. Anal. 31 (1994);
Elman, Silvester & Wathen, Finite Elements and Fast Iterative Solvers (2014), section 4.2.
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.weak_form import UNUSED
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.linear.choice import PMultigrid, rigid_body_modes


class SchurSplit:
    """PETSc python preconditioner for the unknowns of a mixed problem. Collective.

    Args:
        problem: With a pressure as the one scalar field.
        assembler: Knows which entries are displacements.
    """

    def __init__(self, problem: Problem, assembler: Assembler) -> None:
        self._problem = problem
        start = assembler.matrix.getOwnershipRange()[0]
        self._moves = assembler.moves
        others = np.ones(assembler.size, dtype=bool)
        others[assembler.moves] = False
        self._pressures = np.flatnonzero(others).astype(PETSc.IntType)
        comm = problem.body.comm
        self._is_u = PETSc.IS().createGeneral((assembler.moves + start).astype(PETSc.IntType), comm)
        self._is_u.setBlockSize(problem.body.dim)
        self._is_p = PETSc.IS().createGeneral(self._pressures + start, comm)
        self._inverse = 1.0 / self._schur_diagonal()
        self._K: PETSc.Mat | None = None
        self._B: PETSc.Mat | None = None
        self._pc: PETSc.PC | None = None
        self._multigrid = PMultigrid(problem) if problem.degree > 1 else None

    def _schur_diagonal(self) -> FloatArray:
        """Row sums of the scaled pressure mass matrix, negative, owned entries."""
        problem = self._problem
        scale = problem.unknowns.scale["pressure"]
        q = problem.unknowns.extra("pressure", ufl.TestFunction(problem.W))
        form = sum(
            -((1 / part.shear + part.compliance) if part.compliance else UNUSED / part.shear)
            * scale
            * q
            * problem.weak_form.volume(part, 2)
            for part in problem.regions
        )
        index_map, bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
        sums = la.vector(index_map, bs)
        fem.assemble_vector(sums.array, compiled(problem, [form])[0])
        sums.scatter_reverse(la.InsertMode.add)
        return np.asarray(sums.array[self._pressures])

    def setUp(self, pc: PETSc.PC) -> None:
        """Takes the blocks out of the tangent and sets multigrid up. Collective."""
        _, matrix = pc.getOperators()
        self._K = matrix.createSubMatrix(self._is_u, self._is_u, self._K)
        self._B = matrix.createSubMatrix(self._is_u, self._is_p, self._B)
        if self._pc is None:
            self._make(pc)
        assert self._pc is not None
        self._pc.setOperators(self._K, self._K)
        self._pc.setUp()

    def _make(self, pc: PETSc.PC) -> None:
        assert self._K is not None
        assert self._B is not None
        if self._problem.symmetric:
            self._K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self._K.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._attach_modes()
        self._pc = PETSc.PC().create(comm=self._K.comm)
        self._pc.setOptionsPrefix(pc.getOptionsPrefix() + "u_")
        if self._multigrid is None:
            self._pc.setType("gamg")
        else:
            self._pc.setType("python")
            self._pc.setPythonContext(self._multigrid)
        self._pc.setOperators(self._K, self._K)
        self._pc.setFromOptions()
        self._x, self._r = self._K.createVecs()
        self._p = self._B.createVecRight()

    def _attach_modes(self) -> None:
        assert self._K is not None
        if self._multigrid is None:
            modes = rigid_body_modes(self._problem.unknowns.U, self._problem.unknowns.moved)
            self._K.setNearNullSpace(modes)
            modes.destroy()

    def refresh(self) -> None:
        """Makes multigrid begin anew, with the rigid-body modes of the current places."""
        if self._pc is not None:
            self._attach_modes()
            self._pc.reset()
            if self._multigrid is not None:
                self._multigrid.refresh()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Pressure by the diagonal, then displacement by one cycle. Collective."""
        assert self._pc is not None
        assert self._B is not None
        rows = x.array_r
        p = rows[self._pressures] * self._inverse
        self._p.array_w[:] = p
        self._B.mult(self._p, self._r)
        self._r.array_w[:] = rows[self._moves] - self._r.array_r
        self._pc.apply(self._r, self._x)
        out = y.array_w
        out[self._pressures] = p
        out[self._moves] = self._x.array_r

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Frees everything. Collective."""
        things = [self._pc, self._K, self._B, self._is_u, self._is_p]
        if self._pc is not None:
            things += [self._x, self._r, self._p]
        for thing in things:
            if thing is not None:
                thing.destroy()
        self._pc = self._K = self._B = None
        if self._multigrid is not None:
            self._multigrid.destroy()
            self._multigrid = None
