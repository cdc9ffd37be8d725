"""A few scalar unknowns beside the fields, each with an equation of its own.

    | K  B | | du |     | R |
    | C  D | | ds | = - | g |

is solved by block elimination with one more solve with K for each scalar, so K keeps whatever
solver it has.  Source: Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria
(2000), section 3.1.  The scalars may be a load factor, the pressure in a cavity, or the motion of
a rigid surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.solvers.assembler import Assembler

Vector = npt.NDArray[np.float64]


class Border:
    """Scalar unknowns s and their equations g(u, s) = 0; all ranks know both.

    Attributes:
        size: How many there are.
        steps: Differences of s by which derivatives with respect to it are taken.
    """

    size: int
    steps: Vector

    def get(self) -> Vector:
        """The present scalars."""
        raise TypeError(f"{type(self).__name__} has no scalars")

    def put(self, values: Vector) -> None:
        """Changes the scalars and what depends on them in the problem. Not collective."""
        raise TypeError(f"{type(self).__name__} has no scalars")

    def residual(self) -> Vector:
        """g at the present state; the assembler's `balance` is up to date. Collective."""
        raise TypeError(f"{type(self).__name__} has no equations")

    def rows(self) -> list[Vector]:
        """dg/du at the owned entries, one array a scalar. Collective."""
        raise TypeError(f"{type(self).__name__} has no equations")

    def corner(self) -> Vector:
        """dg/ds, shape (size, size)."""
        return np.zeros((self.size, self.size))

    def settled(self, residual: Vector, rtol: float) -> bool:
        """Whether the equations hold well enough."""
        raise TypeError(f"{type(self).__name__} has no equations")


class Bordered:
    """PETSc's view of fields and scalars together: vectors, operator and solver.

    Vectors have the fields' owned entries and, on rank 0, the scalars behind them.

    Args:
        assembler: Of the fields.
        border: The scalars.
        ksp: Solves with the fields' tangent.

    Attributes:
        last: The scalars' residual at the last evaluation.
        iterations: Of the fields' linear solver so far.
    """

    def __init__(self, assembler: Assembler, border: Border, ksp: PETSc.KSP) -> None:
        self.assembler, self.border, self.ksp = assembler, border, ksp
        self._comm, self._size = assembler.comm, assembler.size
        self._x, self._b = assembler.create_vector(), assembler.create_vector()
        self._own = self._size + (border.size if self._comm.rank == 0 else 0)
        self.matrix = PETSc.Mat().createPython(
            ((self._own, None), (self._own, None)), context=self, comm=self._comm
        )
        self.matrix.setUp()
        self._columns: list[Vector] = []
        self._rows: list[Vector] = []
        self._corner = np.zeros((border.size, border.size))
        self._solved: list[Vector] | None = None
        self.iterations = 0
        self.last = np.zeros(border.size)

    def create_vector(self) -> PETSc.Vec:
        """A vector of fields and scalars; the caller destroys it."""
        vec = PETSc.Vec().createMPI((self._own, None), comm=self._comm)
        vec.set(0.0)
        return vec

    def scalars(self, x: PETSc.Vec) -> Vector:
        """The scalars in a vector. Collective."""
        own = x.array_r[self._size :].copy() if self._comm.rank == 0 else None
        return np.asarray(self._comm.bcast(own))

    def fill(self, x: PETSc.Vec, fields: Vector, scalars: Vector) -> None:
        """Writes fields and scalars into a vector."""
        x.array_w[: self._size] = fields
        if self._comm.rank == 0:
            x.array_w[self._size :] = scalars

    # --- residual and tangent ---

    def residual(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Residual of fields and scalars. Collective."""
        self.border.put(self.scalars(x))
        self._x.array_w[:] = x.array_r[: self._size]
        self.assembler.residual(self._x, self._b)
        self.last = self.border.residual()
        self.fill(f, self._b.array_r, self.last)

    def renew(self, x: PETSc.Vec) -> None:
        """Assembles everything at x. Collective."""
        values = self.scalars(x)
        self._x.array_w[:] = x.array_r[: self._size]
        self.border.put(values)
        self._columns = self._differences(values)
        self.assembler.residual(self._x, self._b)  # back to where we are
        self._rows, self._corner = self.border.rows(), self.border.corner()
        self.assembler.tangent(self._x)
        self._solved = None

    def _differences(self, values: Vector) -> list[Vector]:
        """Derivatives of the fields' residual with respect to the scalars."""
        columns = []
        for j, h in enumerate(self.border.steps):
            sides = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[j] += sign * h
                self.border.put(moved)
                self.assembler.residual(self._x, self._b)
                sides.append(self._b.array_r.copy())
            columns.append((sides[0] - sides[1]) / (2 * h))
        self.border.put(values)
        return columns

    # --- what PETSc calls ---

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The operator. Collective."""
        scalars = self.scalars(x)
        self._x.array_w[:] = x.array_r[: self._size]
        self.assembler.matrix.mult(self._x, self._b)
        fields = self._b.array_r.copy()
        for s, column in zip(scalars, self._columns, strict=True):
            fields += s * column
        below = self._products(x.array_r[: self._size]) + self._corner @ scalars
        self.fill(y, fields, below)

    def _products(self, fields: Vector) -> Vector:
        local = np.array([np.dot(row, fields) for row in self._rows])
        return np.asarray(self._comm.allreduce(local, op=MPI.SUM))

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Block elimination. Collective."""
        plain = self._inverse(b.array_r[: self._size])
        if self._solved is None:
            self._solved = [self._inverse(column) for column in self._columns]
        schur = self._corner - np.column_stack([self._products(z) for z in self._solved])
        right = self.scalars(b) - self._products(plain)
        try:
            scalars = np.linalg.solve(schur, right)
        except np.linalg.LinAlgError:
            scalars = np.full(self.border.size, np.nan)
        for s, z in zip(scalars, self._solved, strict=True):
            plain = plain - s * z
        self.fill(x, plain, scalars)
        reason = self.ksp.getConvergedReason()
        ksp.setConvergedReason(reason if reason < 0 else PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def _inverse(self, right: Vector) -> Vector:
        self._b.array_w[:] = right
        self.ksp.solve(self._b, self._x)
        self.iterations += self.ksp.getIterationNumber()
        return np.asarray(self._x.array_r.copy())

    def free(self) -> None:
        """Frees everything. Collective.

        Not `destroy`, which PETSc would call for each thing that has this as its context.
        """
        for thing in (self.matrix, self._x, self._b):
            thing.destroy()


def python_solver(snes: PETSc.SNES, context: Any, prefix: str) -> None:
    """Makes a python context the linear solver of a SNES."""
    ksp = snes.getKSP()
    ksp.setOptionsPrefix(prefix)
    ksp.setType("python")
    ksp.setPythonContext(context)
    ksp.getPC().setType("none")
