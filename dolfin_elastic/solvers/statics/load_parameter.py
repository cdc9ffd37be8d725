"""The load parameter of statics, and parts of it, as numbers or as times with a unit."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, TypeAlias

from pydantic import GetCoreSchemaHandler
from pydantic_core import core_schema

from dolfin_elastic.core.errors import InputError, UnitError
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.units import Quantity, to_si

_TIME = 'a time above 0, for example "10 s"'


class Seconds(float):
    """A time [s] that was written with its unit."""


class _LoadParameter(Quantity):
    """A bare number, or a time with a unit, which stays a `Seconds`."""

    def read(self, value: object, bounded: Callable[[float], float]) -> object:
        """See `Quantity`; a time is bounded by who knows where the run ends."""
        if isinstance(value, Seconds):
            return value
        try:
            number = to_si(value, self.unit)
        except UnitError as error:
            raise UnitError(error.what, expected=f"expected a number, or {_TIME}") from None
        if not isinstance(value, str) or _bare(value):
            return bounded(number)
        if number <= 0:
            raise InputError(f"{quoted(value)} is wrong", expected=f"expected {_TIME}")
        return Seconds(number)

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            self.read,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(_written),
        )


def _bare(text: str) -> bool:
    with suppress(ValueError):
        float(text)
        return True
    return False


def _written(value: object) -> object:
    return f"{float(value)!r} s" if isinstance(value, Seconds) else value


if TYPE_CHECKING:
    LoadParameter: TypeAlias = float
else:
    from typing import Annotated

    LoadParameter = Annotated[float, _LoadParameter("s")]
