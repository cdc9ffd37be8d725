"""Range of validity of a law: growth of its energy, strong ellipticity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.point.homogeneous_tests import ResponseCurve
from dolfin_elastic.model.point.tested import Finding, LawUnderTest
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

_CRUSHED = 10.0 ** -np.array([2.0, 4.0, 8.0, 16.0, 32.0])
_BLOWN = 10.0 ** np.array([1.0, 2.0, 3.0, 4.0])
_DIRECTIONS = 300
_CHUNK = 200
PATHS = ("uniaxial", "equibiaxial", "simple-shear")


def energy_growth(tested: LawUnderTest) -> Iterator[Finding]:
    """The energy as J goes to 0 and to infinity."""
    if not tested.law.has_energy:
        return
    for name, J in (("energy as J -> 0", _CRUSHED), ("energy as J -> inf", _BLOWN)):
        psi = tested.point.energy(np.cbrt(J)[:, None, None] * np.eye(3))
        yield Finding(name, "note", _trend(psi, J, tested.scale), {"psi": list(map(float, psi))})


def _trend(psi: AnyArray, J: AnyArray, scale: float) -> str:
    if np.isnan(psi).any():
        return f"not defined at J = {J[np.argmax(np.isnan(psi))]:g}"
    if np.isposinf(psi).any() or psi[-1] > 1e3 * abs(psi[-2]):
        return "grows without bound"
    rise = np.diff(psi)
    if rise[-1] > 1e-3 * scale and rise[-1] >= 0.9 * rise[-2] > 0:
        return "grows without bound"
    side = "does not resist inversion" if J[-1] < 1 else "does not resist a change of volume"
    return f"stays at {psi[-1]:.4g} J/m^3: {side}"


def directions(count: int = _DIRECTIONS) -> AnyArray:
    """Unit vectors spread over half a sphere (a Fibonacci lattice), the axes and diagonals too."""
    k = np.arange(count) + 0.5
    z, turn = 1 - k / count, np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    spread = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    grid = np.array([[a, b, c] for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (0, 1)], float)
    grid = grid[np.abs(grid).sum(axis=1) > 0]
    return np.concatenate([spread, grid / np.linalg.norm(grid, axis=1, keepdims=True)])


def acoustic_eigenvalues(point: LawAtPoints, F: AnyArray, *, flat: bool = False) -> AnyArray:
    """Smallest eigenvalue of the acoustic tensor over all directions, of shape (n,) [Pa].

    Q_ik = A_ijkl N_j N_l in the reference configuration; strong ellipticity is Q > 0 for all N.

    Source: J. Marsden and T. Hughes, Mathematical Foundations of Elasticity, 1983, section 4.3.

    Args:
        F: Deformation gradients, shape (n, 3, 3).
        flat: Directions and amplitudes in the plane of x and y only.
    """
    N, least, dim = directions(), [], 3
    if flat:
        turn = np.linspace(0.0, np.pi, 180, endpoint=False)
        N, dim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), 2
    for start in range(0, len(F), _CHUNK):
        A = point.tangent(F[start : start + _CHUNK])
        Q = np.einsum("nijkl,mj,ml->nmik", A, N, N, optimize=True)
        Q = ((Q + Q.swapaxes(-1, -2)) / 2)[..., :dim, :dim]
        bad = ~np.isfinite(Q).all(axis=(1, 2, 3))
        Q[bad] = -np.eye(dim)
        least.append(np.linalg.eigvalsh(Q)[..., 0].min(axis=1))
    return np.concatenate(least) if least else np.zeros(0)


def ellipticity(tested: LawUnderTest, curves: dict[str, ResponseCurve]) -> Iterator[Finding]:
    """Interval about the rest in which the law is strongly elliptic, one finding a path.

    Args:
        curves: Name of a deformation mode to its response, for all of `PATHS`.
    """
    for name in PATHS:
        curve = curves[name]
        least = acoustic_eigenvalues(tested.point, curve.F)
        if not least[curve.rest] > 0:
            text = f"lost at rest: smallest eigenvalue {least[curve.rest]:.3g} Pa"
            yield Finding(f"elliptic, {name}", "fail", text, {})
            continue
        low, high = curve.interval(least > 0)
        a, b = float(curve.values[low]), float(curve.values[high])
        whole = (low, high) == (0, len(least) - 1)
        text = f"{curve.mode.symbol} {a:.3g} to {b:.3g}" + (
            "" if whole else "; beyond, the law is not stable"
        )
        values = {"from": a, "to": b, "whole": whole}
        yield Finding(f"elliptic, {name}", "pass" if whole else "note", text, values)
