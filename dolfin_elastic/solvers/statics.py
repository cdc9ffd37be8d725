"""Statics: equilibrium under loads that grow step by step."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from dolfin_elastic.errors import ConvergenceError
from dolfin_elastic.model.curves import RAMP
from dolfin_elastic.problem import Problem
from dolfin_elastic.schema import Record
from dolfin_elastic.solvers.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.inversion import JacobianWatch
from dolfin_elastic.solvers.linear import LinearSettings, choose
from dolfin_elastic.solvers.newton import Newton, Progress, Tolerance
from dolfin_elastic.solvers.rigid import check_held
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage
from dolfin_elastic.units import Force

log = logging.getLogger("dolfin_elastic")

QUICK = 5
"""Newton iterations up to which a step counts as easy and the next one may be larger."""


class StaticsSettings(Record):
    """How a static solution is found.

    Attributes:
        steps: Load steps from nothing to the full load.  A step that fails is tried again in
            halves.
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual that always is small enough [N].
        max_iterations: Newton iterations after which a step is given up and halved.
        min_step: Smallest part of a step that is tried, as a fraction of it.
    """

    steps: int = Field(default=1, ge=1)
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=30, ge=1)
    min_step: float = Field(default=1e-3, gt=0, le=1)


class Statics:
    """Finds the equilibrium states of a problem under growing load.

    Args:
        problem: What is loaded; its displacement is the starting point.
        settings: See `StaticsSettings`; keyword arguments are its fields.
        linear: How linear systems are solved.
        petsc: PETSc options, which win over everything.
    """

    def __init__(
        self,
        problem: Problem,
        settings: StaticsSettings | None = None,
        *,
        linear: LinearSettings | None = None,
        petsc: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        self.problem = problem
        if settings is not None and fields:
            raise TypeError(f"give settings or keywords, not both: {', '.join(fields)}")
        self.settings = settings or StaticsSettings(**fields)
        self.linear = linear or LinearSettings()
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.choice = choose(problem, self.linear)

    def steps(self) -> Iterator[State]:
        """Yields the initial state and then one equilibrium a step. Collective.

        Raises:
            InputError: The supports do not hold the body against every rigid motion.
            ConvergenceError: No equilibrium was found even with the smallest step; the problem
                then holds the last iterate, and all states yielded before are valid.
        """
        check_held(self.problem)
        log.info("%s", self.choice.why)
        s = self.settings
        assembler = Assembler(self.problem)
        tolerance = Tolerance(s.rtol, s.atol, s.max_iterations)
        newton = Newton(assembler, self.choice, tolerance, users=self.petsc)
        try:
            yield from _Stepping(self, assembler, newton).run()
        finally:
            newton.destroy()
            assembler.destroy()


class _Stepping:
    """Load steps with retry in halves and growth back to the planned size."""

    def __init__(self, statics: Statics, assembler: Assembler, newton: Newton) -> None:
        self.settings, self.problem = statics.settings, statics.problem
        self.assembler, self.newton = assembler, newton
        energy = self.problem.strain_energy
        self._energy = compiled(self.problem, [energy])[0] if energy is not None else None
        self._watch = JacobianWatch(self.problem)
        self._count = 0

    def run(self) -> Iterator[State]:
        planned = 1.0 / self.settings.steps
        t, size = 0.0, planned
        self.problem.set_time(t, default=RAMP)
        with stage("assemble"):
            self.assembler.assemble_balance()
        yield self._state(t, Progress(reason="initial state"))
        while t < 1.0 - 1e-12:
            goal = _next_planned(t, planned, size)
            progress = self._attempt(t, goal)
            if progress.converged:
                t = goal
                yield self._state(t, progress)
                easy = progress.newton <= QUICK
                size = min(planned, (2.0 if easy else 1.0) * size)
            else:
                size = self._smaller(t, goal, planned, progress)

    def _attempt(self, t: float, goal: float) -> Progress:
        """Tries to go to a load factor; the displacement is put back if that fails."""
        w = self.problem.w.x.array
        start = w.copy()
        self.problem.set_time(goal, default=RAMP)
        self.problem.prescribed.check_finite()
        for line_search in self.newton.ladder():
            if self._count > 1:
                self.newton.refresh()
            w[:] = start
            progress = self.newton.solve(line_search)
            if "LINEAR_SOLVE" in progress.reason and self.newton.fall_back():
                w[:] = start
                progress = self.newton.solve(line_search)
            self._refuse_inverted(progress)
            if progress.converged:
                return progress
            log.debug("line search '%s' fails: %s", line_search, progress.reason)
        self._failed = w.copy()
        w[:] = start
        self.problem.unknowns.tell()
        return progress

    def _refuse_inverted(self, progress: Progress) -> None:
        if not progress.converged or (worst := self._watch.smallest())[0] > 0.0:
            return
        what = f"a cell turned inside out (det F = {worst[0]:.3g}, at {_text(worst[1])} m)"
        if self.problem.linear:  # it is the solution, only far beyond what the law is made for
            log.warning("%s: too large a load for laws of small strains", what)
            return
        progress.converged, progress.reason = False, what

    def _smaller(self, t: float, goal: float, planned: float, progress: Progress) -> float:
        """Half the step that failed, or the error when that is too small."""
        size = (goal - t) / 2
        if size >= planned * self.settings.min_step:
            log.warning(
                "no equilibrium at load factor %.6g (%s): half the step", goal, progress.reason
            )
            return size
        force, place = self.assembler.largest_unbalance()
        self.problem.w.x.array[:] = self._failed
        self.problem.unknowns.tell()
        raise ConvergenceError(
            f"no equilibrium beyond load factor {t:.6g}: {progress.reason}, Newton iterations: "
            f"{progress.newton}; the largest force out of balance, {force:.3g} N, is at "
            f"{_text(place)} m",
            advice=_advice(progress),
            state=self._state(goal, progress),
        )

    def _state(self, t: float, progress: Progress) -> State:
        problem, assembler = self.problem, self.assembler
        strain = np.nan if self._energy is None else integral(problem, self._energy)
        self._count += 1
        return State(
            step=self._count - 1,
            t=t,
            load_factor=t,
            u=problem.u,
            w=problem.w,
            newton=progress.newton,
            krylov=progress.krylov,
            reason=progress.reason,
            residuals=tuple(progress.residuals),
            energies={"strain": strain},
            reactions=assembler.reactions(),
            max_displacement=assembler.max_displacement(),
            done=t,
        )


def _next_planned(t: float, planned: float, size: float) -> float:
    """The end of a step of `size`, at most the next planned load factor."""
    following = (np.floor(t / planned + 1e-9) + 1) * planned
    goal = min(t + size, following)
    return 1.0 if abs(goal - 1.0) < 1e-9 else float(goal)


def _text(place: Any) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in place) + ")"


def _advice(progress: Progress) -> str:
    if "LINEAR_SOLVE" in progress.reason:
        return (
            "is the body held against every rigid motion? Otherwise "
            'solver.method = "direct" or a smaller load'
        )
    if "inside out" in progress.reason or "NAN" in progress.reason:
        return "more load steps, a smaller load, or a finer mesh where the cells are crushed"
    return "more load steps or a smaller load; beyond a limit point no static equilibrium exists"
