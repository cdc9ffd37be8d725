"""Triangles of shapes to be drawn, counter-clockwise seen from outside."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray

ROUND = 48
"""Corners of a circle."""
WIDE = 0.5
"""Half the side of a drawn plane, or length of a cylinder, over the diagonal of the body beside."""

Triangles = tuple[FloatArray, IntArray]
"""Points [m], shape (n, 3), and triangles."""


def whole(vector: Iterable[float]) -> FloatArray:
    """Three components."""
    return np.array([*vector, 0.0, 0.0][:3], dtype=np.float64)


def across(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors at right angles to an axis and to each other."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    a = np.cross(axis, other)
    a /= np.linalg.norm(a)
    return np.asarray(a, dtype=np.float64), np.asarray(np.cross(axis, a), dtype=np.float64)


def revolved(
    middle: FloatArray, axis: FloatArray, along: FloatArray, radii: FloatArray
) -> Triangles:
    """A surface of revolution, of circles one after the other along its axis.

    Args:
        axis: Unit vector along it.
        along: Position of each circle from there [m], shape (m,).
        radii: Their radii [m], shape (m,).
    """
    a, b = across(axis)
    turn = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)[:, None]
    circle, m, n = np.cos(turn) * a + np.sin(turn) * b, len(radii), ROUND
    rings = middle + along[:, None, None] * axis + radii[:, None, None] * circle
    i, j = (k.ravel() for k in np.meshgrid(np.arange(m - 1), np.arange(n), indexing="ij"))
    here, beside = i * n + j, i * n + (j + 1) % n
    lower = np.stack([here, beside, beside + n], axis=1)
    triangles = np.vstack([lower, np.stack([here, beside + n, here + n], axis=1)])
    # A circle without radius is one point, else edges of triangles without area look sharp.
    point = np.arange(m * n).reshape(m, n)
    axial = radii <= 1e-9 * np.max(radii)
    point[axial] = point[axial][:, :1]
    corners = point.ravel()[triangles]
    flat = (corners == np.roll(corners, 1, axis=1)).any(axis=1)
    return rings.reshape(-1, 3), corners[~flat]


def block(dim: int) -> Triangles:
    """A box, in a plane a rectangle, between (-1, -1, -1) and (1, 1, 1), shape (n, dim)."""
    flat = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    if dim == 2:
        return flat, _halves([[0, 1, 2, 3]])
    points = np.vstack([np.column_stack([flat, np.full(4, z)]) for z in (-1.0, 1.0)])
    faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    return points, _halves(faces)


def _halves(quadrilaterals: list[list[int]]) -> IntArray:
    corners = np.array(quadrilaterals)
    return np.vstack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
