"""Numbers with units: ``"1.2 MPa"`` becomes 1.2e6.

Inside the program everything is in SI units (m, kg, s, N, Pa).  A bare number is taken as it
stands, so a case written without any unit works in any consistent system.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, Union, get_args, get_origin

from pydantic import AfterValidator, BeforeValidator, GetCoreSchemaHandler
from pydantic_core import core_schema

from dolfin_elastic.core.errors import UnitError

if TYPE_CHECKING:
    import pint

_NUMBER = re.compile(
    r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    # A unit begins with a letter, or with 1/; "/K" alone divides by no name of a formula.
    r"(?:\s*((?:[^\W\d_]|[%°]).*?)|\s+(1\s*/.*?)|\s*(/\s*(?:K|degC|°C)))?\s*",
    re.DOTALL,
)
_EXPONENT = r"(?:\s*(?:\^|\*\*)\s*-?[0-9](?![0-9])|[²³])?"
_POWER = rf"(?:[^\W\d_]|[%°])+{_EXPONENT}"
_TIMES = r"(?:\s*[*/·.]\s*|\s+)"
_PRODUCT = rf"{_POWER}(?:{_TIMES}{_POWER})*"
_FACTOR = rf"(?:{_POWER}|\(\s*{_PRODUCT}\s*\){_EXPONENT})"
_UNIT = re.compile(rf"(?:1\s*/\s*)?{_FACTOR}(?:{_TIMES}{_FACTOR})*\s*")
"""Units handed to pint: names with one-digit powers, and products of them in parentheses, since it
would evaluate 9^9^9 for hours."""


MAX_UNIT_LENGTH = 40
"""Most characters of a unit."""

COMMON_UNITS = {
    "m": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "N/m^2": 1.0, "N/mm^2": 1e6},
    "kg/m^3": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "N/m^3": {"N/m^3": 1.0, "kN/m^3": 1e3},
    "N": {"N": 1.0, "kN": 1e3, "MN": 1e6, "mN": 1e-3},
    "N/m": {"N/m": 1.0, "kN/m": 1e3, "MN/m": 1e6, "N/mm": 1e3, "kN/mm": 1e6},
    "N*m": {"N*m": 1.0, "kN*m": 1e3, "MN*m": 1e6, "N*mm": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "rad/s": {"rad/s": 1.0, "rpm": math.tau / 60},
    "K": {"K": 1.0},
    "1/K": {"1/K": 1.0, "ppm/K": 1e-6},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "m/s^2": {"m/s^2": 1.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180},
}
"""Usual units, found without importing pint, which takes 0.3 s."""

_OTHER_UNITS = {
    "m": ("in", "ft"),
    "Pa": ("kN/m^2", "mPa", "psi", "bar"),
    "kg/m^3": ("t/m^3", "kg/cm^3", "g/mm^3", "kg/dm^3"),
    "N/m^3": ("N/mm^3", "MN/m^3"),
    "s": ("us", "hours", "days"),
    "rad/s": ("deg/s",),
    "K": ("degC", "°C"),
    "1/K": ("1/degC", "1/°C"),
    "m/s": ("km/h", "cm/s", "km/s"),
    "m/s^2": ("mm/s^2", "cm/s^2"),
    "Hz": ("MHz", "rpm"),
    "rad": ("mrad", "degrees"),
    "N": ("lbf",),
    "N/m": ("N/cm",),
    "N*m": ("N*cm",),
    "N*m/rad": ("N*m/rad", "kN*m/rad", "N*mm/rad"),
    "Pa*s": ("Pa*s", "kPa*s", "MPa*s", "GPa*s"),
    "N*s/m": ("N*s/m", "kN*s/m", "N*s/mm"),
    "N*s/m^3": ("N*s/m^3", "kN*s/m^3", "Pa*s/m"),
    "1/s": ("1/s", "Hz"),
    "m^3": ("m^3", "cm^3", "mm^3", "ml", "l"),
    "": ("%",),
}
"""Units that may have been meant, beside the usual ones."""

_LIKE, _VERY_LIKE = 0.6, 0.75
"""Likeness from which on a unit may be meant: in place of an unknown one, and of a known one."""

LENGTHS = {**COMMON_UNITS["m"], "in": 0.0254, "ft": 0.3048, "mil": 2.54e-5, "mi": 1609.344}

_METRIC = ("m", "mm", "cm", "dm", "km", "um", "µm", "μm", "nm")
MESH_UNITS = (*_METRIC, "in", "inch", "ft", "mil", "yd", "mi")
"""Units in which meshes come; any other length is more likely a slip."""


_SAME_PLACE = 1e-12
"""Coordinates up to this, over the largest, are 0."""
_NO_LENGTH = 1e-15
"""Length [m] that no body resolves: an atom has 1e-10 m."""


def coordinates(point: Iterable[float]) -> str:
    """A point or a direction, with four digits; no zero has a sign, nor round-off for digits."""
    numbers = [float(x) for x in point]
    least = max(_SAME_PLACE * max(map(abs, numbers), default=0.0), _NO_LENGTH)
    return "(" + ", ".join(f"{x if abs(x) > least else 0.0:.4g}" for x in numbers) + ")"


@dataclass(frozen=True)
class LengthUnit:
    """The unit of length of a mesh, in which people read lengths; metres where it has no name.

    Attributes:
        name: For messages: "mm", or "x 0.5 m" where it has no name.
        metres: Its length [m].
        stated: The file states it.
    """

    name: str = "m"
    metres: float = 1.0
    stated: bool = False

    @staticmethod
    def of(metres: float, *, stated: bool = False) -> LengthUnit:
        """The unit of a given length.

        Args:
            metres: Its length [m].
            stated: The file states it.
        """
        names = (name for name, length in LENGTHS.items() if length == metres)
        return LengthUnit(next(names, f"x {metres:g} m"), metres, stated)

    @property
    def _named(self) -> LengthUnit:
        return METRE if self.name.startswith("x ") else self

    def length(self, value: float, digits: int = 3, *, power: int = 1) -> str:
        """A length [m] for people, such as "2.5 mm"; of power 2 and 3 an area and a volume."""
        unit = self._named
        name = unit.name if power == 1 else f"{unit.name}^{power}"
        return f"{value / unit.metres**power:.{digits}g} {name}"

    def point(self, x: Iterable[float]) -> str:
        """A point [m] for people, such as "(16, 0, 10) mm"."""
        return f"{coordinates(c / self._named.metres for c in x)} {self._named.name}"


METRE = LengthUnit()


OWN_CONVERSIONS = {
    "Hz": {"rad/s": 1 / math.tau, "rpm": 1 / 60},
    "rad/s": {"Hz": math.tau},
    "K": {"degC": 1.0, "°C": 1.0},
}
"""Conversions that pint makes otherwise: revolutions per second, changes of temperature."""


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry:
    import pint  # 0.3 s: only where a case needs it

    return pint.UnitRegistry()


def stress_unit(largest: float) -> tuple[float, str]:
    """Unit in which people read a stress.

    Args:
        largest: The largest of the values that are shown together [Pa].

    Returns:
        The unit in Pa, and its name: Pa, kPa, MPa or GPa.
    """
    units = ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"))
    return next((unit for unit in units if largest >= unit[0]), (1.0, "Pa"))


def is_quantity(text: str) -> bool:
    """True for a number, bare or followed by a known unit: ``"2"``, ``"2 mm"``; no formula."""
    parts = _split(text)
    return parts is not None and (not parts[1] or _known(parts[1]))


def number_and_unit(value: object) -> tuple[float, str] | None:
    """A number, or a text with a number and a unit, as it is written; None of anything else."""
    if isinstance(value, str):
        return _split(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value), ""


def _split(text: str) -> tuple[float, str] | None:
    """Number and unit of a text; None if it is not of this form."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    return float(match[1]), match[2] or match[3] or (f"1{match[4]}" if match[4] else "")


def _known(unit: str) -> bool:
    if any(unit in units for units in COMMON_UNITS.values()):
        return True
    if len(unit) > MAX_UNIT_LENGTH or not _UNIT.fullmatch(unit):
        return False
    try:
        _registry().parse_units(unit)
    except Exception:  # pint raises many kinds for text that is no unit
        return False
    return True


def to_si(value: object, unit: str) -> float:
    """A number, or a text with a number and a unit, in SI units.

    Args:
        value: ``210e9``, ``"210e9"`` or ``"210 GPa"``.
        unit: SI unit of what is expected, for example ``"Pa"`` (``""``: a pure number).

    Returns:
        The value in `unit`.

    Raises:
        UnitError: Not a finite number, an unknown unit, or one that measures something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"{value!r} is not a number", expected=_expected(unit))
    if isinstance(value, str):
        return _finite(_from_text(value, unit), value)
    try:
        return _finite(float(value), value)
    except OverflowError:  # a whole number of more than 308 digits
        return _finite(math.inf, math.inf)


def unit_to_si(name: str, unit: str) -> float:
    """One of a unit in SI units.

    Raises:
        UnitError: It is unknown, or measures something else than `unit`.
    """
    try:
        return to_si(f"1 {name}", unit)
    except UnitError as error:
        what = error.what.replace(f" in '1 {name}'", "").replace(f"'1 {name}'", f"'{name}'")
        raise UnitError(what, expected=f"expected a unit of {unit}") from None


def _from_text(text: str, unit: str) -> float:
    if (parts := _split(text)) is None:
        raise UnitError(f"'{text}' is not a number", expected=_expected(unit))
    number, name = parts
    if not name:
        return number
    for table in (COMMON_UNITS, OWN_CONVERSIONS):
        if name in table.get(unit, ()):
            return number * table[unit][name]
    if not _known(name):
        meant = _meant(name, unit)
        raise UnitError(f"unknown unit '{name}' in '{text}'{meant}", expected=_expected(unit))
    if not _registry().Quantity(1.0, name).is_compatible_with(unit or "dimensionless"):
        meant = _meant(name, unit, _VERY_LIKE)  # to pint "kNm" is a fineness of yarn
        raise UnitError(f"'{text}' has the wrong unit{meant}", expected=_expected(unit))
    zero, size = _scale(text, name, unit)
    if zero != 0.0 and unit != "K":  # a number in kelvin is a change of temperature throughout
        raise UnitError(f"'{text}' counts from a zero of its own", expected=_expected(unit))
    return number * size * _frequency_factor(name, unit)


def _meant(name: str, unit: str | None, like: float = _LIKE) -> str:
    """Question after an unknown or wrong unit: the nearest of the right dimension, if any is.

    Args:
        name: As it was written.
        unit: SI unit of what is expected; None: any.
        like: Likeness from which on one is named.
    """
    wanted = {*COMMON_UNITS, *_OTHER_UNITS} if unit is None else {unit}
    tables = (COMMON_UNITS, _OTHER_UNITS)
    every = [one for key in sorted(wanted) for table in tables for one in table.get(key, ())]
    # Among those that differ in nothing but case or a missing ^, the first: MPa, not mPa.
    known = {_plain(one): one for one in reversed(every)}
    match = get_close_matches(_plain(name), known, n=1, cutoff=like)
    return f" (did you mean '{known[match[0]]}'?)" if match else ""


def _plain(unit: str) -> str:
    return unit.casefold().replace("**", "").replace("^", "").replace(" ", "")


def _frequency_factor(name: str, unit: str) -> float:
    """Factor between frequency and angular frequency; to pint both are 1/s."""
    if unit == "Hz" and "radian" in str(_registry().Quantity(1.0, name).to_root_units().units):
        return 1 / math.tau
    if unit == "rad/s" and "hertz" in str(_registry().parse_units(name)):
        return math.tau
    return 1.0


def _scale(text: str, name: str, unit: str | None) -> tuple[float, float]:
    """Offset and factor of the linear conversion from a unit.

    Args:
        text: As the user wrote it, for messages.
        name: Unit to convert from.
        unit: Unit to convert to; None: SI base units.

    Raises:
        UnitError: The conversion is not linear, as that of decibels.
    """
    quantities = [_registry().Quantity(x, name) for x in (0.0, 1.0, 2.0)]
    zero, one, two = (
        float((q.to_base_units() if unit is None else q.to(unit or "dimensionless")).magnitude)
        for q in quantities
    )
    # Round-off of a zero such as 273.15 K.
    if abs(two - 2 * one + zero) > 1e-9 * abs(one - zero):
        raise UnitError(
            f"'{text}' is on a scale whose steps are not equal",
            expected="a unit that is proportional to SI units",
        )
    return zero, one - zero


def to_base(value: float | str) -> float:
    """A number, or a text with a number and any unit, in SI base units: ``"2 kN/mm"`` is 2e6.

    Raises:
        UnitError: Not a finite number, or an unknown unit.
    """
    parts = _split(value) if isinstance(value, str) else None
    if parts is None or not parts[1]:
        return to_si(value, "")
    number, name = parts
    for units in COMMON_UNITS.values():
        if name in units:
            return _finite(number * units[name], value)
    if not _known(name):
        raise UnitError(
            f"unknown unit '{name}' in '{value}'{_meant(name, None)}",
            expected='for example "0.4 MPa"',
        )
    zero, size = _scale(str(value), name, None)
    if zero != 0.0:
        raise UnitError(
            f"'{value}' may be a temperature or a change of one", expected="the same in K"
        )
    return _finite(number * size, value)


def reading(value: float | str, unit: str, scale: str) -> float:
    """A number on a scale as it is, or a text with a unit on that scale; zeros count.

    So "20 degC" is 293.15 in K and 68 in degF, where `to_si` has a change of temperature.

    Args:
        unit: SI unit of what is expected.
        scale: Unit of the result, of the same kind.

    Raises:
        UnitError: See `to_si`.
    """
    plain = to_si(value, unit)
    parts = _split(value) if isinstance(value, str) else None
    if parts is None or not parts[1]:
        return plain
    to = scale or unit or "dimensionless"
    return _finite(float(_registry().Quantity(*parts).to(to).magnitude), value)


def _finite(number: float, written: object) -> float:
    if not math.isfinite(number):
        raise UnitError(
            f"{written!r} is not a finite number",
            expected="a number up to 1e308, no nan and no inf",
        )
    return number


_EXAMPLES = {
    "Pa": "210 GPa",
    "m": "2 mm",
    "kg/m^3": "1100 kg/m^3",
    "m/s^2": "9.81 m/s^2",
    "m/s": "3 m/s",
    "s": "0.1 s",
    "Hz": "440 Hz",
    "N/m^3": "10 kN/m^3",
    "N": "5 kN",
    "rad": "90 deg",
    "N/m": "2 kN/m",
    "rad/s": "3000 rpm",
    "K": "80 K",
    "1/K": "12 ppm/K",
}


LOAD_EXAMPLES = {"Pa": "2 kPa"}
"""Examples for loads, where those for materials are of another order of magnitude."""


def _expected(unit: str) -> str:
    example = _EXAMPLES.get(unit)
    if not unit:
        return "expected a pure number"
    return f"expected a number in {unit}" + (f', for example "{example}"' if example else "")


class SpatialValue(ABC):
    """A constant that varies in space: it has values, and bounds to check, only on a mesh.

    All comparisons are true, so that validators of bounds let it pass.
    """

    @property
    @abstractmethod
    def written(self) -> object:
        """As it stands in a case file."""

    def __gt__(self, other: object) -> bool:
        return True

    def __ge__(self, other: object) -> bool:
        return True

    def __lt__(self, other: object) -> bool:
        return True

    def __le__(self, other: object) -> bool:
        return True


@dataclass(frozen=True)
class Quantity:
    """Tells pydantic how a number in `unit` is read and written back.

    Attributes:
        unit: SI unit of the number.
        table: Record that may stand in its place; None: there is none.
    """

    unit: str
    table: type | None = None

    def read(self, value: object, bounded: Callable[[float], float]) -> object:
        """Reads a number in SI units, or a table; a `SpatialValue` is returned as it is.

        Args:
            value: As a user wrote it.

        Raises:
            UnitError: See `to_si`.
        """
        if self.table is not None and isinstance(value, Mapping):
            return self.table(**value)
        others = (SpatialValue, *([] if self.table is None else [self.table]))
        return value if isinstance(value, others) else bounded(to_si(value, self.unit))

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            self.read, handler(source), serialization=as_written
        )


class Temperature(Quantity):
    """A temperature [K] from absolute zero on: "20 degC" is 293.15."""

    def read(self, value: object, bounded: Callable[[float], float]) -> object:
        """See `Quantity.read`."""
        to_si(value, self.unit)
        assert isinstance(value, int | float | str)
        return bounded(reading(value, self.unit, self.unit))


def _as_written(value: object) -> object:
    return value.written if isinstance(value, SpatialValue) else value


as_written = core_schema.plain_serializer_function_ser_schema(_as_written)
"""For pydantic: writes a `SpatialValue` as it was read."""


def members_of(kind: object) -> list[object]:
    """The members of a union without what annotates them, or the type itself."""
    origin = get_origin(kind)
    if origin is Annotated:
        return members_of(get_args(kind)[0])
    if origin is Union or origin is UnionType:
        return [member for one in get_args(kind) for member in members_of(one)]
    return [kind]


def quantity(unit: str) -> Any:
    """A pydantic field type: a float in `unit` that may be written with any compatible unit."""
    return Annotated[float, Quantity(unit)]


if TYPE_CHECKING:
    Number: TypeAlias = float
    Length: TypeAlias = float
    Stress: TypeAlias = float
    Density: TypeAlias = float
    Acceleration: TypeAlias = float
    Velocity: TypeAlias = float
    Mass: TypeAlias = float
    Time: TypeAlias = float
    Frequency: TypeAlias = float
    Force: TypeAlias = float
    ForceDensity: TypeAlias = float
    Expansion: TypeAlias = float
    Viscosity: TypeAlias = float
    Rate: TypeAlias = float
else:
    Number = quantity("")
    Length = quantity("m")
    Stress = quantity("Pa")
    Density = quantity("kg/m^3")
    Acceleration = quantity("m/s^2")
    Velocity = quantity("m/s")
    Mass = quantity("kg")
    Time = quantity("s")
    Frequency = quantity("Hz")
    Force = quantity("N")
    ForceDensity = quantity("N/m^3")
    Expansion = quantity("1/K")
    Viscosity = quantity("Pa*s")
    Rate = quantity("1/s")


# --- lengths beside the mesh ---


def metres(value: float | str, scale: float) -> float:
    """A length beside the mesh in metres.

    Args:
        value: A number in the mesh's unit, also as a text, or a text with a unit.
        scale: Metres per unit of length of the mesh.
    """
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return to_si(value, "m")
    return value * scale


def no_switch(value: object) -> object:
    """For pydantic: no true or false in place of a length."""
    if isinstance(value, bool):
        raise ValueError('a number is needed, or a length such as "2 mm"')
    return value


def finite_length(value: float | str) -> float | str:
    """For pydantic: a length in the mesh's unit, or a text with a unit."""
    try:
        if not math.isfinite(metres(value, 1.0)):
            raise ValueError("a finite number is needed")
    except UnitError as error:
        if error.expected != _expected("m"):
            raise
        wanted = 'expected a number in the unit of the mesh, or a length such as "2 mm"'
        raise UnitError(error.what, expected=wanted) from None
    return value


def _positive(value: float | str) -> float | str:
    if not metres(value, 1.0) > 0:
        raise ValueError("should be positive")
    return value


MeshLength = Annotated[float | str, BeforeValidator(no_switch), AfterValidator(finite_length)]
"""A pydantic field type: a number in the mesh's unit, or a text with a unit; see `metres`."""
Size = Annotated[MeshLength, AfterValidator(_positive)]
"""The same, positive."""
