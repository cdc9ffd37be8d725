"""`Dynamics`: the motion of a problem by any scheme, implicit or explicit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from typing import Any

from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import UnusedKeys, refuse_unused_keys, settings_from
from dolfin_elastic.core.together import failing_together, loop_together
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.tie import EXPLICIT_TIES, IMPLICIT
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, SavedState, State
from dolfin_elastic.problem.term_list import refuse_motion
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit, ExplicitOptions
from dolfin_elastic.solvers.dynamics.implicit.implicit import Implicit, conserving
from dolfin_elastic.solvers.dynamics.initial_conditions import set_initial
from dolfin_elastic.solvers.dynamics.schemes import ExplicitRow
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings, refuse_memory
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.marching import Marching
from dolfin_elastic.solvers.statics.settings import StaticsSettings

log = logging.getLogger("dolfin_elastic")

BARRED = {"scheme": "implicit-euler", "max_iterations": 100}
"""Defaults where surfaces must not pass through themselves: bodies meet in several places in one
step, and each may stop a few iterations."""


class Dynamics(Marching):
    """Follows the motion of a problem, with every load and support it has.

    Args:
        problem: What moves; every material needs a density.
        settings: See `DynamicsSettings`; keyword arguments are its fields.
        statics: How the equilibrium is found from which the motion starts, with `preload`.
        linear: How linear systems are solved (implicit scheme).

    Attributes:
        start: Gives displacement [m] and velocity [m/s] of all local nodes, unrolled, from which
            the motion starts. Collective.
    """

    settings: DynamicsSettings
    start: Callable[[], tuple[FloatArray, FloatArray]] | None = None

    def __init__(
        self,
        problem: Problem,
        settings: DynamicsSettings | None = None,
        *,
        statics: StaticsSettings | None = None,
        linear: LinearSettings | None = None,
        petsc: PetscOptions | None = None,
        **fields: Any,
    ) -> None:
        refuse_motion(problem.terms)
        self.problem = problem
        self.settings = conserving(settings_from(DynamicsSettings, settings, fields), problem)
        self.linear = linear or LinearSettings()
        self.settings = with_barriers(problem, self.settings)
        if not self.settings.implicit:
            self._refuse_linear()
        self.statics = statics or StaticsSettings()
        if problem.history is not None:
            refuse_memory(self.settings, timed=problem.history.timed)
        self.settings.row.scheme.check(problem, self.settings.scheme)
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.velocity = fem.Function(problem.V, name="velocity")
        self._motion: Explicit | Implicit | None = None

    def steps(self, saved: SavedState | None = None) -> Generator[State, None, None]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            saved: A `restart_state` from which the run continues, with the state after it.

        Raises:
            ConvergenceError: A step found no equilibrium however small it was made.
            StabilityError: The explicit step became larger than the stable one.
        """
        return loop_together(self.problem.body.comm, self._steps(saved))

    def _steps(self, saved: SavedState | None) -> Generator[State, None, None]:
        if self.problem.cell is not None:
            raise InputError(
                "a periodic cell has no motion",
                where="periodic",
                expected="leave it out, or use [statics]",
            )
        s = self.settings
        if s.preload and any(term.mass for term in self.problem.terms):
            raise InputError(
                "an obstacle with a mass has no equilibrium that a preload finds",
                where="dynamics.preload",
                expected="leave it out, or `motion` in place of the obstacle's mass",
            )
        if self.problem.constraints.tied and not s.implicit:
            raise InputError(EXPLICIT_TIES, where="tie[0]", expected=IMPLICIT)
        if s.preload and saved is None:
            self._load()
        given = self.start() if self.start is not None and saved is None else None
        shocks = set_initial(
            self.problem, self.velocity, s.displacement, s.velocity, s.end, given=given
        )
        notes = [s.stability_limit] if s.stability_limit else []
        # A state that a run goes on from may lie deeper than the start that it had.
        penetrations = self.problem.check_start() if saved is None else []
        notes += [
            *map(str, shocks),
            *(() if s.preload else penetrations),
        ]  # an equilibrium has some
        for note in notes if saved is None else ():
            log.warning("%s", note)
        self.problem.terms.begin(moving=True)
        motion = self._motion = self._make()
        try:
            with failing_together(self.problem.body.comm):
                yield from motion.run(saved)
        finally:
            self._motion = None
            motion.destroy()

    def _load(self) -> None:
        """Finds the equilibrium under what acts at t = 0. Collective.

        Raises:
            ConvergenceError: There is none.
        """
        from dolfin_elastic.solvers.statics.statics import Statics  # which few motions need

        linear, state = self.linear.model_copy(update={"petsc": {}}), None
        petsc = {k: v for k, v in self.petsc.items() if not k.startswith("ts_")}
        with self.problem.growing_to_start():
            way = Statics(self.problem, self.statics, linear=linear, petsc=petsc, preload=True)
            for state in way.steps():
                log.debug("preload: %.4g %% of what acts at t = 0", 100 * state.t)
        if state is None or state.done < 1.0 - 1e-9:
            raise ConvergenceError(
                "the equilibrium from which the motion starts was not reached",
                advice="more statics.max_steps, or larger steps",
            )
        log.info("the motion starts from equilibrium: max |u| %.4g m", state.max_displacement)

    @property
    def ts(self) -> PETSc.TS:
        """PETSc's TS of an implicit motion that is on, for monitors and events of one's own.

        Its solution is that of all unknowns, and its second one the velocity.
        """
        if not isinstance(self._motion, Implicit):
            raise RuntimeError("there is no TS: no implicit motion is on")
        return self._motion.ts

    def restart_state(self) -> RestartState:
        """See `RestartableSolver`. Collective.

        Raises:
            RuntimeError: `steps` has not begun, or has ended.
        """
        if self._motion is None:
            raise RuntimeError("no state to save: the motion has not begun, or has ended")
        return self._motion.restart_state()

    def _run_is_on(self) -> Explicit | Implicit | None:
        return self._motion

    def _refuse_linear(self) -> None:
        """Keys of [solver], where there is nothing to solve."""
        what = f"the scheme '{self.settings.scheme}' solves no equations"
        keys = ["petsc"] if self.linear.method == "auto" else ["method", "petsc"]
        refuse_unused_keys(self.linear, [UnusedKeys(keys, what)], "solver")

    def _make(self) -> Explicit | Implicit:
        s, problem, velocity = self.settings, self.problem, self.velocity
        if not isinstance(s.row, ExplicitRow):
            return Implicit(problem, velocity, s, self.linear, self.petsc)
        for name in self.petsc:
            log.warning("PETSc option '-%s' was not used: '%s' solves no equations", name, s.scheme)
        bulk = s.bulk_viscosity
        options = ExplicitOptions(
            mass_scaling=s.mass_scaling or 0.0,
            rate=s.damping.get("mass", 0.0),
            bulk=None if bulk is None else (bulk.linear, bulk.quadratic),
        )
        scheme, every = s.row.scheme, s.every
        return Explicit(
            problem,
            velocity,
            scheme,
            end=s.end,
            dt=s.dt,
            safety=s.safety,
            every=every,
            options=options,
        )


def with_barriers(problem: Problem, settings: DynamicsSettings) -> DynamicsSettings:
    """With a scheme that sees the ends of steps, where terms bar steps: nothing passes there.

    Raises:
        InputError: Another scheme is given.
    """
    if not problem.terms.bars:
        return settings
    others = {"spectral_radius", "beta", "gamma"} & settings.model_fields_set
    given = settings.model_fields_set | ({"scheme"} if others else set())
    settings = settings.model_copy(update={k: v for k, v in BARRED.items() if k not in given})
    if settings.parameters is None or settings.parameters.alpha_f != 0.0:
        raise InputError(
            f"contact of a surface with itself cannot be computed by {settings.scheme}: at the "
            "ends of steps parts may have passed through each other",
            where="dynamics.scheme",
            expected='"implicit-euler", which is the default with it, or "newmark"',
        )
    return settings
