"""Fitting the constants of a law to the curves of material tests."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import CaseError, InputError
from dolfin_elastic.core.si_text import listed, percent, quantity
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.isochoric import Isochoric
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.library import completed
from dolfin_elastic.study.fit.constants import chosen, guessed, marked_rows, with_numbers
from dolfin_elastic.study.fit.constrained import Condition, Constrained, PositiveShear
from dolfin_elastic.study.fit.curves import KINDS, TestCurve, as_curve, known_kind
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.model import Model
from dolfin_elastic.study.fit.remarks import remarks
from dolfin_elastic.study.fit.stable import Stability, stability
from dolfin_elastic.study.least_squares.certainty import certainty
from dolfin_elastic.study.least_squares.fitted import (
    FittedConstant,
    constant_of,
    fitted_constants,
    rms,
)
from dolfin_elastic.study.least_squares.problem import Constant
from dolfin_elastic.study.least_squares.search import Answer, search

STARTS, SLOW_STARTS, EVALUATIONS = 24, 4, 400
"""Largest number of starts, that of compressible laws and metals, and of steps from each."""
_NEARLY = 0.49
"""Poisson's ratio from which on a law of rubber is close to an incompressible one."""
_POOR = 0.2
"""R.m.s. error over the largest stress above which a law does not describe a test."""
_SOFT = 1e3
"""Young's modulus below which a unit may be wrong [Pa]: gelatine has some kPa."""
_SMALL = 1e-5
"""Strain at which Young's modulus is measured."""
_LINE = 120
"""Points of a curve of the law."""


@dataclass(frozen=True)
class FittedCurve:
    """A test beside the law that was fitted.

    Attributes:
        measured: The test.
        stress: Of the law at the same points [Pa], shape (n,).
        line: More points of the law's curve, x and stress; None: it is one over time or of steps.
    """

    measured: TestCurve
    stress: FloatArray
    line: tuple[FloatArray, FloatArray] | None = None

    @property
    def rms(self) -> float:
        """Root mean square of the differences [Pa]."""
        return rms(self.stress - self.measured.stress)

    @property
    def relative(self) -> float:
        """The same over the largest measured stress."""
        return self.rms / float(np.abs(self.measured.stress).max())


@dataclass(frozen=True)
class Fit:
    """A law fitted to curves.

    Attributes:
        law: With the fitted constants.
        table: Of the material from which it began, as it was written.
        constants: All constants of the law.
        curves: The tests beside it.
        correlation: Of the fitted constants in their order, shape (k, k); nan beside constants that
            the tests cannot tell apart.
        unknown: What the tests do not tell, and which test would, a sentence each.
        notes: Further remarks.
        ended: The search has come to its end.
        why: How it has ended.
        starts: Starts of the search.
        same: How many of them have come to this answer.
        model: Law and tests as functions of the constants over their scales.
        z: These.
        condition: That binds, "that of stability"; empty: none does. Intervals are those without
            it.
    """

    law: Law
    table: Mapping[str, object] = field(repr=False)
    constants: tuple[FittedConstant, ...]
    curves: tuple[FittedCurve, ...]
    correlation: FloatArray
    unknown: tuple[str, ...]
    notes: tuple[str, ...]
    ended: bool
    why: str
    starts: int
    same: int
    model: Model = field(repr=False)
    z: FloatArray = field(repr=False)
    condition: str = ""

    @cached_property
    def stability(self) -> tuple[str, ...]:
        """Where it is stable over the range of the tests, a sentence each."""
        return tuple(stability(self.law, self.model, self.z))

    @cached_property
    def fitted(self) -> tuple[FittedConstant, ...]:
        """The constants that are not held."""
        return tuple(row for row in self.constants if not row.held)

    def __getitem__(self, name: str) -> FittedConstant:
        """The constant of a name; of an unknown one a KeyError that names the nearest."""
        return constant_of(self.constants, name)

    def __str__(self) -> str:
        rows = [f"{c.name} = {c.value:.6g} {c.unit}".rstrip() for c in self.constants]
        errors = [f"{c.measured.kind}: {percent(c.relative)} r.m.s." for c in self.curves]
        return "\n".join([*rows, *errors, *self.unknown, *self.stability, *self.notes])


def fit(
    law: Law | Mapping[str, object],
    data: Mapping[str, object],
    *,
    fix: Collection[str] = (),
    bounds: Mapping[str, object] | None = None,
    weights: Mapping[str, float] | None = None,
    unit: str | None = None,
    true: bool = False,
    starts: int | None = None,
    evaluations: int = EVALUATIONS,
    stable: bool = False,
) -> Fit:
    """Fits the constants of a law to curves of material tests. Not collective.

    Args:
        law: A law, or a table of a case file. Its numbers are starting values; in a table "fit"
            stands for a constant without one. nu, K and lambda are held where no test is
            volumetric, unless they are "fit".
        data: Name of a kind of test, of `KINDS`, to the path of a CSV file, to arrays, to a
            `TestCurve`, or to a list of paths or curves.
        fix: Names of constants that keep their values.
        bounds: Name of a constant to its least and largest value, None: none.
        weights: Name of a kind of test to the weight of its mean square error; 1 by default.
        unit: Of stresses whose column has none; None: Pa, and a note for files.
        true: Stresses whose column does not say what they are, are Cauchy's.
        starts: Largest number of starts of the search; None: 24, of compressible laws and metals 4.
        evaluations: Largest number of steps from each.
        stable: The law is to be stable over the range of the tests, at the cost of larger errors.

    Raises:
        InputError: Something that was given is wrong.
        SolveError: The law has no stress at the points, or cannot have the constants found.
    """
    curves = read_curves(data, weights or {}, unit=unit, true=true)
    return fit_curves(
        start_of(law, curves),
        curves,
        fix=fix,
        bounds=bounds or {},
        starts=starts,
        evaluations=evaluations,
        stable=stable,
    )


def fit_curves(
    begin: Start,
    curves: Sequence[TestCurve],
    *,
    fix: Collection[str],
    bounds: Mapping[str, object],
    starts: int | None,
    evaluations: int,
    stable: bool = False,
) -> Fit:
    """The same of a law and of curves that have been read. Not collective.

    Args:
        begin: From `start_of`.
        curves: From `read_curves`.
        fix: And the others, see `fit`.

    Raises:
        InputError: A constant or its bounds are wrong, or the law has no answer to a test.
        SolveError: See `fit`.
    """
    constants = chosen(begin.law, curves, fix, bounds, begin.marked)
    start = with_numbers(begin.law, {row.name: row.start for row in constants if not row.held})
    model, twin = Model(start, curves, constants), _incompressible(start, constants)
    quick = isinstance(model.tests, HomogeneousTests) and model.tests.incompressible
    usual = SLOW_STARTS if twin is None and not quick else STARTS
    many = usual if starts is None else starts
    if twin is None:
        answer = search(model, many, evaluations)
    else:  # whose states are known at once: its constants are near
        first = search(Model(twin, curves, constants), many, evaluations)
        model.start = np.clip(first.z, model.low, model.high)
        answer = replace(search(model, 1, evaluations), starts=first.starts, same=first.same)
    condition: Condition | None = None
    if stable:
        condition = Stability(model, start)
    elif isinstance(start, Isochoric):
        condition = PositiveShear(model, start)
    found = answer if condition is None else Constrained(condition, answer, evaluations).answer
    result = _result(begin, start, model, constants, found)
    if condition is None or found.z is answer.z:
        return result
    cost = _cost(condition, answer.z, found.z)
    return replace(result, condition=condition.name, notes=(cost, *result.notes))


def _cost(condition: Condition, free: FloatArray, found: FloatArray) -> str:
    """What a condition costs: the errors without it and with it."""
    model = condition.model
    errors = [
        [
            percent(FittedCurve(curve, P).relative)
            for curve, P in zip(model.curves, model.by_curve(stresses), strict=True)
        ]
        for stresses in model.stresses(np.array([free, found]))
    ]
    both = (
        f"{curve.kind} {before} and {after}"
        for curve, before, after in zip(model.curves, *errors, strict=True)
    )
    return (
        f"without a condition {condition.without}; r.m.s. errors over the largest stress without "
        f"and with it: {', '.join(both)}; the intervals are those without it"
    )


def _incompressible(law: Law, constants: Sequence[Constant]) -> Law | None:
    """A law that is hardly compressible with nu = 0.5 in place of it; None: it is another one."""
    nu = next((row for row in constants if row.name == "nu" and row.held), None)
    if nu is None or not _NEARLY <= nu.start < 0.5 or not isinstance(law, Isochoric):
        return None
    return with_numbers(law, {"nu": 0.5})


@dataclass(frozen=True)
class Start:
    """What a fit starts from.

    Attributes:
        table: Of the material, as it was written.
        law: With guesses in place of "fit".
        marked: Names of the constants that are "fit".
    """

    table: Mapping[str, object]
    law: Law
    marked: Sequence[str] = ()


def start_of(law: Law | Mapping[str, object], curves: Sequence[TestCurve]) -> Start:
    """The law from which a fit starts.

    Args:
        law: See `fit`.
        curves: What guesses in place of "fit" follow from.

    Raises:
        InputError: The table is wrong, or a constant varies in space.
    """
    if isinstance(law, Law):
        start = Start(Material(law=law).table(), law)
    else:
        table = completed(law) if "material" in law else law
        start = Start(table, Material.read(guessed(table, curves)).law, marked_rows(table))
    for name in start.law.spatial_constants():
        raise CaseError("this constant varies in space", where=name, expected="a number")
    return start


def read_curves(
    data: Mapping[str, object],
    weights: Mapping[str, float],
    *,
    unit: str | None = None,
    true: bool = False,
) -> list[TestCurve]:
    """All curves, with their weights.

    Arguments: see `fit`.

    Raises:
        InputError: A file or a weight is wrong, or there is no curve.
    """
    curves = []
    for kind, given in data.items():
        known_kind(kind, f"--{kind}")
        paths = isinstance(given, list | tuple) and all(
            isinstance(one, str | Path | TestCurve) for one in given
        )
        for one in given if paths and isinstance(given, list | tuple) else [given]:
            curve = as_curve(kind, one, unit=unit, true=true)
            curves.append(replace(curve, weight=curve.weight * weights.get(kind, 1.0)))
    if not curves:
        raise CaseError(
            "there is no curve to fit",
            expected=f"for example --uniaxial test.csv; known: {', '.join(KINDS)}",
        )
    for kind, weight in weights.items():
        known_kind(kind, "--weight")
        if not (np.isfinite(weight) and weight > 0):
            raise CaseError(
                f"{kind}: {weight:g} is no weight", where="--weight", expected="above 0"
            )
        if kind not in data:
            raise CaseError(f"there is no {kind} test to weigh", where="--weight")
    return curves


def _result(
    begin: Start, start: Law, model: Model, constants: list[Constant], answer: Answer
) -> Fit:
    known = certainty(model, answer.z)
    values = dict(zip((row.name for row in model.free), answer.z * model.scale, strict=True))
    rows = fitted_constants(constants, model, answer.z, known)
    notes = list[str]()
    try:
        law = with_numbers(start, {name: float(x) for name, x in values.items()})
    except InputError as error:
        law = start.with_values({})
        notes.append(f"the law does not accept these constants: {error}")
        why = "the law does not accept its constants" if answer.ended else answer.why
        answer = replace(answer, ended=False, why=why)
    stresses = model.by_curve(model.stresses(answer.z[None])[0])
    curves = tuple(
        FittedCurve(c, P, _line(model, c, answer.z))
        for c, P in zip(model.curves, stresses, strict=True)
    )
    unknown, more = remarks(model, answer.z, known)
    return Fit(
        law,
        begin.table,
        rows,
        curves,
        known.correlation,
        tuple(unknown),
        (*notes, *more, *_doubts(curves, law, model, answer.z)),
        answer.ended,
        answer.why,
        answer.starts,
        answer.same,
        model,
        answer.z,
    )


def _doubts(curves: Sequence[FittedCurve], law: Law, model: Model, z: FloatArray) -> Iterator[str]:
    """Tests that the law does not describe, and stresses whose unit nobody has given."""
    for curve in curves:
        if curve.relative > _POOR:
            test = curve.measured
            yield (
                f"the law does not describe the {f'{test.kind} test {test.source}'.rstrip()}: its "
                f"r.m.s. error is {percent(curve.relative)} of the largest stress"
            )
    if bare := [c.measured.source for c in curves if c.measured.bare]:
        yield (
            f"the stresses of {listed(bare)} have no unit and were read in Pa: write it in the "
            'heading, "stress [MPa]", or give --unit'
        )
        E = _modulus(law, model, z)
        if abs(E) < _SOFT:
            yield (
                f"warning: Young's modulus at small strains is {quantity(E, 'Pa')}, below "
                "1 kPa: was --unit forgotten?"
            )


def _modulus(law: Law, model: Model, z: FloatArray) -> float:
    """Young's modulus at small strains [Pa]; nan where it is not known."""
    if (moduli := law.small_strain()) is not None:
        return float(moduli.E)
    if not isinstance(model.tests, HomogeneousTests):
        return np.nan
    x = np.array([1 - _SMALL, 1 + _SMALL])
    low, high = model.tests.predict(TestCurve("uniaxial", x, x), z[None] * model.scale)[0]
    return float(high - low) / (2 * _SMALL)


def _line(model: Model, curve: TestCurve, z: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The curve of the law from the rest to the last point."""
    if curve.time is not None or not isinstance(model.tests, HomogeneousTests):
        return None
    rest = curve.mode.rest
    x = np.linspace(min(rest, curve.x.min()), max(rest, curve.x.max()), _LINE, dtype=np.float64)
    return x, model.tests.predict(replace(curve, x=x), z[None] * model.scale)[0]
