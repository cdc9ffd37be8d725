"""Explicit motion: the loop over steps, the yielded states, and restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, floor
from time import monotonic

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.errors import StabilityError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.signals import raise_if_agreed, stop_agreed, watched
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.bulk_viscosity import BulkViscosity
from dolfin_elastic.problem.context import show_velocity
from dolfin_elastic.problem.problem import Problem, results_of
from dolfin_elastic.problem.state import RestartState, SavedState, State, StateCopy, restoring
from dolfin_elastic.solvers.assembly.assembler import Assembler, SupportForces
from dolfin_elastic.solvers.assembly.energy_momentum import LumpedMass, lumped
from dolfin_elastic.solvers.dynamics.explicit.audit import ExplicitAuditor
from dolfin_elastic.solvers.dynamics.explicit.damper import Damper, sees_velocity
from dolfin_elastic.solvers.dynamics.explicit.mass_scaling import scaled
from dolfin_elastic.solvers.dynamics.explicit.monitor import StabilityMonitor
from dolfin_elastic.solvers.dynamics.explicit.replay import Replay
from dolfin_elastic.solvers.dynamics.explicit.scheme import END, ExplicitScheme
from dolfin_elastic.solvers.dynamics.explicit.stable_step import StepSize
from dolfin_elastic.solvers.dynamics.work import ExternalWork, Measures, MotionBook

STEPS_A_LOOK = 20
"""Steps after which ranks agree on whether they shall stop: rarely enough to cost nothing."""

STATES = 200
"""About as many states are yielded if no other number is asked for."""

BETWEEN = 10.0
"""Seconds without a state after which one between is yielded, for a checkpoint and the display."""

_MET = 1e-9
"""Share of a time interval by which a state may come before its end."""


def _due_between(comm: MPI.Comm, shown: float) -> bool:
    """Whether the run shall stop, or nothing was shown of it for long. Collective.

    Args:
        comm: The ranks of the run.
    """
    if not watched():
        return False
    if stop_agreed(comm):
        return True
    # Clocks differ between ranks: the first one decides for all.
    return largest(comm, float(comm.rank == 0 and monotonic() - shown >= BETWEEN)) > 0


@dataclass(frozen=True)
class ExplicitOptions:
    """What is added to an explicit motion.

    Attributes:
        mass_scaling: Largest fraction of the mass that may be added, see `mass_scaling`; 0: none.
        rate: Forces of damping over those of inertia at an acceleration of the velocity over 1 s:
            Rayleigh's factor of the mass [1/s].
        bulk: b1 and b2 of `bulk_viscosity`; None: none.
    """

    mass_scaling: float = 0.0
    rate: float = 0.0
    bulk: tuple[float, float] | None = None

    def damper(self, problem: Problem, assembler: Assembler, mass: FloatArray) -> Damper | None:
        """None without damping. Collective.

        Args:
            mass: Lumped mass at every owned entry [kg].
        """
        if not self.rate and self.bulk is None:
            return None
        bulk = None if self.bulk is None else BulkViscosity(problem, *self.bulk)
        return Damper(problem, assembler, mass, rate=self.rate, bulk=bulk)


class Explicit:
    """An explicit motion of one problem. Collective.

    Args:
        problem: What moves, in its initial state; linear elements, all densities given.
        end: When the motion ends [s].
        dt: Time step [s]; None for the stable step times `safety`.
        every: Steps from one yielded state to the next, or time [s]: the first state at or after
            each multiple; 0: about `STATES` in all.
        options: Damping and added mass; by default none.

    Attributes:
        scheme: Takes the steps.
        size: Stable step, and the step that is taken.
        mass: Lumped mass at every owned entry [kg].
        work: Of loads and supports.

    Raises:
        InputError: dt is above the stable step.
    """

    def __init__(
        self,
        problem: Problem,
        v: fem.Function,
        scheme: type[ExplicitScheme],
        *,
        end: float,
        dt: float | None,
        safety: float,
        every: int | float = 0,
        options: ExplicitOptions | None = None,
    ) -> None:
        self.problem, self.v, self.end = problem, v, end
        self.assembler = Assembler(problem)
        try:
            self._prepare(scheme, dt, safety, options or ExplicitOptions())
        except Exception:  # the same on all ranks: nobody else can free the matrix
            self.destroy()
            raise
        self.every = every or max(1, ceil(end / self.size.dt / STATES))

    def _prepare(
        self,
        scheme: type[ExplicitScheme],
        dt: float | None,
        safety: float,
        options: ExplicitOptions,
    ) -> None:
        problem, v, a = self.problem, self.v, self.assembler
        problem.set_time(0.0)  # what is packed below are the loads of motion
        if problem.history is not None:
            problem.history.begin(fused=True)
        self._monitor, self.mass = StabilityMonitor(problem, a), lumped(problem, a)
        self._numbers: dict[str, float] = {}
        if options.mass_scaling:
            found = scaled(problem, a, self.mass, most=options.mass_scaling, dt=dt)
            self.mass, self._numbers = found.mass, found.numbers
        self._damper = options.damper(problem, a, self.mass)
        self._supports, self._last = SupportForces(a), StateCopy()
        self.size = StepSize(problem, a, self.mass, chosen=dt, safety=safety, damper=self._damper)
        self.work = ExternalWork(problem, a, self.mass, v)
        self._energies = MotionBook(problem, LumpedMass(problem, v, self.mass), self.work.energies)
        if sees_velocity(self._damper):  # bulk viscosity shortens the first step, too
            show_velocity(problem.context, v.x.array[: len(self.mass)])
        self.size.begin(self.end)
        self._auditor = ExplicitAuditor(problem, a, self._monitor, self.mass)
        first = min(self.size.dt, self.end)
        self.work.damper = self._damper
        self.scheme = scheme(
            a, self.mass, v, self.work, end=self.end, dt=first, chosen=dt, damper=self._damper
        )

    # --- the loop ---

    def run(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the initial state and then every `every`-th one. Collective.

        Where signals can stop the run, also states between them, see `State.between`: they change
        nothing of the motion, so that it does not depend on the wall time.

        Args:
            saved: A `restart_state` from which the motion continues, with the state after it.

        Raises:
            StabilityError: The step became larger than the stable one, or the state is lost.
        """
        if saved is None:
            yield from self._shown(self._begin())
        else:
            with restoring(saved):
                self.restore(saved)
        yield from self._march()

    def _begin(self) -> State:
        """Forces, acceleration and energies of the initial state."""
        self.scheme.update_dashpots()
        self.scheme.assemble_forces()
        self.scheme.commit()  # the body is strained suddenly, at the start
        self.work.begin()
        self.scheme.begin_damping()
        self.scheme.start()
        first = self._checked_state()
        self._drifts(first)
        return self._audited(first)

    def _march(self) -> Iterator[State]:
        self._last.save(self.restart_state())
        shown, comm = monotonic(), self.assembler.comm
        while not self._ended:
            before = self.scheme.t
            try:
                self.step()
            except StabilityError as error:  # raised on all ranks
                raise Replay(self, self._monitor, self._last).unstable_step(error) from None
            if self._due(before) or self._ended:
                self.scheme.settle()
                self.scheme.synchronise()
                state = self._checked_state()
                if self._drifts(state):
                    self.size.check_before(self.scheme.steps)
                self._last.save(self.restart_state())
                yield from self._shown(self._audited(state))
                shown = monotonic()
            elif self.scheme.steps % STEPS_A_LOOK == 0 and _due_between(comm, shown):
                yield from self._shown(self._state_between())
                raise_if_agreed(comm)
                shown = monotonic()

    def _shown(self, state: State) -> Iterator[State]:
        """Yields a state, and takes over loads that a program has changed meanwhile. Collective.

        The motion goes on from there with the new forces, and so does the work.
        """
        before = self.scheme.fingerprint()
        yield state
        changed = float(self.scheme.fingerprint() != before)
        if largest(self.assembler.comm, changed) == 0.0:
            return
        dt, excess = self.size.dt, self.scheme.conserved_excess(self.size.dt)
        if state.between:
            self.work.close()
        self.scheme.renew_forces()
        self.work.renew()
        self.scheme.begin_damping()
        if not state.between:
            self.scheme.start()
            self._monitor.loads_changed(self.scheme.conserved_excess(dt) - excess)
            self._last.save(self.restart_state())
        self.size.check_before(self.scheme.steps)

    def stop_at(self, t: float) -> None:
        """See `marching.Loop`: its steps are as long as they are."""

    def _state_between(self) -> State:
        """The present state as far as it is known without bringing the velocity to its time.

        Raises:
            StabilityError: It is not finite, and no state to go on from.
        """
        self.scheme.settle()
        if not self.finite():
            raise Replay(self, self._monitor, self._last).not_finite()
        scheme = self.scheme
        return State(
            step=scheme.steps,
            t=scheme.t,
            unit=self.problem.body.unit,
            u=self.problem.u,
            v=self.v,
            reason="explicit",
            max_displacement=self.assembler.max_displacement(),
            failure=self._monitor.failure,
            done=scheme.t / self.end,
            between=True,
        )

    def _due(self, before: float) -> bool:
        """Whether the state is one to be yielded.

        Args:
            before: Time before the step [s].
        """
        if isinstance(self.every, int):
            return self.scheme.steps % self.every == 0
        # With a tolerance, so that sums of steps do not come too late by round-off.
        count, was = (floor(t / self.every + _MET) for t in (self.scheme.t, before))
        return count > was

    @property
    def _ended(self) -> bool:
        return self.scheme.t >= self.end * END

    def _drifts(self, state: State) -> bool:
        """Whether energy has appeared or been lost, see `StabilityMonitor.drifts`."""
        excess = self.scheme.conserved_excess(self.size.dt)
        return self._monitor.drifts(state.energies, excess, state.t)

    def _audited(self, state: State) -> State:
        """A state with its audit, of whose energy `_drifts` has judged before. Collective."""
        audit = self._auditor.judge(state.t, state.energies, self.size.stable)
        return replace(state, audit=audit, failure=self._monitor.failure)

    @np.errstate(all="ignore")  # a state that is not finite is reported when it is found
    def step(self) -> None:
        """One step; the stable step is found anew before it where that is due. Collective."""
        scheme = self.scheme
        if scheme.steps == self.size.next_check:
            scheme.settle()
            self.size.update(scheme.steps, scheme.t)
        scheme.advance(min(self.size.dt, self.end - scheme.t))

    # --- states ---

    @property
    def now(self) -> tuple[int, float]:
        """Steps done, and the time [s]."""
        return self.scheme.steps, self.scheme.t

    def finite(self) -> bool:
        """Whether energies and forces are finite. Collective."""
        return self._energies.finite(self._energies.measure()[0], self.scheme.out_of_balance)

    def state(self, *, moved: bool) -> State:
        """The present state. Collective.

        Args:
            moved: Steps have been taken since the motion began or was restored.
        """
        if moved:
            self.scheme.synchronise()
        else:
            self.scheme.start()
        return self._state(self._energies.measure())

    def _checked_state(self) -> State:
        """The present state.

        Raises:
            StabilityError: It is not finite.
        """
        measures = self._energies.measure()
        if not self._energies.finite(measures[0], self.scheme.out_of_balance):
            raise Replay(self, self._monitor, self._last).not_finite()
        self._monitor.observe(self.scheme.t)
        return self._state(measures)

    def _state(self, measures: Measures) -> State:
        (energies, momenta), scheme = measures, self.scheme
        a, inertia = self.assembler, self.mass * scheme.a.x.array[: len(self.mass)]
        reactions, moments = self._supports(a.residual.owned + a.constrained_part(inertia))
        return State(
            step=scheme.steps,
            t=scheme.t,
            unit=self.problem.body.unit,
            u=self.problem.u,
            v=self.v,
            a=scheme.a,
            reason="explicit",
            energies=energies,
            reactions=reactions,
            moments=moments,
            momenta=momenta,
            max_displacement=self.assembler.max_displacement(),
            numbers=results_of(self.problem, a.residual.owned[a.displacement_dofs] + inertia)
            | self._numbers,
            done=scheme.t / self.end,
        )

    # --- restarts: keys are those of checkpoint format 3 ---

    def restart_state(self) -> RestartState:
        """See `Restartable`; at a state that is yielded. Not collective."""
        numbers = {
            "t": self.scheme.t,
            "step": self.scheme.steps,
            "remaining": self.scheme.remaining,
            "every": self.every,
            "work": self.work.sum,
            "friction": self.work.friction,
            "damping": float(self.work.damping[0]),
            "bulk_viscosity": float(self.work.damping[1]),
            "lookout": self._monitor.restart_state(),
            "initial": self._auditor.initial,
            **self.size.restart_state(),
        }
        history = self.problem.history
        if history is None:
            return RestartState(self._fields(), numbers)
        numbers["history"] = history.restart_state()
        return RestartState(self._fields() | history.fields(), numbers)

    def _fields(self) -> dict[str, fem.Function]:
        fields = {"displacement": self.problem.u, "velocity": self.v, "rates": self.size.field}
        fields |= self.problem.terms.past
        # Dashpots and bulk viscosity see the velocity of half a step before.
        if self.problem.dashpots or sees_velocity(self._damper):
            fields["dashpots"] = self.problem.context.velocity
        return fields

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`. Collective."""
        history = self.problem.history
        past = {} if history is None else history.fields()
        saved.fill(self._fields() | past)
        numbers = saved.numbers
        if history is not None:
            history.restore(past, numbers["history"])
        self.every = numbers["every"]
        self._monitor.restore(numbers["lookout"])
        self._auditor.initial = numbers.get("initial", np.nan)
        self.size.restore(numbers)
        remaining = float(numbers.get("remaining", 0.0))  # older checkpoints are all of states
        self.scheme.resume(float(numbers["t"]), int(numbers["step"]), remaining)
        names = ("friction", "damping", "bulk_viscosity")
        rubbed, *damped = (float(numbers.get(name, 0.0)) for name in names)
        self.work.begin(float(numbers["work"]), rubbed, damped)
        self.scheme.begin_damping()

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.assembler.destroy()
