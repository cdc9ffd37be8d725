"""Statics: equilibrium under loads that grow step by step."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import (
    Idle,
    Record,
    refuse_idle,
    settled,
)
from dolfin_elastic.core.units import Force, Length
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.restart_state import Kept, Restore
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.breakpoints import corners, refuse_beyond, winds
from dolfin_elastic.solvers.diagnostics.rigid_body import check_held
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.nonlinear.progress import Tolerance
from dolfin_elastic.solvers.nonlinear.scalars import Scalars
from dolfin_elastic.solvers.statics.load_stepping import LoadStepping
from dolfin_elastic.solvers.statics.step_size import StepSizes

log = logging.getLogger("dolfin_elastic")

FIRST = 0.25
"""Share of the load in the first step of a nonlinear problem."""


class StaticsSettings(Record):
    """How a static solution is found.

    Attributes:
        method: "load": the load factor grows, and where no equilibrium is near the body is let go
            to flow to another; "arc-length": the path of equilibria is followed through limit
            points, where the load falls.
        steps: Equal load steps; by default the size of steps is chosen as they go.
        first_step: Share of the load in the first step; by default a quarter, and all of it in a
            linear problem.
        max_step: Share of the load that no step exceeds.
        min_step: Smallest step that is tried, as a share of the first one.
        end: Load parameter at which the run ends; 1 is the full load.
        times: Load parameters that are met exactly.
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up and tried smaller.
        max_steps: Steps after which a path is not followed any further.
        max_displacement: The run ends where a displacement reaches this [m].
        snap: Where the load cannot grow any further, let the body flow to another equilibrium.
    """

    method: Literal["load", "arc-length"] = "load"
    steps: int | None = Field(default=None, ge=1)
    first_step: float | None = Field(default=None, gt=0, le=1)
    max_step: float = Field(default=1.0, gt=0)
    min_step: float = Field(default=1e-3, gt=0, le=1)
    end: float = Field(default=1.0, gt=0)
    times: list[Annotated[float, Field(gt=0)]] = Field(default=[])
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=30, ge=1)
    max_steps: int = Field(default=1000, ge=1)
    max_displacement: Length | None = Field(default=None, gt=0)
    snap: bool = True

    @model_validator(mode="after")
    def _together(self) -> Self:
        if self.steps is not None and self.first_step is not None:
            raise InputError(
                "steps and first_step given together",
                expected="steps are equal; leave one of them out",
            )
        refuse_idle(self, _idle(self))
        if (self.first_step or 0.0) > self.max_step:
            raise InputError(
                f"{self.first_step:g} is more than any step may be",
                where="first_step",
                expected=f"at most statics.max_step = {self.max_step:g}",
            )
        refuse_beyond(self.times, self.end, "statics.end")
        return self


def _idle(s: StaticsSettings) -> Iterator[Idle]:
    """Keys that steps of this kind do not know."""
    if s.steps is not None:
        yield Idle(["max_step"], "steps are equal where `steps` is given", "leave one of them out")
    if s.method == "arc-length":
        by_load = 'leave it out, or method = "load"'
        yield Idle(
            ["times"], "a path that is followed by its length meets no load on purpose", by_load
        )
        yield Idle(
            ["steps", "max_step"],
            "steps along a path are measured by its length, not by the load",
            "leave it out; first_step is the share of the load in the first one",
        )
        yield Idle(["snap"], "a path that is followed by its length is never left", by_load)


class Statics:
    """Finds the equilibrium states of a problem under growing load.

    Args:
        problem: What is loaded; its displacement is the starting point.
        settings: See `StaticsSettings`; keyword arguments are its fields.
        linear: How linear systems are solved.
        petsc: PETSc options, which win over everything.

    Attributes:
        alone: It is all that is done; else whoever goes on from here says what does nothing.
    """

    def __init__(
        self,
        problem: Problem,
        settings: StaticsSettings | None = None,
        *,
        linear: LinearSettings | None = None,
        petsc: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        self.problem, self.alone = problem, True
        self.settings = settled(StaticsSettings, settings, fields)
        self.linear = linear or LinearSettings()
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.choice = choose(problem, self.linear)
        self._stepping: LoadStepping | None = None

    def steps(self, restore: Restore | None = None) -> Iterator[State]:
        """Yields the initial state and then one equilibrium a step. Collective.

        Args:
            restore: Gives back what `kept` has told: then it goes on with the step after that.

        Raises:
            InputError: The supports do not hold the body against every rigid motion.
            ConvergenceError: No equilibrium was found even with the smallest step; the problem
                then holds the last iterate, and all states yielded before are valid.
        """
        check_held(self.problem)
        self._check_path()
        for dashpot in self.problem.dashpots if self.alone else ():
            log.warning("the dashpot '%s' does nothing in statics", dashpot.label)
        log.info("%s", self.choice.why)
        with ExitStack() as owned:
            assembler = Assembler(self.problem)
            owned.callback(assembler.destroy)
            scalars = Scalars(assembler)
            newton = Newton(
                assembler, self.choice, self.tolerance, users=self.petsc, border=scalars.border
            )
            owned.callback(newton.destroy)
            newton.watch_inversion()
            self._stepping = LoadStepping(self, scalars, newton)
            owned.callback(self._forget)
            yield from self._stepping.run(restore)

    def _forget(self) -> None:
        self._stepping = None

    def kept(self) -> Kept:
        """What the next step needs to know, while `steps` has stopped at a state. Collective."""
        if self._stepping is None:
            raise RuntimeError("there is nothing to keep: no step has been made, or all have")
        return self._stepping.kept()

    def _check_path(self) -> None:
        if self.problem.cell is not None and self.settings.method == "arc-length":
            raise InputError(
                "the path of a periodic cell is not followed by its length",
                where="statics.method",
                expected='"load"; periodic.gradient prescribes how far the cell is deformed',
            )

    @property
    def tolerance(self) -> Tolerance:
        """When equilibrium counts as found."""
        s = self.settings
        return Tolerance(s.rtol, s.atol, s.max_iterations)

    def sizes(self) -> StepSizes:
        """The plan of load steps."""
        s = self.settings
        if s.steps is not None:
            first = s.end / s.steps
            stops = [s.end * i / s.steps for i in range(1, s.steps)]
            largest = first
        else:
            winding = winds(self.problem)
            share = 1.0 if self.problem.linear and not winding else FIRST
            first = min(s.first_step or share, s.max_step) * s.end
            wide = FIRST if winding and "max_step" not in s.model_fields_set else s.max_step
            stops, largest = [], max(first, wide * s.end)
        return StepSizes(
            s.end,
            first=first,
            largest=largest,
            smallest=first * s.min_step,
            stops=[*stops, *s.times, *corners(self.problem)],
            steady=s.steps is not None,
        )
