"""`Surface`: signed distances from the surface of a rigid body that is made of triangles.

The distance is that from the nearest point of all triangles; it is positive on the side to which
the normal there points.  At edges and corners that is the sum of the normals of the triangles that
meet, weighted by their angles: the side is right then, which no other weights give.

A smooth surface has curved triangles, see `nagata`, of which the nearest points are those of the
curved ones.

Source: J. A. Baerentzen & H. Aanaes, IEEE Transactions on Visualization and Computer Graphics 11
(2005) 243.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dolfin_elastic.core.shapes.nagata import SHARP, Patches, edge_numbers
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

_EDGE = np.radians(10.0)
"""Angle between triangles from which on what lies between them may enter a face as an edge."""

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
    def on_face(self) -> BoolArray:
        """Where that is a face."""
        return np.asarray(self.feature % FEATURES == 0)


class Surface:
    """Triangles whose corners are counter-clockwise seen from outside.

    Args:
        points: Corners [m], shape (n, 3).
        triangles: Rows of `points`, at least one, none without area, shape (m, 3).
        loops: The compiled `CODE`.
        smooth: The surface is curved between these corners.

    Attributes:
        size: Diagonal of the box around it [m].
    """

    def __init__(
        self, points: FloatArray, triangles: IntArray, loops: CFunctions, *, smooth: bool = False
    ) -> None:
        self._corners = np.ascontiguousarray(points[triangles])
        self._triangles, self._loops = triangles, loops
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self._edges = np.roll(self._corners, -1, axis=1) - self._corners
        self._edges /= np.linalg.norm(self._edges, axis=2)[:, :, None]
        self._normals = self._pseudonormals()
        self._patches = Patches.of(self._corners, triangles) if smooth else None
        self._sharp: BoolArray = np.ones((len(triangles), FEATURES), dtype=bool)
        self._bows: FloatArray = np.zeros((0, 3, 3))
        if self._patches is not None:
            self._sharp, self._bows = self._patches.sharp, self._patches.bows
        order, boxes = _tree(self._corners, self._bows)
        self._tree = len(triangles), self._corners, len(order) // LEAF, boxes, order

    def _pseudonormals(self) -> FloatArray:
        """Unit normals of all features, see triangles.c, shape (m, 7, 3)."""
        e, triangles = self._edges, self._triangles
        face = np.cross(e[:, 0], e[:, 1])
        face /= np.linalg.norm(face, axis=1)[:, None]
        angle = np.arccos(np.clip(-np.einsum("mki,mki->mk", e, np.roll(e, 1, axis=1)), -1, 1))
        at_points = np.zeros((int(triangles.max()) + 1, 3))
        np.add.at(at_points, triangles, angle[:, :, None] * face[:, None])
        edge = edge_numbers(triangles)
        at_edges = np.zeros((int(edge.max()) + 1, 3))
        np.add.at(at_edges, edge, np.broadcast_to(face[:, None], e.shape))
        result = np.concatenate([face[:, None], at_edges[edge], at_points[triangles]], axis=1)
        length = np.linalg.norm(result, axis=2)[:, :, None]
        return np.where(length > 0, result / np.where(length > 0, length, 1.0), face[:, None])

    @property
    def smooth(self) -> bool:
        """The surface is curved between the corners."""
        return self._patches is not None

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

    def convex_edges(self, side: float) -> FloatArray:
        """Ends of the edges between triangles that are bent away from a side, (n, 2, 3) [m].

        Args:
            side: 1 that to which the normals point, -1 the other one.
        """
        edge = edge_numbers(self._triangles).ravel()
        order = np.argsort(edge, kind="stable")
        pairs = np.flatnonzero(edge[order][1:] == edge[order][:-1])
        (one, i), (two, j) = (np.divmod(order[pairs + k], 3) for k in (0, 1))
        normals, corners = self._normals[:, 0], self._corners
        bent = np.einsum("ni,ni->n", normals[one], normals[two]) < np.cos(_EDGE)
        across = corners[two, (j + 2) % 3] - corners[one, i]
        bent &= side * np.einsum("ni,ni->n", across, normals[one]) < 0
        return np.stack([corners[one, i], corners[one, (i + 1) % 3]], axis=1)[bent]

    def near(self, x: FloatArray) -> Near:
        """Distances and more at points, shape (n, 3). Not collective."""
        n = len(x)
        triangle, feature = np.zeros(n, np.int64), np.empty(n, np.int64)
        foot, local = np.full((n, 3), np.nan), np.empty((n, 2))
        bows = len(self._bows), self._bows
        self._loops.call("find_nearest", n, x, *self._tree, *bows, triangle, feature, foot, local)
        arm, normal = x - foot, self._normals[triangle, feature]
        length, bend = np.linalg.norm(arm, axis=1), self._sharp[triangle, feature] & (feature > 0)
        of_patches = None
        if self._patches is not None:
            of_patches = self._patches.derivatives(triangle, local)
            normal = np.where(bend[:, None], normal, of_patches.normals)
        side = np.where(np.einsum("ni,ni->n", arm, normal) < 0, -1.0, 1.0)
        distance, away = side * length, (feature > 0) & (length > _ROUND_OFF * self.size)
        normal[away] = (side[:, None] * arm)[away] / length[away, None]
        # Straight above an edge, which may be one within a plane, it is as above the face.
        bend &= away & (np.einsum("ni,ni->n", normal, self._normals[triangle, 0]) < 1 - _STRAIGHT)
        curvature: FloatArray = np.zeros((n, 3, 3))
        if of_patches is not None:
            curvature = of_patches.curvature(normal, distance)
        curvature[bend] = (np.eye(3) - _outer(normal[bend])) / distance[bend, None, None]
        on_edge = bend & (feature <= 3)
        if on_edge.any():
            this, edge, d = triangle[on_edge], feature[on_edge] - 1, distance[on_edge]
            along = self._edges[this, edge]
            if self._patches is not None:
                of_edges = self._patches.of_edges(this, edge, local[on_edge])
                curvature[on_edge] += of_edges.curvature(normal[on_edge], d)
                along = of_edges.directions
            curvature[on_edge] -= _outer(along) / d[:, None, None]
        return Near(distance, normal, curvature, foot, FEATURES * triangle + feature)


def _outer(a: FloatArray) -> FloatArray:
    """Products of vectors with themselves, (n, 3, 3)."""
    return np.asarray(a[:, :, None] * a[:, None])


class Followed:
    """Distances of points that move, whose normals jump a few times only.

    Where the nearest points of two features are alike, as in a valley of the surface, the normal
    jumps, and an equilibrium may lie just there, which Newton's method would pass for ever.  A
    point that comes back to the feature before the last one stays in the plane through both their
    planes, whose normal is between theirs, until all is forgotten: along where they meet it has
    the distance of both.  A point that has changed often otherwise stays in the plane of the last.
    Trials of a line search count as changes, too: points then stay a little sooner.  With iterates
    alone a block in a cup of facets takes 42 iterations of backtracking, else 32, and comes no
    nearer to what full steps, which have no trials, find.
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
        if self._surface.smooth:  # else the normal does not jump
            changed &= np.einsum("ni,ni->n", new.normal, last.normal) < np.cos(SHARP)
        often = changed & (self._turns >= _TURNS)
        # Between a face and an edge the normal does not jump.
        back = changed & (new.feature == before.feature) & new.on_face & last.on_face
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


def _tree(corners: FloatArray, bows: FloatArray) -> tuple[IntArray, FloatArray]:
    """The order of triangles in the leaves, and the boxes of all nodes, see triangles.c.

    Curved ones are within the control points of Bezier triangles: corners, and middles of the edges
    less c/2.
    """
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
    control = corners
    if len(bows):
        control = np.hstack([corners, (corners + np.roll(corners, -1, axis=1) - bows) / 2])
    low, high = control.min(axis=1)[order], control.max(axis=1)[order]
    for level in range(depth, -1, -1):
        n = 1 << level
        low, high = low.reshape(n, -1, 3).min(axis=1), high.reshape(n, -1, 3).max(axis=1)
        boxes[n - 1 : 2 * n - 1] = np.hstack([low, high])
    return order, boxes
