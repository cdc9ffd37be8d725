"""`ImplicitScheme`: what an implicit motion asks of its time scheme, PETSc's or our own.

A scheme is one class and one row of the table `SCHEMES` in `solvers/dynamics/schemes.py`.  It is
registered with PETSc's TS, which owns the loop over steps, monitors and events.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError, StoppedError
from dolfin_elastic.core.petsc_options import PetscValue
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.implicit.step_control import StepControl
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton

FAILURES = 8
"""Times that a step without solution is repeated with a quarter of its size, before giving up."""


@dataclass(frozen=True)
class StepForces:
    """Forces of an accepted step, for the balances of momentum and energy.

    Attributes:
        stage: Forces at the stage, where the equation of motion holds.
        middle: Forces in the middle of the step, whose work over `du` is of second order.
        du: Change of the displacement, owned entries [m].
        contact: `Forces.contact` that has changed the momentum; None: that of the stage.
    """

    stage: Forces
    middle: Forces
    du: FloatArray
    contact: FloatArray | None = None

    @property
    def of_obstacles(self) -> FloatArray:
        """What obstacles have exerted, see `Forces.contact`."""
        return self.stage.contact if self.contact is None else self.contact


@dataclass(frozen=True)
class SchemeContext:
    """The objects that a scheme uses; it owns none of them.

    Attributes:
        ts: The scheme registers itself with it.
        moving: Residual and tangent with inertia and damping.
        newton: Solver of the equations of a step, on the SNES of `ts`.
        control: Sizes of steps, and times that are met.
        watch: Of det F.
        v: Velocity, changed by steps.
        a: Acceleration of the scheme, changed by steps.
        parameters: Coefficients of the scheme.
        adaptive: The error of each step is estimated.
    """

    ts: PETSc.TS
    moving: DynamicResidual
    newton: Newton
    control: StepControl
    watch: JacobianWatch
    v: fem.Function
    a: fem.Function
    parameters: GeneralizedAlphaParameters
    adaptive: bool


class ImplicitScheme(ABC):
    """A time scheme of an implicit motion.  All of it is collective.

    Attributes:
        not_adaptive: Why the scheme cannot choose its steps by their errors; empty if it can.
        not_restartable: Why a restarted motion differs from one never stopped; empty if it does
            not.
        acceleration: At the end of the last step [m/s^2].
        error: A fault of the input that a step has met, or a request to stop: PETSc would lose a
            Python exception.
    """

    not_adaptive: ClassVar[str] = ""
    not_restartable: ClassVar[str] = ""

    def __init__(self, context: SchemeContext) -> None:
        self.context, self.moving = context, context.moving
        self.problem, self.assembler = self.moving.problem, self.moving.assembler
        self.newton, self.v = context.newton, context.v
        self.acceleration = fem.Function(self.problem.V, name="acceleration")
        self.error: InputError | StoppedError | None = None

    @classmethod  # noqa: B027  a hook, as are the others below
    def check(cls, problem: Problem, name: str) -> None:
        """Refuses what the scheme cannot compute. Not collective.

        Raises:
            InputError: It cannot compute this problem.
        """

    @property
    def options(self) -> dict[str, PetscValue]:
        """PETSc options that the scheme needs, without prefix."""
        return {}

    # --- the first state ---

    @abstractmethod
    def start(self, t: float) -> None:
        """Initialises the scheme with the first state, whose residual is assembled.

        Args:
            t: Time [s].
        """

    def resume(self, t: float) -> None:  # noqa: B027
        """Initialises the scheme with a restored state.

        Args:
            t: Time [s].
        """

    def loads_changed(self, t: float) -> bool:
        """Whether a program has changed the loads at a state that was yielded.

        Args:
            t: Time of the state [s].
        """
        return False

    # --- each step ---

    def begin_step(self) -> None:  # noqa: B027
        """Called before TS takes a step."""

    @abstractmethod
    def accept(self) -> StepForces:
        """Called after TS has accepted a step; state and velocity are then those of its end."""

    @abstractmethod
    def balance_at_end(self, t: float) -> None:
        """Assembles `assembler.residual.vector` at the end of the step, for reactions.

        Args:
            t: Time [s].
        """

    @abstractmethod
    def counts(self) -> tuple[int, int]:
        """Newton and linear iterations of all steps so far, rejected ones included."""

    def fall_back(self) -> bool:
        """After TS has failed: whether another linear solver is now in use, to try once more."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Frees what it owns; `destroy` is the name by which TS calls a Python context."""
