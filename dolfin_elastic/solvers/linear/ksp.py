"""The linear solver inside Newton's method: its preconditioner, and what follows its failure."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import GMRES, LAST_DIRECT, factorising, petsc_multigrid
from dolfin_elastic.solvers.linear.hierarchy import Multigrid
from dolfin_elastic.solvers.linear.multigrid import PMultigrid, rigid_body_modes
from dolfin_elastic.solvers.linear.schur import PressureSplit
from dolfin_elastic.solvers.linear.smoother import random_vector
from dolfin_elastic.solvers.linear.symmetric_part import SymmetricPart
from dolfin_elastic.solvers.messages import in_words
from dolfin_elastic.solvers.petsc.c_api import leave_preconditioner
from dolfin_elastic.solvers.petsc.options import Options

log = logging.getLogger("dolfin_elastic")


def null_combinations(assembler: Assembler, columns: FloatArray, small: float) -> FloatArray:
    """Combinations of given motions that lie in the null space of the assembled tangent.

    By a singular value decomposition of K times the motions, reduced to the triangular factor of
    each rank's rows: the product's Gram matrix would lose half the digits.  Collective.

    Args:
        columns: The motions: owned entries of all unknowns, of norm 1, shape (entries, n).
        small: Singular value, over the largest entry of the free diagonal, that counts as zero.

    Returns:
        Orthonormal coefficients of the motions, shape (n, found).
    """
    matrix, comm = assembler.tangent.matrix, assembler.comm
    diagonal = matrix.getDiagonal()
    free = np.ones(assembler.size, dtype=bool)
    free[assembler.prescribed_dofs] = False
    scale = largest(comm, float(np.max(np.abs(diagonal.array_r[free]), initial=0.0))) or 1.0
    diagonal.destroy()
    images = times(matrix, columns) / scale
    fixed = assembler.prescribed_dofs  # whose rows of K are the identity's
    images[fixed] = columns[fixed]
    images[assembler.tied_dofs] = 0.0  # whose rows only keep the matrix regular
    rows = np.vstack([images, np.zeros((images.shape[1],) * 2)])
    triangles = np.vstack(comm.allgather(np.linalg.qr(rows, mode="r")))
    _, sizes, mixes = np.linalg.svd(triangles, full_matrices=False)
    return np.asarray(mixes[sizes <= small].T)


def times(matrix: PETSc.Mat, columns: FloatArray) -> FloatArray:
    """A matrix times several vectors. Collective.

    Args:
        columns: Owned entries of the vectors, shape (entries, n).

    Returns:
        Owned entries of the products, of the same shape.
    """
    x, y = matrix.createVecs()
    images = np.zeros_like(columns)
    for k in range(columns.shape[1]):
        x.array_w[:] = columns[:, k]
        matrix.mult(x, y)
        images[:, k] = y.array_r
    x.destroy()
    y.destroy()
    return images


def _forget_pattern(pc: PETSc.PC) -> None:
    """Lets the next set-up know no nonzero pattern, though the matrix is the same. Collective.

    Another matrix in between makes PETSc forget the nonzero state of the one before.
    """
    A, P = pc.getOperators()
    entries = P.createVecLeft()
    other = PETSc.Mat().createDiagonal(entries)
    pc.setOperators(other, other)
    pc.setOperators(A, P)
    other.destroy()
    entries.destroy()


CHANGE = {"displacement": 0.5, "mixed": 0.05}
"""Relative change of the tangent from which its preconditioner is set up anew: with pressures a
changed tangent costs many more iterations."""

CHANGE_FOR_DIGITS = 0.15
"""The same where solves to eight digits follow: from there on one of them saves the 15 iterations
of a set-up, where the displacement is the only unknown."""

GROWTH = 1.2
"""Iterations a digit over those of the first solve from which it is, too."""

SPARE = {"displacement": 8.0, "mixed": 3.0}
"""Further iterations a digit that cost less than a set-up, which takes the time of 25 iterations
where the displacement is the only unknown."""


class Age:
    """Watches the tangents and iterations of one preconditioner.  Collective to make.

    Setting multigrid up costs as much as 10 to 50 iterations, so a preconditioner serves for
    several tangents; but one of an unloaded bracket took 483 iterations for a bracket bent by 50
    degrees, and 77 after it was set up anew. Two signs tell:

    - before a solve, how much the tangent has changed, |(K - K0) v| / |K0 v| for one random v: an
      estimate of the same quotient of Frobenius norms by one product (M. Hutchinson, Commun. Stat.
      Simul. Comput. 19 (1990) 433), whatever it is that has changed, shape, stress or time step;
    - after it, how many iterations a digit of the residual has taken.

    Attributes:
        kept: The preconditioner is of an earlier tangent than the last one.
        limit: Change of the tangent from which it is too old.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self.kept = assembler, False
        self._v, self._product = assembler.create_vector(), assembler.create_vector()
        rows = assembler.displacement_dofs
        first = self._v.getOwnershipRange()[0]
        self._v.array_w[rows] = random_vector(first, len(rows))
        self._v.array_w[assembler.prescribed_dofs] = 0.0
        self._then: FloatArray | None = None
        kind = "mixed" if assembler.problem.unknowns.auxiliary_fields else "displacement"
        self.limit, self._spare, self._first = CHANGE[kind], SPARE[kind], 0.0

    def forget(self) -> None:
        """There is no preconditioner any more. Not collective."""
        self._then, self.kept = None, False

    def begin(self, tangent: PETSc.Mat) -> None:
        """A preconditioner of this tangent is set up. Collective."""
        self._then, self._first, self.kept = self._times(tangent), 0.0, False

    def take(self, tangent: PETSc.Mat) -> bool:
        """Whether the preconditioner is too old for this tangent, or is none. Collective."""
        if self._then is None:
            return True
        self.kept = True
        now = self._times(tangent)
        squares = np.array([np.sum((now - self._then) ** 2), np.sum(self._then**2)])
        off, size = total(self._assembler.comm, squares)
        return not off <= self.limit**2 * size  # no numbers count as a change

    def served(self, iterations: int, digits: float) -> bool:
        """Whether a solve has taken no more iterations than a set-up saves. Not collective.

        Args:
            digits: By how many powers of ten the residual was to fall.
        """
        effort = iterations / digits
        self._first = self._first or effort
        return effort <= GROWTH * self._first + self._spare

    def _times(self, tangent: PETSc.Mat) -> FloatArray:
        tangent.mult(self._v, self._product)
        return np.asarray(self._product.array_r[self._assembler.displacement_dofs].copy())

    def destroy(self) -> None:
        """Frees its vectors. Collective."""
        self._v.destroy()
        self._product.destroy()


class LinearSolver:
    """A KSP for the tangent of one assembler.

    An iterative one keeps its preconditioner as long as `Age` says; with the user's option
    -snes_lag_preconditioner, as long as SNES does.

    Args:
        options: PETSc's, in force while it is set up.
        ksp: The solver; owned elsewhere.

    Attributes:
        direct: It factorises.
        left_gradients: It was CG, and is GMRES since that failed.
    """

    def __init__(
        self, assembler: Assembler, options: Options, ksp: PETSc.KSP, snes: PETSc.SNES
    ) -> None:
        self._assembler, self._options, self.ksp, self._snes = assembler, options, ksp, snes
        self._parts: Multigrid | PMultigrid | PressureSplit | SymmetricPart | None = None
        self._prepared, self.direct, self.left_gradients = False, False, False
        self._pattern = 0
        self._age: Age | None = None
        self._rtol = 0.0  # of the last solve; 0 where there was none
        # Whether the next solve may be Newton's last one, and whether the solve before was to be.
        self._may_be_last, self._was_exact = False, False
        self._each = False  # the preconditioner is set up for each tangent
        options.update(petsc_multigrid(options.all, options.users, assembler.problem.degree))

    def set_up(self) -> None:
        """Reads the options in force and attaches multigrid and near null space. Collective."""
        self.ksp.setFromOptions()
        if self._assembler.tied:
            self.ksp.setPostSolve(self._extend)
        self.direct = self.ksp.getType() == "preonly"  # the user may have chosen otherwise
        self._free_parts()
        problem, pc = self._assembler.problem, self.ksp.getPC()
        if pc.getType() == "fieldsplit" and problem.mixed:
            self._parts = PressureSplit(self._assembler, pc)
        elif pc.getType() == "python" and self.direct:
            self._parts = SymmetricPart(self._assembler, pc)
        elif pc.getType() == "python":
            self._parts = Multigrid(problem, pc, blocks=self._assembler.tangent.blocks)
        elif pc.getType() == "mg" and problem.degree > 1 and not problem.unknowns.auxiliary_fields:
            self._parts = PMultigrid(problem, pc)
        elif not self.direct:
            self._set_modes()
        self._free_age()
        if not self.direct and "snes_lag_preconditioner" not in self._options.users:
            self._age = Age(self._assembler)
            leave_preconditioner(self._snes)

    def _extend(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Makes tied unknowns of a solution follow the others. Collective."""
        self._assembler.extend(x.array_w)

    @property
    def split(self) -> PressureSplit | None:
        """The displacement and the pressure apart, where they are preconditioned so."""
        return self._parts if isinstance(self._parts, PressureSplit) else None

    @property
    def factors(self) -> PETSc.PC:
        """The PC that has the factors of a direct solver."""
        parts = self._parts
        return parts.factors if isinstance(parts, SymmetricPart) else self.ksp.getPC()

    @property
    def kept(self) -> bool:
        """The preconditioner is of an earlier tangent than the last one."""
        return self._age is not None and self._age.kept

    @contextmanager
    def left_as_it_is(self) -> Iterator[None]:
        """Nothing sets the preconditioner or the factors up anew meanwhile. Not collective."""
        pc = self.ksp.getPC()
        pc.setReusePreconditioner(True)
        try:
            yield
        finally:  # SNES decides anew for those of its own
            pc.setReusePreconditioner(self._age is not None)

    @contextmanager
    def many_digits(self) -> Iterator[None]:
        """A tangent that is taken meanwhile is for solves to many digits. Not collective.

        Factors are left; a preconditioner is set up anew where such a solve gains by it.
        """
        with self.left_as_it_is():
            if (age := self._age) is None:
                yield
                return
            limit, age.limit = age.limit, min(age.limit, CHANGE_FOR_DIGITS)
            try:
                yield
            finally:
                age.limit = limit

    def factorise_each_tangent(self) -> None:
        """Makes a direct solver factorise each tangent, for quadratic convergence."""
        if self.direct:
            self._options.update({"snes_lag_preconditioner": 1})
            with self._options.in_force():
                self._snes.setFromOptions()

    def _set_modes(self) -> None:
        """Rigid-body modes of the current places, for algebraic multigrid of the whole tangent."""
        problem = self._assembler.problem
        if not problem.unknowns.auxiliary_fields:
            modes = rigid_body_modes(problem.unknowns.U, problem.unknowns.single_valued)
            self._assembler.tangent.matrix.setNearNullSpace(modes)
            modes.destroy()

    def take(self, tangent: PETSc.Mat) -> None:
        """Takes a tangent, and sets the preconditioner up where it is none or too old. Collective.

        With the options in force, before SNES hands the tangent on, if it does.
        """
        pc, age = self.ksp.getPC(), self._age
        if self._pattern != self._assembler.tangent.pattern:
            # A sum of matrices that takes the place of another may have the nonzero state of that
            # one: PETSc would then reuse what is of the other pattern: factors, splits, products.
            self._pattern = self._assembler.tangent.pattern
            if self.direct:
                self.factors.reset()
            else:
                self.ksp.setOperators(tangent)
                _forget_pattern(pc)
        if age is None:
            if self.ksp != self._snes.ksp:  # else SNES does so
                pc.setReusePreconditioner(self._prepared and not self.direct)
                self.ksp.setOperators(tangent)
                self._prepared = True
            return
        served = self._has_served(age)
        if (age.take(tangent) or self._each or not served) and self._prepared:
            self.refresh()
        self.ksp.setOperators(tangent)
        if not self._prepared:
            pc.setReusePreconditioner(False)
            with suppress(PETSc.Error):  # the solve meets it again, and can say it
                self.ksp.setUp()
            age.begin(tangent)
        pc.setReusePreconditioner(True)
        self._prepared, self._rtol = True, self.ksp.getTolerances()[0]
        self._was_exact = self._may_be_last

    def _has_served(self, age: Age) -> bool:
        """Whether the preconditioner was good enough for the last solve."""
        if not 0.0 < self._rtol < 1.0:
            return True
        if self.ksp.getConvergedReason() < 0:
            return False
        # The digits of a solve that is to be exact, perhaps in another norm, take more iterations.
        return self._was_exact or age.served(self.ksp.getIterationNumber(), -np.log10(self._rtol))

    def judge(self, *, may_be_last: bool) -> None:
        """Lets conjugate gradients end by the residual, or by the preconditioned one. Local.

        Far from equilibrium the latter tells more of the error of a Newton step.  Equilibrium is
        judged by the residual, which, relative to the right-hand side, may be an order larger than
        the preconditioned one.

        Args:
            may_be_last: The next solve may be the last one: by the residual.
        """
        self._may_be_last = may_be_last
        if self.ksp.getType() == "cg" and "ksp_norm_type" not in self._options.users:
            norm = PETSc.KSP.NormType
            self.ksp.setNormType(norm.UNPRECONDITIONED if may_be_last else norm.DEFAULT)

    def refresh(self) -> None:
        """Rebuilds the preconditioner with the present rigid-body modes. Collective."""
        if self.direct:
            return
        self._prepared, self._rtol = False, 0.0
        if self._age is not None:
            self._age.forget()
        if isinstance(self._parts, PMultigrid | PressureSplit):
            # A reset of the whole PC would lose interpolation and splits.
            self._parts.refresh()
            return
        if self._parts is None:
            self._set_modes()
        self.ksp.getPC().reset()

    def fall_back(self, reason: str) -> bool:
        """Goes to a more robust linear solver. Collective.

        From a preconditioner that is kept to one that is set up for each tangent; from conjugate
        gradients, which an indefinite tangent breaks, to GMRES, and from there to a factorisation
        where the problem is not too large for one.

        Returns:
            False if there is nothing left to fall back to.
        """
        kept = self._age is not None and self._age.kept and not self._each
        # An old preconditioner may have become indefinite; only a tangent that is so is no matter
        # of age.
        if kept and "LINEAR_SOLVE" in reason and "INDEFINITE_MAT" not in reason:
            log.info("the iterative solver failed (%s): set up anew from here on", in_words(reason))
            self._each = True
            self.refresh()
            return True
        if self.direct or "ksp_type" in self._options.users or "pc_type" in self._options.users:
            return False
        self.judge(may_be_last=False)  # others may not know the norm of the last solve
        if self.ksp.getType() == "cg":
            log.info("conjugate gradients failed (%s): GMRES from here on", in_words(reason))
            self._options.update(GMRES)
            with self._options.in_force():
                self.ksp.setFromOptions()  # TS calls it no more
            self.left_gradients = True
            self.refresh()
            return True
        problem = self._assembler.problem
        if problem.num_dofs > LAST_DIRECT[problem.body.dim]:
            return False
        log.info("the iterative solver failed (%s): factorising", in_words(reason))
        self._assembler.tangent.to_entries()
        self._options.update(factorising(problem.symmetric))
        with self._options.in_force(), self._options.elastic_errors():
            self.set_up()
        self.factorise_each_tangent()
        return True

    def _free_parts(self) -> None:
        if self._parts is not None:
            self._parts.destroy()
        self._parts = None

    def _free_age(self) -> None:
        if self._age is not None:
            self._age.destroy()
        self._age = None

    def destroy(self) -> None:
        """Frees what it owns, not the KSP. Collective."""
        self._free_parts()
        self._free_age()
