"""The uniform pressure of an incompressible body whose volume only scalar unknowns can change.

The motion of a rigid surface, or a macroscopic strain, does work against this pressure; free nodes
do not.  So it is one more scalar unknown, whose equation is the volume of the body.  The pressure
field is the deviation from it, with one entry fixed (`assembly.hydrostatic_constant`).
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.hydrostatic_constant import EnclosedBody

VOLUME = 1e-12
"""Error of the volume, as a share of it, that is round-off."""


class UniformPressure:
    """The uniform pressure of one body; as unknown it is scaled as the pressures in the fields.

    Collective to make.
    """

    size = 1

    def __init__(self, assembler: Assembler, body: EnclosedBody) -> None:
        self._assembler, self._body, problem = assembler, body, assembler.problem
        self._value = 0.0
        # The residual is linear in it.
        self.steps, self.signs = np.array([cell_size(problem.body)]), np.array([-1.0])
        self.prescribing = np.zeros(1, dtype=bool)
        along = fem.Function(problem.W)
        along.x.array[body.dofs] = 1.0
        along.x.scatter_forward()
        works = ufl.derivative(
            ufl.action(problem.weak_form.residual, along), problem.w, ufl.TestFunction(problem.W)
        )
        self._work = compiled(problem, [works])[0]
        self._floor = VOLUME * body.volume * problem.thickness
        self._floor *= float(problem.unknowns.scale["pressure"].value)

    def get(self) -> FloatArray:
        """The pressure, scaled [m]."""
        return np.array([self._value])

    def put(self, values: FloatArray) -> None:
        """Sets it."""
        self._value = float(values[0])
        self._assembler.origin[self._body.dofs] = self._value

    def residual(self) -> FloatArray:
        """Minus the change of volume, which the pressure multiplies, scaled [N]. Collective."""
        rows = self._assembler.residual.owned[self._body.dofs]
        return np.array([-total(self._assembler.comm, float(rows.sum()))])

    def rows(self) -> list[FloatArray]:
        """Its derivative. Collective."""
        return [-self._assembler.reactions.nodal(self._work)]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The volume is that of the body.

        Args:
            target: See `ScalarUnknowns`.
        """
        return bool(abs(residual[0]) <= max(target, self._floor))
