"""The recovered stress at points inside the body, from the cells around them alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, la

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.locate import LocatedPoint
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.cell_fields import unknowns_of_outputs
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.recovery.stress import (
    RegionStress,
    field_rows,
    safety_factor,
    von_mises,
)

if TYPE_CHECKING:
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

_RINGS = 4
"""Layers of cells around the cell of a point: those of the patches of its nodes, and those of the
patches from which a patch with too few sampling points takes its polynomial."""


@dataclass(frozen=True)
class PointStress:
    """Recovered stress at a point; zeros on all ranks but one, so that a sum gives the value.

    Attributes:
        stress: Cauchy stress [Pa], shape (1, 6).
        safety: Safety factor, shape (1,); NaN without an allowable stress.
    """

    stress: FloatArray
    safety: FloatArray

    def row(self, name: str) -> FloatArray:
        """Components of a field that follows from the recovered stress."""
        return np.asarray(field_rows(name, self.stress, self.safety)[0])


class StressAtPoints:
    """Recovered stress at points.  All of it is collective.

    The stress at the nodes of the point's cell is interpolated by the shape functions of the
    displacement, so that it is that of the nodes in the fields.

    Args:
        places: Name of the point to its cell and local coordinates.
    """

    def __init__(self, problem: Problem, places: Mapping[str, LocatedPoint]) -> None:
        self._w, self._places = unknowns_of_outputs(problem), places
        self._element = problem.V.element.basix_element
        comm = problem.body.comm
        self._parts: list[tuple[RegionStress, dict[str, int]]] = []
        for region in problem.regions:
            mine = [n for n, p in places.items() if p.cell >= 0 and p.cell in region.cells]
            if total(comm, len(mine)):
                cells = _around(problem, region, [places[name].cell for name in mine])
                part = RegionStress(problem, region, self._w, cells)
                rows = {n: int(np.searchsorted(cells, places[n].cell)) for n in mine}
                self._parts.append((part, rows))

    def __call__(self, state: State) -> dict[str, PointStress]:
        """Name of the point to the stress there."""
        self._w.x.array[:] = (state.w or state.u).x.array
        found = {n: PointStress(np.zeros((1, 6)), np.zeros(1)) for n in self._places}
        for part, rows in self._parts:
            stress, allowable = part(), part.allowable()
            for name, row in rows.items():
                local = self._places[name].local
                shape = self._element.tabulate(0, local[None])[0, :, :, 0]
                sigma = shape @ stress[row]
                factor = safety_factor(shape @ allowable[row], von_mises(sigma))
                found[name] = PointStress(sigma, factor)
        return found


def _around(problem: Problem, region: MaterialRegion, cells: list[int]) -> IndexArray:
    """Owned cells of a region in `_RINGS` layers around cells of all ranks, sorted. Collective."""
    dofmap = fem.functionspace(problem.body.mesh, ("Lagrange", 1)).dofmap
    chosen = np.asarray(sorted(cells), dtype=np.int32)
    for _ in range(_RINGS):
        marks = la.vector(dofmap.index_map, 1)
        marks.array[dofmap.list[chosen].reshape(-1)] = 1.0
        marks.scatter_reverse(la.InsertMode.add)
        marks.scatter_forward()
        near = (marks.array[dofmap.list[region.cells]] > 0).any(axis=1)
        chosen = np.asarray(region.cells[near])
    return chosen


def is_recovered(names: tuple[str, ...]) -> bool:
    """Whether one of some fields follows from the recovered stress."""
    return any(name in FIELDS and FIELDS[name].recovered for name in names)
