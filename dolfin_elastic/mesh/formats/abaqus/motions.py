"""Rigid motions of nodes: instances of parts, and the rectangular systems of *SYSTEM."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.shapes.turn import rotation
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.formats.abaqus.cards import Card

_IN_PLANE = 1e-6
"""Sine up to which an axis lies in the global plane of X and Y."""


@dataclass(frozen=True)
class Motion:
    """Maps a point x to turn x + shift.

    Attributes:
        turn: Rotation matrix.
        shift: Image of the origin.
    """

    turn: FloatArray
    shift: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        """Images of points of shape (n, 3)."""
        return np.asarray(points @ self.turn.T + self.shift)


def displaced(card: Card) -> Motion:
    """A translation, and in a second line a rotation about the axis from a to b (*INSTANCE)."""
    rows = card.numbers(7) if card.lines else np.zeros((1, 7))
    if len(rows) > 2 or rows[0, 3:].any():
        raise card.error(
            "the motion is not understood",
            row=len(rows) - 1,
            expected="a line with a translation, and one with two points of an axis and an angle",
        )
    shift, turn = rows[0, :3], np.eye(3)
    if len(rows) == 2 and rows[1, 6]:
        a, b, angle = rows[1, :3], rows[1, 3:6], np.radians(rows[1, 6])
        length = np.linalg.norm(b - a)
        if not length > 0:
            raise card.error("the axis of the rotation has no length", row=1)
        turn = rotation(tuple(map(float, (b - a) / length)), float(angle))
        shift = turn @ (shift - a) + a
    return Motion(turn, shift)


def system(card: Card) -> Motion | None:
    """The system of a *SYSTEM: its origin, a point on its axis X, one in its plane XY.

    Without the third point the axis Z is the global one; without the second all axes are.
    """
    if not card.lines:
        return None
    rows = card.numbers(6)
    if len(rows) > 2:
        raise card.error("there are more than two lines", row=2)
    a, b = rows[0, :3], rows[0, 3:]
    if not any(word.strip() for word in card.lines[0].split(",")[3:]):
        return Motion(np.eye(3), a)
    x = b - a
    along = np.linalg.norm(x)
    plane = rows[1, :3] - a if len(rows) == 2 else np.cross([0.0, 0.0, 1.0], x)
    z = np.cross(x, plane)
    if not np.linalg.norm(z) > _IN_PLANE * along * np.linalg.norm(plane) or (
        len(rows) == 1 and abs(x[2]) > _IN_PLANE * along
    ):
        raise card.error(
            "the points span no plane",
            row=len(rows) - 1,
            expected="the origin, a point on the axis X, and in a second line one in the plane XY",
        )
    x, z = x / along, z / np.linalg.norm(z)
    return Motion(np.stack([x, np.cross(z, x), z], axis=1), a)
