"""Audit of motion: balances of linear and angular momentum, and of energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Audit
from dolfin_elastic.problem.term_list import conserve_in_steps
from dolfin_elastic.solvers.audit.equilibrium import EquilibriumAuditor, no_balance, round_off
from dolfin_elastic.solvers.audit.violations import FAILING_GAIN, Violation, Violations, restored
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.dynamics.rotation_error import RotationError
from dolfin_elastic.solvers.dynamics.work import EnergyBalance
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

TURN = 1.2
"""Movement within a step over the largest displacement so far that is too much."""

SHARE = 0.2
"""Share of the steps so far that may turn round: after a hit, a few do."""

LEAST = 2
"""So many may in any case."""


class TimeResolution:
    """Counts the steps within which the body turns round.

    The trapezoidal rule turns a mode of angular frequency w by the angle 2 atan(w h/2) a step h,
    and its displacement changes by at most 2 sin(atan(w h/2)) times its amplitude. That is 1.2
    where about four steps make a period, which is then a seventh too long, while the energy is
    conserved whatever the step. A body that starts from rest, or is carried along, never moves
    within a step by more than it has moved so far.

    Source: T. J. R. Hughes, The Finite Element Method (2000), section 9.3.

    Args:
        alpha_f: Share of the old displacement in that of a step's stage.
    """

    def __init__(self, problem: Problem, alpha_f: float) -> None:
        self._comm, self._dim, self._alpha = problem.body.comm, problem.body.dim, alpha_f
        self._steps = self._turned = 0
        self._farthest = self._worst = 0.0

    def add_step(self, u: FloatArray, du: FloatArray) -> None:
        """Compares a step with the largest displacement so far. Collective.

        Args:
            u: Displacement of the step's stage, owned entries [m].
            du: Its change in the step, owned entries [m].
        """
        end = u + self._alpha * du
        lengths = [self._longest(part) for part in (end, end - du, du)]
        self._farthest = max(self._farthest, *lengths[:2])
        self._steps += 1
        if self._farthest > 0.0 and lengths[2] > TURN * self._farthest:
            self._turned += 1
            self._worst = max(self._worst, lengths[2] / self._farthest)

    def _longest(self, entries: FloatArray) -> float:
        rows = np.linalg.norm(entries.reshape(-1, self._dim), axis=1)
        return largest(self._comm, float(rows.max(initial=0.0)))

    def violation(self) -> Violation | None:
        """The warning, if too many steps have turned round. Not collective."""
        if self._turned <= max(LEAST, SHARE * self._steps):
            return None
        return Violation(
            f"the body moves within one step by {self._worst:.3g} times its largest displacement "
            "so far: hardly four steps make a period of this motion, whose time is wrong by a "
            "seventh and more; a smaller dt",
            self._worst,
        )

    # --- restarts ---

    def restart_state(self) -> list[float]:
        """See `Restartable`. Not collective."""
        return [self._steps, self._turned, self._farthest, self._worst]

    def restore(self, saved: list[float]) -> None:
        """See `Restartable`. Not collective."""
        self._steps, self._turned = int(saved[0]), int(saved[1])
        self._farthest, self._worst = float(saved[2]), float(saved[3])


MAX_ENERGY_GAIN = 0.02
"""Gain of energy over the largest energy up to which there is no warning: the schemes conserve the
energy of a nonlinear body to second order in the step only."""

MAX_ENERGY_LOSS = 0.1
"""Loss of energy by the scheme, over the largest energy, up to which there is no warning."""

CONSERVING = 'scheme = "energy-momentum", which conserves the energy'
"""What is to be tried where a scheme makes energy."""

GROWTH = 2.0
"""Growth of the largest energy from one state to the next above which the energy is not judged.

The motion or a support has just begun to move.  The work of a support follows its velocity by one
step, so that all of the energy may be out of balance."""

CERTAIN_SHARE = 0.5
"""Imbalance over the largest energy that is judged even while the energy grows so fast."""


class MotionAuditor(EquilibriumAuditor):
    """Audits the steps of an implicit motion. Collective.

    Args:
        parameters: Of the scheme: what it is meant to damp.
        end: When the motion ends [s].
    """

    def __init__(
        self,
        problem: Problem,
        moving: DynamicResidual,
        watch: JacobianWatch,
        parameters: GeneralizedAlphaParameters,
        *,
        end: float,
    ) -> None:
        super().__init__(problem, moving.assembler, watch)
        self._moving, self._parameters, self._end = moving, parameters, end
        self._rotation = RotationError(problem, 0.0 if moving.conserves else parameters.alpha_f)
        self._resolution = TimeResolution(problem, parameters.alpha_f)
        self._du: FloatArray | None = None  # of the last step
        self._unbalanced = False
        self._worst = [0.0, 0.0]
        self._reasons: Violations = {}
        self._last_imbalance = self._scale = 0.0

    def add_step(self, forces: Forces, du: FloatArray) -> None:
        """Checks the balance of forces and moments of a step. Collective.

        Args:
            forces: Of its stage, at the displacement of the stage.
            du: Change of the displacement, owned entries [m].
        """
        self._du = du
        self._resolution.add_step(forces.u, du)
        noise, _ = round_off(self._assembler)
        rows = (forces.loads, forces.reactions, forces.restraints, -forces.inertia, -forces.drag)
        moves = self._moving.displacement_dofs
        external: list[FloatArray] = [row[moves].reshape(-1, self._dim) for row in rows]
        balances = self._balances(external, forces.u, forces.ties, noise, self._reasons)
        self._worst = [max(pair) for pair in zip(self._worst, balances, strict=True)]

    @stage("audit")
    def judge(self, t: float, balance: EnergyBalance, energies: Mapping[str, float]) -> Audit:
        """The audit of all steps since the last audit. Collective.

        Args:
            t: Time [s].
            energies: Of the state [J].
        """
        reasons = dict(self._reasons)
        if not no_balance(self._problem):
            off = balance.relative_imbalance(energies)
            reasons.update(self._persistent(self._energy(off), off, balance.scale, t))
        if self._du is not None and (rotated := self._rotation.violation(self._du)) is not None:
            reasons["chords"] = rotated
        self._unbalanced = self._unbalanced or "energy" in reasons
        turned = self._resolution.violation()
        if turned is not None and self._is_last(t) and not self._unbalanced:
            reasons["resolution"] = turned  # else the energy has told the same
        force, moment = self._worst
        if self._moment_frame == "none":  # not judged, as in statics
            moment = np.nan
        self._reasons, self._worst = {}, [0.0, 0.0]
        work, energy = energies["external"], energies["total"]
        return self._verdict(t, reasons, (force, moment, work, energy))

    def _persistent(self, reasons: Violations, off: float, scale: float, t: float) -> Violations:
        """Reasons that hold in two successive states, or in the last one.

        While the energy still grows fast they count only if most of it is out of balance: then the
        imbalance is why it grows.

        Args:
            off: Energy out of balance over the largest energy.
            scale: The largest energy so far [J].
            t: Time [s].
        """
        before, settled = self._last_imbalance, scale <= GROWTH * self._scale
        self._last_imbalance, self._scale = abs(off) if reasons else 0.0, scale
        last = self._is_last(t)
        again = before > 0.0 and (settled or min(before, self._last_imbalance) > CERTAIN_SHARE)
        return reasons if last or again else {}

    def _energy(self, off: float) -> Violations:
        if off > MAX_ENERGY_GAIN:
            parameters, other = self._parameters, ""
            if conserve_in_steps(self._problem.terms):
                other = "" if parameters.midpoint else f", or for contact {CONSERVING},"
            elif self._problem.terms.dissipates and (parameters.spectral_radius or 0.0) > 0.5:
                other = ", or where surfaces slide spectral_radius = 0.5,"
            what = (
                f"{100 * off:.3g} % of the energy has come from nowhere: a smaller dt{other} is "
                "needed"
            )
            return {"energy": Violation(what, off, fails=off > FAILING_GAIN)}
        if off < -MAX_ENERGY_LOSS and not self._parameters.damps:
            radius = ", or a larger spectral_radius," if self._parameters.can_damp_less else ""
            what = (
                f"the scheme has damped {-100 * off:.3g} % of the energy away: a smaller dt"
                f"{radius} keeps it"
            )
            return {"energy": Violation(what, -off)}
        return {}

    def _is_last(self, t: float) -> bool:
        return t >= self._end * (1 - 1e-9)

    def _when(self, t: float) -> str:
        return f"t = {t:.6g} s"

    # --- restarts: keys are those of checkpoint format 3 ---

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`. Not collective."""
        return {
            "warned": self._violations.restart_state(),
            "worst": self._worst,
            "reasons": {check: asdict(violation) for check, violation in self._reasons.items()},
            "far": self._strains.note,
            "off": self._last_imbalance,
            "scale": self._scale,
            "chords": self._rotation.restart_state(),
            "resolution": self._resolution.restart_state(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self._violations.restore(saved["warned"])
        self._reasons = {
            check: restored(violation) for check, violation in saved["reasons"].items()
        }
        self._worst = [float(value) for value in saved["worst"]]
        self._strains.restore(str(saved.get("far", "")))
        self._last_imbalance, self._scale = float(saved["off"]), float(saved["scale"])
        self._rotation.restore(saved["chords"])
        if "resolution" in saved:
            self._resolution.restore(saved["resolution"])
