"""Constants of materials that vary in space: formulas of the place and of fields of the mesh.

A constant of a law is a number; or a text such as ``"1e9*(1 - 0.5*z/0.1)"`` in x, y, z [m] and in
the names of scalar fields of the mesh, which gives SI units; or a field as it is,
``{field = "E_cell", unit = "MPa"}``.  In Python it may also be a scalar DOLFINx function, or an
array with a value for each cell.  What a name means is known only on a body, to which
`dolfin_elastic.problem.coefficients` binds the law.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args

import annotated_types
import numpy as np
import ufl
from pydantic import AliasChoices, BaseModel, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import core_schema
from ufl import Coefficient
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, all_errors, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.formula_functions import CONSTANTS, FUNCTIONS
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import AXES, unit_vector
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import (
    Quantity,
    SpatialValue,
    as_written,
    is_quantity,
    to_si,
)
from dolfin_elastic.model.values import FieldTable, field_table, misspelt_unit

PLACE = ("x", "y", "z")
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*", re.ASCII)


def usable(names: Iterable[str]) -> list[str]:
    """Names that can be used in a formula: identifiers that are not taken."""
    taken = {*CONSTANTS, *FUNCTIONS, *PLACE}
    return [name for name in names if _NAME.fullmatch(name) and name not in taken]


@dataclass(frozen=True)
class SpatialFormula(SpatialValue):
    """A formula in coordinates and mesh fields, to be evaluated on a mesh.

    Attributes:
        text: As it was written.
        unit: SI unit of its values.
    """

    text: str
    unit: str = ""

    @property
    def written(self) -> str:
        """As it stands in a case file."""
        return self.text

    def known(self, fields: Iterable[str]) -> Formula:
        """The formula parsed against the fields of a mesh.

        Raises:
            InputError: A name is neither a coordinate nor a field.
        """
        fields = [*fields]
        if not fields and _NAME.fullmatch(self.text) and self.text not in PLACE:
            to_si(self.text, self.unit)  # raises: without fields a single word is a bad number
        return Formula.parse(self.text, allowed=[*PLACE, *usable(fields)])


@dataclass(frozen=True)
class SpatialField(SpatialValue):
    """The values of a field of the mesh.

    Attributes:
        table: As it was written.
        factor: SI units per unit.
    """

    table: FieldTable
    factor: float = 1.0

    @property
    def field(self) -> str:
        """Its name, see `FieldTable.key`."""
        return self.table.key

    @property
    def written(self) -> dict[str, object]:
        """As it stands in a case file."""
        return self.table.model_dump(exclude_defaults=True)


@dataclass(frozen=True, eq=False)
class SpatialFunction(SpatialValue):
    """The values of a function on the mesh, taken where a problem is made.

    Attributes:
        function: A scalar DOLFINx function [SI].
    """

    function: Coefficient

    @property
    def written(self) -> str:
        """Its name: no case file can hold it."""
        return f"function {self.function}"


@dataclass(frozen=True, eq=False)
class SpatialCells(SpatialValue):
    """A value for each cell.

    Attributes:
        values: In the order of this rank's cells, of the owned ones or of all [SI], shape (n,).
    """

    values: FloatArray

    @property
    def written(self) -> str:
        """What it is: no case file can hold it."""
        return "values of elements"


@dataclass(frozen=True)
class SpatialDirection(SpatialValue):
    """A direction: three components, of which at least one is a formula."""

    components: tuple[float | SpatialFormula, ...]

    @property
    def written(self) -> list[object]:
        """As it stands in a case file."""
        return [getattr(item, "written", item) for item in self.components]


def constant(value: object, unit: str | None) -> object:
    """Reads a constant that may vary in space; any other value is returned unchanged.

    Args:
        value: As a user wrote it.
        unit: SI unit of the constant; None: it may have any.

    Raises:
        InputError: What cannot be right on any mesh.
    """
    if isinstance(value, Mapping):
        return _field(value, unit)
    if isinstance(value, Coefficient):
        return _function(value)
    if isinstance(value, np.ndarray) and value.ndim:
        return _cells(value)
    if not isinstance(value, str) or is_quantity(value) or misspelt_unit(value, PLACE):
        return value
    # Any name may be a field's: other errors of the formula are raised before a mesh is read.
    names = {*PLACE, *usable(_NAME.findall(value))}
    formula = Formula.parse(value, allowed=names)
    return SpatialFormula(value, unit or "") if formula.names else float(formula.evaluate())


def _function(value: Coefficient) -> SpatialFunction:
    if value.ufl_shape:
        raise InputError(
            f"a function of shape {value.ufl_shape}", expected="expected a scalar function"
        )
    return SpatialFunction(value)


def _cells(values: FloatArray) -> SpatialCells:
    if values.ndim != 1 or values.dtype.kind not in "fiu":
        raise InputError(
            f"an array of shape {values.shape} and type {values.dtype}",
            expected="expected a real number for each element of this rank",
        )
    return SpatialCells(np.array(values, dtype=np.float64))


def _field(value: Mapping[str, object], unit: str | None) -> SpatialField:
    table, factor = field_table(value, unit)
    return SpatialField(table, factor)


def constants(kind: type[BaseModel], table: Mapping[str, object]) -> dict[str, object]:
    """A law's table with its spatially varying constants read.

    Args:
        table: Keys and values as a user wrote them.

    Raises:
        InputError: See `constant`; the key is named.
    """
    units, tables, read = units_of(kind), _with_table(kind), {}
    with all_errors() as attempt:
        for key, value in table.items():
            known = key in units
            if key in tables and isinstance(value, Mapping) and "field" not in value:
                known = False
            with attempt(), keyed(key):
                read[key] = constant(value, units[key]) if known else value
    return read


class SpatialRecord(Record):
    """A record whose quantities may vary in space."""

    @model_validator(mode="before")
    @classmethod
    def _read_varying(cls, data: object) -> object:
        return constants(cls, data) if isinstance(data, dict) else data


@lru_cache
def units_of(kind: type[BaseModel]) -> dict[str, str]:
    """Key, other spellings included, to SI unit, for the fields that are single quantities."""
    units = {}
    for name, info in kind.model_fields.items():
        if (unit := _unit(info)) is not None:
            alias = info.validation_alias
            others = alias.choices if isinstance(alias, AliasChoices) else ()
            units.update(dict.fromkeys([name, *map(str, others)], unit))
    return units


@lru_cache
def units_in_lists(kind: type[BaseModel]) -> dict[str, str]:
    """Key to SI unit, for the fields that are lists of quantities such as `list[Length] | None`."""
    return {
        name: one.unit
        for name, info in kind.model_fields.items()
        for choice in (info.annotation, *get_args(info.annotation))
        for item in get_args(choice)
        for one in getattr(item, "__metadata__", ())
        if isinstance(one, Quantity)
    }


@lru_cache
def _with_table(kind: type[BaseModel]) -> frozenset[str]:
    """Names of the fields in whose place a table may stand that is no field of the mesh."""
    rows = kind.model_fields.items()
    return frozenset(n for n, info in rows if (q := _quantity(info)) and q.table is not None)


def _unit(info: FieldInfo) -> str | None:
    quantity = _quantity(info)
    return None if quantity is None else quantity.unit


def _quantity(info: FieldInfo) -> Quantity | None:
    metadata = [*info.metadata]
    for choice in get_args(info.annotation):  # of `Density | None`
        metadata += getattr(choice, "__metadata__", ())
    return next((item for item in metadata if isinstance(item, Quantity)), None)


# --- directions ---


class _Direction:
    """Reads ``"x"``, ``[1, 0, 0]``, ``["cos(z)", "sin(z)", 0]`` or ``{field = "fibre"}``."""

    def read(self, value: object) -> tuple[float, ...] | SpatialValue:
        if isinstance(value, SpatialValue):
            return value
        if isinstance(value, Mapping):
            return _field(value, "")
        if isinstance(value, str) and value in AXES:
            return unit_vector(value)
        if not isinstance(value, list | tuple) or len(value) not in (2, 3):
            raise InputError(
                f"{value!r} is not a direction",
                expected='expected "x", [1, 0, 0], formulas, or {field = "fibre"}',
            )
        items = tuple(self._component(i, item) for i, item in enumerate([*value, 0.0][:3]))
        if any(isinstance(item, SpatialFormula) for item in items):
            return SpatialDirection(items)
        vector = np.array(items, dtype=np.float64)
        length = float(np.linalg.norm(vector))
        if length == 0:
            raise InputError("a direction needs a length", expected="for example [1, 0, 0]")
        return tuple(float(item) for item in vector / length)

    def _component(self, index: int, item: object) -> float | SpatialFormula:
        with keyed(f"[{index}]"):
            read = constant(item, "")
            return read if isinstance(read, SpatialFormula) else to_si(read, "")

    def __get_pydantic_core_schema__(
        self, source: object, handler: object
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read, serialization=as_written)


if TYPE_CHECKING:
    Direction: TypeAlias = tuple[float, ...]
else:
    Direction = Annotated[tuple, _Direction()]
    """A unit vector of three components; laws name such fields in `Law.directions`."""


def direction(value: Expr | Sequence[float]) -> Expr:
    """A direction as a UFL unit vector with three components.

    Args:
        value: A list of numbers, or a UFL vector of any length; two components lie in the plane.
    """
    vector = value if isinstance(value, Expr) else ufl.as_vector(list(value))
    if len(vector) == 2:
        vector = ufl.as_vector([vector[0], vector[1], 0])
    return vector / ufl.sqrt(ufl.inner(vector, vector))


def frame(axis1: Expr | Sequence[float], axis2: Expr | Sequence[float]) -> tuple[Expr, Expr, Expr]:
    """Orthonormal frame of an orthotropic material, three UFL vectors (Gram-Schmidt).

    Args:
        axis1: First direction, of any length: numbers or a UFL vector.
        axis2: Direction in the plane of the first two axes, not parallel to axis1.
    """
    first, towards = direction(axis1), direction(axis2)
    second = direction(towards - ufl.inner(towards, first) * first)
    return first, second, ufl.cross(first, second)


# --- admissible values ---


@dataclass(frozen=True)
class Range:
    """The values a constant may have."""

    low: float = -np.inf
    high: float = np.inf
    low_too: bool = False
    high_too: bool = False

    @classmethod
    def of(cls, metadata: Iterable[object]) -> Range:
        """The range that pydantic's gt, ge, lt and le leave."""
        result: dict[str, Any] = {}
        for item in metadata:
            match item:
                case annotated_types.Gt(gt=low):
                    result |= {"low": low, "low_too": False}
                case annotated_types.Ge(ge=low):
                    result |= {"low": low, "low_too": True}
                case annotated_types.Lt(lt=high):
                    result |= {"high": high, "high_too": False}
                case annotated_types.Le(le=high):
                    result |= {"high": high, "high_too": True}
        return cls(**result)

    def distance(self, values: FloatArray) -> FloatArray:
        """How far values lie outside; -1: inside; what is not finite is infinitely far off."""
        above = values >= self.low if self.low_too else values > self.low
        below = values <= self.high if self.high_too else values < self.high
        finite = np.isfinite(values)
        known = np.where(finite, values, 0.0)
        far = np.maximum(np.maximum(self.low - known, known - self.high), 0.0)
        return np.asarray(np.where(finite & above & below, -1.0, np.where(finite, far, np.inf)))

    def __str__(self) -> str:
        low = f"{'at least' if self.low_too else 'above'} {self.low:g}"
        high = f"{'at most' if self.high_too else 'below'} {self.high:g}"
        bounds = [low] * bool(np.isfinite(self.low)) + [high] * bool(np.isfinite(self.high))
        return " and ".join(bounds) or "a finite number"
