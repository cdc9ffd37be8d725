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

from abc import ABC, abstractmethod
from collections.abc import Iterator
from math import ceil
from time import perf_counter
from typing import ClassVar

import numpy as np
from dolfinx import fem

from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import StabilityError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, SavedState, State, StateCopy
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.energy_momentum import lumped
from dolfin_elastic.solvers.assembly.nodal_forces import Forces
from dolfin_elastic.solvers.dynamics.explicit.energies import Energies, Measures
from dolfin_elastic.solvers.dynamics.explicit.limits import (
    changes,
    check_explicit,
    mean_acceleration,
)
from dolfin_elastic.solvers.dynamics.explicit.monitor import StabilityMonitor
from dolfin_elastic.solvers.dynamics.explicit.replay import Replay
from dolfin_elastic.solvers.dynamics.explicit.stable_step import StepSize
from dolfin_elastic.solvers.dynamics.work import ExternalWork, supports_move
from dolfin_elastic.solvers.nonlinear.scalars import Scalars

STATES = 200
"""About as many states are yielded if nothing else is said."""

END = 1 - 1e-12
"""Share of the duration at which the end is reached."""


class Explicit(ABC):
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
        self._lookout, self.mass = StabilityMonitor(problem, a), lumped(problem, a)
        self._scalars, self._last = Scalars(a), StateCopy()
        self.size = StepSize(problem, a, self.mass, chosen=dt, safety=safety)
        self.work = ExternalWork(problem, a, self.mass, v)
        self._energies = Energies(problem, v, self.mass, self.work)
        self._forces = Forces(problem, a.residual.form, a.residual.vector, points=-1.0)
        self._leads, self._timed = supports_move(problem), changes(problem)
        self._tilts = problem.dirichlet.skew is not None
        arrays = problem.u.x.array, v.x.array, a.residual.vector.array
        self._u, self._v, self._out = (array[: a.size] for array in arrays)
        self._pull, self._free = self._mobility(), np.ones(a.size)
        self._free[problem.dirichlet.owned] = 0.0
        self._change, self._du = np.zeros(a.size), np.zeros(a.size)
        self._t, self._step, self._chosen = 0.0, 0, dt
        self.size.begin(self.end)
        self._dt_done = min(self.size.dt, self.end)
        self.every = self.every or max(1, ceil(self.end / self.size.dt / STATES))

    def _mobility(self) -> FloatArray:
        """-1/m at owned entries, 0 where supports hold still [1/kg]."""
        pull = -1 / self.mass
        if not self._leads:
            pull[self.problem.dirichlet.owned] = 0.0
        return np.asarray(pull)

    @property
    def dt(self) -> float:
        """The present step [s]."""
        return self.size.dt

    def stable_step(self) -> float:
        """2/omega_max of the present tangent and the lumped mass [s]. Collective."""
        return self.size.step_for(self.size.sharp())

    # --- what the schemes differ in ---

    @abstractmethod
    def _kick(self, dt: float) -> float:
        """For how long the present forces push, before a step of dt [s]."""

    @abstractmethod
    def _meet(self) -> None:
        """Brings the velocity to the time of the place, and finds the acceleration. Collective."""

    @abstractmethod
    def _start(self) -> None:
        """Finds the acceleration that the motion begins with. Collective."""

    @abstractmethod
    def _quiver(self) -> float:
        """What the scheme's own energy has beyond that of a state, this rank's part [J].

        Of linear problems U + m v- . v+ / 2 is conserved exactly, with the velocities before and
        after the place of U; the energy of one time swings about it, up to all of it.
        """

    # --- the loop ---

    def steps(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the initial state and then every `every`-th one. Collective.

        Args:
            saved: A `restart_state` from which the run continues, with the state after it.

        Raises:
            StabilityError: The step became larger than the stable one, or the state is lost.
        """
        try:
            if saved is None:
                self._tell_dashpots()
                self._balance()
                self.work.begin()
                self._start()
                first = self._state()
                self._lookout.drifts(first.energies, self._quiver(), 0.0)
                yield first
            else:
                self.restore(saved)
            yield from self._march()
        finally:
            self.assembler.destroy()

    def _march(self) -> Iterator[State]:
        self._last.save(self.restart_state())
        while self._t < self.end * END:
            try:
                self.forward()
            except StabilityError as error:  # of a collective look: on all ranks
                raise Replay(self, self._lookout, self._last).refused(error) from None
            if self._step % self.every == 0 or self._t >= self.end * END:
                self._meet()
                state = self._state()
                if self._lookout.drifts(state.energies, self._quiver(), self._t):
                    self.size.doubt(self._step)
                self._last.save(self.restart_state())
                yield state

    @np.errstate(all="ignore")  # what is lost is told of when it is found
    def forward(self) -> None:
        """One step, with a look at the stable one before it where that is due. Collective."""
        if self._step == self.size.due:
            self.size.look(self._step, self._t)
        self._advance(min(self.size.dt, self.end - self._t))

    def _advance(self, dt: float) -> None:
        """One step; `balance` holds the forces at its start before and at its end afterwards."""
        begin = perf_counter()
        v, change, du = self._v, self._change, self._du
        np.multiply(self._out, self._pull, out=change)
        change *= self._kick(dt)
        self._step += 1
        self._t = self._reached(self._t + dt)
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

    def _reached(self, t: float) -> float:
        """A time without the round-off of a sum: of equal steps, and the end."""
        even = t if self._chosen is None else self._step * self._chosen
        meant = self.end if t >= self.end * END else even
        return meant if abs(meant - t) < 1e-9 * self.size.dt else t

    def _hold(self, dt: float) -> None:
        """Makes the change of velocity one that takes supports where they are to be."""
        held = self.problem.dirichlet
        goal = (held.targets - held.extract(self.problem.u.x.array)) / dt
        self._change += self._v
        held.impose(self._change, goal)
        self._change -= self._v

    def _tell_dashpots(self) -> None:
        if self.problem.dashpots:
            seen = self.problem.context.velocity.x
            seen.array[: len(self._v)] = self._v
            seen.scatter_forward()

    def _balance(self) -> None:
        """Forces out of balance at the present place and time. Collective."""
        if self._timed:
            self._forces.renew()
            self.work.renew()
        self._forces.assemble()

    @np.errstate(all="ignore")
    def _mean(self, interval: float) -> None:
        """Forces over mass, and the mean acceleration of supports in the next step.

        Args:
            interval: From the time of the velocity to the middle of the velocity's next step [s].
        """
        np.multiply(self._out, self._pull, out=self._change)
        if self._leads or self._tilts:
            driven = mean_acceleration(self.problem, self.v, self._t, self._dt_done, interval)
            self.problem.dirichlet.impose(self._change, driven)
        self.a.x.array[: len(self._v)] = self._change + 0.0  # no -0
        self.a.x.scatter_forward()

    # --- what is seen of it ---

    @property
    def now(self) -> tuple[int, float]:
        """Steps done, and the time [s]."""
        return self._step, self._t

    def finite(self) -> bool:
        """Whether energies and forces are. Collective."""
        return self._energies.finite(self._energies.take()[0], self._out)

    def reached(self, *, moved: bool) -> State:
        """The present state, which a step has led to since it was restored or not. Collective."""
        (self._meet if moved else self._start)()
        return self._seen(self._energies.take())

    def _state(self) -> State:
        measures = self._energies.take()
        if not self._energies.finite(measures[0], self._out):
            raise Replay(self, self._lookout, self._last).lost()
        self._lookout.look(self._t, last=self._t >= self.end * END)
        return self._seen(measures)

    def _seen(self, measures: Measures) -> State:
        energies, momenta = measures
        a, inertia = self.assembler, self.mass * self.a.x.array[: len(self._v)]
        return State(
            step=self._step,
            t=self._t,
            u=self.problem.u,
            v=self.v,
            a=self.a,
            reason="explicit",
            energies=energies,
            reactions=a.reactions.by_support(a.residual.owned + a.constrained_part(inertia)),
            momenta=momenta,
            max_displacement=self.assembler.max_displacement(),
            numbers={**self._energies.numbers(), **self._scalars.numbers(inertia)},
            done=self._t / self.end,
        )

    # --- from one run to the next ---

    def restart_state(self) -> RestartState:
        """See `Restartable`; at a state that is yielded. Not collective."""
        numbers = {
            "t": self._t,
            "step": self._step,
            "every": self.every,
            "work": self.work.sum,
            "lookout": self._lookout.restart_state(),
            **self.size.restart_state(),
        }
        return RestartState(self._fields(), numbers)

    def _fields(self) -> dict[str, fem.Function]:
        fields = {"displacement": self.problem.u, "velocity": self.v, "rates": self.size.field}
        if self.problem.dashpots:  # they have seen that of half a step before
            fields["dashpots"] = self.problem.context.velocity
        return fields

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`. Collective."""
        saved.fill(self._fields())
        numbers = saved.numbers
        self._t, self._step = float(numbers["t"]), int(numbers["step"])
        self.every = int(numbers["every"])
        self._lookout.restore(numbers["lookout"])
        self.size.restore(numbers)
        self.problem.set_time(self._t)
        self._balance()
        self.work.begin(float(numbers["work"]))


class SymplecticEuler(Explicit):
    """v += dt f/m, then u += dt v; see `Explicit`.

    The acceleration is the mean of the step before, that of the first state of the step after.
    """

    name = "symplectic-euler"

    def _kick(self, dt: float) -> float:
        return dt

    def _meet(self) -> None:
        self.a.x.array[: len(self._v)] = self._change / self._dt_done
        self.a.x.scatter_forward()
        self.v.x.scatter_forward()

    def _start(self) -> None:
        self._mean(self._dt_done)

    def _quiver(self) -> float:
        # Supports' nodes have no force but that of the body.
        kick = self._v * self._out * self._free
        return -0.5 * self.size.dt * float(np.sum(kick))


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
        self._mean(self._dt_done / 2 + self._owed)
        self._change *= self._owed
        self._v += self._change
        self.v.x.scatter_forward()
        self._owed = 0.0

    def _start(self) -> None:
        self._meet()

    def restore(self, saved: SavedState) -> None:
        """See `Explicit`; states owe nothing. Collective."""
        self._owed = 0.0
        super().restore(saved)

    def _quiver(self) -> float:
        a = self.a.x.array[: len(self._v)]
        return -(self.size.dt**2) / 8 * float(np.sum(self.mass * a**2 * self._free))


SCHEMES: dict[str, type[Explicit]] = {
    scheme.name: scheme for scheme in (SymplecticEuler, CentralDifferences)
}
