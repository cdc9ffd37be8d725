"""What an eye far away sees of triangles: a depth buffer in NumPy, with no graphics card.

Source: E. Catmull, A subdivision algorithm for computer display of curved surfaces, PhD thesis,
University of Utah (1974): of all that covers a pixel the nearest one is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

_AT_ONCE = 2_000_000
"""Pixels that are tried at once, which bounds the memory."""
_STEP = 3.0
"""Pixels of a piece of a line, which is seen or hidden as a whole."""


@dataclass(frozen=True)
class Window:
    """The part of the plane that is drawn, in pixels.

    Attributes:
        low: Its lower left corner, shape (2,).
        pixel: Side of a pixel.
        shape: Rows, counted from below, and columns.
    """

    low: FloatArray
    pixel: float
    shape: tuple[int, int]


@dataclass(frozen=True)
class Seen:
    """The triangle that is seen in each pixel.

    Attributes:
        window: The pixels.
        triangle: Number of the triangle, -1 where there is none, shape (rows, columns).
        depth: Towards the eye, -inf where there is no triangle, shape (rows, columns).
    """

    window: Window
    triangle: IntArray
    depth: FloatArray

    def weights(self, flat: FloatArray, triangles: IntArray) -> tuple[IntArray, FloatArray]:
        """The triangles of the pixels that have one, and the shares of their corners.

        Args:
            flat: Places of the nodes in the plane, shape (nodes, 2).
            triangles: As given to `look`, shape (triangles, 3).

        Returns:
            Shapes (pixels,) and (pixels, 3), row by row.
        """
        rows, columns = np.nonzero(self.triangle >= 0)
        which = self.triangle[rows, columns]
        x = self.window.low + self.window.pixel * (np.column_stack([columns, rows]) + 0.5)
        a, b, c = (flat[triangles[which, i]] for i in range(3))
        whole = _cross(b - a, c - a)
        shares = np.stack([_cross(b - x, c - x), _cross(c - x, a - x)], axis=1) / whole[:, None]
        return which, np.column_stack([shares, 1.0 - shares.sum(axis=1)])

    def pieces(
        self, ends: FloatArray, depth: FloatArray, tolerance: float
    ) -> tuple[FloatArray, BoolArray]:
        """Lines in short pieces, and which of these are not behind a triangle.

        A piece is seen where the surface lies no nearer to the eye in one of the nine pixels
        around: the surface beside a line is as deep there as the line itself.

        Args:
            ends: In the plane, shape (lines, 2, 2).
            depth: Of the ends, shape (lines, 2).
            tolerance: By how much the surface may be nearer.

        Returns:
            Shapes (pieces, 2, 2) and (pieces,).
        """
        long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / self.window.pixel
        count = np.maximum(np.ceil(long / _STEP), 1).astype(int)
        line = np.repeat(np.arange(len(ends)), count)
        first = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)

        def at(share: FloatArray) -> tuple[FloatArray, FloatArray]:
            t = share / count[line]
            x = (1 - t)[:, None] * ends[line, 0] + t[:, None] * ends[line, 1]
            return x, (1 - t) * depth[line, 0] + t * depth[line, 1]

        begin, _ = at(first.astype(float))
        end, _ = at(first + 1.0)
        middle, deep = at(first + 0.5)
        return np.stack([begin, end], axis=1), self.sees(middle, deep, tolerance)

    def sees(self, places: FloatArray, depth: FloatArray, tolerance: float) -> BoolArray:
        """Which points are not behind a triangle, see `pieces`.

        Args:
            places: In the plane, shape (points, 2).
            depth: Shape (points,).
            tolerance: By how much the surface may be nearer.

        Returns:
            Shape (points,).
        """
        rows, columns = self.window.shape
        at = np.floor((places - self.window.low) / self.window.pixel).astype(int)
        around = np.pad(self.depth, 2, constant_values=-np.inf)
        least = np.full(len(places), np.inf)
        row, column = np.clip(at[:, 1], -1, rows) + 2, np.clip(at[:, 0], -1, columns) + 2
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                least = np.minimum(least, around[row + i, column + j])
        return np.asarray(least <= depth + tolerance)


def look(flat: FloatArray, depth: FloatArray, triangles: IntArray, window: Window) -> Seen:
    """Finds the nearest triangle of each pixel.

    Args:
        flat: Places of the nodes in the plane, shape (nodes, 2).
        depth: Towards the eye, shape (nodes,).
        triangles: Shape (triangles, 3).
    """
    rows, columns = window.shape
    nearest = np.full(rows * columns, -np.inf)
    found = np.full(rows * columns, -1, dtype=np.int64)
    x = (flat - window.low) / window.pixel - 0.5  # centres of pixels are whole numbers
    corners, deep = x[triangles], depth[triangles]
    low = np.maximum(np.ceil(corners.min(axis=1)), 0).astype(int)
    high = np.minimum(np.floor(corners.max(axis=1)), [columns - 1, rows - 1]).astype(int)
    sides = high - low + 1
    turn = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    drawn = np.flatnonzero((sides > 0).all(axis=1) & (turn != 0))
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    safe = np.where(turn != 0, turn, 1.0)[:, None]
    slopes = np.stack([_turned(c - b), _turned(a - c)], axis=1) / safe[..., None]
    at_low = np.stack([_cross(b - low, c - low), _cross(c - low, a - low)], axis=1) / safe
    # Triangles of about the same size are tried together, on boxes of the largest.
    power = np.ceil(np.log2(np.maximum(sides[drawn], 1))).astype(int)
    for group in np.unique(power, axis=0):
        some = drawn[(power == group).all(axis=1)]
        most = sides[some].max(axis=0)
        box = np.stack(np.meshgrid(*map(np.arange, most), indexing="ij"), axis=-1).reshape(-1, 2)
        for part in np.array_split(some, max(1, len(some) * len(box) // _AT_ONCE)):
            # Shares of the corners a and b are linear in the place, those at `low` the first.
            u, v = (
                first[part, None] + slope[part] @ box.T
                for first, slope in ((at_low[:, 0], slopes[:, 0]), (at_low[:, 1], slopes[:, 1]))
            )
            row, k = np.nonzero((u >= 0) & (v >= 0) & (u + v <= 1))
            u, v, t = u[row, k], v[row, k], part[row]
            p = low[t] + box[k]
            kept = (p <= high[t]).all(axis=1)  # others are outside of the window
            u, v, t, p = u[kept], v[kept], t[kept], p[kept]
            z = u * deep[t, 0] + v * deep[t, 1] + (1 - u - v) * deep[t, 2]
            pixel = p[:, 1] * columns + p[:, 0]
            order = np.argsort(z, kind="stable")
            order = order[z[order] > nearest[pixel[order]]]
            # Of several that are given for one pixel the last one stays: the nearest.
            nearest[pixel[order]], found[pixel[order]] = z[order], t[order]
    return Seen(window, found.reshape(rows, columns), nearest.reshape(rows, columns))


def _turned(along: FloatArray) -> FloatArray:
    """Gradient of a share of a corner, times twice the area, from the side opposite of it."""
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
