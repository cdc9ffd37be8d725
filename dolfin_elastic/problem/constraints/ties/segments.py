"""Where facets of two surfaces lie opposite each other: common pieces and their quadrature points.

Facets are projected on the plane of the first one and cut by each other; the pieces are convex
polygons (in a plane intervals), on which polynomials of both sides are integrated exactly.  Curved
facets are cut into four flat ones (two in a plane) first; the corners of the second one are then
projected on the first curved one itself, along the normal of its flat part, so that the cut is
exact where both have the same shape.  Source: M. A. Puso, Int. J. Numer. Meth. Engng 59 (2004) 315,
section 4; M. A. Puso, T. A. Laursen & J. Solberg, Comput. Methods Appl. Mech. Engrg. 197 (2008)
555.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import basix
import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.problem.constraints.ties.facets import Facets
from dolfin_elastic.problem.constraints.ties.shapes import shape_functions, shape_slopes

DEGREE = 5
"""Of the quadrature: quadratic functions of both sides, times the radius of a ring."""

PARALLEL = 0.5
"""Cosine of the angle between two facets from which they may lie opposite."""

_UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Corners of a triangle in its own coordinates."""

THIN = 1e-12
"""Part of a facet's area below which a piece is round-off."""

ASIDE = 0.5
"""By how much of a flat part what is projected on a curved facet may lie beside its projection on
the flat part."""

NEWTON = 6
"""Iterations of that projection: they converge quadratically."""

FOUND = 1e-6
"""What of a flat part the last but one may be off."""

GAP = 0.1
"""Default of the largest distance that is tied, over the longer of the two facets."""


@dataclass(frozen=True)
class Segments:
    """Quadrature points of all pieces of a pair of surfaces.

    Attributes:
        near: Facet of the first surface, shape (pieces,).
        far: Facet of the second surface, shape (pieces,).
        pair: Of flat parts, which it is a piece of, shape (pieces,), not decreasing.
        near_coordinates: Barycentric coordinates in `near`, shape (pieces, points, d).
        far_coordinates: The same in `far`.
        weights: Areas [m^(d-1)], shape (pieces, points).
        shares: The same over the area of the reference facet, on which the coordinates are.
        gaps: Largest distance between the two at each piece [m].
        sizes: Of the longer facet of each piece [m].
        places: A point of each piece [m], shape (pieces, d).
    """

    near: IntArray
    far: IntArray
    pair: IntArray
    near_coordinates: FloatArray
    far_coordinates: FloatArray
    weights: FloatArray
    shares: FloatArray
    gaps: FloatArray
    sizes: FloatArray
    places: FloatArray

    def __getitem__(self, which: BoolArray | IntArray) -> Segments:
        return Segments(**{name: values[which] for name, values in vars(self).items()})


def joined(parts: Sequence[Segments]) -> Segments:
    """All pieces of several."""
    every = [vars(one) for one in parts]
    return Segments(**{name: np.concatenate([one[name] for one in every]) for name in every[0]})


@dataclass(frozen=True)
class _Flat:
    """Flat facets: corners [m], the facet that each is a part of, and the corners' places in it.

    `parts` such parts are one facet.
    """

    x: FloatArray
    parent: IntArray
    corners: FloatArray
    parts: int

    @property
    def size(self) -> FloatArray:
        """Longest side [m]."""
        sides = self.x - np.roll(self.x, 1, axis=1)
        return np.asarray(np.linalg.norm(sides, axis=2).max(axis=1))

    @property
    def areas(self) -> FloatArray:
        """Areas, in a plane lengths [m^(d-1)]."""
        return np.asarray(np.linalg.norm(self._vectors, axis=1)) / (self.x.shape[2] - 1)

    @property
    def normals(self) -> FloatArray:
        """Outward unit normals."""
        n = self._vectors
        return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))

    @property
    def _vectors(self) -> FloatArray:
        n: FloatArray
        if self.x.shape[2] == 2:
            t = self.x[:, 1] - self.x[:, 0]
            n = np.stack([t[:, 1], -t[:, 0]], axis=1)
        else:
            n = np.asarray(
                np.cross(self.x[:, 1] - self.x[:, 0], self.x[:, 2] - self.x[:, 0]), np.float64
            )
        return n


@dataclass(frozen=True)
class Pairs:
    """Flat parts of facets of two surfaces that may lie opposite each other.

    Attributes:
        a: Flat parts of `near`, the facets of the first surface.
        b: Flat parts of `far`, the facets of the second one.
        i: Which of the parts `a` is in each pair, shape (pairs,).
        j: Which of the parts `b`, shape (pairs,).
        y: Corners of the second part in coordinates of the first one, shape (pairs, d, d - 1).
        tolerance: Largest distance [m]; None: `GAP` of the facets' size.
    """

    near: Facets
    far: Facets
    a: _Flat
    b: _Flat
    i: IntArray
    j: IntArray
    y: FloatArray
    tolerance: float | None

    def __getitem__(self, which: BoolArray) -> Pairs:
        return replace(self, i=self.i[which], j=self.j[which], y=self.y[which])

    @property
    def near_facet(self) -> IntArray:
        """Facet of the first surface of each pair."""
        return self.a.parent[self.i]

    @property
    def far_facet(self) -> IntArray:
        """Facet of the second surface."""
        return self.b.parent[self.j]

    def pieces(self, y: FloatArray | None = None) -> Segments:
        """What the pairs have in common.

        Args:
            y: Other corners in place of those of the pairs, shape of these.
        """
        y = self.y if y is None else y
        of = _pieces_of_planes if self.near.x.shape[2] == 3 else _pieces_of_lines
        pieces = of(self.a, self.b, self.i, self.j, y)
        most = GAP * pieces.sizes if self.tolerance is None else self.tolerance
        return pieces[pieces.gaps <= most]

    def by_nodes(self, of_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of a number by the geometry nodes of both facets of each pair.

        With the place X(y) on the first facet, the sides t of its flat part and a corner b of the
        other one, y is where t . (X(y) - b) = 0.

        Args:
            of_y: The derivatives of the number by `y`, in the shape of that.

        Returns:
            Shapes (pairs, nodes, d).
        """
        whole, there = self.near.x[self.near_facet], self.far.x[self.far_facet]
        corners, flat = self.a.corners[self.i], self.a.x[self.i]
        nodes = whole.shape[1]
        at_corners = shape_functions(corners, nodes)
        at_others = shape_functions(self.b.corners[self.j], there.shape[1])
        t, b, sides = flat[:, 1:] - flat[:, :1], at_others @ there, corners[:, 1:] - corners[:, :1]
        where = corners[:, :1] + self.y @ sides
        N = shape_functions(where, nodes)
        slopes = sides[:, None, :, 1:] @ shape_slopes(where, nodes).swapaxes(2, 3)
        # Where nothing of the facet has that projection, y is in the plane of its part.
        lies = np.all(np.abs(_along(flat, N @ whole - b)) < FOUND, axis=2)[..., None]
        share = np.concatenate([1 - self.y.sum(axis=2, keepdims=True), self.y], axis=2)
        N = np.where(lies, N, share @ at_corners)
        plane = at_corners[:, 1:] - at_corners[:, :1]
        slopes = np.where(lies[..., None], slopes, plane[:, None])
        J = (slopes @ whole[:, None]) @ t[:, None].swapaxes(2, 3)
        turned = _solved(J, of_y)
        along, off = turned @ t, N @ whole - b
        of_sides = -turned.swapaxes(1, 2) @ off
        of_corners = np.concatenate([-of_sides.sum(axis=1, keepdims=True), of_sides], axis=1)
        of_near = at_corners.swapaxes(1, 2) @ of_corners - N.swapaxes(1, 2) @ along
        return of_near, at_others.swapaxes(1, 2) @ along


def cut(near: Facets, far: Facets, tolerance: float | None, *, facing: bool = False) -> Segments:
    """All pieces of facets that lie opposite each other. Local.

    Args:
        far: Facets of the second surface that may lie opposite.
        tolerance: Largest distance [m]; infinity: any; None: `GAP` of the facets' size.
        facing: Only of those whose outer sides see each other.
    """
    return pairs_of(near, far, tolerance, facing=facing).pieces()


def pairs_of(near: Facets, far: Facets, tolerance: float | None, *, facing: bool) -> Pairs:
    """What `cut` cuts. Local."""
    a, b = _flat(near), _flat(far)
    i, j = _candidates(a, b, tolerance, facing=facing)
    y = _along(a.x[i], b.x[j] - a.x[i, :1])
    sums = y.sum(axis=2)
    some = np.all((y.min(axis=1) < 1 + ASIDE) & (y.max(axis=1) > -ASIDE), axis=1)
    some &= (sums.min(axis=1) < 1 + ASIDE) & (sums.max(axis=1) > -ASIDE)
    i, j, y = i[some], j[some], y[some]
    if a.parts > 1:
        y = _on_curved(near.x[a.parent[i]], a.x[i], a.corners[i], y)
    return Pairs(near, far, a, b, i, j, y, tolerance)


def _along(flat: FloatArray, vectors: FloatArray) -> FloatArray:
    """Components of vectors along the sides from a facet's first corner, shape (n, k, d - 1).

    Args:
        flat: Corners, shape (n, d, d) [m].
        vectors: Shape (n, k, d) [m].
    """
    t = flat[:, 1:] - flat[:, :1]
    return _solved((t @ t.swapaxes(1, 2))[:, None], vectors @ t.swapaxes(1, 2))


@np.errstate(all="ignore")
def _on_curved(
    whole: FloatArray, flat: FloatArray, corners: FloatArray, onto: FloatArray
) -> FloatArray:
    """Coordinates in flat parts of the points of curved facets that have given projections on them.

    Far beside the facet there may be none: there the projections stay.

    Args:
        whole: Nodes of the curved facets, shape (n, nodes, d) [m].
        flat: Corners of their flat parts, shape (n, d, d) [m].
        corners: Barycentric coordinates of these, shape (n, d, d).
        onto: Coordinates of the projections but the first, shape (n, points, d - 1).
    """
    count, points, ways = len(flat), onto.shape[1], onto.shape[2]
    sides, y = corners[:, 1:] - corners[:, :1], onto.copy()
    for _ in range(NEWTON):
        where = corners[:, :1] + y @ sides
        there = shape_functions(where, whole.shape[1]) @ whole - flat[:, :1]
        off = onto - _along(flat, there)
        slopes = sides[:, None, :, 1:] @ shape_slopes(where, whole.shape[1]).swapaxes(2, 3)
        tangents = (slopes @ whole[:, None]).reshape(count, points * ways, flat.shape[2])
        J = _along(flat, tangents).reshape(count, points, ways, ways)
        y += _solved(J.swapaxes(2, 3), off)
    good = np.all((np.abs(off) < FOUND) & (np.abs(y - onto) < ASIDE), axis=2)
    return np.where(good[..., None], y, onto)


@np.errstate(all="ignore")
def _solved(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solutions of one or two equations, not finite where there is none, shape (..., 1 or 2)."""
    if b.shape[-1] == 1:
        return np.asarray(b / A[..., 0])
    (p, q), (r, s) = np.moveaxis(A, (-2, -1), (0, 1))
    first, second = s * b[..., 0] - q * b[..., 1], p * b[..., 1] - r * b[..., 0]
    return np.asarray(np.stack([first, second], axis=-1) / (p * s - q * r)[..., None])


def _flat(facets: Facets) -> _Flat:
    """The facets themselves where they have no midside nodes, else the parts between all nodes."""
    count, nodes, d = facets.x.shape
    own = np.eye(d)
    if nodes == d:
        return _Flat(facets.x, np.arange(count), np.broadcast_to(own, (count, d, d)), 1)
    if d == 2:
        middle = np.array([[0.5, 0.5]])
        parts = np.array([[0, 2], [2, 1]])
    else:
        middle = np.array([[0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]])
        parts = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]])
    coordinates = np.concatenate([own, middle])[parts]
    return _Flat(
        facets.x[:, parts].reshape(-1, d, d),
        np.repeat(np.arange(count), len(parts)),
        np.tile(coordinates, (count, 1, 1)),
        len(parts),
    )


def _candidates(
    a: _Flat, b: _Flat, tolerance: float | None, *, facing: bool
) -> tuple[IntArray, IntArray]:
    """Pairs of flat facets that are near and nearly parallel."""
    nothing = np.empty(0, dtype=np.int64)
    if not len(a.x) or not len(b.x):
        return nothing, nothing
    middles = a.x.mean(axis=1), b.x.mean(axis=1)
    sizes = a.size, b.size
    longest = float(sizes[1].max())
    reach = GAP * np.maximum(sizes[0], longest) if tolerance is None else tolerance
    reach = np.minimum(sizes[0] + longest + reach, 1e300)
    from scipy.spatial import cKDTree

    result = cKDTree(middles[1]).query_ball_point(middles[0], reach)
    i = np.repeat(np.arange(len(a.x)), [len(row) for row in result])
    j = np.concatenate([nothing, *map(np.asarray, result)]).astype(np.int64)
    cosines = -np.einsum("ni,ni->n", a.normals[i], b.normals[j])
    keep = (cosines if facing else np.abs(cosines)) > PARALLEL
    return i[keep], j[keep]


def _made(
    a: _Flat,
    b: _Flat,
    i: IntArray,
    j: IntArray,
    *,
    pair: IntArray,
    s: FloatArray,
    m: FloatArray,
    parts: FloatArray,
) -> Segments:
    """Pieces from barycentric coordinates in flat facets.

    Args:
        i: Facet in `a` of each pair.
        j: Facet in `b`.
        pair: Of each piece.
        s: Coordinates in `a`, shape (pieces, points, d).
        m: Coordinates in `b`.
        parts: Weights over the part of the first flat facet that each piece is.
    """
    i, j = i[pair], j[pair]
    x, y = (
        np.einsum("npk,nkc->npc", where, flat.x[k]) for where, flat, k in ((s, a, i), (m, b, j))
    )
    return Segments(
        near=a.parent[i],
        far=b.parent[j],
        pair=pair,
        near_coordinates=np.einsum("npk,nkc->npc", s, a.corners[i]),
        far_coordinates=np.einsum("npk,nkc->npc", m, b.corners[j]),
        weights=parts * a.areas[i, None],
        shares=parts / a.parts,
        gaps=np.linalg.norm(y - x, axis=2).max(axis=1, initial=0.0),
        sizes=np.maximum(a.size[i], b.size[j]),
        places=x[:, 0],
    )


def _pieces_of_lines(a: _Flat, b: _Flat, i: IntArray, j: IntArray, y: FloatArray) -> Segments:
    """Common intervals of edges of a plane body.

    Args:
        y: Ends of the other side's in coordinates of the first one's, shape (n, 2, 1).
    """
    low, high = np.maximum(y[:, :, 0].min(axis=1), 0.0), np.minimum(y[:, :, 0].max(axis=1), 1.0)
    pair = np.flatnonzero(high - low > THIN)
    low, high, ends = (v[pair] for v in (low, high, y[:, :, 0]))
    points, weights = basix.make_quadrature(basix.CellType.interval, DEGREE)
    at = low[:, None] + (high - low)[:, None] * points[:, 0]
    there = (at - ends[:, :1]) / (ends[:, 1:] - ends[:, :1])
    return _made(
        a,
        b,
        i,
        j,
        pair=pair,
        s=np.stack([1 - at, at], axis=2),
        m=np.stack([1 - there, there], axis=2),
        parts=(high - low)[:, None] * weights,
    )


def _pieces_of_planes(a: _Flat, b: _Flat, i: IntArray, j: IntArray, y: FloatArray) -> Segments:
    """Common polygons of triangles, cut into triangles from their first corner.

    Args:
        y: Corners of the other side's in coordinates of the first one's, shape (n, 3, 2).
    """
    polygon, count = _clipped(y, np.broadcast_to(_UNIT, y.shape))
    piece, corner = np.nonzero(np.arange(1, polygon.shape[1] - 1) < count[:, None] - 1)
    triangles = np.stack(
        [polygon[piece, 0], polygon[piece, corner + 1], polygon[piece, corner + 2]], axis=1
    )
    parts = 2 * np.abs(_area(triangles))
    keep = parts > THIN
    piece, triangles, parts = piece[keep], triangles[keep], parts[keep]
    points, weights = basix.make_quadrature(basix.CellType.triangle, DEGREE)
    inside = np.column_stack([1 - points.sum(axis=1), points])
    at = np.einsum("pk,nkc->npc", inside, triangles)
    return _made(
        a,
        b,
        i,
        j,
        pair=piece,
        s=np.concatenate([1 - at.sum(axis=2, keepdims=True), at], axis=2),
        m=_barycentric(y[piece], at),
        parts=2 * parts[:, None] * weights,
    )


def _area(triangles: FloatArray) -> FloatArray:
    """Signed areas."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def _barycentric(triangles: FloatArray, at: FloatArray) -> FloatArray:
    """Barycentric coordinates of points of the plane, shape (n, points, 3)."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    w = at - triangles[:, None, 0]
    twice = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])[:, None]
    second = (w[..., 0] * v[:, None, 1] - w[..., 1] * v[:, None, 0]) / twice
    third = (u[:, None, 0] * w[..., 1] - u[:, None, 1] * w[..., 0]) / twice
    return np.stack([1 - second - third, second, third], axis=2)


def _clipped(polygons: FloatArray, by: FloatArray) -> tuple[FloatArray, IntArray]:
    """Polygons cut by triangles, and their numbers of corners.

    Source: I. E. Sutherland & G. W. Hodgman, Commun. ACM 17 (1974) 32, for all pairs at once.

    Args:
        polygons: Triangles, shape (n, 3, 2).
    """
    rows = len(polygons)
    points, count = polygons, np.full(rows, 3)
    for k in range(3):
        start, side = by[:, k], by[:, (k + 1) % 3] - by[:, k]
        width = points.shape[1]
        column = np.arange(width)
        used = column < count[:, None]
        after = np.where(column + 1 < count[:, None], column + 1, 0)
        nextly = np.take_along_axis(points, after[..., None], axis=1)
        here, there = (
            side[:, None, 0] * (p[..., 1] - start[:, None, 1])
            - side[:, None, 1] * (p[..., 0] - start[:, None, 0])
            for p in (points, nextly)
        )
        crosses = used & ((here >= 0) != (there >= 0))
        share = np.divide(here, here - there, out=np.zeros_like(here), where=crosses)
        meets = points + share[..., None] * (nextly - points)
        taken = np.stack([used & (here >= 0), crosses], axis=2).reshape(rows, 2 * width)
        every = np.stack([points, meets], axis=2).reshape(rows, 2 * width, 2)
        order = np.argsort(~taken, axis=1, kind="stable")
        count = taken.sum(axis=1)
        widest = max(int(count.max(initial=0)), 3)
        points = np.take_along_axis(every, order[..., None], axis=1)[:, :widest]
    return points, count
