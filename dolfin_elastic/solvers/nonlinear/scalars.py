"""Scalar unknowns beside those of terms: free strains of a periodic cell, and uniform pressures.

The uniform pressure is that of an incompressible body whose volume only scalar unknowns can change.
The motion of a rigid surface, or a macroscopic strain, does work against it; free nodes do not.  So
it is one more scalar unknown, whose equation is the volume of the body.  The pressure field is the
deviation from it, with one entry fixed (`assembly.hydrostatic_constant`).
"""

from __future__ import annotations

import numpy as np
import ufl

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.problem.term import OutOfBalance, ScalarUnknowns
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.cell_stress import CellStress
from dolfin_elastic.solvers.assembly.hydrostatic_constant import EnclosedBody

ROUND_OFF = 1e-14
"""Error of the mean stress over the cell's stiffness, of which strains are computed."""


class FreeStrains(ScalarUnknowns):
    """Free components of the macroscopic gradient; their stress is prescribed.

    As unknown each is multiplied by the length of the cell, and its equation V (P - P*) divided by
    it, so that they are a length and a force as those of the nodes are.
    """

    def __init__(self, mean: CellStress) -> None:
        self._mean, self._cell, problem = mean, mean.cell, mean.problem
        self._free, self.size = self._cell.free, len(self._cell.free)
        self.steps = np.full(self.size, 1e-5 * self._cell.length)
        # The residual is the derivative of the energy with respect to them.
        self.signs = np.ones(self.size)
        self.prescribing = np.zeros(self.size, dtype=bool)
        row = ufl.derivative(mean.mean, problem.w, ufl.TestFunction(problem.W))
        self._row = mean.compiled([row])[0]
        self._stiffness = 0.0

    def get(self) -> FloatArray:
        """The free strains times the length of the cell [m]."""
        return self._cell.free_values() * self._cell.length

    def put(self, values: FloatArray) -> None:
        """Sets the free strains."""
        self._cell.set_free(np.asarray(values / self._cell.length, dtype=np.float64))

    @property
    def _area(self) -> float:
        return self._cell.volume / self._cell.length

    def residual(self, forces: OutOfBalance | None = None) -> FloatArray:
        """Stress minus prescribed stress, times the area of a face [N]."""
        gaps = [self._mean.component(*ij) - self._cell.stress[ij] for ij in self._free]
        return self._area * np.array(gaps)

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative with respect to the fields."""
        self._measure_stiffness()
        self._mean.follow()
        result: list[FloatArray] = []
        for ij in self._free:
            self._mean.select(*ij)
            row = assembled(self._row, self._mean.problem.W)
            result.append(np.asarray(row / self._cell.length))
        return result

    def _measure_stiffness(self) -> None:
        """Measures the stiffness of the cell by differences, for the round-off of stresses."""
        values = self.get()
        result = np.zeros(self.size)
        for b, h in enumerate(self.steps):
            sides = []
            for moved in (h, -h):
                self.put(values + moved * (np.arange(self.size) == b))
                sides.append(self.residual()[b])
            result[b] = (sides[0] - sides[1]) / (2 * h)
        self.put(values)
        self._stiffness = float(np.abs(result).max())

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The stresses are as prescribed, to the tolerance of forces or to round-off.

        The force of a face is spread over its nodes, the target is a norm of nodal forces.

        Args:
            residual: Stress minus prescribed stress, times the area of a face [N].
            target: See `ScalarUnknowns`.
        """
        own = target * np.sqrt(self._cell.pairing.face_nodes)
        floor = ROUND_OFF * self._stiffness * self._cell.length
        return bool(np.abs(residual).max() <= max(own, floor))


VOLUME = 1e-12
"""Error of the volume, as a share of it, that is round-off."""


class UniformPressure(ScalarUnknowns):
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
        self._floor = VOLUME * body.volume * problem.thickness
        self._floor *= float(problem.unknowns.scale["pressure"].value)

    def get(self) -> FloatArray:
        """The pressure, scaled [m]."""
        return np.array([self._value])

    def put(self, values: FloatArray) -> None:
        """Sets it."""
        self._value = float(values[0])
        self._assembler.origin[self._body.dofs] = self._value

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """Minus the change of volume, which the pressure multiplies, scaled [N]. Collective."""
        rows = forces.owned[self._body.dofs]
        return np.array([-total(self._assembler.comm, float(rows.sum()))])

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative. Collective."""
        return [-forces.along(self._body.dofs, np.ones(len(self._body.dofs)))]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The volume is that of the body."""
        return bool(abs(residual[0]) <= max(target, self._floor))
