"""Runs that a program drives: one window after the other, with a way back."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import Protocol, Self

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, SavedState, State, StateCopy

SAME = 1e-12
"""Share of a time by which another one is the same."""


class Loop(Protocol):
    """A run that is on."""

    def stop_at(self, t: float) -> None:
        """Makes it meet this time exactly, if its steps can. Not collective."""

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`. Collective."""


class _Settings(Protocol):
    @property
    def end(self) -> float: ...

    @property
    def times(self) -> Sequence[float]: ...

    def model_copy(self, *, update: Mapping[str, object] | None = None) -> Self: ...


class Marching:
    """A solver that a program can drive itself, in place of the loop over `steps`.

    Collective, all of it.  Times are those of the loads: seconds in motion, the load parameter in
    statics, which is then as good as a time: loads with ``curve="constant"`` act as they are.

    Example:
        saved = solver.save()
        state = solver.advance(0.1)
        solver.restore(saved)  # now with another load, and again
        state = solver.advance(0.1)
    """

    problem: Problem
    settings: _Settings
    _states: Generator[State, None, None] | None = None
    _state: State | None = None
    _saved: SavedState | None = None
    _t = 0.0

    def steps(self, saved: SavedState | None = None) -> Generator[State, None, None]:
        """Yields the states. Collective."""
        raise NotImplementedError

    def restart_state(self) -> RestartState:
        """See `RestartableSolver`. Collective."""
        raise NotImplementedError

    def _run_is_on(self) -> Loop | None:
        raise NotImplementedError

    def _begin(self, t: float) -> None:
        """Begins a run, or one that goes on where it was restored, whose first goal is t."""
        if self._saved is not None:
            times = sorted({*self.settings.times, t})
            self.settings = self.settings.model_copy(update={"times": times})
        self._states = self.steps(self._saved)

    def advance(self, t: float) -> State:
        """Goes on to a time, by as many steps as it takes; from the start, or where it is now.

        Implicit motion and statics meet the time exactly; explicit motion ends with the first
        state of `every` that is not before it.  Loads, constants and functions count as they are
        at the call.

        Args:
            t: Time [s], or load parameter, at most `end`; 0 gives the initial state.

        Returns:
            The state there; its fields are the solver's own and change with the next step.

        Raises:
            InputError: The time has passed, or lies beyond the end.
            ConvergenceError: There is no solution.  The solver can then be restored.
            RuntimeError: The run has ended or failed before, and nothing was restored.
        """
        self._check(t)
        if self._states is None:
            self._begin(t)
            self._go_on()
        if t <= self._t * (1 + SAME) and self._state is not None:
            return self._state
        if (loop := self._run_is_on()) is not None:
            loop.stop_at(t)
        while self._state is None or self._t < t * (1 - SAME):
            self._go_on()
        return self._state

    def _go_on(self) -> None:
        """Takes the next state."""
        assert self._states is not None
        self._state = next(self._states, None)
        if self._state is None:
            raise RuntimeError("the run has ended: restore a state that was saved")
        self._t = self._state.t

    def _check(self, t: float) -> None:
        end = self.settings.end
        if not self._t * (1 - SAME) <= t <= end * (1 + SAME):
            raise InputError(
                f"the run is at t = {self._t:g} and cannot go to {t:g}",
                expected=f"a time from there to end = {end:g}; a saved state leads back",
            )

    def save(self) -> SavedState:
        """A copy of all that the next step depends on, in memory.

        It holds the solver's fields and numbers, with what contact, cavities and materials that
        relax remember; no loads that a program has set, and no parameters.
        """
        if self._states is None and self._saved is not None:
            return self._saved
        if self._states is None:
            self.advance(0.0)
        return StateCopy(self.restart_state())

    def restore(self, saved: SavedState) -> None:
        """Goes back to a state that was saved, also after a failure; it may be restored often.

        Args:
            saved: Of this solver, or of one of an equal problem on the same mesh and ranks.
        """
        t, loop = float(saved.numbers["t"]), self._run_is_on()
        if self._states is not None and loop is not None:
            loop.restore(saved)
        else:
            if self._states is not None:
                self._states.close()
            self._states, self._saved = None, saved
        self._state, self._t = None, t
