"""Kinetic energy, linear and angular momentum, and lumped mass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled


class NodalMass:
    """Kinetic energy and momenta, as sums over the nodes.

    Args:
        problem: The body; its displacement gives the current places.
        v: Its velocity [m/s].
        times: Gives M v, owned entries, of those of v.
    """

    def __init__(
        self, problem: Problem, v: fem.Function, times: Callable[[FloatArray], FloatArray]
    ) -> None:
        self._problem, self._v, self._times = problem, v, times
        nodes = problem.V.dofmap.index_map.size_local
        self._X = problem.places[:nodes, : problem.body.dim]

    def measure(self) -> tuple[float, FloatArray, FloatArray]:
        """Kinetic energy [J], linear [kg m/s] and angular [kg m^2/s] momentum. Collective."""
        X, dim = self._X, self._problem.body.dim
        u, v = (f.x.array[: X.size].reshape(X.shape) for f in (self._problem.u, self._v))
        p = self._times(v.reshape(-1)).reshape(X.shape)
        spin = moment_of(X + u, p).sum(axis=0)
        sums = np.concatenate([[0.5 * np.sum(p * v)], p.sum(axis=0), spin])
        sums = total(self._problem.body.comm, sums)
        if self._problem.geometry == "axisymmetric":  # of the ring only the axial one is not zero
            sums[1], sums[1 + dim :] = 0.0, 0.0
        return float(sums[0]), sums[1 : 1 + dim], sums[1 + dim :]


class LumpedMass(NodalMass):
    """The same of a mass lumped at the nodes, as the explicit schemes see it.

    Args:
        problem: The body; its displacement gives the current places.
        v: Its velocity [m/s].
        mass: Mass at every owned entry, unrolled [kg].
    """

    def __init__(self, problem: Problem, v: fem.Function, mass: FloatArray) -> None:
        super().__init__(problem, v, lambda w: mass * w)


def lumped(problem: Problem, assembler: Assembler) -> FloatArray:
    """Row sums of the mass matrix at the owned displacements [kg]. Collective."""
    ones = ufl.as_vector([problem.constant(1.0)] * problem.body.dim)
    form = compiled(problem, [problem.weak_form.inertia(ones, problem.v)])[0]
    index_map, bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
    mass = la.vector(index_map, bs)
    fem.assemble_vector(mass.array, form)
    mass.scatter_reverse(la.InsertMode.add)
    return np.asarray(mass.array[assembler.displacement_dofs])
