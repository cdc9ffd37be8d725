"""`Patches`: curved triangles through corners of flat ones, of a smooth surface.

Each is quadratic, and tangential at its corners to planes across normals that are means of those
around: a Nagata patch.  Its edge from x0 to x1 = x0 + d is

    x(t) = x0 + t d - t (1 - t) c,    (d - c) . n0 = 0,    (d + c) . n1 = 0,

with the smallest such bow c, and with r = 1 - s - t the patch is the flat triangle less
r s c_0 + s t c_1 + t r c_2.  On a sphere of radius R edges of length a are off by a^4/(128 R^3) in
their middles, flat ones by a^2/(8 R).  Where the normals of neighbours are at an angle of more than
`SHARP` their edge is sharp: corners on it have a normal on either side, and c meets both.

Source: T. Nagata, Computer Aided Geometric Design 22 (2005) 327 (patches); N. Max, Journal of
Graphics Tools 4 (1999) no. 2, 1 (means of normals, exact on spheres); D. M. Neto, M. C. Oliveira,
L. F. Menezes & J. L. Alves, Computer-Aided Design 45 (2013) 639 (contact with such surfaces).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

SHARP = np.radians(30.0)
"""Angle between the normals of neighbours from which on the edge between them is sharp."""

_BENT = 0.2
"""Part of the largest singular value below which normals say nothing of a bow: those of the sides
of a sharp edge are at more than 2 arctan of this, 23 degrees."""

_ENDS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
"""Coordinates s and t of the corners."""


class Derivatives(NamedTuple):
    """Of n places on curves or patches by their coordinates, of which there are k.

    Attributes:
        first: Shape (n, k, 3) [m].
        second: Shape (n, k, k, 3) [m].
    """

    first: FloatArray
    second: FloatArray

    @property
    def normals(self) -> FloatArray:
        """Unit normals of patches, shape (n, 3)."""
        return _unit(np.asarray(np.cross(self.first[:, 0], self.first[:, 1]), dtype=np.float64))

    @property
    def directions(self) -> FloatArray:
        """Unit vectors along curves, shape (n, 3)."""
        return _unit(self.first[:, 0])

    def curvature(self, normals: FloatArray, distances: FloatArray) -> FloatArray:
        """Along them, of surfaces at distances [m] over these places, shape (n, 3, 3) [1/m].

        With tangents T, the metric A = T^T T and B = n . (second derivatives), the foot of x moves
        by (A - d B) du = T^T dx, so that the derivative of the normal is
        -T A^-1 B (A - d B)^-1 T^T.
        """
        T = self.first
        A, B = T @ T.swapaxes(1, 2), np.einsum("nabi,ni->nab", self.second, normals)
        inner = np.linalg.solve(A, B) @ np.linalg.inv(A - distances[:, None, None] * B)
        return np.asarray(-T.swapaxes(1, 2) @ inner @ T)


class Patches(NamedTuple):
    """Curved triangles.

    Attributes:
        corners: Shape (m, 3, 3) [m].
        bows: c of the edge that begins at each corner, shape (m, 3, 3) [m].
        sharp: Which features are, see triangles.c, shape (m, 7).
    """

    corners: FloatArray
    bows: FloatArray
    sharp: BoolArray

    @staticmethod
    def of(corners: FloatArray, triangles: IntArray) -> Patches:
        """Those through corners, shape (m, 3, 3) [m], of triangles, rows of points, (m, 3)."""
        sides = np.roll(corners, -1, axis=1) - corners
        face, halves = Derivatives(sides, sides).normals, np.arange(triangles.size)
        end = 3 * (halves // 3) + (halves + 1) % 3  # the corner at which the edge of each ends
        twin = _twins(triangles)
        cosine = np.einsum("ki,ki->k", face[twin // 3], face[halves // 3])
        sharp = (cosine < np.cos(SHARP)) | (twin == halves)

        n = _normals(sides, _joined(halves[~sharp], end, twin))
        d, beside = sides.reshape(-1, 3), (twin != halves)[:, None]
        # A neighbour has its edge the other way round.
        rows = [n, np.where(beside, n[end[twin]], n), n[end], np.where(beside, n[twin], n[end])]
        right = [
            np.einsum("ki,ki->k", row, way) for row, way in zip(rows, (d, d, -d, -d), strict=True)
        ]
        inverse = np.linalg.pinv(np.stack(rows, axis=1), rcond=_BENT)
        bows = np.einsum("kij,kj->ki", inverse, np.stack(right, axis=1)).reshape(corners.shape)
        at_points = np.zeros(int(triangles.max()) + 1, dtype=bool)
        at_points[triangles.ravel()[sharp]] = at_points[triangles.ravel()[end[sharp]]] = True
        none = np.zeros((len(triangles), 1), dtype=bool)
        every = np.hstack([none, sharp.reshape(-1, 3), at_points[triangles]])
        return Patches(corners, np.ascontiguousarray(bows.reshape(corners.shape)), every)

    def derivatives(self, which: IntArray, local: FloatArray) -> Derivatives:
        """At the coordinates s and t of some patches, shape (n, 2)."""
        (x, y, z), (a, b, c) = (np.moveaxis(one[which], 1, 0) for one in (self.corners, self.bows))
        s, t = local.T[..., None]
        r = 1 - s - t
        by_s = y - x - (r - s) * a - t * b + t * c
        by_t = z - x + s * a - s * b - (r - t) * c
        second = np.stack([2 * a, a - b + c, a - b + c, 2 * c], axis=1)
        return Derivatives(np.stack([by_s, by_t], axis=1), second.reshape(-1, 2, 2, 3))

    def of_edges(self, which: IntArray, edge: IntArray, local: FloatArray) -> Derivatives:
        """Along edges of some patches, by t; see `derivatives`."""
        along = _ENDS[(edge + 1) % 3] - _ENDS[edge]
        first = np.einsum("na,nai->ni", along, self.derivatives(which, local).first)
        return Derivatives(first[:, None], 2 * self.bows[which, edge][:, None, None])


def _unit(a: FloatArray) -> FloatArray:
    return np.asarray(a / np.linalg.norm(a, axis=-1)[..., None])


def edge_numbers(triangles: IntArray) -> IntArray:
    """A number for the edge that begins at each corner of triangles, alike for both sides, (m, 3).

    Args:
        triangles: Rows of points, shape (m, 3).
    """
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
    keys = ends[:, :, 0] * (int(triangles.max()) + 1) + ends[:, :, 1]
    return np.unique(keys, return_inverse=True)[1].reshape(-1, 3)


def _twins(triangles: IntArray) -> IntArray:
    """The same edge of the neighbour, for each edge of each triangle; on a border itself."""
    edge = edge_numbers(triangles).ravel()
    order, result = np.argsort(edge, kind="stable"), np.arange(triangles.size)
    pairs = np.flatnonzero(edge[order[1:]] == edge[order[:-1]])
    result[order[pairs]], result[order[pairs + 1]] = order[pairs + 1], order[pairs]
    return result


def _joined(smooth: IntArray, end: IntArray, twin: IntArray) -> IntArray:
    """A number for each corner of triangles, alike where these smooth edges join them."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    one = np.concatenate([smooth, end[smooth]])
    two = np.concatenate([end[twin[smooth]], twin[smooth]])
    graph = coo_array((np.ones(len(one)), (one, two)), shape=(len(end), len(end)))
    return np.asarray(connected_components(graph, directed=False)[1])


def _normals(sides: FloatArray, group: IntArray) -> FloatArray:
    """Unit normals of corners of triangles, those of a group alike, (n, 3); see the source."""
    into = -np.roll(sides, 1, axis=1)
    weights = 1 / (np.sum(sides**2, axis=2) * np.sum(into**2, axis=2))
    sums = np.zeros((int(group.max()) + 1, 3))
    np.add.at(sums, group, (np.cross(sides, into) * weights[..., None]).reshape(-1, 3))
    return _unit(sums)[group]
