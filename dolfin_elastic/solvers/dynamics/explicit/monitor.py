"""Checks of explicit motion, which solves no equations that might fail: det F and energy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.audit.violations import FAILING_GAIN, Violation, WorstViolations
from dolfin_elastic.solvers.diagnostics.evidence import Cells, blind_to_inversion
from dolfin_elastic.solvers.messages import (
    MIRRORED,
    SEES_INVERSION,
    load_not_finite,
)
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch, SmallStrains

DRIFT = 0.1
"""Share of the largest energy so far by which the conserved energy may drift."""

DRIFTS = (
    "more than a tenth of the energy has come from nowhere, or got lost: the step is too long for "
    "what happens; try a smaller dt or safety"
)

RESISTS = "smaller loads, or a law that resists, such as neo-hookean"


class StabilityMonitor:
    """Checks the states of an explicit motion, and warns once of each fault. Collective to make.

    Attributes:
        watch: Of det F.
        small: Of the size of strains, which the audit checks.
        nonlinear: Some law is nonlinear, so that det F means something.
        violations: What speaks against the run.
        inverted: The warning of cells inside out; empty before.
        place: Where det F was smallest then, undeformed [m].
    """

    def __init__(self, problem: Problem, assembler: Assembler) -> None:
        self._problem, self._assembler = problem, assembler
        self.watch = JacobianWatch(problem)
        self.small = SmallStrains(problem, self.watch)
        self.nonlinear = any(not part.law.linear for part in problem.regions)
        self.inverted = ""
        self.place: tuple[float, ...] = ()
        self._first: FloatArray | None = None
        self._start, self._largest_energy = 0.0, 0.0
        self.violations = WorstViolations()

    @property
    def failure(self) -> str:
        """See `State`."""
        return self.violations.texts()[0] if self.violations.verdict() == "fail" else ""

    def observe(self, t: float) -> None:
        """Checks det F. Collective.

        Laws without a barrier have finite forces in inverted cells.  For linear laws det F has no
        meaning: the audit checks their strains.

        Args:
            t: Time [s].
        """
        if self.inverted or not self.nonlinear:
            return
        J, place = self.watch.smallest()
        if J > 0.0:
            return
        self.place = tuple(float(x) for x in place[: self._problem.body.dim])
        what = f"det F = {J:.3g} at {self._problem.body.unit.point(self.place)}"
        self.inverted = f"elements had turned inside out by t = {t:.6g} s, {what}"
        blind = blind_to_inversion(self._problem, Cells(self._assembler).worst())
        text = f"{self.inverted}: the law permits it, but no body does so: {RESISTS}"
        if blind:
            text = f"{self.inverted}: {MIRRORED}; {SEES_INVERSION}"
        violation = Violation(text, -J, fails=blind)
        self.violations.add({"inverted": violation}, f"t = {t:.6g} s")

    def drifts(self, energies: Mapping[str, float], conserved_excess: float, t: float) -> bool:
        """Whether energy may have appeared or been lost; warns if it certainly has. Collective.

        The energy of the states oscillates even at stable steps; the energy that the scheme
        conserves (see `ExplicitScheme.conserved_excess`) does not, so only its drift is reported.
        A drift of either makes `StepSize` solve the eigenvalue problem again: an unstable linear
        mode grows at constant conserved energy.

        Args:
            energies: Of the state [J].
            conserved_excess: Conserved energy less that of the state, on this rank [J].
            t: Time [s].
        """
        if self._problem.eigenstrains:  # what grows or is heated stores energy without work
            return False
        lost = energies.get("friction", 0.0) + energies.get("damping", 0.0)
        gained = energies["total"] + lost - energies["external"]
        now = np.array([gained, gained + total(self._problem.body.comm, conserved_excess)])
        if self._first is None:
            self._first, self._start = now, float(now[1])
        sizes = (energies["kinetic"], energies["strain"], abs(energies["external"]))
        self._largest_energy = max(self._largest_energy, *sizes)
        self._judge(float(now[1]) - self._start, t)
        seems, drifts = np.abs(now - self._first) > DRIFT * self._largest_energy
        if seems or drifts:
            self._first = np.where([seems, drifts], now, self._first)  # each drift counts once
            self.observe(t)  # inverted cells explain the drift
        if drifts and not self.inverted and "energy" not in self.violations.worst:
            off = abs(float(now[1]) - self._start) / self._largest_energy
            self.violations.add({"drift": Violation(DRIFTS, off)}, f"t = {t:.6g} s")
        return bool(seems or drifts)

    def _judge(self, gain: float, t: float) -> None:
        """Whether so much energy has come from nowhere that the motion is not to be relied on.

        Args:
            gain: Of the conserved energy since the start [J].
            t: Time [s].
        """
        if np.isnan(gain) or gain <= FAILING_GAIN * self._largest_energy:
            return  # a law without an energy has no balance of it
        share = gain / self._largest_energy
        what = f"{100 * share:.3g} % of the energy has come from nowhere: a smaller dt or safety"
        self.violations.add({"energy": Violation(what, share, fails=True)}, f"t = {t:.6g} s")

    def loads_changed(self, excess: float) -> None:
        """Takes in what a program's change of the loads does to the conserved energy. Collective.

        Args:
            excess: Change of `ExplicitScheme.conserved_excess`, on this rank [J].
        """
        change = total(self._problem.body.comm, excess)
        self._start += change
        if self._first is not None:
            self._first = self._first + np.array([0.0, change])

    def check_input(self, t: float) -> None:
        """Refuses supports and loads without finite values. Collective.

        Args:
            t: Time, for the message [s].

        Raises:
            InputError: A prescribed displacement or a load is not finite.
        """
        problem, u = self._problem, self._problem.u.x.array
        problem.constraints.check_finite()
        displacement = u.copy()
        u[:] = 0.0  # loads that follow the body are not finite where it is not
        forces = self._assembler.reactions.loads()
        u[:] = displacement
        if total(problem.body.comm, int(np.sum(~np.isfinite(forces)))):
            raise load_not_finite(problem, t)

    # --- restarts: keys are those of checkpoint format 3 ---

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`. Not collective."""
        return {
            "far": self.small.note,
            "inside_out": self.inverted,
            "place": list(self.place),
            "first": [] if self._first is None else self._first.tolist(),
            "most": self._largest_energy,
            "start": self._start,
            "violations": self.violations.restart_state(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self.small.restore(saved["far"])
        self.inverted = saved["inside_out"]
        self.place = tuple(saved["place"])
        self._largest_energy = saved["most"]
        first = saved["first"]
        self._first = np.array(first) if first else None
        self._start = float(saved.get("start", first[1] if first else 0.0))
        self.violations.restore(saved.get("violations", {}))
