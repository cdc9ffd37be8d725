"""Extreme values of a state with their places, for the summary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx.mesh import Mesh

from dolfin_elastic.core.types import AnyArray, IntArray
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.grid import place_of
from dolfin_elastic.results.recovery.stress import StressRecovery

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem


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
    """Finds the extremes of states.  All of it is collective; the constructor compiles.

    Args:
        problem: The problem that is solved.
    """

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
        cell, value = _first_largest(sign * values)
        centre = _barycentre(self.evaluate.grid.mesh, cell) if cell >= 0 else np.zeros(0)
        part = next((p.name for p in self.problem.regions if cell in p.cells), "")
        return self._largest(Extreme(sign * value, _numbers(centre), part), sign)

    def _at_nodes(
        self, values: AnyArray, regions: IntArray | None = None, *, sign: int = 1
    ) -> Extreme:
        node, value = _first_largest(sign * values)
        dim = self.problem.body.dim
        place = place_of(self.problem.V, node)[:dim] if node >= 0 else np.zeros(0)
        region = -1 if regions is None or node < 0 else int(regions[node])
        part = self.problem.regions[region].name if region >= 0 else ""
        return self._largest(Extreme(sign * value, _numbers(place), part), sign)

    def _largest(self, own: Extreme, sign: int) -> Extreme:
        found: list[Extreme] = [e for e in self.problem.body.comm.allgather(own) if e.place]
        return max(found, key=lambda e: sign * e.value)


def _first_largest(values: AnyArray) -> tuple[int, float]:
    """Index and value of the largest finite number; (-1, -inf) without values on this rank."""
    finite = np.where(np.isfinite(values), values, -np.inf)
    if not len(finite):
        return -1, -np.inf
    index = int(np.argmax(finite))
    return index, float(finite[index])


def _numbers(place: AnyArray) -> tuple[float, ...]:
    return tuple(float(x) for x in place)


def _barycentre(mesh: Mesh, cell: int) -> AnyArray:
    dim = mesh.geometry.dim
    corners = mesh.geometry.dofmap[cell][: mesh.topology.dim + 1]
    return np.asarray(mesh.geometry.x[corners].mean(axis=0)[:dim])


def extremes(problem: Problem, state: State) -> dict[str, Extreme]:
    """Extremes of one state. Collective.

    Args:
        problem: The problem that is solved.
        state: Its state.

    Returns:
        See `Extremes.of`.
    """
    return Extremes(problem).of(state)
