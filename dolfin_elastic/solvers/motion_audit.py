"""Audit of motion: forces from outside change the momenta, and energy has a source."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.audit import Auditor, in_words
from dolfin_elastic.solvers.inversion import JacobianWatch
from dolfin_elastic.solvers.jump import round_off
from dolfin_elastic.solvers.moving import Forces, Moving
from dolfin_elastic.state import Audit

Floats = npt.NDArray[np.float64]

GAINED = 0.02
"""Share of the largest energy that may appear from nowhere: the schemes keep the energy of a
nonlinear body to the second order of the step only."""

LOST = 0.1
"""Share of the largest energy that a scheme may damp away before it is said."""


class MotionAuditor(Auditor):
    """Judges one step of a motion after another. Collective.

    Args:
        problem: What moves.
        moving: Its forces.
        watch: Of det F.
        damps: The scheme is meant to damp.
    """

    def __init__(
        self, problem: Problem, moving: Moving, watch: JacobianWatch, *, damps: bool
    ) -> None:
        super().__init__(problem, moving.assembler, watch)
        self._moving, self._damps = moving, damps
        self._forces: Forces | None = None
        self._worst = [0.0, 0.0]
        self._reasons: dict[str, str] = {}

    def look(self, forces: Forces) -> None:
        """Takes in the forces of a step's stage, at the places of the stage. Collective."""
        self._forces = forces
        noise, _ = round_off(self._assembler)
        outside = self._outside()
        found = (
            self._sum(outside, noise, self._reasons),
            self._moment(outside, noise, self._reasons),
        )
        self._worst = [max(pair) for pair in zip(self._worst, found, strict=True)]

    def _outside(self) -> list[Floats]:
        assert self._forces is not None
        f, moves = self._forces, self._moving.moves
        rows = [f.loads, f.reactions, f.holding, -f.inertia, -f.drag]
        return [row[moves].reshape(-1, self._dim) for row in rows]

    def _moved(self) -> Floats:
        assert self._forces is not None
        return self._forces.u

    def judge(self, t: float, off: float, energies: Mapping[str, float]) -> Audit:
        """The audit of all steps since the last one. Collective.

        Args:
            t: Time [s].
            off: Energy that came from nowhere, over the largest energy.
            energies: Of the state [J].
        """
        reasons = dict(self._reasons)
        low, high = self._watch.extremes()
        if not low[0] > 0.0:
            reasons["jacobian"] = (
                f"a cell is inside out: det F = {low[0]:.3g} at {in_words(low[1])} m"
            )
        stabilised = self._problem.unknowns.stabilised
        if not (stabilised or self._problem.rest):
            reasons.update(self._energy(off))
        self._warn(t, reasons)
        force, moment = self._worst
        self._reasons, self._worst = {}, [0.0, 0.0]
        strain = energies["strain"]
        return Audit(
            force=force,
            moment=moment,
            work=energies["external"],
            energy=strain + energies["kinetic"],
            min_jacobian=low[0],
            max_jacobian=high[0],
            min_place=tuple(float(x) for x in low[1][: self._dim]),
            max_place=tuple(float(x) for x in high[1][: self._dim]),
            verdict="warn" if reasons else "pass",
            reasons=tuple(reasons.values()),
            so_far=tuple(self._warned.values()),
            notes=self._notes(strain),
        )

    def _energy(self, off: float) -> dict[str, str]:
        if off > GAINED:
            what = f"{100 * off:.2g} % of the energy have come from nowhere: a smaller dt is needed"
            return {"energy": what}
        if off < -LOST and not self._damps:
            what = (
                f"the scheme has damped {-100 * off:.2g} % of the energy away: a smaller dt, or a "
                "larger spectral_radius, keeps it"
            )
            return {"energy": what}
        return {}

    def _when(self, t: float) -> str:
        return f"t = {t:.6g} s"

    # --- restarts ---

    def kept(self) -> dict[str, Any]:
        """All that it has to know later on."""
        return {"warned": dict(self._warned), "worst": self._worst, "reasons": dict(self._reasons)}

    def restore(self, numbers: Mapping[str, Any]) -> None:
        """Goes on from there."""
        self._warned, self._reasons = dict(numbers["warned"]), dict(numbers["reasons"])
        self._worst = [float(value) for value in numbers["worst"]]
