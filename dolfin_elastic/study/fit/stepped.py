"""Uniaxial stress of laws that remember by steps, metals above all, for many sets of constants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import deformation_from, gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.point.steps import PointOverSteps
from dolfin_elastic.study.fit.constants import SymbolicLaw
from dolfin_elastic.study.fit.curves import TestCurve

_ITERATIONS = 25
_NEAR = 1e-8
"""A last change of the lateral strain, whose square is round-off."""


class SteppedBars:
    """Bars with free sides side by side, one of each set of constants, that go the same way.

    Steps are those between the measured points: of a metal they are exact, whose stress keeps its
    direction, see `model.point.cyclic_curve`.

    Args:
        law: One that is isotropic and has a memory that is followed by steps.
        names: Of the constants that each set has, as `FittedConstant.name`.

    Raises:
        InputError: It has directions of its own.
    """

    def __init__(self, law: Law, names: Sequence[str]) -> None:
        if any(getattr(law, name, None) is not None for name in law.directions):
            raise CaseError("a law with directions that remembers cannot be fitted")
        self._given, self._symbolic = law, SymbolicLaw(law, names)
        domain = gradient_symbol().ufl_domain()
        ends = ufl.Constant(domain), ufl.Constant(domain)
        e, w = (ufl.variable(symbol) for symbol in ends)
        F = deformation_from(ufl.as_matrix([[e, 0, 0], [0, w, 0], [0, 0, w]]))
        self._point = PointOverSteps(self._symbolic.law, F, (*ends, *self._symbolic.symbols))
        P = self._point.law.stress(F)
        along, across = P[0, 0], P[1, 1]
        slopes = [ufl.diff(p, x) for p in (along, across) for x in (e, w)]
        self._numbers = self._point.quantity(ufl.as_vector([along, across, *slopes]))
        self._start = self._point.values

    def predict(self, curve: TestCurve, rows: FloatArray) -> FloatArray:
        """See `HomogeneousTests.predict`."""
        if curve.kind not in ("uniaxial", "cyclic", "relaxation"):
            raise CaseError(
                f"a law that remembers by steps has no {curve.kind} test",
                where=curve.source or curve.kind,
                expected="uniaxial, cyclic or relaxation",
            )
        memory = self._given.memory
        if memory is not None and memory.timed and curve.time is None:
            raise CaseError(
                "the law depends on time, and no column has it",
                where=curve.source or curve.kind,
                expected="a column 'time', and cyclic",
            )
        self._point.values = self._start
        arrays, m = self._symbolic.arrays(rows), len(rows)
        stretches, steps = curve.steps()
        e, w = np.zeros(m), np.zeros(m)
        thinner: FloatArray = np.full(m, -0.4)
        found = []
        with np.errstate(all="ignore"):
            for x, dt in zip(stretches - 1, steps, strict=True):
                w, e = w + thinner * (x - e), np.full(m, x)
                for _ in range(_ITERATIONS):
                    along, across, _, ew, we, ww = self._numbers(e, w, *arrays, dt=float(dt)).T
                    change = -across / ww
                    w, along = w + change, along + ew * change
                    if not (np.abs(change) > _NEAR).any():
                        break
                good = np.abs(change) <= _NEAR
                thinner = np.where(good, -we / ww, np.nan)
                self._point.commit(e, w, *arrays, dt=float(dt))
                true = curve.true and not self._given.linear
                found.append(np.where(good, along / (1 + w) ** 2 if true else along, np.nan))
        return np.stack(found[-len(curve.x) :], axis=1)
