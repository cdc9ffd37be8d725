"""The largest von Mises stress, the smallest safety factor, and whether these have a limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.core.units import stress_unit
from dolfin_elastic.results.grid import place_of
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
    """A largest von Mises stress, or a smallest safety factor.

    Attributes:
        value: Of the recovered stress [Pa, 1].
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
        return f"{self.value / factor:.3g} {unit} {self.where()}"

    def where(self) -> str:
        """The place for people, such as "at (0.016, 0, 0.01) m on 'fillet'"."""
        place = ", ".join(f"{0.0 if abs(x) < 1e-12 else x:.4g}" for x in self.place)
        on = f" on '{self.surface}'" if self.surface else ""
        return f"at ({place}) m{on}"


@dataclass(frozen=True)
class Peaks:
    """The largest von Mises stress and the smallest safety factor of a state.

    Attributes:
        largest: Of all nodes.
        elsewhere: Where the largest one is singular, the largest one away from singular places, see
            `find_peaks`; None where cells are so large that there is no such place.
        safety: Smallest safety factor; None without an allowable stress.
        safety_elsewhere: As `elsewhere`, where the smallest factor is singular.
    """

    largest: Peak
    elsewhere: Peak | None = None
    safety: Peak | None = None
    safety_elsewhere: Peak | None = None

    @property
    def regular(self) -> Peak | None:
        """The largest one that does not grow with every refinement."""
        return self.elsewhere if self.largest.singular else self.largest

    def lines(self, norm: float) -> list[str]:
        """All of it for people, a fact a line; what belongs to the line above is indented.

        Args:
            norm: Estimated error of the stress field, relative, in the energy norm.
        """
        most = f"largest von Mises stress  {self.largest.text()}"
        found = [most, *_remarks(self.largest, "grows")]
        if self.elsewhere is not None:
            other = f"{self.elsewhere.text()}, estimated error {percent(self.elsewhere.error)}"
            found.append(f"  largest elsewhere       {other}")
        if self.safety is not None:
            least = f"smallest safety factor    {self.safety.value:.3g} {self.safety.where()}"
            found += [least, *_remarks(self.safety, "falls")]
        if self.safety_elsewhere is not None:
            beside = self.safety_elsewhere
            found.append(f"  smallest elsewhere      {beside.value:.3g} {beside.where()}")
        share = f"{percent(norm)} of the whole stress field (energy norm)"
        if not np.isfinite(norm):
            share = "none is known: its energy at these strains has no finite value"
        return [*found, f"estimated error           {share}"]


def _remarks(peak: Peak, changes: str) -> list[str]:
    """Lines below that of a largest value.

    Args:
        peak: It.
        changes: "grows" or "falls" with every refinement at a singular place.
    """
    if peak.singular:
        return [f"  not to be relied on     at {peak.singular} it {changes} with every refinement"]
    return [f"  estimated error         {percent(peak.error)}"] if changes == "grows" else []


def percent(share: float) -> str:
    """A share in percent with two digits; "unknown" where it is no number."""
    if not np.isfinite(share):
        return "unknown"
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
    stress = estimate.stress
    highest, elsewhere = _pair(problem, estimate, von_mises(stress.stress), stress.region, places)
    if all(region.law.allowable is None for region in problem.regions):
        return Peaks(highest, elsewhere)
    # The share of the allowable stress is largest where the factor is smallest.
    use = 1 / np.where(stress.safety > 0, stress.safety, np.nan)
    factors = [
        None if peak is None or peak.value <= 0 else replace(peak, value=1 / peak.value)
        for peak in _pair(problem, estimate, use, stress.safety_region, places)
    ]
    return Peaks(highest, elsewhere, *factors)


def _pair(
    problem: Problem,
    estimate: ErrorEstimate,
    values: FloatArray,
    regions: IntArray,
    places: SingularPlaces,
) -> tuple[Peak, Peak | None]:
    """The largest value, and where it is singular the largest elsewhere. Collective.

    Args:
        problem: The problem that is solved.
        estimate: The estimate for a state.
        values: In proportion to the von Mises stress, at the owned nodes.
        regions: Number of the material region that each belongs to.
        places: Where the stress is singular.
    """
    values = np.where(np.isfinite(values), values, -np.inf)
    reasons = [places.reason(node) for node in _best(values)]
    first = _at_largest(problem, estimate, values, regions, "".join(reasons))
    if not first.singular:
        return first, None
    chosen = _local_maxima(problem.V, values)
    others = (~places.anywhere & chosen, ~places.widened(problem.V))
    maximum, beyond = (
        _at_largest(problem, estimate, np.where(where, values, -np.inf), regions)
        for where in others
    )
    other = beyond if maximum.value < _LOWER * beyond.value else maximum
    return first, other if other.place else None


def largest(
    problem: Problem, estimate: ErrorEstimate, chosen: BoolArray, places: SingularPlaces
) -> Peak:
    """The largest von Mises stress on some nodes. Collective.

    Args:
        problem: The problem that is solved.
        estimate: The estimate for a state.
        chosen: Which of the owned nodes count.
        places: Where the stress is singular.
    """
    values = von_mises(estimate.stress.stress)
    values = np.where(np.isfinite(values) & chosen, values, -np.inf)
    reasons = [places.reason(node) for node in _best(values)]
    return _at_largest(problem, estimate, values, estimate.stress.region, "".join(reasons))


def _best(values: FloatArray) -> list[int]:
    """This rank's node with the largest value, if it has nodes."""
    return [int(np.argmax(values))] if len(values) else []


def _at_largest(
    problem: Problem,
    estimate: ErrorEstimate,
    values: FloatArray,
    regions: IntArray,
    singular: str = "",
) -> Peak:
    """The largest value. Collective.

    Args:
        problem: The problem that is solved.
        estimate: The estimate for a state.
        values: In proportion to the von Mises stress, at the owned nodes; -inf where none counts.
        regions: Number of the material region that each belongs to.
        singular: What is singular at this rank's largest value.
    """
    comm, node = problem.body.comm, next(iter(_best(values)), -1)
    mine = float(values[node]) if node >= 0 else -np.inf
    best, rank = max((value, -r) for r, value in enumerate(comm.allgather(mine)))
    if not np.isfinite(best):
        return Peak(0.0, (), "", 0.0)
    own, surface = None, _surface_at(problem, node, -rank)
    around = _largest_around(problem, node if comm.rank == -rank else -1, estimate.difference)
    if comm.rank == -rank:
        x = place_of(problem.V, node)[: problem.body.dim]
        stress = float(von_mises(estimate.stress.stress[node]))
        error = max(float(estimate.stress_error[node]), around)
        own = Peak(
            mine,
            tuple(float(a) for a in x),
            problem.regions[int(regions[node])].name,
            error / stress if stress > 0 else 0.0,
            surface,
            singular,
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
