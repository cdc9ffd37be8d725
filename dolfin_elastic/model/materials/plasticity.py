"""The yield condition of von Mises, and the return of a trial stress to it.

With q the von Mises stress of the trial stress measured from the back stress, a the equivalent
plastic strain and M = 3 mu + H_kin + eta/dt, the growth d of a over a step of backward Euler is the
root of

    q - M d - sigma_y(a + d) = 0,

the only unknown where the flow is in the direction of the trial stress.  Of straight pieces of
sigma_y the root is explicit; of Voce's law it is that of y = c + k exp(-y), which Newton's method
approaches from one side.  The trapezoidal rule, of second order in dt where eta is given, is half a
step at the plastic rate of the start, which is remembered, and half a step of backward Euler.  What
hardening takes up counts as dissipated, but for the energy of the back stress: the plastic work
less that is the integral of sigma_y over a.

Source: Simo & Hughes, Computational Inelasticity (1998), sections 2.4 and 3.3; E. Voce, Metallurgia
51 (1955) 219; P. Perzyna, Adv. Appl. Mech. 9 (1966) 243.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, Self, TypeAlias

import numpy as np
import ufl
from pydantic import AliasChoices, BeforeValidator, Field, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.types import FloatArray, Scalar
from dolfin_elastic.core.units import Number, Quantity, SpatialValue, Stress, Viscosity
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.memory import Memory, OverStep, Values, Variable
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.spatial import Range

NEWTON = 6
"""Iterations for Voce's law: k is the first slope of the curve over 3 mu, below 0.1 for metals,
where three are exact to round-off; six are so up to k = 20."""
STEEPEST = 20.0
"""Largest k that is computed."""
AT_ONCE = 1e30
"""1/dt [1/s] of a step without a length, in which nothing flows against a viscosity."""

LIMIT = "limit"
"""Name of the constant of a step by which the yield stress is multiplied."""
NEVER = 1e9
"""Its value where nothing is to yield: stiffness about a state, not a step."""


class HardeningCurve(Record):
    """The yield stress over the equivalent plastic strain: a table, or Voce's law.

    Voce: sigma_y = yield + slope a + (saturation - yield) (1 - exp(-rate a)).

    Attributes:
        table: Pairs of the equivalent plastic strain, which begins with 0, and the yield stress
            [Pa]. Between them it is a straight line, beyond the last one constant.
        saturation: Yield stress that is approached [Pa].
        rate: How fast: 1 over the plastic strain in which the rest falls to 1/e.
        slope: Hardening that goes on beside it [Pa].
    """

    table: tuple[tuple[Number, Stress], ...] = ()
    saturation: Stress | None = Field(default=None, gt=0)
    rate: Number | None = Field(default=None, gt=0)
    slope: Stress = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.table and (self.saturation is not None or self.rate is not None or self.slope):
            raise InputError(
                "a table beside the constants of Voce's law",
                expected="either table, or saturation, rate and slope",
            )
        if not self.table and (self.saturation is None or self.rate is None):
            raise InputError(
                "neither a table nor both saturation and rate",
                expected='for example {saturation = "350 MPa", rate = 20}',
            )
        if any(isinstance(x, SpatialValue) for row in self.table for x in row):
            raise InputError(
                "a table of numbers that vary in space", expected="a material for each region"
            )
        if self.table and self.table[0][0] != 0.0:
            raise InputError(
                f"the table begins at a plastic strain of {self.table[0][0]:g}",
                where="table",
                expected='the first yield stress at 0, for example [0, "250 MPa"]',
            )
        for (a, low), (b, high) in pairwise(self.table):
            if not b > a:
                raise InputError(
                    f"the plastic strain {b:g} follows {a:g}",
                    where="table",
                    expected="plastic strains that increase",
                )
            if high < low:
                raise InputError(
                    f"the yield stress falls at a plastic strain of {b:g}",
                    where="table",
                    expected="yield stresses that do not fall: softening has no answer that is "
                    "the same on every mesh",
                )
        return self


def _read(value: object) -> object:
    return {"table": value} if isinstance(value, list | tuple) else value


if TYPE_CHECKING:
    Hardening: TypeAlias = float | HardeningCurve
else:
    Hardening = Annotated[float, Quantity("Pa", HardeningCurve), BeforeValidator(_read)]
    """The slope of the yield stress over the equivalent plastic strain [Pa], or a curve."""


class Plastic(Isotropic, SplitLaw):
    """A law that yields where the von Mises stress reaches a limit.

    Attributes:
        yield_stress: Yield stress [Pa] of the virgin material; not beside a table of `hardening`.
        hardening: By how much the yield stress grows with the equivalent plastic strain: a slope
            [Pa]; a table [[plastic strain, yield stress], ...]; or Voce's law {saturation = ...,
            rate = ..., slope = ...}.
        kinematic: Kinematic hardening: slope of the back stress over the plastic strain in
            uniaxial tension [Pa]; without, there is no back stress.
        plastic_viscosity: eta of the overstress eta da/dt [Pa s] (Perzyna): the faster, the more
            stress. Statics then needs steps in time.
        rate_integration: With `plastic_viscosity`, how a step follows the plastic rate:
            "backward-euler", of first order, or "trapezoidal", of second order where steps are
            shorter than eta/E; longer ones oscillate.
    """

    yield_stress: Stress | None = Field(
        default=None, gt=0, validation_alias=AliasChoices("yield_stress", "yield")
    )
    hardening: Hardening = 0.0
    kinematic: Stress | None = Field(default=None, ge=0)
    plastic_viscosity: Viscosity | None = Field(default=None, gt=0)
    rate_integration: Literal["backward-euler", "trapezoidal"] | None = None

    @model_validator(mode="after")
    def _has_a_rate(self) -> Self:
        if self.rate_integration is not None and self.plastic_viscosity is None:
            raise InputError(
                "without a viscosity the plastic strain has no rate to integrate",
                where="rate_integration",
                expected="leave it out, or give plastic_viscosity, too",
            )
        return self

    @model_validator(mode="after")
    def _yields(self) -> Self:
        curve = self.hardening
        table = curve.table if isinstance(curve, HardeningCurve) else ()
        if table and self.yield_stress is not None:
            raise InputError(
                "a yield stress beside a table that begins with one",
                where="yield",
                expected="leave it out",
            )
        if table and not table[0][1] > 0:
            raise InputError(
                "the yield stress is not positive", where="hardening.table[0]", expected="above 0"
            )
        if not table and self.yield_stress is None:
            raise InputError(
                "the key is missing",
                where="yield",
                expected='for example "250 MPa", or a table of `hardening`',
            )
        if not isinstance(curve, HardeningCurve) and not isinstance(curve, SpatialValue):
            if curve < 0:
                raise InputError(
                    f"{curve:g} Pa: the material would soften",
                    where="hardening",
                    expected="at least 0: softening has no answer that is the same on every mesh",
                )
        elif isinstance(curve, HardeningCurve) and curve.saturation is not None:
            first, rate = self.yield_stress, curve.rate
            if not isinstance(first, float) or not isinstance(self.mu, float) or rate is None:
                raise InputError(
                    "constants that vary in space beside a saturation",
                    where="hardening",
                    expected="a slope, or a material for each region",
                )
            steep = rate * (curve.saturation - first) / (3 * self.mu)
            if steep > STEEPEST:
                raise InputError(
                    f"the yield stress rises {steep:.3g} times as fast as an elastic stress would",
                    where="hardening.rate",
                    expected=f"at most {STEEPEST:g} times: saturation and rate of a metal give 0.1",
                )
            if curve.saturation < first:
                raise InputError(
                    "the yield stress would fall to its saturation",
                    where="hardening.saturation",
                    expected=f"at least the yield stress, {first:g} Pa",
                )
        return self

    @classmethod
    def ranges(cls) -> dict[str, Range]:
        """See `Law.ranges`."""
        return {**super().ranges(), "hardening": Range(low=0.0, low_too=True)}

    @property
    def timed(self) -> bool:
        """It depends on how long a step takes."""
        return self.plastic_viscosity is not None

    @property
    def back_slope(self) -> Scalar:
        """`kinematic`, or 0."""
        return 0.0 if self.kinematic is None else self.kinematic

    @property
    def trapezoidal(self) -> bool:
        """A step begins at the plastic rate of its start."""
        return self.rate_integration == "trapezoidal"

    @property
    def first_yield(self) -> float | None:
        """Yield stress of the virgin material [Pa]; None where it varies in space."""
        curve = self.hardening
        if isinstance(curve, HardeningCurve) and curve.table:
            return curve.table[0][1]
        return self.yield_stress if isinstance(self.yield_stress, float) else None

    @property
    def flow(self) -> Flow:
        """The yield stress as a function, and the root of the module."""
        curve = self.hardening
        if not isinstance(curve, HardeningCurve):
            return _Straight(self.yield_stress, curve)
        if curve.table:
            return _Pieces(curve.table)
        return _Voce(self.yield_stress, curve.slope, curve.saturation, curve.rate)


class Flow(ABC):
    """The yield stress sigma_y over the equivalent plastic strain a; all are UFL scalars [Pa]."""

    @abstractmethod
    def stress(self, a: Expr) -> Expr:
        """sigma_y(a)."""

    @abstractmethod
    def work(self, a: Expr) -> Expr:
        """Its integral from 0 to a [J/m^3]."""

    @abstractmethod
    def growth(self, q: Expr, M: Expr, a: Expr) -> Expr:
        """d of the module where q is above sigma_y(a)."""


@dataclass(frozen=True)
class _Straight(Flow):
    """sigma_y = first + slope a."""

    first: Scalar
    slope: Scalar

    def stress(self, a: Expr) -> Expr:
        """See `Flow`."""
        return self.first + self.slope * a

    def work(self, a: Expr) -> Expr:
        """See `Flow`."""
        return self.first * a + self.slope / 2 * a**2

    def growth(self, q: Expr, M: Expr, a: Expr) -> Expr:
        """See `Flow`."""
        return (q - self.stress(a)) / (M + self.slope)


@dataclass(frozen=True)
class _Pieces(Flow):
    """Straight lines between the rows of a table, constant beyond the last."""

    rows: tuple[tuple[float, float], ...]

    @property
    def _lines(self) -> list[tuple[float, float, float]]:
        """Start, yield stress there and slope of each piece."""
        slopes = [(t - s) / (b - a) for (a, s), (b, t) in pairwise(self.rows)]
        return [(a, s, h) for (a, s), h in zip(self.rows, [*slopes, 0.0], strict=True)]

    def _piece(self, begun: list[Expr]) -> tuple[Expr, Expr]:
        """Intercept and slope of the last piece that has begun; the first one has."""
        a, s, slope = self._lines[0]
        chosen = ufl.as_ufl(s - slope * a), ufl.as_ufl(slope)
        for (a, s, slope), condition in zip(self._lines[1:], begun, strict=True):
            chosen = (
                ufl.conditional(condition, s - slope * a, chosen[0]),
                ufl.conditional(condition, slope, chosen[1]),
            )
        return chosen

    def stress(self, a: Expr) -> Expr:
        """See `Flow`."""
        intercept, slope = self._piece([ufl.gt(a, row[0]) for row in self.rows[1:]])
        return intercept + slope * a

    def work(self, a: Expr) -> Expr:
        """See `Flow`."""
        result, ends = ufl.as_ufl(0.0), [row[0] for row in self.rows[1:]]
        for (start, s, slope), end in zip(self._lines, [*ends, None], strict=True):
            inside = ufl.max_value(a - start, 0.0)
            inside = inside if end is None else ufl.min_value(inside, end - start)
            result += s * inside + slope / 2 * inside**2
        return result

    def growth(self, q: Expr, M: Expr, a: Expr) -> Expr:
        """See `Flow`: the line q - M (b - a) meets the curve in the last piece it begins above."""
        begun = [ufl.gt(q - M * (b - a), s) for b, s in self.rows[1:]]
        intercept, slope = self._piece(begun)
        return (q - intercept - slope * a) / (M + slope)


@dataclass(frozen=True)
class _Voce(Flow):
    """sigma_y = first + slope a + (saturation - first) (1 - exp(-rate a))."""

    first: Scalar
    slope: Scalar
    saturation: Scalar
    rate: Scalar

    def stress(self, a: Expr) -> Expr:
        """See `Flow`."""
        rest = (self.saturation - self.first) * ufl.exp(-self.rate * a)
        return self.saturation + self.slope * a - rest

    def work(self, a: Expr) -> Expr:
        """See `Flow`."""
        risen = (1 - ufl.exp(-self.rate * a)) / self.rate
        linear = self.saturation * a + self.slope / 2 * a**2
        return linear - (self.saturation - self.first) * risen

    def growth(self, q: Expr, M: Expr, a: Expr) -> Expr:
        """See `Flow`."""
        per = self.rate / (M + self.slope)
        c = per * (q - self.saturation - self.slope * a)
        k = per * (self.saturation - self.first) * ufl.exp(-self.rate * a)
        y = ufl.max_value(c, 0.0)  # below the root, as all iterates are
        for _ in range(NEWTON):
            e = k * ufl.exp(-y)
            y = y + (c + e - y) / (1 + e)
        return y / self.rate


@dataclass(frozen=True)
class Return:
    """A trial stress returned to the yield surface; UFL scalars.

    Attributes:
        growth: Of the equivalent plastic strain; 0 where nothing yields.
        share: growth over q of the module [1/Pa], so that the plastic strain grows by 3/2 share
            times the deviator of the trial stress.
    """

    growth: Expr
    share: Expr


PLASTIC_STRAIN = Variable("plastic_strain")
VISCOUS = Variable("viscous_work")
"""Work against the plastic viscosity [J/m^3]."""
RATE = "plastic_rate"
"""Of the plastic strain tensor [1/s], its name among the variables."""
POWER = Variable("viscous_power")
"""Rate of `VISCOUS` [W/m^3]."""


def returned(
    law: Plastic, deviator: Expr, past: Mapping[str, Expr], step: Mapping[str, Expr]
) -> Return:
    """Returns a trial stress to the yield surface.

    Args:
        deviator: Of the trial stress measured from the back stress [Pa], shape (3, 3).
        past: With `PLASTIC_STRAIN`.
        step: See `PlasticMemory.step`.
    """
    a, square = past[PLASTIC_STRAIN.name], 1.5 * ufl.inner(deviator, deviator)
    limit = step[LIMIT] * law.flow.stress(a)
    yields = ufl.gt(square, limit**2)
    # UFL evaluates both branches: where nothing yields the root must not be that of 0.
    q = ufl.sqrt(ufl.conditional(yields, square, limit**2))
    M = 3 * law.mu + law.back_slope
    if law.plastic_viscosity is not None:
        M += law.plastic_viscosity * step["per_dt"]
    growth = law.flow.growth(q, M, a)
    return Return(ufl.conditional(yields, growth, 0.0), ufl.conditional(yields, growth / q, 0.0))


def scalars_at_end(
    law: Plastic, growth: Expr, past: Mapping[str, Expr], step: Mapping[str, Expr]
) -> dict[str, Expr]:
    """Equivalent plastic strain, and work and power against a viscosity, at the end of a step."""
    result = {PLASTIC_STRAIN.name: past[PLASTIC_STRAIN.name] + growth}
    if law.plastic_viscosity is not None:
        work = law.plastic_viscosity * step["per_dt"] * growth**2
        result[VISCOUS.name] = past[VISCOUS.name] + work
        if law.trapezoidal:
            result[POWER.name] = work * step["per_dt"]
    return result


def dissipated(law: Plastic, scalars: Mapping[str, Expr]) -> Expr:
    """Per reference volume [J/m^3], of what `scalars_at_end` gives."""
    work = law.flow.work(scalars[PLASTIC_STRAIN.name])
    return work + scalars[VISCOUS.name] if VISCOUS.name in scalars else work


class PlasticMemory(Memory):
    """The plastic strain, as a tensor and as the equivalent one; of the trapezoidal rule its rate.

    Args:
        tensor: What the law keeps of the tensor.
        stepped: The law over a step, of past and step.
        plane_stress: See `Memory`.
    """

    def __init__(
        self,
        law: Plastic,
        tensor: Variable,
        stepped: Callable[[Mapping[str, Expr], Mapping[str, Expr]], OverStep],
        *,
        plane_stress: bool = True,
    ) -> None:
        self._stepped, self._law, self._tensor = stepped, law, tensor
        self.timed, self.plane_stress = law.timed, plane_stress
        self._seen = (tensor, PLASTIC_STRAIN, *((VISCOUS,) if law.timed else ()))
        rates = (Variable(RATE, tensor.shape), POWER) if law.trapezoidal else ()
        self.variables = (*self._seen, *rates)

    @property
    def seen(self) -> tuple[Variable, ...]:
        """See `Memory`."""
        return self._seen

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> OverStep:
        """See `Memory`."""
        return self._stepped(past, step)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`; of the trapezoidal rule the half that is one of backward Euler."""
        if not self.timed:
            return {LIMIT: 1.0}
        implicit = dt / 2 if self._law.trapezoidal else dt
        return {LIMIT: 1.0, "per_dt": 1 / implicit if dt > 0 else AT_ONCE}

    def elastic_step(self) -> dict[str, float]:
        """See `Memory`: a state at its yield stress is far from it."""
        return {LIMIT: NEVER}

    def fold(self, values: Values, dt: float) -> Values:
        """See `Memory`: of the trapezoidal rule after half a step at the rate of its start."""
        if not self._law.trapezoidal or dt == 0.0:
            return {v.name: values[v.name] for v in self._seen}
        grown = dt / 2 * values[RATE]
        length = np.sqrt(2 / 3 * self._tensor.square(grown))[:, None]
        return {
            self._tensor.name: self.advanced(values[self._tensor.name], grown),
            PLASTIC_STRAIN.name: values[PLASTIC_STRAIN.name] + length,
            VISCOUS.name: values[VISCOUS.name] + dt / 2 * values[POWER.name],
        }

    def advanced(self, tensor: FloatArray, grown: FloatArray) -> FloatArray:
        """What the law keeps of the tensor, after the plastic strain has grown; (n, size) each."""
        return tensor + grown
