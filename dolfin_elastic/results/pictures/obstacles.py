"""Triangles of rigid obstacles, as large as the body beside them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.model.contact import CylinderObstacle, Obstacle, Plane, SphereObstacle
from dolfin_elastic.results.pictures.scene import Scene

_ROUND, _WIDE, _DEEP = 48, 0.5, 0.04
"""Corners of a circle; half the side of a drawn plane, and the depth of a drawn line, over the
diagonal of the body."""

Triangles = tuple[FloatArray, IntArray]
"""Points [m], shape (n, 3), and triangles."""


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


def obstacle_triangles(
    obstacles: Iterable[tuple[Obstacle, FloatArray]], low: FloatArray, high: FloatArray, dim: int
) -> Triangles:
    """The surfaces of obstacles, counter-clockwise seen from their free side.

    Of planes and cylinders it is the part beside the body.

    Args:
        obstacles: Each with its displacement [m], `dim` components.
        low: Smallest coordinates of the body [m], shape (3,).
        high: Largest coordinates.
        dim: Of the body; in a plane the obstacles are those parts of it that they fill.
    """
    points: list[FloatArray] = [np.zeros((0, 3))]
    triangles: list[IntArray] = [np.zeros((0, 3), dtype=np.int64)]
    count = 0
    for obstacle, shift in obstacles:
        size, middle = float(np.linalg.norm(high - low)), (low + high) / 2
        moved = np.zeros(3)
        moved[: len(shift)] = shift
        found = _triangles(obstacle, middle - moved, size, dim)
        inside = bool(getattr(obstacle, "inside", False))
        points.append(found[0] + moved)
        triangles.append((found[1][:, ::-1] if inside else found[1]) + count)
        count += len(found[0])
    return np.concatenate(points), np.concatenate(triangles)


def obstacle_scene(
    obstacles: Sequence[tuple[Obstacle, FloatArray]], reach: Reach, dim: int
) -> Scene:
    """What a picture is told of obstacles: where they would be at rest, and their shifts.

    In a series all pictures show as much of them as the one with the longest reach.

    Args:
        obstacles: Each with its displacement [m], `dim` components.
        reach: Of the body.
        dim: Of the body.
    """
    every: list[Triangles] = []
    shifts: list[AnyArray] = [np.zeros((0, 3))]
    for obstacle, shift in obstacles:
        found = obstacle_triangles([(obstacle, np.zeros(dim))], reach.low, reach.high, dim)
        every.append(found)
        shifts.append(np.tile(_whole(shift), (len(found[0]), 1)))
    starts = np.cumsum([0, *(len(points) for points, _ in every)])
    none = np.zeros((0, 3), dtype=np.int64)
    return {
        "obstacle_points": np.concatenate([np.zeros((0, 3)), *(points for points, _ in every)]),
        "obstacle_triangles": np.concatenate(
            [none, *(one[1] + start for one, start in zip(every, starts, strict=False))]
        ),
        "obstacle_shift": np.concatenate(shifts),
    }


def _triangles(obstacle: Obstacle, middle: FloatArray, size: float, dim: int) -> Triangles:
    if isinstance(obstacle, Plane):
        return _plane(obstacle, middle, size, dim)
    if isinstance(obstacle, SphereObstacle):
        centre = _whole(obstacle.center)
        return _disc(centre, obstacle.radius) if dim == 2 else _sphere(centre, obstacle.radius)
    assert isinstance(obstacle, CylinderObstacle)
    point = _whole(obstacle.point)
    if isinstance(obstacle.axis, str):
        axis = np.array([float(name == obstacle.axis) for name in "xyz"])
    else:
        axis = _whole(obstacle.axis) / float(np.linalg.norm(obstacle.axis))
    if dim == 2 and axis[2]:
        return _disc(point, obstacle.radius)
    return _tube(point + axis * float((middle - point) @ axis), axis, obstacle.radius, size)


def _whole(vector: Iterable[float]) -> FloatArray:
    """Three components."""
    found = np.zeros(3)
    numbers = list(vector)
    found[: len(numbers)] = numbers
    return found


def _plane(plane: Plane, middle: FloatArray, size: float, dim: int) -> Triangles:
    """A square, in a plane a strip along the line, at the place that is nearest to the body."""
    point, normal = (_whole(vector) for vector in plane.placed(dim))
    foot = middle - normal * float((middle - point) @ normal)
    if dim == 2:
        across, depth = np.cross(normal, [0.0, 0.0, 1.0]), -_DEEP * size * normal
        ends = [foot - _WIDE * size * across, foot + _WIDE * size * across]
        corners = [ends[0], ends[1], ends[1] + depth, ends[0] + depth]
    else:
        a, b = _across(normal)
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [foot + _WIDE * size * (p * a + q * b) for p, q in signs]
    return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])


def _across(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors at right angles to an axis and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    a = np.cross(axis, other)
    a /= np.linalg.norm(a)
    return np.asarray(a, dtype=np.float64), np.asarray(np.cross(axis, a), dtype=np.float64)


def _disc(centre: FloatArray, radius: float) -> Triangles:
    turn = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)
    rim = centre + radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    i = np.arange(_ROUND, dtype=np.int64)
    return np.vstack([rim, centre]), np.stack([i, (i + 1) % _ROUND, 0 * i + _ROUND], axis=1)


def _swept(rings: FloatArray) -> Triangles:
    """Triangles between neighbouring closed rings, shape (rings, points, 3)."""
    m, n = rings.shape[:2]
    i, j = (k.ravel() for k in np.meshgrid(np.arange(m - 1), np.arange(n), indexing="ij"))
    here, beside = i * n + j, i * n + (j + 1) % n
    lower = np.stack([here, beside, beside + n], axis=1)
    return rings.reshape(-1, 3), np.vstack([lower, np.stack([here, beside + n, here + n], axis=1)])


def _sphere(centre: FloatArray, radius: float) -> Triangles:
    fall = np.linspace(np.pi, 0, _ROUND // 2 + 1)[:, None]
    turn = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)[None]
    x, y = np.sin(fall) * np.cos(turn), np.sin(fall) * np.sin(turn)
    return _swept(centre + radius * np.stack([x, y, np.cos(fall) + 0 * turn], axis=2))


def _tube(middle: FloatArray, axis: FloatArray, radius: float, size: float) -> Triangles:
    a, b = _across(axis)
    turn = np.linspace(0, 2 * np.pi, _ROUND, endpoint=False)[:, None]
    ring = middle + radius * (np.cos(turn) * a + np.sin(turn) * b)
    return _swept(np.stack([ring - _WIDE * size * axis, ring + _WIDE * size * axis]))
