"""A law that remembers over time steps, evaluated by numpy at many points at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.kinematics import gradient_symbol, variables
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import (
    ImplicitMemory,
    ImplicitStep,
    OverStep,
    Root,
    in_a_row,
)
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram

MOST = 40
ENOUGH = 1e-11
"""Last step of Newton's method, over the size of z."""
SMALLEST = 1e-4

Values = dict[str, FloatArray]
"""Name of a variable to its numbers at points, shape (n, size)."""


@dataclass(frozen=True)
class PointStep:
    """What a step has found.

    Attributes:
        inputs: Numbers of the programs: the past, constants of the step, and of implicit laws z and
            the inverse of dr/dz, shape (n, m).
        found: Of the equations at all points; False where Newton's method has failed.
    """

    inputs: FloatArray
    found: BoolArray


class PointSteps:
    """A law over steps at points, each of backward Euler as in a body.

    Args:
        law: One that remembers, with a number for every constant.

    Attributes:
        memory: What the law remembers, and how that follows from a step.
        F: UFL's symbol of the deformation gradient, shape (3, 3).
        law: The law over a step, whose past and whose constants are symbols, too.
    """

    def __init__(self, law: Law) -> None:
        memory = law.memory
        assert memory is not None
        self.memory = memory
        self.F = gradient_symbol()
        self._names = list(memory.step(1.0, passes=True))
        self._unknowns = memory.unknowns if isinstance(memory, ImplicitMemory) else ()
        self._z = sum(v.size for v in self._unknowns)
        past = sum(v.size for v in memory.seen)
        self._first = past + len(self._names)
        size = max(self._first + self._z + self._z**2, 1)
        self._symbol = ufl.Constant(self.F.ufl_domain(), (size,))
        self.law = self._over_step()

    def _over_step(self) -> SteppedLaw:
        at, past = 0, {}
        for v in self.memory.seen:
            past[v.name] = v.value(self._numbers(at, v.size))
            at += v.size
        step = {name: self._symbol[at + i] for i, name in enumerate(self._names)}
        law: OverStep = self.memory.over_step(past, step)
        if isinstance(self.memory, ImplicitMemory):
            z = self._numbers(self._first, self._z)
            inverse = self._numbers(self._first + self._z, self._z**2)
            law = self.memory.with_root(past, step, Root(self._unknowns, z, inverse))
        assert isinstance(law, SteppedLaw)
        return law

    def _numbers(self, first: int, count: int) -> Expr:
        return ufl.as_vector([self._symbol[first + i] for i in range(count)])

    def program(self, expression: Expr) -> NumpyProgram:
        """What an expression of the law over a step gives, of F and of `PointStep.inputs`."""
        return NumpyProgram(expand_derivatives(expression), self.F, self._symbol)

    @cached_property
    def _equations(self) -> NumpyProgram:
        assert isinstance(self.law, ImplicitStep)
        return self.program(self.law.root.to_solve(self.law.equations(self.F)))

    @cached_property
    def stress(self) -> NumpyProgram:
        """P [Pa] of F and of `PointStep.inputs`, shape (n, 3, 3)."""
        return self.program(self.law.stress(self.F))

    @cached_property
    def tangent(self) -> NumpyProgram:
        """dP/dF [Pa], shape (n, 3, 3, 3, 3)."""
        H, F = variables(self.F)
        return self.program(ufl.diff(self.law.stress(F), H))

    @cached_property
    def at_end(self) -> NumpyProgram:
        """Numbers of `Memory.found` at the end of the step, shape (n, m)."""
        return self.program(in_a_row(self.memory.found, self.law.at_end(self.F)))

    def start(self, count: int) -> Values:
        """The variables in bodies at rest."""
        return {v.name: np.tile(v.at_start, (count, 1)) for v in self.memory.variables}

    def step(self, F: FloatArray, values: Mapping[str, FloatArray], dt: float) -> PointStep:
        """Solves the equations of a step of a length [s].

        Args:
            F: At its end, shape (n, 3, 3).
            values: At its start, from `start` or `follow`.
        """
        n, folded = len(F), self.memory.fold(values, dt)
        numbers = np.array([*self.memory.step(dt, passes=True).values()])
        seen = [folded[v.name] for v in self.memory.seen]
        given = np.hstack([*seen, np.tile(numbers, (n, 1))])
        if not self._z:
            rest = np.zeros((n, self._symbol.ufl_shape[0] - self._first))
            return PointStep(np.hstack([given, rest]), np.ones(n, dtype=bool))
        z = np.hstack([values[v.name] for v in self._unknowns])
        inverse, found = self._newton(F, given, z)
        return PointStep(np.hstack([given, z, inverse.reshape(n, -1)]), found)

    def _newton(
        self, F: FloatArray, given: FloatArray, z: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """The inverse of dr/dz, and where z, which is changed, is a root."""
        n, size = z.shape
        inverse, d = np.zeros((n, size, size)), np.zeros_like(z)
        before, share, length = z.copy(), np.ones(n), np.full(n, np.inf)
        found, going = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
        for _ in range(MOST):
            k = np.flatnonzero(going)
            if not len(k):
                break
            values = self._equations(
                F[k], np.hstack([given[k], z[k], inverse[k].reshape(-1, size**2)])
            )
            r, J = values[:, :size], values[:, size:].reshape(-1, size, size)
            scale = np.linalg.norm(z[k], axis=1) + 1e-3
            trial = np.linalg.norm(np.einsum("nij,nj->ni", inverse[k], r), axis=1) / scale
            worse = np.isfinite(length[k]) & ~(trial < length[k]) & (length[k] > ENOUGH)
            back, on = k[worse], k[~worse]
            share[back] /= 2
            z[back] = before[back] + share[back, None] * d[back]
            going[back] = share[back] > SMALLEST
            good = np.isfinite(J[~worse]).all(axis=(1, 2))
            good[good] = np.abs(np.linalg.det(J[~worse][good])) > 0
            going[on[~good]] = False
            on, r, J = on[good], r[~worse][good], J[~worse][good]
            inverse[on] = np.linalg.inv(J)
            d[on] = -np.einsum("nij,nj->ni", inverse[on], r)
            before[on], share[on] = z[on], 1.0
            length[on] = np.linalg.norm(d[on], axis=1) / (np.linalg.norm(z[on], axis=1) + 1e-3)
            z[on] += d[on]
            found[on] = length[on] <= ENOUGH
            going[on] = ~found[on]
        return inverse, found

    def follow(
        self, F: FloatArray, values: Mapping[str, FloatArray], dt: float, step: PointStep
    ) -> Values:
        """The variables at the end of a step, see `step`."""
        now = self.at_end(F, step.inputs)
        at, found = 0, {}
        for v in self.memory.found:
            found[v.name] = now[:, at : at + v.size]
            at += v.size
        return dict(self.memory.follow(values, found, dt))
