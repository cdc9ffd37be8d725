"""Times of a motion that are met exactly, and steps whose states are yielded."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.units import Time

SAME = 1e-9
"""Share of an interval that two times may differ by and still be one."""

_EXPECTED = (
    "expected a whole number of steps, at least 1, or (implicit schemes) a time above 0 with a "
    'unit, for example "10 ms"'
)


def _not_bare(value: object) -> object:
    """Refuses numbers without a unit: 2.0 might be steps or seconds."""
    bare = isinstance(value, bool | float)
    if isinstance(value, str):
        with suppress(ValueError):
            float(value)
            bare = True
    if bare:
        raise InputError(f"{quoted(value)} is wrong", expected=_EXPECTED)
    return value


def _above_zero(value: float) -> float:
    if value <= 0:
        written = str(value) if isinstance(value, int) else f"{value:g} s"
        raise InputError(f"{written} is wrong", expected=_EXPECTED)
    return value


Interval = Annotated[int | Time, BeforeValidator(_not_bare), AfterValidator(_above_zero)]
"""Steps from one state to the next, or the time between them [s]."""


class OutputTimes:
    """Which states of a motion are yielded.

    Args:
        end: When the motion ends [s].
        times: Further times that are met exactly, and whose states are yielded [s].
        every: Steps from one state to the next; or, as a float, time between them [s].
    """

    def __init__(self, end: float, times: Sequence[float] = (), every: float = 1) -> None:
        self.end, self._times = end, sorted({t for t in times if 0.0 < t < end} | {end})
        self.steps = every if isinstance(every, int) else None
        self._interval = None if isinstance(every, int) else float(every)

    def add(self, t: float) -> None:
        """Meets a time exactly, too [s]."""
        if all(abs(time - t) > 1e-12 * self.end for time in self._times):
            self._times = sorted([*self._times, t])

    def ended(self, t: float) -> bool:
        """Whether the end is reached.

        Args:
            t: Time [s].
        """
        return t >= self.end * (1 - 1e-12)

    def next_time(self, t: float) -> float:
        """The first time after t that is met exactly [s].

        Args:
            t: Time [s].
        """
        time = next((s for s in self._times if s > t + 1e-12 * self.end), self.end)
        if self._interval is None:
            return time
        number = int(t / self._interval + SAME) + 1
        multiple = number * self._interval
        # Where a multiple and a time that was asked for coincide, the latter is exact.
        return time if time <= multiple * (1 + SAME / number) else multiple

    def steps_left(self, step: int) -> int:
        """Steps to the next state that is yielded, at most."""
        return 10**9 if self.steps is None else self.steps - step % self.steps

    def is_output(self, step: int, t: float) -> bool:
        """Whether the state after a step is yielded.

        Args:
            t: Its time [s].
        """
        if self.ended(t) or t in self._times:
            return True
        if self.steps is not None:
            return step % self.steps == 0
        assert self._interval is not None
        multiples = t / self._interval
        return abs(multiples - round(multiples)) < SAME * max(1.0, multiples)
