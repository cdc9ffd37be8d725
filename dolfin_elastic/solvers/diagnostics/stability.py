"""Whether an equilibrium is stable: the inertia of the tangent, and the weakest mode.

By Sylvester's law of inertia the factors L D L^T of a symmetric matrix have as many negative pivots
as it has negative eigenvalues.  With a pressure beside the displacement the tangent is that of a
saddle point: a stable one has exactly as many negative eigenvalues as there are pressures.  Where
there are no such factors, conjugate gradients tell, see `negative_curvature`.

Sources: G. Golub and C. Van Loan, Matrix Computations (2013), section 8.1.5; M. Benzi, G. Golub and
J. Liesen, Acta Numerica 14 (2005), section 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Stability
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.factored_inertia import count_by_factors
from dolfin_elastic.solvers.diagnostics.negative_curvature import (
    Inertia,
    count_negative,
    start_vector,
)
from dolfin_elastic.solvers.linear.symmetric_part import factorise
from dolfin_elastic.solvers.linear.symmetric_part import symmetric_part as symmetric_part_of
from dolfin_elastic.solvers.nonlinear.newton import Newton

if TYPE_CHECKING:
    from slepc4py import SLEPc

LIMIT = {2: 200_000, 3: 40_000}
"""Unknowns up to which tangents are factorised here, by dimension.

At the limit a state takes about six seconds on one core, and up to four states are looked at.
"""

NEGATIVE_PIVOTS = 12
"""Index of their number in MUMPS's INFOG."""

_DIGITS = 1e-3
"""Relative accuracy of the weakest mode's stiffness."""


def negative_pivots(pc: PETSc.PC, assembler: Assembler) -> int | None:
    """Negative eigenvalues of a factorised tangent that a stable body has not.

    As many as negative pivots (Sylvester's law of inertia), less those of the pressures, which
    belong to a saddle point.

    Returns:
        Their number; None where it is not MUMPS's of a symmetric matrix, or where there are fewer
        pivots than pressures, for then the tangent is singular.
    """
    if not _counts_pivots(pc):
        return None
    negative = int(pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS)) - assembler.pressures
    return None if negative < 0 else negative


def _counts_pivots(pc: PETSc.PC) -> bool:
    return bool(pc.getType() == "cholesky" and pc.getFactorSolverType() == "mumps")


@dataclass(frozen=True)
class Verdict:
    """What `judge` has found.

    Attributes:
        stability: In plain data.
        direction: The motion of a body that is unstable, or about to be: owned entries of all
            unknowns; None where it is not known.
    """

    stability: Stability
    direction: FloatArray | None = None

    @property
    def stable(self) -> bool | None:
        """Whether the equilibrium is stable; None where it could not be judged."""
        negative = self.stability.negative
        return None if negative is None else negative == 0


@stage("stability")
def judge(newton: Newton, *, surely: bool = True) -> Verdict:
    """Whether the equilibrium at the end of a Newton solve is stable. Collective.

    The tangent judged is the last one of Newton's method, one small step before the solution.  It
    is assembled anew only where there is none, or one with a shifted diagonal, whose eigenvalues
    are larger.  That of a linear problem need not be looked at where its laws and springs have been
    checked to be positive definite: neither loads nor contacts change it.

    Args:
        newton: The solver, after a solve that has converged; scalar unknowns beside its fields add
            the inertia of their Schur complement.
        surely: With factors of an unsymmetric tangent, also an even number of stiff negative
            eigenvalues is found, at half the cost of a factorisation; else a state on the way to
            one that is judged so.
    """
    if newton.assembler.problem.linear and _has_checked_stiffness(newton.assembler.problem):
        return Verdict(Stability(0, reason=LINEAR))
    if newton.shift > 0.0 or not (newton.result.newton or newton.factorised):
        newton.factorise()
    fields = _of_fields(newton, surely=surely)
    if fields.negative is None:
        return Verdict(Stability(None, reason=fields.reason), fields.direction)
    negative = fields.negative
    if newton.bordered is not None:
        negative += newton.bordered.negative()
    if negative < 0:  # fewer than the constraints of the scalar unknowns have by themselves
        return Verdict(Stability(None, reason=_SINGULAR), fields.direction)
    return Verdict(Stability(negative, at_least=fields.at_least), fields.direction)


def _has_checked_stiffness(problem: Problem) -> bool:
    """Whether the case's own checks leave no negative stiffness in laws and springs.

    Formulas for the stiffness of springs and of orthotropic laws, and laws that a user has derived
    in Python, may have any sign.
    """
    if not all(region.law.surely_stiff for region in problem.regions):
        return False
    return not any(
        isinstance(c, Formula) for spring in problem.springs for c in spring.coefficients
    )


LINEAR = "laws of small strains know no buckling; 'st-venant-kirchhoff' takes the same constants"
_SINGULAR = "its tangent is singular"
_SLIDES = "with friction its tangent is not symmetric, and an iterative solver has no factors of it"


def _of_fields(newton: Newton, *, surely: bool) -> Inertia:
    """The inertia of the fields' tangent: by pivots where there are any, for these are free."""
    pc, symmetric = newton.linear.factors, newton.assembler.problem.symmetric
    if newton.linear.direct and _counts_pivots(pc):
        below = negative_pivots(pc, newton.assembler)
        if symmetric or below is None:
            return Inertia(below, reason=_SINGULAR if below is None else "")
        return count_by_factors(newton, below)
    if newton.assembler.problem.terms.dissipates:
        # Where friction slides, the symmetric part is indefinite by the size of the penalty,
        # however stable the body is: it says nothing.
        return count_by_factors(newton) if newton.linear.direct else Inertia(None, reason=_SLIDES)
    exactly = newton.bordered is not None and bool(np.any(newton.bordered.scalars.signs < 0.0))
    if not newton.linear.direct or symmetric:
        return count_negative(newton, exactly=exactly)
    inertia = None if surely or exactly else count_by_factors(newton)
    if inertia is not None and inertia.negative == 0:
        return inertia
    return count_by_factors(newton, _of_symmetric_part(newton.assembler))


def _of_symmetric_part(assembler: Assembler) -> int | None:
    """Negative pivots of the tangent's symmetric part, None where they cannot be had."""
    problem = assembler.problem
    if problem.num_dofs > LIMIT[problem.body.dim]:
        return None
    tangent = FactorisedTangent(assembler, symmetric_part=True)
    negative = tangent.negative
    tangent.destroy()
    return negative


@dataclass(frozen=True)
class Mode:
    """The motion of the displacements that the tangent resists least.

    Attributes:
        stiffness: v . K v / v . v, scalar fields following the displacement [N/m].
        motion: Owned entries of the displacement, of Euclidean norm 1.
    """

    stiffness: float
    motion: FloatArray


class FactorisedTangent:
    """A factorised tangent. Collective; `destroy` it.

    Args:
        assembler: Its `matrix` is the tangent to be looked at.
        symmetric_part: Its symmetric part is, where it is not symmetric.

    Attributes:
        sound: The factors exist and are finite; without, nothing else here is of use.
        negative: Negative eigenvalues beyond those of a stable body; None where the tangent is not
            symmetric, so that its pivots say nothing.
    """

    def __init__(self, assembler: Assembler, *, symmetric_part: bool = False) -> None:
        self.assembler, self.comm = assembler, assembler.comm
        symmetric = bool(assembler.problem.symmetric)
        self._symmetric = symmetric or symmetric_part
        self._pc = PETSc.PC().create(self.comm)
        with assembler.tangent.entries() as A:
            matrix = A if symmetric == self._symmetric else symmetric_part_of(A)
            self.sound = factorise(self._pc, matrix, symmetric=self._symmetric)
            if matrix is not A:
                matrix.destroy()  # the factors hold it
        counts = self.sound and self._symmetric
        self.negative = negative_pivots(self._pc, assembler) if counts else None

    def solve(self, f: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = K^-1 f. Collective."""
        self._pc.apply(f, x)

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
        self._pc.destroy()


class _Compliance:
    """The displacement block of the inverse tangent, zero where displacements are prescribed."""

    def __init__(self, tangent: FactorisedTangent) -> None:
        self._of = tangent
        self._keep = np.zeros(tangent.assembler.size)
        self._keep[tangent.assembler.displacement_dofs] = 1.0
        self._f = tangent.assembler.create_vector()

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


def curvature(assembler: Assembler, direction: FloatArray) -> float:
    """d . K d / d . d of the tangent as it is assembled, free entries only [N/m]. Collective.

    Args:
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
