"""Strain measures and stress conversions against numpy, at deformations drawn at random.

UFL evaluates the expressions itself: nothing is compiled, so every function is tried many times.
"""

from __future__ import annotations

from typing import Any

import basix.ufl
import numpy as np
import pytest
import ufl
from ufl.algorithms import expand_derivatives
from ufl.utils.stacks import StackDict

from dolfin_elastic.model import kinematics as k

# Round-off: a few hundred operations on numbers of order one, in any order.
TIGHT = {"rtol": 1e-12, "atol": 1e-13}
SEEDS = range(4)


def value(expression: Any) -> np.ndarray:
    """The numbers of a UFL expression that holds no mesh functions."""
    lowered = expand_derivatives(expression)
    out = np.empty(lowered.ufl_shape)
    for index in np.ndindex(*lowered.ufl_shape):
        out[index] = lowered.evaluate(None, {}, index, StackDict())
    return out


def symbol(A: np.ndarray) -> Any:
    return ufl.as_tensor(A.tolist())


def random_F(seed: int, dim: int = 3) -> np.ndarray:
    """A deformation gradient far from the identity and far from singular."""
    rng = np.random.default_rng(seed)
    U = np.diag(rng.uniform(0.5, 2.0, dim))
    Q, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
    R, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
    F = Q @ U @ R
    return F if np.linalg.det(F) > 0 else F * np.where(np.arange(dim) == 0, -1.0, 1.0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_strain_measures_are_those_of_linear_algebra(seed, dim):
    F, I = random_F(seed, dim), np.eye(dim)
    expected = {
        k.jacobian: np.linalg.det(F),
        k.right_cauchy_green: F.T @ F,
        k.left_cauchy_green: F @ F.T,
        k.green_strain: (F.T @ F - I) / 2,
        k.almansi_strain: (I - np.linalg.inv(F @ F.T)) / 2,
        k.infinitesimal_strain: (F + F.T) / 2 - I,
        k.cofactor: np.linalg.det(F) * np.linalg.inv(F).T,
    }
    for function, wanted in expected.items():
        np.testing.assert_allclose(
            value(function(symbol(F))), wanted, **TIGHT, err_msg=function.__name__
        )


def test_strains_measure_lengths():
    """dx.dx - dX.dX = 2 dX.E.dX = 2 dx.e.dx, the meaning of both finite strains."""
    F, dX = random_F(7), np.array([0.3, -0.2, 0.9])
    dx = F @ dX
    change = dx @ dx - dX @ dX
    assert 2 * dX @ value(k.green_strain(symbol(F))) @ dX == pytest.approx(change, rel=1e-12)
    assert 2 * dx @ value(k.almansi_strain(symbol(F))) @ dx == pytest.approx(change, rel=1e-12)


@pytest.mark.parametrize(("dim", "cell"), [(2, "triangle"), (3, "tetrahedron")])
def test_deformation_gradient_of_an_affine_map(dim, cell):
    mesh = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(dim,)))
    H = random_F(3, dim) - np.eye(dim)
    u = ufl.dot(symbol(H), ufl.SpatialCoordinate(mesh))
    np.testing.assert_allclose(value(k.deformation_gradient(u)), np.eye(dim) + H, **TIGHT)


@pytest.mark.parametrize("seed", SEEDS)
def test_cofactor_turns_area_vectors(seed):
    """Nanson's formula, with the area vector of the parallelogram of two edges."""
    F, rng = random_F(seed), np.random.default_rng(seed)
    a, b = rng.standard_normal((2, 3))
    turned = value(k.cofactor(symbol(F))) @ np.cross(a, b)
    np.testing.assert_allclose(turned, np.cross(F @ a, F @ b), **TIGHT)


@pytest.mark.parametrize("seed", SEEDS)
def test_invariants_are_those_of_the_eigenvalues(seed):
    F = random_F(seed)
    C = F.T @ F
    a, b, c = np.linalg.eigvalsh(C)
    found = [float(value(x)) for x in k.invariants(symbol(C))]
    np.testing.assert_allclose(found, [a + b + c, a * b + b * c + c * a, a * b * c], **TIGHT)


@pytest.mark.parametrize("seed", SEEDS)
def test_isochoric_invariants_do_not_see_a_change_of_volume(seed):
    C = random_F(seed).T @ random_F(seed)
    first = [float(value(x)) for x in k.isochoric_invariants(symbol(C))]
    swollen = [float(value(x)) for x in k.isochoric_invariants(symbol(2.7 * C))]
    np.testing.assert_allclose(swollen, first, **TIGHT)
    unimodular = C / np.linalg.det(C) ** (1 / 3)
    wanted = np.trace(unimodular), np.trace(np.linalg.inv(unimodular))  # I2 = tr C^-1 if det C = 1
    np.testing.assert_allclose(first, wanted, **TIGHT)


def test_padding_makes_plane_strain():
    F = random_F(1, 2)
    expected = np.eye(3)
    expected[:2, :2] = F
    np.testing.assert_array_equal(value(k.embedded(symbol(F))), expected)
    expected[2, 2] = 0.0
    np.testing.assert_array_equal(value(k.padded(symbol(F))), expected)
    whole = symbol(random_F(1, 3))
    assert k.embedded(whole) is whole
    assert k.padded(whole) is whole


# --- stress measures ---

MEASURES = ("first", "second", "kirchhoff", "cauchy")


def stresses(S: np.ndarray, F: np.ndarray) -> dict[str, np.ndarray]:
    """All four from the second Piola-Kirchhoff stress, by their definitions."""
    J, tau = np.linalg.det(F), F @ S @ F.T
    return {"second": S, "first": F @ S, "kirchhoff": tau, "cauchy": tau / J}


PAIRS = [(a, b) for a in MEASURES for b in MEASURES if a != b]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("to", "source"), PAIRS)
def test_every_conversion_of_stress(to, source, dim):
    convert = getattr(k, f"{to}_from_{source}")
    for seed in SEEDS:
        F = random_F(seed, dim)
        A = np.random.default_rng(seed + 100).standard_normal((dim, dim))
        wanted = stresses(A + A.T, F)
        found = value(convert(symbol(wanted[source]), symbol(F)))
        np.testing.assert_allclose(found, wanted[to], **TIGHT)


def test_all_conversions_are_there():
    there = {name for name in dir(k) if "_from_" in name}
    assert there == {f"{a}_from_{b}" for a, b in PAIRS}


@pytest.mark.parametrize("seed", SEEDS)
def test_round_trips_come_back(seed):
    F, P = random_F(seed), np.random.default_rng(seed).standard_normal((3, 3))
    f = symbol(F)
    ring = symbol(P)
    for to, source in (
        ("second", "first"),
        ("kirchhoff", "second"),
        ("cauchy", "kirchhoff"),
        ("first", "cauchy"),
        ("kirchhoff", "first"),
        ("second", "kirchhoff"),
        ("cauchy", "second"),
        ("kirchhoff", "cauchy"),
        ("first", "kirchhoff"),
        ("cauchy", "first"),
        ("second", "cauchy"),
        ("first", "second"),
    ):
        ring = symbol(value(getattr(k, f"{to}_from_{source}")(ring, f)))
    # Twelve conversions, each with the condition of F (at most 4): 1e-11 is round-off.
    np.testing.assert_allclose(value(ring), P, rtol=1e-11, atol=1e-11)


def test_power_does_not_depend_on_the_measure():
    """J sigma : d = P : dF/dt = S : dE/dt for any rate (Bonet & Wood 2008, section 5.5)."""
    F, rate = random_F(5), np.random.default_rng(5).standard_normal((3, 3))
    S = np.diag([1.0, -2.0, 0.5]) + 0.3
    P, sigma = F @ S, F @ S @ F.T / np.linalg.det(F)
    d = rate @ np.linalg.inv(F)
    E_rate = (F.T @ rate + rate.T @ F) / 2
    power = np.sum(value(k.first_from_second(symbol(S), symbol(F))) * rate)
    assert power == pytest.approx(np.sum(S * E_rate), rel=1e-12)
    tau = value(k.kirchhoff_from_cauchy(symbol(sigma), symbol(F)))
    assert np.sum(tau * d) == pytest.approx(np.sum(P * rate), rel=1e-12)


def test_von_mises():
    tension = np.diag([3.0, 0.0, 0.0])
    shear = np.array([[0, 2.0, 0], [2.0, 0, 0], [0, 0, 0]])
    assert float(value(k.von_mises(symbol(tension)))) == pytest.approx(3.0, rel=1e-14)
    assert float(value(k.von_mises(symbol(shear)))) == pytest.approx(2 * np.sqrt(3), rel=1e-14)
    pressed = float(value(k.von_mises(symbol(tension - 7.0 * np.eye(3)))))
    assert pressed == pytest.approx(3.0, rel=1e-13)
    Q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    turned = float(value(k.von_mises(symbol(Q @ (tension + shear) @ Q.T))))
    assert turned == pytest.approx(float(value(k.von_mises(symbol(tension + shear)))), rel=1e-13)
