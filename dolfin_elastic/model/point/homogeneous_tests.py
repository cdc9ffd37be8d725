"""Homogeneous tests of a material: uniaxial, equibiaxial, planar, shear, volumetric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

_ITERATIONS = 25
_HALVINGS = 6
_LARGEST_CHANGE = 0.5
_LEAST_VOLUME = 0.2
"""Least det F over that of the step before: P = F S also vanishes at F = 0, a spurious root."""
_SMALL = 1e-3
_EXACT, _GOOD = 1e-14, 1e-9
"""Stress over stiffness: good enough at once, and where it gets no better."""
_FREE_LATERAL = ((1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_FREE_THICKNESS = ((2, 2), (0, 2), (1, 2))
Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class DeformationMode:
    """A kind of homogeneous deformation.

    F is upper triangular, which excludes rotations and nothing else.

    Attributes:
        name: Its name.
        symbol: Name of the prescribed quantity.
        place: F for a prescribed value.
        rest: The value at F = I.
        free: Components of F that are unknowns: the same components of P vanish.
        shown: Component of the stress that is plotted.
    """

    name: str
    symbol: str
    place: Callable[[float], AnyArray]
    rest: float
    free: Pairs = ()
    shown: tuple[int, int] = (0, 0)

    def targets(self, largest: float, count: int) -> AnyArray:
        """Stretches from 1/`largest` to it, shears to `largest` - 1; `count` to each side."""
        spread = np.linspace(-1.0, 1.0, 2 * count + 1)
        return np.asarray(largest**spread if self.rest else spread * (largest - 1))


def _shear(g: float) -> AnyArray:
    return np.array([[1.0, g, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


DEFORMATION_MODES = (
    DeformationMode("uniaxial", "stretch", lambda s: np.diag([s, 1.0, 1.0]), 1.0, _FREE_LATERAL),
    DeformationMode("equibiaxial", "stretch", lambda s: np.diag([s, s, 1.0]), 1.0, _FREE_THICKNESS),
    DeformationMode("planar", "stretch", lambda s: np.diag([s, 1.0, 1.0]), 1.0, _FREE_THICKNESS),
    DeformationMode("simple-shear", "shear", _shear, 0.0, shown=(0, 1)),
    DeformationMode("volumetric", "J", lambda J: np.cbrt(J) * np.eye(3), 1.0),
)
"""Planar tension of a wide sheet is called pure shear in the rubber industry."""


@dataclass(frozen=True)
class ResponseCurve:
    """States along one mode, in ascending order of the prescribed quantity.

    Attributes:
        mode: Kind of deformation.
        values: Prescribed quantity, shape (n,).
        F: Deformation gradients, (n, 3, 3).
        P: First Piola-Kirchhoff stresses [Pa].
        energy: Strain energy [J/m^3]; nan if the law has none.
        ends: Where a branch ended before its last target, with the reason.
    """

    mode: DeformationMode
    values: AnyArray
    F: AnyArray
    P: AnyArray
    energy: AnyArray
    ends: tuple[str, ...]

    @property
    def rest(self) -> int:
        """Index of the state at F = I."""
        return int(np.argmin(np.abs(self.values - self.mode.rest)))

    def interval(self, good: AnyArray) -> tuple[int, int]:
        """First and last index of the run of true entries about the rest."""
        bad = np.flatnonzero(~good)
        low = int(bad[bad < self.rest].max(initial=-1)) + 1
        high = int(bad[bad > self.rest].min(initial=len(good))) - 1
        return low, high

    @property
    def cauchy(self) -> AnyArray:
        """Cauchy stresses [Pa]."""
        return np.asarray(self.P @ self.F.transpose(0, 2, 1)) / self.J[:, None, None]

    @property
    def J(self) -> AnyArray:
        """det F, shape (n,)."""
        return np.asarray(np.linalg.det(self.F))


def response_curve(point: LawAtPoints, mode: DeformationMode, targets: AnyArray) -> ResponseCurve:
    """Follows a deformation mode from rest to both ends of `targets`.

    Args:
        targets: Ascending values of the prescribed quantity, shape (n,); rest is among them.
    """
    up = _branch(point, mode, targets[targets > mode.rest])
    down = _branch(point, mode, targets[targets < mode.rest][::-1])
    rest = (mode.rest, mode.place(mode.rest))
    result = [*reversed(down.states), rest, *up.states]
    F = np.array([state for _, state in result])
    energy = point.energy(F) if point.law.has_energy else np.full(len(F), np.nan)
    ends = tuple(branch.end for branch in (down, up) if branch.end)
    values = np.array([value for value, _ in result])
    return ResponseCurve(mode, values, F, point.stress(F), energy, ends)


@dataclass
class _Branch:
    states: list[tuple[float, AnyArray]]
    end: str = ""


def _branch(point: LawAtPoints, mode: DeformationMode, targets: AnyArray) -> _Branch:
    """States from rest outwards; a step that fails is tried again with half its size."""
    if not mode.free:
        return _prescribed(point, mode, targets)
    branch = _Branch([])
    value, F = mode.rest, mode.place(mode.rest)
    for target in targets:
        share, done = 1.0, 0.0
        start = value
        while done < 1.0:
            trial = start + min(done + share, 1.0) * (target - start)
            equilibrium = _equilibrium(point, mode, value, F, trial)
            if equilibrium is not None:
                done, value, F = done + share, trial, equilibrium
            elif (share := share / 2) < 0.5**_HALVINGS:
                where = f"{mode.name} ends at {mode.symbol} {value:.4g}"
                branch.end = f"{where}: no state with free sides follows"
                return branch
        value = float(target)
        branch.states.append((value, F))
    return branch


def _prescribed(point: LawAtPoints, mode: DeformationMode, targets: AnyArray) -> _Branch:
    if not len(targets):
        return _Branch([])
    F = np.array([mode.place(float(value)) for value in targets])
    fine: AnyArray = np.asarray(np.isfinite(point.stress(F)).all(axis=(1, 2)))
    count = len(fine) if fine.all() else int(np.argmin(fine))
    branch = _Branch([(float(v), f) for v, f in zip(targets[:count], F[:count], strict=True)])
    if count < len(fine):
        last = targets[count - 1] if count else mode.rest
        branch.end = f"{mode.name} ends at {mode.symbol} {last:.4g}: the stress is not finite"
    return branch


def _equilibrium(
    point: LawAtPoints, mode: DeformationMode, value: float, F: AnyArray, trial: float
) -> AnyArray | None:
    """The state at `trial` near F, by Newton's method with the tangent; None if there is none."""
    rows, columns = np.array(mode.free).T
    A, G = point.tangent(F[None])[0], mode.place(trial)
    before, scale = F[rows, columns], float(np.abs(A).max())
    G[rows, columns] = before + _predictor(A, mode, trial - value)
    last = np.inf
    for _ in range(_ITERATIONS):
        residual = point.stress(G[None])[0][rows, columns]
        size = float(np.abs(residual).max())
        if size <= _EXACT * scale or (size <= _GOOD * scale and size > last / 4):
            return G  # converged, or stagnated at the level of round-off
        last = size
        change = _solve_free(point.tangent(G[None])[0], mode, residual)
        G[rows, columns] -= change
        far = np.abs(G[rows, columns] - before).max() > _LARGEST_CHANGE
        crushed = np.linalg.det(G) < _LEAST_VOLUME * np.linalg.det(F)
        if far or crushed or not np.isfinite(change).all():
            return None
    return None


def _predictor(A: AnyArray, mode: DeformationMode, step: float) -> AnyArray:
    """Change of the free components along the tangent of the path."""
    rows, columns = np.array(mode.free).T
    ahead = (mode.place(mode.rest + _SMALL) - mode.place(mode.rest)) / _SMALL
    driven = np.einsum("ijkl,kl->ij", A, ahead)[rows, columns]
    change = -step * _solve_free(A, mode, driven)
    return np.where(np.isfinite(change), change, 0.0)


def _solve_free(A: AnyArray, mode: DeformationMode, right: AnyArray) -> AnyArray:
    """Solves with the part of the tangent that belongs to the free components; else nan."""
    rows, columns = np.array(mode.free).T
    matrix = A[rows[:, None], columns[:, None], rows, columns]
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(len(rows), np.nan)
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return np.full(len(rows), np.nan)
