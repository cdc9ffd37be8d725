"""Motion: settings of all schemes, and implicit dynamics by PETSc TS in second-order form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, Literal

from dolfinx import fem
from pydantic import Field, model_validator

from dolfin_elastic.errors import InputError
from dolfin_elastic.kept import Kept, Restore
from dolfin_elastic.model.components import Component, components, depends_on_time
from dolfin_elastic.problem import Problem
from dolfin_elastic.schema import Record
from dolfin_elastic.solvers.alpha import Alpha
from dolfin_elastic.solvers.contact import begin_motion
from dolfin_elastic.solvers.explicit import SCHEMES as EXPLICIT
from dolfin_elastic.solvers.explicit import Explicit
from dolfin_elastic.solvers.initial import set_initial
from dolfin_elastic.solvers.linear import LinearSettings
from dolfin_elastic.solvers.scalars import refuse_scalars
from dolfin_elastic.state import State
from dolfin_elastic.units import Force, Time


class DynamicsSettings(Record):
    """How motion is followed through time.

    Attributes:
        scheme: "generalized-alpha" (implicit, PETSc's TSALPHA2), or explicit, with lumped mass and
            linear elements: "symplectic-euler" (v += dt f/m, then x += dt v) or
            "central-differences" (the velocity halfway between places, of second order).
        end: When it ends [s]; it starts at 0.
        dt: Time step [s].  Implicit: needed; the first step if adaptive.  Explicit: the stable
            step times `safety` if not given; a larger one than the stable one is refused.
        adaptive: Let the error estimate choose the implicit step.
        tolerance: Relative error a step may make in displacement and velocity, if adaptive.
        spectral_radius: Of the generalized-alpha scheme at infinite frequency: 1 keeps the
            energy of a linear body, less damps what the step cannot resolve.
        initial_displacement: Components [m] or formulas in x, y, z.
        initial_velocity: Components [m/s] or formulas in x, y, z.
        rtol: Newton's tolerance, relative to the forces of the step.
        atol: Free residual that always is small enough [N].
        max_iterations: Newton iterations after which a step is made smaller.
        safety: Share of the stable step that the explicit scheme takes.
        every: Steps from one yielded state to the next; if not given each step is one, of
            explicit schemes about 200 in all.
    """

    scheme: Literal["generalized-alpha", "symplectic-euler", "central-differences"] = (
        "generalized-alpha"
    )
    end: Time = Field(gt=0)
    dt: Time | None = Field(default=None, gt=0)
    adaptive: bool = False
    tolerance: float = Field(default=1e-3, gt=0, lt=1)
    spectral_radius: float = Field(default=0.9, ge=0, le=1)
    initial_displacement: list[Any] = Field(default=[])
    initial_velocity: list[Any] = Field(default=[])
    rtol: float = Field(default=1e-8, gt=0, lt=1)
    atol: Force = Field(default=0.0, ge=0)
    max_iterations: int = Field(default=20, ge=1)
    safety: float = Field(default=0.9, gt=0, le=1)
    every: int = Field(default=0, ge=1)

    @model_validator(mode="after")
    def _read(self) -> DynamicsSettings:
        _ = self.displacement, self.velocity
        if self.dt is None and not self.explicit:
            raise ValueError(f"'{self.scheme}' needs a time step dt")
        if self.adaptive and self.explicit:
            raise ValueError("an adaptive step needs the scheme 'generalized-alpha'")
        if not self.explicit:  # an explicit scheme knows only later how many steps it takes
            self.__dict__["every"] = self.every or 1
        return self

    @property
    def explicit(self) -> bool:
        """The scheme solves no equations."""
        return self.scheme in EXPLICIT

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
        self._march: Explicit | None = None

    def steps(self, restore: Restore | None = None) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            restore: Brings back what `kept` gave: begins with the step after.

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
        if s.explicit:
            self._march = EXPLICIT[s.scheme](
                self.problem, self.velocity, end=s.end, dt=s.dt, safety=s.safety, every=s.every
            )
            yield from self._march.steps(restore)
        else:
            yield from self._implicit()

    def kept(self) -> Kept:
        """All that the step after a yielded state needs to know."""
        assert self._march is not None
        return self._march.kept()

    def _implicit(self) -> Iterator[State]:
        march = Alpha(self.problem, self.velocity, self.settings, self.linear, self.petsc)
        try:
            yield from march.run()
        finally:
            march.destroy()
