"""`ContactStep`: contact forces of a time step, which do the work that the penalty stores.

The trial pressures a0 and a1 at both ends of a step, their positive parts q0 and q1, and the share
alpha of the old displacement in the stage's give the pressure of the step

    p = (q0 + q1)/(|a0| + |a1|) ((1 - alpha) q1 + alpha q0).

While the surface is in contact that is the pressure of the stage; if it hits or leaves within the
step, the first factor is the part of the way on which it is.  With the gap g = (lam - a)/eps

    p (g1 - g0) = W0 - W1 - (1/2 - alpha) (q1 - q0)^2 (...)/eps,    W = q^2/(2 eps),

with a factor (...) of at least 0: with alpha = 1/2 the work is the change of the energy exactly,
however hard the hit, and below it the scheme takes energy out, and never makes any.

The direction is a discrete gradient of the gap, that of the middle of the way dx of the point with
what is missing of the change of the gap along dx,

    n = n_m + (g1 - g0 - n_m . dx)/(dx . dx) dx.

Source: T. A. Laursen & V. Chawla, Int. J. Numer. Methods Eng. 40 (1997) 863; F. Armero & E.
Petocz, Comput. Methods Appl. Mech. Eng. 158 (1998) 269 (penalty); O. Gonzalez, J. Nonlinear Sci. 6
(1996) 449 (discrete gradient).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.term import StepWeights, Term

TINY = np.finfo(float).tiny

AtPoints = Callable[[FloatArray], FloatArray]
"""Gives displacements of points, shape (..., dim), of those of all nodes, (nodes, dim) [m]."""

SHORT = 1e-14
"""Square of the way over that of an element's size below which no correction of the normal is
made: it is of the way's third power, and round-off over the way."""


class ContactStep:
    """The step of a motion over which a contact takes its forces.  Collective to make.

    Args:
        pose: Of the obstacle, see `pose`.
        size: Of an element [m].

    Attributes:
        start: Displacement less that of the obstacle at the start of the step [m].
        share: 1 in a step; 0 at a state, which is all of the step then.
        old: Share alpha of the old displacement in the stage's.
        short: See `SHORT` [m^2].
    """

    def __init__(self, context: FormContext, pose: Pose, size: float) -> None:
        self._context, self._pose = context, pose
        self.start = fem.Function(context.unknowns.V)
        self.share, self.old = context.constant(0.0), context.constant(0.0)
        self.short = SHORT * size**2
        self.begun = False

    @property
    def on(self) -> bool:
        """Forces are those of a step."""
        return bool(self.share.value > 0.0)

    @property
    def ahead(self) -> float:
        """Way from the stage to the end of the step over that from its start to the stage."""
        old = float(self.old.value)
        return old / (1 - old)

    def begin(self) -> None:
        """The step begins at the present state. Not collective."""
        self.begun = True
        self.start.x.array[:] = self._past().reshape(-1)

    def enter(self, old: float) -> None:
        """Forces are those of the step now, unless its end is the stage. Not collective."""
        self.share.value, self.old.value = float(old > 0.0), old

    def leave(self) -> None:
        """Forces are those of a state again. Not collective."""
        self.share.value = 0.0

    # --- in UFL ---

    def places(self, X: Expr) -> tuple[Expr, Expr]:
        """Where points are at both ends of the step, as the obstacle sees them.

        Args:
            X: Their reference places.
        """
        past, pose = self._context.u - self._pose.shift, self._pose
        way = self.share * (past - self.start)
        last = X + past + self.old / (1 - self.old) * way
        return pose.seen_in_form(X + past - way, at_start=True), pose.seen_in_form(last)

    def place(self, X: Expr) -> Expr:
        """Where points are at the stage: the mean of both ends, as the obstacle sees them."""
        if self._pose.last is None:
            return X + self._context.u - self._pose.shift
        first, last = self.places(X)
        return (1 - self.old) * last + self.old * first

    def mean_normal(self, gaps: tuple[Expr, Expr], way: Expr, normal: Expr) -> Expr:
        """The direction of the module.

        Args:
            gaps: Of the point at the start and at the end of the step [m].
            normal: The unit normal of the obstacle at the middle of the way.
        """
        square = ufl.inner(way, way)
        missing = (gaps[1] - gaps[0] - ufl.dot(normal, way)) / ufl.max_value(square, self.short)
        return normal + ufl.conditional(ufl.gt(square, self.short), missing, 0.0) * way

    # --- numbers ---

    def _past(self) -> FloatArray:
        """Displacements less the obstacle's of all nodes of this rank, (nodes, dim) [m]."""
        shift = self._pose.shift.value
        return np.asarray(self._context.unknowns.u.x.array.reshape(-1, len(shift)) - shift)

    def ends(self, X: FloatArray, at: AtPoints) -> tuple[FloatArray, FloatArray]:
        """Where the obstacle sees points at both ends of the step, shape of X [m].

        Args:
            X: Their reference places.
            at: Gives what they have of the nodes' displacements.
        """
        (start, end), pose = self.past_ends(), self._pose
        return pose.seen(X + at(start), pose.at_start), pose.seen(X + at(end))

    def past_ends(self) -> tuple[FloatArray, FloatArray]:
        """Displacements less the obstacle's at both ends of the step, (nodes, dim) [m]."""
        past = self._past()
        start = self.start.x.array.reshape(past.shape) if self.on else past
        return start, past + self.ahead * (past - start) if self.on else past

    def at_stage(self, X: FloatArray, at: AtPoints) -> FloatArray:
        """Where the obstacle sees points at the stage, see `place` and `ends`."""
        if self._pose.last is None or not self.on:
            return self._pose.seen(X + at(self._past()))
        (first, last), old = self.ends(X, at), float(self.old.value)
        return (1 - old) * last + old * first

    def pressures(self, first: FloatArray, last: FloatArray, least: FloatArray) -> FloatArray:
        """Pressures of the step [Pa].

        Args:
            first: Trial pressures at its start [Pa].
            last: Trial pressures at the end of the step [Pa].
            least: Trial pressures from which on points are in contact [Pa].
        """
        if not self.on:
            return np.where(last >= least, last, 0.0)
        old, (q0, q1) = float(self.old.value), (np.where(a >= least, a, 0.0) for a in (first, last))
        both = (first >= least) & (last >= least)
        size = np.maximum(np.abs(first) + np.abs(last), TINY)
        part = np.where(both, 1.0, (q0 + q1) / size)
        return np.asarray(part * ((1 - old) * q1 + old * q0))

    def softening(self, first: FloatArray, last: FloatArray, least: FloatArray) -> FloatArray:
        """Derivative of these pressures by the trial pressure at the stage."""
        closed: list[BoolArray] = [np.asarray(a >= least) for a in (first, last)]
        if not self.on:
            return closed[1].astype(float)
        size = np.maximum(np.abs(first) + np.abs(last), TINY)
        hits, leaves = 1 - (first / size) ** 2, self.ahead * (first / size) ** 2
        mixed = np.where(closed[1], hits, np.where(closed[0], leaves, 0.0))
        return np.where(closed[0] & closed[1], 1.0, mixed)

    def mean_normals(
        self, gaps: tuple[FloatArray, FloatArray], way: FloatArray, normals: FloatArray
    ) -> FloatArray:
        """See `mean_normal`; the last axis is that of components."""
        square = np.sum(way * way, axis=-1)
        missing = gaps[1] - gaps[0] - np.sum(normals * way, axis=-1)
        factor = np.where(square > self.short, missing / np.maximum(square, self.short), 0.0)
        return np.asarray(normals + factor[..., None] * way)


class InSteps(Term):
    """A term of a moving obstacle whose forces are those of a `ContactStep`.

    Attributes:
        pose: Of the obstacle.
        step: Over which forces are taken, see the module.
    """

    in_steps = True
    pose: Pose
    step: ContactStep
    _begun: FloatArray

    def begin_step(self) -> None:
        """See `Term`."""
        self.step.begin()
        self._begun = self.pose.now

    def enter_stage(self, step: StepWeights, pose: FloatArray | None) -> None:
        """See `Term`; as the body at the stage, the obstacle is at the mean of both ends."""
        old = step.alpha_f
        self.step.enter(old if self.in_steps else 0.0)
        if pose is not None:
            self.pose.shift.value[:] = ((1 - old) * pose + old * self._begun)[:, 0]
            if self.step.on:
                self.pose.enter(self._begun, pose)

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        self.step.leave()
        self.pose.enter(self.pose.now, self.pose.now)


def pressure_of_step(step: ContactStep, first: Expr, last: Expr, least: Expr) -> Expr:
    """See `ContactStep.pressures`, in UFL."""
    closed = [ufl.ge(a, least) for a in (first, last)]
    q0, q1 = (ufl.conditional(now, a, 0.0) for now, a in zip(closed, (first, last), strict=True))
    size = ufl.max_value(abs(first) + abs(last), TINY)
    part = ufl.conditional(ufl.And(*closed), 1.0, (q0 + q1) / size)
    return part * ((1 - step.old) * q1 + step.old * q0)
