"""`Pose`: where a rigid obstacle is, which moves and turns.

With its displacement d and its rotation R about a point c that moves with it, a point of the
obstacle that was at y is at

    x = c + d + R (y - c).

Laws of contact and friction are those of the place y that a point of the body has for the
obstacle: what sticks turns with it, and shapes stay as they were drawn.  Forces f of these laws act
as Q f, Q = R; in a step from R0 to R1 it is Q = (R0 + R1)/2.  With r = x - c - d, and means over
the step, then

    y1 - y0 = Q^T (r1 - r0) + (R1 - R0)^T r,
    f . (y1 - y0) = Q f . (x1 - x0 - w),    w = d1 - d0 + S r,    S = (R1 - R0) Q^-1,

exactly: what the forces do over the motion w of the obstacle is its work.  S is skew; for a step by
an angle a about an axis n, S r = 2 tan(a/2) n x r (A. Cayley 1846).

Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97 (slip is what moves past
the obstacle's points); O. Gonzalez, J. Nonlinear Sci. 6 (1996) 449 (the step).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.context import FormContext


class Pose:
    """Displacement and rotation of an obstacle.

    Args:
        centre: The point about which it turns [m]; None: it does not.

    Attributes:
        shift: Its displacement [m], in a step that of the stage.
        first: Its rotation where the step begins, outside of steps the present one; shape
            (dim, dim), None without a centre.
        last: The same where the step ends.
    """

    def __init__(self, context: FormContext, centre: Sequence[float] | None = None) -> None:
        self._dim = dim = context.body.dim
        self.shift: fem.Constant = context.constant([0.0] * dim)
        self.first = self.last = None
        if centre is not None:
            self._about = context.constant(centre)
            self.first, self.last = (context.constant(np.eye(dim)) for _ in range(2))

    # --- which it is ---

    @property
    def now(self) -> FloatArray:
        """A copy of displacement [m] and rotation, shape (dim, 1 + dim)."""
        turn = np.eye(self._dim) if self.last is None else self.last.value
        return np.column_stack([self.shift.value, turn])

    def put(self, pose: FloatArray) -> None:
        """Takes such a pose, of a state. Not collective."""
        self.shift.value[:] = pose[:, 0]
        self.enter(pose, pose)

    def enter(self, first: FloatArray, last: FloatArray) -> None:
        """Takes the rotations at both ends of a step. Not collective."""
        if self.first is not None and self.last is not None:
            self.first.value[:], self.last.value[:] = first[:, 1:], last[:, 1:]

    # --- places and directions ---

    def seen(self, past: FloatArray, turn: FloatArray | None = None) -> FloatArray:
        """Where the obstacle sees points, shape (..., dim) [m].

        Args:
            past: Their places less its displacement [m].
            turn: Its rotation; None: that of the end of the step.
        """
        if self.last is None:
            return past
        R, c = self.last.value if turn is None else turn, self._about.value
        return np.asarray(c + (past - c) @ R)

    def seen_in_form(self, past: Expr, *, at_start: bool = False) -> Expr:
        """See `seen`, in UFL; at an end of the step."""
        turn = self.first if at_start else self.last
        if turn is None:
            return past
        return self._about + ufl.dot(past - self._about, turn)

    @property
    def at_start(self) -> FloatArray | None:
        """The rotation where the step begins; None: it does not turn."""
        return None if self.first is None else self.first.value

    def to_obstacle(self, vectors: FloatArray) -> FloatArray:
        """Components for the obstacle of vectors in space, of a state."""
        return vectors if self.last is None else np.asarray(vectors @ self.last.value)

    def to_space(self, vectors: FloatArray) -> FloatArray:
        """Vectors in space of ones for the obstacle, by its rotation at the end."""
        return vectors if self.last is None else np.asarray(vectors @ self.last.value.T)

    def acting(self, forces: FloatArray) -> FloatArray:
        """Forces in space of ones for the obstacle, see the module."""
        if self.first is None or self.last is None:
            return forces
        return np.asarray(forces @ (self.first.value + self.last.value).T / 2)

    def acting_in_form(self, forces: Expr) -> Expr:
        """See `acting`, in UFL."""
        if self.first is None or self.last is None:
            return forces
        return ufl.dot(0.5 * (self.first + self.last), forces)

    def matrices_to_space(self, matrices: FloatArray) -> FloatArray:
        """Matrices in space of ones for the obstacle, (..., dim, dim), by its rotation at the end.

        See `pushes` for those whose rows are forces.
        """
        return self.to_space(np.swapaxes(self.to_space(np.swapaxes(matrices, -1, -2)), -1, -2))

    @property
    def pushes(self) -> FloatArray:
        """What turns forces by the rotation at the end into those of the step, (dim, dim)."""
        return self.acting(self.to_obstacle(np.eye(self._dim))).T

    def carried(self, before: FloatArray, x: FloatArray) -> FloatArray:
        """Motion w of the module from a former pose to the present one, shape (n, dim) [m].

        Args:
            before: See `now`.
            x: Places of points in the middle of their way [m], shape (n, dim).
        """
        change, mean = self.now - before, (self.now + before) / 2
        way = np.broadcast_to(change[:, 0], x.shape)
        if self.last is None:
            return way
        spin = change[:, 1:] @ np.linalg.inv(mean[:, 1:])
        return np.asarray(way + (x - self._about.value - mean[:, 0]) @ spin.T)
