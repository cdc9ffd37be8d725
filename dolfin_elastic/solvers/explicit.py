"""Semi-implicit (symplectic) Euler: v += dt f/m, then x += dt v, with lumped mass.

Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer 2006,
section I.1.2; first order, stable for dt < 2/omega_max, energy bounded, momenta kept exactly.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc
from slepc4py import SLEPc

from dolfin_elastic.errors import InputError, StabilityError
from dolfin_elastic.parallel import largest, total
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import Assembler, compiled
from dolfin_elastic.solvers.contact import Measured, all_touching
from dolfin_elastic.solvers.motion import LumpedMass, Strain, lumped
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage

log = logging.getLogger("dolfin_elastic")
Vector = npt.NDArray[np.float64]

DRIFT = 0.1
"""Share of the energy that may come from nowhere before the stable step is looked at again."""

RECHECK = (10, 200)
"""Fewest and most steps between two estimates of the stable step: the less it changes, the more."""


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
        check_explicit(problem)
        self.problem, self.v, self.end, self.every = problem, v, end, every
        self.safety, self._chosen = safety, dt
        self.a = fem.Function(problem.V, name="acceleration")
        self.assembler = Assembler(problem)
        self.strain, self._measured = Strain(problem), Measured(problem, moving=True)
        self.mass = lumped(problem, self.assembler)
        self.measure = LumpedMass(problem, v, self.mass)
        self._drag = self._drag_rows()
        self.dt = self._first_step()
        self._local_work = 0.0
        self._change = np.zeros(self.assembler.size)
        self._inertia = np.zeros(self.assembler.size)
        self._dt_done = self.dt
        self._interval = RECHECK[0]
        self._initial = 0.0

    # --- the stable step ---

    def stable_step(self) -> float:
        """2/omega_max of the present tangent and the lumped mass [s]. Collective.

        omega_max^2 is the largest eigenvalue of M^-1/2 K M^-1/2, found by Lanczos.
        """
        with stage("solve"):
            x, scale = self.assembler.create_vector(), self.assembler.create_vector()
            self.assembler.get(x)
            with all_touching(self.problem):  # what is free now may hit within the next steps
                self.assembler.tangent(x, unit=0.0)
            scale.array_w[:] = 1 / np.sqrt(self.mass)
            scale.array_w[self.problem.prescribed.owned] = 0.0
            self.assembler.matrix.diagonalScale(scale, scale)
            self.assembler.forget_tangent()
            square = _largest_eigenvalue(self.assembler.matrix, self.problem.symmetric)
            x.destroy()
            scale.destroy()
        return self._damped(square)

    def _damped(self, square: float) -> float:
        """Stable step for the largest omega^2 and the dashpots' largest rate c/m [s]. Collective.

        With dashpots at the old velocity, z^2 - (2 - h c/m - h^2 omega^2) z + 1 - h c/m has no root
        beyond -1 up to h = 4/(c/m + sqrt((c/m)^2 + 4 omega^2)), which is 2/omega without them.
        """
        rate = 0.0
        if self._drag is not None:
            rows = self._drag / self.mass
            rate = largest(self.problem.body.comm, float(np.max(rows, initial=0.0)))
        below = rate + np.sqrt(rate**2 + 4 * max(square, 0.0))
        return float(4 / below) if below > 0 else np.inf

    def _drag_rows(self) -> Vector | None:
        """Bounds of the rows of the dashpots' matrix, owned entries [N s/m]. Collective."""
        dashpots = self.problem.dashpots
        if not dashpots:
            return None
        form = sum(dashpot.bound(self.problem.site) for dashpot in dashpots)
        return self.assembler.nodal(compiled(self.problem, [form])[0])

    def _tell_dashpots(self) -> None:
        if self._drag is not None:
            self.problem.site.velocity.x.array[:] = self.v.x.array
            self.problem.site.velocity.x.scatter_forward()

    def _first_step(self) -> float:
        stable = self._stable = self.stable_step()
        if self._chosen is None:
            dt = min(self.safety * stable, self.end)
            log.info("stable step %.4g s, taken %.4g s (safety %g)", stable, dt, self.safety)
            return dt
        if self._chosen > stable:
            self.assembler.destroy()
            raise InputError(
                f"{self._chosen:.4g} s is above the stable step, {stable:.4g} s",
                where="dynamics.dt",
                expected="leave dt out to have it chosen, or "
                f"give at most {self.safety * stable:.3g} s",
            )
        return self._chosen

    def _recheck(self, t: float) -> int:
        """Estimates the stable step anew; returns after how many steps to do it again."""
        if self.problem.linear:
            return RECHECK[1]  # it cannot have changed
        before, self._stable = self._stable, self.stable_step()
        if self._chosen is None:
            self.dt = self.safety * self._stable
        elif self._chosen > self._stable:
            raise StabilityError(
                f"at t = {t:.6g} s the stable step has fallen to {self._stable:.4g} s, below "
                f"dt = {self._chosen:.4g} s, because the body has deformed",
                advice="leave dt out to have it follow the stable step",
            )
        change = abs(self._stable / before - 1) if np.isfinite(before) else 0.0
        factor = 2.0 if change < 0.01 else 0.5 if change > 0.03 else 1.0
        return int(np.clip(factor * self._interval, *RECHECK))

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
        t, step, check = 0.0, 0, RECHECK[0]
        self._interval = check
        with stage("assemble"):
            self._tell_dashpots()
            self.assembler.assemble_balance()
            self._forces = self._applied()
        first = self._state(step, t)
        self._initial = first.energies["total"]
        yield first
        while t < self.end * (1 - 1e-12):
            if step == check:
                self._interval = self._recheck(t)
                check = step + self._interval
            dt = min(self.dt, self.end - t)
            self._advance(t, dt)
            t, step = t + dt, step + 1
            if step % self.every == 0 or t >= self.end * (1 - 1e-12):
                state = self._state(step, t)
                if self._drifts(state.energies):
                    check = step
                yield state

    def _drifts(self, energies: Mapping[str, float]) -> bool:
        """Energy that no load has given appears or is lost: the sign of a step too long."""
        gained = energies["total"] - energies["external"]
        scale = max(energies["kinetic"], energies["strain"], abs(energies["external"]))
        drifts = abs(gained - self._initial) > DRIFT * scale
        if drifts:
            self._initial = gained  # looked into once
        return drifts

    def _advance(self, t: float, dt: float) -> None:
        """One step; `balance` holds the forces at t before and at t + dt afterwards."""
        n, u, v = self.assembler.size, self.problem.u.x, self.v.x
        a, held = self.assembler, self.problem.prescribed
        with stage("solve"):
            reactions = a.constraint_forces(a.balance.array[:n])
            old = v.array[:n].copy()
            np.multiply(a.balance.array[:n], -dt / self.mass, out=self._change)
            self.problem.set_time(t + dt)
            goal = (held.targets - held.present(u.array)) / dt
            v.array[:n] += self._change
            held.impose(v.array[:n], goal)
            np.subtract(v.array[:n], old, out=self._change)
            u.array[:n] += dt * v.array[:n]
            u.scatter_forward()
        with stage("assemble"):
            self._tell_dashpots()
            a.assemble_balance()
        self._dt_done = dt
        self._add_work(dt, reactions, a.constraint_forces(old))

    def _add_work(self, dt: float, reactions: Vector, before: Vector) -> None:
        """This rank's work of loads and supports over a step, by the trapezoidal rule.

        What a support gives to the mass it moves is the change of that mass's kinetic energy.
        """
        a, n = self.assembler, self.assembler.size
        forces = self._forces
        if self.problem.loads_change or self.problem.holding:
            forces = self._applied()
        v = self.v.x.array[:n]
        now = a.constraint_forces(v)
        reactions = reactions + a.constraint_forces(a.balance.array[:n])
        pushed = dt * np.dot(reactions / 2, now)
        moved = 0.5 * np.dot(self.mass, now * now - before * before)
        loaded = dt * (np.dot(forces, v) + np.dot(self._forces, v)) / 2
        self._local_work += float(pushed + moved + loaded)
        self._forces = forces

    def _applied(self) -> Vector:
        """Nodal forces of loads, and of all that holds by forces [N]."""
        forces = self.assembler.external_forces()
        return forces + self.assembler.holding_forces() if self.problem.holding else forces

    def _acceleration(self) -> None:
        """Mean acceleration of the last step, and with it the reactions of moving supports."""
        n = self.assembler.size
        self.a.x.array[:n] = self._change / self._dt_done
        self.a.x.scatter_forward()
        self._inertia[:] = self.assembler.constraint_forces(self.mass * self.a.x.array[:n])

    def _state(self, step: int, t: float) -> State:
        kinetic, linear, angular = self.measure.measure()
        if not np.isfinite(kinetic):
            raise StabilityError(
                f"the motion has no finite velocity at t = {t:.6g} s",
                advice="a smaller dt or safety",
            )
        strain, more = self.strain.energy(), self._measured.energies()
        self._acceleration()
        energies = {
            "strain": strain,
            "kinetic": kinetic,
            "total": strain + kinetic + sum(more.values()),
            "external": float(total(self.problem.body.comm, self._local_work)),
            **self.strain.springs(),
            **more,
        }
        return State(
            step=step,
            t=t,
            u=self.problem.u,
            v=self.v,
            a=self.a,
            reason="explicit",
            energies=energies,
            reactions=self.assembler.reactions(self._inertia),
            momenta={"linear": linear, "angular": angular},
            max_displacement=self.assembler.max_displacement(),
            numbers=self._measured.numbers(),
            done=t / self.end,
        )


def check_explicit(problem: Problem) -> None:
    """The scheme needs a lumped mass, and displacements as the only unknowns.

    Raises:
        InputError: It cannot compute this problem.
    """
    if problem.degree != 1:
        raise InputError(
            "'symplectic-euler' needs linear elements: quadratic ones have no positive lumped mass",
            where="mesh.degree",
            expected="degree = 1",
        )
    if problem.w is not problem.u:
        stretch = problem.unknowns.has("stretch")
        raise InputError(
            "'symplectic-euler' solves for displacements only",
            where="mesh.geometry" if stretch else "mesh.formulation",
            expected=f"{'not plane stress' if stretch else 'displacement'}, or the scheme "
            "'generalized-alpha'",
        )


def _largest_eigenvalue(matrix: PETSc.Mat, symmetric: bool) -> float:
    eps = SLEPc.EPS().create(matrix.comm)
    eps.setOperators(matrix)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP if symmetric else SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
    eps.setTolerances(tol=1e-3, max_it=200)
    try:
        eps.solve()
        found = eps.getConverged() > 0
        value = float(eps.getEigenvalue(0).real) if found else 0.0
    except PETSc.Error:  # "invalid inner product: nan"
        found, value = False, 0.0
    finally:
        eps.destroy()
    if not found:
        raise StabilityError(
            "the stable step cannot be estimated: no largest eigenvalue was found",
            advice="is the displacement finite, and every density positive?",
        )
    return value
