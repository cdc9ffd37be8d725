"""The largest von Mises stress and the smallest safety factor of all states of a motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.problem.state import State, plain
from dolfin_elastic.results.recovery.peaks import (
    LOWER,
    Peak,
    PeakFinder,
    least_ratio,
    utilisation,
)
from dolfin_elastic.results.recovery.singular import singular_places
from dolfin_elastic.results.recovery.stress import StressRecovery, von_mises
from dolfin_elastic.results.verdict import ELSEWHERE, Table

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_EQUAL = 1e-9
"""Relative difference up to which the earlier one of two states counts."""
_JUDGED = ("error", "unresolved", "unit")
"""What is not known of a peak whose error is not estimated."""


class MotionPeaks:
    """Keeps the worst stress of the states of a motion.  All of it is collective.

    Every state that the solver yields is looked at.  Recovering its stress costs about a twentieth
    of an implicit step, and nothing where outputs write the stress, too.

    Args:
        saved: The worst stresses before the checkpoint from which the run continues.
    """

    def __init__(self, problem: Problem, saved: Mapping[str, Table]) -> None:
        self._problem = problem
        self._limited = any(region.law.allowable is not None for region in problem.regions)
        self._worst = dict(saved)
        self._finder: PeakFinder | None = None
        self._found = -1

    @cached_property
    def _stress(self) -> StressRecovery:
        return StressRecovery(self._problem)

    def restart_state(self) -> Mapping[str, Table]:
        """The worst so far, as JSON data."""
        return self._worst

    def as_json(self) -> dict[str, Table | None]:
        """As the `error` of `summary.json`, each with its time, but without an error.

        Where the worst is singular, "elsewhere" has the worst of all states away from there.  It is
        None where a worse state has no place that is regular, as on a coarse mesh.
        """
        result: dict[str, Table | None] = {}
        for name, other in ELSEWHERE.items():
            if (peak := self._worst.get(name)) is not None:
                regular = self._worst.get(other, peak)
                known = peak["singular"] and not regular["singular"]
                result |= {name: peak, other: regular if known else None}
        return result

    def add(self, state: State) -> None:
        """Takes a state."""
        stress = self._stress(state)
        self._add(state, "von_mises", von_mises(stress.stress), stress.region)
        if self._limited:
            lower = least_ratio(self._problem)
            self._add(state, "safety_factor", utilisation(stress), stress.safety_region, lower)

    def _add(
        self,
        state: State,
        name: str,
        values: FloatArray,
        regions: IntArray,
        lower: float = LOWER,
    ) -> None:
        """Takes the values of a state.

        Args:
            values: In proportion to the von Mises stress, at the owned nodes.
            regions: Number of the material region that each belongs to.
            lower: See `PeakFinder.pair`.
        """
        finite = values[np.isfinite(values)]
        top = largest(self._problem.body.comm, float(finite.max(initial=0.0)))
        if top <= self._least(name):
            return  # as of most states of a vibration
        found = self._finder_at(state).pair(values, regions, lower=lower)[:2]
        for key, peak in _pairs(name, *found):
            if peak.value > self._known(key):
                row = {k: value for k, value in peak.as_json().items() if k not in _JUDGED}
                if name == "safety_factor":
                    row["value"] = 1 / peak.value
                self._worst[key] = {**row, "step": state.step, "t": plain(state.t)}

    def _finder_at(self, state: State) -> PeakFinder:
        """Finds peaks of a state: contacts and forces at nodes make singular places that change."""
        problem = self._problem
        changing = problem.contact_pairs or problem.nodal_loads is not None
        if self._finder is None or (changing and self._found != state.step):
            self._finder = PeakFinder(problem, singular_places(problem))
            self._found = state.step
        return self._finder

    def _least(self, name: str) -> float:
        """What a value has to exceed to count."""
        return min(self._known(key) for key in (name, ELSEWHERE[name]))

    def _known(self, key: str) -> float:
        """The largest value so far, of a safety factor its inverse."""
        if (row := self._worst.get(key)) is None:
            return 0.0
        value = float(row["value"])
        return (1 / value if key.startswith("safety_factor") else value) * (1 + _EQUAL)


def _pairs(name: str, first: Peak, other: Peak | None) -> Iterator[tuple[str, Peak]]:
    """The largest value, and the largest one that is regular; without any the singular one."""
    regular = first if other is None else other
    for key, peak in ((name, first), (ELSEWHERE[name], regular)):
        if peak.place:
            yield key, peak
