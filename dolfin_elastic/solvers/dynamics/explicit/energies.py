"""Energies and momenta of a body that moves with lumped mass, and whether they have a value."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.energy_momentum import LumpedMass, Strain
from dolfin_elastic.solvers.dynamics.work import ExternalWork
from dolfin_elastic.solvers.nonlinear.contact import Measured

Measures = tuple[dict[str, float], dict[str, FloatArray]]
"""Energies [J], and momenta, by name."""


class Energies:
    """What a state of explicit motion has of them. Collective to make.

    Args:
        problem: What moves.
        v: Velocity.
        mass: Lumped mass at every owned entry [kg].
        work: Of loads and supports.
    """

    def __init__(
        self, problem: Problem, v: fem.Function, mass: FloatArray, work: ExternalWork
    ) -> None:
        self._comm, self._work = problem.body.comm, work
        self._strain, self._contacts = Strain(problem), Measured(problem, moving=True)
        self._inertia = LumpedMass(problem, v, mass)

    @np.errstate(all="ignore")  # whether they are finite is asked afterwards
    def take(self) -> Measures:
        """Those of the present place and velocity. Collective."""
        kinetic, linear, angular = self._inertia.measure()
        strain, more = self._strain.energy(), self._contacts.energies()
        energies = {
            "strain": strain,
            "kinetic": kinetic,
            "total": strain + kinetic + sum(more.values()),
            "external": self._work.close(),
            **self._strain.springs(),
            **more,
        }
        return energies, {"linear": linear, "angular": angular}

    def finite(self, energies: Mapping[str, float], forces: FloatArray) -> bool:
        """Whether all of them have a value, but those that a law does not know. Collective.

        Args:
            energies: From `take`.
            forces: At owned entries [N].
        """
        unknown = ("strain", "total") if self._strain.none else ()
        known = [energy for name, energy in energies.items() if name not in unknown]
        bad = not (np.isfinite(known).all() and np.isfinite(forces).all())
        return largest(self._comm, float(bad)) == 0.0

    def numbers(self) -> dict[str, float]:
        """Of contacts. Collective."""
        return self._contacts.numbers()
