"""Motion: settings of all schemes, implicit and explicit."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

from dolfinx import fem
from petsc4py import PETSc
from pydantic import Field, field_serializer, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import (
    Idle,
    Record,
    refuse_idle,
    settled,
)
from dolfin_elastic.core.units import Force, Rate, Time
from dolfin_elastic.model.values import Component, components, depends_on_time
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import RestartState, SavedState, State
from dolfin_elastic.solvers.breakpoints import refuse_beyond
from dolfin_elastic.solvers.dynamics.explicit.explicit import SCHEMES as EXPLICIT
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import Scheme, limit, newmark
from dolfin_elastic.solvers.dynamics.implicit.implicit import Implicit
from dolfin_elastic.solvers.dynamics.implicit.output_times import Interval
from dolfin_elastic.solvers.dynamics.implicit.petsc_alpha2 import check_alpha2
from dolfin_elastic.solvers.dynamics.initial_conditions import set_initial
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear.contact import begin_motion
from dolfin_elastic.solvers.nonlinear.scalars import refuse_scalars

log = logging.getLogger("dolfin_elastic")


class Rayleigh(Record):
    """Rayleigh damping: forces a M v, and stresses b times the rate of the elastic ones.

    A mode of angular frequency w has the damping ratio a/(2 w) + b w/2.

    Attributes:
        mass: a [1/s].
        stiffness: b [s].
    """

    mass: Rate = Field(default=0.0, ge=0)
    stiffness: Time = Field(default=0.0, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        """Two numbers stand for both."""
        if not isinstance(value, list | tuple):
            return value
        if len(value) != 2:
            raise InputError(
                f"{len(value)} factors given",
                expected="expected two, [a, b], or {mass = a, stiffness = b}",
            )
        return {"mass": value[0], "stiffness": value[1]}


class DynamicsSettings(Record):
    """How motion is followed through time.

    Attributes:
        scheme: Implicit: "generalized-alpha", "newmark", "implicit-euler", and "alpha2", PETSc's
            own generalized-alpha.  Explicit, with lumped mass and linear elements:
            "symplectic-euler" (v += dt f/m, then x += dt v) and "central-differences" (the
            velocity halfway between places, of second order).
        end: When it ends [s]; it starts at 0.
        dt: Time step [s].  Implicit: needed; the first step if adaptive.  Explicit: the stable
            step times `safety` if not given; a larger one than the stable one is refused.
        adaptive: Let the error estimate choose the implicit step (not that of "alpha2").
        tolerance: Error a step may make in the displacement of any node, over the largest
            displacement so far (in the first step, of a step of dt, too), if adaptive.
        spectral_radius: Of the generalized-alpha scheme at infinite frequency: 1 keeps the
            energy of a linear body, less damps what the step cannot resolve.
        beta: Of Newmark's method; (gamma + 1/2)^2/4 by default.
        gamma: Of Newmark's method; 1/2 by default, more damps.
        rayleigh: Damping of the whole body (implicit schemes).
        initial_displacement: Components [m] or formulas in x, y, z.
        initial_velocity: Components [m/s] or formulas in x, y, z.
        rtol: Newton's tolerance, relative to the forces of the step.
        atol: Free residual that always is small enough [N].
        max_iterations: Newton iterations after which a step is made smaller.
        safety: Share of the stable step that the explicit scheme takes; at most 0.6 of it where
            there are obstacles, see `stable.RESONANCE`.
        every: Steps from one yielded state to the next, if not given 1, of explicit schemes about
            200 states in all; or, with a unit, the time between states, which is met exactly
            (implicit schemes).
        times: Further times that are met exactly and yielded [s] (implicit schemes).
    """

    scheme: Literal[
        "generalized-alpha",
        "newmark",
        "implicit-euler",
        "alpha2",
        "symplectic-euler",
        "central-differences",
    ] = "generalized-alpha"
    end: Time = Field(gt=0)
    dt: Time | None = Field(default=None, gt=0)
    adaptive: bool = False
    tolerance: float = Field(default=1e-3, gt=0, lt=1)
    spectral_radius: float = Field(default=0.9, ge=0, le=1)
    beta: float | None = Field(default=None, gt=0)
    gamma: float | None = Field(default=None, ge=0.5)
    rayleigh: Rayleigh | None = None
    initial_displacement: list[Any] = Field(default=[])
    initial_velocity: list[Any] = Field(default=[])
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=20, ge=1)
    safety: float = Field(default=0.9, gt=0, le=1)
    every: Interval = 0
    times: list[Annotated[Time, Field(gt=0)]] = Field(default=[])

    @field_serializer("every")
    def _with_unit(self, every: float) -> int | str:
        return every if isinstance(every, int) else f"{every!r} s"

    @model_validator(mode="after")
    def _read(self) -> DynamicsSettings:
        _ = self.displacement, self.velocity
        refuse_idle(self, _idle(self))
        if self.dt is None and self.implicit:
            raise InputError(
                "this key is missing",
                where="dt",
                expected=f"'{self.scheme}' needs a time step, for example \"1 ms\"",
            )
        if self.dt is not None and self.dt > self.end * (1 + 1e-9):
            raise InputError(
                f"{self.dt:g} s is longer than the motion",
                where="dt",
                expected=f"at most dynamics.end = {self.end:g} s",
            )
        if self.adaptive and self.scheme == "alpha2":
            raise InputError(
                "PETSc's 'alpha2' judges the error of velocities by what is allowed for "
                "displacements, and takes thousands of steps for it",
                where="adaptive",
                expected="leave it out, or take 'generalized-alpha': the same scheme with an "
                "estimate of its own",
            )
        if self.adaptive and self.limited:
            raise InputError(
                f"{self.limited}: steps that follow the error only may be too long",
                where="adaptive",
                expected="leave it out, or beta and gamma",
            )
        if self.implicit:  # an explicit scheme knows only later how many steps it takes
            self.__dict__["every"] = self.every or 1
        if isinstance(self.every, float) and self.every > self.end:
            raise InputError(
                f"{self.every:g} s lies beyond the end",
                where="every",
                expected=f"at most dynamics.end = {self.end:g} s",
            )
        refuse_beyond(self.times, self.end, "dynamics.end", "s")
        return self

    @property
    def implicit(self) -> bool:
        """The scheme solves equations."""
        return self.scheme not in EXPLICIT

    @property
    def parameters(self) -> Scheme | None:
        """Of an implicit scheme of our own; None: PETSc's."""
        match self.scheme:
            case "newmark":
                return Scheme.newmark(*newmark(self.beta, self.gamma))
            case "implicit-euler":
                return Scheme.implicit_euler()
            case "alpha2":
                return None
        return Scheme.generalized_alpha(self.spectral_radius)

    @property
    def limited(self) -> str:
        """Why Newmark's method is not stable with any step, if it is not."""
        return limit(*newmark(self.beta, self.gamma)) if self.scheme == "newmark" else ""

    @property
    def damping(self) -> dict[str, float]:
        """Rayleigh's factors by name; zero without any."""
        given = self.rayleigh
        return {"mass": given.mass, "stiffness": given.stiffness} if given else {}

    @property
    def order(self) -> int:
        """Power of the step that the error of one step grows with."""
        first = self.scheme == "implicit-euler" or (self.gamma or 0.5) > 0.5
        return 2 if first else 3

    @property
    def damps(self) -> bool:
        """The scheme is meant to damp what the step does not resolve, and more."""
        radius = self.spectral_radius
        return self.order == 2 or (self.scheme != "newmark" and radius < 0.5)

    @property
    def dissipates(self) -> bool:
        """The scheme has a spectral radius, and a larger one would damp less."""
        return self.scheme in ("generalized-alpha", "alpha2") and self.spectral_radius < 1.0

    @cached_property
    def displacement(self) -> tuple[Component, ...]:
        """Initial displacement as numbers and formulas."""
        return _still("initial_displacement", self.initial_displacement, "m")

    @cached_property
    def velocity(self) -> tuple[Component, ...]:
        """Initial velocity as numbers and formulas."""
        return _still("initial_velocity", self.initial_velocity, "m/s")


def _still(key: str, written: list[Any], unit: str) -> tuple[Component, ...]:
    """A vector at the start, where there is no time yet."""
    found = components(written, unit, key=key) if written else ()
    if depends_on_time(found):
        raise InputError(
            "what holds at the start does not depend on t",
            where=key,
            expected="a formula in x, y, z",
        )
    return found


def _idle(s: DynamicsSettings) -> Iterator[Idle]:
    """Keys that the scheme, or steps of this kind, do not know."""
    scheme, leave = f"the scheme '{s.scheme}'", "leave it out, or scheme = "
    if s.scheme not in ("generalized-alpha", "alpha2"):
        yield Idle(
            ["spectral_radius"], f"{scheme} has no spectral radius", f'{leave}"generalized-alpha"'
        )
    if s.scheme != "newmark":
        for key in ("beta", "gamma"):
            yield Idle([key], f"{scheme} has no {key}", f'{leave}"newmark"')
    yield from _idle_implicit(s, scheme) if s.implicit else _idle_explicit(s, scheme, leave)


def _idle_implicit(s: DynamicsSettings, scheme: str) -> Iterator[Idle]:
    explicit = " and ".join(f'"{name}"' for name in EXPLICIT)
    yield Idle(
        ["safety"],
        f"{scheme} takes no share of a stable step",
        f"leave it out; it is for {explicit}",
    )
    if not s.adaptive:
        yield Idle(
            ["tolerance"],
            "all steps are dt: their error is not judged",
            "leave it out, or adaptive = true; rtol is Newton's tolerance",
        )


def _idle_explicit(s: DynamicsSettings, scheme: str, leave: str) -> Iterator[Idle]:
    leave += '"generalized-alpha"'
    if s.adaptive:
        yield Idle(
            ["adaptive"],
            f"{scheme} has no estimate of its error",
            f"{leave}; without dt the stable step is followed",
        )
    yield Idle(["tolerance"], f"{scheme} has no estimate of its error", "leave it out")
    yield Idle(["rtol", "atol", "max_iterations"], f"{scheme} solves no equations", leave)
    yield Idle(["rayleigh"], f"{scheme} has no rayleigh damping", leave)
    yield Idle(["times"], f"{scheme} meets no times exactly", leave)
    if not isinstance(s.every, int):
        yield Idle(["every"], f"{scheme} counts steps", "a whole number")
    if s.dt is not None:
        yield Idle(
            ["safety"],
            f"all steps are dt = {s.dt:g} s, and no share of the stable one",
            "leave one of them out",
        )


class Dynamics:
    """Follows the motion of a problem, with every load and support it has.

    Args:
        problem: What moves; every material needs a density.
        settings: See `DynamicsSettings`; keyword arguments are its fields.
        linear: How linear systems are solved (implicit scheme).
        petsc: PETSc options, which win over everything.
    """

    def __init__(
        self,
        problem: Problem,
        settings: DynamicsSettings | None = None,
        *,
        linear: LinearSettings | None = None,
        petsc: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        refuse_scalars(problem)
        self.problem = problem
        self.settings = settled(DynamicsSettings, settings, fields)
        self.linear = linear or LinearSettings()
        if not self.settings.implicit:
            self._refuse_linear()
        if self.settings.scheme == "alpha2":
            check_alpha2(problem)
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.velocity = fem.Function(problem.V, name="velocity")
        self._march: Explicit | Implicit | None = None

    def steps(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            saved: A `restart_state` from which the run continues, with the state after it.

        Raises:
            ConvergenceError: A step found no equilibrium however small it was made.
            StabilityError: The explicit step became larger than the stable one.
        """
        if self.problem.cell is not None:
            raise InputError(
                "a periodic cell has no motion",
                where="periodic",
                expected="leave it out, or use [statics]",
            )
        s = self.settings
        shocks = set_initial(self.problem, self.velocity, s.displacement, s.velocity, s.end)
        notes = [s.limited] if s.limited else []
        for note in [*notes, *shocks] if saved is None else ():
            log.warning("%s", note)
        begin_motion(self.problem, tell=saved is None)
        yield from self._implicit(saved) if s.implicit else self._explicit(saved)

    @property
    def ts(self) -> PETSc.TS:
        """PETSc's TS of an implicit motion that is on, for monitors and events of one's own.

        Its solution is that of all unknowns, and its second one the velocity.
        """
        if not isinstance(self._march, Implicit):
            raise RuntimeError("there is no TS: no implicit motion is on")
        return self._march.ts

    def restart_state(self) -> RestartState:
        """See `RestartableSolver`. Collective.

        Raises:
            RuntimeError: `steps` has not begun, or has ended.
        """
        if self._march is None:
            raise RuntimeError("there is nothing to keep: the motion has not begun, or has ended")
        return self._march.restart_state()

    def _refuse_linear(self) -> None:
        """Keys of [solver], where there is nothing to solve."""
        what = f"the scheme '{self.settings.scheme}' solves no equations"
        keys = ["petsc"] if self.linear.method == "auto" else ["method", "petsc"]
        refuse_idle(self.linear, [Idle(keys, what)], "solver")

    def _explicit(self, saved: SavedState | None) -> Iterator[State]:
        s = self.settings
        for name in self.petsc:
            log.warning("PETSc option '-%s' was not used: '%s' solves no equations", name, s.scheme)
        assert isinstance(s.every, int)
        march = EXPLICIT[s.scheme](
            self.problem, self.velocity, end=s.end, dt=s.dt, safety=s.safety, every=s.every
        )
        self._march = march
        try:
            yield from march.steps(saved)
        finally:
            self._march = None

    def _implicit(self, saved: SavedState | None) -> Iterator[State]:
        march = Implicit(self.problem, self.velocity, self.settings, self.linear, self.petsc)
        self._march = march
        try:
            yield from march.run(saved)
        finally:
            self._march = None
            march.destroy()
