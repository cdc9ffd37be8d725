"""Explicit schemes with lumped mass: symplectic Euler, and central differences.

Both change the velocity by the forces of the present displacement and then move on with it.
Euler's v_n+1 = v_n + dt f_n/m, u_n+1 = u_n + dt v_n+1 is of first order.  With the velocity halfway
between two displacements, v_n+1/2 = v_n-1/2 + dt f_n/m, u_n+1 = u_n + dt v_n+1/2, it becomes
central differences, of second order, and v_n = v_n-1/2 + dt/2 f_n/m where a state is asked for.
Both are stable for dt < 2/omega_max, their energy is bounded, and momenta are conserved exactly.

A scheme is one class and one row of the table `SCHEMES` in `solvers/dynamics/schemes.py`.

Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer 2006,
sections I.1.2 and I.1.4; T. Belytschko, W. K. Liu, B. Moran, K. Elkhodary, Nonlinear Finite
Elements for Continua and Structures, 2nd ed., Wiley 2014, section 6.2 (box 6.1).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from time import perf_counter
from typing import ClassVar

import numpy as np
from dolfinx import fem

from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import FormulaError, InputError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.problem.context import show_velocity
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.weak_form import weak_form_without_memory
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.nodal_forces import Forces
from dolfin_elastic.solvers.dynamics.explicit.damper import Damper, sees_velocity
from dolfin_elastic.solvers.dynamics.work import ExternalWork, supports_move


def check_explicit(problem: Problem, scheme: str) -> None:
    """Refuses problems without a positive lumped mass, or with what the schemes do not know.

    Raises:
        InputError: Explicit schemes cannot compute this problem.
    """
    if problem.degree != 1:
        raise InputError(
            f"'{scheme}' needs linear elements: quadratic ones have no positive lumped mass",
            where="mesh.degree",
            expected="degree = 1",
        )
    if problem.w is not problem.u:
        stretch = problem.unknowns.has("stretch")
        raise InputError(
            f"'{scheme}' solves for displacements only",
            where="mesh.geometry" if stretch else "mesh.formulation",
            expected=f"{'not plane stress' if stretch else 'displacement'}, or the scheme "
            "'generalized-alpha'",
        )
    for term in problem.terms:
        if (
            term.nodal
            and term.restrains
            and (term.only_implicit or not (term.opens or term.dissipates))
        ):
            raise InputError(
                f"'{scheme}' knows no forces that answer to the motion and have no UFL form, as "
                f"those of '{term.label}'",
                where="dynamics.scheme",
                expected='"generalized-alpha"',
            )
    for part in problem.regions:
        if part.law.viscosity is not None:
            raise InputError(
                f"the scheme '{scheme}' knows no viscosity",
                where=f"{part.table}.viscosity",
                expected='leave it out, or dynamics.scheme = "generalized-alpha"',
            )


def changes(problem: Problem) -> bool:
    """Whether loads, supports, springs or obstacles depend on time."""
    return (
        (problem.loaded and problem.loads_change)
        or any(not support.at_rest for support in problem.supports)
        or any(not term.at_rest for term in problem.terms)
    )


def mean_acceleration(
    problem: Problem, v: fem.Function, t: float, dt: float, interval: float
) -> FloatArray:
    """Mean acceleration that supports prescribe [m/s^2]. Collective.

    It is that of the next step; where a curve or formula has no value any more, that of the last
    steps.

    Args:
        v: Velocity [m/s].
        t: Time [s].
        dt: The last step [s].
        interval: From the time of the velocity to the middle of its next step [s].
    """
    held = problem.constraints
    here, now = held.constrained_part(problem.u.x.array), held.constrained_part(v.x.array)

    def targets(time: float) -> FloatArray:
        try:
            return np.asarray(held.targets_at((time,))[0])
        except FormulaError:  # of a curve or an angle: on all ranks
            return np.full_like(here, np.nan)

    result: AnyArray = ((targets(t + dt) - here) / dt - now) / interval
    if not np.all(np.isfinite(result)):
        back: AnyArray = np.zeros_like(here)
        if t > 1.5 * dt:
            back = (here - 2 * targets(t - dt) + targets(max(t - 2 * dt, 0.0))) / dt**2
        result = np.where(np.isfinite(result), result, back)
    problem.set_time(t)
    return np.asarray(result, dtype=np.float64)


END = 1 - 1e-12
"""Share of the duration at which the end is reached."""


class ExplicitScheme(ABC):
    """Displacement and velocity of a body, a step at a time. Collective.

    Args:
        mass: Lumped mass at every owned entry [kg].
        v: Velocity, in its initial state; changed by steps.
        work: Sums up the work of loads and supports that change.
        end: When the motion ends [s].
        dt: First step [s].
        chosen: The user's step, which all steps but the last have [s]; None: steps change.
        damper: None without damping, which only schemes that `damps` know.

    Attributes:
        damps: The scheme knows damping.
        a: Acceleration [m/s^2], after `start` or `synchronise`.
        t: Time [s].
        steps: Number of steps done.
        dt: The last step [s].
        velocity: Owned entries of the velocity [m/s]; a scheme may hold it at another time.
        out_of_balance: Owned entries of the forces out of balance [N]: minus the nodal forces.
        change: Change of the velocity in a step, owned entries [m/s].
        free: 1 at owned entries that no support prescribes, 0 at the others.
        remaining: For how long the forces at the present displacement have still to accelerate the
            body, where the velocity is behind it [s]; 0 at states.
    """

    remaining = 0.0
    damps: ClassVar[bool] = False

    def __init__(
        self,
        assembler: Assembler,
        mass: FloatArray,
        v: fem.Function,
        work: ExternalWork,
        *,
        end: float,
        dt: float,
        chosen: float | None,
        damper: Damper | None = None,
    ) -> None:
        self._damper = damper
        self.problem, self.mass, self._velocity = assembler.problem, mass, v
        self._work, self._end, self._chosen = work, end, chosen
        self.a = fem.Function(self.problem.V, name="acceleration")
        residual, self._history = assembler.residual, self.problem.history
        steps = None if self._history is None else self._history.fused
        work = residual.work
        if steps is not None:
            work = weak_form_without_memory(self.problem.weak_form).residual
        self._forces = Forces(self.problem, work, residual.vector, points=-1.0, steps=steps)
        self._supports_move = supports_move(self.problem)
        self._timed = changes(self.problem) or self._history is not None
        self._imposed = self._supports_move or self.problem.constraints.skewed
        arrays = self.problem.u.x.array, v.x.array, assembler.residual.vector.array
        self._u, self.velocity, self.out_of_balance = (array[: assembler.size] for array in arrays)
        self._factor, self.free = self._mobility(), np.ones(assembler.size)
        self.free[self.problem.constraints.prescribed_dofs] = 0.0
        self.change, self._du = np.zeros(assembler.size), np.zeros(assembler.size)
        self.t, self.steps, self.dt = 0.0, 0, dt

    def _mobility(self) -> FloatArray:
        """-1/m at owned entries, 0 where supports prevent any motion [1/kg]."""
        factor = -1 / self.mass
        if not self._supports_move:
            factor[self.problem.constraints.prescribed_dofs] = 0.0
        return np.asarray(factor)

    @classmethod
    def check(cls, problem: Problem, name: str) -> None:
        """Refuses what the scheme cannot compute. Not collective.

        Raises:
            InputError: It cannot compute this problem.
        """
        check_explicit(problem, name)

    def kick(self, dt: float) -> None:
        """Sets `change` to that of the present forces.

        Args:
            dt: The step [s].
        """
        np.multiply(self.out_of_balance, self._factor, out=self.change)
        self.change *= self.kick_duration(dt)

    def _at_forces(self) -> FloatArray:
        """The velocity at the time of the forces, with damping."""
        assert self._damper is not None
        acceleration = self.out_of_balance * self._factor
        return self._damper.at_forces(self.velocity, acceleration, self.remaining)

    def begin_damping(self) -> None:
        """What is lost by damping is summed up from the present state on."""
        if self._damper is not None:
            self._damper.begin(self._at_forces())

    # --- what the schemes differ in ---

    @abstractmethod
    def kick_duration(self, dt: float) -> float:
        """For how long the present forces accelerate the body before it moves on [s].

        Args:
            dt: The step [s].
        """

    @abstractmethod
    def synchronise(self) -> None:
        """Brings the velocity to the time of the displacement, and finds the acceleration."""

    @abstractmethod
    def start(self) -> None:
        """Finds the acceleration of the state that the motion begins with."""

    @abstractmethod
    def conserved_excess(self, dt: float) -> float:
        """Energy that the scheme conserves minus that of the state, on this rank [J].

        In linear problems U + m v- . v+ / 2 is conserved exactly, with the velocities before and
        after the displacement of U; the energy of one time oscillates about it.

        Args:
            dt: The step to come [s].
        """

    # --- one step ---

    def advance(self, dt: float) -> None:
        """One step; the forces at its start are there before, those at its end afterwards.

        Args:
            dt: The step [s].
        """
        begin = perf_counter()
        # Not before: a motion that is restarted has the forces of what the state remembers.
        self.problem.terms.advance()
        v, change, du = self.velocity, self.change, self._du
        self.kick(dt)
        self.steps += 1
        self.t = self._without_round_off(self.t + dt)
        if self._timed:
            self.problem.set_time(self.t)
        if self._imposed:
            self._impose_motion(dt)
        v += change
        np.multiply(v, dt, out=du)
        self._u += du
        self.problem.u.x.scatter_forward()
        self.dt = dt
        middle = perf_counter()
        timing.add("solve", middle - begin)
        self.update_dashpots()
        self.assemble_forces(accept=True)
        if self._work.paths:
            self._work.step(du)
        if self._damper is not None:
            self._damper.step(self._at_forces(), du)
        timing.add("assemble", perf_counter() - middle)
        self.commit(settle=False)

    def commit(self, *, settle: bool = True) -> None:
        """Makes the present state the past of materials that remember. Collective.

        No step is ever taken back, and the forces of this one are there already.

        Args:
            settle: See `History.commit`.
        """
        if self._history is not None:
            self._history.commit(settle=settle)

    def settle(self) -> None:
        """Has materials that remember begin the next step, before their stiffness is asked for."""
        if self._history is not None:
            self._history.settle()

    def _without_round_off(self, t: float) -> float:
        """A time without the round-off of a sum: of equal steps, and the end."""
        even = t if self._chosen is None else self.steps * self._chosen
        meant = self._end if t >= self._end * END else even
        return meant if abs(meant - t) < 1e-9 * (self._chosen or self.dt) else t

    def _impose_motion(self, dt: float) -> None:
        """Sets the velocity change at supports so that they reach their prescribed displacement."""
        constraints = self.problem.constraints
        gap = constraints.targets - constraints.constrained_part(self.problem.u.x.array)
        self.change += self.velocity
        constraints.impose(self.change, np.asarray(gap / dt))
        self.change -= self.velocity

    def update_dashpots(self) -> None:
        """Gives dashpots the velocity, which may be that of half a step before."""
        if self.problem.dashpots or sees_velocity(self._damper):
            show_velocity(self.problem.context, self.velocity)

    def assemble_forces(self, *, accept: bool = False) -> None:
        """Forces out of balance at the present displacement and time.

        Args:
            accept: See `Forces.assemble`.
        """
        if not accept:
            self.settle()
        if self._timed:
            self._forces.renew()
            self._work.update_time()
        self._forces.assemble(accept=accept)
        if self._damper is not None:
            self._damper.add_to(self.out_of_balance)

    def fingerprint(self) -> bytes:
        """See `Forces.fingerprint`."""
        return self._forces.fingerprint()

    def renew_forces(self) -> None:
        """Takes over forces that a program has changed at the present state. Collective."""
        self._forces.pack_again()
        self.assemble_forces()

    @np.errstate(all="ignore")
    def find_acceleration(self, interval: float) -> None:
        """Sets `a` and `change` to forces over mass; of supports, their mean acceleration.

        Args:
            interval: From the time of the velocity to the middle of the velocity's next step [s].
        """
        np.multiply(self.out_of_balance, self._factor, out=self.change)
        if self._damper is not None:
            self.change -= self._damper.rate * self._at_forces()
        if self._imposed:
            driven = mean_acceleration(self.problem, self._velocity, self.t, self.dt, interval)
            self.problem.constraints.impose(self.change, driven)
        self.set_acceleration(self.change + 0.0)  # no -0

    def set_acceleration(self, a: FloatArray) -> None:
        """Sets the acceleration of the state.

        Args:
            a: Owned entries [m/s^2].
        """
        self.a.x.array[: len(a)] = a
        self.a.x.scatter_forward()

    def update_velocity(self) -> None:
        """Brings ghost entries of the velocity up to date."""
        self._velocity.x.scatter_forward()

    def resume(self, t: float, steps: int, remaining: float) -> None:
        """Goes back to a state whose displacement and velocity were restored.

        Args:
            t: Time [s].
            remaining: See the attribute.
        """
        self.t, self.steps, self.remaining = t, steps, remaining
        self.problem.set_time(t)
        self.assemble_forces()


class SymplecticEuler(ExplicitScheme):
    """v += dt f/m, then u += dt v.

    The acceleration is the mean of the step before, that of the first state of the step after.
    """

    def kick_duration(self, dt: float) -> float:
        """See `ExplicitScheme`."""
        return dt

    def synchronise(self) -> None:
        """See `ExplicitScheme`."""
        self.set_acceleration(self.change / self.dt)
        self.update_velocity()

    def start(self) -> None:
        """See `ExplicitScheme`."""
        self.find_acceleration(self.dt)

    def conserved_excess(self, dt: float) -> float:
        """See `ExplicitScheme`; nodes of supports have no force but that of the body."""
        power = self.velocity * self.out_of_balance * self.free
        return -0.5 * dt * float(np.sum(power))


class CentralDifferences(ExplicitScheme):
    """The velocity is that halfway to the next displacement.

    States have velocity and acceleration of their own time; where a support moves, they are the
    differences of its displacements before and after.
    """

    damps = True

    def kick(self, dt: float) -> None:
        """See `ExplicitScheme`; with damping see `damper`."""
        if self._damper is None or self._damper.rate == 0.0:
            super().kick(dt)
            return
        v, self.remaining = self._at_forces(), dt / 2
        np.multiply(self.out_of_balance, self._factor, out=self.change)
        self.change *= self.remaining
        self.change += (1 - self._damper.rate * self.remaining) * v - self.velocity

    def kick_duration(self, dt: float) -> float:
        """See `ExplicitScheme`."""
        duration, self.remaining = self.remaining + dt / 2, dt / 2
        return duration

    def synchronise(self) -> None:
        """See `ExplicitScheme`."""
        self.find_acceleration(self.dt / 2 + self.remaining)
        self.change *= self.remaining
        self.velocity += self.change
        self.update_velocity()
        self.remaining = 0.0

    def start(self) -> None:
        """See `ExplicitScheme`."""
        self.synchronise()

    def conserved_excess(self, dt: float) -> float:
        """See `ExplicitScheme`."""
        a = self.a.x.array[: len(self.velocity)]
        return -(dt**2) / 8 * float(np.sum(self.mass * a**2 * self.free))
