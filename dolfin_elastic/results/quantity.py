"""`Quantity`: one number that follows from a field of a state, and where it is found."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.parallel import LargestRow, largest_row
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import (
    PartNumbers,
    has_length,
    members,
)
from dolfin_elastic.results.derived.reductions import reduction_of
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS, component_names
from dolfin_elastic.results.probes import Probe
from dolfin_elastic.results.recovery.stress import StressRecovery

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

_AT_REST = {"jacobian": 1.0}
"""Value of a field whose difference from it tells which of two extremes is the larger one."""
EXTREMES = ("max", "min")
"""Reductions that have a place."""
_ROUND_OFF = 1e-14
"""Differences of det F that rounding decides; displacements and stresses are never so small but
where there are none."""


@dataclass(frozen=True)
class Measured:
    """A quantity of one state, the same on every rank.

    Attributes:
        value: In its SI unit; -inf or inf of an extreme where the field has no finite value.
        place: Node or barycentre of the cell of an extreme, or the point [m], reference
            configuration; empty of others.
        cell_size: About the edge length of the cells there [m].
        part: Name of the material region of an extreme of a stress or a field of cells.
    """

    value: float
    place: tuple[float, ...] = ()
    cell_size: float = float("nan")
    part: str = ""


@dataclass(frozen=True)
class Quantity:
    """One number that follows from a field.

    Extremes are sought among nodes, those of fields of cells among barycentres; means, integrals
    and percentiles are those of `PartNumbers`.

    Attributes:
        field: A name of `FIELDS`, or of one of its components, such as "displacement_x" or
            "cauchy_stress_xy".  Of several components their length is taken, of means and integrals
            that of the row of them.
        where: Name of a part, or for "at" a point of the undeformed body [m]; None: the whole body.
        reduction: "at", or a name of `REDUCTIONS`: "max", "mean", "percentile:95" ...

    Raises:
        InputError: There is no such field, or no such reduction.
    """

    field: str
    where: str | tuple[float, ...] | None = None
    reduction: str = "max"

    def __post_init__(self) -> None:
        if self.name not in FIELDS:
            raise InputError(f"there is no field '{self.name}'", expected=FIELDS.nearest(self.name))
        if not isinstance(self.where, tuple):
            field = FIELDS[self.name]
            names = component_names(self.name, field.columns)
            bare = self.field == self.name and len(names) > 1 and not has_length(self.name, field)
            if (
                reduction_of(self.reduction)[0].factor is None
                and bare
                and self.reduction not in EXTREMES
            ):
                raise InputError(f"'{self.field}' has no length", expected=f"such as '{names[0]}'")
        elif self.reduction != "at":
            raise InputError(f"unknown value '{self.reduction}'", expected="'at' of a point")

    @property
    def name(self) -> str:
        """Name of the field without that of a component."""
        stem = self.field.rpartition("_")[0]
        return stem if self.field not in FIELDS and stem in FIELDS else self.field

    def component(self, size: int) -> int | None:
        """Number of the component, of so many; None: the length of all.

        Raises:
            InputError: There is none of this name.
        """
        if self.field == self.name:
            return 0 if size == 1 else None
        names = component_names(self.name, size)
        if self.field not in names:
            raise InputError(
                f"there is no field '{self.field}'", expected=nearest(self.field, names)
            )
        return names.index(self.field)

    def scalars(self, rows: FloatArray) -> FloatArray:
        """The component or length of each row of the field."""
        number = self.component(rows.shape[1])
        return np.asarray(np.linalg.norm(rows, axis=1) if number is None else rows[:, number])

    def on(self, problem: Problem) -> Measurement:
        """How it is measured in the states of a problem. Collective.

        Raises:
            InputError: The field cannot be evaluated there.
            MeshError: The point lies outside, or there is no such part.
        """
        if isinstance(self.where, tuple):
            return AtPoint(self, problem)
        return (Extreme if self.reduction in EXTREMES else Integral)(self, problem)


class Measurement(ABC):
    """Evaluates a quantity in the states of a problem.  All of it is collective."""

    def __init__(self, quantity: Quantity, problem: Problem) -> None:
        self.quantity, self.problem = quantity, problem
        where = quantity.where
        self.part = where if isinstance(where, str) else None
        region = self.part is None or "region" in problem.body.kinds(self.part)
        self.kind = "region" if region else "surface"

    @abstractmethod
    def of(self, state: State) -> Measured:
        """The quantity of a state."""


class AtPoint(Measurement):
    """The value at a point, see `Probe`."""

    def __init__(self, quantity: Quantity, problem: Problem) -> None:
        super().__init__(quantity, problem)
        assert isinstance(quantity.where, tuple)
        self._probe = Probe(problem, {"at": quantity.where}, [quantity.name])

    def of(self, state: State) -> Measured:
        """See `Measurement`."""
        assert isinstance(self.quantity.where, tuple)
        (row,) = self._probe(state).values()
        place = self.quantity.where
        value = float(self.quantity.scalars(row[None])[0])
        return Measured(value, place, size_at(self.problem, place))


class Extreme(Measurement):
    """The largest or smallest value on a part, and its place.

    Args:
        evaluator: Of the field, among others; None: one of its own is made.

    Attributes:
        members: Owned nodes or cells among which it is sought.
    """

    def __init__(
        self, quantity: Quantity, problem: Problem, evaluator: Evaluator | None = None
    ) -> None:
        super().__init__(quantity, problem)
        field, self._sign = FIELDS[quantity.name], -1.0 if quantity.reduction == "min" else 1.0
        self.centre = field.centre
        self.members = members(problem, self.kind, self.part, field.centre)
        self._evaluator = evaluator or Evaluator(problem, [quantity.name])
        self._recovery = StressRecovery(problem) if field.recovered else None

    def of(self, state: State) -> Measured:
        """See `Measurement`."""
        return self.largest(state, self.values(state))

    def values(self, state: State) -> FloatArray:
        """Values of the members, of a smallest one their negatives; -inf where none is finite."""
        return self.values_in(self._evaluator(state))

    def values_in(self, evaluated: Mapping[str, AnyArray]) -> FloatArray:
        """The same of a state whose field is evaluated: its name to all owned rows."""
        rows = evaluated[self.quantity.name][self.members]
        values = self._sign * self.quantity.scalars(np.asarray(rows, dtype=np.float64))
        return np.where(np.isfinite(values), values, -np.inf)

    def largest(self, state: State, values: FloatArray, *, sized: bool = True) -> Measured:
        """What is measured where the members have these `values`.

        Args:
            sized: Also the size of the cells there, which takes a look at all of them.
        """
        problem, dim = self.problem, self.problem.body.dim

        def places(rows: IntArray) -> FloatArray:
            chosen = self.members[rows]
            if self.centre == "node":
                return problem.places[chosen, :dim]
            return np.asarray(cell_corners(problem.body.mesh, chosen).mean(axis=1))

        rest = self._sign * _AT_REST.get(self.quantity.name, 0.0)
        row = largest_row(problem.body.comm, values, places, least=_ROUND_OFF, about=rest)
        if row is None:
            return Measured(self._sign * -np.inf)
        size = size_at(problem, row.place) if sized else np.nan
        return Measured(self._sign * row.value, row.place, size, self._region(state, row))

    def _region(self, state: State, largest: LargestRow) -> str:
        """Name of the material region that the value belongs to; empty where that is none."""
        comm, name = self.problem.body.comm, ""
        stress = self._recovery(state) if self._recovery else None
        if comm.rank == largest.rank:
            row = self.members[largest.row]
            if stress is not None:
                safety = self.quantity.name == "safety_factor"
                numbers = stress.safety_region if safety else stress.region
                name = self.problem.regions[numbers[row]].name if numbers[row] >= 0 else ""
            elif self.centre == "cell":
                name = next((p.name for p in self.problem.regions if row in p.cells), "")
        return str(comm.bcast(name, root=largest.rank))


class Integral(Measurement):
    """A mean, integral or percentile over a surface, a region or the whole body."""

    def __init__(self, quantity: Quantity, problem: Problem) -> None:
        super().__init__(quantity, problem)
        one = [quantity.name], [quantity.reduction]
        self._numbers = PartNumbers(problem, self.kind, self.part, *one)

    def of(self, state: State) -> Measured:
        """See `Measurement`."""
        row, *length = self._numbers(state).values()
        if length and self.quantity.component(len(row)) is None:
            return Measured(float(length[0][0]))
        return Measured(float(self.quantity.scalars(row[None])[0]))


def size_at(problem: Problem, place: tuple[float, ...]) -> float:
    """About the edge length [m] of the cell whose middle is nearest to a place. Collective."""
    body, d = problem.body, problem.body.dim
    away = np.linalg.norm(cell_corners(body.mesh).mean(axis=1) - np.array(place), axis=1)
    local = (np.inf, 0.0)
    if len(away):
        nearest_one = int(np.argmin(away))
        local = (float(away[nearest_one]), float(cell_volumes(body.mesh)[nearest_one]))
    volume = min(body.comm.allgather(local))[1]
    return float((volume * (2.0 if d == 2 else 8.0)) ** (1 / d))


class Extremes:
    """Finds the extremes of states for the summary.  All of it is collective."""

    def __init__(self, problem: Problem) -> None:
        wanted = {
            "von_mises": Quantity("von_mises"),
            "displacement": Quantity("displacement"),
            "min_jacobian": Quantity("jacobian", reduction="min"),
            "max_jacobian": Quantity("jacobian"),
        }
        if any(part.law.allowable is not None for part in problem.regions):
            wanted["safety_factor"] = Quantity("safety_factor", reduction="min")
        self._evaluator = Evaluator(problem, sorted({one.name for one in wanted.values()}))
        self._found = {name: Extreme(one, problem, self._evaluator) for name, one in wanted.items()}

    def of(self, state: State) -> dict[str, Measured]:
        """Name to extreme.

        ``von_mises`` and ``displacement`` (largest), ``min_jacobian``, ``max_jacobian``, and where
        a material has an allowable stress the smallest ``safety_factor``.
        """
        evaluated = self._evaluator(state)  # each field once
        return {
            name: one.largest(state, one.values_in(evaluated), sized=False)
            for name, one in self._found.items()
        }
