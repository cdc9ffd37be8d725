"""Extreme values of a state with their places, for the summary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.parallel import LargestRow, largest_row
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.grid import places_of
from dolfin_elastic.results.recovery.stress import StressRecovery

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_ROUND_OFF = 1e-14
"""Differences of det F that rounding decides; displacements and stresses are never so small but
where there are none."""


@dataclass(frozen=True)
class Extreme:
    """An extreme value and its place.

    Attributes:
        value: In the field's SI unit.
        place: Node or barycentre of a cell [m], reference configuration.
        part: Name of the material region; empty for displacements.
    """

    value: float
    place: tuple[float, ...]
    part: str = ""


class Extremes:
    """Finds the extremes of states.  All of it is collective; the constructor compiles."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.evaluate = Evaluator(problem, ["displacement", "jacobian"])
        self._recovery = StressRecovery(problem)
        self._limited = any(part.law.allowable is not None for part in problem.regions)

    def of(self, state: State) -> dict[str, Extreme]:
        """Name to extreme: the same on all ranks.

        ``von_mises`` and ``displacement`` (largest), ``min_jacobian``, ``max_jacobian``, and where
        a material has an allowable stress the smallest ``safety_factor``.
        """
        values, stress = self.evaluate(state), self._recovery(state)
        J = values["jacobian"][:, 0]
        lengths = np.linalg.norm(values["displacement"], axis=1)
        found = {
            "von_mises": self._at_nodes(stress.rows("von_mises")[:, 0], stress.region),
            "displacement": self._at_nodes(lengths),
            "min_jacobian": self._in_cells(J, sign=-1),
            "max_jacobian": self._in_cells(J),
        }
        if self._limited:
            found["safety_factor"] = self._at_nodes(stress.safety, stress.safety_region, sign=-1)
        return found

    def _in_cells(self, values: AnyArray, *, sign: int = 1) -> Extreme:
        """Of det F, whose difference from 1 counts."""
        mesh = self.evaluate.grid.mesh
        found = self._found(sign * (values - 1.0), lambda cells: _barycentres(mesh, cells))
        if found is None:
            return Extreme(sign * -np.inf, ())
        part = next((p.name for p in self.problem.regions if self._owns(found, p.cells)), "")
        return Extreme(1.0 + sign * found.value, found.place, self._shared(found, part))

    def _at_nodes(
        self, values: AnyArray, regions: IntArray | None = None, *, sign: int = 1
    ) -> Extreme:
        V, dim = self.problem.V, self.problem.body.dim
        found = self._found(sign * values, lambda nodes: places_of(V, nodes)[:, :dim])
        if found is None:
            return Extreme(sign * -np.inf, ())
        region = -1
        if regions is not None and found.rank == self.problem.body.comm.rank:
            region = int(regions[found.row])
        part = self.problem.regions[region].name if region >= 0 else ""
        return Extreme(sign * found.value, found.place, self._shared(found, part))

    def _found(
        self, values: AnyArray, places: Callable[[IntArray], FloatArray]
    ) -> LargestRow | None:
        finite = np.where(np.isfinite(values), values, -np.inf)
        return largest_row(self.problem.body.comm, finite, places, least=_ROUND_OFF)

    def _owns(self, found: LargestRow, rows: AnyArray) -> bool:
        return found.rank == self.problem.body.comm.rank and found.row in rows

    def _shared(self, found: LargestRow, part: str) -> str:
        """What the rank of an extreme knows of it. Collective."""
        return str(self.problem.body.comm.bcast(part, root=found.rank))


def _barycentres(mesh: Mesh, cells: IntArray) -> FloatArray:
    """Means of the corners of cells [m], shape (n, dim)."""
    corners = mesh.geometry.dofmap[cells][:, : mesh.topology.dim + 1]
    return np.asarray(mesh.geometry.x[corners].mean(axis=1)[:, : mesh.geometry.dim])


def extremes(problem: Problem, state: State) -> dict[str, Extreme]:
    """Extremes of one state. Collective.

    Returns:
        See `Extremes.of`.
    """
    return Extremes(problem).of(state)
