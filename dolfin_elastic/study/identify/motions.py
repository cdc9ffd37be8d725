"""`Motions`: how an equilibrium moves with a parameter, by Newton's linear solver.

With all unknowns x, and pressures of contact whose gaps stay closed, an equilibrium R(x, p; m) = 0,
g(x; m) = 0 moves by

    R_x dx/dm + R_p dp/dm = -R_m,    g_x dx/dm = -g_m.

What is left of these equations is known by differences of fourth order along a motion; Newton's
linear solver, and p <- p - eps g with the penalty eps that is in its tangent, correct it.  So the
tangent need be neither symmetric nor exact, and its factors, or its preconditioner, may be old.
Source: D. A. Tortorelli and P. Michaleris, Inverse Problems in Engineering 1 (1994) 71 (direct
differentiation); of the iteration `Mixing`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.nonlinear.kept_gaps import KeptGaps
from dolfin_elastic.solvers.nonlinear.mixing import Mixing
from dolfin_elastic.solvers.petsc.options import ksp_reason
from dolfin_elastic.study.gradient.parameters import (
    STEP,
    WEIGHTS,
    Equilibrium,
    Sides,
    combined,
    move_prescribed,
    pressures_of,
)

_ENOUGH, _ROUND_OFF = 1e-9, 1e-15
"""Next correction over the largest one, and round-off of places over the size of the body."""
_ROUGH = 1e-5
"""Tolerance of an iterative solver in each correction."""
_CORRECTIONS = 50


@dataclass(frozen=True)
class Motion:
    """How an equilibrium moves, by one of a parameter.

    Attributes:
        numbers: Whole derivatives of the functionals.
        displacements: Local entries [m].
    """

    numbers: FloatArray
    displacements: FloatArray


class Motions:
    """Motions of one equilibrium.  Collective, all of it; `close` it.

    Args:
        here: The equilibrium, whose contacts keep what presses, see `Equilibrium.kept`.
    """

    def __init__(self, here: Equilibrium) -> None:
        newton, pairs = here.newton, here.problem.contact_pairs
        newton.factorise(anew=False)
        self._here, self._comm, none = here, here.assembler.comm, np.zeros(0)
        source = newton.bordered or here.assembler
        self._x, self._y = source.create_vector(), source.create_vector()
        source.get(self._x)
        self._start = self._x.array_r.copy()
        self._lam = np.concatenate([none, *(pair.values() for pair in pairs)])
        self._ends = np.cumsum([len(pair.nodes) for pair in pairs], dtype=int)
        self._gaps = KeptGaps(here.assembler, newton.bordered) if pairs else None
        self._eps = none if self._gaps is None else self._gaps.eps
        self._step, self._round_off = STEP * newton.cell_size, _ROUND_OFF * newton.span
        self._highest = self._sizes(none, pressures_of(here.problem))[1] or np.inf
        # In the mixing all are lengths.
        self._scales = np.ones(len(self._start))
        if newton.bordered is not None:
            behind = self._scales[here.assembler.size :]
            behind[:] = self._step / newton.bordered.scalars.steps[: len(behind)]

    def by(self, side: Sides) -> Motion:
        """The motion with a parameter.

        Args:
            side: Derivatives by it at fixed unknowns, as `Parameter.derivative` has them.

        Returns:
            Whole derivatives.

        Raises:
            InputError: It was not found.
        """
        x, p = np.zeros_like(self._start), np.zeros_like(self._lam)
        most: FloatArray = np.zeros(2)
        before: FloatArray = np.zeros(2)
        moved: FloatArray = np.zeros_like(self._here.problem.u.x.array)
        left, mixing, round_off = side, Mixing(self._comm), 0.0
        for _ in range(_CORRECTIONS):
            dx = self._corrected(left)
            dp = left.pressures - p - self._eps * self._rates(dx)
            changes = self._sizes(dx * self._scales, dp / self._eps)
            most = np.maximum(most, changes)
            # The next one falls as this has, or faster.
            fall = np.divide(changes, before, out=np.ones(2), where=before > changes)
            found = bool(np.all(fall * changes <= np.maximum(_ENOUGH * most, round_off)))
            if found:
                x, p = x + dx, p + dp
            else:
                lengths, more = (
                    np.concatenate([one * self._scales, other / self._eps])
                    for one, other in ((x, p), (dx, dp))
                )
                mixed, heights = np.split(mixing.next(lengths, more), [len(x)])
                x, p, before = mixed / self._scales, heights * self._eps, changes
            h = self._step_along(x, p)
            changed, moved = self._along(x, p, h)
            left, round_off = combined([(1.0, side), (1.0, changed)]), self._round_off / h
            if found:
                return Motion(left.numbers, moved)
        raise InputError(
            f"the motion with a parameter was not found in {_CORRECTIONS} corrections",
            expected="differences of runs",
        )

    def _sizes(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Largest entries of both."""
        local = (float(np.abs(one).max(initial=0.0)) for one in (x, p))
        return np.array([largest(self._comm, one) for one in local])

    def _corrected(self, left: Sides) -> FloatArray:
        """What takes the rest of the equations away, by the tangent that there is."""
        newton, assembler = self._here.newton, self._here.assembler
        fields = assembler.balanced(assembler.free_part(left.forces))
        fields[assembler.fixed_pressures] = 0.0
        if newton.bordered is None:
            self._x.array_w[:] = -fields
        else:
            newton.bordered.fill(self._x, -fields, -left.equations)
        usual = newton.ksp.getTolerances()[0]
        newton.ksp.setTolerances(rtol=_ROUGH)
        try:
            with newton.options.in_force(), petsc_errors(), newton.linear.left_as_it_is():
                newton.snes.ksp.solve(self._x, self._y)
        finally:
            newton.ksp.setTolerances(rtol=usual)
        reason = newton.snes.ksp.getConvergedReason()
        if reason < 0:
            raise InputError(
                f"the motion with a parameter was not found: {ksp_reason(reason)}",
                expected="differences of runs",
            )
        result = self._y.array_r.copy()
        if (level := assembler.level) is not None:
            fields = result[: assembler.size]
            result[: assembler.size] = level.without_mean(fields, level.bodies)
        return result

    def _rates(self, dx: FloatArray) -> FloatArray:
        """How gaps open along a motion, nearly, (n,) [m]."""
        if self._gaps is None:
            return np.zeros(0)
        assembler, bordered = self._here.assembler, self._here.newton.bordered
        self._x.array_w[:] = dx
        scalars = np.zeros(0) if bordered is None else bordered.scalar_part(self._x)
        free = assembler.free_part(dx[: assembler.size])
        return self._gaps.rates(self._gaps.way(free, scalars, None))[0]

    def _step_along(self, x: FloatArray, p: FloatArray) -> float:
        """Of the differences: as large as pressures, and small against cells."""
        moved, pressed = self._sizes(x[self._here.assembler.displacement_dofs], p)
        most = max(moved / self._step, pressed / self._highest)
        return 1 / most if most > 0.0 else 1.0

    def _along(self, x: FloatArray, p: FloatArray, h: float) -> tuple[Sides, FloatArray]:
        """Differences of everything along a motion, and of displacements."""
        here, u, parts = self._here, self._here.problem.u, list[tuple[float, Sides]]()
        unknowns, moved = here.newton.unknowns(), np.zeros_like(u.x.array)
        try:
            for k, weight in WEIGHTS.items():
                self._put(self._start + k * h * x, self._lam + k * h * p)
                parts.append((weight / h, here.evaluated()))
                moved += weight / h * u.x.array
        finally:
            self._put_multipliers(self._lam)
            here.newton.put_back(unknowns)
        return combined(parts), moved

    def _put(self, x: FloatArray, lam: FloatArray) -> None:
        """Moves the problem, with what is prescribed where the scalars have it."""
        assembler, bordered = self._here.assembler, self._here.newton.bordered
        self._put_multipliers(lam)
        self._x.array_w[:] = x
        if bordered is not None:
            bordered.scalars.put(bordered.scalar_part(self._x))
        problem = self._here.problem
        problem.w.x.array[: assembler.size] = assembler.origin + x[: assembler.size]
        move_prescribed(assembler)

    def _put_multipliers(self, values: FloatArray) -> None:
        for pair, end in zip(self._here.problem.contact_pairs, self._ends, strict=True):
            pair.lam.x.array[pair.nodes] = values[end - len(pair.nodes) : end]
            pair.lam.x.scatter_forward()

    def close(self) -> None:
        """Frees what it owns."""
        self._x.destroy()
        self._y.destroy()
