"""Triangles that cross, touch or cover each other without common corners."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

_LEAF = 4
_CHUNK = 100_000
"""Pairs that are looked at at once."""

_SLACK = 1e-9
"""Of the size of two triangles, up to which they touch."""


def crossings(points: FloatArray, triangles: IntArray, most: int = 1000) -> IntArray:
    """Pairs of triangles that cross, touch, or cover each other. Local.

    Those with a common corner cross where the edge of one opposite to it goes through the other;
    those with a common edge where one is folded onto the other.

    Args:
        points: Shape (n, 3).
        triangles: Shape (m, 3).
        most: Pairs after which the search ends.

    Returns:
        Rows of triangles, shape (k, 2).
    """
    corners = points[triangles]
    found: list[IntArray] = [np.empty((0, 2), dtype=np.int64)]
    number = 0
    for pairs in _near(corners):
        i, j = pairs.T
        common = (triangles[i][:, :, None] == triangles[j][:, None, :]).sum(axis=(1, 2))
        hit = np.zeros(len(pairs), dtype=bool)
        apart = common == 0
        hit[apart] = _meet(corners[i[apart]], corners[j[apart]])
        for some, test in ((common == 1, _corner), (common == 2, _folded)):
            if some.any():
                hit[some] = test(points, triangles[i[some]], triangles[j[some]])
        found.append(pairs[hit])
        number += int(hit.sum())
        if number >= most:
            break
    return np.concatenate(found)


def _near(corners: FloatArray) -> Iterator[IntArray]:
    """Pairs of triangles whose boxes touch, some at a time: a tree of boxes against itself."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = _SLACK * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    order = _curve((low + high) / 2)
    low, high = low[order] - slack, high[order] + slack
    levels = [(low, high)]
    while len(levels[-1][0]) > 1:
        begin = np.arange(0, len(levels[-1][0]), _LEAF)
        levels.append(
            (
                np.minimum.reduceat(levels[-1][0], begin),
                np.maximum.reduceat(levels[-1][1], begin),
            )
        )
    stack: list[tuple[int, IntArray]] = [(len(levels) - 1, np.zeros((1, 2), dtype=np.int64))]
    while stack:
        level, pairs = stack.pop()
        if len(pairs) > _CHUNK:
            half = len(pairs) // 2
            stack += [(level, pairs[:half]), (level, pairs[half:])]
            continue
        boxes = levels[level]
        a, b = pairs.T
        touch = ((boxes[0][a] <= boxes[1][b]) & (boxes[0][b] <= boxes[1][a])).all(axis=1)
        pairs = pairs[touch]
        if level == 0:
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            yield order[pairs]
        elif len(pairs):
            stack.append((level - 1, _below(pairs, len(levels[level - 1][0]))))


def _below(pairs: IntArray, count: int) -> IntArray:
    """Pairs of children of pairs of boxes, each once."""
    child = np.arange(_LEAF)
    a = pairs[:, :1, None] * _LEAF + child[None, :, None]
    b = pairs[:, 1:, None] * _LEAF + child[None, None, :]
    a, b = (np.broadcast_to(x, (len(pairs), _LEAF, _LEAF)).reshape(-1) for x in (a, b))
    return np.stack([a, b], axis=1)[(a < count) & (b < count) & (a <= b)]


def _curve(x: FloatArray) -> IntArray:
    """The order of points along a curve that fills their box (Morton)."""
    size = np.ptp(x, axis=0).max()
    grid = ((x - x.min(axis=0)) / (size or 1.0) * 1023).astype(np.int64)
    code = np.zeros(len(x), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((grid[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable").astype(np.int64)


def _planes(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals, zero for triangles without area, and offsets."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(size > 0, size, 1)
    return normal, np.einsum("ni,ni->n", normal, corners[:, 0])


def _meet(p: FloatArray, q: FloatArray) -> BoolArray:
    """Whether triangles without common corners have a common point."""
    size = np.maximum(np.ptp(p, axis=1).max(axis=1), np.ptp(q, axis=1).max(axis=1))
    slack = _SLACK * size
    (np_, dp), (nq, dq) = _planes(p), _planes(q)
    of_p = np.einsum("nki,ni->nk", p, nq) - dq[:, None]
    of_q = np.einsum("nki,ni->nk", q, np_) - dp[:, None]
    s = slack[:, None]
    apart = (of_p > s).all(axis=1) | (of_p < -s).all(axis=1)
    apart |= (of_q > s).all(axis=1) | (of_q < -s).all(axis=1)
    result = np.zeros(len(p), dtype=bool)
    left = np.flatnonzero(~apart)
    if not len(left):
        return result
    flat = (np.abs(of_p[left]) <= s[left]).all(axis=1)
    result[left[flat]] = _cover(p[left[flat]], q[left[flat]], np_[left[flat]], slack[left[flat]])
    deep = left[~flat]
    for one, other in ((p, q), (q, p)):
        for k in range(3):
            a, b = one[deep, k], one[deep, (k + 1) % 3]
            result[deep] |= through(a, b, other[deep], slack[deep])
    return result


def through(a: FloatArray, b: FloatArray, corners: FloatArray, slack: FloatArray) -> BoolArray:
    """Whether segments meet triangles; by a negative slack, only well within both."""
    normal, offset = _planes(corners)
    da, db = (np.einsum("ni,ni->n", normal, x) - offset for x in (a, b))
    crossing = ((da >= -slack) & (db <= slack)) | ((da <= slack) & (db >= -slack))
    crossing &= np.abs(da - db) > np.abs(slack) * 1e-3
    with np.errstate(all="ignore"):
        x = a + (da / (da - db))[:, None] * (b - a)
    for k in range(3):
        start, side = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        inward = np.cross(normal, side)
        length = np.linalg.norm(inward, axis=1)
        crossing &= np.einsum("ni,ni->n", inward, x - start) >= -slack * length
    return np.asarray(crossing)


def _cover(p: FloatArray, q: FloatArray, normal: FloatArray, slack: FloatArray) -> BoolArray:
    """Whether triangles in one plane overlap: no edge separates them."""
    result = np.ones(len(p), dtype=bool)
    for one, other in ((p, q), (q, p)):
        for k in range(3):
            start = one[:, k]
            across = np.cross(normal, one[:, (k + 1) % 3] - start)
            across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-300
            own = np.einsum("ni,ni->n", across, one[:, (k + 2) % 3] - start)
            sign = np.where(own < 0, -1.0, 1.0)
            far = np.einsum("nki,ni->nk", other - start[:, None], across) * sign[:, None]
            result &= ~(far < slack[:, None]).all(axis=1)
    return result


def _corner(points: FloatArray, s: IntArray, t: IntArray) -> BoolArray:
    """Whether triangles with one common corner cross at the edge opposite to it."""
    equal = s[:, :, None] == t[:, None, :]
    p = points[_from(s, equal.any(axis=2).argmax(axis=1))]
    q = points[_from(t, equal.any(axis=1).argmax(axis=1))]
    slack = -_SLACK * np.maximum(np.ptp(p, axis=1).max(axis=1), np.ptp(q, axis=1).max(axis=1))
    result = through(p[:, 1], p[:, 2], q, slack) | through(q[:, 1], q[:, 2], p, slack)
    return np.asarray(result)


def _from(t: IntArray, first: IntArray) -> IntArray:
    """Triangles that begin at the corner in a given column."""
    return np.take_along_axis(t, (first[:, None] + np.arange(3)) % 3, axis=1)


def _folded(points: FloatArray, s: IntArray, t: IntArray) -> BoolArray:
    """Whether triangles with a common edge lie on each other."""
    own = ~(s[:, :, None] == t[:, None, :]).any(axis=2)
    p = points[_from(s, own.argmax(axis=1))]
    q = points[np.take_along_axis(t, _apex(s, t)[:, None], axis=1)[:, 0]]
    edge = p[:, 2] - p[:, 1]
    length = (edge**2).sum(axis=1)[:, None]
    u, v = p[:, 0] - p[:, 1], q - p[:, 1]
    u = u - edge * np.einsum("ni,ni->n", u, edge)[:, None] / length
    v = v - edge * np.einsum("ni,ni->n", v, edge)[:, None] / length
    both = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    return np.asarray(np.einsum("ni,ni->n", u, v) > (1 - 1e-13) * both)


def _apex(s: IntArray, t: IntArray) -> IntArray:
    """Column of the corner of `t` that `s` does not have."""
    return np.asarray((~(t[:, :, None] == s[:, None, :]).any(axis=2)).argmax(axis=1))
