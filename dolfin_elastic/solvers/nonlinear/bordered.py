"""A few scalar unknowns beside the fields, each with an equation of its own.

    | K  B | | du |     | R |
    | C  D | | ds | = - | g |

is solved by block elimination with one more solve with K for each scalar, so the solver of K
can be any.  Where that iterates, what D - C K^-1 B loses by cancellation is won back by refining
K^-1 B: the stiffness against a rotation is a thousandth of the products that it is the difference
of.  Source: Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria
(2000), section 3.1.  The scalars may be a load factor, the pressure in a cavity, or the motion of
a rigid surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.term import OutOfBalance, ScalarUnknowns
from dolfin_elastic.solvers.assembly.assembler import Assembler

SAME = 0.1
"""Relative change of scalars, or error of their stiffness, below which they count as known."""

REFINEMENTS = 4
"""Of K^-1 B in one solve, each of which gains the digits of one solve with K."""


class JoinedScalars(ScalarUnknowns):
    """Several groups of scalar unknowns as one, one after the other.

    Args:
        parts: The groups.  Each `put` may undo what one before has set in the problem, never one
            behind: what sets the time comes first.
    """

    def __init__(self, parts: Sequence[ScalarUnknowns]) -> None:
        self._parts = tuple(parts)
        self.size = sum(part.size for part in parts)
        self.steps = np.concatenate([part.steps for part in parts])
        self.signs = np.concatenate([part.signs for part in parts])
        self.prescribing = np.concatenate([part.prescribing for part in parts])
        self._cuts = np.cumsum([part.size for part in parts])[:-1]

    def get(self) -> FloatArray:
        """All scalars."""
        return np.concatenate([part.get() for part in self._parts])

    def shifts(self, pose: Pose) -> FloatArray:
        """Those by all scalars."""
        return np.concatenate([part.shifts(pose) for part in self._parts])

    def put(self, values: FloatArray) -> None:
        """Changes all scalars. Not collective."""
        for part, own in zip(self._parts, np.split(values, self._cuts), strict=True):
            part.put(own)

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """All equations. Collective."""
        return np.concatenate([part.residual(forces) for part in self._parts])

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """All their derivatives. Collective."""
        return [row for part in self._parts for row in part.rows(forces)]

    def exact(self, rows: Sequence[FloatArray]) -> dict[int, tuple[FloatArray, float]]:
        """All derivatives that are known."""
        result: dict[int, tuple[FloatArray, float]] = {}
        begin = 0
        for part in self._parts:
            known = part.exact(rows[begin : begin + part.size])
            result |= {begin + j: one for j, one in known.items()}
            begin += part.size
        return result

    def settled(self, residual: FloatArray, target: float) -> bool:
        """Whether all equations hold well enough.

        Args:
            target: See `ScalarUnknowns`.
        """
        owns = np.split(residual, self._cuts)
        return all(part.settled(own, target) for part, own in zip(self._parts, owns, strict=True))


class Bordered:
    """PETSc's view of fields and scalars together: vectors, operator and solver.

    Vectors have the fields' owned entries and, on rank 0, the scalars behind them.

    Attributes:
        columns: B, owned entries, one array a scalar.
        rows: C, the same.
        corner: D.
        last: The scalars' residual at the last evaluation.
        iterations: Of the fields' linear solver so far.
    """

    def __init__(self, assembler: Assembler, scalars: ScalarUnknowns, ksp: PETSc.KSP) -> None:
        self.assembler, self.scalars, self.ksp = assembler, scalars, ksp
        self._comm, self._size = assembler.comm, assembler.size
        self._x, self._b = assembler.create_vector(), assembler.create_vector()
        self._own = self._size + (scalars.size if self._comm.rank == 0 else 0)
        self.matrix = PETSc.Mat().createPython(
            ((self._own, None), (self._own, None)), context=self, comm=self._comm
        )
        self.matrix.setUp()
        self.columns: list[FloatArray] = []
        self.rows: list[FloatArray] = []
        self.corner: FloatArray = np.zeros((scalars.size, scalars.size))
        self._elimination = _Elimination(self)
        self.iterations = self._reason = 0
        self.last: FloatArray = np.zeros(scalars.size)

    def create_vector(self) -> PETSc.Vec:
        """A vector of fields and scalars; the caller destroys it."""
        vec = PETSc.Vec().createMPI((self._own, None), comm=self._comm)
        vec.set(0.0)
        return vec

    def scalar_part(self, x: PETSc.Vec) -> FloatArray:
        """The scalars in a vector. Collective."""
        own = x.array_r[self._size :].copy() if self._comm.rank == 0 else None
        return np.asarray(self._comm.bcast(own))

    def fill(self, x: PETSc.Vec, fields: FloatArray, scalars: FloatArray) -> None:
        """Writes fields and scalars into a vector.

        Args:
            fields: Owned entries of the fields.
            scalars: The scalars, the same on all ranks.
        """
        x.array_w[: self._size] = fields
        if self._comm.rank == 0:
            x.array_w[self._size :] = scalars

    # --- residual and tangent ---

    def get(self, x: PETSc.Vec) -> None:
        """Copies all unknowns into a vector, before a solve."""
        self.iterations = 0
        fields = self.assembler.problem.w.x.array[: self._size] - self.assembler.origin
        self.fill(x, fields, self.scalars.get())

    def put(self, x: PETSc.Vec) -> None:
        """Copies a vector into all unknowns, and evaluates there. Collective."""
        self.scalars.put(self.scalar_part(x))
        self._x.array_w[:] = x.array_r[: self._size]
        self.assembler.residual.evaluate(self._x, self._b)
        self.last = self.scalars.residual(self.assembler.residual)

    def evaluate(self) -> None:
        """Evaluates everything at the present unknowns, which others have changed. Collective."""
        x = self.create_vector()
        self.get(x)
        self.put(x)
        x.destroy()

    def residual(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Residual of fields and scalars. Collective.

        Args:
            f: Receives it: nodal forces [N], and the scalars' equations.
        """
        self.put(x)
        self.fill(f, self._b.array_r, self.last)

    def renew(self, x: PETSc.Vec) -> None:
        """Assembles everything at x. Collective."""
        values = self.scalar_part(x)
        self._x.array_w[:] = x.array_r[: self._size]
        self.scalars.put(values)
        self.assembler.residual.evaluate(self._x, self._b)
        self.rows = self.scalars.rows(self.assembler.residual)
        known = {
            j: self._with_response(j, column, own)
            for j, (column, own) in self.scalars.exact(self.rows).items()
        }
        self.columns, self.corner = self._differences(values, known)
        self.assembler.tangent.assemble(self._x)
        self._elimination.solved = None

    def _with_response(self, j: int, column: FloatArray, own: float) -> tuple[FloatArray, ...]:
        """A known derivative as `_difference` would give it. Collective.

        The other scalars' residuals are linear in the nodal forces, where they depend on them.
        """
        forces, a = self.assembler.residual, self.assembler
        before, corner = forces.owned.copy(), -self.scalars.residual(forces)
        column = np.asarray(a.collect(column))
        forces.owned[:] += column
        corner += self.scalars.residual(forces)
        forces.owned[:] = before
        corner[j] = own
        return a.free_part(column), corner

    def _differences(
        self, values: FloatArray, known: dict[int, tuple[FloatArray, ...]]
    ) -> tuple[list[FloatArray], FloatArray]:
        """Derivatives of the fields' and the scalars' residuals with respect to the scalars.

        Scalars that only prescribe displacements change no force where the fields are: for them
        the nodal forces stand, and nothing is assembled.

        Args:
            values: All scalars.
            known: Index of those whose derivatives are known, to these.
        """
        steps, only_prescribing = self.scalars.steps, self.scalars.prescribing
        result = known | {
            j: self._difference(values, j, steps[j])
            for j in np.flatnonzero(~only_prescribing)
            if j not in known
        }
        self.scalars.put(values)
        self.assembler.residual.evaluate(self._x, self._b)  # back to where we are
        for j in np.flatnonzero(only_prescribing):
            result[j] = self._difference(values, j, steps[j], constrained_only=True)
        self.scalars.put(values)
        self.assembler.residual.constrain(self._b)
        columns, corner = zip(*(result[j] for j in range(len(steps))), strict=True)
        return list(columns), np.column_stack(corner)

    def _difference(
        self, values: FloatArray, j: int, h: float, *, constrained_only: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """The same with respect to one scalar.

        Args:
            values: All scalars, around which the difference is central.
            constrained_only: It changes prescribed displacements only.
        """
        sides = []
        for sign in (1.0, -1.0):
            changed = values.copy()
            changed[j] += sign * h
            self.scalars.put(changed)
            if constrained_only:
                self.assembler.residual.constrain(self._b)
            else:
                self.assembler.residual.evaluate(self._x, self._b)
            sides.append((self._b.array_r.copy(), self.scalars.residual(self.assembler.residual)))
        (f, g), (p, q) = sides
        column, corner = np.asarray(f - p) / (2 * h), np.asarray(g - q) / (2 * h)
        return np.asarray(column, dtype=np.float64), np.asarray(corner, dtype=np.float64)

    # --- what PETSc calls ---

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The operator, as PETSc's MATPYTHON asks for it. Collective.

        Args:
            x: What it is multiplied by.
        """
        scalars = self.scalar_part(x)
        self._x.array_w[:] = x.array_r[: self._size]
        self.assembler.tangent.matrix.mult(self._x, self._b)
        fields = self._b.array_r.copy()
        for s, column in zip(scalars, self.columns, strict=True):
            fields += s * column
        below = self.products(x.array_r[: self._size]) + self.corner @ scalars
        self.fill(y, fields, below)

    def prescribed_part(self, row: FloatArray) -> FloatArray:
        """K^-T times what a vector has at prescribed entries, whose equations are x - g = 0."""
        dofs = self.assembler
        result = dofs.constrained_part(row)
        if dofs.skewed:
            result[dofs.skew_dofs] /= dofs.tangent.scale()
        return result

    def products(self, fields: FloatArray) -> FloatArray:
        """C times owned entries of the fields. Collective."""
        local = np.array([np.dot(row, fields) for row in self.rows])
        return np.asarray(self._comm.allreduce(local, op=MPI.SUM))

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Block elimination, as PETSc's KSPPYTHON asks for it. Collective.

        Args:
            ksp: Receives the reason why it ended: the first failure of the fields' solver counts.
        """
        self._reason = 0
        plain = self.inverse(b.array_r[: self._size])
        self.eliminate()
        assert self._elimination.solved is not None
        right, size = self.scalar_part(b) - self.products(plain), self._elimination.norm(b.array_r)
        scalars = self._elimination.by_schur(right)
        for _ in range(REFINEMENTS):
            before = scalars
            if self._reason or not self._elimination.inexact(scalars, size):
                break
            self._elimination.refine()
            scalars = self._elimination.by_schur(right)
            if size == 0.0 and np.allclose(scalars, before, rtol=SAME, atol=0.0):
                break
        for s, z in zip(scalars, self._elimination.solved, strict=True):
            plain = plain - s * z
        self.fill(x, plain, scalars)
        ksp.setConvergedReason(self._reason or PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def eliminate(self) -> None:
        """Solves for the columns of the present tangent, unless they are. Collective."""
        self._elimination.eliminate()

    def tangent(self, rtol: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Direction of the path along which the first scalar's equation alone changes. Collective.

        Args:
            rtol: Tolerance of the fields' solver; None: what is known of the last solve will do.

        Returns:
            Owned entries of the fields, and the scalars, NaN where the tangent is singular.
        """
        if rtol is not None:
            usual, self._elimination.solved = self.ksp.getTolerances()[0], None
            self.ksp.setTolerances(rtol=rtol)
            self.eliminate()
            self.ksp.setTolerances(rtol=usual)
        self.eliminate()
        assert self._elimination.solved is not None
        right = np.zeros(self.scalars.size)
        right[0] = 1.0
        scalars = self._elimination.by_schur(right)
        fields = np.zeros(self._size)
        for s, z in zip(scalars, self._elimination.solved, strict=True):
            fields -= s * z
        return fields, scalars

    def negative(self) -> int:
        """Negative eigenvalues that the scalars add to those of the fields' tangent. Collective.

        By Haynsworth's formula for the Schur complement; a constraint has one of its own.
        """
        signs = self.scalars.signs
        counted = np.flatnonzero(signs)
        if not len(counted):
            return 0
        for refined in range(REFINEMENTS + 1):
            S = (signs[:, None] * self._elimination.schur)[np.ix_(counted, counted)]
            values = np.linalg.eigvalsh((S + S.T) / 2)
            if refined == REFINEMENTS or self._elimination.error() <= SAME * np.abs(values).min():
                break
            self._elimination.refine()
        return int(np.sum(values < 0.0)) - int(np.sum(signs < 0.0))

    def inverse(self, right: FloatArray) -> FloatArray:
        """K^-1 times owned entries, counted in `iterations`. Collective."""
        self._b.array_w[:] = right
        self.ksp.solve(self._b, self._x)
        self.iterations += self.ksp.getIterationNumber()
        if not self._reason:  # the first failure is the one to report
            self._reason = min(int(self.ksp.getConvergedReason()), 0)
        return np.asarray(self._x.array_r.copy())

    def free(self) -> None:
        """Frees everything. Collective.

        Not `destroy`, which PETSc would call for each thing that has this as its context.
        """
        for thing in (self.matrix, self._x, self._b, self._elimination):
            thing.destroy()


def python_solver(snes: PETSc.SNES, context: Bordered, prefix: str) -> None:
    """Makes a python context the linear solver of a SNES.

    Args:
        context: Has `solve`, as PETSc's KSPPYTHON asks for.
        prefix: Of the options of that linear solver.
    """
    ksp = snes.getKSP()
    ksp.setOptionsPrefix(prefix)
    ksp.setType("python")
    ksp.setPythonContext(context)
    ksp.getPC().setType("none")


class _Elimination:
    """K^-1 B, and the Schur complement D - C K^-1 B.

    Attributes:
        solved: K^-1 B, one array a scalar; None until it is asked for.
        schur: The Schur complement.
    """

    def __init__(self, of: Bordered) -> None:
        self._of, self._comm = of, of.assembler.comm
        self.solved: list[FloatArray] | None = None
        self.schur: FloatArray = of.corner
        self._left: list[FloatArray] | None = None  # B - K K^-1 B
        self._x, self._b = (of.assembler.create_vector() for _ in range(2))

    def eliminate(self) -> None:
        """Solves for the columns of the present tangent, unless they are. Collective."""
        if self.solved is None:
            self.solved, self._left = (
                [self._of.inverse(column) for column in self._of.columns],
                None,
            )
            self._take_schur()

    def _take_schur(self) -> None:
        assert self.solved is not None
        products = [self._of.products(z) for z in self.solved]
        self.schur = self._of.corner - np.column_stack(products)

    def by_schur(self, right: FloatArray) -> FloatArray:
        """The scalars; NaN where the system is singular.

        Args:
            right: Their equations without the fields.
        """
        try:
            return np.asarray(np.linalg.solve(self.schur, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.full(self._of.scalars.size, np.nan)

    def inexact(self, scalars: FloatArray, size: float) -> bool:
        """Whether the fields' residual is larger than their solver leaves by itself. Collective.

        Args:
            scalars: How much of each column the solution has.
        """
        if self._of.ksp.getType() == "preonly" or not np.all(np.isfinite(scalars)):
            return False
        if self._left is None:
            self._find_left()
        assert self._left is not None
        return self.norm(scalars @ np.array(self._left)) > self._of.ksp.getTolerances()[0] * size

    def _find_left(self) -> None:
        assert self.solved is not None
        self._left = []
        for z, column in zip(self.solved, self._of.columns, strict=True):
            self._x.array_w[:] = z
            self._of.assembler.tangent.matrix.mult(self._x, self._b)
            self._left.append(column - self._b.array_r)

    def refine(self) -> None:
        """Solves for what is left of the columns. Collective."""
        assert self.solved is not None
        assert self._left is not None
        left = [self._of.inverse(r) for r in self._left]
        self.solved = [z + more for z, more in zip(self.solved, left, strict=True)]
        self._find_left()
        self._take_schur()

    def norm(self, fields: FloatArray) -> float:
        own = fields[: self._of.assembler.size]
        return float(np.sqrt(total(self._comm, float(own @ own))))

    def error(self) -> float:
        """About that of the Schur complement: C K^-1 (B - K Z), C being B^T or so. Collective."""
        if self._of.ksp.getType() == "preonly" or self.solved is None:
            return 0.0
        if self._left is None:
            self._find_left()
        products = np.array(self.solved) @ np.array(self._left).T
        return float(np.abs(total(self._comm, products)).max())

    def destroy(self) -> None:
        """Frees its vectors. Collective."""
        self._x.destroy()
        self._b.destroy()
