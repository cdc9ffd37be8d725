"""Which triangles share corners and edges, and which way round they go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

_CROWD = 100
"""Points that are one with each, on average, at most."""


class CrowdedError(ValueError):
    """So many corners coincide that the surface has no shape."""


def weld(
    points: FloatArray, triangles: IntArray, distance: float, solids: IntArray | None = None
) -> tuple[FloatArray, IntArray]:
    """Makes one of corners that are near each other, and leaves unused ones out. Local.

    Corners are grouped by a graph of pairs, so that no border of a grid divides them.

    Args:
        points: Shape (n, 3).
        triangles: Rows of these, shape (m, 3).
        distance: Up to which corners are near; 0: those that are equal.
        solids: Number of a solid for each triangle; corners of different solids stay apart.

    Raises:
        CrowdedError: So many coincide that nothing is left of the shape.
    """
    used, rows = np.unique(triangles, return_inverse=True)
    points, rows = points[used], rows.reshape(-1)
    if solids is not None and len(solids) and (solids != solids[0]).any():
        far = 10 * np.ptp(points, axis=0).max() + 1
        keys = rows * (int(solids.max()) + 1) + np.repeat(solids, 3)
        found, rows = np.unique(keys, return_inverse=True)
        own, solid = np.divmod(found, int(solids.max()) + 1)
        points = np.column_stack([points[own], far * solid])
    order = np.lexsort(points.T[::-1])
    sorted_points = points[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (sorted_points[1:] != sorted_points[:-1]).any(axis=1)
    label = np.empty(len(order), dtype=np.int64)
    label[order] = np.cumsum(new) - 1
    points, rows = sorted_points[new], label[rows.reshape(-1)]
    if distance > 0:
        first, near = _near(points, distance)
        points, rows = points[first], near[rows]
    return np.ascontiguousarray(points[:, :3]), rows.reshape(-1, 3)


def _near(points: FloatArray, distance: float) -> tuple[IntArray, IntArray]:
    """The first point of each group, and the group of each point."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    tree, n = cKDTree(points), len(points)
    if tree.count_neighbors(tree, distance) > _CROWD * n:
        raise CrowdedError
    pairs = tree.query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    first = np.full(count, n)
    np.minimum.at(first, label, np.arange(n))
    return first, label.astype(np.int64)


@dataclass(frozen=True)
class Edges:
    """Edges of triangles.  Side 3 t + i of triangle t goes from its corner i to the next.

    Attributes:
        starts, ends: Corners of each side, shape (3 m,).
        first: A side of each edge; those of an edge are `order[begin[e]:begin[e] + count[e]]`.
        begin, count: See there.
        order: Sides, sorted by edges.
    """

    starts: IntArray
    ends: IntArray
    order: IntArray
    begin: IntArray
    count: IntArray

    @staticmethod
    def of(triangles: IntArray) -> Edges:
        """Those of triangles, shape (m, 3)."""
        starts, ends = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
        size = int(triangles.max(initial=0)) + 1
        keys = np.minimum(starts, ends) * size + np.maximum(starts, ends)
        order = np.argsort(keys, kind="stable")
        begin, count = np.unique(keys[order], return_index=True, return_counts=True)[1:]
        return Edges(starts, ends, order, begin, count)

    @property
    def open(self) -> IntArray:
        """Sides of edges with one triangle."""
        return self.order[self.begin[self.count == 1]]

    @property
    def crowded(self) -> IntArray:
        """The first side of each edge with more than two triangles."""
        return self.order[self.begin[self.count > 2]]

    @property
    def pairs(self) -> IntArray:
        """Both sides of each edge with two triangles, shape (e, 2)."""
        first = self.begin[self.count == 2]
        return np.stack([self.order[first], self.order[first + 1]], axis=1)

    @property
    def is_closed(self) -> bool:
        """Two triangles meet in each edge."""
        return bool((self.count == 2).all())


class OneSidedError(ValueError):
    """A surface has one side only, as a Moebius strip; `triangle` is on it."""

    def __init__(self, triangle: int) -> None:
        super().__init__()
        self.triangle = triangle


def oriented(edges: Edges) -> tuple[IntArray, BoolArray]:
    """Shells, and which triangles go against the first of their shell. Local.

    A triangle and the same one turned round are two nodes of a graph, of which those are joined
    that go the same way round: a surface that has two sides falls into two parts.

    Returns:
        Number of the shell of each triangle, and whether it is to be turned round, shape (m,).

    Raises:
        OneSidedError: A shell has one side.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    m = len(edges.starts) // 3
    pairs = edges.pairs
    a, b = (pairs // 3).T
    turn = np.where(edges.starts[pairs[:, 0]] != edges.starts[pairs[:, 1]], 0, m)
    i, j = np.concatenate([a, a + m]), np.concatenate([b + turn, (b + m + turn) % (2 * m)])
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(2 * m, 2 * m))
    label = connected_components(graph, directed=False)[1]
    if len(bad := np.flatnonzero(label[:m] == label[m:])):
        raise OneSidedError(int(bad[0]))
    pair = np.stack([label[:m], label[m:]])
    shell = np.unique(pair.min(axis=0), return_inverse=True)[1].reshape(-1)
    return shell.astype(np.int64), np.asarray(pair[0] > pair[1])


def signed_volumes(corners: FloatArray) -> FloatArray:
    """Volumes between triangles and the middle of their corners, shape (m,).

    Args:
        corners: Shape (m, 3, 3).
    """
    a, b, c = np.moveaxis(corners - corners.reshape(-1, 3).mean(axis=0), 1, 0)
    return np.asarray(np.einsum("ni,ni->n", a, np.cross(b, c)) / 6)


def volumes(corners: FloatArray, shell: IntArray, count: int) -> FloatArray:
    """Volume that each shell encloses, negative where its triangles face inwards, shape (count,).

    Args:
        corners: Shape (m, 3, 3).
        shell: Of each triangle.
    """
    each = np.bincount(shell, signed_volumes(corners), minlength=count)
    return np.asarray(each, dtype=np.float64)


def heights(corners: FloatArray) -> FloatArray:
    """The least height of each triangle over its longest edge, shape (m,)."""
    edges = np.roll(corners, -1, axis=1) - corners
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = (edges**2).sum(axis=2).max(axis=1)
    return np.asarray(area / np.where(longest > 0, longest, 1))
