"""Stability over the range of the tests: where a fitted law has it, and how a fit gets it.

Stable means strongly elliptic, and a nominal stress that rises; `model.point.stable_range` has the
sources.  A fit that is to be stable makes least the sum of squares and

    w sum max(0, c - g)^2,   g = (smallest eigenvalue of the acoustic tensor, slope of the stress)/s

over states of the tests, with the size s of the stresses and a small c.  w grows until g > 0.

Source: J. Nocedal and S. Wright, Numerical Optimization (2006), section 17.1 (exterior penalties).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.ellipticity import acoustic_eigenvalues, directions
from dolfin_elastic.model.point.homogeneous_tests import DeformationMode
from dolfin_elastic.model.point.stable_range import rising
from dolfin_elastic.model.point.tested import with_finite_moduli
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.model import Model, differentiated
from dolfin_elastic.study.least_squares.search import Answer, spread

_GRID = 16
"""Points to each side of the rest at which stability is looked at."""
_MARGIN = 1e-3
"""Of g, to be above zero between the points, too."""
_STAGES = ((1e2, 1e-5), (1e4, 1e-5), (1e6, 1e-8))
"""Weights w of what stability lacks, each with the tolerance of its search."""
_SAME = 1e-3
"""Relative difference of two sums of squares that are the same answer."""
_STARTS, _SPREAD = 2, 24
"""Further starts, and directions of waves beside the axes and diagonals."""


@dataclass(frozen=True)
class _Range:
    """The states of all tests of one mode, from the least to the largest."""

    mode: DeformationMode
    x: FloatArray

    @property
    def rest(self) -> int:
        """Index of the state without strain."""
        return int(np.argmin(np.abs(self.x - self.mode.rest)))

    @property
    def curve(self) -> TestCurve:
        """A slow test of these states."""
        name = "shear" if self.mode.name == "simple-shear" else self.mode.name
        return TestCurve(name, self.x, np.ones(len(self.x)))


def _ranges(model: Model) -> list[_Range]:
    strained = [c for c in model.curves if c.kind != "volumetric"]
    result = []
    for mode in dict.fromkeys(c.mode for c in strained):
        curves = [c for c in strained if c.mode is mode]
        low = min(mode.rest, *(float(c.x.min()) for c in curves))
        high = max(mode.rest, *(float(c.x.max()) for c in curves))
        sides = np.linspace(low, mode.rest, _GRID), np.linspace(mode.rest, high, _GRID)
        result.append(_Range(mode, np.unique(np.concatenate(sides))))
    return result


def stability(law: Law, model: Model, z: FloatArray) -> Iterator[str]:
    """Where the law is strongly elliptic, and its force rises, in the tests.

    The pressure of an incompressible law does not enter its acoustic tensor: a law with a large
    bulk modulus in the same state stands for it.
    """
    tests = model.tests
    if not isinstance(tests, HomogeneousTests) or tests.linear:
        return
    point, lost, ranges = LawAtPoints(with_finite_moduli(law)), False, _ranges(model)
    for one in ranges:
        x, rest = one.x, one.rest
        F, P = tests.slow(one.curve, z[None] * model.scale)
        good = (acoustic_eigenvalues(point, F) > 0) & rising(P[0], rest)
        bad = np.flatnonzero(~good)
        first = int(bad[bad <= rest].max(initial=-1)) + 1
        last = int(bad[bad > rest].min(initial=len(x))) - 1
        if (first, last) != (0, len(x) - 1):
            lost = True
            yield (
                f"not stable over the whole {one.mode.name} test, "
                f"{one.mode.symbol} {x[0]:.4g} to {x[-1]:.4g}: "
                f"only from {x[min(first, rest)]:.4g} to {x[max(last, rest)]:.4g}"
            )
    if ranges and not lost:
        yield STABLE


STABLE = "stable over the range of the tests: elliptic, and the force rises"


class _Penalised:
    """Weighted differences from what was measured, and below them what stability lacks."""

    def __init__(self, model: Model, tests: HomogeneousTests) -> None:
        self._model, self._tests = model, tests
        self._ranges, self._N = _ranges(model), directions(_SPREAD)
        self._size = max(curve.size for curve in model.curves)
        self.weight = 1.0
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def lacks(self, z: FloatArray) -> FloatArray:
        """max(0, c - g) in all states, shape (m, 2 n), for sets of constants of shape (m, k)."""
        parts = []
        for one in self._ranges:
            F, P, A = self._tests.tangents(one.curve, z * self._model.scale)
            least = self._acoustic(F, A).reshape(len(z), -1)
            parts += [least / self._size, np.diff(P, axis=1) / np.diff(one.x) / self._size]
        g = np.nan_to_num(np.hstack(parts), nan=-1.0, posinf=1.0, neginf=-1.0)
        return np.maximum(0.0, _MARGIN - g)

    def _acoustic(self, F: AnyArray, A: AnyArray) -> AnyArray:
        """Smallest eigenvalue over all directions [Pa]; of waves that leave the volume as it is."""
        N, result = self._N, np.full(len(F), np.nan)
        good = np.isfinite(A).all(axis=(1, 2, 3, 4)) & np.isfinite(F).all(axis=(1, 2))
        Q = np.einsum("nijkl,mj,ml->nmik", A[good], N, N, optimize=True)
        Q = (Q + Q.swapaxes(-1, -2)) / 2
        if self._tests.incompressible:  # amplitudes across F^-T N; along it nothing is soft
            n = np.einsum("nji,mj->nmi", np.linalg.inv(F[good]), N)
            n /= np.linalg.norm(n, axis=-1, keepdims=True)
            along = n[..., :, None] * n[..., None, :]
            across = np.eye(3) - along
            Q = across @ Q @ across + 1e6 * self._size * along
        result[good] = np.linalg.eigvalsh(Q)[..., 0].min(axis=1)
        return result

    def residuals(self, z: FloatArray) -> FloatArray:
        """Shape (N + 2 n,)."""
        return self._both(z)[0]

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Derivatives of `residuals`, shape (N + 2 n, k)."""
        return self._both(z)[1]

    def _both(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._last is None or not np.array_equal(self._last[0], z):
            model = self._model
            self._last = z.copy(), *differentiated(self.lacks, z, model.low, model.high)
        root = np.sqrt(self.weight)
        return (
            np.concatenate([self._model.residuals(z), root * self._last[1]]),
            np.vstack([self._model.sensitivities(z), root * self._last[2]]),
        )


@dataclass(frozen=True)
class Stabilised:
    """A search for constants with which the law is stable over the range of the tests.

    Args:
        free: Where the search without this condition has ended.
        stable: Whether the law is stable with constants over their scales.
        evaluations: Largest number of steps from each start, and with each weight.

    Raises:
        CaseError: The stability of the law is not looked at.
    """

    model: Model
    free: Answer
    stable: Callable[[FloatArray], bool]
    evaluations: int

    def __post_init__(self) -> None:
        tests = self.model.tests
        if not isinstance(tests, HomogeneousTests) or tests.linear or not _ranges(self.model):
            raise CaseError(
                "the stability of this law in these tests is not known",
                where="--stable",
                expected="a law of large strains, without a memory but `viscous`, and a test that "
                "is not volumetric",
            )

    @cached_property
    def answer(self) -> Answer:
        """That without the condition if it is stable; the best one that was found to be so, else.

        Where there is none, it has not ended.
        """
        if self.stable(self.free.z):
            return self.free
        ends, starts = list[Answer](), [self.free.z, *spread(self.model, _STARTS)]
        for z in starts:
            least = min((end.cost for end in ends), default=np.inf)
            if (end := self._descend(z, least * (1 + _SAME))) is not None:
                ends.append(end)
        if not ends:
            why = "no constants were found with which the law is stable over the tests"
            return replace(self.free, ended=False, why=why)
        best = min(ends, key=lambda one: one.cost)
        same = sum(one.cost <= best.cost * (1 + _SAME) for one in ends)
        return replace(best, starts=len(starts), same=same)

    def _descend(self, z: FloatArray, most: float) -> Answer | None:
        """Where a descent ends; None: it cannot begin, is not stable there, or has lost.

        Args:
            most: Sum of squares that others have reached: with the penalties it only grows with w.
        """
        from scipy.optimize import least_squares

        model, tests = self.model, self.model.tests
        assert isinstance(tests, HomogeneousTests)
        part = _Penalised(model, tests)
        inside = 1e-8 * np.maximum(np.abs(z), 1e-3)
        z = np.clip(z, model.low + inside, model.high - inside)
        if not np.isfinite(model.sensitivities(z)).all():
            return None
        size = np.where(self.free.z != 0, np.abs(self.free.z), 1.0)  # tolerances are of all alike
        for part.weight, tolerance in _STAGES:
            found = least_squares(
                lambda x: part.residuals(x * size),
                z / size,
                lambda x: part.sensitivities(x * size) * size,
                (model.low / size, model.high / size),
                x_scale="jac",
                ftol=tolerance,
                xtol=tolerance,
                gtol=tolerance,
                max_nfev=self.evaluations,
            )
            z = np.clip(found.x * size, model.low, model.high)
            if 2 * found.cost > most:
                return None
        if not self.stable(z):
            return None
        cost = float(np.sum(model.residuals(z) ** 2))
        return Answer(z, cost, found.status > 0, "least squares of stable laws", 1, 1)
