"""Uniaxial stress of a metal that is pulled, let go, pressed and pulled again.

The law over a step at one point, with the lateral strain at which the lateral stress vanishes.
Numbers have a closed form: with the slope H of what hardens, isotropic and kinematic together, the
tangent modulus after yield is E H/(E + H) (Simo & Hughes, Computational Inelasticity (1998),
section 1.2.2.3).  After a pull to the stress s with the back stress b, the metal yields again where
the stress from b is as large the other way, at 2 b - s: Bauschinger's effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import ufl

from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.kinematics import deformation_from, gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.plasticity import PLASTIC_STRAIN, Plastic
from dolfin_elastic.model.point.steps import PointOverSteps
from dolfin_elastic.model.point.tested import Finding

_STEPS = 20
"""Beyond yield, in each pull or press."""
_TURNS = 4
"""How often the strain turns around."""
_ITERATIONS = 30
_NEAR = 1e-8
"""A last change of the lateral strain, whose square is round-off."""
_ROUND_OFF = 1e-14
"""Growth of the plastic strain that is none: at the start of a step the metal is at its limit."""
_GOOD = 1e-6
"""Relative difference of stresses that are equal to a reader."""
_PARTS, _DIVISIONS = 64, 8
"""Of the interval in which a yield point lies: 64^-8 of it is round-off."""


@dataclass(frozen=True)
class CyclicCurve:
    """States of uniaxial stress in their order.

    Of laws for large strains, strain is the logarithmic one and stress the Kirchhoff stress, J
    times the Cauchy stress, between which the law is linear.

    Attributes:
        law: The metal.
        stretch: Shape (n,); 1 first.
        lateral: Stretch across, shape (n,).
        nominal: Force over undeformed area [Pa], shape (n,).
        plastic: Equivalent plastic strain, shape (n,).
        yields: Stress at which the virgin metal yields [Pa].
        tangent: Slope of stress over strain just beyond [Pa].
        turned: Stress at which the first pull ends [Pa].
        again: Stress at which it yields on the way back from there [Pa].
    """

    law: Plastic
    stretch: FloatArray
    lateral: FloatArray
    nominal: FloatArray
    plastic: FloatArray
    yields: float
    tangent: float
    turned: float
    again: float

    @cached_property
    def strain(self) -> FloatArray:
        """Along the bar, shape (n,)."""
        return self.stretch - 1 if self.law.linear else np.log(self.stretch)

    @cached_property
    def stress(self) -> FloatArray:
        """Along the bar [Pa], shape (n,)."""
        return self.nominal if self.law.linear else self.nominal * self.stretch

    @property
    def measures(self) -> tuple[str, str]:
        """What `strain` and `stress` are."""
        if self.law.linear:
            return "strain", "stress"
        return "logarithmic strain", "Kirchhoff stress"

    @property
    def cauchy(self) -> FloatArray:
        """Force over current area [Pa], shape (n,)."""
        return self.nominal / self.lateral**2

    @property
    def bauschinger(self) -> float:
        """Stress of the first yield under pressure over that at which the pull before has ended."""
        return -self.again / self.turned


@dataclass(frozen=True)
class _States:
    """Of the bar at ends of a step, each of shape (n,).

    Attributes:
        e: Displacement gradient along it.
        w: Displacement gradient across.
        nominal: Stress along it [Pa].
        slope: Of `nominal` over `e` while nothing pushes from the sides [Pa].
        thinner: Slope of `w` over `e`.
    """

    e: FloatArray
    w: FloatArray
    nominal: FloatArray
    slope: FloatArray
    thinner: FloatArray

    def __getitem__(self, i: int) -> _States:
        """One of them."""
        return _States(*(getattr(self, f.name)[i : i + 1] for f in fields(self)))


class _Bar:
    """Uniaxial stress at a point.

    Attributes:
        at: The state as the step began.
    """

    def __init__(self, law: Plastic) -> None:
        slow = law.model_copy(update={"plastic_viscosity": None, "rate_integration": None})
        domain = gradient_symbol().ufl_domain()
        symbols = ufl.Constant(domain), ufl.Constant(domain)
        e, w = (ufl.variable(symbol) for symbol in symbols)
        F = deformation_from(ufl.as_matrix([[e, 0, 0], [0, w, 0], [0, 0, w]]))
        self._point = PointOverSteps(slow, F, symbols)
        P = self._point.law.stress(F)
        along, across = P[0, 0], P[1, 1]
        slopes = [ufl.diff(p, x) for p in (along, across) for x in (e, w)]
        self._numbers = self._point.quantity(ufl.as_vector([along, across, *slopes]))
        self.at = _States(*np.zeros((5, 1)))

    @property
    def plastic(self) -> float:
        """Equivalent plastic strain at the start of the step."""
        return float(self._point.values[PLASTIC_STRAIN.name][0, 0])

    def states(self, e: FloatArray) -> _States:
        """Ends of the step at which the sides are free, by Newton's method."""
        w = self.at.w + self.at.thinner * (e - self.at.e)
        for _ in range(_ITERATIONS):
            along, across, ee, ew, we, ww = self._numbers(e, w, dt=0.0).T
            change = -across / ww
            w, along = w + change, along + ew * change
            if np.abs(change).max() <= _NEAR:
                break
        return _States(e, w, along, ee - ew * we / ww, -we / ww)

    def grows(self, states: _States) -> BoolArray:
        """Where the plastic strain grows in the step."""
        ends = self._point.at_end(states.e, states.w, dt=0.0)
        return np.asarray(ends[PLASTIC_STRAIN.name][:, 0] > self.plastic + _ROUND_OFF)

    def commit(self, states: _States) -> None:
        """Ends the step in one state."""
        self._point.commit(states.e, states.w, dt=0.0)
        self.at = states

    def yield_point(self, end: float) -> _States | None:
        """First state that yields on the way to a strain, to round-off; None: none does."""
        low, high = float(self.at.e[0]), end
        for _ in range(_DIVISIONS):
            states = self.states(np.linspace(low, high, _PARTS + 1, dtype=np.float64))
            beyond = np.flatnonzero(self.grows(states))
            if not len(beyond):
                return None
            first = int(beyond[0])
            low, high = float(states.e[max(first - 1, 0)]), float(states.e[first])
        return states[first]


def cyclic_curve(law: Law, largest: float) -> CyclicCurve | None:
    """The cyclic curve of a metal, which is strained slowly.

    Args:
        law: With numbers as constants, not values that vary in space.
        largest: Stretch at which the strain turns around; under pressure it is as large.

    Returns:
        None: nothing yields, or not up to there.
    """
    if not isinstance(law, Plastic):
        return None
    bar, plastic, bends, ends = _Bar(law), [0.0], [], []
    states = [bar.at]
    for turn in range(_TURNS + 1):
        end = _gradient(law, (-1) ** turn * largest_strain(law, largest))
        bend = bar.yield_point(end)
        if bend is None and not turn:
            return None
        for e in [end] if bend is None else np.linspace(float(bend.e[0]), end, _STEPS + 1):
            bar.commit(bar.states(np.array([e])))
            states.append(bar.at)
            plastic.append(bar.plastic)
        bends.append(bend)
        ends.append(bar.at)
    first, again = bends[0], bends[1]
    assert first is not None
    yields, tangent = _measured(law, first)
    return CyclicCurve(
        law,
        stretch=np.concatenate([1 + state.e for state in states]),
        lateral=np.concatenate([1 + state.w for state in states]),
        nominal=np.concatenate([state.nominal for state in states]),
        plastic=np.array(plastic),
        yields=yields,
        tangent=tangent,
        turned=_measured(law, ends[0])[0],
        again=math.nan if again is None else _measured(law, again)[0],
    )


def largest_strain(law: Plastic, stretch: float) -> float:
    """Strain at a stretch, in the measure of `CyclicCurve`."""
    return stretch - 1 if law.linear else math.log(stretch)


def _gradient(law: Plastic, strain: float) -> float:
    """Displacement gradient along the bar, from the strain."""
    return strain if law.linear else math.expm1(strain)


def _measured(law: Plastic, state: _States) -> tuple[float, float]:
    """Stress of one state, and its slope over strain, in the measures of `CyclicCurve` [Pa]."""
    e, nominal, slope = (float(x[0]) for x in (state.e, state.nominal, state.slope))
    if law.linear:
        return nominal, slope
    return nominal * (1 + e), (nominal + (1 + e) * slope) * (1 + e)


def cyclic_findings(curve: CyclicCurve) -> Iterator[Finding]:
    """The numbers of a cyclic curve, in words."""
    strain = largest_strain(curve.law, float(curve.stretch.max()))
    values = {
        "strain": strain,
        "yields": curve.yields,
        "tangent": curve.tangent,
        "turned": curve.turned,
        "again": curve.again,
        "bauschinger": curve.bauschinger,
    }
    back = "it does not yield on the way back"
    if math.isfinite(curve.again):
        weaker = curve.bauschinger < 1 - _GOOD
        back = f"it yields on the way back at {quantity(curve.again, 'Pa')}"
        back += f" (Bauschinger's effect: {percent(curve.bauschinger)})" if weaker else ""
    tangent, turned = (quantity(value, "Pa") for value in (curve.tangent, curve.turned))
    text = (
        f"between strains of {100 * strain:.3g} and -{100 * strain:.3g} %: the tangent modulus "
        f"after yield is {tangent}; pulled up to {turned}, {back}"
    )
    if curve.law.plastic_viscosity is not None:
        text += "; strained slowly, without the stress of its viscosity"
    yield Finding("cycles", "note", text, values)
