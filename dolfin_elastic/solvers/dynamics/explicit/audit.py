"""Audit of explicit motion: balances of forces and moments, energy, det F and strains.

An explicit scheme solves nothing: at each node its mass times acceleration is what the nodal forces
leave, so no residual says how well.  What can be wrong is judged here: forces that do not sum up to
those of loads, supports and inertia, as they must whatever the mesh, see `audit.equilibrium`, and
energy that comes from nowhere, see `StabilityMonitor`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Audit
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.audit.equilibrium import EquilibriumAuditor
from dolfin_elastic.solvers.audit.violations import Violations
from dolfin_elastic.solvers.dynamics.explicit.monitor import StabilityMonitor
from dolfin_elastic.solvers.nonlinear.jacobian import Extreme


class ExplicitAuditor(EquilibriumAuditor):
    """Audits the states of an explicit motion. Collective.

    Args:
        monitor: Judges energy and det F; what speaks against the run is among its violations.
        mass: Lumped mass at every owned entry [kg].

    Attributes:
        initial: Energy that the motion begins with [J]; None before the first state, nan where it
            goes on from a checkpoint without it.
    """

    def __init__(
        self,
        problem: Problem,
        assembler: Assembler,
        monitor: StabilityMonitor,
        mass: FloatArray,
    ) -> None:
        super().__init__(problem, assembler, monitor.watch)
        self._violations, self._strains = monitor.violations, monitor.small
        self._scale = cell_size(problem.body) * float(
            np.sqrt(self._comm.allreduce(float(np.dot(mass, mass))))
        )
        self.initial: float | None = None

    @stage("audit")
    def judge(self, t: float, energies: Mapping[str, float], stable: float) -> Audit:
        """The audit of the present state, whose forces are in the residual. Collective.

        Args:
            t: Time [s].
            energies: Of the state [J].
            stable: The stable step [s]: forces are known to machine precision of 4 m h/stable^2,
                h the size of the cells.
        """
        reasons: Violations = {}
        self._round_off_share = 0.0
        noise = 40 * np.finfo(float).eps * 4 / stable**2 * self._scale
        a = self._assembler
        nodal = a.residual.owned
        reactions = a.constrained_part(nodal)
        # At nodes without a support the scheme has minus inertia and damping for what is left.
        rows = (a.reactions.loads(), a.reactions.restraints(), reactions, nodal - reactions)
        moves, shape = a.displacement_dofs, (-1, self._dim)
        external: list[FloatArray] = [row[moves].reshape(shape) for row in rows]
        u = self._problem.u.x.array[: external[0].size]
        measured = self._balances(external, u, a.residual.tied_nodal, noise, reasons)
        if self.initial is None:
            self.initial = energies["total"]
        stored = energies["total"] - self.initial
        return self._verdict(t, reasons, (*measured, energies["external"], stored))

    def _inside_out(self, low: Extreme, inverted: int | None) -> Violations:
        """The monitor judges it. Not collective."""
        return {}

    def _notes(self) -> tuple[str, ...]:
        lost = self.initial is not None and np.isnan(self.initial)
        more = "energy since the start is not known: the checkpoint does not have it"
        return (*super()._notes(), *([more] if lost else []))

    def _when(self, t: float) -> str:
        return f"t = {t:.6g} s"
