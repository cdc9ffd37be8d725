"""Polygons of files, cut to triangles."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

MOST_CORNERS = 5000
"""Of a polygon: the time to cut it grows with the square of their number."""


def cut(
    points: FloatArray, counts: IntArray, corners: IntArray, name: str
) -> tuple[IntArray, IntArray]:
    """Cuts polygons to triangles within their plane. Local.

    Args:
        points: Shape (n, 3).
        counts: Corners of each polygon.
        corners: Rows of `points`, of one polygon after the other.
        name: Of the file, for messages.

    Returns:
        Rows of `points`, shape (m, 3), and the polygon of each triangle, shape (m,); polygons of
        fewer than three corners have none.

    Raises:
        MeshError: A polygon has too many corners.
    """
    if (most := int(counts.max(initial=0))) > MOST_CORNERS:
        raise MeshError(
            f"it has a polygon of {most} corners, more than {MOST_CORNERS}",
            where=name,
            expected="triangles, as most programs can export them",
        )
    starts = np.cumsum(counts) - counts
    triangles: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    owners: list[IntArray] = [np.empty(0, dtype=np.int64)]
    three = np.flatnonzero(counts == 3)
    triangles.append(corners[starts[three][:, None] + np.arange(3)])
    owners.append(three)
    four = np.flatnonzero(counts == 4)
    if len(four):
        quads = corners[starts[four][:, None] + np.arange(4)]
        # A quadrilateral with a corner that points inwards is cut there.
        turned = np.where(_bent(points[quads])[:, None], np.roll(quads, -1, axis=1), quads)
        triangles.append(turned[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))
        owners.append(np.repeat(four, 2))
    for row in np.flatnonzero(counts > 4):
        polygon = corners[starts[row] : starts[row] + counts[row]]
        found = polygon[_ears(points[polygon])]
        triangles.append(found)
        owners.append(np.full(len(found), row))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _bent(corners: FloatArray) -> BoolArray:
    """Whether the diagonal from the first corner leaves a quadrilateral, shape (n, 4, 3)."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return np.asarray(np.einsum("ni,ni->n", np.cross(b - a, c - a), np.cross(c - a, d - a)) < 0)


def _ears(corners: FloatArray) -> IntArray:
    """Triangles of one polygon by clipping its ears, shape (n - 2, 3).

    Source: G. H. Meisters, Amer. Math. Monthly 82 (1975) 648.
    """
    centred = corners - corners.mean(axis=0)
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    flat = np.delete(centred, drop, axis=1) * (1, -1 if (normal[drop] < 0) ^ (drop == 1) else 1)
    left = list(range(len(corners)))
    result = []
    while len(left) > 3:
        at = next((k for k in range(len(left)) if _is_ear(flat, left, k)), 0)
        n = len(left)
        result.append((left[at - 1], left[at], left[(at + 1) % n]))
        del left[at]
    return np.array([*result, left], dtype=np.int64)


def _is_ear(flat: FloatArray, left: list[int], k: int) -> bool:
    a, b, c = flat[left[k - 1]], flat[left[k]], flat[left[(k + 1) % len(left)]]
    if _turn(a, b, c) <= 0:
        return False
    rest = flat[[i for j, i in enumerate(left) if j not in (k, (k - 1) % len(left))]]
    rest = rest[(rest != a).any(axis=1) & (rest != b).any(axis=1) & (rest != c).any(axis=1)]
    inside = np.ones(len(rest), dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        d, r = q - p, rest - p
        inside &= d[0] * r[:, 1] - d[1] * r[:, 0] >= 0
    return not inside.any()


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    d, e = b - a, c - a
    return float(d[0] * e[1] - d[1] * e[0])
