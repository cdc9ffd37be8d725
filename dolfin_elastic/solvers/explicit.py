"""Explicit motion with lumped mass: symplectic Euler, and central differences.

Both push the velocity by the forces of the present place and then move on with it.  Euler's
v_n+1 = v_n + dt f_n/m, u_n+1 = u_n + dt v_n+1 is of first order.  With the velocity halfway between
two places, v_n+1/2 = v_n-1/2 + dt f_n/m, u_n+1 = u_n + dt v_n+1/2, it becomes central differences,
of second order, and v_n = v_n-1/2 + dt/2 f_n/m where a state is asked for.  Both are stable for
dt < 2/omega_max, their energy is bounded, and momenta are kept exactly.

Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer 2006,
sections I.1.2 and I.1.4; T. Belytschko, W. K. Liu, B. Moran, K. Elkhodary, Nonlinear Finite
Elements for Continua and Structures, 2nd ed., Wiley 2014, section 6.2 (box 6.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic import timing
from dolfin_elastic.errors import InputError, StabilityError
from dolfin_elastic.kept import Kept, Restore
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.contact import Measured
from dolfin_elastic.solvers.forces import Forces
from dolfin_elastic.solvers.motion import LumpedMass, Strain, lumped
from dolfin_elastic.solvers.stable import StepSize
from dolfin_elastic.solvers.worklog import WorkLog, supports_move
from dolfin_elastic.state import State

Vector = npt.NDArray[np.float64]

DRIFT = 0.1
"""Share of the energy that may come from nowhere before the stable step is looked at again."""

STATES = 200
"""About as many states are yielded if nothing else is said."""

END = 1 - 1e-12
"""Share of the duration at which the end is reached."""


class Explicit:
    """An explicit scheme on one problem. Collective.

    Args:
        problem: What moves, in its initial state; linear elements, all densities given.
        v: Velocity, in its initial state.
        end: When it ends [s].
        dt: Time step [s]; None for the stable step times `safety`.
        safety: Share of the stable step.
        every: Steps from one yielded state to the next; 0: about `STATES` in all.

    Raises:
        InputError: The elements are not linear (their lumped mass is not positive), or dt is
            above the stable step.
    """

    name: ClassVar[str]

    def __init__(
        self,
        problem: Problem,
        v: fem.Function,
        *,
        end: float,
        dt: float | None,
        safety: float,
        every: int = 0,
    ) -> None:
        check_explicit(problem, self.name)
        self.problem, self.v, self.end, self.every = problem, v, end, every
        self.a = fem.Function(problem.V, name="acceleration")
        self.assembler = Assembler(problem)
        try:
            self._prepare(dt, safety)
        except Exception:  # the same on all ranks: nobody else can free the matrix
            self.assembler.destroy()
            raise

    def _prepare(self, dt: float | None, safety: float) -> None:
        problem, v, a = self.problem, self.v, self.assembler
        problem.set_time(0.0)  # what is packed below are the loads of motion
        self.strain, self._measured = Strain(problem), Measured(problem, moving=True)
        self.mass = lumped(problem, a)
        self.measure = LumpedMass(problem, v, self.mass)
        self.size = StepSize(problem, a, self.mass, chosen=dt, safety=safety)
        self.work = WorkLog(problem, a, self.mass, v)
        self._forces = Forces(problem, a.form, a.balance, points=-1.0)
        self._leads, self._timed = supports_move(problem), changes(problem)
        self._tilts = problem.prescribed.tilted is not None
        self._out = a.balance.array[: a.size]
        self._u, self._v = problem.u.x.array[: a.size], v.x.array[: a.size]
        self._pull = self._mobility()
        self._change, self._du = np.zeros(a.size), np.zeros(a.size)
        self._dt_done, self._initial = 1.0, 0.0
        self._t, self._step = 0.0, 0
        self.size.begin(self.end)
        self.every = self.every or max(1, ceil(self.end / self.size.dt / STATES))

    def _mobility(self) -> Vector:
        """-1/m at owned entries, 0 where supports hold still [1/kg]."""
        pull = -1 / self.mass
        if not self._leads:
            pull[self.problem.prescribed.owned] = 0.0
        return np.asarray(pull)

    @property
    def dt(self) -> float:
        """The present step [s]."""
        return self.size.dt

    def stable_step(self) -> float:
        """2/omega_max of the present tangent and the lumped mass [s]. Collective."""
        return self.size.step_for(self.size.sharp())

    # --- what the schemes differ in ---

    def _kick(self, dt: float) -> float:
        """For how long the present forces push, before a step of dt [s]."""
        raise NotImplementedError

    def _meet(self) -> None:
        """Brings the velocity to the time of the place, and finds the acceleration. Collective."""
        raise NotImplementedError

    # --- the loop ---

    def steps(self, restore: Restore | None = None) -> Iterator[State]:
        """Yields the initial state and then every `every`-th one. Collective.

        Args:
            restore: Brings back what `kept` gave: begins with the state after.

        Raises:
            StabilityError: The step became larger than the stable one, or the state is lost.
        """
        try:
            if restore is None:
                self._tell_dashpots()
                self._balance()
                self.work.begin()
                first = self._state()
                self._initial = first.energies["total"]
                yield first
            else:
                self._restore(restore)
            yield from self._march()
        finally:
            self.assembler.destroy()

    def _march(self) -> Iterator[State]:
        while self._t < self.end * END:
            if self._step == self.size.due:
                self.size.look(self._step, self._t)
            self._advance(min(self.size.dt, self.end - self._t))
            if self._step % self.every == 0 or self._t >= self.end * END:
                self._meet()
                state = self._state()
                if self._drifts(state.energies):
                    self.size.doubt(self._step)
                yield state

    def _drifts(self, energies: Mapping[str, float]) -> bool:
        """Energy that no load has given appears or is lost: the sign of a step too long."""
        gained = energies["total"] - energies["external"]
        scale = max(energies["kinetic"], energies["strain"], abs(energies["external"]))
        drifts = abs(gained - self._initial) > DRIFT * scale
        if drifts:
            self._initial = gained  # looked into once
        return drifts

    def _advance(self, dt: float) -> None:
        """One step; `balance` holds the forces at its start before and at its end afterwards."""
        begin = perf_counter()
        v, change, du = self._v, self._change, self._du
        np.multiply(self._out, self._pull, out=change)
        change *= self._kick(dt)
        self._t, self._step = self._t + dt, self._step + 1
        if self._timed:
            self.problem.set_time(self._t)
        if self._leads or self._tilts:
            self._hold(dt)
        v += change
        np.multiply(v, dt, out=du)
        self._u += du
        self.problem.u.x.scatter_forward()
        self._dt_done = dt
        middle = perf_counter()
        timing.add("solve", middle - begin)
        self._tell_dashpots()
        self._balance()
        if self.work.shares:
            self.work.step(du)
        timing.add("assemble", perf_counter() - middle)

    def _hold(self, dt: float) -> None:
        """Makes the change of velocity one that takes supports where they are to be."""
        held = self.problem.prescribed
        goal = (held.targets - held.present(self.problem.u.x.array)) / dt
        self._change += self._v
        held.impose(self._change, goal)
        self._change -= self._v

    def _tell_dashpots(self) -> None:
        if self.problem.dashpots:
            seen = self.problem.site.velocity.x
            seen.array[: len(self._v)] = self._v
            seen.scatter_forward()

    def _balance(self) -> None:
        """Forces out of balance at the present place and time. Collective."""
        if self._timed:
            self._forces.renew()
            self.work.renew()
        self._forces.assemble()

    # --- what is seen of it ---

    def _state(self) -> State:
        kinetic, linear, angular = self.measure.measure()
        if not np.isfinite(kinetic):
            raise StabilityError(
                f"the motion has no finite velocity at t = {self._t:.6g} s",
                advice="a smaller dt or safety",
            )
        strain, more = self.strain.energy(), self._measured.energies()
        inertia = self.assembler.constraint_forces(self.mass * self.a.x.array[: len(self._v)])
        energies = {
            "strain": strain,
            "kinetic": kinetic,
            "total": strain + kinetic + sum(more.values()),
            "external": self.work.close(),
            **self.strain.springs(),
            **more,
        }
        return State(
            step=self._step,
            t=self._t,
            u=self.problem.u,
            v=self.v,
            a=self.a,
            reason="explicit",
            energies=energies,
            reactions=self.assembler.reactions(inertia),
            momenta={"linear": linear, "angular": angular},
            max_displacement=self.assembler.max_displacement(),
            numbers=self._measured.numbers(),
            done=self._t / self.end,
        )

    # --- from one run to the next ---

    def kept(self) -> Kept:
        """All that the step after a yielded state needs to know. Not collective."""
        numbers = {
            "t": self._t,
            "step": self._step,
            "every": self.every,
            "initial": self._initial,
            "work": self.work.sum,
            **self.size.kept(),
        }
        return Kept(self._fields(), numbers)

    def _fields(self) -> dict[str, fem.Function]:
        fields = {
            "displacement": self.problem.u,
            "velocity": self.v,
            "rates": self.size.field,
        }
        if self.problem.dashpots:  # they have seen that of half a step before
            fields["dashpots"] = self.problem.site.velocity
        return fields

    def _restore(self, restore: Restore) -> None:
        numbers: Mapping[str, Any] = restore(self._fields())
        self._t, self._step = float(numbers["t"]), int(numbers["step"])
        self.every, self._initial = int(numbers["every"]), float(numbers["initial"])
        self.size.restore(numbers)
        self.problem.set_time(self._t)
        self._balance()
        self.work.begin(float(numbers["work"]))


class SymplecticEuler(Explicit):
    """v += dt f/m, then u += dt v; see `Explicit`.  The acceleration is the mean of the step."""

    name = "symplectic-euler"

    def _kick(self, dt: float) -> float:
        return dt

    def _meet(self) -> None:
        self.a.x.array[: len(self._v)] = self._change / self._dt_done
        self.a.x.scatter_forward()
        self.v.x.scatter_forward()


class CentralDifferences(Explicit):
    """The velocity is that halfway to the next place; see `Explicit`.

    States have velocity and acceleration of their own time; where a support moves, they are the
    differences of its places before and after.
    """

    name = "central-differences"

    def _prepare(self, dt: float | None, safety: float) -> None:
        self._owed = 0.0
        super()._prepare(dt, safety)

    def _kick(self, dt: float) -> float:
        kick, self._owed = self._owed + dt / 2, dt / 2
        return kick

    def _meet(self) -> None:
        n = len(self._v)
        np.multiply(self._out, self._pull, out=self._change)
        if self._leads or self._tilts:
            self._ahead()
        self.a.x.array[:n] = self._change
        self.a.x.scatter_forward()
        self._change *= self._owed
        self._v += self._change
        self.v.x.scatter_forward()
        self._owed = 0.0

    def _ahead(self) -> None:
        """The acceleration of supports, from where they will be as much later."""
        held, dt = self.problem.prescribed, self._dt_done
        self.problem.set_time(self._t + dt)
        goal = (held.targets - held.present(self.problem.u.x.array)) / dt
        self.problem.set_time(self._t)
        now = held.present(self.v.x.array)
        held.impose(self._change, (goal - now) / dt)


SCHEMES: dict[str, type[Explicit]] = {
    scheme.name: scheme for scheme in (SymplecticEuler, CentralDifferences)
}


def changes(problem: Problem) -> bool:
    """Something depends on time: loads, supports, springs or obstacles."""
    return (
        (bool(problem.loads) and problem.loads_change)
        or any(not support.at_rest for support in problem.supports)
        or any(touch.contact.values for touch in problem.touching)
    )


def check_explicit(problem: Problem, scheme: str = SymplecticEuler.name) -> None:
    """The schemes need a lumped mass, and displacements as the only unknowns.

    Raises:
        InputError: They cannot compute this problem.
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
