"""Triangles of rigid obstacles, as large as the body beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.shapes.triangles import whole
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.results.scene.scene import Scene


class Reach:
    """The box around a body in all states so far: a floor is drawn below all of its ways."""

    def __init__(self) -> None:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def take(self, points: FloatArray) -> None:
        """Takes up a state.

        Args:
            points: Of the body [m], shape (n, 3).
        """
        self.low = np.minimum(self.low, points.min(axis=0))
        self.high = np.maximum(self.high, points.max(axis=0))


def obstacle_scene(obstacles: Sequence[tuple[Shape, FloatArray]], reach: Reach, dim: int) -> Scene:
    """What a picture is told of obstacles: where they would be at rest, and their shifts.

    In a series all pictures show as much of them as the one with the longest reach.

    Args:
        obstacles: Each with its displacement [m], `dim` components.
    """
    points: list[FloatArray] = [np.zeros((0, 3))]
    shifts: list[FloatArray] = [np.zeros((0, 3))]
    triangles: list[IntArray] = [np.zeros((0, 3), dtype=np.int64)]
    for obstacle, shift in obstacles:
        x, found = obstacle.drawn(Box(reach.low, reach.high), dim)
        triangles.append(found + sum(map(len, points)))
        points.append(x)
        shifts.append(np.tile(whole(shift), (len(x), 1)))
    return {
        "obstacle_points": np.concatenate(points),
        "obstacle_triangles": np.concatenate(triangles),
        "obstacle_shift": np.concatenate(shifts),
    }
