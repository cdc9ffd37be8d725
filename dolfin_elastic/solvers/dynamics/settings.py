"""Settings of motion, for implicit and explicit schemes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_serializer, model_validator

from dolfin_elastic.core.errors import InputError, UnitError, nearest
from dolfin_elastic.core.schema import (
    Record,
    UnusedKeys,
    quoted,
    refuse_times_beyond,
    refuse_unused_keys,
)
from dolfin_elastic.core.si_text import counted
from dolfin_elastic.core.units import Force, Number, Rate, Time, to_si
from dolfin_elastic.model.values import Component, components, depends_on_time
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.implicit.output_times import Interval

if TYPE_CHECKING:
    from dolfin_elastic.solvers.dynamics.schemes import ExplicitRow, ImplicitRow

DEFAULT = "generalized-alpha"


def _schemes() -> Mapping[str, ImplicitRow | ExplicitRow]:
    """The table `SCHEMES`, imported once there is a motion: all classes of schemes come with it."""
    from dolfin_elastic.solvers.dynamics.schemes import SCHEMES

    return SCHEMES


def _known(name: object) -> object:
    schemes = _schemes()
    if isinstance(name, str) and name in schemes:
        return name
    *names, last = (f"'{one}'" for one in schemes)
    expected = f"expected {', '.join(names)} or {last}"
    raise InputError(
        f"{quoted(name)} is wrong",
        expected=nearest(name, schemes) if isinstance(name, str) else expected,
    )


SchemeName = Annotated[str, BeforeValidator(_known)]
"""A key of `SCHEMES`."""


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
    def _short(cls, value: object) -> object:
        """Two numbers stand for both."""
        if isinstance(value, Mapping | Rayleigh):
            return value
        if not isinstance(value, list | tuple):
            raise InputError(
                f"{quoted(value)} is wrong",
                expected="expected [alpha, beta], of the mass in 1/s and of the stiffness in s, or "
                "a table {mass = alpha, stiffness = beta}",
            )
        if len(value) != 2:
            raise InputError(
                f"{counted(len(value), 'factor')} given",
                expected="expected two, [alpha, beta], or {mass = alpha, stiffness = beta}",
            )
        return {"mass": value[0], "stiffness": value[1]}


class BulkViscosityFactors(Record):
    """Bulk viscosity, see `problem.bulk_viscosity`.

    True stands for the usual factors, a number for the linear one beside the usual quadratic one.

    Attributes:
        linear: b1, by default 0.06.
        quadratic: b2, by default 1.2.
    """

    linear: Number = Field(default=0.06, ge=0)
    quadratic: Number = Field(default=1.2, ge=0)

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: object) -> object:
        if value is True:
            return {}
        if isinstance(value, Mapping | BulkViscosityFactors):
            return value
        form = "expected true, the linear factor such as 0.06, or a table {linear, quadratic}"
        return {"linear": _number(value, form)}


def _number(value: object, expected: str) -> object:
    """A number, as it is or as a text.

    Raises:
        InputError: It is none; with all forms that are allowed.
    """
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        with suppress(UnitError):
            to_si(value, "")
            return value
    raise InputError(f"{quoted(value)} is wrong", expected=expected)


def _fraction(value: object) -> object:
    return (
        value if value is None else _number(value, 'expected a fraction of the mass, 0.01 or "1 %"')
    )


MOST_STEPS = 1e9
"""Time steps that anybody means, and that TS counts."""

SHORTEST = 1e-12
"""First step of an adaptive motion over its end: below, the time hardly changes in it."""


LONGEST = 1e10
"""Longest motion [s]: three centuries."""


class MotionStart(Record):
    """A state that a motion starts from, but for what its supports prescribe.

    Attributes:
        file: Results of a run on the same mesh: their folder, or results.xdmf in it, relative to
            the case file.
        step: Number of the step in it, or "last".
        displacement: Vector field of the mesh's file, in the mesh's unit.
        velocity: The same, in this unit per second.
    """

    file: str | None = None
    step: int | Literal["last"] = "last"
    displacement: str | None = None
    velocity: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> MotionStart:
        if self.file is None:
            refuse_unused_keys(self, [UnusedKeys(["step"], "there is no file with steps")])
            if self.displacement is None and self.velocity is None:
                raise InputError("no state is given", expected='for example file = "beam_results"')
            return self
        rule = UnusedKeys(["displacement", "velocity"], "both are those of the file")
        refuse_unused_keys(self, [rule])
        return self


class DynamicsSettings(Record):
    """How a motion is integrated in time.

    Attributes:
        scheme: Implicit: "generalized-alpha", "energy-momentum", which is the same with a spectral
            radius of 1, "newmark", "implicit-euler", and "alpha2", PETSc's own one.  Explicit, with
            lumped mass and linear elements: "symplectic-euler" (v += dt f/m, then x += dt v) and
            "central-differences" (the velocity halfway between places, of second order).
        end: When it ends [s]; it starts at 0.
        dt: Time step [s].  Implicit: needed; the first step if adaptive.  Explicit: the stable
            step times `safety` if not given; a larger one than the stable one is refused.
        adaptive: Let the error estimate choose the implicit step (not that of "alpha2").
        tolerance: Error a step may make in the displacement of any node, over the largest
            displacement so far (in the first step, of a step of dt, too), if adaptive.
        spectral_radius: Of the generalized-alpha scheme at infinite frequency: 1 conserves energy
            and momenta, less damps what the step cannot resolve.  By default 0.9, and 1 where
            there are obstacles, if the energy of all materials is conserved.
        beta: Of Newmark's method; (gamma + 1/2)^2/4 by default.
        gamma: Of Newmark's method; 1/2 by default, more damps.
        rayleigh: Damping of the whole body; of explicit schemes only "central-differences" knows
            it, and only the factor of the mass.
        bulk_viscosity: Pressure against the rate of volume, which smears shocks
            ("central-differences").
        mass_scaling: Largest fraction of the body's mass that may be added at nodes of thin
            elements (explicit schemes): for dt, or for a step as long as that permits.
        preload: The motion starts from the equilibrium under what acts at t = 0; without, from the
            undeformed body.
        start: The state that it starts from, of other results or of the mesh's file; an
            `initial_velocity` replaces its velocity.
        initial_displacement: Components [m] or formulas in x, y, z.
        initial_velocity: Components [m/s] or formulas in x, y, z.
        rtol: Newton's tolerance, relative to the forces of the step.
        atol: Free residual that always is small enough [N].
        max_iterations: Newton iterations after which a step is made smaller.
        safety: Share of the stable step that the explicit scheme takes; at most 0.6 of it where
            there are obstacles.
        every: Steps from one yielded state to the next, if not given 1, of explicit schemes about
            200 states in all; or, with a unit, the time between states, which is met exactly
            (implicit schemes).
        times: Further times that are met exactly and yielded [s] (implicit schemes).
    """

    scheme: SchemeName = DEFAULT
    end: Time = Field(gt=0, le=LONGEST)
    dt: Time | None = Field(default=None, gt=0)
    adaptive: bool = False
    tolerance: float = Field(default=1e-3, gt=0, lt=1)
    spectral_radius: float | None = Field(default=None, ge=0, le=1)
    beta: float | None = Field(default=None, gt=0)
    gamma: float | None = Field(default=None, ge=0.5)
    rayleigh: Rayleigh | None = None
    bulk_viscosity: BulkViscosityFactors | None = None
    mass_scaling: Annotated[Number | None, BeforeValidator(_fraction)] = Field(
        default=None, gt=0, le=1
    )
    preload: bool = False
    start: MotionStart | None = None
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
        refuse_unused_keys(self, _unused(self))
        if self.preload:
            what = "the motion starts from the displacement of the preload"
            rule = UnusedKeys(["initial_displacement", "start"], what, "leave one of them out")
            refuse_unused_keys(self, [rule])
        if self.start is not None:
            what = "the displacement is that of `start`"
            rule = UnusedKeys(["initial_displacement"], what, "leave one of them out")
            refuse_unused_keys(self, [rule])
        if not self.implicit and self.rayleigh is not None and self.rayleigh.stiffness > 0:
            raise InputError(
                "explicit schemes damp by the mass alone: damping by the stiffness makes the "
                "stable step too short",
                where="rayleigh.stiffness",
                expected="rayleigh = [a, 0], with bulk_viscosity against shocks, or "
                '"generalized-alpha"',
            )
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
        if self.dt is not None:
            _refuse_tiny("dt", self.dt, self.end, SHORTEST if self.adaptive else 1 / MOST_STEPS)
        if isinstance(self.every, float) and self.every > 0:
            _refuse_tiny("every", self.every, self.end, 1 / MOST_STEPS)
        if self.adaptive and self.row.implicit and self.row.scheme.not_adaptive:
            raise InputError(
                self.row.scheme.not_adaptive,
                where="adaptive",
                expected="leave it out, or take 'generalized-alpha': the same scheme with an "
                "estimate of its own",
            )
        if self.adaptive and self.stability_limit:
            raise InputError(
                f"{self.stability_limit}: steps that follow the error only may be too long",
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
        refuse_times_beyond(self.times, self.end, "dynamics.end", "s")
        return self

    @property
    def row(self) -> ImplicitRow | ExplicitRow:
        """The scheme's row in `SCHEMES`."""
        return _schemes()[self.scheme]

    @property
    def implicit(self) -> bool:
        """The scheme solves equations."""
        return self.row.implicit

    @property
    def parameters(self) -> GeneralizedAlphaParameters | None:
        """Coefficients of an implicit scheme."""
        row = self.row
        if not row.implicit:
            return None
        return row.parameters(**{key: getattr(self, key) for key in row.keys})

    @property
    def stability_limit(self) -> str:
        """Why an implicit scheme is not stable with any step; empty where it is."""
        parameters = self.parameters
        return parameters.stability_limit if parameters else ""

    @property
    def damping(self) -> dict[str, float]:
        """Rayleigh's factors by name; zero without any."""
        given = self.rayleigh
        return {"mass": given.mass, "stiffness": given.stiffness} if given else {}

    @cached_property
    def displacement(self) -> tuple[Component, ...]:
        """Initial displacement as numbers and formulas."""
        return _initial_values("initial_displacement", self.initial_displacement, "m")

    @cached_property
    def velocity(self) -> tuple[Component, ...]:
        """Initial velocity as numbers and formulas."""
        return _initial_values("initial_velocity", self.initial_velocity, "m/s")


def refuse_memory(settings: DynamicsSettings, *, timed: bool) -> None:
    """Refuses what takes no steps over which a material could remember.

    Args:
        timed: A material depends on how long a step takes.

    Raises:
        InputError: The scheme is PETSc's own, or the motion begins with a strain.
    """
    if timed and settings.preload:
        raise InputError(
            "materials that depend on time have no equilibrium before it begins",
            where="dynamics.preload",
            expected="leave it out: let the load grow slowly in the motion",
        )
    if settings.start is not None:
        raise InputError(
            "results do not hold what materials remember",
            where="dynamics.start",
            expected="leave it out: let the load grow slowly in the motion"
            + ("" if timed else ", or preload = true"),
        )
    if settings.scheme == "alpha2":
        raise InputError(
            f"the scheme '{settings.scheme}' does not compute materials that remember",
            where="dynamics.scheme",
            expected='"generalized-alpha", or materials that remember nothing',
        )


def _refuse_tiny(key: str, step: float, end: float, share: float) -> None:
    """Refuses a step that never comes to the end.

    Args:
        step: Its length [s].
        end: When the motion ends [s].
        share: Of the end, which a step may have at least.
    """
    if step < share * end * (1 - 1e-9):
        raise InputError(
            f"{step:g} s would be {end / step:.3g} steps up to dynamics.end = {end:g} s"
            if step > 0 and end / step < float("inf")
            else f"{step:g} s would never come to dynamics.end = {end:g} s",
            where=key,
            expected=f"at least {share * end:g} s",
        )


def _initial_values(key: str, written: Sequence[object], unit: str) -> tuple[Component, ...]:
    """Components of a vector at the start, which cannot depend on time."""
    parts = components(written, unit, key=key) if written else ()
    if depends_on_time(parts):
        raise InputError(
            "an initial value does not depend on t",
            where=key,
            expected="a formula in x, y, z",
        )
    return parts


def _unused(s: DynamicsSettings) -> Iterator[UnusedKeys]:
    """Keys that have no meaning for the scheme, or for steps of this kind."""
    scheme, leave = f"the scheme '{s.scheme}'", "leave it out, or scheme = "
    knows: dict[str, str] = {}
    for name, row in _schemes().items():
        for key in row.keys:
            knows.setdefault(key, name)
    for key, name in knows.items():
        if key not in s.row.keys:
            yield UnusedKeys([key], f"{scheme} has no {key.replace('_', ' ')}", f'{leave}"{name}"')
    yield from (
        _unused_by_implicit(s, scheme) if s.implicit else _unused_by_explicit(s, scheme, leave)
    )


def _unused_by_implicit(s: DynamicsSettings, scheme: str) -> Iterator[UnusedKeys]:
    names = (name for name, row in _schemes().items() if not row.implicit)
    explicit = " and ".join(f'"{name}"' for name in names)
    yield UnusedKeys(
        ["safety"],
        f"{scheme} does not use the stable step",
        f"leave it out; it is for {explicit}",
    )
    yield UnusedKeys(
        ["mass_scaling"],
        f"{scheme} does not use the stable step",
        f"leave it out; it is for {explicit}",
    )
    yield UnusedKeys(
        ["bulk_viscosity"],
        f"{scheme} has no bulk viscosity",
        'leave it out; it is for "central-differences"',
    )
    if not s.adaptive:
        yield UnusedKeys(
            ["tolerance"],
            "all steps are dt: their error is not judged",
            "leave it out, or adaptive = true; rtol is Newton's tolerance",
        )


def _unused_by_explicit(s: DynamicsSettings, scheme: str, leave: str) -> Iterator[UnusedKeys]:
    leave += f'"{DEFAULT}"'
    if s.adaptive:
        yield UnusedKeys(
            ["adaptive"],
            f"{scheme} has no estimate of its error",
            f"{leave}; without dt the stable step is followed",
        )
    yield UnusedKeys(["tolerance"], f"{scheme} has no estimate of its error", "leave it out")
    yield UnusedKeys(["rtol", "atol", "max_iterations"], f"{scheme} solves no equations", leave)
    assert not s.row.implicit
    if not s.row.scheme.damps:
        instead = f'{leave}, or "central-differences"'
        yield UnusedKeys(["rayleigh"], f"{scheme} has no rayleigh damping", instead)
        central = 'leave it out; or scheme = "central-differences"'
        yield UnusedKeys(["bulk_viscosity"], f"{scheme} has no bulk viscosity", central)
    yield UnusedKeys(["times"], f"{scheme} meets no times exactly", leave)
    if s.dt is not None:
        yield UnusedKeys(
            ["safety"],
            f"dt = {s.dt:g} s is given, so the stable step is not used",
            "leave one of them out",
        )
