"""`Wanted`: one number of a run, such as "von_mises on fillet", and where it is found."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.types import BoolArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.reductions import ending
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.finished.run import column_unit
from dolfin_elastic.results.quantity import EXTREMES, Extreme, Measured, Measurement, Quantity
from dolfin_elastic.results.recovery.error import ErrorEstimate
from dolfin_elastic.results.recovery.peaks import Peak, largest
from dolfin_elastic.results.recovery.singular import singular_places
from dolfin_elastic.results.writers.history import row

_TEXT = re.compile(r"\s*(?:([a-z]+(?::[\d.]+)?)\s+)?(\w+)(?:\s+(?:on|of|at)\s+(\S.*?))?\s*")
_EXAMPLES = (
    '"von_mises on fillet", "displacement of tip", "percentile:95 von_mises on fillet", '
    '"reaction of left" or "strain_energy"'
)
_COMPONENTS = re.compile(r"(displacement|reaction)(_[xyz])?")
SAME = {"energy": "strain_energy"}
"""Word for a column to the column's name."""
_SMALLEST = ("safety_factor",)
_PEAK = 0.8
"""Share of the largest value from which on a node belongs to the peak."""


@dataclass(frozen=True)
class Wanted:
    """The result that is wanted, as it was written: "[REDUCTION] NAME [on PART]".

    Attributes:
        name: A field, a column of history.csv, "displacement" or "reaction".
        part: Surface, region, edge, point, probe or support; empty: the whole body.
        reduction: Of a field or its component, see `REDUCTIONS`; empty: the extreme of a field.
        option: By which it was given, for messages.
    """

    name: str
    part: str = ""
    reduction: str = ""
    option: str = field(default="--until", compare=False)

    @classmethod
    def read(cls, text: str, option: str = "--until") -> Wanted:
        """From the command line.

        Args:
            option: Where it was given, for messages.

        Raises:
            InputError: It is no name, and no name with a part.
        """
        match = _TEXT.fullmatch(text)
        if match is None:
            raise InputError(
                f"a run has no result '{text}'", where=option, expected=f"for example {_EXAMPLES}"
            )
        wanted = cls(match[2], match[3] or "", match[1] or "", option)
        if (name := f"{match[1]}_{match[2]}") in FIELDS:  # "safety factor", "von mises"
            wanted = cls(name, match[3] or "", option=option)
        if wanted.reduction:
            try:
                assert wanted.quantity
            except InputError as error:
                raise error.at(option) from None
        return wanted

    def __str__(self) -> str:
        named = f"{self.reduction} {self.name}".lstrip()
        return f"{named} on {self.part}" if self.part else named

    @property
    def is_field(self) -> bool:
        """It is a number of a field, by default the largest (of the safety factor the smallest).

        A reaction is the force of a whole support, not the largest of its nodal forces.
        """
        return bool(self.reduction) or (self.name in FIELDS and self.name != "reaction")

    @property
    def quantity(self) -> Quantity:
        """Of the field."""
        reduction = self.reduction or ("min" if self.name in _SMALLEST else "max")
        return Quantity(self.name, self.part or None, reduction)

    @property
    def is_stress(self) -> bool:
        """It is the largest von Mises stress."""
        return self.name in ("von_mises", "von_mises_nodal") and self.reduction in ("", "max")

    @property
    def unit(self) -> str:
        """SI unit; empty where it is not known from the name."""
        if self.reduction:
            over = "" if self.part else "volume"  # a part may be of either kind
            column = f"part_{self.quantity.name}_{ending(self.reduction, over)}"
            return column_unit(column, timed=False)
        if self.name in FIELDS:
            return FIELDS[self.name].unit
        units = {"displacement": "m", "reaction": "N", "force": "N", "energy": "J"}
        return next((unit for word, unit in units.items() if word in self.name), "")

    def order(self, degree: int) -> int:
        """Order of convergence in the cell size that is assumed where the solution is smooth.

        Stresses have the order of the displacement gradient; energies and reactions, whose errors
        are products of two, twice that.  Displacements have one order more than their gradient
        where all cells are halved; adapted meshes leave many as they are.

        Source: G. Strang and G. J. Fix, An Analysis of the Finite Element Method (1973), chapter 3.
        """
        whole = not self.is_field and ("energy" in self.name or "reaction" in self.name)
        return 2 * degree if whole else degree

    def check(self, body: Body, probes: Sequence[str], supports: Sequence[str]) -> None:
        """Checks the names before anything is computed. Not collective.

        Raises:
            InputError: There is no such part, or no such field on it.
        """
        if not self.part:
            return
        parts = [name for named in body.parts.values() for name in named]
        if self.name.startswith("reaction"):
            if self.part not in supports:
                raise self.unknown("no support", self.part, supports)
        elif self.part in probes:
            return
        elif not body.kinds(self.part):
            raise self.unknown("no part and no probe", self.part, [*parts, *probes])
        elif not self.is_field:
            raise InputError(
                f"there is no field '{self.name}'",
                where=self.option,
                expected=FIELDS.nearest(self.name),
            )
        elif self.quantity.reduction not in EXTREMES:
            sized = [*body.parts["surface"], *body.parts["region"]]
            if self.part not in sized:
                raise self.unknown("no surface or region", self.part, sized)

    def unknown(self, what: str, name: str, known: Iterable[str]) -> InputError:
        """An error that names the nearest of what is known."""
        known_one = nearest(name, known)
        return InputError(f"there is {what} '{name}'", where=self.option, expected=known_one)


class WantedNumber:
    """Evaluates what is wanted on one mesh. Collective to make."""

    def __init__(self, wanted: Wanted, problem: Problem) -> None:
        self._wanted, self._problem = wanted, problem
        self._measured: Measurement | None = None
        if wanted.is_field and (not wanted.part or problem.body.kinds(wanted.part)):
            self._measured = wanted.quantity.on(problem)

    def __call__(self, state: State) -> tuple[Measured, IndexArray]:
        """What is measured in a state with the numbers of its probes. Collective.

        Returns:
            It, and the owned cells of this rank at the peak of a field.

        Raises:
            InputError: The run has no such result.
        """
        extreme, none = self._measured, np.empty(0, dtype=np.int32)
        if extreme is None:
            return Measured(self._number(state)), none
        if not isinstance(extreme, Extreme):
            return extreme.of(state), none
        values = extreme.values(state)
        result = extreme.largest(state, values)
        if not result.place:
            raise InputError(
                f"'{self._wanted}' has no value in this run",
                where=self._wanted.option,
                expected="a result that is finite somewhere on that part",
            )
        top = result.value if extreme.quantity.reduction == "max" else -result.value
        peak = extreme.members[values >= (_PEAK * top if top > 0 else top / _PEAK)]
        return result, self._touching(peak) if extreme.centre == "node" else peak

    def peak(self, measured: Measured, estimate: ErrorEstimate) -> Peak | None:
        """What is known of a largest stress; None of other results. Collective.

        Args:
            measured: From calling it, in the state of the estimate.
        """
        if not (self._wanted.is_stress and measured.place):
            return None
        return largest(self._problem, estimate, self._chosen(), singular_places(self._problem))

    def _chosen(self) -> BoolArray:
        """Whether an owned node is one of those among which the extreme of a field is sought."""
        assert isinstance(self._measured, Extreme)
        mask = np.zeros(self._problem.V.dofmap.index_map.size_local, dtype=bool)
        mask[self._measured.members] = True
        return mask

    def _number(self, state: State) -> float:
        """A number that is there already: a column of the history, or the length of some."""
        q, columns = self._wanted, row(state)
        known = SAME.get(q.name, q.name)
        if not q.part and isinstance(column := columns.get(known), int | float):
            return float(column)
        kind = _COMPONENTS.fullmatch(q.name)
        if q.part:
            stem = f"reaction_{q.part}" if q.name.startswith("reaction") else q.part
            ends = [kind[2]] if kind and kind[2] else ["_x", "_y", "_z"]
            names = [stem + end for end in ends] if kind else [f"{q.part}_{q.name}"]
            if q.reduction:
                ends = [ending(q.reduction, over) for over in ("area", "volume")]
                names = [f"{q.part}_{q.name}_{end}" for end in dict.fromkeys(ends)]
            numbers = [float(v) for n in names if isinstance(v := columns.get(n), int | float)]
            if len(numbers) == 1:
                return numbers[0]
            if numbers:
                return float(np.linalg.norm(numbers))
        name = f"{q.part}_{q.name}" if q.part else q.name
        raise q.unknown(
            "no result", name, [n for n, v in columns.items() if not isinstance(v, str)]
        )

    def _touching(self, nodes: IndexArray) -> IndexArray:
        """Owned cells with one of these owned nodes, also those of other ranks. Collective."""
        V = self._problem.V
        marks = fem.Function(V)
        width = V.dofmap.index_map_bs
        marks.x.array.reshape(-1, width)[nodes] = 1.0
        marks.x.scatter_forward()
        touched = marks.x.array.reshape(-1, width)[:, 0][V.dofmap.list] > 0
        cells = np.flatnonzero(touched.any(axis=1)).astype(np.int32)
        return cells[cells < len(self._problem.body.owned_cells())]


def tolerance(text: str) -> float:
    """A share such as "3%" or "0.03".

    Raises:
        InputError: It is no share between 0 and 1.
    """
    bare, percent = (text.strip()[:-1], 100.0) if text.strip().endswith("%") else (text, 1.0)
    try:
        share = float(bare) / percent
    except ValueError:
        share = float("nan")
    if not 0.0 < share < 1.0:
        raise InputError(f"'{text}' is no tolerance", where="--until", expected='for example "3%"')
    return share
