"""`Adjoint`: what a small force anywhere changes of a number of an equilibrium.

At an equilibrium R(w; m) = 0, with the number Q(w; m), the derivative by a parameter m is

    dQ/dm = dQ/dm at fixed w + a . dR/dm at fixed w,    K^T a = -dQ/dw,

with K = dR/dw: one solve for each number, whatever the parameters.  Scalar unknowns s beside the
fields, with equations g(w, s; m) = 0, border the system as in `Bordered`.
Source: D. A. Tortorelli and P. Michaleris, Inverse Problems in Engineering 1 (1994) 71.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
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
_UZAWA = 100
"""Of Uzawa's iterations, each of which gains a digit or so."""


@dataclass(frozen=True)
class AdjointState:
    """Multipliers of the equations.

    Attributes:
        fields: Of the nodal equations, owned entries of all unknowns; none where prescribed.
        scalars: Of those of scalar unknowns.
        iterations: Of the linear solver.
    """

    fields: FloatArray
    scalars: FloatArray
    iterations: int


class Adjoint:
    """Solves with the transposed tangent of the present equilibrium. Collective; `destroy` it.

    The tangent is assembled where the solve has ended; the factors or the preconditioner of
    Newton's method, of a state one small step before, serve for it.

    Args:
        newton: After a solve that has converged.
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
        digits = WITH_FACTORS if newton.linear.direct else DIGITS
        self._ksp.setTolerances(rtol=digits, atol=0.0, max_it=_ITERATIONS)
        if newton.ksp.getType() == "cg":
            self._ksp.setType("cg")
            self._ksp.setNormType(PETSc.KSP.NormType.NATURAL)
        else:
            self._take_gmres()
        self._rows: list[FloatArray] | None = None
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
        self._iterations, level = 0, self._assembler.level
        if level is not None:  # a change of the mean of an enclosed pressure is taken out again
            derivative = level.balanced(
                derivative, [one for one in level.bodies if not one.coupled]
            )
        fields, bordered = self._inverse(-derivative, motion), self._newton.bordered
        scalars: FloatArray = np.zeros(0)
        if bordered is not None:
            comm = self._assembler.comm
            columns, rows = np.array(bordered.columns), np.array(bordered.rows)
            if self._rows is None:
                self._rows = [self._inverse(row) for row in rows]
            inverses = np.array(self._rows)
            # What scalars prescribe moves with them, and with it the scalars' equations.
            moved = np.array([self._prescribed(row) for row in rows])
            schur = bordered.corner.T - total(comm, columns @ (inverses + moved).T)
            right = -of_scalars - total(comm, columns @ (fields - self._prescribed(derivative)))
            scalars = np.asarray(np.linalg.solve(schur, right))
            fields = np.asarray(fields - scalars @ inverses)
        if level is not None:  # the equations of enclosed pressures hold but for their mean
            fields = level.without_mean(fields, level.bodies)
        return AdjointState(fields, scalars, self._iterations)

    def _prescribed(self, row: FloatArray) -> FloatArray:
        """K^-T times what a vector has at prescribed entries, whose equations are x - g = 0."""
        dofs = self._assembler
        result = dofs.constrained_part(row)
        if dofs.skewed:
            result[dofs.skew_dofs] /= dofs.tangent.scale()
        return result

    def _inverse(self, right: FloatArray, motion: FloatArray | None = None) -> FloatArray:
        """K^-T times what a vector has at free entries, along which contact holds. Collective.

        Newton's K has the penalty of contact, K_c = eps G^T G with the rows G of the gaps.  But
        pressures are multipliers, which keep G x = 0: Uzawa's iteration K x_k = b - sum K_c x_j,
        j < k, finds that solution.  Where supports hold vertices that press, their reactions have
        part of the pressures: of the motion m of a number that is K^T m, G (x + m) = 0.
        """
        x = self._plain_inverse(right)
        if not self._assembler.problem.contact_pairs:
            return x
        largest_size = float(total(self._assembler.comm, np.sum(x**2)))
        for _ in range(_UZAWA):
            right = right - self._penalised(x, motion)
            before, x = x, self._plain_inverse(right)
            change, size = total(
                self._assembler.comm, np.array([np.sum((x - before) ** 2), np.sum(x**2)])
            )
            largest_size = max(largest_size, size)
            if change <= DIGITS**2 * largest_size:  # also where nothing can move at last
                return x
        raise InputError(
            f"the adjoint was not found: contact has not settled in {_UZAWA} iterations",
            expected="`sweep`, or a stiffer contact",
        )

    def _penalised(self, x: FloatArray, motion: FloatArray | None) -> FloatArray:
        """K_c (x + m), see `Pressures.penalised`. Collective."""
        problem, way = self._assembler.problem, self._assembler.ghosted_vector()
        way.array[: len(x)] = x
        self._assembler.extend(way.array)
        if motion is not None:
            way.array[: len(x)] += motion
        way.scatter_forward()
        entries = problem.unknowns.mixed_dofs(np.arange(len(problem.u.x.array), dtype=np.int32))
        moved = way.array[entries]
        return np.asarray(sum(pair.penalised(moved) for pair in problem.contact_pairs))

    def _plain_inverse(self, right: FloatArray) -> FloatArray:
        """The same without contact. Collective."""
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
        iterated = not (self._newton.linear.direct or self._assembler.problem.contact_pairs)
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

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self._ksp.destroy()
        self._x.destroy()
        self._y.destroy()
        if not self._symmetric:
            self._matrix.destroy()
