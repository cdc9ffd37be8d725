"""Triangles of rigid obstacles, as large as the body beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.shapes import Shape
from dolfin_elastic.core.shapes.triangles import whole
from dolfin_elastic.core.shapes.turned import Turned
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.scene.scene import OBSTACLE, Obstacle


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


def obstacles_beside(
    shapes: Sequence[tuple[str, Shape, FloatArray]], reach: Reach, dim: int, colour: str = OBSTACLE
) -> tuple[Obstacle, ...]:
    """Obstacles as large as the body has reached so far.

    Args:
        shapes: What stands beside each, its shape in metres and its displacement [m], `dim`
            components.
    """
    near = Box(reach.low, reach.high)
    return tuple(
        Obstacle(name, *shape.drawn(near, dim), whole(shift), colour, isinstance(shape, Turned))
        for name, shape, shift in shapes
    )
