"""Load steps, one after the other: tried, made smaller or larger, given up."""

from __future__ import annotations

import logging
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.state import RestartState, SavedState, State, restoring
from dolfin_elastic.problem.term_list import intrusion, passed
from dolfin_elastic.solvers.audit.equilibrium import PathEnergyCheck
from dolfin_elastic.solvers.diagnostics.stability import Verdict, judge
from dolfin_elastic.solvers.messages import in_words
from dolfin_elastic.solvers.nonlinear.convergence import (
    ANOTHER,
    BEYOND,
    ENTERED,
    PASSED,
    UNSTABLE,
    NewtonResult,
)
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.nonlinear.passage import leads_through
from dolfin_elastic.solvers.statics.retry import RetryStrategy, flow_to_equilibrium
from dolfin_elastic.solvers.statics.settings import StaticsSettings
from dolfin_elastic.solvers.statics.states import StaticStates
from dolfin_elastic.solvers.statics.step_size import StepSizes, StepSpeed
from dolfin_elastic.solvers.statics.whole_load import try_whole_load

if TYPE_CHECKING:
    from dolfin_elastic.solvers.statics.arc_length import ArcLength

log = logging.getLogger("dolfin_elastic")

JUMPS = 3
"""Jumps that no smaller step avoids, after which jumps are accepted and only the audit warns: in
such a body the energy does not follow from the forces."""


@dataclass(frozen=True)
class _Step:
    """A load step.

    Attributes:
        t: Load factor at its beginning.
        goal: Load factor at its end.
        start: All unknowns at its beginning, as `Newton.unknowns`.
    """

    t: float
    goal: float
    start: FloatArray


@dataclass(frozen=True)
class InitialGuess:
    """Unknowns near those of the full load, as those of a coarser mesh or of an earlier run are.

    Attributes:
        unknowns: Local array of all fields, `Problem.w`.
        scalars: Scalar unknowns beside the fields.
    """

    unknowns: FloatArray
    scalars: tuple[float, ...] = ()


class LoadStepping:
    """Load steps of one run. Collective to make.

    Args:
        newton: The solver; its problem is at the starting point.
        whole: The whole load is tried in one step before it grows in several.
    """

    def __init__(
        self,
        settings: StaticsSettings,
        sizes: StepSizes,
        *,
        newton: Newton,
        watch: JacobianWatch,
        whole: bool = False,
    ) -> None:
        self._settings, self._sizes, self._newton = settings, sizes, newton
        self._assembler, self._problem = newton.assembler, newton.assembler.problem
        self._retry = RetryStrategy(newton)
        self._path_check = PathEnergyCheck(self._assembler)
        self._states = StaticStates(
            newton,
            book=self._path_check.book,
            watch=watch,
            end=settings.end,
            seconds=bool(settings.in_time),
        )
        self._speed = StepSpeed(self._assembler, self._problem.corners)
        self._t, self._whole = 0.0, whole
        self._arc: ArcLength | None = None
        # Load factor and unknowns at the beginning of the last step: the path is extrapolated.
        self._previous: tuple[float, FloatArray] | None = None
        # Load factor and unknowns of an equilibrium on another path that a step has jumped to.
        self._jumped_to: tuple[float, FloatArray] | None = None
        self._limits: tuple[tuple[float, float], ...] = ()
        self._jumps = 0
        # On the last equilibrium that was found, accepted or not.
        self._verdict: Verdict | None = None

    def run(
        self, saved: SavedState | None = None, near: InitialGuess | None = None
    ) -> Generator[State, None, None]:
        """Yields the states; see `Statics.steps`. Collective.

        Args:
            saved: A `restart_state` from which the run continues.
        """
        by_load = self._settings.method == "load"
        if saved is None:
            self._problem.set_time(0.0, default=PROPORTIONAL)
            self._problem.terms.commit()
        if near is not None and by_load and (state := self._straight(near)) is not None:
            yield state
            return
        try:
            if self._settings.method == "arc-length":
                from dolfin_elastic.solvers.statics.arc_length import ArcLength

                self._arc = ArcLength(self._retry, end=self._settings.end)
            if saved is None:
                self._evaluate_start()
                begin = NewtonResult(reason="initial state")
                yield self._states.state(0.0, begin, stored=self._path_check.stored)
            else:
                with restoring(saved):
                    self.restore(saved)
            yield from self._by_load() if self._arc is None else self._along_path(self._arc)
        finally:
            if self._arc is not None:
                self._arc.destroy()

    def _evaluate_start(self) -> None:
        """Evaluates residual and energy of the state where the next step starts. Collective."""
        with stage("assemble"):
            self._assembler.residual.assemble()
        self._path_check.evaluate()
        self._path_check.accept()

    # --- from one run to the next ---

    def stop_at(self, t: float) -> None:
        """See `marching.Loop`; loads may have changed, so that no speed is known any more."""
        self._sizes.stop_at(t)
        self._speed.accept(known=False)

    def restart_state(self) -> RestartState:
        """See `Restartable`. Collective."""
        history = self._problem.history
        fields = {"unknowns": self._problem.w, **self._problem.terms.memory}
        numbers: dict[str, Any] = {
            "t": self._t,
            "scalars": self._split(self._newton.unknowns())[1],
            "sizes": self._sizes.restart_state(),
            "jumps": self._jumps,
            "speed": self._speed.speed,
            "limits": self._limits,
            "newton": self._newton.restart_state(),
            **self._states.restart_state(),
        }
        if history is not None:
            fields |= history.fields()
            numbers["history"] = history.restart_state()
        ahead = self._jumped_to is not None and self._jumped_to[0] > self._t
        others = {"before": self._previous, "fallback": self._jumped_to if ahead else None}
        for name, other in others.items():
            if other is not None:
                fields[name], scalars = self._split(other[1])
                numbers[name] = {"t": other[0], "scalars": scalars}
        if self._arc is not None:
            arc = self._arc.restart_state()
            fields |= arc.fields
            numbers["arc"] = arc.numbers
        return RestartState(fields, numbers)

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`; the problem is unloaded before. Collective."""
        numbers = saved.numbers
        names = [name for name in ("before", "fallback") if name in numbers]
        names += ["way"] if numbers.get("arc") else []
        others = {name: fem.Function(self._problem.W) for name in names}
        history = self._problem.history
        past = {} if history is None else history.fields()
        saved.fill({"unknowns": self._problem.w, **self._problem.terms.memory, **others, **past})
        self._t = numbers["t"]
        self._problem.set_time(self._t, default=PROPORTIONAL)
        self._newton.put_back(self._join(self._problem.w, numbers["scalars"]))
        self._problem.terms.commit()
        if history is not None:
            history.restore(past, numbers["history"])
        self._sizes.restore(numbers["sizes"])
        self._jumps = numbers["jumps"]
        self._limits = tuple((t, error) for t, error in numbers["limits"])
        self._speed.restore(numbers["speed"])
        self._previous, self._jumped_to = (
            (numbers[name]["t"], self._join(others[name], numbers[name]["scalars"]))
            if name in others
            else None
            for name in ("before", "fallback")
        )
        self._retry.restarted()
        self._newton.restore(numbers["newton"])
        self._evaluate_start()
        self._states.restore(numbers)
        if self._arc is not None:
            self._arc.restore(self._t, others.get("way"), numbers["arc"])

    def _split(self, unknowns: FloatArray) -> tuple[fem.Function, list[float]]:
        """Fields and scalars of unknowns as `Newton.unknowns` has them."""
        w = fem.Function(self._problem.W)
        w.x.array[:] = unknowns[: len(w.x.array)]
        return w, [float(value) for value in unknowns[len(w.x.array) :]]

    def _join(self, w: fem.Function, scalars: Sequence[float]) -> FloatArray:
        return np.concatenate([w.x.array, np.array(scalars, dtype=np.float64)])

    # --- from unknowns near those of the end ---

    def _straight(self, near: InitialGuess) -> State | None:
        """The equilibrium of the full load next to a guess, None if there is none. Collective.

        All unknowns and the time are put back if there is none.
        """
        start, end = self._newton.unknowns(), self._settings.end
        self._problem.set_time(end, default=PROPORTIONAL)
        self._problem.constraints.check_finite()
        result = self._retry.solve([("", self._join_arrays(near))])
        refusal = self._refusal_of_guess() if result.converged else result.reason
        if refusal:
            log.info("from the solution before: %s; the load grows from zero", refusal)
            self._retry.undo(start)
            self._problem.set_time(0.0, default=PROPORTIONAL)
            self._retry.restarted()
            return None
        self._t = end
        # The auditor compares a state with the one before it: it is shown this one twice.
        self._states.state(end, result)
        return self._committed(self._states.state(end, result, verdict=self._verdict))

    def _join_arrays(self, near: InitialGuess) -> FloatArray:
        return np.concatenate([near.unknowns, np.array(near.scalars, dtype=np.float64)])

    def _refusal_of_guess(self) -> str:
        """Why the equilibrium is none that a body would be in; empty: it is. Collective."""
        self._evaluate_start()
        if not self._path_check.finite():
            return BEYOND
        if intrusion(self._problem.terms) is not None:
            return ENTERED
        self._verdict = judge(self._newton)
        return UNSTABLE if self._verdict.stable is False else ""

    # --- the load grows ---

    def _by_load(self) -> Iterator[State]:
        sizes = self._sizes
        end, start = self._settings.end, self._newton.unknowns()
        whole = self._whole and self._t == 0.0
        if whole and (whole_load := try_whole_load(self._retry, self._path_check, end)) is not None:
            result, self._verdict = whole_load
            self._accept(_Step(0.0, end, start), end, result, left_path=False)
            stored = self._path_check.stored
            state = self._states.state(end, result, verdict=self._verdict, stored=stored)
            yield self._committed(state)
        while not sizes.done(self._t) and not self._ends_early():
            goal = sizes.goal(self._t)
            goal = self._problem.terms.within_stride(self._t, goal, self._problem.acting)
            step = _Step(self._t, goal, self._newton.unknowns())
            self._problem.set_time(goal, default=PROPORTIONAL)
            before = self._problem.u.x.array.copy(), self._problem.terms.poses
            result = self._solve(step)
            last = goal >= self._settings.end
            refusal = self._refusal(*before, last=last) if result.converged else result.reason
            if refusal:
                if refusal == ANOTHER:
                    self._jumped_to = goal, self._newton.unknowns()
                inverted = not result.converged and (result.rejected > 0 or "NAN" in result.reason)
                if sizes.failed(step.t, goal, inverted=inverted):
                    what = in_words(refusal) + self._released(result)
                    text = "at %.4g %% of the load: %s; trying a smaller step"
                    log.info(text, 100 * goal, what, extra={"search": True})
                    self._retry.undo(step.start)
                    continue
                goal, result = self._leave_path(step, result, refusal)
            elif self._speed.too_fast(step.t, goal, step.start, result) and sizes.refine(
                step.t, goal
            ):
                log.debug("load factor %.6g: a large displacement in one step; repeated", goal)
                self._retry.undo(step.start)
                continue
            self._accept(step, goal, result, left_path=bool(refusal))
            state = self._states.state(goal, result, verdict=self._verdict, limits=self._limits)
            yield self._committed(state)

    def _solve(self, step: _Step) -> NewtonResult:
        """Tries to take a step to the present time; all is put back if that fails. Collective."""
        self._problem.constraints.check_finite()
        now = self._newton.unknowns()
        starts = [("", now)]
        if self._previous is not None and step.t > self._previous[0]:
            before, was = self._previous
            further = now + (step.goal - step.t) / (step.t - before) * (now - was)
            terms = self._problem.terms
            looks = terms.joins or terms.bars
            if not (looks and leads_through(self._problem, self._newton.put_back, further, now)):
                starts.append(("along the path", further))
        return self._retry.solve(starts)

    def _released(self, result: NewtonResult) -> str:
        """That the last iterate of a failure is off its contact, in words. Collective."""
        from dolfin_elastic.solvers.diagnostics.sliding import released

        if result.converged or self._retry.failed is None:
            return ""
        self._newton.put_back(self._retry.failed)
        if (found := released(self._problem)) is None:
            return ""
        return f", and contact no longer holds {found[0]} there: it can {found[1]}"

    def _accept(self, step: _Step, goal: float, result: NewtonResult, *, left_path: bool) -> None:
        """Takes the present equilibrium as the next point of the path.

        Args:
            left_path: It lies on another path, of which no speed and no step size is known.
        """
        self._path_check.accept()
        self._speed.accept(known=not left_path)
        self._previous = step.t, step.start
        remembers = self._problem.history is not None
        self._sizes.succeeded(step.t, goal, self._retry.spent if remembers else result.longest)
        if left_path:
            self._sizes.begin_anew()
        self._t = goal
        self._remember()

    def _remember(self) -> None:
        """Makes the present state, which is kept, the past of the materials. Collective."""
        if self._problem.history is not None:
            self._problem.history.commit()

    def _committed(self, state: State) -> State:
        """The same: only after it was measured its terms begin the next step. Collective."""
        self._problem.terms.commit()
        return state

    def _refusal(
        self, before: FloatArray, poses: Sequence[FloatArray | None], *, last: bool
    ) -> str:
        """Why the equilibrium is not the next point of the path; empty: it is. Collective.

        Newton's method may find an unstable equilibrium, one on another path, or one where a
        material's energy has no finite value.

        Args:
            before: Displacements at the start of the step, local array [m].
            poses: Of the terms there: a force may have moved an obstacle since.
        """
        if self._problem.linear:
            self._verdict = judge(self._newton)
            return UNSTABLE if self._verdict.stable is False else ""
        if refusal := self._unseen(before, poses):
            return refusal
        self._path_check.evaluate()
        if not self._path_check.finite():
            return BEYOND
        self._verdict = judge(self._newton, surely=last)
        if self._verdict.stable is False:
            return UNSTABLE
        if self._jumps >= JUMPS:
            return ""
        return ANOTHER if self._path_check.jumped(self._newton.result.target) else ""

    def _unseen(self, before: FloatArray, poses: Sequence[FloatArray | None]) -> str:
        """What the forces of contact have not seen, see `_refusal`. Collective."""
        terms = self._problem.terms
        if passed(terms, before - self._problem.u.x.array, poses):
            return PASSED
        return ENTERED if intrusion(terms) is not None else ""

    def _leave_path(
        self, step: _Step, result: NewtonResult, refusal: str
    ) -> tuple[float, NewtonResult]:
        """Goes to an equilibrium off the path, where no step along it is small enough; or fails.

        Three things can have stopped the smallest step:

        - Nothing converged, or what did is unstable: a limit point or a bifurcation.  A real body
          would move from there to a stable equilibrium, which pseudo-transient continuation
          finds.  Where it does not, there may still be the equilibrium that a larger step has
          jumped to: it was refused then only because a smaller step might have stayed on the path.
        - A stable equilibrium of another path (`ANOTHER`) at every size of step: then the path
          has ended, the jump is what the body does, and it is taken as it is.
        - A material beyond its limit, an obstacle that was passed, or no equilibrium at all next to
          the unloaded body: no flow leads out of the first two, and the last is a fault of the
          input (loads, supports), which is reported.

        Args:
            result: How it ended; if it converged, the problem holds what was refused.
            refusal: Why it is not accepted.

        Returns:
            The load factor that was reached after all, and how.

        Raises:
            ConvergenceError: No other equilibrium was found, or none may be looked for.
        """
        goal, newton = step.goal, self._newton
        failed = newton.unknowns() if result.converged else self._retry.failed
        hopeless = refusal in (BEYOND, PASSED, ENTERED) or (step.t == 0.0 and not result.converged)
        if not self._settings.snap or self._problem.linear or hopeless:
            raise self._failure(step.t, goal, result.refused(refusal), step.start, failed)
        if refusal != ANOTHER:
            unstable = self._verdict if result.converged else None
            reached, self._verdict = flow_to_equilibrium(self._retry, unstable)
            if not reached.converged and self._jumped_to is not None:
                goal, reached = self._follow_jump(step, reached)
            self._path_check.evaluate()
            if not reached.converged or not self._path_check.finite():
                # The first failure is diagnosed: what stopped the path, not what stopped the flow.
                raise self._failure(step.t, goal, result.refused(refusal), step.start, failed)
            result = reached
        if intrusion(self._problem.terms) is not None:
            raise self._failure(
                step.t, goal, result.refused(ENTERED), step.start, newton.unknowns()
            )
        self._jumps += refusal == ANOTHER
        self._limits += (((step.t + step.goal) / 2, (step.goal - step.t) / 2),)
        what = "buckles or tips over" if refusal == UNSTABLE else "has snapped through"
        log.warning(
            "the part %s between %.4g and %.4g %% of the load: the result is where it comes to "
            'rest; statics.method = "arc-length" shows the way there',
            what,
            100 * step.t,
            100 * step.goal,
        )
        return goal, result

    def _follow_jump(self, step: _Step, reached: NewtonResult) -> tuple[float, NewtonResult]:
        """Goes where a larger step had jumped to, if that is still ahead. Collective.

        Args:
            reached: How the flow ended that did not find an equilibrium.
        """
        assert self._jumped_to is not None
        goal, unknowns = self._jumped_to
        if goal <= step.t:
            return step.goal, reached
        self._problem.set_time(goal, default=PROPORTIONAL)
        reached = self._retry.solve([("", unknowns)])
        if reached.converged:
            self._verdict = judge(self._newton)
            if self._verdict.stable is False:
                reached, self._verdict = flow_to_equilibrium(self._retry, self._verdict)
        return goal, reached

    def _ends_early(self) -> bool:
        limit = self._settings.max_displacement
        if limit is not None and self._assembler.max_displacement() >= limit:
            log.info("a displacement has reached %g m: the run ends", limit)
            return True
        steps = self._states.count - 1
        if steps >= self._settings.max_steps:
            log.warning("statics.max_steps = %d steps are done: the run ends", steps)
            return True
        return False

    def _failure(
        self,
        t: float,
        goal: float,
        result: NewtonResult,
        good: FloatArray,
        failed: FloatArray | None,
    ) -> ConvergenceError:
        # Arc length follows unstable paths, where a negative eigenvalue does not explain a failure.
        return self._states.failure(
            t,
            goal,
            result,
            good=good,
            failed=good if failed is None else failed,
            judge_stability=self._settings.method == "load",
        )

    # --- the path is followed by its length ---

    def _along_path(self, arc: ArcLength) -> Iterator[State]:
        if self._t > 0.0 and self._ends_early():
            return
        s = self._settings
        chosen = s.first_step is not None or s.steps is not None
        for point in arc.path(self._sizes.goal(0.0), s.min_step, chosen=chosen):
            self._path_check.evaluate()
            result = point.result
            if result.converged and not self._path_check.finite():
                result = result.refused(BEYOND)
            elif result.converged and intrusion(self._problem.terms) is not None:
                result = result.refused(ENTERED)
            if not result.converged:
                good = self._newton.unknowns() if point.good is None else point.good
                raise self._failure(point.t, point.t, result, good, point.failed)
            self._t = point.t
            self._remember()
            self._limits = tuple((limit.t, limit.error) for limit in arc.limits)
            state = self._states.state(point.t, result, verdict=point.verdict, limits=self._limits)
            yield self._committed(state)
            if self._ends_early():
                return
