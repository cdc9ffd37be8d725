"""Kinetic energy, linear and angular momentum, and lumped mass."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled


def _cross(r: ufl.core.expr.Expr, w: ufl.core.expr.Expr) -> list[ufl.core.expr.Expr]:
    if len(r) == 2:
        return [r[0] * w[1] - r[1] * w[0]]
    c = ufl.cross(r, w)
    return [c[0], c[1], c[2]]


class ConsistentMass:
    """Kinetic energy and momenta as integrals over the body.

    Args:
        problem: The body; its displacement gives the current places.
    """

    def __init__(self, problem: Problem, v: fem.Function) -> None:
        x = ufl.SpatialCoordinate(problem.body.mesh) + problem.u
        terms = [ufl.inner(v, v) / 2, *v, *_cross(x, v)]
        degree = 2 * problem.degree + 1
        forms = [
            sum(
                problem.context.density(region) * term * problem.weak_form.volume(region, degree)
                for region in problem.regions
            )
            + sum(rho * term * ds for rho, ds, _ in problem.context.masses())
            for term in terms
        ]
        self._problem, self._forms = problem, compiled(problem, forms)

    def measure(self) -> tuple[float, FloatArray, FloatArray]:
        """Kinetic energy [J], linear [kg m/s] and angular [kg m^2/s] momentum. Collective."""
        local = np.array([fem.assemble_scalar(form) for form in self._forms])
        return _summed(self._problem, local)


class LumpedMass:
    """The same sums for a mass lumped at the nodes, as the explicit schemes see it.

    Args:
        problem: The body; its displacement gives the current places.
        mass: Mass at every owned entry, unrolled [kg].
    """

    def __init__(self, problem: Problem, v: fem.Function, mass: FloatArray) -> None:
        self._problem, self._v = problem, v
        self._mass = mass.reshape(-1, problem.V.dofmap.index_map_bs)
        self._X = problem.places[: len(self._mass)]

    def measure(self) -> tuple[float, FloatArray, FloatArray]:
        """Kinetic energy [J], linear [kg m/s] and angular [kg m^2/s] momentum. Collective."""
        shape = self._mass.shape
        u = self._problem.u.x.array[: self._mass.size].reshape(shape)
        v = self._v.x.array[: self._mass.size].reshape(shape)
        p = self._mass * v
        x = self._X[:, : shape[1]] + u
        spin = moment_of(x, p).sum(axis=0)
        local = np.concatenate([[0.5 * np.sum(p * v)], p.sum(axis=0), spin])
        return _summed(self._problem, local)


def _summed(problem: Problem, local: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Energy, linear and angular momentum of all ranks. Collective."""
    sums, dim = problem.body.comm.allreduce(local, op=MPI.SUM), problem.body.dim
    if problem.geometry == "axisymmetric":  # only the axial momentum of the ring is not zero
        sums[1], sums[1 + dim :] = 0.0, 0.0
    return float(sums[0]), sums[1 : 1 + dim], sums[1 + dim :]


def lumped(problem: Problem, assembler: Assembler) -> FloatArray:
    """Row sums of the mass matrix at the owned displacements [kg]. Collective."""
    ones = ufl.as_vector([problem.constant(1.0)] * problem.body.dim)
    form = compiled(problem, [problem.weak_form.inertia(ones, problem.v)])[0]
    index_map, bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
    mass = la.vector(index_map, bs)
    fem.assemble_vector(mass.array, form)
    mass.scatter_reverse(la.InsertMode.add)
    return np.asarray(mass.array[assembler.displacement_dofs])
