"""Preconditioner for displacement and pressure: block triangular with a scaled mass matrix.

    P = | K  B^T |      S = - integral of (1/mu + 1/k) p q
        | 0   S  |

K is approximated by one multigrid cycle, S^-1 by a symmetric Gauss-Seidel sweep; PETSc's
PCFIELDSPLIT puts them together.  S is spectrally equivalent to the Schur complement whatever the
compressibility: Silvester & Wathen, SIAM J. Numer. Anal. 31 (1994); Elman, Silvester & Wathen,
Finite Elements and Fast Iterative Solvers (2014), section 4.2.

Of a mass matrix a sweep is nearly exact, for it is well conditioned; its row sums exceed it up to
five times in three dimensions, and take twice the iterations (A. J. Wathen, IMA J. Numer. Anal. 7
(1987) 449; A. J. Wathen and T. Rees, Electron. Trans. Numer. Anal. 34 (2009) 125).
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.weak_form import UNUSED
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.linear.hierarchy import Multigrid
from dolfin_elastic.solvers.linear.multigrid import PMultigrid, renew, rigid_body_modes

SOFTER = (2.0, 4.0, 8.0)
"""Bulk modulus over shear modulus of `SofterVolume`, one after the other, where the material has an
infinite one.

With the second, conjugate gradients take as many iterations as without a pressure, with the third
half as many again; the stiffness in bending is 14, 8 and 4 % too small.
"""


class PressureSplit:
    """Configures PCFIELDSPLIT with the fields "u" and "p", S for "p", and multigrid for "u".

    Args:
        assembler: Of a problem with a pressure as the one scalar field.  Collective.
        pc: Of type "fieldsplit", with its prefix set and the options in force.
    """

    def __init__(self, assembler: Assembler, pc: PETSc.PC) -> None:
        self._problem = assembler.problem
        start = assembler.tangent.matrix.getOwnershipRange()[0]
        # Rows of a split have to be sorted, but the displacement has an order of its own.
        self._order = np.argsort(assembler.displacement_dofs, kind="stable").astype(np.int32)
        moves = assembler.displacement_dofs[self._order]
        pressures = np.setdiff1d(np.arange(assembler.size), assembler.displacement_dofs)
        comm = assembler.comm
        self._u = PETSc.IS().createGeneral((moves + start).astype(PETSc.IntType), comm)
        self._u.setBlockSize(self._block_size())
        self._p = PETSc.IS().createGeneral((pressures + start).astype(PETSc.IntType), comm)
        self._S = _compliance_matrix(self._problem, pressures)
        pc.setFieldSplitIS(("u", self._u), ("p", self._p))
        pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, self._S)
        pc.setFromOptions()  # the user may want another approximation of the Schur complement
        pc.setOperators(assembler.tangent.matrix, assembler.tangent.matrix)
        pc.setUp()  # makes the solvers of the splits; they are set up at their first use
        self._ksp = pc.getFieldSplitSubKSP()[0]
        if self._problem.symmetric:
            K = self._ksp.getOperators()[1]
            K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            K.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        self._multigrid: Multigrid | PMultigrid | None = None
        inner = self._ksp.getPC()
        if inner.getType() == "python" and self._u.getBlockSize() == 1:
            inner.setType("gamg")  # multigrid in blocks needs the rows of a node together
            self._set_modes()
        elif inner.getType() == "python":
            self._multigrid = Multigrid(self._problem, inner, self._order)
        elif inner.getType() == "mg" and self._problem.degree > 1:
            self._multigrid = PMultigrid(self._problem, inner, self._order)
        else:
            self._set_modes()

    def _block_size(self) -> int:
        """Components of a node, where all nodes' rows are numbered in a row; else 1."""
        dim = self._problem.body.dim
        nodes = np.argsort(self._order).reshape(-1, dim)
        apart = (nodes[:, :1] % dim != 0) | (nodes != nodes[:, :1] + np.arange(dim))
        return 1 if total(self._problem.body.comm, int(apart.any())) else dim

    def _set_modes(self) -> None:
        unknowns = self._problem.unknowns
        modes = rigid_body_modes(unknowns.U, unknowns.single_valued, self._order)
        self._ksp.getOperators()[1].setNearNullSpace(modes)
        modes.destroy()

    def refresh(self) -> None:
        """Rebuilds multigrid, with the rigid-body modes of the current places."""
        if isinstance(self._multigrid, PMultigrid):
            self._multigrid.refresh()
            return
        if self._multigrid is None:
            self._set_modes()
        renew(self._ksp)

    def precondition(self, r: FloatArray) -> FloatArray:
        """One cycle of the displacement's multigrid, as old as it may be. Collective.

        Args:
            r: Forces at the owned displacements, in the order of their rows [N].
        """
        K = self._ksp.getOperators()[1]
        x, y = K.createVecs()
        x.array_w[:] = r
        self._ksp.getPC().apply(x, y)
        result = y.array_r.copy()
        x.destroy()
        y.destroy()
        return np.asarray(result)

    def destroy(self) -> None:
        """Frees what it owns, not the PC. Collective."""
        if self._multigrid is not None:
            self._multigrid.destroy()
        for thing in (self._ksp, self._u, self._p, self._S):
            thing.destroy()


class SofterVolume:
    """The displacement's tangent K + B^T W^-1 B with pressures of a softer material eliminated.

    The whole tangent is [K B^T; B -C], where C is the mass matrix M of the pressures over the bulk
    modulus k, and with linear displacements the stabilisation besides.  A body is stable where
    T = K + B^T C^-1 B is positive definite; where k is infinite, on displacements with B u = 0.

    W are the row sums of M times 1/k plus 1/(s mu), s of `SOFTER`.  They exceed M/k, because row
    sums exceed a mass matrix of linear elements (their difference is diagonally dominant), so where
    this operator is positive definite, T is.  Unlike T it is well conditioned, and unlike K it is
    not indefinite as soon as pressures exceed mu.  The stabilisation is at most M/mu, for it is the
    square of the pressure without its mean over each cell: with 1/mu in place of 1/(s mu) the same
    holds of it.

    Source: M. Fortin and R. Glowinski, Augmented Lagrangian Methods (1983), section I.2.

    Args:
        assembler: Of a problem with a pressure, whose tangent is assembled.  Collective.

    Attributes:
        moves: Owned rows of displacements, sorted.
    """

    def __init__(self, assembler: Assembler) -> None:
        problem, tangent = assembler.problem, assembler.tangent.matrix
        moves = np.zeros(assembler.size, dtype=bool)
        moves[assembler.displacement_dofs] = True
        self.moves, self._pressures = (
            np.flatnonzero(of).astype(np.int32) for of in (moves, ~moves)
        )
        self._problem = problem
        self._shares = [1.0] if problem.unknowns.stabilised else [1.0 / s for s in SOFTER]
        self._set_volume()
        start = tangent.getOwnershipRange()[0]
        rows = [(own + start).astype(PETSc.IntType) for own in (self._pressures, self.moves)]
        p, u = (PETSc.IS().createGeneral(own, assembler.comm) for own in rows)
        self._B = tangent.createSubMatrix(p, u)
        self._u, self._p = self._B.createVecs()
        p.destroy()
        u.destroy()

    def _set_volume(self) -> None:
        self._compliances = -_compliances(self._problem, self._shares.pop(0))[self._pressures]

    def stiffen(self) -> bool:
        """Takes the next of `SOFTER`; False after the last, and if stabilised. Collective."""
        if not self._shares:
            return False
        self._set_volume()
        return True

    def eliminate(self, product: FloatArray) -> FloatArray:
        """Forces K u + B^T W^-1 B u [N] at `moves`. Collective.

        Args:
            product: The whole tangent times u without pressures, all owned rows.
        """
        self._p.array_w[:] = product[self._pressures] / self._compliances
        self._B.multTranspose(self._p, self._u)
        return np.asarray(product[self.moves] + self._u.array_r)

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        for thing in (self._B, self._u, self._p):
            thing.destroy()


def _compliances(problem: Problem, share: float) -> FloatArray:
    """Row sums of - (share/mu + 1/k) p q at all local unknowns; of S where it is 1. Collective.

    Args:
        share: Of the compliance 1/mu that counts.
    """
    q = problem.unknowns.auxiliary("pressure", ufl.TestFunction(problem.W))
    form = _compliance(problem, problem.unknowns.scale["pressure"], share, q)
    sums = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
    fem.assemble_vector(sums.array, compiled(problem, [form])[0])
    sums.scatter_reverse(la.InsertMode.add)
    return np.asarray(sums.array)


def _compliance_matrix(problem: Problem, pressures: IndexArray) -> PETSc.Mat:
    """S, which the caller destroys. Collective.

    Of a space of its own: the entries of all unknowns would take the memory of the tangent.

    Args:
        pressures: Their owned rows among all unknowns, sorted; so are those of S.
    """
    from dolfinx.fem import petsc  # 6 ms of each start

    space, entries = collapsed(problem.W.sub(1))
    p, q, scale = ufl.TrialFunction(space), ufl.TestFunction(space), problem.unknowns.scale
    form = _compliance(problem, scale["pressure"] * p, 1.0, scale["pressure"] * q)
    result = petsc.assemble_matrix(compiled(problem, [form])[0])
    result.assemble()
    order = np.argsort(np.asarray(entries)[: len(pressures)], kind="stable")
    start = result.getOwnershipRange()[0]
    rows = PETSc.IS().createGeneral((order + start).astype(PETSc.IntType), problem.body.comm)
    sorted_result = result.createSubMatrix(rows, rows)
    rows.destroy()
    result.destroy()
    return sorted_result


def _compliance(problem: Problem, p: Expr, share: float, q: Expr) -> ufl.Form:
    """- integral of (share/mu + 1/k) p q."""
    factor = fem.Constant(problem.body.mesh, share)
    return sum(
        -(
            (factor / region.shear + region.compliance)
            if region.compliance
            else UNUSED / region.shear
        )
        * p
        * q
        * problem.weak_form.volume(region, 2)
        for region in problem.regions
    )
