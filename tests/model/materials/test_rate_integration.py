"""Perzyna's plastic rate over steps at a point, against the closed form of a bar that is pulled.

Beyond the yield strain the stress is E (e - p), and p' = (E (e - p) - yield - H p)/eta: an
exponential where e grows at a constant rate.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import ufl
from scipy.integrate import solve_ivp

from dolfin_elastic import J2, J2Logarithmic
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.kinematics import deformation_from, gradient_symbol
from dolfin_elastic.model.materials.plasticity import VISCOUS, Plastic
from dolfin_elastic.model.point.steps import PointOverSteps

pytestmark = pytest.mark.usefixtures("serial_only")

E, NU, YIELD, H, ETA, MOST = 200e9, 0.3, 250e6, 2e9, 2e10, 0.01
RATES = [0.01, 0.1, 1.0]
Path = Callable[[float], float]


def metal(kind: type[Plastic], rule: str | None) -> Plastic:
    keys = {"plastic_viscosity": ETA, "rate_integration": rule}
    return kind(E=E, nu=NU, yield_stress=YIELD, hardening=H, **keys)


class Bar:
    """Uniaxial stress at a point: strain and stress are those that the law is linear in."""

    def __init__(self, law: Plastic) -> None:
        domain = gradient_symbol().ufl_domain()
        symbols = ufl.Constant(domain), ufl.Constant(domain)
        e, w = symbols[0], ufl.variable(symbols[1])
        F = deformation_from(ufl.as_matrix([[e, 0, 0], [0, w, 0], [0, 0, w]]))
        self.law, self.point, self.w = law, PointOverSteps(law, F, symbols), np.zeros(1)
        P = self.point.law.stress(F)
        numbers = ufl.as_vector([P[0, 0], P[1, 1], ufl.diff(P[1, 1], w)])
        self.numbers = self.point.quantity(numbers)

    def step(self, strain: float, dt: float) -> float:
        e = np.array([strain if self.law.linear else np.expm1(strain)])
        for _ in range(30):
            along, across, slope = self.numbers(e, self.w, dt=dt).T
            self.w = self.w - across / slope
            if abs(across / slope) < 1e-15:
                break
        self.point.commit(e, self.w, dt=dt)
        return float(along[0] if self.law.linear else along[0] * (1 + e[0]))


def pulled(law: Plastic, path: Path, end: float, steps: int) -> float:
    """Stress at the end."""
    bar, stress = Bar(law), 0.0
    for t in np.linspace(0, end, steps + 1)[1:]:
        stress = bar.step(path(t), end / steps)
    return stress


def exact(rate: float) -> float:
    """Stress at the strain MOST."""
    since, k = (MOST - YIELD / E) / rate, (E + H) / ETA
    p = E * rate / (E + H) * (since + np.expm1(-k * since) / k)
    return float(E * (MOST - p))


def errors(kind: type[Plastic], rule: str | None, rate: float, counts: tuple[int, ...]) -> list:
    law, end = metal(kind, rule), MOST / rate
    return [pulled(law, lambda t: rate * t, end, n) / exact(rate) - 1 for n in counts]


@pytest.mark.parametrize(("rate", "steps"), zip(RATES, (40, 2560, 480), strict=True))
def test_backward_euler_is_of_first_order(rate: float, steps: int) -> None:
    """The default.  Slowly pulled, the stress ends on a plateau where any step is good."""
    coarse, fine = errors(J2, None, rate, (steps // 2, steps))
    assert abs(fine) < 1e-4
    if rate > RATES[0]:
        assert np.log2(coarse / fine) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(("rate", "steps"), zip(RATES, (80, 240, 80), strict=True))
def test_the_trapezoidal_rule_is_of_second_order(rate: float, steps: int) -> None:
    coarse, fine = errors(J2, "trapezoidal", rate, (steps // 2, steps))
    assert abs(fine) < 1e-6
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.02)


@pytest.mark.parametrize(("rate", "steps"), [(0.01, 80), (1.0, 40)])
def test_at_large_strains(rate: float, steps: int) -> None:
    """The same between Kirchhoff stress and logarithmic strain, to the digits of its series."""
    one, two = (errors(kind, "trapezoidal", rate, (steps,))[0] for kind in (J2, J2Logarithmic))
    assert abs(two) < 1e-6
    assert two == pytest.approx(one, abs=1e-10)


def test_the_way_back_is_of_second_order() -> None:
    """The strain turns around: half a step goes on at the rate of its start, the other back.

    The flow ends and begins amid steps, so that the error over dt^2 wanders, but stays below 0.4.
    """
    times = [0.0, 0.1, 0.2]

    def path(t: float) -> float:
        return float(np.interp(t, times, [0, MOST, -MOST]))

    def rates(t: float, state: np.ndarray) -> list[float]:
        p, a = state
        stress = E * (path(t) - p)
        grown = max(abs(stress) - YIELD - H * a, 0.0) / ETA
        return [grown * np.sign(stress), grown]

    state = np.zeros(2)
    for part in zip(times[:-1], times[1:], strict=True):
        state = solve_ivp(rates, part, state, rtol=1e-12, atol=1e-16, max_step=1e-3).y[:, -1]
    wanted = E * (-MOST - state[0])
    law = metal(J2, "trapezoidal")
    for n in (40, 160, 640):
        assert abs(pulled(law, path, 0.2, n) / wanted - 1) < 0.4 / n**2


@pytest.mark.parametrize("rule", [None, "trapezoidal"])
def test_work_of_the_viscosity(rule: str | None) -> None:
    """Held at a strain, the stress falls to the yield stress: all of eta p'^2 dt has become heat.

    Ideal: with the overstress s, p' = s/eta and s' = -E p', so that the work is s^2/(2 E).
    """
    keys = {"plastic_viscosity": ETA, "rate_integration": rule}
    bar = Bar(J2(E=E, nu=NU, yield_stress=YIELD, **keys))
    tau = ETA / E
    over = bar.step(MOST, 1e-9 * tau) - YIELD
    n = 1000
    for _ in range(n):
        bar.step(MOST, 8 * tau / n)
    work = float(bar.point.values[VISCOUS.name][0, 0])
    left = float(np.exp(-16.0))
    assert work == pytest.approx((1 - left) * over**2 / (2 * E), rel=3e-5 if rule else 5e-3)


def test_without_a_viscosity_there_is_no_rate() -> None:
    with pytest.raises(InputError, match="no rate to integrate"):
        J2(E=E, nu=NU, yield_stress=YIELD, rate_integration="trapezoidal")
