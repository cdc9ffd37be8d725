"""Tapered cantilevers: deflection and buckling load in closed form, and the lowest frequency.

A pyramid's frustum of square section, side d(s) = tip (1 + c s) with s = x/L from the tip, of small
slenderness d/L = 1/40 at the foot: shear adds less than 5e-4.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

from dolfin_elastic import (
    Buckling,
    LinearElastic,
    Modal,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.model.loads.base import Load

E, DENSITY, LENGTH, TIP, FOOT = 1e7, 1000.0, 40.0, 0.5, 1.0
C = FOOT / TIP - 1
STIFF = E * TIP**4 / 12
"""Bending stiffness at the tip [N m^2]; that at s is (1 + c s)^4 times as large."""
WITHIN = 5e-4
"""Shear, the taper of the sections and the elements account for 3e-4 at most."""
CONSTANTS = {"E": E, "nu": 0.0, "density": DENSITY}
"""Without lateral contraction beam theory holds at the clamped foot, too."""


def problem(law: type[LinearElastic | StVenantKirchhoff], loads: list[Load]) -> Problem:
    """The frustum with its tip at x = 0, clamped at x = L."""
    body = box_body(size=[LENGTH, 1, 1], cells=[24, 2, 2])
    x = body.mesh.geometry.x
    x[:, 1:] = (x[:, 1:] - 0.5) * (TIP + (FOOT - TIP) * x[:, :1] / LENGTH)
    return Problem(body, law(**CONSTANTS), supports=[Support(on="right")], loads=loads, degree=2)


def ritz(tip: float) -> float:
    """omega L^2 sqrt(rho A/(E I)), A and I at the foot, of a beam of Euler and Bernoulli.

    Its side is tip + (1 - tip) s times that at the foot; w = (1 - s)^2, (1 - s)^3 ... (1 - s)^11.
    """
    s, weights = np.polynomial.legendre.leggauss(40)
    s, weights = (s + 1) / 2, weights / 2
    powers = np.arange(2, 12)[:, None]
    side = tip + (1 - tip) * s
    w, bent = (1 - s) ** powers, powers * (powers - 1) * (1 - s) ** (powers - 2)
    stiffness, mass = (bent * weights * side**4) @ bent.T, (w * weights * side**2) @ w.T
    return float(np.sqrt(eigh(stiffness, mass, eigvals_only=True)[0]))


def test_deflection() -> None:
    """u = F L^3/(3 E I_tip (1 + c)^3): the integral of F x^2/(E I) over the length.

    With s^2/(1 + c s)^4 the derivative of s^3/(3 (1 + c s)^3); as in J. Gere and S. Timoshenko,
    Mechanics of Materials, on tapered beams.
    """
    force = 1.0
    exact = force * LENGTH**3 / (3 * STIFF * (1 + C) ** 3)
    load = Traction(on="left", value=[0, 0, force / TIP**2])
    *_, state = Statics(problem(LinearElastic, [load])).steps()
    assert state.max_displacement == pytest.approx(exact, rel=WITHIN)


def test_frequency() -> None:
    """That of a beam by the method of Ritz, which gives the published value for a pointed one.

    This is 8.719, by G. Kirchhoff (1879); H. D. Conway, E. Becker and J. Dubil, J. Applied
    Mechanics 31 (1964) 329, on truncated cones, whose sections grow in the same way.
    """
    assert ritz(0) == pytest.approx(8.719, abs=5e-4)
    exact = ritz(TIP / FOOT) * np.sqrt(E * FOOT**2 / 12 / DENSITY) / LENGTH**2 / (2 * np.pi)
    found = next(iter(Modal(problem(LinearElastic, []), count=1).modes()))
    assert found.frequency == pytest.approx(exact, rel=WITHIN)


def test_buckling() -> None:
    """The column whose I grows with the fourth power, after A. N. Dinnik.

    (1 + c s) sin(k s/(1 + c s)) solves w'' + k^2 w/(1 + c s)^4 = 0 with w = 0 at the tip; that its
    slope is 0 at the foot gives tan q = -q/c with q = k/(1 + c) and P = k^2 E I_tip/L^2.  S. P.
    Timoshenko and J. M. Gere, Theory of Elastic Stability (1961), section 2.12.
    """
    q = brentq(lambda q: np.sin(q) + q / C * np.cos(q), np.pi / 2, np.pi)
    exact = (q * (1 + C)) ** 2 * STIFF / LENGTH**2
    load = Traction(on="left", value=[1.0 / TIP**2, 0, 0])
    found = next(iter(Buckling(problem(StVenantKirchhoff, [load]), count=1).modes()))
    assert found.load_factor == pytest.approx(exact, rel=WITHIN)
