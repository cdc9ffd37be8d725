"""Motion: settings of all schemes, implicit and explicit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

from dolfinx import fem
from petsc4py import PETSc
from pydantic import Field, model_validator

from dolfin_elastic.errors import InputError
from dolfin_elastic.kept import Kept, Restore
from dolfin_elastic.model.components import Component, components, depends_on_time
from dolfin_elastic.problem import Problem
from dolfin_elastic.schema import Record
from dolfin_elastic.solvers.alpha import Scheme
from dolfin_elastic.solvers.contact import begin_motion
from dolfin_elastic.solvers.explicit import SCHEMES as EXPLICIT
from dolfin_elastic.solvers.explicit import Explicit
from dolfin_elastic.solvers.implicit import Implicit
from dolfin_elastic.solvers.initial import set_initial
from dolfin_elastic.solvers.linear import LinearSettings
from dolfin_elastic.solvers.scalars import refuse_scalars
from dolfin_elastic.state import State
from dolfin_elastic.units import Force, Rate, Time


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
        if isinstance(value, list | tuple) and len(value) == 2:
            return {"mass": value[0], "stiffness": value[1]}
        return value


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
        adaptive: Let the error estimate choose the implicit step.
        tolerance: Error a step may make in the displacement of any node, over the largest
            displacement so far, if adaptive.
        spectral_radius: Of the generalized-alpha scheme at infinite frequency: 1 keeps the
            energy of a linear body, less damps what the step cannot resolve.
        beta: Of Newmark's method; 1/4 by default.
        gamma: Of Newmark's method; 1/2 by default, more damps.
        rayleigh: Damping of the whole body (implicit schemes).
        initial_displacement: Components [m] or formulas in x, y, z.
        initial_velocity: Components [m/s] or formulas in x, y, z.
        rtol: Newton's tolerance, relative to the forces of the step.
        atol: Free residual that always is small enough [N].
        max_iterations: Newton iterations after which a step is made smaller.
        safety: Share of the stable step that the explicit scheme takes.
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
    every: Annotated[int, Field(ge=1)] | Annotated[Time, Field(gt=0)] = 0
    times: list[Annotated[Time, Field(gt=0)]] = Field(default=[])

    @model_validator(mode="after")
    def _read(self) -> DynamicsSettings:
        _ = self.displacement, self.velocity
        if self.dt is None and self.implicit:
            raise ValueError(f"'{self.scheme}' needs a time step dt")
        if self.adaptive and not self.implicit:
            raise ValueError("an adaptive step needs an implicit scheme")
        if self.implicit:  # an explicit scheme knows only later how many steps it takes
            self.__dict__["every"] = self.every or 1
        self._check_keys()
        for index, time in enumerate(self.times):
            if time > self.end:
                raise InputError(
                    f"{time:g} s lies beyond the end",
                    where=f"times[{index}]",
                    expected=f"at most dynamics.end = {self.end:g} s",
                )
        return self

    def _check_keys(self) -> None:
        """Keys that the scheme does not know."""
        wrong = {
            "beta": self.beta is not None and self.scheme != "newmark",
            "gamma": self.gamma is not None and self.scheme != "newmark",
            "rayleigh": self.rayleigh is not None and not self.implicit,
            "times": bool(self.times) and not self.implicit,
            "every": not isinstance(self.every, int) and not self.implicit,
        }
        for key in (key for key, is_wrong in wrong.items() if is_wrong):
            what = "counts steps" if key == "every" else f"has no {key}"
            raise InputError(
                f"the scheme '{self.scheme}' {what}",
                where=key,
                expected="a whole number" if key == "every" else "leave it out",
            )

    @property
    def implicit(self) -> bool:
        """The scheme solves equations."""
        return self.scheme not in EXPLICIT

    @property
    def parameters(self) -> Scheme | None:
        """Of an implicit scheme of our own; None: PETSc's."""
        match self.scheme:
            case "newmark":
                return Scheme.newmark(self.beta or 0.25, self.gamma or 0.5)
            case "implicit-euler":
                return Scheme.implicit_euler()
            case "alpha2":
                return None
        return Scheme.generalized_alpha(self.spectral_radius)

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
    found = components(written, unit) if written else ()
    if depends_on_time(found):
        raise InputError(
            "what holds at the start does not depend on t",
            where=key,
            expected="a formula in x, y, z",
        )
    return found


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
        if settings is not None and fields:
            raise TypeError(f"give settings or keywords, not both: {', '.join(fields)}")
        self.settings = settings or DynamicsSettings(**fields)
        self.linear = linear or LinearSettings()
        self.petsc = {**self.linear.petsc, **(petsc or {})}
        self.velocity = fem.Function(problem.V, name="velocity")
        self._march: Explicit | Implicit | None = None

    def steps(self, restore: Restore | None = None) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            restore: Fills what was `kept`, to go on from there; the state that was kept is not
                yielded again.

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
        set_initial(self.problem, self.velocity, s.displacement, s.velocity, s.end)
        begin_motion(self.problem)
        yield from self._implicit(restore) if s.implicit else self._explicit(restore)

    @property
    def ts(self) -> PETSc.TS:
        """PETSc's TS of an implicit motion that is on, for monitors and events of one's own.

        Its solution is that of all unknowns, and its second one the velocity.
        """
        if not isinstance(self._march, Implicit):
            raise RuntimeError("there is no TS: no implicit motion is on")
        return self._march.ts

    def kept(self) -> Kept:
        """What the next step needs to know, between two steps. Collective."""
        if self._march is None:
            raise RuntimeError("there is nothing to keep: the motion has not begun, or has ended")
        return self._march.kept()

    def _explicit(self, restore: Restore | None) -> Iterator[State]:
        s = self.settings
        for part in self.problem.parts:
            if part.law.viscosity is not None:
                raise InputError(
                    f"the scheme '{s.scheme}' knows no viscosity",
                    where=f"materials.{part.name}.viscosity",
                    expected='leave it out, or dynamics.scheme = "generalized-alpha"',
                )
        assert isinstance(s.every, int)
        march = EXPLICIT[s.scheme](
            self.problem, self.velocity, end=s.end, dt=s.dt, safety=s.safety, every=s.every
        )
        self._march = march
        try:
            yield from march.steps(restore)
        finally:
            self._march = None

    def _implicit(self, restore: Restore | None) -> Iterator[State]:
        march = Implicit(self.problem, self.velocity, self.settings, self.linear, self.petsc)
        self._march = march
        try:
            yield from march.run(restore)
        finally:
            self._march = None
            march.destroy()
