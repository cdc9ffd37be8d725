"""The consistent mass: accelerations from forces."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks
from dolfin_elastic.solvers.assembly.scalar_mass import ScalarMass
from dolfin_elastic.solvers.messages import linear
from dolfin_elastic.solvers.petsc.options import ksp_reason

TOLERANCE = 1e-14
"""Relative residual of the initial acceleration: down to round-off."""


class _FreeMass:
    """T^T M T, and ones elsewhere, as PETSc calls a matrix of type "python"."""

    def __init__(self, mass: ScalarMass, rows: Rows) -> None:
        self._mass, self._rows, self._diagonal = mass, rows, mass.diagonal()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Collective."""
        whole = x.array_r.copy()
        moved = self._rows.free_part(whole)
        self._rows.extend(moved)
        forces = self._rows.free_part(self._rows.collect(self._mass.times(moved)))
        y.array_w[:] = forces + self._rows.constrained_part(whole)

    def getDiagonal(self, matrix: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """That of M, which is near enough to scale by. Not collective."""
        diagonal.array_w[:] = self._diagonal


def initial_acceleration(
    assembler: Assembler, mass: ScalarMass, prescribed: FloatArray, a: fem.Function
) -> None:
    """Finds the acceleration that goes with the forces in `assembler.residual.vector`. Collective.

    M a = -R where nothing is prescribed, R the forces out of balance without inertia; prescribed
    components keep what is given.  By conjugate gradients with the diagonal, whose iterations do
    not depend on the mesh (A. J. Wathen, IMA J. Numer. Anal. 7 (1987) 449).

    Args:
        assembler: Of the moving body; its residual is assembled without inertia.
        prescribed: Prescribed accelerations [m/s^2], like `Constraints.targets`.
        a: Receives the acceleration [m/s^2].

    Raises:
        ConvergenceError: A part of the body has no mass.
    """
    constraints, size = assembler.problem.constraints, len(assembler.displacement_dofs)
    a.x.array[:] = 0.0
    constraints.impose(a.x.array, prescribed)
    rows = assembler.residual.owned[assembler.displacement_dofs] + mass.times(a.x.array[:size])
    sizes = ((size, None),) * 2
    matrix = PETSc.Mat().createPython(sizes, _FreeMass(mass, constraints), assembler.comm)
    matrix.setUp()
    x, b = matrix.createVecs()
    b.array_w[:] = -constraints.free_part(constraints.collect(rows))
    ksp = PETSc.KSP().create(assembler.comm)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setOperators(matrix)
    ksp.setTolerances(rtol=TOLERANCE, atol=1e-300, max_it=5000)
    ksp.solve(b, x)
    reason, converged = ksp.getConvergedReason(), constraints.free_part(x.array_r)
    for thing in (ksp, x, b, matrix):
        thing.destroy()
    # Round-off may keep it just above the tolerance: only a breakdown is a fault.
    if reason < 0 and reason != PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
        raise ConvergenceError(
            f"the initial acceleration cannot be found: {linear(ksp_reason(reason))[0]}",
            advice="is every density positive, and are all initial values finite?",
        )
    constraints.extend(converged)
    a.x.array[:size] += converged
    a.x.scatter_forward()


def mass_diagonal(assembler: Assembler, mass: ScalarMass) -> PETSc.Vec:
    """Diagonal of T^T M T at all unknowns that are free [kg]. Collective.

    The caller destroys it.
    """
    out, rows = assembler.create_vector(), assembler.problem.constraints
    if assembler.tied:
        blocks = NodeBlocks(assembler, mass.blocks)
        blocks.free().getDiagonal(out)
        blocks.destroy()
    else:
        diagonal = mass.diagonal()
        diagonal[rows.skew_dofs] *= 1 - np.einsum("nii->ni", rows.P)
        out.array_w[assembler.displacement_dofs] = diagonal
    out.array_w[assembler.prescribed_dofs] = 0.0
    return out


def prescribed_acceleration(problem: Problem, h: float) -> FloatArray:
    """Second derivative of what is prescribed at time 0 [m/s^2], as `Constraints.targets`.

    By differences forward in time, of second order.  Not collective.

    Args:
        problem: Its time is 0 afterwards.
        h: Step of the differences [s].
    """
    values = problem.constraints.targets_at(k * h for k in range(4))
    problem.set_time(0.0)
    acceleration = (2 * values[0] - 5 * values[1] + 4 * values[2] - values[3]) / h**2
    return np.asarray(np.nan_to_num(acceleration, nan=0.0, posinf=0.0, neginf=0.0))


def prescribed_rates(problem: Problem, t: float, h: float) -> tuple[FloatArray, FloatArray]:
    """Velocity [m/s], acceleration [m/s^2] of what is prescribed, as `Constraints.targets`.

    By central differences: the velocity over h/4, the acceleration as the difference of velocities
    half a step before and after, so that over all steps it sums up to the change of velocity,
    kinks of curves included.  Where there is no value any more after t it is taken as unchanged.
    Changes the time of what is prescribed.  Not collective.

    Args:
        t: Time [s].
        h: The step [s].
    """

    def velocity(at: float) -> FloatArray:
        times = (max(time, 0.0) for time in (at - h / 8, at + h / 8))
        before, after = problem.constraints.targets_at(times)
        return np.asarray((after - before) * 4 / h)

    before, now, after = (velocity(at) for at in (t - h / 2, t, t + h / 2))
    now, after = (np.where(np.isfinite(v), v, before) for v in (now, after))
    return now, np.asarray((after - before) / h)
