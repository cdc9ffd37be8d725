"""What a static run yields: a `State` for each equilibrium, or the error where there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dolfin_elastic.core.errors import ConvergenceError, FormulaError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.problem import results_of
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import SupportForces
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook, EquilibriumAuditor
from dolfin_elastic.solvers.diagnostics.stability import Verdict
from dolfin_elastic.solvers.messages import in_words
from dolfin_elastic.solvers.nonlinear.convergence import UNSTABLE, NewtonResult
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton

FAR = 3.0
"""Lengths of the body beyond which a prescribed motion is suspected of a missing unit, where no
equilibrium is found: rubber may be stretched that far."""


class StaticStates:
    """Measures and audits the equilibria of one run. Collective to make.

    Args:
        newton: The solver; its problem and its assembler are in the state to be measured.
        end: Load factor at which the run ends.
        seconds: The user speaks of it as a time.

    Attributes:
        count: States made so far, the initial one included.
    """

    def __init__(
        self,
        newton: Newton,
        *,
        book: EnergyBook,
        watch: JacobianWatch,
        end: float,
        seconds: bool,
    ) -> None:
        self._newton, self._book, self._end, self._seconds = newton, book, end, seconds
        self._assembler, self._problem = newton.assembler, newton.assembler.problem
        self._supports = SupportForces(self._assembler)
        self._auditor = EquilibriumAuditor(self._problem, self._assembler, watch)
        self.count = 0

    def _numbers(self) -> dict[str, float]:
        """Results of terms and of a periodic cell by name [SI units]. Collective."""
        a = self._assembler
        result = results_of(self._problem, a.residual.owned[a.displacement_dofs])
        return result if a.cell is None else result | a.cell.numbers()

    def state(
        self,
        t: float,
        result: NewtonResult,
        *,
        verdict: Verdict | None = None,
        limits: tuple[tuple[float, float], ...] = (),
        stored: dict[str, float] | None = None,
    ) -> State:
        """The present state, audited if it is an equilibrium. Collective.

        Args:
            verdict: Whether it is stable; None of the initial state and of what is no equilibrium.
            limits: Load factors, and their errors, at which the path had limit points or was left.
            stored: Its energies by account [J], if they are known.

        Raises:
            InputError: Supports change the volume of a body that cannot change it.
        """
        problem, assembler = self._problem, self._assembler
        energies = self._book.stored() if stored is None else stored
        equilibrium = result.converged or t == 0.0
        self.count += 1
        if equilibrium:
            assembler.check_volumes()
        reactions, moments = self._supports()
        stability = None if verdict is None else verdict.stability
        audit = None
        if equilibrium:
            audit = self._auditor.audit(t, energies["strain"], stability)
        return State(
            step=self.count - 1,
            t=t,
            load_factor=t,
            unit=problem.body.unit,
            u=problem.u,
            w=problem.w,
            newton=result.newton,
            krylov=result.krylov,
            reason=result.reason,
            residuals=result.residuals,
            energies=energies,
            reactions=reactions,
            moments=moments,
            max_displacement=assembler.max_displacement(),
            stability=stability,
            limit_points=tuple(t for t, _ in limits),
            limit_errors=tuple(error for _, error in limits),
            numbers=self._numbers(),
            audit=audit,
            done=t / self._end,
            seconds=self._in_seconds(),
        )

    def _in_seconds(self) -> bool:
        history = self._problem.history
        return self._seconds or (history is not None and history.timed and history.passes)

    def failure(
        self,
        t: float,
        goal: float,
        result: NewtonResult,
        *,
        good: FloatArray,
        failed: FloatArray,
        judge_stability: bool,
    ) -> ConvergenceError:
        """The error with its diagnosis; the problem is left with the last iterate. Collective.

        Args:
            goal: Load factor at which none was found.
            good: The last equilibrium, as `Newton.unknowns`.
            judge_stability: An equilibrium would have to be stable, so a tangent that is not
                positive definite explains the failure.
        """
        from dolfin_elastic.solvers.diagnostics.diagnose import diagnose  # most runs end well

        self._newton.put_back(failed)
        fields = len(self._problem.w.x.array)
        diagnosis = diagnose(
            self._assembler,
            result,
            good=good[:fields],
            failed=failed[:fields],
            judge_stability=judge_stability and self._newton.bordered is None,
        )
        force, place = self._assembler.residual.largest()
        state, suspicion = self.state(goal, result), self._suspicion()
        self._problem.set_time(goal, default=PROPORTIONAL)
        if suspicion:
            diagnosis = replace(diagnosis, advice=f"{suspicion}; else {diagnosis.advice}")
        none = "no stable equilibrium" if result.reason == UNSTABLE else "no equilibrium"
        return ConvergenceError(
            f"{none} beyond load factor {t:.6g}: {diagnosis.text}\n  at the end: "
            f"{in_words(result.reason)}, Newton iterations: {result.newton}; the largest force "
            f"out of balance, {force:.3g} N, is at {self._problem.body.unit.point(place)}",
            advice=diagnosis.advice,
            state=state,
            diagnosis=diagnosis,
        )

    def _suspicion(self) -> str:
        """Whether something is moved by far more than the body is long, in words. Collective.

        By the end of the run, which may be far ahead.  The problem's time is that of the end then.
        """
        problem, longest = self._problem, max(extent(self._problem.body))
        try:
            problem.set_time(self._end, default=PROPORTIONAL)
        except FormulaError:  # of a curve or an angle: on all ranks
            return ""
        targets = np.abs(np.nan_to_num(problem.constraints.targets, posinf=0.0, neginf=0.0))
        moved = {"a support": largest(problem.body.comm, float(np.max(targets, initial=0.0)))}
        for term in problem.terms:
            if term.pose is not None:
                shift = np.abs(np.nan_to_num(term.pose.shift.value, posinf=0.0, neginf=0.0))
                moved[f"the obstacle of '{term.label}'"] = float(np.max(shift))
        what, far = max(moved.items(), key=lambda one: one[1])
        unit = problem.body.unit
        return (
            messages.far_motion(what, *(unit.length(x) for x in (far, longest)))
            if far > FAR * longest
            else ""
        )

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`: number of states and history of the audit. Not collective."""
        return {"count": self.count, "audit": self._auditor.restart_state()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; the problem and the assembler are in the saved state. Collective."""
        self.count = saved["count"]
        self._auditor.restore(saved["audit"])
