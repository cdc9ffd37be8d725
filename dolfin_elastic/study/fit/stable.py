"""Stability over the range of the tests: where a fitted law has it, and how a fit gets it.

Stable means strongly elliptic, and a nominal stress that rises; `model.point.stable_range` has the
sources.  With the size s of the stresses the condition of a fit that is to be stable is, in states
of the tests,

    g = (smallest eigenvalue of the acoustic tensor, slope of the stress)/s > 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfin_elastic.core.errors import CaseError, InputError
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.ellipticity import acoustic_eigenvalues, directions
from dolfin_elastic.model.point.homogeneous_tests import DeformationMode
from dolfin_elastic.model.point.stable_range import rising
from dolfin_elastic.model.point.tested import with_finite_moduli
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints
from dolfin_elastic.study.fit.constrained import Condition
from dolfin_elastic.study.fit.curves import TestCurve
from dolfin_elastic.study.fit.homogeneous import HomogeneousTests
from dolfin_elastic.study.fit.model import Model

_GRID = 16
"""Points to each side of the rest at which stability is looked at."""
_SPREAD = 24
"""Directions of waves beside the axes and diagonals."""


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


@dataclass(frozen=True)
class Stability(Condition):
    """The law is stable over the range of the tests.

    Raises:
        CaseError: The stability of the law is not looked at.
    """

    name = "that of stability"
    without = "the law is not stable over the range of the tests"
    nowhere = "no constants were found with which the law is stable over the tests"

    def __post_init__(self) -> None:
        tests = self.model.tests
        if not isinstance(tests, HomogeneousTests) or tests.linear or not self._ranges:
            raise CaseError(
                "the stability of this law in these tests is not known",
                where="--stable",
                expected="a law of large strains, without a memory but `viscous`, and a test that "
                "is not volumetric",
            )

    @cached_property
    def _ranges(self) -> list[_Range]:
        return _ranges(self.model)

    @cached_property
    def _tests(self) -> HomogeneousTests:
        assert isinstance(self.model.tests, HomogeneousTests)
        return self.model.tests

    @cached_property
    def _N(self) -> FloatArray:
        """Directions of waves."""
        return directions(_SPREAD)

    def holds(self, z: FloatArray) -> bool:
        """See `Condition`."""
        try:
            return STABLE in stability(self.law_at(z), self.model, z)
        except InputError:  # the law does not accept them
            return False

    def margins(self, z: FloatArray) -> FloatArray:
        """Least eigenvalues of the acoustic tensor and slopes of the stress, in all states."""
        parts = []
        for one in self._ranges:
            F, P, A = self._tests.tangents(one.curve, z * self.model.scale)
            least = self._acoustic(F, A).reshape(len(z), -1)
            parts += [least / self.size, np.diff(P, axis=1) / np.diff(one.x) / self.size]
        return np.hstack(parts)

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
            Q = across @ Q @ across + 1e6 * self.size * along
        result[good] = np.linalg.eigvalsh(Q)[..., 0].min(axis=1)
        return result
