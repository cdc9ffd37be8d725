"""Label images of bodies with known volumes."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import AnyArray, FloatArray

LENGTH = 20.0
"""Edge of the cube that is seen [mm]."""
_CENTRE = np.array([10.137, 9.863, 10.07])
"""Off the grid: a ball centred at a corner of voxels has 0.5 to 1.5 % too many of them."""


def middles(n: int) -> FloatArray:
    """Middles of n voxels along each axis, shape (n, n, n, 3)."""
    at = (np.arange(n) + 0.5) * LENGTH / n
    return np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1)


def affine(n: int) -> FloatArray:
    """From indices to places [mm]."""
    h = LENGTH / n
    result = np.diag([h, h, h, 1.0])
    result[:3, 3] = h / 2
    return result


def nested_balls(n: int) -> tuple[AnyArray, list[float]]:
    """A ball of radius 8 around one of 4: labels 1 and 2, and their volumes."""
    x = middles(n)
    outer = np.linalg.norm(x - _CENTRE, axis=-1) < 8
    inner = np.linalg.norm(x - _CENTRE - [1.0, 0.274, -0.207], axis=-1) < 4
    volumes = [4 / 3 * np.pi * (512 - 64), 4 / 3 * np.pi * 64]
    return np.where(inner, 2, outer).astype(np.int16), volumes


def cut_ball(n: int) -> tuple[AnyArray, list[float]]:
    """A ball of radius 8 that a plane between voxels divides: three surfaces meet in a circle."""
    x, plane = middles(n), 11.5
    ball = np.linalg.norm(x - _CENTRE, axis=-1) < 8
    high = plane - _CENTRE[0]
    cap = np.pi * (8 - high) ** 2 * (16 + high) / 3
    labels = np.where(ball, np.where(x[..., 0] < plane, 1, 2), 0).astype(np.int16)
    return labels, [4 / 3 * np.pi * 512 - cap, cap]


def shaft(n: int) -> tuple[AnyArray, list[float]]:
    """A shaft of radius 6.2 around one of 3, which leaves the image at both ends of x."""
    x = middles(n)
    r = np.linalg.norm(x[..., 1:] - _CENTRE[[0, 1]], axis=-1)
    volumes = [np.pi * (6.2**2 - 9) * LENGTH, np.pi * 9 * LENGTH]
    return np.where(r < 3, 2, r < 6.2).astype(np.int16), volumes
