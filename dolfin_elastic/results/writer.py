"""`Output`, settings of a file, and `Writer`, an open one; the states it takes, and the last."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Self, runtime_checkable

from dolfinx import fem
from pydantic import AfterValidator, Field

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.results.files import writing

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

Numbers = Mapping[str, Any]
"""Restart state of a writer, as JSON data."""


class Writer(Protocol):
    """An open output.  All of it is collective."""

    def write(self, state: State) -> None:
        """Writes one converged step, if it is selected."""

    def restart_state(self) -> Numbers:
        """Where the output ends now, for `Output.open`; brings what is written to the disk first.

        Nothing of an output that begins anew after a restart.
        """

    def close(self, status: str = "completed", error: object = None) -> None:
        """Ends the output, at the end of the run or after an error.

        Args:
            status: "completed", "failed" or "stopped".
            error: The error that ended the run, or "on request".
        """


class Output(Record):
    """Settings of one output file.

    Attributes:
        file: Name of the file inside the results' folder.
    """

    file: str = Field(default="", min_length=1)

    @abstractmethod
    def open(self, problem: Problem, folder: Path, saved: Numbers | None = None) -> Writer:
        """Opens the output in a folder, which is made if need be. Collective.

        Args:
            saved: `Writer.restart_state` at the checkpoint from which the run continues: results
                after it are cut off. An output that cannot be cut back begins anew.

        Raises:
            InputError: A field that the problem does not have.
            OutputError: The folder cannot be written to.
            RestartError: Results from before the checkpoint are missing.
        """

    @classmethod
    def from_keys(cls, keys: Mapping[str, object]) -> Self:
        """From those of the keys `fields`, `every` and `frames` of a run that it has."""
        return cls(**{key: value for key, value in keys.items() if key in cls.model_fields})

    def remove(self, folder: Path) -> None:
        """Removes its files that an earlier run has left in a folder. Not collective.

        Raises:
            OutputError: They cannot be removed.
        """
        with writing(folder):
            (folder / self.file).unlink(missing_ok=True)

    def listing(self, folder: Path) -> list[str]:
        """Its files in the results' folder, for the list at the end of a run. Not collective."""
        return [self.file] if (folder / self.file).is_file() else []


@runtime_checkable
class ModeWriter(Protocol):
    """An open output of modes."""

    def write_mode(self, mode: Mode) -> None:
        """Writes one mode. Collective."""


def _check_positive(steps: int) -> int:
    if steps < 1:
        raise InputError(
            f"{steps} is wrong", expected="expected a whole number of steps, at least 1"
        )
    return steps


Steps = Annotated[int, AfterValidator(_check_positive)]
"""Number of steps from one written state to the next."""


class StepInterval:
    """Selects the first state at or after each n-th step.

    A solver need not yield every step, so the numbers of its states need not be multiples of n.

    Args:
        n: Steps from one selected state to the next.
        taken: Value of the attribute at the checkpoint from which the run continues.

    Attributes:
        taken: Number of the last interval of n steps from which a state was selected; -1: none.
    """

    def __init__(self, n: int, taken: int = -1) -> None:
        self.n, self.taken = n, taken

    def takes(self, step: int) -> bool:
        """Whether the state of this step is selected; call it once for each state."""
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

    def forget(self) -> None:
        """Goes back to no state. Not collective."""
        self.state = None

    def _copy(self, name: str, function: fem.Function) -> fem.Function:
        if name not in self._copies:
            self._copies[name] = fem.Function(function.function_space)
        copy = self._copies[name]
        copy.x.array[:] = function.x.array
        return copy
