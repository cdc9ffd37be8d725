"""How a static solution is found: the keys of [statics]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Self, TypeAlias

from pydantic import Field, GetCoreSchemaHandler, model_validator
from pydantic_core import core_schema

from dolfin_elastic.core.errors import InputError, UnitError
from dolfin_elastic.core.schema import (
    Record,
    UnusedKeys,
    quoted,
    refuse_times_beyond,
    refuse_unused_keys,
)
from dolfin_elastic.core.units import Force, Length, Quantity, to_si

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

FIRST = 0.25
"""Share of the load in the first step of a nonlinear problem."""


MOST_STEPS = 1_000_000
"""Load steps that anybody means; a smaller step is one in which nothing changes."""


LARGEST = 1e9
"""Largest load factor: beyond it no step from 0 could be taken."""


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
    LoadParameter = Annotated[float, _LoadParameter("s")]


class StaticsSettings(Record):
    """How a static solution is found.

    Attributes:
        method: "load": the load factor grows, and where no equilibrium is near, pseudo-transient
            continuation leads to another; "arc-length": the path of equilibria is followed
            through limit points, where the load falls.
        steps: Equal load steps; by default the size of steps is chosen as they go, where the whole
            load in one step is not beyond doubt.
        first_step: Fraction of the load in the first step, or a time with a unit; by default a
            quarter, and all of it in a linear problem.
        max_step: Fraction of the load that no step exceeds, or a time with a unit.
        min_step: Smallest step that is tried, as a fraction of the first one.
        end: Load parameter at which the run ends; 1 is the full load.  Or a time with a unit, where
            the load parameter is the time.
        times: Load parameters that are met exactly, or times with a unit.
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up and tried smaller.
        max_steps: Steps after which a path is not followed any further.
        max_displacement: The run ends where a displacement reaches this [m].
        snap: Where the load cannot grow any further, let the body flow to another equilibrium.
    """

    method: Literal["load", "arc-length"] = "load"
    steps: int | None = Field(default=None, ge=1, le=MOST_STEPS)
    first_step: LoadParameter | None = Field(default=None, ge=1 / MOST_STEPS)
    max_step: LoadParameter = Field(default=1.0, ge=1 / MOST_STEPS)
    min_step: float = Field(default=1e-3, gt=0, le=1)
    end: LoadParameter = Field(default=1.0, gt=0, le=LARGEST)
    times: list[Annotated[LoadParameter, Field(gt=0)]] = Field(default=[])
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=30, ge=1)
    max_steps: int = Field(default=1000, ge=1)
    max_displacement: Length | None = Field(default=None, gt=0)
    snap: bool = True

    @model_validator(mode="after")
    def _check_combinations(self) -> Self:
        if self.steps is not None and self.first_step is not None:
            raise InputError(
                "steps and first_step given together",
                expected="steps are equal; leave one of them out",
            )
        refuse_unused_keys(self, _unused_keys(self))
        if self.end > LARGEST:
            raise InputError(
                f"{_text(self.end)} is wrong", where="end", expected=f"at most {LARGEST:g} s"
            )
        for key in ("first_step", "max_step"):
            self._check_length(key, getattr(self, key))
        if (self.first or 0.0) > 1:
            raise InputError(
                f"{quoted(self.first_step)} is wrong",
                where="first_step",
                expected="expected a number of at most 1, or a time with a unit",
            )
        _ = self.in_time  # fails or is known now, not when it is used
        if (self.first or 0.0) > self.largest:
            raise InputError(
                f"{_text(self.first_step)} is more than any step may be",
                where="first_step",
                expected=f"at most statics.max_step = {_text(self.max_step)}",
            )
        unit = "s" if isinstance(self.end, Seconds) else ""
        refuse_times_beyond(self.times, self.end, "statics.end", unit)
        return self

    def _check_length(self, key: str, step: float | None) -> None:
        """Refuses a step in seconds that is longer than the run, or never comes to its end."""
        if isinstance(step, Seconds) and not self.end / MOST_STEPS <= step <= self.end:
            raise InputError(
                f"{_text(step)} is wrong",
                where=key,
                expected=f"from {self.end / MOST_STEPS:g} s to statics.end = {self.end:g} s",
            )

    def _fraction(self, step: float) -> float:
        """Of `end`, from a step as it is written."""
        return step / self.end if isinstance(step, Seconds) else step

    @cached_property
    def first(self) -> float | None:
        """The first step as a fraction of `end`; None: nobody has chosen it."""
        return None if self.first_step is None else self._fraction(self.first_step)

    @cached_property
    def largest(self) -> float:
        """The largest step as a fraction of `end`."""
        return self._fraction(self.max_step)

    @cached_property
    def in_time(self) -> str:
        """The first key that is a time with a unit; empty: there is none."""
        keys = ("end", "max_step", "first_step")
        found = [key for key in keys if isinstance(getattr(self, key), Seconds)]
        found += [f"times[{i}]" for i, t in enumerate(self.times) if isinstance(t, Seconds)]
        return found[0] if found else ""

    def as_way(self, *, ends: bool) -> Self:
        """The settings for the way to the preload of another analysis.

        Args:
            ends: That state is the end of this analysis; else the other one says what it is.
        """
        left = {"max_displacement"} if ends else {"max_displacement", "end", "times"}
        return type(self)(**{key: getattr(self, key) for key in self.model_fields_set - left})


def _text(step: float | None) -> str:
    return f"{step:g} s" if isinstance(step, Seconds) else f"{step:g}"


def refuse_times(settings: StaticsSettings, problem: Problem) -> None:
    """Refuses times with units, of which there are some, where the load parameter is none.

    Raises:
        InputError: There are times, and all that acts is proportional to the load parameter.
    """
    timed = problem.history is not None and problem.history.timed
    if not (timed or problem.curves or problem.driven_by_formula):
        raise InputError(
            "nothing depends on time: no curve, no formula in t, and no material that relaxes",
            where=f"statics.{settings.in_time}",
            expected="a number: 1 is the full load; or a `curve` of the loads",
        )


def refuse_memory(settings: StaticsSettings, *, timed: bool) -> None:
    """Refuses what materials that remember do not allow: steps without a time, or of any size.

    Args:
        timed: A material depends on how long a step takes.

    Raises:
        InputError: Along the path of equilibria no time passes, or nobody has said how fine the
            steps in time are.
    """
    if timed and settings.method == "arc-length":
        raise InputError(
            "a material depends on time, and along a path no time passes",
            where="statics.method",
            expected='"load", or an elastic material',
        )
    if timed and not {"steps", "max_step"} & settings.model_fields_set:
        raise InputError(
            "a material depends on time, and the steps in time are not given",
            where="statics.steps",
            expected="for example 100, or max_step; the load parameter is the time in seconds, up "
            "to statics.end",
        )


def _unused_keys(s: StaticsSettings) -> Iterator[UnusedKeys]:
    """Keys without effect beside `steps` or with `method = "arc-length"`."""
    if s.steps is not None:
        yield UnusedKeys(
            ["max_step"], "steps are equal where `steps` is given", "leave one of them out"
        )
    if s.method == "arc-length":
        by_load = 'leave it out, or method = "load"'
        yield UnusedKeys(
            ["times"], "a path that is followed by its length meets no load factor exactly", by_load
        )
        yield UnusedKeys(
            ["steps", "max_step"],
            "steps along a path are measured by its length, not by the load",
            "leave it out; first_step is the fraction of the load in the first one",
        )
        yield UnusedKeys(
            ["snap"], "a path that is followed by its length goes on beyond limit points", by_load
        )
