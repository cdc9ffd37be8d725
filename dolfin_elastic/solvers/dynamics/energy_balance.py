"""What a motion has cost: work of loads and supports, damping, and the balance of energy."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import compiled, integral
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.dynamics.work import supports_move

_NAMES = ("external", "damping", "dashpots")

_NOISE = 10.0
"""Round-off of the stored energy over eps mu V: up to 1.8 was found, of laws whose energy is a
difference, such as neo-Hookean and corotated ones."""


class EnergyBalance:
    """Sums up work over the steps of a motion.

    The work of a step is that of the forces in the middle of it over its displacement, of second
    order: those of the stage where that is the middle, and else the mean of those at both ends.
    What the penalties of obstacles store counts as the body's: they do work only where they move.
    Supports that move work against the inertia of what they carry: M dv . (v0 + v1)/2, which is the
    change of its kinetic energy also where they are set going at once, and the force has no end.

    Collective to make.

    Args:
        moving: The body.
        v: Its velocity.

    Attributes:
        scale: The largest energy so far [J].
    """

    def __init__(self, moving: DynamicResidual, v: fem.Function) -> None:
        self._moving, self._velocity = moving, v
        self._leads = supports_move(moving.problem)
        self._v: FloatArray = np.empty(0)
        self._sums = dict.fromkeys(_NAMES, 0.0)
        self._initial: float | None = None
        self.scale = 0.0
        problem = moving.problem
        self._constant = bool(problem.loads) and not problem.loads_change
        self._dead: FloatArray | None = None
        self._places: FloatArray = np.empty(0)
        size = problem.constant(1.0) * problem.weak_form.volume(None, 1)
        volume = integral(problem, compiled(problem, [size])[0])
        self._round_off = _NOISE * np.finfo(float).eps * problem.stiffness * volume

    def begin(self) -> None:
        """Takes in where the obstacles are at the problem's time, and the speed. Not collective."""
        self._places = self._shifts()
        self._v = self._now()

    def add(self, forces: Forces, du: FloatArray) -> None:
        """Adds the work of one step. Collective.

        Args:
            forces: In the middle of it; the problem's time is that of its end.
            du: Change of the displacement, owned entries [m].
        """
        moves = self._moving.moves
        outside = forces.loads + forces.reactions + forces.holding - forces.obstacles
        rows = (outside, forces.damping, -forces.dashpots)
        mine = np.array([np.dot(row[moves], du) for row in rows])
        before, self._places = self._places, self._shifts()
        mine[0] += np.sum(forces.pushes * (self._places - before))
        if self._leads:
            mine[0] += self._carried(forces, du)
        found = total(self._moving.comm, mine)
        for name, value in zip(_NAMES, found, strict=True):
            self._sums[name] += float(value)

    def _carried(self, forces: Forces, du: FloatArray) -> float:
        """What inertia costs supports, in place of its forces over the way, on this rank [J]."""
        a, moves = self._moving.assembler, self._moving.moves
        before, self._v = self._v, self._now()
        change = a.constrained_part(self._moving.momentum(self._v - before))[moves]
        pushed = a.constrained_part(forces.inertia)[moves]
        return float(np.dot(change, (before + self._v) / 2) - np.dot(pushed, du))

    def _now(self) -> FloatArray:
        return self._velocity.x.array[: len(self._moving.moves)].copy()

    def _shifts(self) -> FloatArray:
        """How far the obstacles have moved by now, shape (contacts, dim) [m]."""
        return np.array([touch.shift.value for touch in self._moving.problem.contact_pairs])

    def energies(self, kinetic: float, stored: float) -> dict[str, float]:
        """Work, dissipation, potential and balance [J] by name. Collective.

        Args:
            kinetic: Energy of the present velocity [J].
            stored: Energy of the present displacement, strain and penalties [J]; nan where a law
                has none.
        """
        found = {"external": self._sums["external"]}
        if not self._moving.damping.none:
            found["damping"] = self._sums["damping"]
        if self._moving.problem.dashpots:
            found["dashpots"] = self._sums["dashpots"]
        if self._constant:
            found["potential"] = self._potential()
        if math.isfinite(stored):
            if self._initial is None:
                self._initial = kinetic + stored
            found["balance"] = (
                kinetic + stored - self._initial + self._sums["damping"] - self._sums["external"]
            )
            moved = abs(self._sums["external"]) + self._sums["damping"]
            self.scale = max(self.scale, kinetic, abs(stored), moved)
        return found

    def off(self, energies: Mapping[str, float]) -> float:
        """The balance over the largest energy so far; positive where energy has appeared.

        Damping takes energy; what it should have given has appeared, too.  Round-off is no part of
        it: where hardly anything moves, all energy is. Not collective.
        """
        balance, noise = energies.get("balance", 0.0), self._round_off
        balance = max(balance, -energies.get("damping", 0.0)) if balance >= 0.0 else balance
        if self.scale == 0.0 or abs(balance) <= noise:
            return 0.0
        return (balance - math.copysign(noise, balance)) / self.scale

    def _potential(self) -> float:
        """Of loads that do not change: minus their forces times the displacement [J]."""
        moves = self._moving.moves
        if self._dead is None:
            self._dead = self._moving.assembler.reactions.loads()[moves].copy()
        u = self._moving.problem.w.x.array[moves]
        return -float(total(self._moving.comm, float(np.dot(self._dead, u))))

    # --- restarts ---

    def restart_state(self) -> dict[str, float | None]:
        """See `Restartable`. Not collective."""
        return {**self._sums, "initial": self._initial, "scale": self.scale}

    def restore(self, saved: Mapping[str, float | None]) -> None:
        """See `Restartable`; the problem has the state of that time already. Collective."""
        self.begin()
        self._sums = {name: float(saved[name] or 0.0) for name in _NAMES}
        self._initial, self.scale = saved["initial"], float(saved["scale"] or 0.0)
