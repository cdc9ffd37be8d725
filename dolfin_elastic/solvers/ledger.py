"""What a motion has cost: work of loads and supports, damping, and the balance of energy."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from dolfin_elastic.parallel import total
from dolfin_elastic.solvers.jump import round_off
from dolfin_elastic.solvers.moving import Forces, Moving

Vector = npt.NDArray[np.float64]

_NAMES = ("external", "damping", "dashpots")


class Ledger:
    """Sums up work over the steps of a motion.

    The work of a step is that of the forces in the middle of it over its displacement, of second
    order: those of the stage where that is the middle, and else the mean of those at both ends.

    Args:
        moving: The body.
    """

    def __init__(self, moving: Moving) -> None:
        self._moving = moving
        self._sums = dict.fromkeys(_NAMES, 0.0)
        self._initial: float | None = None
        self._scale = 0.0
        problem = moving.problem
        self._constant = bool(problem.loads) and not problem.loads_change
        self._dead: Vector | None = None

    def add(self, forces: Forces, du: Vector) -> None:
        """Adds the work of one step. Collective.

        Args:
            forces: In the middle of it.
            du: Change of the displacement, owned entries [m].
        """
        moves = self._moving.moves
        outside = forces.loads + forces.reactions + forces.holding
        rows = (outside, forces.damping, -forces.dashpots)
        found = total(self._moving.comm, np.array([np.dot(row[moves], du) for row in rows]))
        for name, value in zip(_NAMES, found, strict=True):
            self._sums[name] += float(value)

    def energies(self, kinetic: float, strain: float) -> dict[str, float]:
        """Work, dissipation, potential and balance [J] by name. Collective.

        Args:
            kinetic: Energy of the present velocity [J].
            strain: Energy of the present displacement [J]; nan where a law has none.
        """
        found = {"external": self._sums["external"]}
        if not self._moving.damping.none:
            found["damping"] = self._sums["damping"]
        if self._moving.problem.dashpots:
            found["dashpots"] = self._sums["dashpots"]
        if self._constant:
            found["potential"] = self._potential()
        if math.isfinite(strain):
            if self._initial is None:
                self._initial = kinetic + strain
            found["balance"] = (
                kinetic + strain - self._initial + self._sums["damping"] - self._sums["external"]
            )
            moved = abs(self._sums["external"]) + self._sums["damping"]
            self._scale = max(self._scale, kinetic, abs(strain), moved)
        return found

    def off(self, energies: Mapping[str, float]) -> float:
        """The balance over the largest energy so far; positive where energy has appeared.

        Damping takes energy; what it should have given has appeared, too.  Round-off is no part of
        it: where hardly anything moves, all energy is. Collective.
        """
        balance, noise = energies.get("balance", 0.0), round_off(self._moving.assembler)[1]
        balance = max(balance, -energies.get("damping", 0.0)) if balance >= 0.0 else balance
        if self._scale == 0.0 or abs(balance) <= noise:
            return 0.0
        return (balance - math.copysign(noise, balance)) / self._scale

    def _potential(self) -> float:
        """Of loads that do not change: minus their forces times the displacement [J]."""
        moves = self._moving.moves
        if self._dead is None:
            self._dead = self._moving.assembler.external_forces()[moves].copy()
        u = self._moving.problem.w.x.array[moves]
        return -float(total(self._moving.comm, float(np.dot(self._dead, u))))

    # --- restarts ---

    def kept(self) -> dict[str, float | None]:
        """All that it has to know later on."""
        return {**self._sums, "initial": self._initial, "scale": self._scale}

    def restore(self, numbers: Mapping[str, float | None]) -> None:
        """Goes on from there."""
        self._sums = {name: float(numbers[name] or 0.0) for name in _NAMES}
        self._initial, self._scale = numbers["initial"], float(numbers["scale"] or 0.0)
