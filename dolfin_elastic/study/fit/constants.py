"""Constants of a law that are fitted: names, units, ranges, starting values.

A constant of several values has one for each, "mu[0]"; parameters of a formula are
"parameters.c1", branches that relax "viscous[0].ratio" and "viscous[0].time", Voce's law
"hardening.rate".
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import ufl
from pydantic import BaseModel

from dolfin_elastic.case.tables import Material
from dolfin_elastic.case.toml import changed_tables, key_parts
from dolfin_elastic.core.errors import CaseError, InputError, UnitError, nearest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import to_base, to_si
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.plasticity import HardeningCurve, Plastic
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.spatial import Range, units_in_lists, units_of
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.least_squares.problem import Constant

FIT = "fit"
"""In the place of a constant: it is fitted, and has no starting value."""
OTHER_NAMES = {"lambda": "lmbda", "yield": "yield_stress", "prony": "viscous"}
OTHER_NAMES |= {"g": "ratio", "tau": "time"}
"""What tables may call constants and branches."""
VOLUME = ("nu", "K", "lmbda")
"""Constants of the change of volume, which only volumetric tests tell."""
_BESIDE = ("density", "expansion", "allowable", "viscosity", "plastic_viscosity")
"""Numbers of a law that no curve depends on, but for the last, which needs a rate."""
_VOCE = ("saturation", "rate", "slope")
_EXPONENT = Range(low=-20.0, high=20.0, low_too=True, high_too=True)
"""Of Ogden's law: larger ones fit the scatter of the last points."""
_INSIDE = 1e-9
"""Distance from a bound that does not belong to a range, over the size of the constant."""


def constants_of(law: Law) -> list[Constant]:
    """All numbers of a law that curves can depend on."""
    rows, ranges, units = [], law.ranges(), _units(type(law))
    for name, value in law.constants().items():
        if name in (*_BESIDE, *law.directions):
            continue
        unit, limits = units.get(name, ""), ranges.get(name, Range())
        if isinstance(value, list):
            rows += [_constant(f"{name}[{i}]", unit, x, limits) for i, x in enumerate(value)]
        else:
            rows.append(_constant(name, unit, value, limits))
    if (curve := _voce(law)) is not None:
        units = _units(HardeningCurve)
        for key in _VOCE:
            limits = Range.of(HardeningCurve.model_fields[key].metadata)
            value = float(getattr(curve, key))
            rows.append(_constant(f"hardening.{key}", units.get(key, ""), value, limits))
    for i, term in enumerate(law.viscous):
        limits = Range(low=0.0)
        rows.append(_constant(f"viscous[{i}].ratio", "", term.ratio, limits))
        rows.append(_constant(f"viscous[{i}].time", "s", term.time, limits))
    return rows


def _voce(law: Law) -> HardeningCurve | None:
    curve = law.hardening if isinstance(law, Plastic) else None
    return curve if isinstance(curve, HardeningCurve) and not curve.table else None


def _units(kind: type[BaseModel]) -> dict[str, str]:
    """SI units of the fields that are quantities, or lists of them."""
    return {**units_of(kind), **units_in_lists(kind)}


def _constant(name: str, unit: str, value: float, limits: Range) -> Constant:
    inside = _INSIDE * (abs(value) or 1.0)
    if name.startswith("alpha"):
        limits = _EXPONENT
    low = limits.low + (0.0 if limits.low_too else inside)
    high = limits.high - (0.0 if limits.high_too else inside)
    return Constant(name, unit, float(value), low, high)


# --- what is fitted ---


def chosen(
    law: Law,
    curves: Sequence[TestCurve],
    fix: Collection[str],
    bounds: Mapping[str, object],
    marked: Collection[str],
) -> list[Constant]:
    """All constants of a law, those that are held with the reason.

    Args:
        fix: Names of those that are held; "mu" holds all of a list.
        bounds: Name to least and largest value, None or empty: none.
        marked: Names of those that had no starting value.

    Raises:
        InputError: There is no constant of a name, bounds that cannot be, or nothing to fit.
    """
    rows = constants_of(law)
    for option, names in (("--fix", fix), ("--bounds", bounds)):
        for name in names:
            if not _named(rows, name):
                raise CaseError(
                    f"there is no constant '{name}' to fit",
                    where=option,
                    expected=nearest(name, _known(rows)),
                )
    for name in sorted({*marked} - {row.name for row in rows}):
        raise CaseError(
            f"there is no constant '{name}' to fit", expected=nearest(name, _known(rows))
        )
    held = {row.name for name in fix for row in _named(rows, name)}
    limits = {row.name: value for name, value in bounds.items() for row in _named(rows, name)}
    volumetric = any(curve.kind == "volumetric" for curve in curves)
    result, size = [], _stiffness(curves)
    for row in rows:
        why = ""
        if row.name in held and row.name in marked:
            raise CaseError(
                f"{row.name} is fixed but has no value",
                where="--fix",
                expected='its value in place of "fit"',
            )
        if row.name in held:
            why = "fixed by --fix"
        elif row.name in VOLUME and not volumetric and row.name not in {*marked, *limits}:
            why = "fixed: only a volumetric test shows it"
        elif not _given(law, row.name) and row.name not in {*marked, *limits}:
            why = "fixed: its default"
        new = _bounded(row, limits[row.name]) if row.name in limits else row
        scale = abs(new.start) or (size if new.unit == "Pa" else 1.0)
        result.append(replace(new, held=why, scale=scale))
    if all(row.held for row in result):
        reasons = ", ".join(f"{row.name} ({row.held})" for row in result)
        raise CaseError(f"nothing is left to fit: {reasons}", where="--fix")
    return result


def _given(law: Law, name: str) -> bool:
    """Whether a constant is in the law's table."""
    head, _, key = name.partition(".")
    if head == "hardening" and key and (curve := _voce(law)) is not None:
        return key in curve.model_fields_set
    return head.partition("[")[0] in law.model_fields_set


def _names(row: Constant) -> tuple[str, str]:
    """Without index, and behind the last dot: "mu" of "mu[0]"; "c1" of "parameters.c1"."""
    first = row.name.removeprefix("parameters.").partition("[")[0]
    return first.partition(".")[0], row.name.rpartition(".")[2]


def _known(rows: Sequence[Constant]) -> list[str]:
    return list(dict.fromkeys(x for row in rows for x in (row.name, *_names(row))))


def _named(rows: Sequence[Constant], name: str) -> list[Constant]:
    exact = [row for row in rows if row.name == name]
    return exact or [row for row in rows if name in _names(row)]


def _bounded(row: Constant, value: object) -> Constant:
    """A constant with bounds of the user's, "0.1 MPa:10 MPa" or a pair.

    Raises:
        InputError: They cannot be.
    """
    parts = value.split(":") if isinstance(value, str) else value
    wrong = CaseError(
        f"{row.name}: '{value}' is not a least and a largest value",
        where="--bounds",
        expected='for example mu="0.1 MPa:10 MPa"; either may be left out',
    )
    if not isinstance(parts, Sequence) or len(parts) != 2:
        raise wrong
    try:
        low, high = (None if x is None or x == "" else _number(row, x) for x in parts)
    except UnitError as error:
        raise CaseError(
            f"{row.name}: {error.what}", where="--bounds", expected=error.expected
        ) from None
    result = row.within(low, high)
    if not result.low < result.high:
        raise wrong
    return result


def _number(row: Constant, value: object) -> float:
    assert isinstance(value, int | float | str)
    return to_base(value) if row.name.startswith("parameters.") else to_si(value, row.unit)


# --- laws of numbers, and with symbols ---


class SymbolicLaw:
    """A law whose numbers have become UFL constants.

    Attributes:
        law: With these.
        names: Of the scalars, in the order of the rows that `arrays` takes.
        symbols: The UFL constants, scalars and vectors.
    """

    def __init__(self, law: Law, names: Sequence[str]) -> None:
        domain = gradient_symbol().ufl_domain()

        def symbol(value: float | list[float]) -> ufl.Constant:
            return ufl.Constant(domain, np.shape(value))

        bound = law.bind(symbol, {}, {}, None)
        self.law, self.names = bound.law, list(names)
        tops = dict(bound.constants)
        if (curve := _voce(law)) is not None:
            parts = {key: symbol(0.0) for key in _VOCE}
            self.law = self.law.with_values({"hardening": curve.model_copy(update=parts)})
            tops |= {f"hardening.{key}": part for key, part in parts.items()}
        self.symbols, self._given = list(tops.values()), law.constants()
        self._tops = list(tops)
        if curve is not None:
            self._given |= {f"hardening.{key}": getattr(curve, key) for key in _VOCE}

    def arrays(self, rows: FloatArray) -> list[FloatArray]:
        """Values of the symbols, each of shape (m, *shape).

        Args:
            rows: Of `names`, shape (m, k); the other constants have the law's own numbers.
        """
        result = []
        for top in self._tops:
            given = np.asarray(self._given[top], dtype=np.float64)
            array = np.array(np.broadcast_to(given, (len(rows), *given.shape)))
            for column, name in enumerate(self.names):
                head, _, index = name.partition("[")
                if name == top:
                    array[:] = rows[:, column]
                elif head == top and index.rstrip("]").isdigit():
                    array[:, int(index.rstrip("]"))] = rows[:, column]
            result.append(array)
        return result


def with_numbers(law: Law, numbers: Mapping[str, float]) -> Law:
    """The law with other numbers, read as from a case file.

    Raises:
        InputError: The law cannot have them.
    """
    return Material.read(table_with(law, numbers)).law


def table_with(law: Law, numbers: Mapping[str, object]) -> dict[str, object]:
    """A law's table with other values of some constants."""
    return changed_tables(Material(law=law).table(), numbers, frozenset())


def place_in(table: Mapping[str, object], name: str) -> tuple[str, object]:
    """Dotted key of a constant in a material's table, by the names that this has, and its value.

    Args:
        name: As `constants_of` has it.

    Returns:
        The value is None of a constant that the table leaves out.
    """
    inner, path = cast(object, table), ""
    for part in key_parts(name):
        if isinstance(inner, Mapping):
            known = (key for key in inner if OTHER_NAMES.get(key, key) == part)
            key = next(known, part)
            inner, path = inner.get(key), f"{path}.{key}" if path else key
        elif isinstance(inner, list | tuple):
            inner, path = inner[int(part)], f"{path}[{part}]"
    return path, inner


# --- constants without a starting value ---


def marked_constants(table: Mapping[str, object]) -> Iterator[str]:
    """Names of the values of a material's table that are "fit"."""
    return (name for name, text in _texts(table) if text == FIT)


def marked_rows(table: Mapping[str, object]) -> list[str]:
    """The same, by the names that `constants_of` has."""
    names = marked_constants(table)
    return [re.sub(r"\w+", lambda m: OTHER_NAMES.get(m[0], m[0]), name) for name in names]


def _texts(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Names and texts of a table, of what is inside it, too."""
    if isinstance(value, str):
        yield name, value
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from _texts(part, f"{name}.{key}" if name else key)
    elif isinstance(value, list | tuple):
        for i, part in enumerate(value):
            yield from _texts(part, f"{name}[{i}]")


_NAMES = ("law", "on", "energy", "source", "material")
"""Texts of a material's table that stand for no number."""


_EXPONENTS = (2.0, -2.0, 5.0, -5.0, 9.0)
_BEYOND = 1.3
"""Of a limit of extension over the largest one that was measured."""


def guessed(table: Mapping[str, object], curves: Sequence[TestCurve]) -> dict[str, object]:
    """A material's table with first guesses in place of "fit": of the order of what is measured.

    Args:
        curves: What the sizes of moduli and times follow from.

    Raises:
        InputError: "fit" is misspelt, or a parameter of a formula, of which nothing is known, has
            no value.
    """
    for name, text in _texts(table):
        if text != FIT and name not in _NAMES and (hint := nearest(text, [FIT])).startswith("did"):
            raise InputError(f"'{text}' is neither a number nor \"fit\"", where=name, expected=hint)
    names, values = [*marked_constants(table)], dict[str, object]()
    sizes, times = _sizes(curves), [c.time for c in curves if c.time is not None]
    last = float(times[0][-1]) if times else 1.0
    first = max(float(times[0][0]), 1e-3 * last) if times else 1e-3
    terms = [name for name in names if name.endswith((".time", ".tau"))]
    for name in names:
        key = name.rpartition(".")[2].partition("[")[0]
        index = int(found[1]) if (found := re.search(r"\[(\d+)\]$", name)) else 0
        if name.startswith("parameters."):
            raise InputError(
                "a parameter of a formula needs a value to start from",
                where=name,
                expected='for example "0.1 MPa", of the order that it may have',
            )
        value = sizes[key] if key in sizes else _middle(table, key, sizes["mu"])
        exponent = _EXPONENTS[index % len(_EXPONENTS)]
        if name in terms:
            value = first * (last / first) ** ((terms.index(name) + 1) / (len(terms) + 1))
        elif key == "alpha":  # with the sign of the modulus
            value = abs(exponent) * _sign(table, "mu", index, exponent)
        elif name.startswith("mu["):
            value *= _sign(table, "alpha", index, exponent) / (1 + index)
        elif key == "limit":
            I1 = 3 + max(_excess(curve) for curve in curves)
            value = _BEYOND * ((I1 - 3) if table.get("law") == "gent" else np.sqrt(I1 / 3))
        values[name] = float(value)
    return changed_tables(table, values, frozenset())


def _sign(table: Mapping[str, object], key: str, index: int, exponent: float) -> float:
    """Of the value of a list, of Ogden's law; of an exponent where it has none."""
    values = table.get(key)
    given = values[index] if isinstance(values, list) and index < len(values) else FIT
    try:
        return float(np.sign(to_si(given, "" if key == "alpha" else "Pa")))
    except UnitError:  # "fit", or what the law refuses
        return float(np.sign(exponent))


def _middle(table: Mapping[str, object], key: str, modulus: float) -> float:
    """A guess of a constant of which only the unit and the range are known."""
    law = MATERIALS.get(str(table.get("law")))
    info = None if law is None else law.model_fields.get(key)
    if law is None or info is None:
        return 1.0
    if _units(law).get(key) == "Pa":
        return modulus
    limits = Range.of(info.metadata)
    middle = (limits.low + limits.high) / 2
    return middle if np.isfinite(middle) else 1.0


def _sizes(curves: Sequence[TestCurve]) -> dict[str, float]:
    """Constants of the usual names in bodies as stiff as those that were measured [SI]."""
    mu = _stiffness(curves)
    most = max(float(np.abs(curve.stress).max()) for curve in curves)
    ratios = {"nu": 0.45, **dict.fromkeys(("nu12", "nu13", "nu23", "ratio", "g"), 0.3)}
    stiff = dict.fromkeys(("E", "E1", "E2", "E3"), 3 * mu)
    stiff |= dict.fromkeys(("K", "lmbda", "lambda"), 1e3 * mu)
    soft = dict.fromkeys(("mu", "c10", "c01", "k1", "C"), mu)
    higher = dict.fromkeys(("c20", "c30"), 1e-3 * mu)
    metal = dict.fromkeys(("hardening", "kinematic", "slope"), 0.03 * mu)
    yields = {"yield": most / 2, "yield_stress": most / 2, "saturation": most, "rate": 20.0}
    return {**stiff, **soft, **higher, **metal, **yields, **ratios}


def _excess(curve: TestCurve) -> float:
    """Largest I1 - 3 of an incompressible body in a test."""
    if curve.kind == "shear":
        return float((curve.x**2).max())
    thin = {"equibiaxial": -2.0, "planar": -1.0}.get(curve.kind, -0.5)
    s = curve.x if curve.kind != "volumetric" else np.ones(1)
    return float((s**2 + s ** (2 * thin) + s ** (-2 - 2 * thin) - 3).max())


def _stiffness(curves: Sequence[TestCurve]) -> float:
    """About a third of the first slope of the curves [Pa]."""
    slopes = []
    for curve in curves:
        strain = np.abs(curve.x - curve.mode.rest)
        first = np.flatnonzero(strain > 0)[:3]
        if curve.kind != "volumetric" and len(first):
            ratio = np.abs(curve.stress[first]) / strain[first]
            slopes.append(float(np.median(ratio)) / (1 if curve.kind == "shear" else 3))
    return float(np.median(slopes)) if slopes else 1e6
