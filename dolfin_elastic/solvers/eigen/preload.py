"""`PreloadedAnalysis`: an analysis about a state at rest or loaded: modes, buckling."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Generator
from typing import ClassVar

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue
from dolfin_elastic.core.schema import UnusedKeys, refuse_times_beyond, refuse_unused_keys
from dolfin_elastic.core.together import loop_together
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.eigen.mode_shapes import shared
from dolfin_elastic.solvers.eigen.settings import (
    BucklingSettings,
    ModalSettings,
    refuse_stiffness,
)
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.load_stepping import InitialGuess
from dolfin_elastic.solvers.statics.settings import StaticsSettings
from dolfin_elastic.solvers.statics.statics import Statics

log = logging.getLogger("dolfin_elastic")


class PreloadedAnalysis(ABC):
    """Base of `Modal` and `Buckling`: static path to the preload, and its share of PETSc options.

    Args:
        petsc: PETSc and SLEPc options, which win over everything.

    Attributes:
        table: Of a case file: "modal" or "buckling".
        known: Load factor of an equilibrium that is known, and its unknowns; a preload of that
            factor is found from them.
    """

    table: ClassVar[str]
    settings: ModalSettings | BucklingSettings

    def __init__(
        self,
        problem: Problem,
        statics: StaticsSettings | None,
        linear: LinearSettings | None,
        petsc: PetscOptions | None,
    ) -> None:
        self.problem, self._way = problem, statics
        self.known: tuple[float, InitialGuess] | None = None
        self.statics, self.linear = statics or StaticsSettings(), linear or LinearSettings()
        self.petsc = {**self.linear.petsc, **(petsc or {})}

    def _check_stiffness(self) -> None:
        """Refuses a choice of stiffness that is none, see `refuse_stiffness`."""
        history = self.problem.history
        refuse_stiffness(
            self.settings,
            self.table,
            relaxes=history is not None and history.relaxes,
            flows=history is not None and history.flows,
        )

    def _choose_stiffness(self) -> None:
        """Gives materials that relax the stiffness that is asked for, from here on. Local."""
        if self.problem.history is not None:
            self.problem.history.choose(long_term=self.settings.stiffness == "long-term")

    def _take_yielded(self) -> None:
        """Takes a state in which a metal has yielded as elastic, if that is asked for. Collective.

        Raises:
            InputError: It is not: the stiffness depends on which way the body is strained.
        """
        history, elastic = self.problem.history, self.settings.stiffness == "elastic"
        if history is None:
            return
        if history.changed(flow=not elastic):
            raise InputError(
                "a material has yielded, and a state that has yielded has no modes: its stiffness "
                "is another where the strain goes on than where it goes back",
                where=f"{self.table}.preload",
                expected="a smaller preload, or an elastic material"
                + (', or stiffness = "elastic"' if history.flows and not elastic else ""),
            )
        if elastic:
            history.choose(elastic=True)

    def _check_statics_keys(self, key: str, share: float) -> None:
        """Refuses keys of [statics] that have no effect on the path to the preload.

        Args:
            share: Load factor of the preload; 0: none.

        Raises:
            InputError: Some of it would be ignored.
        """
        if self._way is None or not share:
            return
        ends = f"the way to the preload ends where {key} says"
        rules = [UnusedKeys(["max_displacement"], "a preload is reached in full or not at all")]
        rules += [UnusedKeys(["end"], ends)] if key == "buckling.preload" else []
        try:
            refuse_unused_keys(self._way, rules)
            if rules[1:]:
                refuse_times_beyond(self._way.times, share, key)
        except InputError as error:
            raise error.at("statics") from None

    def steps(self) -> Generator[State | Mode, None, None]:
        """Yields the states of the preload, if there is one, and then the modes. Collective.

        Raises:
            InputError: The supports do not hold a body that is loaded.
            ConvergenceError: No equilibrium was found, it is unstable, or not all modes were found.
        """
        return loop_together(self.problem.body.comm, self._steps())

    def modes(self) -> Generator[Mode, None, None]:
        """Yields the modes only, see `steps`. Collective."""
        modes = (mode for mode in self._steps() if isinstance(mode, Mode))
        return loop_together(self.problem.body.comm, modes)

    def about_this_state(self) -> Generator[Mode, None, None]:
        """Yields the modes about the present state of the problem. Collective."""
        self._choose_stiffness()
        return loop_together(self.problem.body.comm, self._about_this_state())

    @abstractmethod
    def _steps(self) -> Generator[State | Mode, None, None]:
        """Computes what `steps` yields. Collective."""

    @abstractmethod
    def _about_this_state(self) -> Generator[Mode, None, None]:
        """Computes what `about_this_state` yields. Collective."""

    def of_modes(self, *, loaded: bool) -> dict[str, PetscValue]:
        """PETSc options of the eigenvalue analysis.

        Args:
            loaded: There is a preload, whose statics take all options but SLEPc's.
        """
        return shared(self.petsc)[1] if loaded else self.petsc

    def _warn_of_dashpots(self, reason: str) -> None:
        """Warns that dashpots have no effect on modes.

        Args:
            reason: What the analysis computes, for the message.
        """
        for dashpot in self.problem.dashpots:
            log.warning("the dashpot '%s' does nothing to %s", dashpot.label, reason)

    def _load(self, settings: StaticsSettings) -> Generator[State, None, None]:
        """Yields the states on the way to the loaded one. Collective.

        Raises:
            ConvergenceError: It is not reached.
        """
        of_statics, _ = shared(self.petsc)
        linear = self.linear.model_copy(update={"petsc": {}})
        state = None
        way = Statics(self.problem, settings, linear=linear, petsc=of_statics, preload=True)
        near = self.known[1] if self.known is not None and self.known[0] == settings.end else None
        for state in way.steps(near=near):
            yield state
        if state is not None and state.done < 1.0 - 1e-9:
            raise ConvergenceError(
                f"the way to the preload has ended at the load factor {state.t:.6g}, before "
                f"{settings.end:.6g}",
                advice="more statics.max_steps, or larger steps",
            )
