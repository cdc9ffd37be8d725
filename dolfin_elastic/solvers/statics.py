"""Statics: equilibrium under loads that grow step by step."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from dolfin_elastic.errors import ConvergenceError, InputError
from dolfin_elastic.model.curves import RAMP
from dolfin_elastic.problem import Problem
from dolfin_elastic.schema import Record
from dolfin_elastic.solvers.arclength import ArcLength
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.audit import Auditor
from dolfin_elastic.solvers.contact import Augmentation, Measured
from dolfin_elastic.solvers.doctor import diagnose
from dolfin_elastic.solvers.inertia import negative_eigenvalues
from dolfin_elastic.solvers.jump import PathWatch
from dolfin_elastic.solvers.ladder import Ladder
from dolfin_elastic.solvers.linear import LinearSettings, choose
from dolfin_elastic.solvers.newton import Newton
from dolfin_elastic.solvers.pace import Pace
from dolfin_elastic.solvers.progress import ANOTHER, BEYOND, UNSTABLE, Progress, Tolerance
from dolfin_elastic.solvers.relaxation import flow_away
from dolfin_elastic.solvers.rigid import check_held
from dolfin_elastic.solvers.scalars import Scalars
from dolfin_elastic.solvers.schedule import corners, gentle, winds
from dolfin_elastic.solvers.steps import StepSizes
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage
from dolfin_elastic.units import Force, Length

Vector = npt.NDArray[np.float64]
log = logging.getLogger("dolfin_elastic")

FIRST = 0.25
"""Share of the load in the first step of a nonlinear problem."""

JUMPS = 3
"""Jumps that no smaller step avoids, after which they are left to the audit: the energy of such a
body does not follow from its forces."""


class StaticsSettings(Record):
    """How a static solution is found.

    Attributes:
        method: "load": the load factor grows, and where no equilibrium is near the body is let go
            to flow to another; "arc-length": the path of equilibria is followed through limit
            points, where the load falls.
        steps: Equal load steps; by default the size of steps is chosen as they go.
        first_step: Share of the load in the first step; by default a quarter, and all of it in a
            linear problem.
        max_step: Share of the load that no step exceeds.
        min_step: Smallest step that is tried, as a share of the first one.
        end: Load parameter at which the run ends; 1 is the full load.
        times: Load parameters that are met exactly.
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up and tried smaller.
        max_steps: Steps after which a path is not followed any further.
        max_displacement: The run ends where a displacement reaches this [m].
        snap: Where the load cannot grow any further, let the body flow to another equilibrium.
    """

    method: Literal["load", "arc-length"] = "load"
    steps: int | None = Field(default=None, ge=1)
    first_step: float | None = Field(default=None, gt=0, le=1)
    max_step: float = Field(default=1.0, gt=0)
    min_step: float = Field(default=1e-3, gt=0, le=1)
    end: float = Field(default=1.0, gt=0)
    times: list[Annotated[float, Field(gt=0)]] = Field(default=[])
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=30, ge=1)
    max_steps: int = Field(default=1000, ge=1)
    max_displacement: Length | None = Field(default=None, gt=0)
    snap: bool = True

    @model_validator(mode="after")
    def _together(self) -> Self:
        if self.steps is not None and self.first_step is not None:
            raise InputError(
                "steps and first_step given together",
                expected="steps are equal; leave one of them out",
            )
        for index, time in enumerate(self.times):
            if time > self.end:
                raise InputError(
                    f"{time:g} lies beyond the end",
                    where=f"times[{index}]",
                    expected=f"at most statics.end = {self.end:g}",
                )
        if self.times and self.method == "arc-length":
            raise InputError(
                "a path that is followed by its length meets no load on purpose",
                where="times",
                expected='leave it out, or method = "load"',
            )
        return self


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
        self._check_path()
        for dashpot in self.problem.dashpots:
            log.warning("the dashpot '%s' does nothing in statics", dashpot.label)
        log.info("%s", self.choice.why)
        with ExitStack() as owned:
            assembler = Assembler(self.problem)
            owned.callback(assembler.destroy)
            scalars = Scalars(assembler)
            newton = Newton(
                assembler, self.choice, self.tolerance, users=self.petsc, border=scalars.border
            )
            owned.callback(newton.destroy)
            newton.watch_inversion()
            yield from _Stepping(self, scalars, newton).run()

    def _check_path(self) -> None:
        if self.problem.cell is not None and self.settings.method == "arc-length":
            raise InputError(
                "the path of a periodic cell is not followed by its length",
                where="statics.method",
                expected='"load"; periodic.gradient prescribes how far the cell is deformed',
            )

    @property
    def tolerance(self) -> Tolerance:
        """When equilibrium counts as found."""
        s = self.settings
        return Tolerance(s.rtol, s.atol, s.max_iterations)

    def sizes(self) -> StepSizes:
        """The plan of load steps."""
        s = self.settings
        if s.steps is not None:
            first = s.end / s.steps
            stops = [first * i for i in range(1, s.steps)]
            largest = first
        else:
            winding = winds(self.problem)
            share = 1.0 if self.problem.linear and not winding else FIRST
            first = min(s.first_step or share, s.max_step) * s.end
            wide = FIRST if winding and "max_step" not in s.model_fields_set else s.max_step
            stops, largest = [], max(first, wide * s.end)
        return StepSizes(
            s.end,
            first=first,
            largest=largest,
            smallest=first * s.min_step,
            stops=[*stops, *s.times, *corners(self.problem)],
            steady=s.steps is not None,
        )


class _Stepping:
    """Load steps: tried, made smaller or larger, given up."""

    def __init__(self, statics: Statics, scalars: Scalars, newton: Newton) -> None:
        self.statics, self.settings, self.problem = statics, statics.settings, statics.problem
        self.assembler, self.newton, self._scalars = newton.assembler, newton, scalars
        self.ladder = Ladder(newton, Augmentation(self.problem))
        self._watch, self._measured = PathWatch(self.assembler), Measured(self.problem)
        assert newton.guard is not None
        self._auditor = Auditor(self.problem, self.assembler, newton.guard.watch)
        self._count = 0
        self._before: tuple[float, Vector] | None = None
        self._fallback: tuple[float, Vector] | None = None  # where a step has jumped to
        self._limits: tuple[float, ...] = ()
        self._jumps = 0
        self._pace = Pace(self.assembler, corners(self.problem))

    def run(self) -> Iterator[State]:
        self.problem.set_time(0.0, default=RAMP)
        with stage("assemble"):
            self.assembler.assemble_balance()
        self._watch.look()
        self._watch.accept()
        yield self._state(0.0, Progress(reason="initial state"))
        yield from self._arc() if self.settings.method == "arc-length" else self._load()

    # --- the load grows ---

    def _load(self) -> Iterator[State]:
        sizes, t = self.statics.sizes(), 0.0
        while not sizes.done(t) and not self._is_enough():
            goal = gentle(self.problem, t, sizes.goal(t))
            start = self.newton.present()
            progress = self._attempt(t, goal)
            crushed = progress.rejected > 0 or "NAN" in progress.reason
            fault = self._fault() if progress.converged else progress.reason
            if fault:
                if fault == ANOTHER:
                    self._fallback = goal, self.newton.present()
                if sizes.failed(t, goal, crushed=crushed and not progress.converged):
                    log.info("load factor %.6g: %s; a smaller step", goal, fault)
                    self.ladder.undo(start)
                    continue
                goal, progress = self._elsewhere(t, goal, progress, fault, start)
            if not fault and self._pace.hasty(t, goal, start, progress) and sizes.closer(t, goal):
                log.debug("load factor %.6g: so far in one step; a closer look", goal)
                self.ladder.undo(start)
                continue
            self._watch.accept()
            self._pace.accept(known=not fault)
            self._before = t, start
            sizes.succeeded(t, goal, progress.newton)
            if fault:
                sizes.begin_anew()
            t = goal
            yield self._state(t, progress, negative_eigenvalues(self.newton))

    def _fault(self) -> str:
        """Why the equilibrium that was found is none that a body would come to. Collective."""
        if self.problem.linear:
            return ""
        self._watch.look()
        if not self._watch.finite():
            return BEYOND
        if (negative_eigenvalues(self.newton) or 0) > 0:
            return UNSTABLE
        if self._jumps >= JUMPS:
            return ""
        jumped = self._watch.jumped(self.newton.progress.target)
        return ANOTHER if jumped else ""

    def _elsewhere(
        self, t: float, goal: float, progress: Progress, fault: str, start: Vector
    ) -> tuple[float, Progress]:
        """Goes on where no step is small enough, or gives up.

        Returns:
            The load factor that was reached after all, and how.
        """
        kept = self.newton.present() if progress.converged else self.ladder.failed
        stuck = fault == BEYOND or (t == 0.0 and not progress.converged)
        if not self.settings.snap or self.problem.linear or stuck:
            progress.reason = fault
            raise self._failure(t, goal, progress, start, kept)
        if not progress.converged or fault == UNSTABLE:
            found = flow_away(self.ladder, settled=progress.converged)
            if not found.converged and self._fallback is not None and self._fallback[0] > t:
                goal, there = self._fallback
                self.problem.set_time(goal, default=RAMP)
                found = self.ladder.solve([("", there)])
                if found.converged and (negative_eigenvalues(self.newton) or 0) > 0:
                    found = flow_away(self.ladder, settled=True)
            self._watch.look()
            if not found.converged or not self._watch.finite():
                progress.reason = fault
                raise self._failure(t, goal, progress, start, kept)
            progress = found
        self._jumps += fault == ANOTHER
        what = "the body buckles" if fault == UNSTABLE else "the body has snapped"
        log.warning(
            "no stable equilibrium is near beyond load factor %.6g: %s to another one; "
            'statics.method = "arc-length" shows the path between',
            t,
            what,
        )
        return goal, progress

    def _is_enough(self) -> bool:
        limit = self.settings.max_displacement
        if limit is not None and self.assembler.max_displacement() >= limit:
            log.info("a displacement has reached %g m: the run ends", limit)
            return True
        if self._count > self.settings.max_steps:
            log.warning("statics.max_steps = %d steps are done: the run ends", self._count - 1)
            return True
        return False

    def _attempt(self, t: float, goal: float) -> Progress:
        """Tries to go to a load factor; the displacement is put back if that fails."""
        self.problem.set_time(goal, default=RAMP)
        self.problem.prescribed.check_finite()
        now = self.newton.present()
        starts = [("", now)]
        if self._before is not None and t > self._before[0]:
            before, was = self._before
            starts.append(("along the path", now + (goal - t) / (t - before) * (now - was)))
        return self.ladder.solve(starts)

    def _failure(
        self, t: float, goal: float, progress: Progress, good: Vector, failed: Vector | None
    ) -> ConvergenceError:
        """The error, with why; the problem is left with the last iterate."""
        progress.converged = False
        last = good if failed is None else failed
        self.newton.put_back(last)
        fields = len(self.problem.w.x.array)
        # Beyond a limit point the path is unstable, and so may be the fields beside scalars.
        judged = self.settings.method == "load" and self._scalars.border is None
        found = diagnose(
            self.assembler, progress, good=good[:fields], failed=last[:fields], stable=judged
        )
        force, place = self.assembler.largest_unbalance()
        return ConvergenceError(
            f"no equilibrium beyond load factor {t:.6g}: {found.text}\n  at the end: "
            f"{progress.reason}, Newton iterations: {progress.newton}; the largest force out of "
            f"balance, {force:.3g} N, is at {_text(place)} m",
            advice=found.advice,
            state=self._state(goal, progress),
            diagnosis=found,
        )

    # --- the path grows ---

    def _arc(self) -> Iterator[State]:
        statics = self.statics
        arc = ArcLength(self.ladder, self._scalars.parts, end=self.settings.end)
        try:
            arc.prepare(statics.choice, statics.tolerance, statics.petsc)
            first = statics.sizes().goal(0.0)
            chosen = self.settings.first_step is not None or self.settings.steps is not None
            for found in arc.path(first, self.settings.min_step, chosen=chosen):
                self._watch.look()
                if found.progress.converged and not self._watch.finite():
                    found.progress.reason = BEYOND
                    found.progress.converged = False
                if not found.progress.converged:
                    good = self.newton.present() if found.good is None else found.good
                    raise self._failure(found.t, found.t, found.progress, good, found.failed)
                self._limits = tuple(arc.limits)
                yield self._state(found.t, found.progress, found.negative)
                if self._is_enough():
                    return
        finally:
            arc.destroy()

    # --- what is yielded ---

    def _state(self, t: float, progress: Progress, negative: int | None = None) -> State:
        problem, assembler = self.problem, self.assembler
        strain = self._watch.strain
        energies = {"strain": strain.energy(), **strain.springs()}
        judged = progress.converged or t == 0.0
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
            energies=energies,
            reactions=assembler.reactions(),
            max_displacement=assembler.max_displacement(),
            negative=negative,
            limit_points=self._limits,
            numbers={**self._measured.numbers(), **self._scalars.numbers()},
            audit=self._auditor.of(t, energies["strain"]) if judged else None,
            done=t / self.settings.end,
        )


def _text(place: Any) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in place) + ")"
