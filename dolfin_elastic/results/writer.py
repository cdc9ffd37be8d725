"""`Writer`: an open output; which states it takes, and a copy of the last one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Protocol, runtime_checkable

from dolfinx import fem
from pydantic import AfterValidator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import Mode, State

Numbers = Mapping[str, Any]
"""Restart state of a writer, as JSON data."""


class Writer(Protocol):
    """An open output.  All of it is collective."""

    def write(self, state: State) -> None:
        """Takes one converged step."""

    def restart_state(self) -> Numbers:
        """Where the output ends now, for `Output.open`; brings what is written to the disk first.

        Nothing of an output that begins anew after a restart.
        """

    def close(self, status: str = "completed", error: object = None) -> None:
        """Ends the output.

        Args:
            status: "completed" or "failed".
            error: Why it failed.
        """


@runtime_checkable
class ModeWriter(Protocol):
    """An open output that takes modes, too."""

    def write_mode(self, mode: Mode) -> None:
        """Takes one mode. Collective."""


def _some(steps: int) -> int:
    if steps < 1:
        raise InputError(
            f"{steps} is wrong", expected="expected a whole number of steps, at least 1"
        )
    return steps


Steps = Annotated[int, AfterValidator(_some)]
"""How many steps there are from one to the next."""


class StepInterval:
    """Which states are taken: the first one at or after each n-th step.

    A solver may not show every step; then the steps it shows need not be multiples of n.

    Args:
        n: Steps from one taken state to the next.
        taken: Where a run before this one was.

    Attributes:
        taken: Number of the last n steps of which a state was taken.
    """

    def __init__(self, n: int, taken: int = -1) -> None:
        self.n, self.taken = n, taken

    def takes(self, step: int) -> bool:
        """True if this state is taken. To be asked once for each."""
        due = step // self.n > self.taken
        if due:
            self.taken = step // self.n
        return due


class LastState:
    """A copy of the last state, whose fields the solver overwrites in its next step.

    Attributes:
        state: The last state with fields of its own, or None before the first.
    """

    def __init__(self) -> None:
        self.state: State | None = None
        self._copies: dict[str, fem.Function] = {}

    def copy(self, state: State) -> None:
        """Copies a state. Not collective."""
        self.state = replace(
            state,
            **{
                name: self._copy(name, function)
                for name in ("u", "w", "v", "a")
                if (function := getattr(state, name)) is not None
            },
        )

    def _copy(self, name: str, function: fem.Function) -> fem.Function:
        if name not in self._copies:
            self._copies[name] = fem.Function(function.function_space)
        copy = self._copies[name]
        copy.x.array[:] = function.x.array
        return copy
