"""The largest von Mises stress, the smallest safety factor, and whether these have a limit."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.ghosts import marked, with_ghosts
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit, stress_unit
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.results.recovery.error import ErrorEstimate
from dolfin_elastic.results.recovery.locking import unseen_locking
from dolfin_elastic.results.recovery.resolution import RESOLVED, resolution
from dolfin_elastic.results.recovery.singular import SingularPlaces, singular_places
from dolfin_elastic.results.recovery.stress import NodalStress, von_mises
from dolfin_elastic.results.verdict import factor_text

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem
    from dolfin_elastic.problem.state import State

_EQUAL = 1e-9
"""Relative difference of stresses below which none is the larger one."""
ERROR, _PEAKS = "estimated error", "peaks"
_CUT_OFF = 1e-3
"""Least share of the energy at straight cells that is reported."""
_MORE, _MORE_OF_ERROR = 0.01, 0.25
"""By how much the error is larger if another place is named, relative to the stress and to the
error at its own place."""
_SAME_PLACE = 2.0
"""Distance over the size of cells up to which two nodes are at the same peak."""
LOWER = 0.5
"""Least ratio of a local maximum that is reported to the largest stress two cells away from all
singular places."""


def least_ratio(problem: Problem) -> float:
    """The least ratio, see `LOWER`, for safety factors.

    1 where strengths depend on direction or sign: a local maximum may then be of another kind than
    the stress that rises towards a singular place, such as compression opposite to weak tension.
    """
    apart = any(isinstance(region.law.allowable, Strength) for region in problem.regions)
    return 1.0 if apart else LOWER


@dataclass(frozen=True)
class Peak:
    """A largest von Mises stress, or a smallest safety factor.

    Attributes:
        value: Of the recovered stress [Pa, 1].
        place: Node [m], reference configuration.
        part: Name of its material region.
        error: Estimated error, relative to the value: by how much the largest stress at any regular
            place may be larger.  NaN where it is not known.
        surface: Name of the smallest surface that the node is on; empty if there is none.
        singular: What makes the exact stress unbounded there; empty if nothing does.
        unresolved: Why the cells there do not resolve a peak; empty if they do.
        unit: In which the place is told.
    """

    value: float
    place: tuple[float, ...]
    part: str
    error: float
    surface: str = ""
    singular: str = ""
    unresolved: str = ""
    unit: LengthUnit = METRE

    def text(self) -> str:
        """Value and place for people, such as "184 MPa at (16, 0, 10) mm on 'fillet'"."""
        factor, unit = stress_unit(self.value)
        return f"{self.value / factor:.3g} {unit} {self.where()}"

    def where(self) -> str:
        """The place for people, such as "at (16, 0, 10) mm on 'fillet'"."""
        on = f" on '{self.surface}'" if self.surface else ""
        return f"at {self.unit.point(self.place)}{on}"

    def as_json(self) -> dict[str, object]:
        """For `summary.json`, in SI units."""
        return {key: value for key, value in asdict(self).items() if key != "unit"}


@dataclass(frozen=True)
class Remark:
    """A line on a largest value.

    Attributes:
        label: What it is.
        text: Its value or reason.
        reserved: It limits how far the value can be believed.
        indented: It belongs to the line above.
    """

    label: str
    text: str
    reserved: bool = False
    indented: bool = True

    @property
    def line(self) -> str:
        """For people."""
        return (
            f"  {self.label:<22}  {self.text}"
            if self.indented
            else f"{self.label:<24}  {self.text}"
        )


@dataclass(frozen=True)
class Peaks:
    """The largest von Mises stress and the smallest safety factor of a state.

    Attributes:
        largest: Of all nodes.
        elsewhere: Where the largest one is singular, the largest one away from singular places, see
            `find_peaks`; None where cells are so large that there is no such place.
        safety: Smallest safety factor; None without an allowable stress.
        safety_elsewhere: As `elsewhere`, where the smallest factor is singular.
        rival: The place where the stress may be larger than the largest regular one and its own
            error; None: that is the place of the latter.
        safety_rival: As `rival`, where the safety factor may be smaller.
        cut_off: Share of the strain energy that straight cells miss or add at curved faces.
    """

    largest: Peak
    elsewhere: Peak | None = None
    safety: Peak | None = None
    safety_elsewhere: Peak | None = None
    rival: Peak | None = None
    safety_rival: Peak | None = None
    cut_off: float = 0.0

    @property
    def regular(self) -> Peak | None:
        """The largest one that does not grow with every refinement."""
        return self.elsewhere if self.largest.singular else self.largest

    def lines(self, norm: float) -> list[str]:
        """All of it for people, a fact a line; what belongs to the line above is indented.

        Args:
            norm: Estimated error of the stress field, relative, in the energy norm.
        """
        return [remark.line for remark in self._remarks(norm)]

    def reservations(self, norm: float) -> list[str]:
        """Those of the lines that limit how far the values can be believed.

        Args:
            norm: See `lines`.
        """
        return [f"{r.label}: {r.text}" for r in self._remarks(norm) if r.reserved]

    def _remarks(self, norm: float) -> list[Remark]:
        result = [Remark("largest von Mises stress", self.largest.text(), indented=False)]
        if self.largest.singular:
            result.append(_unbounded(self.largest, "grows"))
        if self.elsewhere is not None:
            text = self.elsewhere.text() + _apart(self.elsewhere, self.largest)
            result.append(Remark("largest elsewhere", text))
        elif not self.largest.singular and np.isfinite(self.largest.error):
            result.append(Remark(ERROR, percent(self.largest.error)))
        if self.regular is not None:
            result += _doubts(self.regular, self.rival, "larger", Peak.text)
        if self.safety is not None:
            result += self._of_safety(self.safety)
        share = f"{percent(norm)} of the stresses on average (energy norm)"
        if not np.isfinite(norm):
            share = "none is known: its energy at these strains has no finite value"
        result.append(Remark(ERROR, share, not np.isfinite(norm), indented=False))
        if self.cut_off > _CUT_OFF:
            text = f"their facets cut {percent(self.cut_off)} of the energy off at curved faces"
            result.append(Remark("straight elements", text, reserved=True))
        return result

    def _of_safety(self, least: Peak) -> list[Remark]:
        """On the safety factor; of its error what is not told of that of the stress.

        Args:
            least: The smallest factor of all nodes, which may be at a singular place.
        """
        result = [Remark("smallest safety factor", _factor(least), indented=False)]
        regular, beside, stress = least, self.safety_elsewhere, self.regular
        if least.singular:
            result.append(_unbounded(least, "falls"))
            regular = beside or least
        if beside is not None:
            result.append(Remark("smallest elsewhere", _factor(beside) + _apart(beside, least)))
        doubtful = self.safety_rival or regular
        alike = stress is not None and doubtful.place == (self.rival or stress).place
        if alike and stress is not None and percent(stress.error) == percent(regular.error):
            if not least.singular and not np.isfinite(least.error):
                text = "its error, as that of the stress"
                result.append(Remark("not known", text, reserved=True))
            return result
        if not least.singular and np.isfinite(least.error):
            result.append(Remark(ERROR, percent(least.error)))
        return result + _doubts(regular, self.safety_rival, "smaller", _factor)


def _unbounded(peak: Peak, changes: str) -> Remark:
    """That a value has no limit.

    Args:
        changes: "grows" or "falls" with every refinement.
    """
    text = f"at {peak.singular} it {changes} with every refinement"
    return Remark("not to be relied on", text, reserved=True)


def _apart(peak: Peak, singular: Peak) -> str:
    """Error of a regular peak, and its distance from the singular one."""
    error = f"+- {percent(peak.error)}" if np.isfinite(peak.error) else "error unknown"
    distance = float(np.linalg.norm(np.subtract(peak.place, singular.place)))
    return f", {error}, {peak.unit.length(distance)} away"


def _factor(peak: Peak) -> str:
    """A safety factor and its place for people."""
    return f"{factor_text(peak.value)} {peak.where()}"


def _doubts(
    peak: Peak, rival: Peak | None, changed: str, told: Callable[[Peak], str]
) -> list[Remark]:
    """Where the extreme regular value is not known, or may be exceeded. See `Peaks`.

    Args:
        changed: What it may be, "larger" or "smaller".
        told: A value and its place for people.
    """
    if rival is None:
        return [Remark("peak not known", peak.unresolved, True)] if peak.unresolved else []
    if not rival.unresolved:
        may = f"{told(rival)} +- {percent(rival.error)}"
        return [Remark(f"may be {changed}", may, reserved=True)]
    where = f"may be {changed} {rival.where()}, now {told(rival).partition(' at ')[0]}"
    return [
        Remark("peak not known", where, reserved=True),
        Remark("", rival.unresolved, reserved=True),
    ]


def percent(share: float) -> str:
    """A share in percent with two digits; "unknown" where it is no number."""
    if not np.isfinite(share):
        return "unknown"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def peaks_of(problem: Problem, state: State, estimate: ErrorEstimate) -> Peaks:
    """See `find_peaks`: found once for all outputs of a state. Collective."""
    known = state.derived.get(_PEAKS)
    if not isinstance(known, Peaks):
        known = state.derived[_PEAKS] = find_peaks(problem, estimate)
    return known


def find_peaks(problem: Problem, estimate: ErrorEstimate) -> Peaks:
    """The largest von Mises stress, and where it is singular the largest regular one. Collective.

    The largest regular stress is sought among local maxima at nodes of cells that have no singular
    node: in the next cells the stress still rises towards the singular place, but has no maximum.
    If the largest of them is less than half of the largest stress at least two cells away, as in a
    beam whose bending moment is largest at its clamped end, the latter is taken; of safety factors
    by strengths that depend on direction or sign it is taken wherever it is the larger one.

    Its error is that of the largest stress at any regular place: the largest sum of a stress and
    its own error, less the largest stress.  It is not known where the mesh does not resolve the
    face at which the stress is largest, or one where it may be larger, see `resolution`, nor where
    linear elements lock, see `unseen_locking`.

    Args:
        problem: The problem that is solved, in the state of the estimate.
    """
    finder = _Judge(problem, estimate, singular_places(problem))
    stress = estimate.stress
    highest, elsewhere, rival = finder.pair(von_mises(stress.stress), stress.region)
    if all(region.law.allowable is None for region in problem.regions):
        return Peaks(highest, elsewhere, rival=rival, cut_off=estimate.cut_off)
    found = finder.of_safety(estimate).pair(
        utilisation(stress), stress.safety_region, lower=least_ratio(problem)
    )
    least, other, smaller = (
        None if peak is None or peak.value <= 0 else replace(peak, value=1 / peak.value)
        for peak in found
    )
    return Peaks(
        highest,
        elsewhere,
        least,
        other,
        rival=rival,
        safety_rival=smaller,
        cut_off=estimate.cut_off,
    )


def utilisation(stress: NodalStress) -> FloatArray:
    """Von Mises over allowable stress at the owned nodes, largest where the factor is smallest."""
    return np.asarray(1 / np.where(stress.safety > 0, stress.safety, np.nan))


def largest(
    problem: Problem, estimate: ErrorEstimate, chosen: BoolArray, places: SingularPlaces
) -> Peak:
    """The largest von Mises stress on some nodes. Collective.

    Args:
        chosen: Which of the owned nodes count.
        places: Where the stress is singular.
    """
    finder = _Judge(problem, estimate, places)
    values = von_mises(estimate.stress.stress)
    values = np.where(np.isfinite(values) & chosen, values, -np.inf)
    peak = finder.at_largest(values, estimate.stress.region, singular=True)
    if peak.singular:
        return peak
    regular = finder.regular(values)
    return finder.judged(peak, values, regular, regular, estimate.stress.region)[0]


class PeakFinder:
    """Finds largest values among the owned nodes of all ranks.  All of it is collective.

    Args:
        places: Where the stress is singular.
    """

    def __init__(self, problem: Problem, places: SingularPlaces) -> None:
        self._problem, self._places = problem, places

    def pair(
        self, values: FloatArray, regions: IntArray, *, lower: float = LOWER
    ) -> tuple[Peak, Peak | None, Peak | None]:
        """The largest value, where it is singular the largest elsewhere, and what may be larger.

        Args:
            values: In proportion to the von Mises stress, at the owned nodes.
            regions: Number of the material region that each belongs to.
            lower: Least ratio of a local maximum to the largest value two cells away from all
                singular places, at which the maximum is taken.
        """
        values = np.where(np.isfinite(values), values, -np.inf)
        first = self.at_largest(values, regions, singular=True)
        if not first.singular:
            every = self.regular(values)
            first, rival = self.judged(first, values, every, every, regions)
            return first, None, rival
        others = (~self._places.anywhere & self._maxima(values), self._beyond)
        maximum, beyond = (
            self.at_largest(np.where(where, values, -np.inf), regions) for where in others
        )
        other = beyond if maximum.value < lower * beyond.value else maximum
        if not other.place:
            return first, None, None
        # The flank of a singular place is higher than a maximum elsewhere, and none itself.
        known = others[1] if other is beyond else others[0]
        every = self.regular(values)
        return first, *self.judged(other, values, known, every, regions)

    def regular(self, values: FloatArray) -> BoolArray:
        """Nodes whose stress no singular place raises, see `find_peaks`. Collective."""
        return np.asarray((~self._places.anywhere & self._maxima(values)) | self._beyond)

    @cached_property
    def _beyond(self) -> BoolArray:
        return ~self._places.widened(self._problem.V)

    def _maxima(self, values: FloatArray) -> BoolArray:
        return _local_maxima(self._problem.V, values)

    def judged(
        self,
        peak: Peak,
        values: FloatArray,
        regular: BoolArray,
        every: BoolArray,
        regions: IntArray,
    ) -> tuple[Peak, Peak | None]:
        """A largest regular value with the error of the largest one anywhere, and its rival.

        Args:
            values: At the owned nodes.
            every: Which count where a face is not resolved.
            regions: See `pair`.
        """
        return peak, None

    def at_largest(self, values: FloatArray, regions: IntArray, *, singular: bool = False) -> Peak:
        """The largest value, with its own error.

        Args:
            values: At the owned nodes; -inf where none counts.
            regions: See `pair`.
            singular: It may be singular.
        """
        return self._at_largest(values, values, regions, singular=singular)[1]

    def _at_largest(
        self,
        by: FloatArray,
        values: FloatArray,
        regions: IntArray,
        *,
        singular: bool = False,
    ) -> tuple[float, Peak]:
        """Where something is largest: it, and the value there.

        Args:
            by: What is to be largest; -inf where none counts.
            values: In proportion to the von Mises stress.
            regions: See `pair`.
            singular: See `at_largest`.
        """
        problem, comm = self._problem, self._problem.body.comm
        dim = problem.body.dim
        best = largest_row(comm, by, lambda nodes: problem.places[nodes, :dim])
        if best is None or not np.isfinite(best.value):
            return -np.inf, Peak(0.0, (), "", 0.0)
        node, own, surfaces = best.row, None, _surfaces(problem)
        if comm.rank == best.rank:
            error, unresolved = self._trust(node)
            own = Peak(
                float(values[node]),
                best.place,
                problem.regions[int(regions[node])].name,
                error,
                next((name for _, name, nodes in surfaces if node in nodes), ""),
                self._places.reason(node) if singular else "",
                unresolved,
                problem.body.unit,
            )
        peak: Peak = comm.bcast(own, root=best.rank)
        return best.value, peak

    def _trust(self, node: int) -> tuple[float, str]:
        """Error of an owned node's value, and why it is not resolved. Not collective."""
        return np.nan, ""


class _Judge(PeakFinder):
    """Finds largest values with their estimated errors.

    Args:
        places: Where the stress is singular.
    """

    def __init__(self, problem: Problem, estimate: ErrorEstimate, places: SingularPlaces) -> None:
        super().__init__(problem, places)
        self._resolution = resolution(problem)
        self._locking = unseen_locking(problem, estimate.relative)
        self._errors = np.hypot(estimate.stress_error, self._resolution.polygon)

    def of_safety(self, estimate: ErrorEstimate) -> _Judge:
        """The same for the utilisation of strengths."""
        result = copy(self)
        result._errors = np.hypot(estimate.safety_error, self._resolution.polygon)
        return result

    def judged(
        self,
        peak: Peak,
        values: FloatArray,
        regular: BoolArray,
        every: BoolArray,
        regions: IntArray,
    ) -> tuple[Peak, Peak | None]:
        """See `PeakFinder`."""
        if not peak.place or peak.value <= 0:
            return peak, None
        if self._locking is not None:  # the recovered stress is that of a body that hardly moves
            return replace(peak, error=np.nan, unresolved=self._locking.cause()), None
        if peak.unresolved:
            return replace(peak, error=np.nan), None
        unresolved = self._resolution.unresolved
        upper = values * (1 + self._errors)
        may = np.where(unresolved, np.maximum(upper, values * self._resolution.factor), upper)
        known, unknown = (
            self._at_largest(np.where(where, may, -np.inf), values, regions)
            for where in (regular & ~unresolved, every & unresolved)
        )
        bound = max(known[0], peak.value * (1 + peak.error))
        error = bound / peak.value - 1
        if unknown[0] > bound:
            return replace(peak, error=np.nan), replace(unknown[1], error=np.nan)
        apart = np.linalg.norm(np.subtract(known[1].place, peak.place)) if known[1].place else 0.0
        same = known[0] <= bound * (1 - _EQUAL) or apart <= _SAME_PLACE * self._size_of_cells
        small = error - peak.error < max(_MORE, _MORE_OF_ERROR * peak.error)
        return replace(peak, error=error), None if same or small else known[1]

    @cached_property
    def _size_of_cells(self) -> float:
        return cell_size(self._problem.body)

    def _trust(self, node: int) -> tuple[float, str]:
        """See `PeakFinder`."""
        return float(self._errors[node]), self._unresolved(node)

    def _unresolved(self, node: int) -> str:
        r, body = self._resolution, self._problem.body
        if not r.unresolved[node]:
            return ""
        text = f"an element turns by {np.degrees(r.turn[node]):.0f} degrees along the face"
        if off := r.off[node]:
            face = f"{'face' if body.dim == 3 else 'curve'} {r.face[node]:.0f}"
            text = f"the mesh lies {body.unit.length(off, 2)} off {face} of {body.source}"
        if r.bend[node] <= 0:
            return text
        size = f"size = {RESOLVED / r.bend[node] / body.unit.metres:.3g} {body.unit.name}"
        return f"{text}: {size} {'meshes it anew' if off else 'resolves it'}"


_SURFACES: WeakKeyDictionary[Problem, list[tuple[int, str, IntArray]]] = WeakKeyDictionary()
"""Number of facets, name and this rank's nodes of each surface, the smallest surface first."""


def _surfaces(problem: Problem) -> list[tuple[int, str, IntArray]]:
    """See `_SURFACES`. Collective."""
    if problem not in _SURFACES:
        body, V = problem.body, problem.V
        _SURFACES[problem] = sorted(
            (
                (
                    int(total(body.comm, len(body.surfaces[name]))),
                    name,
                    fem.locate_dofs_topological(V, body.dim - 1, body.surfaces[name]),
                )
                for name in sorted(body.surfaces)
            ),
            key=lambda row: row[:2],
        )
    return _SURFACES[problem]


def _local_maxima(V: fem.FunctionSpace, values: FloatArray) -> BoolArray:
    """Owned nodes whose value none in a cell with them exceeds. Collective.

    Args:
        values: Of the owned nodes.
    """
    local = with_ghosts(V.dofmap.index_map, values[:, None])[:, 0]
    cells = V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    nodes = V.dofmap.list[:cells]
    of_cells = local[nodes]
    below = of_cells < of_cells.max(axis=1, initial=-np.inf, keepdims=True) * (1 - _EQUAL)
    return ~marked(V.dofmap.index_map, nodes[below])[: len(values)]
