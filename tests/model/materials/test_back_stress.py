"""Kinematic hardening at large strains, at a point.

In uniaxial stress principal axes stay, and Mandel's stress has the values of the Kirchhoff stress:
the closed form is that of small strains between Kirchhoff stress and logarithmic strain, see
test_cyclic_curve.py.  Here are the paths in which axes turn.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from helpers import laws as gate

from dolfin_elastic import J2, J2Logarithmic
from dolfin_elastic.model.kinematics import gradient_symbol, variables
from dolfin_elastic.model.materials.plasticity import PLASTIC_STRAIN, Plastic
from dolfin_elastic.model.point.steps import PointOverSteps

pytestmark = pytest.mark.usefixtures("serial_only")

E, NU, YIELD = 200e9, 0.3, 250e6
KEYS = {"E": E, "nu": NU, "yield_stress": YIELD, "hardening": 1e9, "kinematic": 5e9}
I = np.eye(3)


class Point:
    """Stress, tangent and stored and lost energy of a law over steps."""

    def __init__(self, law: Plastic) -> None:
        symbol = gradient_symbol()
        self.steps = PointOverSteps(law, symbol, [symbol])
        H, F = variables(symbol)
        stepped = self.steps.law
        P = stepped.stress(F)
        self.stress = self.steps.quantity(P)
        self.tangent = self.steps.quantity(ufl.diff(P, H))
        self.energy = self.steps.quantity(stepped.energy(F) + stepped.lost(F))

    def along(self, path: list[np.ndarray]) -> list[np.ndarray]:
        """Stresses at the ends of steps."""
        stresses = []
        for F in path:
            stresses.append(self.stress(F[None], dt=1.0)[0])
            self.steps.commit(F[None], dt=1.0)
        return stresses


def twisted(amount: float, steps: int) -> list[np.ndarray]:
    """Stretched along x, then sheared at that stretch: principal axes turn."""
    path = []
    for t in np.linspace(0, 2, 2 * steps + 1)[1:]:
        F = np.diag([1 + amount * min(t, 1.0), 1 - 0.5 * amount * min(t, 1.0), 1.0])
        F[0, 1] = amount * max(t - 1, 0.0)
        F[2, 2] = 1 / np.linalg.det(F[:2, :2])
        path.append(F)
    return path


def test_a_rotated_body_has_the_rotated_stress() -> None:
    """Other rotations in each step: P turns with the body, and what is remembered stays."""
    path = twisted(0.1, 5)
    turns = [gate.rotation(seed) for seed in range(len(path))]
    one, other = Point(J2Logarithmic(**KEYS)), Point(J2Logarithmic(**KEYS))
    plain = one.along(path)
    turned = other.along([Q @ F for Q, F in zip(turns, path, strict=True)])
    for P, rotated, Q in zip(plain, turned, turns, strict=True):
        assert rotated == pytest.approx(Q @ P, abs=1e-9 * YIELD)
    assert one.steps.values[PLASTIC_STRAIN.name][0, 0] > 0.1
    for name, values in one.steps.values.items():
        assert other.steps.values[name] == pytest.approx(values, abs=1e-12)
    for P, F in zip(plain, path, strict=True):
        tau = P @ F.T
        assert tau == pytest.approx(tau.T, abs=1e-9 * YIELD)


def test_the_stress_is_the_derivative_of_energy_and_heat() -> None:
    """From a state with a back stress in other axes: W of the step, its gradient, its Hessian."""
    path = twisted(0.05, 4)
    point = Point(J2Logarithmic(**KEYS))
    point.along(path)
    F = path[-1] + 0.004 * np.random.default_rng(1).uniform(-1, 1, (3, 3))
    P, A = point.stress(F[None], dt=1.0)[0], point.tangent(F[None], dt=1.0)[0]
    slopes = gate.differences(lambda G: point.energy(G[None], dt=1.0)[0], F, 1e-5)
    bends = gate.differences(lambda G: point.stress(G[None], dt=1.0)[0], F, 1e-5)
    assert slopes == pytest.approx(P, abs=1e-7 * np.abs(P).max())
    assert bends == pytest.approx(A, abs=1e-6 * np.abs(A).max())
    assert pytest.approx(A.transpose(2, 3, 0, 1), abs=1e-11 * np.abs(A).max()) == A


def test_without_a_back_stress_nothing_changes() -> None:
    """One of 1e-9 of the yield stress: the other formula of the same stress, where axes turn."""
    plain = {**KEYS, "kinematic": None}
    path = twisted(0.1, 5)
    wanted = Point(J2Logarithmic(**plain)).along(path)
    found = Point(J2Logarithmic(**{**plain, "kinematic": 1.0})).along(path)
    for P, Q in zip(found, wanted, strict=True):
        assert pytest.approx(Q, abs=1e-8 * YIELD) == P


def test_small_strains_are_those_of_j2() -> None:
    """At strains of 1e-5 both differ by strains of that size."""
    keys = {**KEYS, "yield_stress": 1e6}
    path = twisted(1e-5, 5)
    one, other = (Point(kind(**keys)).along(path) for kind in (J2Logarithmic, J2))
    for P, Q in zip(one, other, strict=True):
        assert pytest.approx(Q, abs=1e-4 * 1e6) == P
