"""Damping of central differences: forces -a m v, and bulk viscosity.

With h = dt/2, v_n = (v- + h f_n/m)/(1 + a h) is the velocity at the forces f_n, damped by -a v_n:

    v+ = (1 - a h) v_n + h f_n/m = ((1 - a h) v- + dt f_n/m)/(1 + a h),

of second order, and stable for dt < 2/omega whatever a is.  Bulk viscosity sees the velocity half a
step before, as dashpots do, which shortens the stable step, see `StepSize.step_for`.

What is lost in a step is the work of both forces by the trapezoidal rule, which is what the scheme
loses: U + m v- . v+ / 2 changes by just that in linear bodies.

Source: T. Belytschko, W. K. Liu, B. Moran, K. Elkhodary, Nonlinear Finite Elements for Continua and
Structures, 2nd ed., Wiley 2014, section 6.2.
"""

from __future__ import annotations

import numpy as np
from dolfinx import la

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.bulk_viscosity import BulkViscosity
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.nodal_forces import Forces


def sees_velocity(damper: Damper | None) -> bool:
    """Whether forces depend on the velocity that dashpots see, beside those of dashpots."""
    return damper is not None and damper.viscous


class Damper:
    """Damping of a body in explicit motion. Collective to make.

    Args:
        mass: Lumped mass at every owned entry [kg].
        rate: a of the module [1/s].
        bulk: None without bulk viscosity.

    Attributes:
        local: Work that it has done against this rank's nodes since `take`, of all damping and of
            bulk viscosity [J].
    """

    def __init__(
        self,
        problem: Problem,
        assembler: Assembler,
        mass: FloatArray,
        *,
        rate: float,
        bulk: BulkViscosity | None,
    ) -> None:
        self.rate, self._problem, self._assembler = rate, problem, assembler
        self.local: FloatArray = np.zeros(2)
        self._drag, self._mass = rate * mass, mass
        self._drag[problem.constraints.prescribed_dofs] = 0.0  # what moves there is prescribed
        self._forces: Forces | None = None
        if bulk is not None:
            dofmap = problem.V.dofmap
            vector = la.vector(dofmap.index_map, dofmap.index_map_bs)
            self._forces = Forces(problem, bulk.work(), vector)
            self._bound = compiled(problem, [bulk.bound()])[0]
        self._before: FloatArray = np.zeros((1 + self.viscous, len(mass)))

    @property
    def viscous(self) -> bool:
        """There is bulk viscosity."""
        return self._forces is not None

    def largest_rate(self) -> float:
        """A bound of c/m of bulk viscosity at the present velocity [1/s]. Collective."""
        if self._forces is None:
            return 0.0
        rows = self._assembler.reactions.nodal(self._bound) / self._mass
        return largest(self._problem.body.comm, float(np.max(rows, initial=0.0)))

    def at_forces(self, v: FloatArray, acceleration: FloatArray, remaining: float) -> FloatArray:
        """The velocity at the time of the forces [m/s].

        Args:
            v: The velocity before [m/s].
            acceleration: Of all forces but a m v [m/s^2].
            remaining: From the time of v to that of the forces [s].
        """
        return np.asarray((v + remaining * acceleration) / (1 + self.rate * remaining))

    def add_to(self, forces: FloatArray) -> None:
        """Adds the forces of bulk viscosity to those out of balance, owned entries. Collective."""
        if self._forces is not None:
            forces += self._forces.assemble()

    def begin(self, v: FloatArray) -> None:
        """What is lost is summed up from here.

        Args:
            v: The velocity at the time of the forces, which are there already [m/s].
        """
        self._before = self._now(v)

    def step(self, v: FloatArray, du: FloatArray) -> None:
        """Sums up a step that has led to the present state.

        Args:
            v: See `begin`.
            du: Change of the displacement, owned entries [m].
        """
        before, self._before = self._before, self._now(v)
        work = (before + self._before) @ du / 2
        self.local[: len(work)] += work

    def _now(self, v: FloatArray) -> FloatArray:
        """Forces of all damping, and of bulk viscosity if there is any, each a row [N]."""
        drag: FloatArray = self._drag * v
        if self._forces is None:
            return drag[None]
        bulk = self._forces.owned
        return np.stack([drag + bulk, bulk])

    def take(self) -> FloatArray:
        """`local`, which begins anew [J]."""
        local, self.local = self.local, np.zeros(2)
        return local
