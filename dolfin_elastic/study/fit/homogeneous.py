"""Stress of a law in homogeneous tests, for many sets of its constants at once.

The sides that are free have no stress.  Of an incompressible law that is isotropic F follows from
the stretch, and the pressure from the free side 3: the nominal stress is P11 - P33 F33/F11.  Of all
others the free parts of F are found by Newton's method with the tangent, at all points together.

Of a law that relaxes by branches (see `materials.viscous`) a slow test has the stress after a long
time, and tests over time follow step by step; every set of constants has branches of its own.

Source: R. W. Ogden, Non-linear Elastic Deformations (1984), section 4.4 (homogeneous tests).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol, variables
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.materials.viscous import Relaxation, Relaxed
from dolfin_elastic.model.point.homogeneous_tests import DeformationMode
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram
from dolfin_elastic.study.fit.constants import SymbolicLaw
from dolfin_elastic.study.fit.curves import TestCurve

_ITERATIONS = 40
_LARGEST_CHANGE = 0.3
"""Of a free stretch in one iteration, over itself."""
_SWEEPS = 60
"""Iterations of a whole history."""
_NEAR, _GOOD = 1e-10, 1e-6
"""Last change of the free parts of F, whose square is round-off; and one that is still good."""


@dataclass(frozen=True)
class _Step:
    """What the past adds to the stress in one step.

    Attributes:
        H: See `materials.viscous` [Pa], shape (m, 3, 3).
        instant: Factor of the stress that relaxes, shape (m,).
    """

    H: FloatArray
    instant: FloatArray


class HomogeneousTests:
    """A law without memory, or with branches that relax, in homogeneous tests.

    Args:
        law: With the numbers of the constants that are not in `names`.
        names: Of the constants that each set has, as `FittedConstant.name`.

    Raises:
        InputError: The law has a memory of another kind.
    """

    def __init__(self, law: Law, names: Sequence[str]) -> None:
        symbolic = SymbolicLaw(law, names)
        self._given, self._symbolic, self._names = law, symbolic, list(names)
        self._F = gradient_symbol()
        domain = self._F.ufl_domain()
        self._H, self._instant = ufl.Constant(domain, (3, 3)), ufl.Constant(domain)
        self._law: Law | Relaxed = symbolic.law
        if law.viscous:
            memory = symbolic.law.memory
            assert isinstance(memory, Relaxation)
            step = {"instant": self._instant, "lasting": self._instant}
            self._law = memory.over_step({"H": self._H}, step)
        small = law.small_strain()
        self._nu = 0.45 if small is None else min(small.nu, 0.4999)
        self.incompressible, self.linear = _is_incompressible(law), law.linear

    def _stress(self, F: Expr) -> Expr:
        if self.incompressible:
            assert not isinstance(self._law, Law) or isinstance(self._law, SplitLaw)
            return self._law.shape_stress(F)  # type: ignore[union-attr]
        return self._law.stress(F)

    def _program(self, expression: Expr) -> NumpyProgram:
        symbols = (self._F, self._H, self._instant, *self._symbolic.symbols)
        return NumpyProgram(expand_derivatives(expression), *symbols)

    @cached_property
    def _P(self) -> NumpyProgram:
        return self._program(self._stress(self._F))

    @cached_property
    def _A(self) -> NumpyProgram:
        H, F = variables(self._F)
        return self._program(ufl.diff(self._stress(F), H))

    @cached_property
    def _S(self) -> NumpyProgram:
        assert isinstance(self._law, Relaxed)
        return self._program(self._law.second(self._F))

    # --- branches ---

    def _branches(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ratios and times [s] of each set, shape (m, b), and what lasts, shape (m,)."""
        law = self._given
        factor = 1.0 if law.viscous_shift is None else law.viscous_shift.factor
        values = {name: rows[:, i] for i, name in enumerate(self._names)}

        def column(key: str) -> FloatArray:
            given = [
                values.get(f"viscous[{i}].{key}", np.full(len(rows), getattr(term, key)))
                for i, term in enumerate(law.viscous)
            ]
            return np.stack(given, axis=1) if given else np.zeros((len(rows), 0))

        ratios, times = column("ratio"), factor * column("time")
        sudden = law.viscous_constants == "instantaneous"
        return ratios, times, 1 - ratios.sum(axis=1) if sudden else np.ones(len(rows))

    # --- curves ---

    def predict(self, curve: TestCurve, rows: FloatArray) -> FloatArray:
        """Stress of a test as it was measured [Pa], shape (m, n); nan where there is none.

        Args:
            rows: Sets of constants, shape (m, k).
        """
        if curve.time is not None and self._given.viscous:
            return self._over_time(curve, rows)
        return self.slow(curve, rows)[1]

    def slow(self, curve: TestCurve, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Deformation gradients of a test without times, and the stress as it was measured [Pa].

        Args:
            rows: See `predict`.

        Returns:
            Shapes (m n, 3, 3), one set after the other, and (m, n).
        """
        step, arrays = self._slowly(curve, rows)
        F = self._guess(curve, np.tile(curve.x, len(rows)))
        F = self._equilibrium(curve.mode, F, step, arrays)
        return F, self._measured(curve, F, step, arrays).reshape(len(rows), -1)

    def tangents(
        self, curve: TestCurve, rows: FloatArray
    ) -> tuple[FloatArray, FloatArray, AnyArray]:
        """The same, and dP/dF there [Pa], shape (m n, 3, 3, 3, 3).

        Of an incompressible law it is that without the pressure.
        """
        step, arrays = self._slowly(curve, rows)
        F, P = self.slow(curve, rows)
        return F, P, self._A(F, step.H, step.instant, *arrays)

    def _slowly(self, curve: TestCurve, rows: FloatArray) -> tuple[_Step, list[FloatArray]]:
        """A step in which all has relaxed, and the constants, at all points of all sets."""
        m, n = len(rows), len(curve.x)
        step = _Step(np.zeros((m * n, 3, 3)), np.repeat(self._branches(rows)[2], n))
        return step, [np.repeat(array, n, axis=0) for array in self._symbolic.arrays(rows)]

    def _over_time(self, curve: TestCurve, rows: FloatArray) -> FloatArray:
        """The same over time, from a body at rest.

        The whole history is iterated together: F at all times by Newton's method, and what the past
        adds from the stresses of the F before. As the past is known where it begins, the errors
        leave step by step, and fast where the volume hardly changes.
        """
        m, (x, steps) = len(rows), curve.steps()
        arrays = [np.repeat(array, len(x), axis=0) for array in self._symbolic.arrays(rows)]
        branches = self._branches(rows)
        F = self._guess(curve, np.tile(x, m))
        step = _Step(np.zeros_like(F), np.repeat(branches[2], len(x)))
        mode = curve.mode
        change: FloatArray = np.full(len(F), np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_SWEEPS):
                S = self._S(F, step.H, step.instant, *arrays).reshape(m, len(x), 3, 3)
                step = _past(S, steps, *branches)
                if self.incompressible:
                    break
                F, change = self._newton(mode, F, step, arrays)
                if not (change > _NEAR).any():
                    break
        if not self.incompressible:
            F[~(change <= _GOOD)] = np.nan
        return self._measured(curve, F, step, arrays).reshape(m, -1)[:, -len(curve.x) :]

    def _guess(self, curve: TestCurve, values: FloatArray) -> FloatArray:
        """F whose free stretches are those of a law with the same Poisson's ratio; (n, 3, 3)."""
        mode, nu = curve.mode, 0.5 if self.incompressible else self._nu
        places, which = np.unique(values, return_inverse=True)
        F = np.array([mode.place(float(value)) for value in places])[which]
        if not mode.free:
            return F
        sideways = {"uniaxial": nu, "equibiaxial": 2 * nu / (1 - nu), "planar": nu / (1 - nu)}
        power = sideways[mode.name]
        thin = 1 - power * (values - 1) if self._given.linear else values**-power
        F[:, 2, 2] = thin
        if (1, 1) in mode.free:
            F[:, 1, 1] = thin
        return F

    def _equilibrium(
        self, mode: DeformationMode, F: FloatArray, step: _Step, arrays: Sequence[FloatArray]
    ) -> FloatArray:
        """The state near F whose free sides bear no stress; nan where there is none."""
        if self.incompressible or not mode.free:
            return F
        F, change = F.copy(), np.asarray(np.full(len(F), np.inf))
        with np.errstate(all="ignore"):
            for _ in range(_ITERATIONS):
                F, change = self._newton(mode, F, step, arrays)
                if not (change > _NEAR).any():
                    break
        F[~(change <= _GOOD)] = np.nan
        return F

    def _newton(
        self, mode: DeformationMode, F: FloatArray, step: _Step, arrays: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """One iteration, and how far it went over the stretches, shape (n,)."""
        i, j = np.array(mode.free).T
        scale, at = np.sqrt(np.abs(F[:, i, i] * F[:, j, j])), (F, step.H, step.instant, *arrays)
        matrix = self._A(*at)[:, i[:, None], j[:, None], i, j]
        change = _solved(matrix, self._P(*at)[:, i, j])
        size = np.abs(change / scale).max(axis=1)
        limit = np.minimum(1.0, _LARGEST_CHANGE / np.maximum(size, 1e-300))
        F = F.copy()
        F[:, i, j] -= change * limit[:, None]
        return F, np.asarray(size)

    def _measured(
        self, curve: TestCurve, F: FloatArray, step: _Step, arrays: Sequence[FloatArray]
    ) -> FloatArray:
        """What the machine shows in states [Pa], shape (n,)."""
        P = self._P(F, step.H, step.instant, *arrays)
        mode, linear = curve.mode, self._given.linear
        if curve.kind == "volumetric":
            F = np.broadcast_to(np.eye(3), F.shape) if linear else F
            J = np.linalg.det(F)
            return np.asarray(np.einsum("nij,nij->n", P, F) / (3 * J))
        value = P[:, *mode.shown]
        if self.incompressible and mode.free:
            value = value - P[:, 2, 2] * (1.0 if linear else F[:, 2, 2] / F[:, 0, 0])
        if curve.true and not linear and mode.name != "simple-shear":
            value = value * F[:, 0, 0] / np.linalg.det(F)
        return np.asarray(value)


def _past(
    S: FloatArray, steps: FloatArray, ratios: FloatArray, times: FloatArray, lasting: FloatArray
) -> _Step:
    """What the past adds in all steps, by the recursion of `materials.viscous`.

    Args:
        S: Second Piola-Kirchhoff stress that relaxes, at the end of each step [Pa], (m, n, 3, 3).
        steps: Their lengths [s], shape (n,).
    """
    x = steps[None, :, None] / times[:, None]  # (m, n, b)
    e, f = np.exp(-x), np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1.0), 1.0)
    before = np.concatenate([np.zeros_like(S[:, :1]), S[:, :-1]], axis=1)
    h, H = np.zeros((*ratios.shape, 3, 3)), np.empty_like(S)
    for n in range(len(steps)):
        past = e[:, n, :, None, None] * h - f[:, n, :, None, None] * before[:, n, None]
        H[:, n] = np.einsum("mb,mbij->mij", ratios, past)
        h = past + f[:, n, :, None, None] * S[:, n, None]
    instant = lasting[:, None] + np.einsum("mb,mnb->mn", ratios, f)
    return _Step(H.reshape(-1, 3, 3), instant.ravel())


def _solved(matrix: AnyArray, right: AnyArray) -> FloatArray:
    """Solutions of many small systems; nan where there is none."""
    finite = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    good: BoolArray = np.asarray(finite)
    good[good] = np.abs(np.linalg.det(matrix[good])) > 0
    result = np.full(right.shape, np.nan)
    result[good] = np.linalg.solve(matrix[good], right[good][..., None])[..., 0]
    return result


def _is_incompressible(law: Law) -> bool:
    return isinstance(law, SplitLaw) and bool(np.isinf(getattr(law, law.volume_modulus) or 0.0))


def check_curves(law: Law, curves: Sequence[TestCurve]) -> None:
    """Refuses tests that a law has no answer to.

    Raises:
        InputError: See above.
    """
    solid = _is_incompressible(law)
    for curve in curves:
        where = curve.source or curve.kind
        if curve.kind == "volumetric" and solid:
            raise CaseError(
                "an incompressible material, nu = 0.5, has no change of volume to fit",
                where=where,
                expected='K = "fit" in place of nu, or leave the test out',
            )
        if curve.kind == "relaxation" and law.memory is None:
            raise CaseError(
                "the law does not relax",
                where=where,
                expected='viscous = [{ratio = "fit", time = "fit"}] in its table, a branch or more',
            )
    if solid and any(getattr(law, name, None) is not None for name in law.directions):
        raise CaseError(
            "an anisotropic law cannot be fitted with nu = 0.5",
            expected="nu = 0.499, which is close",
        )
