"""Statics: equilibrium under loads that grow step by step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing
from typing import Any

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import settings_from
from dolfin_elastic.core.together import failing_together, loop_together
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, SavedState, State
from dolfin_elastic.problem.term_list import refuse_rest
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.diagnostics.rigid_body import check_no_rigid_motion
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose, in_blocks
from dolfin_elastic.solvers.marching import Marching
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton, scalar_unknowns
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess, LoadStepping
from dolfin_elastic.solvers.statics.settings import (
    FIRST,
    StaticsSettings,
    refuse_memory,
    refuse_times,
)
from dolfin_elastic.solvers.statics.step_size import StepSizes
from dolfin_elastic.solvers.statics.whole_load import may_take_whole_load

log = logging.getLogger("dolfin_elastic")


class Statics(Marching):
    """Finds the equilibrium states of a problem under growing load.

    Args:
        problem: What is loaded; its displacement is the starting point.
        settings: See `StaticsSettings`; keyword arguments are its fields.
        preload: The equilibrium is the preload of another analysis, which itself warns of keys
            without effect.
        gradual: States on the way are wanted: the load grows step by step though it could be taken
            at once.

    Attributes:
        observer: Called at each equilibrium, before it is yielded, with the solver that has found
            it, whose tangent is there still.
    """

    settings: StaticsSettings
    observer: Callable[[Newton, State], None] | None = None

    def __init__(
        self,
        problem: Problem,
        settings: StaticsSettings | None = None,
        *,
        linear: LinearSettings | None = None,
        petsc: PetscOptions | None = None,
        preload: bool = False,
        gradual: bool = False,
        **fields: Any,
    ) -> None:
        refuse_rest(problem.terms)
        self.problem, self._preload, self._gradual = problem, preload, gradual
        self.settings = settings_from(StaticsSettings, settings, fields)
        self.linear = linear or LinearSettings()
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.choice = choose(problem, self.linear)
        self._stepping: LoadStepping | None = None
        self._end: tuple[State, RestartState] | None = None

    def steps(
        self, saved: SavedState | None = None, *, near: InitialGuess | None = None
    ) -> Generator[State, None, None]:
        """Yields the initial state and then one equilibrium a step. Collective.

        Args:
            saved: A `restart_state` from which the run continues, with the step after it.
            near: Unknowns near those of the end: the equilibrium there is the only state that is
                yielded, if it is found from them; else the load grows from zero as ever.

        Raises:
            InputError: The supports do not hold the body against every rigid motion.
            ConvergenceError: No equilibrium was found even with the smallest step; the problem
                then holds the last iterate, and all states yielded before are valid.
        """
        return loop_together(self.problem.body.comm, self._steps(saved, near))

    def _steps(
        self, saved: SavedState | None, near: InitialGuess | None
    ) -> Generator[State, None, None]:
        check_no_rigid_motion(self.problem)
        self._check_path()
        for dashpot in () if self._preload else self.problem.dashpots:
            log.warning("the dashpot '%s' does nothing in statics", dashpot.label)
        self.choice.report()
        self._end = None
        yield from self._before_the_last(saved, near)
        if self._end is not None:
            yield self._end[0]

    def _before_the_last(
        self, saved: SavedState | None, near: InitialGuess | None
    ) -> Generator[State, None, None]:
        """All states but the last one, which is left in `_end`. Collective.

        Afterwards matrices of tangent and multigrid are freed: outputs need the room.
        """
        with ExitStack() as owned:
            assembler = Assembler(self.problem, iterated=in_blocks(self.choice, self.petsc))
            owned.callback(assembler.destroy)
            if self.problem.mixed:
                HydrostaticConstant(self.problem).report()
            self.problem.terms.begin(moving=self._preload)  # contact has the law of what follows
            watch = JacobianWatch(self.problem)
            newton = Newton(
                assembler,
                self.choice,
                self.tolerance,
                users=self.petsc,
                scalars=scalar_unknowns(assembler),
                watch=watch,
            )
            owned.callback(newton.destroy)
            self._stepping = LoadStepping(
                self.settings,
                self._step_sizes(),
                newton=newton,
                watch=watch,
                whole=not self._asks_for_steps() and may_take_whole_load(self.problem),
            )
            owned.callback(self._forget)
            if self.problem.history is not None and (self._preload or saved is None):
                self.problem.history.reset()
                if not self._preload:
                    self.problem.history.begin()
            terms = self.problem.terms
            if self.problem.history is not None or terms.follows_path or terms.bars:
                near = None  # what has been on the way counts
            states = owned.enter_context(closing(self._stepping.run(saved, near)))
            owned.enter_context(failing_together(self.problem.body.comm))
            for state in states:
                if self.observer is not None:
                    self.observer(newton, state)
                if state.done < 1.0:
                    yield state
                else:
                    self._end = state, self._stepping.restart_state()

    def _forget(self) -> None:
        self._stepping = None

    def restart_state(self) -> RestartState:
        """See `RestartableSolver`. Collective.

        Raises:
            RuntimeError: `steps` has not begun, or has ended before the full load.
        """
        if self._stepping is not None:
            return self._stepping.restart_state()
        if self._end is None:
            raise RuntimeError(
                "no state to save: `steps` has not begun, or has ended before the full load"
            )
        return self._end[1]

    def _run_is_on(self) -> LoadStepping | None:
        return self._stepping

    def _begin(self, t: float) -> None:
        self._gradual = True
        super()._begin(t)

    def _check_path(self) -> None:
        if self.problem.cell is not None and self.settings.method == "arc-length":
            raise InputError(
                "a periodic cell is not followed by arc length",
                where="statics.method",
                expected='"load"; periodic.gradient prescribes how far the cell is deformed',
            )
        if self.problem.terms.follows_path and self.settings.method == "arc-length":
            raise InputError(
                "friction and locked bolts depend on the loads before, which along a path may fall",
                where="statics.method",
                expected='"load", or neither `friction` nor `locked_at`',
            )
        if self.problem.terms.bars and self.settings.method == "arc-length":
            raise InputError(
                "contact of a surface with itself is not followed by arc length",
                where="statics.method",
                expected='"load"',
            )
        if self.settings.in_time:
            refuse_times(self.settings, self.problem)
        if self.problem.history is not None and not self._preload:
            refuse_memory(self.settings, timed=self.problem.history.timed)

    @property
    def tolerance(self) -> Tolerance:
        """When equilibrium counts as found."""
        s = self.settings
        return Tolerance(s.rtol, s.atol, s.max_iterations)

    def _asks_for_steps(self) -> bool:
        """The user has chosen steps, or wants something of the states on the way."""
        keys = {"steps", "first_step", "max_step", "times", "max_steps", "max_displacement"}
        given = self.settings.model_fields_set
        return self._gradual or self.settings.method != "load" or bool(keys & given)

    def _step_sizes(self) -> StepSizes:
        """The plan of load steps."""
        s = self.settings
        if s.steps is not None:
            first = s.end / s.steps
            stops = [s.end * i / s.steps for i in range(1, s.steps)]
            largest = first
        else:
            formula = self.problem.driven_by_formula
            share = 1.0 if self.problem.linear and not formula else FIRST
            first = min(s.first or share, s.largest) * s.end
            largest_share = FIRST if formula and "max_step" not in s.model_fields_set else s.largest
            stops, largest = [], max(first, largest_share * s.end)
        return StepSizes(
            s.end,
            first=first,
            largest=largest,
            smallest=first * s.min_step,
            stops=[*stops, *s.times, *self.problem.corners],
            steady=s.steps is not None,
            remembers=self.problem.history is not None,
        )
