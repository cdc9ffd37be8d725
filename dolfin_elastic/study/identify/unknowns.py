"""The values of a case that are sought: keys, units, ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dolfin_elastic.case.toml import key_parts
from dolfin_elastic.core.errors import CaseError, UnitError, nearest
from dolfin_elastic.core.units import number_and_unit, to_base, to_si
from dolfin_elastic.study.fit.constants import OTHER_NAMES, constants_of
from dolfin_elastic.study.least_squares.problem import Constant

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

_OF_MESH = ("mesh", "surfaces", "regions", "edges", "points")
"""Tables that decide on the mesh, which all runs of a fit have in common."""
_VARY = "--vary"


@dataclass(frozen=True)
class Unknown:
    """A value of a case that is sought.

    Attributes:
        constant: Its key as the name, and its range, in the unit in which the case has it.
        unit: That unit as it was written; empty: a bare number.
        size: One of it in SI units.
    """

    constant: Constant
    unit: str
    size: float = 1.0

    @property
    def key(self) -> str:
        """Dotted, as it was given."""
        return self.constant.name

    def written(self, value: float, digits: int = 0) -> object:
        """A value as a case file has it.

        Args:
            digits: How many are written; 0: all.
        """
        number = float(f"{value:.{digits}g}") if digits else float(value)
        return f"{number!r} {self.unit}" if self.unit else number


def read_unknowns(
    case: Case, vary: Sequence[str], bounds: Mapping[str, object]
) -> tuple[Unknown, ...]:
    """All that is sought. Not collective.

    Args:
        vary: Dotted keys, each of a number.
        bounds: Such a key, or its last part, to "LOW:HIGH" or a pair; either end may be empty or
            None.

    Raises:
        InputError: A key has no number, or bounds cannot be.
    """
    if not vary:
        raise CaseError(
            "nothing varies", where=_VARY, expected="for example --vary materials.rubber.E"
        )
    if twice := next((key for key in vary if list(vary).count(key) > 1), None):
        raise CaseError(f"{twice} is given twice", where=_VARY, expected="each key once")
    known = {name: key for key in vary for name in (key, key.rpartition(".")[2])}
    for name in bounds:
        if name not in known:
            raise CaseError(
                f"'{name}' does not vary", where="--bounds", expected=nearest(name, known)
            )
    limits = {known[name]: value for name, value in bounds.items()}
    return tuple(_unknown(case, key, limits.get(key)) for key in vary)


def _unknown(case: Case, key: str, limits: object) -> Unknown:
    value = case.value_at(key)
    read = number_and_unit(value)
    if key_parts(key)[0] in _OF_MESH:
        raise CaseError(
            f"{key} decides on the mesh, which all runs of a fit have in common",
            where=_VARY,
            expected="for example materials.rubber.E",
        )
    if read is None:
        raise CaseError(
            f"the case has {value!r} at {key}, which is no number to vary",
            where=_VARY,
            expected='a number, for example "1 MPa", from which the search starts',
        )
    start, unit = read
    one = 1.0 if not unit else to_base(f"1 {unit}")
    row = Constant(key, unit, start, -math.inf, math.inf, scale=abs(start) or 1.0)
    if (own := constant_at(case, key)) is not None:
        low, high = own.low / one, own.high / one
        row = replace(row, unit=unit or own.unit, low=low, high=high)
    return Unknown(row if limits is None else _bounded(row, unit, one, limits), unit, one)


def constant_at(case: Case, key: str) -> Constant | None:
    """Unit and range [SI] of a constant of a material; None: the key is of something else."""
    parts = key_parts(key)
    if parts[0] != "materials" or len(parts) < 3 or parts[1] not in case.materials:
        return None
    name = ""
    for part in parts[2:]:
        word = OTHER_NAMES.get(part, part)
        name += f"[{word}]" if word.isdigit() else f".{word}" if name else word
    rows = constants_of(case.materials[parts[1]].law)
    return next((row for row in rows if row.name == name), None)


def _bounded(row: Constant, unit: str, one: float, value: object) -> Constant:
    """A constant with bounds of the user's; bare numbers of them are in SI units."""
    parts = value.split(":") if isinstance(value, str) else value
    wrong = CaseError(
        f"{row.name}: '{value}' is not a least and a largest value",
        where="--bounds",
        expected=f'for example {row.name}="0.1 MPa:10 MPa"; either may be left out',
    )
    if not isinstance(parts, Sequence) or len(parts) != 2:
        raise wrong

    def read(text: object) -> float | None:
        if text is None or text == "":
            return None
        given = number_and_unit(text)
        if given is None:
            raise wrong
        return to_si(text, unit) if given[1] and unit else to_base(str(text)) / one

    try:
        low, high = map(read, parts)
    except UnitError as error:
        what = f"{row.name}: {error.what}"
        raise CaseError(what, where="--bounds", expected=error.expected) from None
    result = row.within(low, high)
    if not result.low < result.high:
        raise wrong
    return result
