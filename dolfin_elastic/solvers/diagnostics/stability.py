"""Whether an equilibrium is stable: the inertia of the tangent, and the weakest mode.

By Sylvester's law of inertia the factors L D L^T of a symmetric matrix have as many negative pivots
as it has negative eigenvalues.  With a pressure beside the displacement the tangent is that of a
saddle point: a stable one has exactly as many negative eigenvalues as there are pressures.

Sources: G. Golub and C. Van Loan, Matrix Computations (2013), section 8.1.5; M. Benzi, G. Golub and
J. Liesen, Acta Numerica 14 (2005), section 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.newton import Newton

if TYPE_CHECKING:
    from slepc4py import SLEPc

LIMIT = {2: 200_000, 3: 40_000}
"""Unknowns up to which tangents are factorised here, by dimension.

At the limit a state takes about six seconds on one core, and up to four states are looked at.
"""

NEGATIVE_PIVOTS = 12
"""Index of their number in MUMPS's INFOG."""

CURVATURE_TOLERANCE = 1e-2
"""Relative residual of the solve that looks for negative curvature: the weakest modes have more
than this share of the right-hand side, and weigh most in the preconditioned norm."""

OLD_CURVATURE_TOLERANCE = 1e-3
"""The same with a preconditioner of an earlier tangent, in whose norm the weakest modes of this one
weigh less."""

CURVATURE_ITERATIONS = 200
"""Of that solve: ten serve for a preconditioner of this tangent, more where it is an old one."""

_DIGITS = 1e-3
"""Relative accuracy of the weakest mode's stiffness."""


def negative_pivots(pc: PETSc.PC, assembler: Assembler) -> int | None:
    """Negative eigenvalues of a factorised tangent that a stable body has not.

    As many as negative pivots (Sylvester's law of inertia), less those of the pressures, which
    belong to a saddle point.

    Args:
        pc: Its factorisation.
        assembler: Of the tangent.

    Returns:
        Their number; None where it is not MUMPS's of a symmetric matrix, or where there are fewer
        pivots than pressures, for then the tangent is singular.
    """
    if not _counts_pivots(pc):
        return None
    found = int(pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS)) - assembler.pressures
    return None if found < 0 else found


def _counts_pivots(pc: PETSc.PC) -> bool:
    return bool(pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps")


def negative_eigenvalues(newton: Newton) -> int | None:
    """Negative eigenvalues that a stable body has not, at the end of a Newton solve. Collective.

    Those of the last tangent that Newton's method has factorised are counted, one small step
    before the solution.  It is factorised anew only where there is none, or one with a shifted
    diagonal, whose eigenvalues are larger.

    Args:
        newton: The solver; scalar unknowns beside its fields add theirs.

    Returns:
        Their number; None where no symmetric factorisation is at hand.
    """
    pc = newton.ksp.getPC()
    if not (newton.linear.direct and newton.assembler.problem.symmetric and _counts_pivots(pc)):
        return None
    if newton.shift > 0.0 or not (newton.result.newton or newton.factorised):
        newton.factorise()
    below = negative_pivots(pc, newton.assembler)
    if below is None or newton.bordered is None:
        return below
    found = below + newton.bordered.negative()
    return None if found < 0 else found


def can_prove_stability(newton: Newton) -> bool:
    """Whether `is_proven_stable` has anything to go by. Not collective."""
    if not newton.assembler.problem.symmetric:
        return False
    if newton.linear.direct:
        return _counts_pivots(newton.ksp.getPC())
    return newton.bordered is None and (_by_gradients(newton) or _condenses(newton))


def _by_gradients(newton: Newton) -> bool:
    return newton.ksp.getType() == "cg" or newton.linear.left_gradients


def _condenses(newton: Newton) -> bool:
    """Whether pressures are split off, and can be eliminated for what follows."""
    return newton.linear.split is not None and not newton.assembler.problem.unknowns.stabilised


@stage("stability")
def is_stable(newton: Newton) -> bool | None:
    """Whether the tangent at the end of a Newton solve is that of a stable body. Collective.

    By the pivots of its factors; else by conjugate gradients, which build the Lanczos polynomials
    of the preconditioned tangent and meet a direction of negative curvature as soon as one of their
    Ritz values is negative.  A right-hand side with a part in every mode cannot be solved for
    before: the residual polynomial is 1 at zero and has to be small at each eigenvalue, a negative
    one, too.  Source: C. C. Paige and M. A. Saunders, SIAM J. Numer. Anal. 12 (1975) 617.

    Args:
        newton: The solver, after a solve that has converged.

    Returns:
        None where nothing tells, or conjugate gradients end otherwise.
    """
    if newton.linear.direct:
        below = negative_eigenvalues(newton)
        return None if below is None else below == 0
    told = can_prove_stability(newton) and _by_gradients(newton)
    return _is_positive_definite(newton) if told else None


def is_proven_stable(newton: Newton) -> bool:
    """Whether it is certain that the tangent is that of a stable body. Collective.

    As `is_stable`; with an iterative solver for displacement and pressure by conjugate gradients on
    the displacement's tangent with softer pressures eliminated, see `SofterVolume`: where it is
    positive definite, so is the body's; where it is not, nothing is certain.

    Args:
        newton: The solver, after a solve that has converged.
    """
    if newton.linear.direct or not (can_prove_stability(newton) and _condenses(newton)):
        return is_stable(newton) is True
    return _is_positive_definite(newton) is True


def _is_positive_definite(newton: Newton) -> bool | None:
    """Whether the last tangent is, by conjugate gradients; None: they tell nothing. Collective.

    With a pressure: whether it is with softer pressures eliminated.
    """
    assembler, split = newton.assembler, newton.linear.split
    if newton.shift > 0.0 or not (newton.result.newton or newton.factorised):
        newton.factorise()
    b = assembler.create_vector()
    b.array_w[assembler.displacement_dofs] = start_vector(assembler)
    assembler.remove_constrained(b)
    rtol = OLD_CURVATURE_TOLERANCE if newton.linear.kept else CURVATURE_TOLERANCE
    with stage("stability"):
        if split is not None:
            reason = split.solve_softer(b, rtol, CURVATURE_ITERATIONS)
        else:
            x = b.duplicate()
            # Newton's solver may be GMRES by now; its preconditioner, as old as it may be, serves.
            gradients = PETSc.KSP().create(assembler.comm)
            gradients.setType("cg")
            gradients.setPC(newton.ksp.getPC())
            gradients.setOperators(*newton.ksp.getOperators())
            gradients.setTolerances(rtol=rtol, max_it=CURVATURE_ITERATIONS)
            gradients.solve(b, x)
            reason = gradients.getConvergedReason()
            gradients.destroy()
            x.destroy()
    b.destroy()
    if reason == PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT:
        return False
    return True if reason > 0 else None


@dataclass(frozen=True)
class Mode:
    """The motion of the displacements that the tangent resists least.

    Attributes:
        stiffness: v . K v / v . v, scalar fields following the displacement [N/m].
        motion: Owned entries of the displacement, of Euclidean norm 1.
    """

    stiffness: float
    motion: FloatArray


class Stability:
    """A factorised tangent. Collective; `destroy` it.

    Args:
        assembler: Its `matrix` is the tangent to be looked at.

    Attributes:
        sound: The factors exist and are finite; without, nothing else here is of use.
        negative: Negative eigenvalues beyond those of a stable body; None where the tangent is not
            symmetric, so that its pivots say nothing.
    """

    def __init__(self, assembler: Assembler) -> None:
        self.assembler, self.comm = assembler, assembler.comm
        self._symmetric = bool(assembler.problem.symmetric)
        self._ksp = PETSc.KSP().create(self.comm)
        self._ksp.setOptionsPrefix("elastic_doctor_")
        self._ksp.setType("preonly")
        with assembler.tangent.entries() as matrix:
            self._ksp.setOperators(matrix)
            self.sound, self.negative = self._factorise(), None
        if self.sound and self._symmetric:
            self.negative = negative_pivots(self._ksp.getPC(), assembler)

    def _factorise(self) -> bool:
        pc = self._ksp.getPC()
        pc.setType("cholesky" if self._symmetric else "lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        # Room for pivots; without ScaLAPACK at the root, which hides signs; null pivots are met.
        for number, value in ((14, 80), (13, 1), (24, 1), (20, 0)):
            factors.setMumpsIcntl(number, value)
        try:
            self._ksp.setUp()
            good = pc.getFailedReason() == PETSc.PC.FailedReason.NOERROR
        except PETSc.Error:
            good = False
        return largest(self.comm, float(not good)) == 0.0

    def solve(self, f: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = K^-1 f. Collective.

        Args:
            f: Right-hand side.
            x: Receives the solution.
        """
        self._ksp.solve(f, x)

    def weakest(self) -> Mode | None:
        """The mode of the most negative compliance, or else of the largest; None if none is found.

        The compliances, inverse stiffnesses, are eigenvalues of the displacement block of the
        inverse tangent, found by Krylov-Schur iterations.
        """
        from dolfin_elastic.core.startup.slepc import (
            SLEPc,  # few runs ask for a mode, all for pivots
        )

        shell = PETSc.Mat().createPython(
            ((self.assembler.size, None),) * 2, context=_Compliance(self), comm=self.comm
        )
        eps = SLEPc.EPS().create(self.comm)
        try:
            eps.setOptionsPrefix("elastic_doctor_")
            eps.setOperators(shell)
            kind = SLEPc.EPS.ProblemType
            eps.setProblemType(kind.HEP if self._symmetric else kind.NHEP)
            eps.setTolerances(tol=_DIGITS, max_it=50)
            which = SLEPc.EPS.Which
            order = [which.SMALLEST_REAL] if self.negative else [which.LARGEST_MAGNITUDE]
            return self._solved(eps, order[0])
        except PETSc.Error:  # "invalid inner product": the factors are not those of a matrix
            return None
        finally:
            eps.destroy()
            shell.destroy()

    def _solved(self, eps: SLEPc.EPS, which: SLEPc.EPS.Which) -> Mode | None:
        eps.setWhichEigenpairs(which)
        eps.setDimensions(nev=1)
        start = self.assembler.create_vector()
        start.array_w[self.assembler.displacement_dofs] = start_vector(self.assembler)
        self.assembler.remove_constrained(start)
        eps.setInitialSpace(start)
        with petsc_errors():
            eps.solve()
        start.destroy()
        if not eps.getConverged():
            return None
        vector = self.assembler.create_vector()
        compliance = complex(eps.getEigenpair(0, vector)).real
        motion = vector.array_r[self.assembler.displacement_dofs].copy()
        vector.destroy()
        size = float(np.sqrt(total(self.comm, float(np.sum(motion**2)))))
        if not (np.isfinite(compliance) and compliance != 0.0 and size > 0.0):
            return None
        return Mode(1.0 / compliance, motion / size)

    def destroy(self) -> None:
        """Frees the factors. Collective."""
        self._ksp.destroy()


class _Compliance:
    """The displacement block of the inverse tangent, zero where displacements are prescribed."""

    def __init__(self, stability: Stability) -> None:
        self._of = stability
        self._keep = np.zeros(stability.assembler.size)
        self._keep[stability.assembler.displacement_dofs] = 1.0
        self._f = stability.assembler.create_vector()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiplies by the compliance, as PETSc's MatMult. Collective.

        Args:
            matrix: The PETSc matrix that this one is the context of.
            x: Forces [N].
            y: Displacements [m], which it writes.
        """
        self._f.array_w[:] = x.array_r * self._keep
        self._of.assembler.remove_constrained(self._f)
        self._of.solve(self._f, y)
        y.array_w[:] *= self._keep
        self._of.assembler.remove_constrained(y)

    def destroy(self, matrix: PETSc.Mat) -> None:
        """Frees what it owns. Collective."""
        self._f.destroy()


def start_vector(assembler: Assembler) -> FloatArray:
    """Owned displacements that have a part in every mode, the same on any number of ranks."""
    problem = assembler.problem
    dim = problem.body.dim
    x = problem.unknowns.unknown_places[: len(assembler.displacement_dofs) // dim, :dim]
    waves = np.sin(1.7 * x.sum(axis=1)[:, None] / span(problem.body) + 2.3 * np.arange(dim))
    return np.asarray((1.0 + waves).ravel())


def curvature(assembler: Assembler, direction: FloatArray) -> float:
    """d . K d / d . d of the tangent as it is assembled, free entries only [N/m]. Collective.

    Args:
        assembler: Its tangent is assembled.
        direction: d, owned entries of all unknowns.

    A negative one proves that the tangent is not positive definite, without any factors.
    """
    d, image = assembler.create_vector(), assembler.create_vector()
    d.array_w[:] = direction
    assembler.remove_constrained(d)
    assembler.tangent.matrix.mult(d, image)
    square, work = d.dot(d), d.dot(image)
    d.destroy()
    image.destroy()
    return float(work / square) if square > 0.0 else np.inf
