"""Semi-implicit (symplectic) Euler: v += dt f/m, then x += dt v, with lumped mass.

Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer 2006,
section I.1.2; first order, stable for dt < 2/omega_max, energy bounded, momenta kept exactly.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from petsc4py import PETSc
from slepc4py import SLEPc

from dolfin_elastic.errors import InputError, StabilityError
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import Assembler, compiled
from dolfin_elastic.solvers.motion import LumpedMass, Strain, work
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage

log = logging.getLogger("dolfin_elastic")
Vector = npt.NDArray[np.float64]

RECHECK = 20
"""Steps between two estimates of the stable step: a body may stiffen fast when it is crushed."""


class SymplecticEuler:
    """The explicit scheme on one problem.

    Args:
        problem: What moves, in its initial state; linear elements, all densities given.
        v: Velocity, in its initial state.
        end: When it ends [s].
        dt: Time step [s]; None for the stable step times `safety`.
        safety: Share of the stable step.
        every: Steps from one yielded state to the next.

    Raises:
        InputError: The elements are not linear (their lumped mass is not positive), or dt is
            above the stable step.
    """

    def __init__(
        self,
        problem: Problem,
        v: fem.Function,
        *,
        end: float,
        dt: float | None,
        safety: float,
        every: int,
    ) -> None:
        if problem.degree != 1:
            raise InputError(
                "'symplectic-euler' needs linear elements: quadratic ones have no "
                "positive lumped mass",
                where="mesh.degree",
                expected="degree = 1",
            )
        self.problem, self.v, self.end, self.every = problem, v, end, every
        self.safety, self._chosen = safety, dt
        self.a = fem.Function(problem.V, name="acceleration")
        self.assembler = Assembler(problem)
        self.strain = Strain(problem)
        self.mass = self._lumped()
        self.measure = LumpedMass(problem, v, self.mass)
        self.dt = self._first_step()
        self._external_work = 0.0
        self._last: tuple[Vector, Vector] | None = None

    def _lumped(self) -> Vector:
        """Row sums of the mass matrix, owned entries [kg]. Collective."""
        bs = self.problem.body.dim
        ones = ufl.as_vector([self.problem.constant(1.0)] * bs)
        form = compiled(self.problem, [self.problem.inertia(ones, self.problem.v)])[0]
        mass = la.vector(self.problem.V.dofmap.index_map, bs)
        fem.assemble_vector(mass.array, form)
        mass.scatter_reverse(la.InsertMode.add)
        return mass.array[: self.assembler.size].copy()

    # --- the stable step ---

    def stable_step(self) -> float:
        """2/omega_max of the present tangent and the lumped mass [s]. Collective.

        omega_max^2 is the largest eigenvalue of M^-1/2 K M^-1/2, found by Lanczos.
        """
        with stage("solve"):
            x, scale = self.assembler.create_vector(), self.assembler.create_vector()
            self.assembler.get(x)
            self.assembler.tangent(x)
            scale.array_w[:] = 1 / np.sqrt(self.mass)
            scale.array_w[self.problem.prescribed.owned] = 0.0
            self.assembler.matrix.diagonalScale(scale, scale)
            largest = _largest_eigenvalue(self.assembler.matrix, self.problem.has_energy)
            x.destroy()
            scale.destroy()
        return float(2 / np.sqrt(largest)) if largest > 0 else np.inf

    def _first_step(self) -> float:
        stable = self.stable_step()
        if self._chosen is None:
            dt = min(self.safety * stable, self.end)
            log.info("stable step %.4g s, taken %.4g s (safety %g)", stable, dt, self.safety)
            return dt
        if self._chosen > stable:
            raise InputError(
                f"{self._chosen:.4g} s is above the stable step, {stable:.4g} s",
                where="dynamics.dt",
                expected="leave dt out to have it chosen, or "
                f"give at most {self.safety * stable:.3g} s",
            )
        return self._chosen

    def _recheck(self, t: float) -> None:
        stable = self.stable_step()
        if self._chosen is None:
            self.dt = self.safety * stable
        elif self._chosen > stable:
            raise StabilityError(
                f"at t = {t:.6g} s the stable step has fallen to {stable:.4g} s, below "
                f"dt = {self._chosen:.4g} s, because the body has deformed",
                advice="leave dt out to have it follow the stable step",
            )

    # --- the loop ---

    def steps(self) -> Iterator[State]:
        """Yields the initial state and then every `every`-th one. Collective.

        Raises:
            StabilityError: The step became larger than the stable one, or the state is lost.
        """
        try:
            yield from self._march()
        finally:
            self.assembler.destroy()

    def _march(self) -> Iterator[State]:
        t, step = 0.0, 0
        with stage("assemble"):
            self.assembler.assemble_balance()
        yield self._state(step, t)
        while t < self.end * (1 - 1e-12):
            if step and step % RECHECK == 0:
                self._recheck(t)
            dt = min(self.dt, self.end - t)
            record = (step + 1) % self.every == 0 or t + dt >= self.end * (1 - 1e-12)
            before = self.v.x.array.copy() if record else None
            self._advance(t, dt)
            if before is not None:
                self.a.x.array[:] = (self.v.x.array - before) / dt
                self.a.x.scatter_forward()
            t, step = t + dt, step + 1
            if record:
                yield self._state(step, t)

    def _advance(self, t: float, dt: float) -> None:
        """One step; `balance` holds the forces at t before and at t + dt afterwards."""
        n, u, v = self.assembler.size, self.problem.u.x, self.v.x
        held = self.problem.prescribed
        balance = self.assembler.balance.array
        with stage("solve"):
            v.array[:n] -= dt * balance[:n] / self.mass
            self.problem.set_time(t + dt)
            v.array[held.owned] = (held.values.x.array[held.owned] - u.array[held.owned]) / dt
            u.array[:n] += dt * v.array[:n]
            u.scatter_forward()
        with stage("assemble"):
            self.assembler.assemble_balance()

    def _add_work(self) -> None:
        """Work of loads and supports since the last state, by the trapezoidal rule."""
        forces = self.assembler.external_forces().copy()
        held = self.problem.prescribed.owned
        forces[held] += self.assembler.balance.array[held]
        u = self.problem.u.x.array[: self.assembler.size].copy()
        if self._last is not None:
            mean, du = (forces + self._last[0]) / 2, u - self._last[1]
            self._external_work += work(self.problem, mean, du)
        self._last = forces, u

    def _state(self, step: int, t: float) -> State:
        kinetic, linear, angular = self.measure.measure()
        self._add_work()
        if not np.isfinite(kinetic):
            raise StabilityError(
                f"the motion has no finite velocity at t = {t:.6g} s",
                advice="a smaller dt or safety",
            )
        strain = self.strain.energy()
        return State(
            step=step,
            t=t,
            u=self.problem.u,
            v=self.v,
            a=self.a,
            reason="explicit",
            energies={
                "strain": strain,
                "kinetic": kinetic,
                "total": strain + kinetic,
                "external": self._external_work,
            },
            reactions=self.assembler.reactions(),
            momenta={"linear": linear, "angular": angular},
            max_displacement=self.assembler.max_displacement(),
            done=t / self.end,
        )


def _largest_eigenvalue(matrix: PETSc.Mat, symmetric: bool) -> float:
    eps = SLEPc.EPS().create(matrix.comm)
    eps.setOperators(matrix)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP if symmetric else SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
    eps.setTolerances(tol=1e-3, max_it=200)
    eps.solve()
    value = eps.getEigenvalue(0).real if eps.getConverged() else 0.0
    eps.destroy()
    return float(value)
