"""Constants of metals, and of branches that relax, from curves of known truth."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic import J2, MooneyRivlin, NeoHookean, fit
from dolfin_elastic.model.point.time_curves import time_curves
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.stepped import SteppedBars

pytestmark = pytest.mark.usefixtures("serial_only")
NONE = np.zeros((1, 0))
TERMS = [{"ratio": 0.4, "time": 0.5}, {"ratio": 0.25, "time": 20.0}]
T = np.geomspace(0.01, 200, 50)


def relaxed(t: np.ndarray, stretch: float, mu: float = 1e6) -> np.ndarray:
    """Nominal stress of an incompressible neo-Hookean bar: the strain stays, the stress fades."""
    modulus = 1 + sum(one["ratio"] * np.exp(-t / one["time"]) for one in TERMS)
    return mu * modulus * (stretch - stretch**-2)


def test_a_prony_series_comes_back_from_its_relaxation():
    law = {"law": "neo-hookean", "mu": "fit", "nu": 0.5}
    law["viscous"] = [{"ratio": "fit", "time": "fit"}] * 2
    found = fit(law, {"relaxation": (T, relaxed(T, 1.3), np.full_like(T, 1.3))}, starts=6)
    assert found["mu"].value == pytest.approx(1e6, rel=1e-6)
    terms = sorted((term.time, term.ratio) for term in found.law.viscous)
    assert terms[0] == pytest.approx((0.5, 0.4), rel=1e-5)
    assert terms[1] == pytest.approx((20.0, 0.25), rel=1e-5)


def test_relaxation_of_an_incompressible_law():
    """Mooney-Rivlin's stress at the stretch times 1 + r exp(-t/tau), the constants given."""
    s, r, tau = 1.4, 0.6, 3.0
    slow = 2 * (s - s**-2) * (0.3e6 + 0.1e6 / s)
    law = MooneyRivlin(c10=0.3e6, c01=0.1e6, nu=0.5, viscous=[{"ratio": r, "time": tau}])
    curve = TestCurve("relaxation", np.full_like(T, s), np.ones_like(T), T)
    stress = HomogeneousTests(law, []).predict(curve, NONE)[0]
    assert stress == pytest.approx(slow * (1 + r * np.exp(-T / tau)), rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("keys", [{"nu": 0.4}, {"nu": 0.3, "viscous_on": "whole"}])
def test_relaxation_of_compressible_bars(keys):
    """As step by step at a material point: sides move while the shape relaxes."""
    law = NeoHookean(mu=1e6, viscous=TERMS, **keys)
    steps = time_curves(law, 1.1)
    t, x = steps.t[1:], np.full(len(steps.t) - 1, steps.held)
    curve = TestCurve("relaxation", x, np.ones_like(x), t)
    stress = HomogeneousTests(law, []).predict(curve, NONE)[0]
    assert stress == pytest.approx(steps.relaxation[1:], rel=1e-8)


def test_slow_tests_have_the_stress_after_a_long_time():
    law = NeoHookean(mu=1e6, nu=0.5, viscous=TERMS, viscous_constants="instantaneous")
    s = np.array([1.2, 1.5])
    stress = HomogeneousTests(law, []).predict(TestCurve("uniaxial", s, s), NONE)[0]
    assert stress == pytest.approx(0.35e6 * (s - s**-2), rel=1e-12)


def test_j2_from_tension():
    """Stress and strain of linear hardening: the slope beyond yield is E H/(E + H)."""
    E, H, limit = 200e9, 2e9, 250e6
    e = np.linspace(2e-4, 0.01, 24)
    stress = np.where(E * e < limit, E * e, limit + E * H / (E + H) * (e - limit / E))
    found = fit(
        J2(E=150e9, nu=0.3, yield_stress=150e6, hardening=1e9), {"uniaxial": (1 + e, stress)}
    )
    assert found["E"].value == pytest.approx(E, rel=1e-6)
    assert found["yield_stress"].value == pytest.approx(limit, rel=1e-6)
    assert found["hardening"].value == pytest.approx(H, rel=1e-5)


def test_metals_that_do_not_yield_in_the_test():
    e = np.linspace(1e-4, 1e-3, 8)
    law = J2(E=150e9, nu=0.3, yield_stress=400e6, hardening=1e9)
    found = fit(law, {"uniaxial": (1 + e, 200e9 * e)}, starts=1)
    assert found["E"].value == pytest.approx(200e9, rel=1e-8)
    assert found["yield_stress"].half == np.inf
    assert any("yield_stress cannot be found" in line for line in found.unknown)


@pytest.mark.long
def test_j2_from_cycles():
    """Isotropic and kinematic hardening are told apart by the way back."""
    true = J2(E=70e9, nu=0.33, yield_stress=100e6, kinematic=3e9, hardening=1e9)
    ends = [0.0, 0.008, -0.008, 0.008]
    e = np.concatenate([np.linspace(a, b, 9)[1:] for a, b in zip(ends, ends[1:], strict=False)])
    curve = TestCurve("cyclic", 1 + e, np.ones_like(e))
    stress = SteppedBars(true, []).predict(curve, NONE)[0]
    start = J2(E=60e9, nu=0.33, yield_stress=70e6, kinematic=1e9, hardening=2e9)
    found = fit(start, {"cyclic": (1 + e, stress)}, starts=2)
    for name in ("E", "yield_stress", "kinematic", "hardening"):
        assert found[name].value == pytest.approx(getattr(true, name), rel=1e-5)
