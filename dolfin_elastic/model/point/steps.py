"""A law that remembers at points, step by step, evaluated by numpy without a mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import (
    ImplicitMemory,
    ImplicitStep,
    OverStep,
    Root,
    Values,
    in_a_row,
)
from dolfin_elastic.model.materials.stepped import SteppedLaw
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram

MOST = 60
ENOUGH = 1e-11
"""Last step of Newton's method, over the size of z."""
SMALLEST = 1e-4
"""Share of a step of Newton's method below which there is no root."""
SMALL, LEAST = 1e-3, 1e-6
"""See `core.jit.point_roots`."""

Quantity = Callable[..., FloatArray]
"""Function of values of the point's symbols, shape (n, ...), and of the step's length `dt`."""
Length = float | FloatArray
"""Of the step [s]; or one of each point, shape (n,)."""


def of_each(
    function: Callable[..., Mapping[str, FloatArray]], dt: Length, *values: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """What a memory makes of values, of shape (n, size) or (1, size), in a step of each length."""
    if isinstance(dt, float):
        return dict(function(*values, dt))
    rows = [
        function(*({k: v[i % len(v)][None].copy() for k, v in x.items()} for x in values), float(h))
        for i, h in enumerate(dt)
    ]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


class PointOverSteps:
    """What `problem.history.RegionHistory` is to a region, at points.

    Equations of a step are solved as `core.jit.point_roots` does.

    Args:
        law: One with a `memory`; its history begins with the body at rest.
        F: The deformation gradient as a UFL expression of shape (3, 3); None: it is the symbol.
        symbols: The UFL constants of which F is made.

    Attributes:
        F: The deformation gradient in UFL.
        law: Over one step.
        values: Of the variables, as they were committed, by name; shape (n, size), or (1, size) of
            all points.
    """

    def __init__(self, law: Law, F: Expr | None = None, symbols: Sequence[Expr] = ()) -> None:
        memory = law.memory
        assert memory is not None
        self.F = gradient_symbol() if F is None else F
        self._memory, self._symbols = memory, (self.F,) if F is None else tuple(symbols)
        domain = self._symbols[0].ufl_domain()
        every = (*memory.seen, *memory.told)
        self._past = {v.name: ufl.Constant(domain, (v.size,)) for v in every}
        self._step = {name: ufl.Constant(domain) for name in memory.step(0.0, passes=True)}
        past = {v.name: v.value(self._past[v.name]) for v in every}
        stepped: OverStep = memory.over_step(past, self._step)
        self._of_root: tuple[Expr, ...] = ()
        if isinstance(memory, ImplicitMemory):
            size = sum(v.size for v in memory.unknowns)
            self._of_root = ufl.Constant(domain, (size,)), ufl.Constant(domain, (size**2,))
            root = Root(memory.unknowns, *self._of_root)
            stepped = memory.with_root(past, self._step, root)
        assert isinstance(stepped, SteppedLaw)
        self.law, self.values = stepped, {v.name: v.at_start[None] for v in memory.variables}
        # Of the last step whose equations were solved, and what it was asked for.
        self._solved: tuple[tuple[object, ...], tuple[list[FloatArray], BoolArray]] | None = None

    def _program(self, expression: Expr) -> NumpyProgram:
        others = (*self._past.values(), *self._step.values(), *self._of_root)
        return NumpyProgram(expand_derivatives(expression), *self._symbols, *others)

    def quantity(self, expression: Expr) -> Quantity:
        """An expression of the symbols, of the history and of the step as a function of numbers."""
        program = self._program(expression)

        def value(*at: FloatArray, dt: Length) -> FloatArray:
            return np.asarray(program(*at, *self._known(dt), *self._root(at, dt)[0]))

        return value

    def _known(self, dt: Length) -> list[FloatArray]:
        """The past, and the constants of a step."""

        def of_one(values: Values, dt: float) -> dict[str, FloatArray]:
            step = self._memory.step(dt, passes=True)
            return {
                **self._memory.tell(values, dt),
                **self._memory.fold(values, dt),
                **{name: np.array([step[name]]) for name in self._step},
            }

        known = of_each(of_one, dt, self.values)
        return [known[name] for name in (*self._past, *self._step)]

    # --- equations of a step ---

    def found(self, *at: FloatArray, dt: Length) -> BoolArray:
        """Where equations of the step have a root; everywhere, if there are none."""
        return self._root(at, dt)[1]

    @cached_property
    def _equations(self) -> NumpyProgram:
        assert isinstance(self.law, ImplicitStep)
        return self._program(self.law.root.to_solve(self.law.equations(self.F)))

    def equations(self, *at: FloatArray, dt: Length) -> FloatArray:
        """r and dr/dz at the start of a step, shape (n, m)."""
        assert isinstance(self._memory, ImplicitMemory)
        z = np.hstack([self.values[v.name] for v in self._memory.unknowns])
        none = np.zeros((1, z.shape[1] ** 2))
        return np.asarray(self._equations(*at, *self._known(dt), z, none))

    def _root(self, at: Sequence[FloatArray], dt: Length) -> tuple[list[FloatArray], BoolArray]:
        """z and the inverse of dr/dz, nothing without equations; and where they were found."""
        if not isinstance(self._memory, ImplicitMemory):
            return [], np.ones(len(at[0]), dtype=bool)
        asked = (*at, self.values, dt)
        if self._solved is None or any(
            a is not b for a, b in zip(self._solved[0], asked, strict=True)
        ):
            self._solved = asked, self._solve(self._memory, at, dt)
        return self._solved[1]

    def _solve(
        self, memory: ImplicitMemory, at: Sequence[FloatArray], dt: Length
    ) -> tuple[list[FloatArray], BoolArray]:
        """See `_root`."""
        start = np.hstack([self.values[v.name] for v in memory.unknowns])
        n, known = len(at[0]), self._known(dt)
        size = start.shape[1]
        z = np.array(np.broadcast_to(start, (n, size)))
        none = np.zeros((1, size**2))
        points = _Newton(z, [v.size for v in memory.unknowns])
        for _ in range(MOST):
            k = np.flatnonzero(points.going).astype(np.int32)
            if not len(k):
                break
            given = [x if len(x) == 1 else x[k] for x in (*at, *known)]
            points.advance(k, self._equations(*given, points.z[k], none))
        return [points.z, points.inverse.reshape(n, -1)], points.found

    # --- steps ---

    @cached_property
    def _at_end(self) -> Quantity:
        return self.quantity(in_a_row(self._memory.found, self.law.at_end(self.F)))

    def at_end(self, *at: FloatArray, dt: Length) -> dict[str, FloatArray]:
        """The variables at the end of a step to values of the symbols; shape (n, size)."""
        rows, found, offset = self._at_end(*at, dt=dt), {}, 0
        for v in self._memory.found:
            found[v.name] = rows[:, offset : offset + v.size]
            offset += v.size
        return of_each(self._memory.follow, dt, self.values, found)

    def commit(self, *at: FloatArray, dt: Length) -> None:
        """Makes the states at values of the symbols the past."""
        self.values = self.at_end(*at, dt=dt)


class _Newton:
    """Newton's method at many points, damped as in roots.c.

    Args:
        z: Where it starts, shape (n, size); changed.
        sizes: How many numbers each variable has: each counts by its own size.
    """

    def __init__(self, z: FloatArray, sizes: Sequence[int]) -> None:
        n, size = z.shape
        self._columns = np.split(np.arange(size), np.cumsum(sizes)[:-1])
        self.z, self._before, self._step = z, z.copy(), np.zeros_like(z)
        self.inverse = np.zeros((n, size, size))
        self._share, self._length = np.ones(n), np.full(n, np.inf)
        self.found, self.going = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)

    def advance(self, k: IndexArray, values: FloatArray) -> None:
        """Takes r and dr/dz at z of points k, a row each."""
        size = self.z.shape[1]
        r, J = values[:, :size], values[:, size:].reshape(-1, size, size)
        trial = self._measured(np.einsum("nij,nj->ni", self.inverse[k], r), self._before[k])
        length = self._length[k]
        worse = np.isfinite(length) & ~(trial < length) & (length > ENOUGH)
        back = k[worse]
        self._share[back] /= 2
        self.z[back] = self._before[back] + self._share[back, None] * self._step[back]
        self.going[back] = self._share[back] > SMALLEST
        on, r, J = k[~worse], r[~worse], J[~worse]
        good = np.isfinite(J).all(axis=(1, 2))
        good[good] = np.abs(np.linalg.det(J[good])) > 0
        self.going[on[~good]] = False
        on, r = on[good], r[good]
        self.inverse[on] = np.linalg.inv(J[good])
        self._step[on] = -np.einsum("nij,nj->ni", self.inverse[on], r)
        self._before[on], self._share[on] = self.z[on], 1.0
        self._length[on] = self._measured(self._step[on], self.z[on])
        self.z[on] += self._step[on]
        self.found[on] = self._length[on] <= ENOUGH
        self.going[on] = np.isfinite(self._length[on]) & ~self.found[on]

    def _measured(self, step: FloatArray, z: FloatArray) -> FloatArray:
        """Largest change of a variable over its size, shape (n,)."""
        ratios = []
        for columns in self._columns:
            sizes = np.linalg.norm(z[:, columns], axis=1)
            least = max(SMALL * float(np.nan_to_num(sizes).max(initial=0.0)), LEAST)
            ratios.append(np.linalg.norm(step[:, columns], axis=1) / (sizes + least))
        return np.asarray(np.max(ratios, axis=0))
