"""The stress of a time step: its work is the change of the energy, for every law that has one."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from helpers.laws import make, rotation
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfin_elastic import FixedCorotated, NeoHookean
from dolfin_elastic.model.discrete_gradient import StepLaw, triangular
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.mixed import Mixed
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.materials.user import FormulaEnergy
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints, NumpyProgram, gradient_symbol
from dolfin_elastic.problem.weak_form import derives_from_strain

WRITTEN = FormulaEnergy(
    energy="mu/2*(I1 - 3) - mu*ln(J) + c*(exp(b*(I4 - 1)^2) - 1)",
    parameters={"mu": 4e5, "c": 1e5, "b": 2.0},
    fibre=[1, 2, 0],
)


def laws() -> dict[str, Law]:
    found = {name: make(name) for name in MATERIALS}
    return {name: law for name, law in found.items() if derives_from_strain(law)} | {
        "of a user": WRITTEN
    }


LAWS = laws()


def at(expression: Expr, symbol: Expr, F: np.ndarray) -> np.ndarray:
    """Values of an expression at deformation gradients of shape (..., 3, 3)."""
    found = NumpyProgram(expand_derivatives(expression), symbol)(F.reshape(-1, 3, 3))
    return np.asarray(found if F.ndim == 3 else found[0])


def stress(law: object, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """First Piola-Kirchhoff stress of a step [Pa]."""
    F = gradient_symbol()
    step = StepLaw(law, ufl.as_matrix(start.tolist()), ufl.as_ufl(1.0))  # type: ignore[arg-type]
    return np.asarray(at(step.stress(F), F, (start + end) / 2))


def ends(strain: float, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Two deformations, of which the second has turned by an angle about an axis askew."""
    draw = np.random.default_rng(5).uniform(-1, 1, (2, 3, 3))
    n = np.array([1.0, 2.0, 2.0]) / 3
    N = np.cross(np.eye(3), n)
    Q = np.eye(3) + np.sin(turn) * N.T + (1 - np.cos(turn)) * (N @ N)
    return np.eye(3) + strain * draw[0], Q @ (np.eye(3) + strain * draw[1])


@pytest.mark.parametrize("strain", [0.1, 1e-2, 1e-4])
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.sample(6)
def test_work_is_the_change_of_energy(name: str, strain: float) -> None:
    """P : (F1 - F0) = psi(F1) - psi(F0) to the round-off of psi, 1e-16 of the modulus.

    The body turns by 0.3 rad meanwhile: forces of the mean displacement would be off by
    the strain 0.3^2/8.  Where the correction is left out, below |dC| = 1e-3, the error is that of
    Gauss's rule with two points, |dC|^5/4320.
    """
    law = LAWS[name]
    F0, F1 = ends(strain, 0.3)
    P = stress(law, F0, F1)
    before, after = LawAtPoints(law).energy(np.array([F0, F1]))
    scale = np.abs(LawAtPoints(law).tangent(np.eye(3)[None])).max()
    assert after - before == pytest.approx(np.sum(P * (F1 - F0)), abs=1e-14 * scale)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.sample(4)
def test_no_moment_and_no_dependence_on_rotations(name: str) -> None:
    """P Fm^T is symmetric; a step that is turned has its stress turned."""
    law = LAWS[name]
    F0, F1 = ends(0.1, 0.5)
    P, Q = stress(law, F0, F1), rotation(3)
    size = np.abs(P).max()
    kirchhoff = P @ ((F0 + F1) / 2).T
    np.testing.assert_allclose(kirchhoff, kirchhoff.T, atol=1e-11 * size)
    np.testing.assert_allclose(stress(law, Q @ F0, Q @ F1), Q @ P, atol=1e-11 * size)


@pytest.mark.parametrize("name", LAWS)
def test_a_step_without_change_has_the_stress_of_the_law(name: str) -> None:
    F, _ = ends(0.1, 0.0)
    expected = LawAtPoints(LAWS[name]).stress(F[None])[0]
    size = np.abs(expected).max()
    np.testing.assert_allclose(stress(LAWS[name], F, F), expected, atol=1e-11 * size)


@pytest.mark.parametrize("exact", [True, False])
def test_pressure_works_on_the_volume_strain(exact: bool) -> None:
    """With p the work is the change of the shape's energy and p times that of g."""
    law, p = NeoHookean(E=1e6, nu=0.3), 3e5
    F0, F1 = ends(0.1, 0.3)
    P = stress(Mixed(law, ufl.as_ufl(p), ufl.as_ufl(0.0), exact), F0, F1)
    F = gradient_symbol()
    shape = at(law.shape_energy(F), F, np.array([F0, F1]))
    J = np.linalg.det(np.array([F0, F1]))
    g = J - 1 if exact else np.log(J)
    assert np.sum(P * (F1 - F0)) == pytest.approx(np.diff(shape)[0] + p * np.diff(g)[0], rel=1e-12)


def test_cells_that_stay_inverted_keep_their_energy_balance() -> None:
    """A law that tells a mirrored cell from an upright one is taken at the mirrored one."""
    law, mirror = FixedCorotated(E=1e6, nu=0.3), np.diag([1.0, 1.0, -0.4])
    F0, F1 = (F @ mirror for F in ends(0.05, 0.2))
    P = stress(law, F0, F1)
    before, after = LawAtPoints(law).energy(np.array([F0, F1]))
    assert after - before == pytest.approx(np.sum(P * (F1 - F0)), abs=1e-13 * 1e6)
    again = LawAtPoints(law).stress(F0[None])[0]
    np.testing.assert_allclose(stress(law, F0, F0), again, atol=1e-10 * np.abs(again).max())


def test_triangular() -> None:
    """F^T F = C and F^-1 F = I."""
    draw = np.eye(3) + 0.3 * np.random.default_rng(1).uniform(-1, 1, (3, 3))
    symbol = gradient_symbol()
    for sign in (1.0, -1.0):
        T, inverse = (
            at(part, symbol, draw.T @ draw) for part in triangular(symbol, ufl.as_ufl(sign))
        )
        np.testing.assert_allclose(T.T @ T, draw.T @ draw, atol=1e-14)
        np.testing.assert_allclose(inverse @ T, np.eye(3), atol=1e-14)
        assert np.sign(np.linalg.det(T)) == sign
