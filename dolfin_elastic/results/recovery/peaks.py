"""The largest von Mises stress, its estimated error, and whether it grows with every refinement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.core.units import stress_unit
from dolfin_elastic.results.recovery.error import ErrorEstimate
from dolfin_elastic.results.recovery.singular import SingularPlaces, singular_places
from dolfin_elastic.results.recovery.stress import von_mises

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_EQUAL = 1e-9
"""Relative difference of stresses below which none is the larger one."""
_LOWER = 0.5
"""Least ratio of a local maximum that is reported to the largest stress two cells away from all
singular places."""


@dataclass(frozen=True)
class Peak:
    """A largest von Mises stress.

    Attributes:
        value: Recovered stress [Pa].
        place: Node [m], reference configuration.
        part: Name of its material region.
        error: Estimated error, relative to the value.
        surface: Name of the smallest surface that the node is on; empty if there is none.
        singular: What makes the exact stress unbounded there; empty if nothing does.
    """

    value: float
    place: tuple[float, ...]
    part: str
    error: float
    surface: str = ""
    singular: str = ""

    def text(self) -> str:
        """Value and place for people, such as "184 MPa at (0.016, 0, 0.01) m on 'fillet'"."""
        factor, unit = stress_unit(self.value)
        place = ", ".join(f"{0.0 if abs(x) < 1e-12 else x:.4g}" for x in self.place)
        on = f" on '{self.surface}'" if self.surface else ""
        return f"{self.value / factor:.3g} {unit} at ({place}) m{on}"


@dataclass(frozen=True)
class Peaks:
    """The largest von Mises stress of a state.

    Attributes:
        largest: Of all nodes.
        elsewhere: Where the largest one is singular, the largest one away from singular places, see
            `find_peaks`; None where cells are so large that there is no such place.
    """

    largest: Peak
    elsewhere: Peak | None = None

    @property
    def regular(self) -> Peak | None:
        """The largest one that does not grow with every refinement."""
        return self.elsewhere if self.largest.singular else self.largest

    def text(self) -> str:
        """All of it as a sentence."""
        start = f"largest von Mises stress {self.largest.text()}"
        if not self.largest.singular:
            return f"{start}, estimated error {percent(self.largest.error)}"
        found = f"{start}, at {self.largest.singular}: it grows with every refinement"
        if self.elsewhere is None:
            return found
        other = f"{self.elsewhere.text()}, estimated error {percent(self.elsewhere.error)}"
        return f"{found}; the largest elsewhere {other}"


def percent(share: float) -> str:
    """A share in percent with two digits."""
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def find_peaks(problem: Problem, estimate: ErrorEstimate) -> Peaks:
    """The largest von Mises stress, and where it is singular the largest regular one. Collective.

    The largest regular stress is sought among local maxima at nodes of cells that have no singular
    node: in the next cells the stress still rises towards the singular place, but has no maximum.
    If the largest of them is less than half of the largest stress at least two cells away, as in a
    beam whose bending moment is largest at its clamped end, the latter is taken.

    Args:
        problem: The problem that is solved, in the state of the estimate.
        estimate: The estimated error of the state.
    """
    places = singular_places(problem)
    first = largest(problem, estimate, places=places)
    if not first.singular:
        return Peaks(first)
    chosen = _local_maxima(problem.V, von_mises(estimate.stress.stress))
    maximum = largest(problem, estimate, ~places.anywhere & chosen)
    beyond = largest(problem, estimate, ~places.widened(problem.V))
    other = beyond if maximum.value < _LOWER * beyond.value else maximum
    return Peaks(first, other if other.place else None)


def largest(
    problem: Problem,
    estimate: ErrorEstimate,
    chosen: BoolArray | None = None,
    *,
    places: SingularPlaces | None = None,
) -> Peak:
    """The largest von Mises stress, on all nodes or on some. Collective.

    Args:
        problem: The problem that is solved.
        estimate: The estimate for a state.
        chosen: Which of the owned nodes count; by default all.
        places: Where the stress is singular, if that is to be known.
    """
    values = von_mises(estimate.stress.stress)
    values = np.where(np.isfinite(values), values, -np.inf)
    if chosen is not None:
        values = np.where(chosen, values, -np.inf)
    comm, node = problem.body.comm, int(np.argmax(values)) if len(values) else -1
    mine = float(values[node]) if node >= 0 else -np.inf
    best, rank = max((value, -r) for r, value in enumerate(comm.allgather(mine)))
    if not np.isfinite(best):
        return Peak(0.0, (), "", 0.0)
    own, surface = None, _surface_at(problem, node, -rank)
    around = _largest_around(problem, node if comm.rank == -rank else -1, estimate.difference)
    if comm.rank == -rank:
        x = problem.V.tabulate_dof_coordinates()[node, : problem.body.dim]
        own = Peak(
            mine,
            tuple(float(a) for a in x),
            problem.regions[int(estimate.stress.region[node])].name,
            max(float(estimate.stress_error[node]), around) / mine if mine > 0 else 0.0,
            surface,
            places.reason(node) if places is not None else "",
        )
    found: Peak = comm.bcast(own, root=-rank)
    return found


def _largest_around(problem: Problem, node: int, values: FloatArray) -> float:
    """Largest value at the nodes of the cells around a node of one rank. Collective.

    Args:
        problem: The problem that is solved.
        node: Owned node; negative on all ranks but one.
        values: At the owned nodes and ghosts.
    """
    comm, dofmap = problem.body.comm, problem.V.dofmap
    first = dofmap.index_map.local_range[0]
    number = comm.allreduce(first + node if node >= 0 else -1, op=MPI.MAX)
    (local,) = dofmap.index_map.global_to_local(np.array([number], dtype=np.int64))
    nodes = dofmap.list[: len(problem.body.owned_cells())]
    beside = nodes[(nodes == local).any(axis=1)] if local >= 0 else nodes[:0]
    return float(comm.allreduce(float(values[beside].max(initial=0.0)), op=MPI.MAX))


def _surface_at(problem: Problem, node: int, rank: int) -> str:
    """Name of the smallest surface with a node of one rank; empty if there is none. Collective."""
    body, found = problem.body, []
    for name in sorted(body.surfaces):
        facets = body.surfaces[name]
        nodes = fem.locate_dofs_topological(problem.V, body.dim - 1, facets)
        here = body.comm.rank == rank and node in nodes
        on, size = total(body.comm, np.array([int(here), len(facets)]))
        if on:
            found.append((int(size), name))
    return min(found)[1] if found else ""


def _local_maxima(V: fem.FunctionSpace, values: FloatArray) -> BoolArray:
    """Owned nodes whose value none in a cell with them exceeds. Collective.

    Args:
        V: Space whose nodes they are.
        values: Of the owned nodes.
    """
    work = la.vector(V.dofmap.index_map, 1)
    work.array[: len(values)] = values
    work.scatter_forward()
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    nodes = V.dofmap.list[:cells]
    of_cells = work.array[nodes]
    below = of_cells < of_cells.max(axis=1, initial=-np.inf, keepdims=True) * (1 - _EQUAL)
    marks = la.vector(V.dofmap.index_map, 1)
    marks.array[nodes[below]] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    return np.asarray(marks.array[: len(values)] == 0)
