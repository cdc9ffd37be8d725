"""Load steps, one after the other: tried, made smaller or larger, given up."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.state import RestartState, SavedState, State
from dolfin_elastic.solvers.audit.equilibrium import EquilibriumAuditor
from dolfin_elastic.solvers.audit.path_energy import PathEnergyCheck
from dolfin_elastic.solvers.breakpoints import corners, gentle
from dolfin_elastic.solvers.diagnostics.diagnose import diagnose
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.contact import ContactAugmentation, Measured
from dolfin_elastic.solvers.nonlinear.convergence import (
    ANOTHER,
    BEYOND,
    UNSTABLE,
    NewtonResult,
)
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.nonlinear.scalars import Scalars
from dolfin_elastic.solvers.statics.arc_length import ArcLength
from dolfin_elastic.solvers.statics.inertia_count import negative_eigenvalues
from dolfin_elastic.solvers.statics.pseudo_transient import flow_away
from dolfin_elastic.solvers.statics.retry import RetryStrategy
from dolfin_elastic.solvers.statics.step_size import StepSpeed

if TYPE_CHECKING:
    from dolfin_elastic.solvers.statics.statics import Statics

log = logging.getLogger("dolfin_elastic")

JUMPS = 3
"""Jumps that no smaller step avoids, after which they are left to the audit: the energy of such a
body does not follow from its forces."""


class LoadStepping:
    """Load steps: tried, made smaller or larger, given up.

    Args:
        statics: What is to be solved.
        scalars: Scalar unknowns.
        newton: The solver.
    """

    def __init__(self, statics: Statics, scalars: Scalars, newton: Newton) -> None:
        self.statics, self.settings, self.problem = statics, statics.settings, statics.problem
        self.assembler, self.newton, self._scalars = newton.assembler, newton, scalars
        self.ladder = RetryStrategy(newton, ContactAugmentation(self.problem))
        self._watch, self._measured = PathEnergyCheck(self.assembler), Measured(self.problem)
        assert newton.guard is not None
        self._auditor = EquilibriumAuditor(self.problem, self.assembler, newton.guard.watch)
        self._count = 0
        self._t, self._sizes = 0.0, statics.sizes()
        self._arc: ArcLength | None = None
        self._before: tuple[float, FloatArray] | None = None
        self._fallback: tuple[float, FloatArray] | None = None  # where a step has jumped to
        self._limits: tuple[float, ...] = ()
        self._jumps = 0
        self._pace = StepSpeed(self.assembler, corners(self.problem))

    def run(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the states; see `Statics.steps`. Collective."""
        try:
            if self.settings.method == "arc-length":
                self._make_arc()
            if saved is None:
                self.problem.set_time(0.0, default=PROPORTIONAL)
                self._arrive()
                yield self._state(0.0, NewtonResult(reason="initial state"))
            else:
                self.restore(saved)
            yield from self._load() if self._arc is None else self._path(self._arc)
        finally:
            if self._arc is not None:
                self._arc.destroy()

    def _arrive(self) -> None:
        """Takes the present state as one where the next step begins. Collective."""
        with stage("assemble"):
            self.assembler.residual.assemble()
        self._watch.look()
        self._watch.accept()

    # --- from one run to the next ---

    def restart_state(self) -> RestartState:
        """See `Restartable`. Collective."""
        fields = {"unknowns": self.problem.w, **self._multipliers()}
        numbers: dict[str, Any] = {
            "t": self._t,
            "scalars": self._scalars.get(),
            "count": self._count,
            "sizes": self._sizes.restart_state(),
            "jumps": self._jumps,
            "speed": self._pace.speed,
            "limits": self._limits,
            "audit": self._auditor.restart_state(),
            "newton": self.newton.restart_state(),
        }
        fallback = self._fallback if self._fallback and self._fallback[0] > self._t else None
        for name, other in (("before", self._before), ("fallback", fallback)):
            if other is not None:
                fields[name], scalars = self._apart(other[1])
                numbers[name] = {"t": other[0], "scalars": scalars}
        if self._arc is not None:
            arc = self._arc.restart_state()
            fields |= arc.fields
            numbers["arc"] = arc.numbers
        return RestartState(fields, numbers)

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`; the problem is unloaded before. Collective."""
        numbers, multipliers = saved.numbers, self._multipliers()
        names = [name for name in ("before", "fallback") if name in numbers]
        names += ["way"] if numbers.get("arc") else []
        others = {name: fem.Function(self.problem.W) for name in names}
        saved.fill({"unknowns": self.problem.w, **multipliers, **others})
        self._t, self._count = numbers["t"], numbers["count"]
        self.problem.set_time(self._t, default=PROPORTIONAL)
        if self._scalars.joined is not None:
            self._scalars.joined.put(np.array(numbers["scalars"]))
        self.problem.unknowns.w_to_u()
        self._sizes.restore(numbers["sizes"])
        self._jumps, self._limits = numbers["jumps"], tuple(numbers["limits"])
        self._pace.speed = numbers["speed"]
        self._before, self._fallback = (
            (numbers[name]["t"], self._together(others[name], numbers[name]["scalars"]))
            if name in others
            else None
            for name in ("before", "fallback")
        )
        self.ladder.restarted()
        self._arrive_again(numbers)
        if self._arc is not None:
            self._arc.restore(self._t, others.get("way"), numbers["arc"])

    def _arrive_again(self, numbers: Mapping[str, Any]) -> None:
        """Evaluates the state that was restored, as the last step has left it. Collective."""
        self.newton.restore(numbers["newton"])
        self._arrive()
        self._auditor.restore(numbers["audit"])

    def _multipliers(self) -> dict[str, fem.Function]:
        return {f"contact_{i}": touch.lam for i, touch in enumerate(self.problem.contact_pairs)}

    def _apart(self, unknowns: FloatArray) -> tuple[fem.Function, list[float]]:
        """Fields and scalars of unknowns as `Newton.unknowns` has them."""
        w = fem.Function(self.problem.W)
        w.x.array[:] = unknowns[: len(w.x.array)]
        return w, [float(value) for value in unknowns[len(w.x.array) :]]

    def _together(self, w: fem.Function, scalars: Sequence[float]) -> FloatArray:
        return np.concatenate([w.x.array, np.array(scalars, dtype=np.float64)])

    # --- the load grows ---

    def _load(self) -> Iterator[State]:
        sizes = self._sizes
        while not sizes.done(self._t) and not self._is_enough():
            t = self._t
            goal = gentle(self.problem, t, sizes.goal(t))
            start = self.newton.unknowns()
            result = self._attempt(t, goal)
            crushed = result.rejected > 0 or "NAN" in result.reason
            fault = self._fault() if result.converged else result.reason
            if fault:
                if fault == ANOTHER:
                    self._fallback = goal, self.newton.unknowns()
                if sizes.failed(t, goal, crushed=crushed and not result.converged):
                    log.info("load factor %.6g: %s; a smaller step", goal, fault)
                    self.ladder.undo(start)
                    continue
                goal, result = self._elsewhere(t, goal, result, fault, start)
            if not fault and self._pace.hasty(t, goal, start, result) and sizes.closer(t, goal):
                log.debug("load factor %.6g: so far in one step; a closer look", goal)
                self.ladder.undo(start)
                continue
            self._watch.accept()
            self._pace.accept(known=not fault)
            self._before = t, start
            sizes.succeeded(t, goal, result.newton)
            if fault:
                sizes.begin_anew()
            self._t = goal
            yield self._state(goal, result, negative_eigenvalues(self.newton))

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
        jumped = self._watch.jumped(self.newton.result.target)
        return ANOTHER if jumped else ""

    def _elsewhere(
        self, t: float, goal: float, result: NewtonResult, fault: str, start: FloatArray
    ) -> tuple[float, NewtonResult]:
        """Goes on where no step is small enough, or gives up.

        Returns:
            The load factor that was reached after all, and how.
        """
        kept = self.newton.unknowns() if result.converged else self.ladder.failed
        stuck = fault == BEYOND or (t == 0.0 and not result.converged)
        if not self.settings.snap or self.problem.linear or stuck:
            raise self._failure(t, goal, result.refused(fault), start, kept)
        if not result.converged or fault == UNSTABLE:
            found = flow_away(self.ladder, settled=result.converged)
            if not found.converged and self._fallback is not None and self._fallback[0] > t:
                goal, there = self._fallback
                self.problem.set_time(goal, default=PROPORTIONAL)
                found = self.ladder.solve([("", there)])
                if found.converged and (negative_eigenvalues(self.newton) or 0) > 0:
                    found = flow_away(self.ladder, settled=True)
            self._watch.look()
            if not found.converged or not self._watch.finite():
                raise self._failure(t, goal, result.refused(fault), start, kept)
            result = found
        self._jumps += fault == ANOTHER
        what = "the body buckles" if fault == UNSTABLE else "the body has snapped"
        log.warning(
            "no stable equilibrium is near beyond load factor %.6g: %s to another one; "
            'statics.method = "arc-length" shows the path between',
            t,
            what,
        )
        return goal, result

    def _is_enough(self) -> bool:
        limit = self.settings.max_displacement
        if limit is not None and self.assembler.max_displacement() >= limit:
            log.info("a displacement has reached %g m: the run ends", limit)
            return True
        if self._count > self.settings.max_steps:
            log.warning("statics.max_steps = %d steps are done: the run ends", self._count - 1)
            return True
        return False

    def _attempt(self, t: float, goal: float) -> NewtonResult:
        """Tries to go to a load factor; the displacement is put back if that fails."""
        self.problem.set_time(goal, default=PROPORTIONAL)
        self.problem.dirichlet.check_finite()
        now = self.newton.unknowns()
        starts = [("", now)]
        if self._before is not None and t > self._before[0]:
            before, was = self._before
            starts.append(("along the path", now + (goal - t) / (t - before) * (now - was)))
        return self.ladder.solve(starts)

    def _failure(
        self,
        t: float,
        goal: float,
        result: NewtonResult,
        good: FloatArray,
        failed: FloatArray | None,
    ) -> ConvergenceError:
        """The error, with why; the problem is left with the last iterate."""
        last = good if failed is None else failed
        self.newton.put_back(last)
        fields = len(self.problem.w.x.array)
        # Beyond a limit point the path is unstable, and so may be the fields beside scalars.
        judged = self.settings.method == "load" and self._scalars.joined is None
        found = diagnose(
            self.assembler, result, good=good[:fields], failed=last[:fields], stable=judged
        )
        force, place = self.assembler.residual.largest()
        return ConvergenceError(
            f"no equilibrium beyond load factor {t:.6g}: {found.text}\n  at the end: "
            f"{result.reason}, Newton iterations: {result.newton}; the largest force out of "
            f"balance, {force:.3g} N, is at {coordinates(place)} m",
            advice=found.advice,
            state=self._state(goal, result),
            diagnosis=found,
        )

    # --- the path grows ---

    def _make_arc(self) -> None:
        statics = self.statics
        self._arc = ArcLength(self.ladder, self._scalars.parts, end=self.settings.end)
        self._arc.prepare(statics.choice, statics.tolerance, statics.petsc)

    def _path(self, arc: ArcLength) -> Iterator[State]:
        if self._t > 0.0 and self._is_enough():
            return
        s = self.settings
        chosen = s.first_step is not None or s.steps is not None
        for found in arc.path(self._sizes.goal(0.0), s.min_step, chosen=chosen):
            self._watch.look()
            result = found.result
            if result.converged and not self._watch.finite():
                result = result.refused(BEYOND)
            if not result.converged:
                good = self.newton.unknowns() if found.good is None else found.good
                raise self._failure(found.t, found.t, result, good, found.failed)
            self._t, self._limits = found.t, tuple(arc.limits)
            yield self._state(found.t, result, found.negative)
            if self._is_enough():
                return

    # --- what is yielded ---

    def _state(self, t: float, result: NewtonResult, negative: int | None = None) -> State:
        problem, assembler = self.problem, self.assembler
        strain = self._watch.strain
        energies = {"strain": strain.energy(), **strain.springs()}
        judged = result.converged or t == 0.0
        self._count += 1
        return State(
            step=self._count - 1,
            t=t,
            load_factor=t,
            u=problem.u,
            w=problem.w,
            newton=result.newton,
            krylov=result.krylov,
            reason=result.reason,
            residuals=result.residuals,
            energies=energies,
            reactions=assembler.reactions.by_support(assembler.residual.owned),
            max_displacement=assembler.max_displacement(),
            negative=negative,
            limit_points=self._limits,
            numbers={**self._measured.numbers(), **self._scalars.numbers()},
            audit=self._auditor.of(t, energies["strain"]) if judged else None,
            done=t / self.settings.end,
        )
