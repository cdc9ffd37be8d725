"""Multipliers of contact and friction as unknowns of Newton's method.

In statics the pressures p_I and tractions t_I at vertices are multipliers.  Uzawa's updates find
them after each equilibrium with a penalty, and need many of these where the penalty is soft beside
what it presses on.  Here the equations of contact belong to the system, a semismooth one:

    p_I = max(0, p_I - eps g_I),      t_I = y_I min(1, mu p_I/|y_I|),    y_I = t_I - eps_t e_I,

with the mean gap g_I and the motion e_I since the point stuck.  Each iteration decides by them
which vertices are open, stick or slide, and is Newton's method with these conditions: gaps and
slips of points that stick close, dg_I = -g_I, tractions of slip follow the pressures.  The gaps
have a small compliance 1/E, so that no multiplier is an unknown of the linear solver:

    p_I(end) = p_I - E (g_I + dg_I),                       by the tangent E/A_I G_I G_I.

Only linear forces depend on E, and what it leaves of the gap falls with each iteration.  A point
that slid and turns round has stuck on the way: it sticks in the next iteration.

Source: S. Hueber & B. Wohlmuth, Comput. Methods Appl. Mech. Eng. 194 (2005) 3147; M. Gitterle, A.
Popp, M. W. Gee & W. A. Wall, Int. J. Numer. Meth. Eng. 84 (2010) 543 (finite deformations,
friction); P. Alart & A. Curnier, ibid. 92 (1991) 353.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray

RIGID = 30.0
"""E over the penalty by default: contact is 300 times as stiff as the elements behind it."""

SETTLED = 1e-6
"""Error of pressures by the gap that is left, and of tractions of slip, over the largest one."""


@dataclass(kw_only=True)
class Iterate:
    """Multipliers at the owned vertices in an iteration.

    Attributes:
        values: They [Pa]; at the end of the iteration once there is one.
        after: They after all of the step, see `foresee` [Pa].
        ended: The step was taken.
    """

    values: FloatArray
    after: FloatArray | None = None
    ended: bool = False

    def step(self, share: float) -> None:
        """Takes a share of the step."""
        assert self.after is not None
        self.values, self.ended = self.values + share * (self.after - self.values), True


@dataclass(kw_only=True)
class PressureIterate(Iterate):
    """The pressures, (n,).

    Attributes:
        gaps: Mean gaps where the iteration begins [m].
        active: Which vertices are in contact in it.
        stiffness: E [Pa/m].
    """

    gaps: FloatArray
    active: BoolArray
    stiffness: FloatArray

    @property
    def acting(self) -> FloatArray:
        """Pressures of the residual: where the iteration begins, those with which it solves."""
        return self.values if self.ended else self._after(self.gaps)

    @property
    def falls(self) -> FloatArray:
        """How these fall with the gaps [Pa/m]."""
        return np.asarray(self.active * self.stiffness)

    def _after(self, gaps: FloatArray) -> FloatArray:
        return np.where(self.active, self.values - self.stiffness * gaps, 0.0)

    def foresee(self, rates: FloatArray) -> None:
        """Takes the pressures after the step, which changes the gaps by `rates` [m]."""
        self.after = self._after(self.gaps + rates)


@dataclass(kw_only=True)
class TractionIterate(Iterate):
    """The tractions, (n, dim).

    Attributes:
        off: Motion along the surface since points stuck, where the iteration begins [m].
        normals: Of the surface there.
        slides: Which vertices slide in it, (n,).
        along: Directions of their tractions.
        turns: mu p over the length of the trial y, (n,).
        mu: Coulomb's coefficient.
        springs: Penalty of the law, (n,) [Pa/m].
        pressures: Of the same iteration.
    """

    off: FloatArray
    normals: FloatArray
    slides: BoolArray
    along: FloatArray
    turns: FloatArray
    mu: float
    springs: FloatArray
    pressures: PressureIterate

    @property
    def limits(self) -> FloatArray:
        """mu p, (n,) [Pa]."""
        return self.mu * self.pressures.values

    @property
    def stiffness(self) -> FloatArray:
        """By which tractions follow the motion of points, those of slip across it, (n,) [Pa/m]."""
        return np.where(self.slides, 1.0, RIGID) * self.springs

    @property
    def acting(self) -> FloatArray:
        """Tractions of the residual, see `PressureIterate`."""
        if self.ended:
            return self.values
        return self._after(self.pressures.acting, np.zeros_like(self.off))

    def _after(self, pressures: FloatArray, way: FloatArray) -> FloatArray:
        k, way = self.stiffness[:, None], across(way, self.normals)
        sticks = self.values - k * (self.off + way)
        slides = self.mu * pressures[:, None] * self.along
        slides -= self.turns[:, None] * k * across(way, self.along)
        return np.where(self.slides[:, None], slides, sticks) * self.pressures.active[:, None]

    def foresee(self, way: FloatArray) -> None:
        """Takes the tractions after the step, in which points move by `way` [m]."""
        assert self.pressures.after is not None
        self.after = self._after(self.pressures.after, way)


def across(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """The parts of vectors that are not along unit vectors, both (n, dim)."""
    return np.asarray(vectors - np.sum(vectors * normals, axis=1)[:, None] * normals)
