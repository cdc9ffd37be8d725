"""When a run writes checkpoints: as it goes, where it is stopped, and amid a step."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.signals import watched
from dolfin_elastic.problem.state import Mode, RestartableSolver, RestartState, State, StateCopy
from dolfin_elastic.results.checkpoint.checkpoints import Checkpoints
from dolfin_elastic.results.writer import Writer

if TYPE_CHECKING:
    from dolfin_elastic.case.analysis import Solver

log = logging.getLogger("dolfin_elastic")


class RunCheckpoints:
    """Checkpoints of a run whose solver can restart; of others there are none.  Collective.

    Args:
        checkpoints: Where they are written.
        solver: What is saved; modes and buckling loads are not.
        asked: See `run`.
    """

    def __init__(
        self, checkpoints: Checkpoints, solver: Solver, asked: Callable[[], bool] | None
    ) -> None:
        self._checkpoints, self._asked = checkpoints, asked
        self._solver = solver if isinstance(solver, RestartableSolver) else None
        self._remembered: tuple[State, RestartState, StateCopy] | None = None

    def remove_foreign(self, *, new: bool) -> None:
        """Removes the checkpoints of other runs in the folder.

        Args:
            new: The run begins: all of them; otherwise those after the one that it continues from.
        """
        if not new:
            self._checkpoints.remove_later()
        elif self._checkpoints.clear():
            log.warning("the checkpoints of a run that had not ended are removed")

    def save_if_due(self, state: State | Mode, writers: Sequence[Writer]) -> None:
        """Writes a checkpoint if it is time or if one was asked for.

        Args:
            state: The last one yielded by the solver.
            writers: The open outputs, which have written it.
        """
        asked = self._asked is not None and self._asked()  # on every rank, whatever the solver
        if self._solver is None or isinstance(state, Mode):
            return
        if self._checkpoints.due(state, asked=asked):
            self._save(self._solver, state, writers)

    def save_at_stop(self, state: State | Mode, writers: Sequence[Writer]) -> None:
        """Writes a checkpoint of a run that is stopped, for its restart.

        Args:
            state: The last one yielded by the solver.
            writers: The open outputs, which have written it.
        """
        if self._solver is None or isinstance(state, Mode):
            return
        if self._checkpoints.off or state.done >= 1.0:
            return
        try:
            self._save(self._solver, state, writers)
        except OutputError as error:
            log.warning("%s", error)

    def remember(self, state: State | Mode) -> None:
        """Copies a state, for a stop amid the step after it; only where signals can stop the run.

        Args:
            state: The last one yielded by the solver; all outputs have written it.
        """
        if self._solver is None or isinstance(state, Mode) or not watched():
            return
        if self._checkpoints.off or state.done >= 1.0:
            return
        restart = self._solver.restart_state()
        self._remembered = state, restart, StateCopy(restart)

    def forget(self) -> None:
        """Forgets the state that was remembered."""
        self._remembered = None

    def save_remembered(self, writers: Sequence[Writer]) -> None:
        """Writes a checkpoint of the last complete step, where the one after it was interrupted.

        Args:
            writers: The open outputs, which have written it.
        """
        if self._remembered is None:
            return
        state, restart, copy = self._remembered
        copy.fill(restart.fields)
        try:
            outputs = [writer.restart_state() for writer in writers]
            self._checkpoints.save(state, RestartState(restart.fields, copy.numbers), outputs)
        except OutputError as error:
            log.warning("%s", error)

    def _save(self, solver: RestartableSolver, state: State, writers: Sequence[Writer]) -> None:
        outputs = [writer.restart_state() for writer in writers]
        self._checkpoints.save(state, solver.restart_state(), outputs)
