"""Measured curves of material tests, and how they are read from CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import CaseError, InputError, UnitError, nearest
from dolfin_elastic.core.files.columns import CsvTable, heading, is_number, numbers, read_csv
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import unit_to_si
from dolfin_elastic.model.point.homogeneous_tests import DEFORMATION_MODES, DeformationMode


@dataclass(frozen=True)
class _Meaning:
    """What a column may be.

    Attributes:
        names: Headings of it, in small letters.
        unit: SI unit of its numbers.
        convert: From its numbers to those of `TestCurve`.
        true: They are Cauchy stresses.
    """

    names: tuple[str, ...]
    unit: str = ""
    convert: Callable[[FloatArray], FloatArray] = lambda x: x
    true: bool = False


_STRETCH = (
    _Meaning(("stretch", "lambda", "lambda_1", "lambda1", "λ")),
    _Meaning(
        ("strain", "nominal strain", "engineering strain", "epsilon"), convert=lambda x: 1 + x
    ),
    _Meaning(("true strain", "log strain", "logarithmic strain"), convert=np.exp),
)
_SHEAR = (_Meaning(("shear", "shear strain", "gamma", "γ", "strain")),)
_VOLUME = (
    _Meaning(("j", "volume ratio", "volume", "v/v0")),
    _Meaning(("volume strain", "volumetric strain", "dv/v"), convert=lambda x: 1 + x),
)
_TIME = (_Meaning(("time", "t"), "s"),)
_NOMINAL = (
    _Meaning(("stress", "nominal stress", "engineering stress", "p"), "Pa"),
    _Meaning(("true stress", "cauchy stress", "sigma", "σ"), "Pa", true=True),
)
_SHEAR_STRESS = (_Meaning(("stress", "shear stress", "nominal stress", "tau", "τ"), "Pa"),)
_MEAN = (
    _Meaning(("pressure", "p", "hydrostatic pressure"), "Pa", convert=np.negative),
    _Meaning(("stress", "mean stress", "hydrostatic stress"), "Pa"),
)

Column = tuple[str, tuple[_Meaning, ...]]
_OF_STRETCH: Column = ("stretch", _STRETCH)
_OF_STRESS: Column = ("stress", _NOMINAL)
_OF_TIME: Column = ("time", _TIME)


@dataclass(frozen=True)
class TestKind:
    """A kind of test.

    Attributes:
        what: It in words.
        mode: How it deforms the body.
        columns: What its files must have, in the order of files without headings.
        more: What they may have besides.
    """

    what: str
    mode: DeformationMode
    columns: tuple[Column, Column]
    more: tuple[Column, ...] = ()


_BAR, _BOTH_WAYS, _ONE_WAY, _SHEARED, _SWOLLEN = DEFORMATION_MODES
KINDS: Mapping[str, TestKind] = {
    "uniaxial": TestKind("tension or compression of a bar", _BAR, (_OF_STRETCH, _OF_STRESS)),
    "equibiaxial": TestKind("a sheet pulled both ways", _BOTH_WAYS, (_OF_STRETCH, _OF_STRESS)),
    "planar": TestKind("a wide sheet pulled one way", _ONE_WAY, (_OF_STRETCH, _OF_STRESS)),
    "shear": TestKind("simple shear", _SHEARED, (("shear", _SHEAR), ("stress", _SHEAR_STRESS))),
    "volumetric": TestKind(
        "a change of volume", _SWOLLEN, (("volume ratio", _VOLUME), ("pressure", _MEAN))
    ),
    "relaxation": TestKind(
        "a bar at a sudden stretch that stays", _BAR, (_OF_TIME, _OF_STRESS), (_OF_STRETCH,)
    ),
    "cyclic": TestKind("a bar strained to and fro", _BAR, (_OF_STRETCH, _OF_STRESS), (_OF_TIME,)),
}
"""Name of an option of the command line, and key of `fit`, to the test."""

_PULLED = ("uniaxial", "equibiaxial", "planar")
"""Tests whose stress has the sign of the strain."""
_SIGNS = {
    "shear": "stresses of the sign of the shear",
    "volumetric": "pressures above 0 where the volume is smaller, below J = 1",
    "relaxation": "stresses below 0 in compression, above in tension",
}
"""What is expected where signs are wrong, of tests whose columns cannot be mistaken."""
_ABOUT_REST = 0.9
"""A strain above this in all rows may be a stretch, which is 1 at rest."""


@dataclass(frozen=True)
class TestCurve:
    """What one test has measured, in the order in which it was.

    Attributes:
        kind: One of `KINDS`.
        x: Stretch, shear or volume ratio J, shape (n,).
        stress: Nominal stress, of volumetric tests the mean Cauchy stress [Pa], shape (n,).
        time: Times of these [s], shape (n,), of relaxation since the sudden stretch; None: slow.
        true: The stress is Cauchy's, a force over the current area.
        weight: Of its mean square error in the sum that is made least.
        source: Its file; empty: it was given in Python.
        bare: No unit of its stresses was given anywhere.
    """

    __test__ = False  # for pytest

    kind: str
    x: FloatArray
    stress: FloatArray
    time: FloatArray | None = None
    true: bool = False
    weight: float = 1.0
    source: str = ""
    bare: bool = False

    def __post_init__(self) -> None:
        """Refuses a curve without points."""
        if not len(self.x):
            where = self.source or self.kind
            raise CaseError("there are no points", where=where, expected="what was measured")

    @property
    def mode(self) -> DeformationMode:
        """How the body is deformed."""
        return KINDS[self.kind].mode

    @property
    def size(self) -> float:
        """Root mean square of the stresses [Pa]."""
        return float(np.sqrt(np.mean(self.stress**2)))

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """`x` at the ends of all steps from the rest, and their lengths [s], each of shape (s,).

        The last n are those to what was measured; the sudden stretch of a relaxation comes first.
        """
        t = np.zeros(len(self.x)) if self.time is None else self.time
        lengths = np.diff(t, prepend=min(float(t[0]), 0.0))
        if self.kind != "relaxation":
            return self.x, lengths
        return np.concatenate([self.x[:1], self.x]), np.concatenate([[0.0], lengths])


def known_kind(kind: str, where: str = "") -> TestKind:
    """The kind of a name.

    Raises:
        InputError: There is none; with the nearest.
    """
    if kind not in KINDS:
        hint = nearest(kind, KINDS)
        raise CaseError(f"'{kind}' is no kind of test", where=where, expected=hint)
    return KINDS[kind]


def as_curve(kind: str, data: object, *, unit: str | None = None, true: bool = False) -> TestCurve:
    """A curve of what a caller of `fit` gives.

    Args:
        data: A `TestCurve`, the path of a CSV file, or arrays: stretch or shear and stress; volume
            ratio and pressure; of relaxation time, stress and stretch; of cycles stretch, stress
            and possibly time.
        unit: Of stresses whose column has none; None: Pa.
        true: Stresses whose column does not say what they are, are Cauchy's.

    Raises:
        InputError: It has no such columns, or numbers that cannot be.
    """
    what = known_kind(kind)
    if isinstance(data, TestCurve):
        return data
    if isinstance(data, str | Path):
        return read_curve(kind, Path(data), unit=unit, true=true)
    assert isinstance(data, Sequence | np.ndarray)
    columns, found = (*what.columns, *what.more), {}
    for (name, meanings), values in zip(columns, data, strict=False):
        factor = unit_to_si(unit or "Pa", "Pa") if meanings[0].unit == "Pa" else 1.0
        found[name] = meanings[0].convert(factor * np.asarray(values, dtype=np.float64))
    names = [name for name, _ in columns]
    if len({len(values) for values in found.values()}) != 1 or len(found) < 2:
        raise CaseError(
            "columns of different lengths", where=kind, expected=f"arrays of {', '.join(names)}"
        )
    rows = [*range(1, len(found[names[0]]) + 1)]
    return _checked(kind, found, true, "", rows, {})


def read_curve(kind: str, path: Path, *, unit: str | None = None, true: bool = False) -> TestCurve:
    """A curve from a CSV file. Not collective.

    Args:
        kind: One of `KINDS`.
        unit: Of stresses whose heading has none, as "stress [MPa]" has; None: Pa.
        true: Stresses whose heading does not say what they are, are Cauchy's.

    Raises:
        InputError: With file, line and column.
    """
    what, file = known_kind(kind), str(path)
    try:
        default = unit_to_si(unit or "Pa", "Pa")
    except UnitError as error:
        raise CaseError(error.what, where="--unit", expected=error.expected) from None
    try:
        table = read_csv(path)
    except InputError as error:
        hint = error.expected.replace("paths are relative to the case file", "")
        raise CaseError(error.what, where=file, expected=hint) from None
    found, heads, is_true, bare = dict[str, FloatArray](), dict[str, str](), true, False
    for place, (name, meanings) in enumerate((*what.columns, *what.more)):
        at = _column(table, name, meanings, file, place, needed=place < 2)
        if at is None:
            continue
        index, meaning, given = at
        heads[name] = f"column '{table.head[index]}'" if table.head else f"column {index + 1}"
        numbers = _numbers(table, index, meaning, given, default, f"{file}: {heads[name]}")
        found[name] = meaning.convert(numbers)
        is_true |= meaning.true
        if meaning.unit == "Pa" and not given:
            bare = unit is None and any(is_number(row[index]) for _, row in table.rows)
        if meaning.unit == "Pa" and table.head and "nominal" in table.head[index].casefold():
            is_true = False
    curve = _checked(kind, found, is_true, file, [line for line, _ in table.rows], heads)
    return replace(curve, bare=bare)


def _plain(head: str) -> tuple[str, str]:
    """Name, in small letters, and unit of a heading."""
    name, unit = heading(head)
    return " ".join(name.replace("_", " ").casefold().split()), unit


def _column(
    table: CsvTable,
    name: str,
    meanings: Sequence[_Meaning],
    file: str,
    place: int,
    *,
    needed: bool,
) -> tuple[int, _Meaning, str] | None:
    """Index, meaning and unit of the column that holds something; None: there is none."""
    if table.head is None:
        width = len(table.rows[0][1]) if table.rows else 2
        return (place, meanings[0], "") if needed or place < width else None
    heads = [_plain(head) for head in table.head]
    for meaning in meanings:
        known = {one.replace("_", " ") for one in meaning.names}
        for index, (head, unit) in enumerate(heads):
            if head in known:
                return index, meaning, unit
    if not needed:
        return None
    wanted = [one for meaning in meanings for one in meaning.names]
    near = [nearest(head, wanted) for head, _ in heads]
    hint = next((one for one in near if one.startswith("did")), f"one of {', '.join(wanted)}")
    raise CaseError(
        f"no column has the {name}: {', '.join(table.head)}", where=f"{file}: line 1", expected=hint
    )


def _numbers(
    table: CsvTable, index: int, meaning: _Meaning, unit: str, default: float, where: str
) -> FloatArray:
    """A column in SI units, shape (n,).

    Args:
        unit: Of the heading; empty: none.
        default: One of the unit of a stress that has none [Pa].
        where: File and column.
    """
    factor = default if meaning.unit == "Pa" else 1.0
    if unit:
        try:
            factor = unit_to_si(unit, meaning.unit)
        except UnitError as error:
            hint = error.expected if meaning.unit else "a pure number, or %"
            raise CaseError(error.what, where=where, expected=hint) from None
    if not table.rows:
        raise CaseError("there are headings but no numbers", where=where)
    return numbers(table, index, meaning.unit, where, factor=factor)


def _checked(
    kind: str,
    found: dict[str, FloatArray],
    true: bool,
    file: str,
    rows: Sequence[int],
    heads: Mapping[str, str],
) -> TestCurve:
    """A curve whose numbers can be.

    Args:
        rows: Number of the line of each.
        heads: Columns by name, for messages.
    """
    first, second = (name for name, _ in KINDS[kind].columns)
    x, source = found[first], file or kind
    if kind == "relaxation":
        if "stretch" not in found:
            raise CaseError(
                "no column has the constant stretch of the bar",
                where=source,
                expected="a column 'stretch' beside time and stress",
            )
        x = found["stretch"]
    curve = TestCurve(kind, x, found[second], found.get("time"), true, source=file)
    what, ratios = "stretch" if kind == "relaxation" else first, kind != "shear"
    for name, values, least, words in (
        (what, curve.x if ratios else None, 0.0, "a stretch is a length over a length"),
        ("time", curve.time, -np.finfo(float).tiny, "times count from the sudden stretch"),
        (second, curve.stress, -np.inf, ""),
    ):
        if values is None:
            continue
        bad = np.flatnonzero(~(values > least) | ~np.isfinite(values))
        if len(bad):
            raise CaseError(
                f"line {rows[bad[0]]}: the {name} is {values[bad[0]]:g}",
                where=f"{source}: {heads.get(name, name)}",
                expected=f"above 0: {words}" if np.isfinite(least) else "a finite number",
            )
    if curve.time is not None and (np.diff(curve.time) < 0).any():
        line = rows[int(np.argmax(np.diff(curve.time) < 0)) + 1]
        where = f"{file}: {heads.get('time', 'time')}" if file else kind
        raise CaseError(f"line {line}: the time falls", where=where, expected="times that grow")
    if curve.size == 0:
        raise CaseError("all stresses are 0", where=source, expected="what was measured")
    if kind == "relaxation" and np.ptp(curve.x) > 1e-6:
        raise CaseError(
            "the stretch is not constant",
            where=source,
            expected="one stretch in all lines; cyclic follows any stretch over time",
        )
    at = heads.get(what, what)
    where, strain = f"{source}: {at}", "strain" in at.casefold()
    if kind in _PULLED:
        _check_rest(curve, where, strain)
    if kind != "cyclic":  # whose stress may push where the bar is longer, once it has flowed
        _check_signs(curve, where, strain)
    return curve


def _check_rest(curve: TestCurve, where: str, strain: bool) -> None:
    """Refuses a strain in the place of a stretch, and the reverse.

    Args:
        where: File and column of the stretch or strain.
        strain: By its heading it has strains, 0 at rest.

    Raises:
        InputError: The stress vanishes where nothing is at rest.
    """
    size = np.abs(curve.stress)
    order = np.argsort(size)
    if strain and (curve.x > 1 + _ABOUT_REST).all() and len(order) > 1:
        (x, next_x), (P, next_P) = curve.x[order[:2]], curve.stress[order[:2]]
        rest = x - P * (next_x - x) / (next_P - P) if next_P != P else x
        if abs(rest - 2) < 1 - _ABOUT_REST:
            raise CaseError(
                f"the stress vanishes at a strain of about {rest - 1:.2g}",
                where=where,
                expected="a strain, 0 at rest: is this column a stretch?",
            )
    if not strain and curve.x[order[0]] < 0.5 and size[order[0]] < 0.1 * size.max():
        raise CaseError(
            f"the stress nearly vanishes at a stretch of {curve.x[order[0]]:g}",
            where=where,
            expected="a stretch, 1 at rest: is this column a strain?",
        )


def _check_signs(curve: TestCurve, where: str, strain: bool) -> None:
    """Refuses stresses of the wrong sign, which no law has, such as pressures.

    Args:
        where: See `_check_rest`, as for `strain`.

    Raises:
        InputError: Most stresses pull where the bar is shorter or push where it is longer.
    """
    size, away = np.abs(curve.stress), curve.x - curve.mode.rest
    wrong = int(np.sum(curve.stress * away < 0))
    if 2 * wrong <= len(size):
        return
    if curve.kind in _SIGNS:
        hint = _SIGNS[curve.kind]
    else:
        grows = float(np.dot(size - size.mean(), np.abs(away) - np.abs(away).mean())) > 0
        ask = f"is this column a {'stretch' if strain else 'strain'}?"
        hint = f"stresses below 0 in compression, above in tension; {ask}" if grows else ask
    raise CaseError(
        f"{wrong} of {len(size)} stresses have the sign opposite to that of the strain",
        where=where,
        expected=hint,
    )
