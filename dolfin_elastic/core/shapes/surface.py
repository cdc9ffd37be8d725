"""`Surface`: signed distances from the surface of a rigid body that is made of triangles.

The distance is that from the nearest point of all triangles; it is positive on the side to which
the normal there points.  At edges and corners that is the sum of the normals of the triangles that
meet, weighted by their angles: the side is right then, which no other weights give.

Source: J. A. Baerentzen & H. Aanaes, IEEE Transactions on Visualization and Computer Graphics 11
(2005) 243.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from dolfin_elastic.core.native.functions import CFunctions

LEAF = 4
"""Triangles in each leaf of the tree of boxes."""

FEATURES = 7
"""Of each triangle: its face, edges and corners."""

CODE = "triangles.c"
"""What `Surface` needs of `core.native`, with the macro `LEAF`."""

_ROUND_OFF = 1e-13
"""Distance over the size of the surface at which the direction from the nearest point is lost."""

_STRAIGHT = 1e-9
"""What the cosine of an angle is off 1 where the angle counts as none: 5e-5."""

_TURNS = 4
"""Changes of the nearest feature after which `Followed` stays with one."""


class Near(NamedTuple):
    """What is known at n points.

    Attributes:
        distance: Signed [m], shape (n,).
        normal: Its gradient, shape (n, 3).
        curvature: Its second derivatives [1/m], shape (n, 3, 3): 0 at faces, (1 - n n - t t)/d at
            edges of the direction t, and (1 - n n)/d at corners.
        foot: The nearest point [m], shape (n, 3).
        feature: A number of the face, edge or corner on which that is, shape (n,).
    """

    distance: FloatArray
    normal: FloatArray
    curvature: FloatArray
    foot: FloatArray
    feature: IntArray

    @property
    def bent(self) -> BoolArray:
        """Where the normal turns."""
        return np.asarray(self.curvature.any(axis=(1, 2)))


class Surface:
    """Triangles whose corners are counter-clockwise seen from outside.

    Args:
        points: Corners [m], shape (n, 3).
        triangles: Rows of `points`, at least one, none without area, shape (m, 3).
        loops: The compiled `CODE`.
    """

    def __init__(self, points: FloatArray, triangles: IntArray, loops: CFunctions) -> None:
        self._corners = np.ascontiguousarray(points[triangles])
        self._triangles, self._loops = triangles, loops
        self._size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self._edges = np.roll(self._corners, -1, axis=1) - self._corners
        self._edges /= np.linalg.norm(self._edges, axis=2)[:, :, None]
        self._normals = self._pseudonormals()
        order, boxes = _tree(self._corners)
        self._tree = len(triangles), self._corners, len(order) // LEAF, boxes, order

    def _pseudonormals(self) -> FloatArray:
        """Unit normals of all features, see triangles.c, shape (m, 7, 3)."""
        e, triangles = self._edges, self._triangles
        face = np.cross(e[:, 0], e[:, 1])
        face /= np.linalg.norm(face, axis=1)[:, None]
        angle = np.arccos(np.clip(-np.einsum("mki,mki->mk", e, np.roll(e, 1, axis=1)), -1, 1))
        at_points = np.zeros((int(triangles.max()) + 1, 3))
        np.add.at(at_points, triangles, angle[:, :, None] * face[:, None])
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        keys = ends[:, :, 0] * len(at_points) + ends[:, :, 1]
        edge = np.unique(keys, return_inverse=True)[1].reshape(-1, 3)
        at_edges = np.zeros((int(edge.max()) + 1, 3))
        np.add.at(at_edges, edge, np.broadcast_to(face[:, None], e.shape))
        result = np.concatenate([face[:, None], at_edges[edge], at_points[triangles]], axis=1)
        length = np.linalg.norm(result, axis=2)[:, :, None]
        return np.where(length > 0, result / np.where(length > 0, length, 1.0), face[:, None])

    @cached_property
    def thickness(self) -> float:
        """The smallest distance from the middle of a triangle straight through to the back [m]."""
        lengths = np.empty(len(self._corners))
        middles, inwards = self._corners.mean(axis=1), np.ascontiguousarray(-self._normals[:, 0])
        self._loops.call("find_backs", len(lengths), middles, inwards, *self._tree, lengths)
        return float(lengths.min())

    def coarseness(self, triangles: IntArray) -> float:
        """The longest edge of those of some triangles between which the surface is curved [m].

        0 where there are none: edges of more than half a right angle are edges of the body.
        """
        cosine = np.einsum("mi,mki->mk", self._normals[:, 0], self._normals[:, 1:4])
        curved = ((cosine < 1 - _STRAIGHT) & (cosine > np.cos(np.pi / 8))).any(axis=1)
        sides = np.roll(self._corners, -1, axis=1) - self._corners
        some = triangles[curved[triangles]]
        return float(np.max(np.linalg.norm(sides[some], axis=2), initial=0.0))

    def near(self, x: FloatArray) -> Near:
        """Distances and more at points, shape (n, 3). Not collective."""
        n = len(x)
        triangle, feature, foot = (
            np.zeros(n, np.int64),
            np.empty(n, np.int64),
            np.full((n, 3), np.nan),
        )
        self._loops.call("find_nearest", n, x, *self._tree, triangle, feature, foot)
        arm, normal = x - foot, self._normals[triangle, feature]
        length = np.linalg.norm(arm, axis=1)
        side = np.where(np.einsum("ni,ni->n", arm, normal) < 0, -1.0, 1.0)
        bend = (feature > 0) & (length > _ROUND_OFF * self._size)
        normal[bend] = (side[:, None] * arm)[bend] / length[bend, None]
        # Straight above an edge, which may be one within a plane, it is as above the face.
        bend &= np.einsum("ni,ni->n", normal, self._normals[triangle, 0]) < 1 - _STRAIGHT
        edge = np.zeros((n, 3))
        on_edge = bend & (feature <= 3)
        edge[on_edge] = self._edges[triangle[on_edge], feature[on_edge] - 1]
        distance = side * length
        outer = (a[:, :, None] * a[:, None] for a in (normal, edge))
        curvature = (np.eye(3) - sum(outer)) / np.where(bend, distance, np.inf)[:, None, None]
        return Near(distance, normal, curvature, foot, FEATURES * triangle + feature)


class Followed:
    """Distances of points that move, whose normals jump a few times only.

    Where the nearest points of two features are alike, as in a valley of the surface, the normal
    jumps, and an equilibrium may lie just there, which Newton's method would pass for ever.  A
    point that comes back to the feature before the last one stays in the plane through both their
    planes, whose normal is between theirs, until all is forgotten: along where they meet it has
    the distance of both.  A point that has changed often otherwise stays in the plane of the last.
    """

    def __init__(self, surface: Surface) -> None:
        self._surface = surface
        self._x: FloatArray = np.empty((0, 3))
        self._turns: IntArray | None = None
        self._stays: BoolArray = np.empty(0, dtype=bool)
        self._last = self._before = surface.near(self._x)

    def forget(self) -> None:
        """All points may change again."""
        if self._turns is not None and self._stays.any():
            self._x = np.empty((0, 3))
        self._turns = None

    def near(self, x: FloatArray) -> Near:
        """See `Surface.near`; the same points at each call, or others after `forget`."""
        known = np.array_equal(x, self._x)
        if self._turns is None:
            self._last = self._last if known else self._surface.near(x)
            self._before = self._last
            self._turns, self._stays = np.zeros(len(x), dtype=np.int64), np.zeros(len(x), bool)
        elif not known:
            self._move(x)
        self._x = x.copy()
        return self._last

    def _move(self, x: FloatArray) -> None:
        last, new, before = self._last, self._surface.near(x), self._before
        assert self._turns is not None
        changed = (new.feature != last.feature) & ~self._stays
        often = changed & (self._turns >= _TURNS)
        # Between a face and an edge the normal does not jump.
        back = changed & (new.feature == before.feature) & ~new.bent & ~last.bent
        self._turns += changed
        self._before = _chosen(changed, last, before)
        foot, normal = _between(last, new)
        still = (self._stays | (often & ~back))[:, None]
        foot, normal = np.where(still, last.foot, foot), np.where(still, last.normal, normal)
        self._stays |= often | back
        flat = np.einsum("ni,ni->n", x - foot, normal)
        plane = Near(flat, normal, np.zeros_like(new.curvature), foot, last.feature)
        self._last = _chosen(self._stays, plane, new)


def _chosen(which: BoolArray, one: Near, other: Near) -> Near:
    """Rows of one, elsewhere of another."""
    return Near._make(
        np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)
        for a, b in zip(one, other, strict=True)
    )


def _between(one: Near, two: Near) -> tuple[FloatArray, FloatArray]:
    """The plane through where two planes meet, by a point and the normal between theirs.

    Of planes that face each other the first.
    """
    arm, cosine = (one.foot - two.foot) / 2, np.einsum("ni,ni->n", one.normal, two.normal)
    a, b = np.einsum("ni,ni->n", arm, one.normal), -np.einsum("ni,ni->n", arm, two.normal)
    square = np.maximum(1 - cosine**2, _STRAIGHT)
    a, b = (a - cosine * b) / square, (b - cosine * a) / square
    middle = one.foot - arm + a[:, None] * one.normal + b[:, None] * two.normal
    faces = (cosine < -0.5)[:, None]
    normal = np.where(faces, one.normal, one.normal + two.normal)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.where(faces, one.foot, middle), normal


def _tree(corners: FloatArray) -> tuple[IntArray, FloatArray]:
    """The order of triangles in the leaves, and the boxes of all nodes, see triangles.c."""
    m = len(corners)
    depth = max(0, int(np.ceil(np.log2(m / LEAF))))
    order = np.minimum(np.arange(LEAF << depth), m - 1)  # the last one is repeated
    middles = corners.mean(axis=1)
    for level in range(depth):
        parts = order.reshape(1 << level, -1)
        x = middles[parts]
        along = np.argmax(np.ptp(x, axis=1), axis=1)
        x = np.take_along_axis(x, along[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(parts, np.argsort(x, axis=1, kind="stable"), axis=1).ravel()
    boxes = np.empty((2 * (1 << depth) - 1, 6))
    low, high = corners.min(axis=1)[order], corners.max(axis=1)[order]
    for level in range(depth, -1, -1):
        n = 1 << level
        low, high = low.reshape(n, -1, 3).min(axis=1), high.reshape(n, -1, 3).max(axis=1)
        boxes[n - 1 : 2 * n - 1] = np.hstack([low, high])
    return order, boxes
