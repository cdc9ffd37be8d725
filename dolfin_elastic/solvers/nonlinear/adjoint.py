"""`Adjoint`: what a small force anywhere changes of a number of an equilibrium.

At an equilibrium R(w; m) = 0, with the number Q(w; m), the derivative by a parameter m is

    dQ/dm = dQ/dm at fixed w + a . dR/dm at fixed w,    K^T a = -dQ/dw,

with K = dR/dw: one solve for each number, whatever the parameters.  Scalar unknowns s beside the
fields, with equations of their own, border the system as in `Bordered`.

Pressures of contact are unknowns, too, with the gaps g = 0 as equations: with their multipliers b
the adjoint's are K^T a + g_w^T b = -dQ/dw, with the scalars' alike, and no gap opens along a.
The tangent has the penalty eps, for which Uzawa's iteration b <- b + eps A (rates of the gaps
along a) finds them in a few such solves, see `KeptGaps`.
Source: D. A. Tortorelli and P. Michaleris, Inverse Problems in Engineering 1 (1994) 71.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.nonlinear.kept_gaps import KeptGaps
from dolfin_elastic.solvers.nonlinear.mixing import Mixing
from dolfin_elastic.solvers.petsc.options import ksp_reason

if TYPE_CHECKING:
    from dolfin_elastic.solvers.nonlinear.newton import Newton

DIGITS, WITH_FACTORS = 1e-8, 1e-11
"""Residual r of an adjoint over its right-hand side, and about the relative error of a gradient.

The error of dQ/dm is r . du/dm, at most |r| |du/dm|, with the norm of K^-1 of r and that of K of
du/dm.  Conjugate gradients know the former as r . P r with the preconditioner P, to the factor by
which P differs from K^-1; GMRES knows |r| alone.  Pressures of nearly incompressible bodies lose
some of the digits, and factors give more for little.
"""
_ITERATIONS, _RESTART = 2000, 60
_KNOWN = 8
"""Solutions with which the next one begins."""
_ROUGH = 1e-3
"""Tolerance of systems within Uzawa's iteration, over how far this is off.

Source: H. C. Elman & G. H. Golub, SIAM J. Numer. Anal. 31 (1994) 1645 (inexact Uzawa)."""
_UZAWA = 100
"""Of Uzawa's iterations, each of which gains more than a digit."""


@dataclass(frozen=True)
class AdjointState:
    """Multipliers of the equations.

    Attributes:
        fields: Of the nodal equations, owned entries of all unknowns; none where prescribed.
        scalars: Of those of scalar unknowns.
        pressures: By which pressures of contact count that a parameter changes at fixed unknowns,
            of all owned vertices as in `pressures_of`; a unit of the number per Pa.
        iterations: Of the linear solver.
    """

    fields: FloatArray
    scalars: FloatArray
    pressures: FloatArray
    iterations: int


class Adjoint:
    """Solves with the transposed tangent of the present equilibrium. Collective; `close` it.

    The tangent is assembled where the solve has ended; the factors of Newton's method, of a state
    one small step before, serve for it, or its preconditioner, see `LinearSolver.many_digits`.

    Args:
        newton: After a solve that has converged; contacts keep what presses, see
            `Pressures.keep`.
    """

    def __init__(self, newton: Newton) -> None:
        self._newton, self._assembler = newton, newton.assembler
        for term in newton.assembler.problem.terms:
            term.make_exact()
        newton.factorise(anew=False)
        self._symmetric = bool(self._assembler.problem.symmetric)
        self._x, self._y = (self._assembler.create_vector() for _ in range(2))
        self._matrix = self._assembler.tangent.matrix
        if not self._symmetric:
            self._matrix = PETSc.Mat().createTranspose(self._matrix)
        self._ksp = PETSc.KSP().create(self._assembler.comm)
        self._ksp.setPC(newton.ksp.getPC())
        self._ksp.setOperators(self._matrix, self._assembler.tangent.matrix)
        self._digits = WITH_FACTORS if newton.linear.direct else DIGITS
        self._ksp.setTolerances(rtol=self._digits, atol=0.0, max_it=_ITERATIONS)
        if newton.ksp.getType() == "cg":
            self._ksp.setType("cg")
            self._ksp.setNormType(PETSc.KSP.NormType.NATURAL)
        else:
            self._take_gmres()
        pressures = [pair.pressures() for pair in self._assembler.problem.contact_pairs]
        self._nothing = np.zeros(sum(map(len, pressures)))
        some = total(self._assembler.comm, sum(map(np.count_nonzero, pressures)))
        self._gaps = KeptGaps(self._assembler, newton.bordered) if some else None
        self._border: tuple[FloatArray, FloatArray] | None = None
        self._iterations, self._known = 0, list[tuple[FloatArray, FloatArray]]()

    def _take_gmres(self) -> None:
        self._ksp.setType("gmres")
        self._ksp.setGMRESRestart(_RESTART)
        self._ksp.setInitialGuessNonzero(False)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)

    @stage("adjoint")
    def solve(
        self, derivative: FloatArray, of_scalars: FloatArray, motion: FloatArray | None = None
    ) -> AdjointState:
        """The adjoint of a number. Collective.

        Args:
            derivative: dQ/dw, owned entries of all unknowns; a unit of Q per m.
            of_scalars: dQ/ds at fixed fields, an entry for each scalar unknown.
            motion: Q is the work of nodal forces along it, those of contact among them, owned
                entries; None: it does not depend on forces.

        Raises:
            InputError: The linear solver has not converged.
        """
        self._iterations, gaps = 0, self._gaps
        if gaps is None:
            fields, scalars = self._bordered(derivative, of_scalars)
            return AdjointState(fields, scalars, self._nothing, self._iterations)
        mixing, multipliers = Mixing(self._assembler.comm), np.zeros_like(gaps.eps)
        before: FloatArray = np.zeros_like(derivative)
        cut, off, rtol = before, 1.0, 1.0
        for _ in range(_UZAWA):
            by_fields, by_scalars = gaps.loads(multipliers)
            rtol = max(self._digits, _ROUGH * min(off, rtol))
            with self._solving(rtol):
                whole = derivative + by_fields + cut
                fields, scalars = self._bordered(whole, of_scalars + by_scalars)
            way = gaps.way(fields, scalars, motion)
            rates, sizes = (gaps.stiffness * one for one in gaps.rates(way))
            change = np.append(rates, gaps.left_out(way, multipliers) - cut)
            squares = [np.sum(x**2) for x in (change, sizes, multipliers, fields - before, fields)]
            left, *known, moved, size = total(self._assembler.comm, np.array(squares)) ** 0.5
            least, enough = (digits * max(known) for digits in (DIGITS, self._digits))
            # Rates of vertices that supports hold do not change, nor anything else at last.
            if rtol == self._digits and (left <= enough or moved <= DIGITS * size):
                pressures = np.where(np.abs(rates) <= least, -multipliers / gaps.eps, 0.0)
                return AdjointState(fields, scalars, pressures, self._iterations)
            before, off = fields, left / max(*known, np.finfo(float).tiny)
            after = mixing.next(np.append(multipliers, cut), change)
            multipliers, cut = np.split(after, [len(multipliers)])
        raise InputError(
            f"the adjoint was not found: contact has not settled in {_UZAWA} iterations",
            expected="`sweep`, or a stiffer contact",
        )

    @contextmanager
    def _solving(self, rtol: float) -> Iterator[None]:
        """Inside, systems are solved to this tolerance."""
        self._ksp.setTolerances(rtol=rtol)
        try:
            yield
        finally:
            self._ksp.setTolerances(rtol=self._digits)

    def _bordered(
        self, derivative: FloatArray, of_scalars: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Multipliers of nodal equations and of scalars, with the pressures as they are.

        Collective.

        Raises:
            InputError: Nothing holds what a scalar moves.
        """
        level, bordered, dofs = self._assembler.level, self._newton.bordered, self._assembler
        if level is not None:  # a change of the mean of an enclosed pressure is taken out again
            derivative = level.balanced(
                derivative, [one for one in level.bodies if not one.coupled]
            )
        fields = self._inverse(-derivative)
        scalars: FloatArray = np.zeros(0)
        if bordered is not None:
            comm, columns = dofs.comm, np.array(bordered.columns)
            if self._border is None:
                with self._solving(self._digits):
                    inverses = np.array([self._inverse(row) for row in bordered.rows])
                # What scalars prescribe moves with them, and with it the scalars' equations.
                moved = np.array([bordered.prescribed_part(row) for row in bordered.rows])
                schur = bordered.corner.T - total(comm, columns @ (inverses + moved).T)
                self._border = inverses, schur
            inverses, schur = self._border
            whole = fields - bordered.prescribed_part(derivative)
            right = -of_scalars - total(comm, columns @ whole)
            try:
                scalars = np.asarray(np.linalg.solve(schur, right), dtype=np.float64)
            except np.linalg.LinAlgError:  # on all ranks alike
                raise InputError(
                    "the adjoint was not found: what a force moves presses on nothing here",
                    expected="a state in which a support or contact holds it",
                ) from None
            fields = fields - scalars @ inverses
        if level is not None:  # the equations of enclosed pressures hold but for their mean
            fields = level.without_mean(fields, level.bodies)
        return np.asarray(fields), np.asarray(scalars)

    def _inverse(self, right: FloatArray) -> FloatArray:
        """K^-T times what a vector has at free entries. Collective."""
        self._x.array_w[:] = self._assembler.collect(right)
        self._assembler.remove_constrained(self._x)
        self._solve()
        self._assembler.remove_constrained(self._y)
        return np.asarray(self._y.array_r.copy())

    def _begin(self) -> None:
        """The best combination of the last solutions: numbers often depend alike on unknowns.

        The error is orthogonal to them in the norm of energy, or the residual to their loads.
        """
        self._ksp.setInitialGuessNonzero(bool(self._known))
        if self._known:
            loads, solutions = (np.array(rows) for rows in zip(*self._known, strict=True))
            tests = solutions if self._ksp.getType() == "cg" else loads
            rows = np.vstack([loads, self._x.array_r])
            products = total(self._assembler.comm, tests @ rows.T)
            factors = np.linalg.lstsq(products[:, :-1], products[:, -1], rcond=1e-12)[0]
            self._y.array_w[:] = factors @ solutions

    def _keep(self) -> None:
        """Keeps a solution for the next ones, where these take iterations. Collective."""
        size = self._x.norm()
        iterated = not self._newton.linear.direct or self._gaps is not None
        if size > 0.0 and iterated:
            last = self._x.array_r / size, self._y.array_r / size
            self._known = [*self._known[1 - _KNOWN :], last]

    def _solve(self) -> None:
        self._begin()
        linear, options = self._newton.linear, self._newton.options
        with options.in_force(), petsc_errors(), linear.left_as_it_is():
            self._ksp.solve(self._x, self._y)
            if self._ksp.getConvergedReason() < 0 and self._ksp.getType() == "cg":
                self._take_gmres()  # an unstable equilibrium has an indefinite tangent
                self._ksp.solve(self._x, self._y)
        self._iterations += self._ksp.getIterationNumber()
        reason = self._ksp.getConvergedReason()
        if reason < 0:
            raise InputError(
                f"the adjoint was not found: {ksp_reason(reason)}",
                expected='solver.method = "direct", which has factors',
            )
        self._keep()

    def step(self) -> FloatArray:
        """The linear solution from the problem's unknowns, as of a symmetric tangent. Collective.

        Returns:
            The change of owned entries, with that of prescribed ones.
        """
        self._assembler.get(self._x)
        self._assembler.residual.evaluate(self._x, self._y)
        self._y.copy(self._x)
        self._x.scale(-1.0)
        self._solve()
        result = np.asarray(self._y.array_r.copy())
        self._assembler.extend(result)
        return result

    def close(self) -> None:
        """Frees what it owns. Collective."""
        self._ksp.destroy()
        self._x.destroy()
        self._y.destroy()
        if not self._symmetric:
            self._matrix.destroy()
