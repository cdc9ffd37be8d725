"""`identify`: values of a whole case from what was measured of the part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError, SolveError
from dolfin_elastic.core.parallel import led, on_root
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.si_text import listed, percent, quantity
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.study.identify.measured import Measured, MeasuredCurve, as_measured
from dolfin_elastic.study.identify.runs import Record, Runs
from dolfin_elastic.study.identify.unknowns import Unknown, read_unknowns
from dolfin_elastic.study.least_squares.certainty import Certainty, certainty
from dolfin_elastic.study.least_squares.fitted import (
    FittedConstant,
    constant_of,
    fitted_constants,
    rms,
)
from dolfin_elastic.study.least_squares.problem import LeastSquares
from dolfin_elastic.study.least_squares.remarks import remarks_on
from dolfin_elastic.study.least_squares.search import Answer, search

EVALUATIONS = 100
"""Largest number of steps from each start."""
_BETTER = 0.999
"""Sum of squares, over the least before, that is worth a line."""
_POOR = 0.2
"""R.m.s. error over the largest measured value above which a case does not describe it."""


@dataclass(frozen=True)
class ComparedSet:
    """What was measured beside the case that was fitted.

    Attributes:
        measured: A curve or a displacement field.
        computed: Of the case at the same points [SI], in the shape of the measured values.
        line: Of a curve x and y in all states of the run [SI]; None of a field.
    """

    measured: Measured
    computed: FloatArray
    line: tuple[FloatArray, FloatArray] | None = None

    @property
    def rms(self) -> float:
        """Root mean square of the differences, SI units."""
        return rms(self.computed - self.measured.values)

    @property
    def relative(self) -> float:
        """The same over the largest measured value."""
        return self.rms / float(np.abs(self.measured.values).max())

    @property
    def unit(self) -> str:
        """SI unit of what was measured."""
        return self.measured.y.unit if isinstance(self.measured, MeasuredCurve) else "m"


@dataclass(frozen=True)
class Identified:
    """A case fitted to what was measured.

    Attributes:
        case: With the values that were found.
        unknowns: What was sought.
        constants: The values, in the units in which the case has them.
        sets: What was measured beside the case.
        correlation: Of the values in their order, shape (k, k); nan beside those that cannot be
            told apart.
        unknown: What the measurements do not tell, a sentence each.
        notes: Further remarks.
        ended: The search has come to its end.
        why: How it has ended.
        starts: Starts of the search.
        same: How many of them have come to this answer.
        runs: Runs that it has taken.
    """

    case: Case
    unknowns: tuple[Unknown, ...]
    constants: tuple[FittedConstant, ...]
    sets: tuple[ComparedSet, ...]
    correlation: FloatArray
    unknown: tuple[str, ...]
    notes: tuple[str, ...]
    ended: bool
    why: str
    starts: int
    same: int
    runs: int

    @cached_property
    def values(self) -> dict[str, object]:
        """Keys to values as a case file has them, see `Case.changed`."""
        pairs = zip(self.unknowns, self.constants, strict=True)
        return {one.key: one.written(row.value) for one, row in pairs}

    def __getitem__(self, name: str) -> FittedConstant:
        """The value of a key; of an unknown one a KeyError that names the nearest."""
        return constant_of(self.constants, name)

    def __str__(self) -> str:
        rows = [f"{c.name} = {quantity(c.value, c.unit)}" for c in self.constants]
        errors = [f"{s.measured.label}: {percent(s.relative)} r.m.s." for s in self.sets]
        return "\n".join([*rows, *errors, *self.unknown, *self.notes])


def identify(
    case: Case,
    data: object,
    vary: Sequence[str],
    *,
    of: Sequence[str] = (),
    bounds: Mapping[str, object] | None = None,
    weights: Mapping[str, float] | None = None,
    starts: int = 1,
    evaluations: int = EVALUATIONS,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    told: Callable[[str], None] = lambda _: None,
) -> Identified:
    """Fits values of a whole case to curves and displacement fields.  Collective.

        found = identify(case, "curve.csv", ["materials.rubber.mu"], of=["t:reaction_x of right"])
        found["materials.rubber.mu"].interval

    Args:
        case: From `read_case`, or made in Python; its values are those from which the search
            starts.
        data: Path of a CSV file, a `MeasuredCurve` or `MeasuredField`, or a list of these.
        vary: Dotted keys of numbers of the case.
        of: "X:Y", the numbers of a run that a file has, see `as_measured`.
        bounds: Key to "LOW:HIGH" or a pair; by default the range of the law.
        weights: Name of a file to the weight of its mean square error; 1 by default.
        starts: Largest number of starts of the search.
        evaluations: Largest number of steps from each.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that compute one run together.
        told: Called on rank 0 with a line for each better state of the search.

    Raises:
        InputError: Something that was given is wrong.
        SolveError: The case has no solution with the values from which the search starts.
    """
    sets = on_root(comm, lambda: as_measured(data, of, weights))
    unknowns = read_unknowns(case, vary, bounds or {})
    runs = Runs(case, unknowns, sets, petsc, comm)
    first = np.array([one.constant.start for one in unknowns])
    runs.plan(first)
    runs.numbers(first)  # fails with its cause, before any search

    def together(asked: _Asked) -> tuple[FloatArray, FloatArray | None]:
        if asked.slopes is None:
            return runs.numbers(asked.values), None
        return runs.jacobian(asked.values, *asked.slopes)

    def lead(ask: _Ask) -> tuple[Answer, Certainty | None]:
        return _CaseModel(unknowns, runs.sets, ask, told).found(starts, evaluations)

    answer, known = led(comm, lead, together)
    model = _CaseModel(unknowns, runs.sets, together, told)
    record = runs.compared(answer.z * model.scale)
    return _result(runs, model, answer, known, record)


@dataclass(frozen=True)
class _Asked:
    """What the search wants next: numbers, and with scales and bounds their derivatives."""

    values: FloatArray
    slopes: tuple[FloatArray, FloatArray, FloatArray] | None = None


_Ask = Callable[[_Asked], tuple[FloatArray, FloatArray | None]]


class _CaseModel(LeastSquares):
    """The numbers of a case as functions of what is sought; those of runs that fail are nan.

    Args:
        ask: Has all ranks compute.
        told: See `identify`.
    """

    def __init__(
        self,
        unknowns: Sequence[Unknown],
        sets: Sequence[Measured],
        ask: _Ask,
        told: Callable[[str], None],
    ) -> None:
        super().__init__(
            [one.constant for one in unknowns],
            [one.values.ravel() for one in sets],
            [one.weight for one in sets],
            [one.label for one in sets],
        )
        self._ask, self._told = ask, told
        self._numbers = dict[bytes, FloatArray]()
        self._slopes = dict[bytes, FloatArray]()
        self._best: tuple[float, FloatArray] = (np.inf, self.start)

    def residuals(self, z: FloatArray) -> FloatArray:
        """See `LeastSquares`."""
        if (key := z.tobytes()) not in self._numbers:
            try:
                found, _ = self._ask(_Asked(z * self.scale))
            except (InputError, SolveError) as error:
                self._told(f"no solution with {self._text(z)}: a smaller step ({error})")
                found = np.full(len(self.measured), np.nan)
            self._keep(z, found)
        return np.asarray(self.weights * (self._numbers[key] - self.measured))

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """See `LeastSquares`."""
        if (key := z.tobytes()) not in self._slopes:
            s = self.scale
            found, slopes = self._ask(_Asked(z * s, (s, self.low * s, self.high * s)))
            assert slopes is not None
            self._keep(z, found)
            self._slopes[key] = self.weights[:, None] * slopes * s
        return self._slopes[key]

    def _keep(self, z: FloatArray, numbers: FloatArray) -> None:
        self._numbers[z.tobytes()] = numbers
        cost = float(np.sum((self.weights * (numbers - self.measured)) ** 2))
        if cost < self._best[0]:
            better = cost < _BETTER * self._best[0]
            self._best = cost, z.copy()
            if better:
                self._told(f"{percent(float(np.sqrt(cost)))} off: {self._text(z)}")

    def _text(self, z: FloatArray) -> str:
        rows = zip(self.free, z * self.scale, strict=True)
        return ", ".join(f"{row.name} = {quantity(value, row.unit)}" for row, value in rows)

    def no_start(self) -> SolveError:
        """See `LeastSquares`."""
        return SolveError(
            "the case has no solution near the values from which the search starts",
            advice="other values in the case, or --bounds",
        )

    def found(self, starts: int, evaluations: int) -> tuple[Answer, Certainty | None]:
        """The answer and what is known of it; the best so far of a search that breaks off."""
        try:
            answer = search(self, starts, evaluations)
            return answer, certainty(self, answer.z)
        except SolveError as error:
            cost, z = self._best
            if not np.isfinite(cost):
                raise
            return Answer(z, cost, False, str(error), starts, 1), None


def _result(
    runs: Runs, model: _CaseModel, answer: Answer, known: Certainty | None, record: Record
) -> Identified:
    values = answer.z * model.scale
    k = len(values)
    if known is None:
        none = np.full(k, np.nan)
        known = Certainty(none, np.full((k, k), np.nan), np.zeros(k, dtype=bool), (), np.zeros(k))
        unknown, notes = list[str](), list[str]()
    else:
        unknown, notes = remarks_on(model, answer.z, known, "measurements", "the case")
    sets = tuple(
        ComparedSet(one, part, record.of(one)[1:] if isinstance(one, MeasuredCurve) else None)
        for one, part in zip(runs.sets, runs.by_set(record), strict=True)
    )
    if record.failure:
        notes.append(f"the run with these values is not to be relied on: {record.failure}")
    if jump := runs.jump(values):
        notes.append(jump)
    return Identified(
        runs.changed(values),
        tuple(runs.unknowns),
        fitted_constants([one.constant for one in runs.unknowns], model, answer.z, known),
        sets,
        known.correlation,
        tuple(unknown),
        (*notes, *_doubts(sets), *runs.outside),
        answer.ended,
        answer.why,
        answer.starts,
        answer.same,
        runs.count,
    )


def _doubts(sets: Sequence[ComparedSet]) -> Iterator[str]:
    """What the case does not describe, and numbers whose unit nobody has given."""
    for one in sets:
        if one.relative > _POOR:
            yield (
                f"the case does not describe {one.measured.label}: the r.m.s. error is "
                f"{percent(one.relative)} of the largest value"
            )
    for one in sets:
        if bare := one.measured.bare:
            yield (
                f"{one.measured.source}: {listed(list(bare))} without a unit was read in SI units: "
                'write it in the heading, "force [kN]"'
            )
