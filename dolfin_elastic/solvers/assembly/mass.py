"""The consistent mass: accelerations from forces."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, ConstrainedMatrix, TangentMatrix
from dolfin_elastic.solvers.messages import linear
from dolfin_elastic.solvers.petsc.options import ksp_reason

TOLERANCE = 1e-14
"""Relative residual of the initial acceleration: down to round-off."""


def initial_acceleration(assembler: Assembler, prescribed: FloatArray, a: fem.Function) -> None:
    """Finds the acceleration that goes with the forces in `assembler.residual.vector`. Collective.

    M a = -R where nothing is prescribed, R the forces out of balance without inertia; prescribed
    components keep what is given.  The mass matrix is made, used once by conjugate gradients with
    its diagonal, whose iterations do not depend on the mesh (A. J. Wathen, IMA J. Numer. Anal. 7
    (1987) 449), and freed.

    Args:
        assembler: Of the moving body; its residual is assembled without inertia.
        prescribed: Prescribed accelerations [m/s^2], like `Constraints.targets`.
        a: Receives the acceleration [m/s^2].

    Raises:
        ConvergenceError: A part of the body has no mass.
    """
    problem, size = assembler.problem, len(assembler.displacement_dofs)
    a.x.array[:] = 0.0
    problem.constraints.impose(a.x.array, prescribed)
    a.x.scatter_forward()
    rows = (
        assembler.residual.vector.array[assembler.displacement_dofs] + _inertia(problem, a)[:size]
    )
    constraints, (plain, constrained) = problem.constraints, _matrix(problem)
    matrix = constrained.matrix
    x, b = matrix.createVecs()
    b.array_w[:] = -constraints.free_part(constraints.collect(rows))
    ksp = PETSc.KSP().create(problem.body.comm)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setOperators(matrix)
    ksp.setTolerances(rtol=TOLERANCE, atol=1e-300, max_it=5000)
    ksp.solve(b, x)
    reason, converged = ksp.getConvergedReason(), constraints.free_part(x.array_r)
    for thing in (ksp, x, b, constrained, plain):
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


def mass_diagonal(assembler: Assembler) -> PETSc.Vec:
    """Diagonal of the mass matrix at all unknowns that are free [kg]. Collective.

    The caller destroys it.
    """
    (plain, constrained), out = _matrix(assembler.problem, 0.0), assembler.create_vector()
    diagonal = constrained.matrix.getDiagonal()
    out.array_w[assembler.displacement_dofs] = diagonal.array_r
    out.array_w[assembler.prescribed_dofs] = 0.0
    for thing in (diagonal, constrained, plain):
        thing.destroy()
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


def _inertia(problem: Problem, a: fem.Function) -> FloatArray:
    """M a, local entries of which the owned ones are complete. Collective."""
    V = problem.V
    form = compiled(problem, [problem.weak_form.inertia(a, ufl.TestFunction(V))])[0]
    out = la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)
    fem.assemble_vector(out.array, form)
    out.scatter_reverse(la.InsertMode.add)
    return out.array


def _matrix(problem: Problem, unit: float | None = None) -> tuple[TangentMatrix, ConstrainedMatrix]:
    """The mass matrix, and with its constraints; the caller destroys both. Collective.

    Args:
        unit: See `ConstrainedMatrix.renew`.
    """
    trial, test = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    plain = TangentMatrix(
        BilinearForm(compiled(problem, [problem.weak_form.inertia(trial, test)])[0])
    )
    plain.assemble(problem.constraints.bcs)
    every = np.arange(plain.petsc.getLocalSize()[0])
    constrained = ConstrainedMatrix(problem, problem.constraints, plain.petsc, every)
    constrained.renew(unit)
    return plain, constrained
