"""Macroscopic strains of a periodic cell that are unknown, and the stresses prescribed for them."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.cell_stress import CellStress

ROUND_OFF = 1e-14
"""Error of the mean stress over the cell's stiffness, of which strains are computed."""


class FreeStrains:
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

    def residual(self) -> FloatArray:
        """Stress minus prescribed stress, times the area of a face [N]."""
        gaps = [self._mean.component(*ij) - self._cell.stress[ij] for ij in self._free]
        return self._area * np.array(gaps)

    def rows(self) -> list[FloatArray]:
        """Its derivative with respect to the fields."""
        self._measure_stiffness()
        found, dofmap = [], self._mean.problem.W.dofmap
        size = dofmap.index_map.size_local * dofmap.index_map_bs
        for ij in self._free:
            self._mean.select(*ij)
            row = la.vector(dofmap.index_map, dofmap.index_map_bs)
            fem.assemble_vector(row.array, self._row)
            row.scatter_reverse(la.InsertMode.add)
            found.append(row.array[:size] / self._cell.length)
        return found

    def _measure_stiffness(self) -> None:
        """Measures the stiffness of the cell by differences, for the round-off of stresses."""
        values = self.get()
        found = np.zeros(self.size)
        for b, h in enumerate(self.steps):
            sides = []
            for moved in (h, -h):
                self.put(values + moved * (np.arange(self.size) == b))
                sides.append(self.residual()[b])
            found[b] = (sides[0] - sides[1]) / (2 * h)
        self.put(values)
        self._stiffness = float(np.abs(found).max())

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


def free_strains(mean: CellStress | None) -> FreeStrains | None:
    """The components of the gradient that are unknown, if there are any. Collective."""
    return None if mean is None or not mean.cell.free else FreeStrains(mean)
