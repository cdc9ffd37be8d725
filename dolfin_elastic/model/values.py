"""Values as users write them: numbers, texts with units, formulas, fields; names of surfaces."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import GetCoreSchemaHandler, model_validator
from pydantic_core import core_schema

from dolfin_elastic.core.errors import InputError, dotted, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import (
    LOAD_EXAMPLES,
    is_quantity,
    reading,
    to_base,
    to_si,
    unit_to_si,
)
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.records import RecordFormula


class OnSurfaces(Record):
    """A record that acts on surfaces; supports may act on edges and points, too.

    Attributes:
        on: Name of a surface, or several.
        name: Its name in results; the surfaces' names by default.
    """

    on: str | list[str]
    name: str = ""

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not any(self.surfaces):
            raise InputError("no name is given", where="on", expected="a surface's name")
        return self

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Names of its surfaces, edges and points."""
        return (self.on,) if isinstance(self.on, str) else tuple(self.on)

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.name or "+".join(self.surfaces)


COORDINATES = ("x", "y", "z", "t")
PLACE = frozenset("xyz")
"""Names of the coordinates in formulas."""
FREE = "free"

Component = float | Formula | None
"""A number in SI units, a formula in x, y, z [m] and t, or None for a free component.

A field of the mesh is a `FieldFormula`.
"""

FieldsAt = Callable[[str], FloatArray]
"""Gives a field of the mesh by its name: its values at known points, shape (..., columns)."""


class FieldTable(Record):
    """``{field = "E_cell", unit = "MPa"}``, a field of the mesh or of another file.

    Attributes:
        field: Its name there.
        unit: Of its values; empty: SI.
        reference: Value that is subtracted from each, in the same unit, or a text with its own.
        file: Another file with a mesh, whose field is taken to the mesh of the case.
        time: Of several time steps in the file, which one; None: the last.
        mesh_unit: Unit of length of the file; empty: the one that it states, else that of the mesh.
        outside: What becomes of nodes outside of the file's mesh.
    """

    field: str
    unit: str = ""
    reference: float | str = 0.0
    file: str = ""
    time: float | None = None
    mesh_unit: str = ""
    outside: Literal["error", "nearest"] = "error"

    @model_validator(mode="after")
    def _of_a_file(self) -> Self:
        for key in ("time", "mesh_unit", "outside"):
            if key in self.model_fields_set and not self.file:
                raise InputError(
                    "this is for a field of another file",
                    where=key,
                    expected='file = "thermal.vtu"; or leave it out',
                )
        with keyed("mesh_unit"):
            _ = self.metres
        return self

    @property
    def key(self) -> str:
        """The name that it has among the fields of the mesh."""
        if not self.file:
            return self.field
        nearest = " (nearest)" if self.outside == "nearest" else ""
        unit = f" in {self.mesh_unit}" if self.mesh_unit else ""
        at = "" if self.time is None else f" at {self.time:.9g}"
        return f"{self.field} of {self.file}{unit}{at}{nearest}"

    @property
    def metres(self) -> float | None:
        """Metres per unit of length of the file; None: as it states."""
        return to_si(f"1 {self.mesh_unit}", "m") if self.mesh_unit else None


@dataclass(frozen=True)
class FieldFormula(Formula):
    """A field of the mesh, or a component of it: a formula that has values on its mesh only.

    Attributes:
        field: The field's name, see `FieldTable.key`.
        factor: SI units per unit of its values.
        reference: Value that is subtracted, in their unit.
        column: Which component of a vector; None: the field must be a scalar.
    """

    field: str
    factor: float
    reference: float
    column: int | None

    @classmethod
    def read(
        cls, written: Mapping[str, object], unit: str, column: int | None = None
    ) -> FieldFormula:
        """The field of a table such as ``{field = "p", unit = "MPa"}``.

        Args:
            unit: SI unit of the value.

        Raises:
            InputError: Another key, or a unit that does not fit.
        """
        table, factor = field_table(written, unit)
        name = f"field '{table.key}'"
        return cls(name, PLACE, 0.0, table.key, factor, float(table.reference), column)

    def of(self, values: FloatArray) -> FloatArray:
        """Its values in SI units.

        Args:
            values: Of the field, shape (..., columns).

        Returns:
            Shape (...).
        """
        return np.asarray((values[..., self.column or 0] - self.reference) * self.factor)

    def evaluate(self, **values: float | FloatArray) -> float | FloatArray:
        """Not a number anywhere: coordinates are not enough, see `number_at`."""
        shape = np.broadcast_shapes(*(np.shape(value) for value in values.values()))
        return np.full(shape, np.nan) if shape else np.nan


def field_table(written: Mapping[str, object], unit: str | None) -> tuple[FieldTable, float]:
    """Name and unit of a field as a user wrote them, and SI units per unit.

    Args:
        unit: SI unit of the values; None: they may have any.

    Raises:
        InputError: Another key, or a unit that does not fit.
    """
    table, factor = FieldTable(**written), 1.0
    with keyed("unit"):
        if table.unit:
            one = f"1 {table.unit}"
            factor = to_base(one) if unit is None else unit_to_si(table.unit, unit)
    with keyed("reference"):
        read = reading(table.reference, table.unit if unit is None else unit, table.unit)
    return table.model_copy(update={"reference": read}), factor


def field_tables(written: object, where: str = "") -> Iterator[tuple[str, FieldTable]]:
    """All fields of other files in nested tables and lists, with their keys.

    Args:
        written: Tables and lists as they stand in a case file.
        where: Dotted key under which they stand there.
    """
    if isinstance(written, Mapping) and "field" in written and written.get("file"):
        with keyed(where):
            yield where, FieldTable(**written)
    elif isinstance(written, Mapping):
        for key, value in written.items():
            yield from field_tables(value, dotted(where, str(key)))
    elif isinstance(written, list | tuple):
        for index, value in enumerate(written):
            yield from field_tables(value, f"{where}[{index}]")


def at_time(value: Component, t: float) -> float:
    """A component that is the same at all places, at a time; 0 of a free one.

    Args:
        t: Time [s], or load parameter.
    """
    return float(value.evaluate(t=t)) if isinstance(value, Formula) else float(value or 0.0)


def fields_of(values: Iterable[Component]) -> list[FieldFormula]:
    """Those values that are fields of the mesh."""
    return [value for value in values if isinstance(value, FieldFormula)]


def sized(values: tuple[Component, ...], dim: int) -> tuple[Component, ...]:
    """The components of a vector in a body of 2 or 3 dimensions: of a field as many."""
    whole = fields_of(values) and all(one.column is not None for one in fields_of(values))
    return values[:dim] if whole else values


class OrField:
    """Of an annotated type: a table ``{field = "f"}`` may stand in its place."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        def read(value: object, inner: core_schema.ValidatorFunctionWrapHandler) -> object:
            return value if isinstance(value, Mapping) else inner(value)

        return core_schema.no_info_wrap_validator_function(
            read,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda value: value),
        )


if TYPE_CHECKING:
    Vector = list[object]
else:
    Vector = Annotated[list[object], OrField()]
    """Components of a vector, or a field of the mesh."""


class Parts(NamedTuple):
    """Where the integral of a load or spring is taken.

    Attributes:
        kind: It is "region", "surface", "edge" or "point".
        names: Of the parts; of regions none for the whole body.
    """

    kind: str
    names: tuple[str, ...]


def component(
    written: object,
    unit: str,
    *,
    may_be_free: bool = False,
    fields: bool = False,
    integrals: int = 0,
) -> Component:
    """Reads one component.

    Args:
        written: A number, a text such as "2 mm", a formula such as "0.1*x*t", "free", a table such
            as {field = "p"}, or a record over time, see `RecordFormula`.
        unit: SI unit of the component; formulas give values in it.
        may_be_free: Whether "free" is allowed.
        fields: Whether a field of the mesh is allowed.
        integrals: How many times records are integrated; then all else is 0.

    Raises:
        InputError: None of these.
    """
    if written == FREE and may_be_free:
        return None
    if isinstance(written, Mapping):
        if fields and "field" in written:
            return FieldFormula.read(written, unit)
        return RecordFormula.read(written, unit, integrals)
    if integrals and written != 0:
        raise InputError(
            f"{written!r} is not a record over time",
            expected='expected 0, "free" or a record such as {file = "quake.csv", unit = "g"}',
        )
    if isinstance(written, str) and not is_quantity(written) and not misspelt_unit(written):
        return Formula.parse(written, allowed=COORDINATES)
    try:
        return to_si(written, unit)
    except InputError as error:
        if unit not in LOAD_EXAMPLES or '"' not in error.expected:
            raise
        example = f'expected a number in {unit}, for example "{LOAD_EXAMPLES[unit]}"'
        raise type(error)(error.what, where=error.where, expected=example) from None


def misspelt_unit(text: str, names: Collection[str] = COORDINATES) -> bool:
    """Whether a text is a number and a word, as "2 mmm": meant as a unit, not as a formula.

    Args:
        text: As a user wrote it.
        names: Names that a formula may use there, which are no units.
    """
    number, _, word = text.strip().partition(" ")
    try:
        float(number)
    except ValueError:
        return False
    word = word.strip()
    return word not in names and word.replace("/", "").replace("^", "").isalnum()


def angle_of(written: float | str) -> Component:
    """An angle [rad] as a number or formula in t, of the key `angle`.

    Args:
        written: A text such as "90 deg", a number in rad, or a formula.

    Raises:
        InputError: It is none of these.
    """
    with keyed("angle"):
        if isinstance(written, str) and not (
            is_quantity(written) or misspelt_unit(written, ("t",))
        ):
            return Formula.parse(written, allowed=("t",))
        return to_si(written, "rad")


def turned_at(written: object) -> Formula:
    """The angle [rad] over time of something that turns, from its velocity, of the key `velocity`.

    Args:
        written: A number in rad/s, a text such as "90 deg/s", or a record over time, which is
            integrated from rest.

    Raises:
        InputError: It is none of these.
    """
    with keyed("velocity"):
        if isinstance(written, Mapping):
            return replace(RecordFormula.read(written, "rad/s", 1), holds=False)
        return Formula.parse(f"{to_si(written, 'rad/s')!r}*t", allowed=("t",))


def components(
    written: object,
    unit: str,
    *,
    key: str = "",
    may_be_free: bool = False,
    fields: bool = False,
    integrals: int = 0,
) -> tuple[Component, ...]:
    """Reads a vector of two or three components.

    Args:
        unit: SI unit of the components.
        may_be_free: Whether components may be "free".
        fields: Whether fields of the mesh are allowed: of components, or one of the vector, which
            is read as three components, see `sized`.
        integrals: See `component`.

    Raises:
        InputError: Not a list of two or three, or a component is wrong (its index is named).
    """
    if fields and isinstance(written, Mapping) and "field" in written:
        with keyed(key):
            return tuple(FieldFormula.read(written, unit, column) for column in range(3))
    if not isinstance(written, list | tuple) or len(written) not in (2, 3):
        raise InputError(
            f"{written!r} is not a vector",
            where=key,
            expected="expected a list of 3 components (2 in a plane), for example [0, 0, -1]",
        )
    result = []
    for index, item in enumerate(written):
        with keyed(f"{key}[{index}]"):
            result.append(
                component(item, unit, may_be_free=may_be_free, fields=fields, integrals=integrals)
            )
    return tuple(result)


def checked_area(size: float) -> float:
    """The size of surfaces [m^2], over which something is spread.

    Raises:
        InputError: They have none.
    """
    if not size > 0.0:
        raise InputError("the surface has no area", where="on", expected="a surface with facets")
    return size


def depends_on_time(vector: tuple[Component, ...]) -> bool:
    """True when a component's formula uses t."""
    return any(isinstance(item, Formula) and "t" in item.names for item in vector)


def amplitude_of(value: Component, curve: Amplitude | None) -> Amplitude | None:
    """Amplitude of one component of a vector; other components may have another.

    Returns:
        The curve; constant for a formula in t, which has its own time dependence; None: open.
    """
    return CONSTANT if curve is None and depends_on_time((value,)) else curve


def vector_at(
    vector: tuple[Component, ...], X: FloatArray, t: float, fields: FieldsAt | None = None
) -> FloatArray:
    """Values of a vector at points of the reference configuration.

    Args:
        vector: Its components; free ones count as 0.
        X: Points [m], shape (..., dim).
        t: Time [s], or load parameter.
        fields: See `number_at`.

    Returns:
        Shape of X.
    """
    result = np.empty_like(X)
    for i, item in enumerate(sized(vector, X.shape[-1])):
        result[..., i] = number_at(item, X, t, fields)
    return result


def number_at(
    item: Component, X: FloatArray, t: float | FloatArray, fields: FieldsAt | None = None
) -> FloatArray:
    """Values of a component at points of the reference configuration.

    Args:
        item: The component; a free one counts as 0.
        X: Points [m], shape (..., dim).
        t: Time [s], or load parameter; one, or one for each point.
        fields: Gives the fields of the mesh at these points; None: they are not a number.

    Returns:
        Shape (...).
    """
    if isinstance(item, FieldFormula) and fields is not None:
        return item.of(fields(item.field))
    place = dict(zip(COORDINATES, np.moveaxis(X, -1, 0), strict=False))
    place.setdefault("z", np.zeros(X.shape[:-1]))
    if isinstance(item, Formula):
        return np.asarray(item.evaluate(**place, t=t))
    return np.full(X.shape[:-1], item or 0.0)
