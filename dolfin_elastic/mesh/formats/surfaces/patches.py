"""Patches of a surface, between its sharp edges."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.surfaces.topology import Edges

ANGLE = 40.0
"""Degrees between the normals of triangles, from which on their edge is sharp."""

MOST = 200
"""Patches that have names, the largest ones."""


def patches(
    points: FloatArray, triangles: IntArray, labels: IntArray, angle: float = ANGLE
) -> IntArray:
    """Number of the patch of each triangle, the largest first; of equals, from small x on. Local.

    Args:
        points: Shape (n, 3).
        triangles: Shape (m, 3).
        labels: A patch has triangles of one label only.
        angle: Between normals, from which on an edge is sharp [degrees].
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    normal /= np.where(area > 0, area, 1)[:, None]
    a, b = (Edges.of(triangles).pairs // 3).T
    smooth = np.einsum("ni,ni->n", normal[a], normal[b]) > np.cos(np.radians(angle))
    # A triangle almost without area has no direction of its own.
    smooth |= np.minimum(area[a], area[b]) <= 1e-9 * area.max(initial=0.0)
    smooth &= labels[a] == labels[b]
    m = len(triangles)
    graph = coo_array((np.ones(int(smooth.sum())), (a[smooth], b[smooth])), shape=(m, m))
    count, patch = connected_components(graph, directed=False)
    return _sorted(corners, area, patch.astype(np.int64), count)


def _sorted(corners: FloatArray, area: FloatArray, patch: IntArray, count: int) -> IntArray:
    size = np.bincount(patch, area, minlength=count)
    middle = (
        np.stack(
            [
                np.bincount(patch, area * corners[:, :, axis].mean(axis=1), minlength=count)
                for axis in range(3)
            ],
            axis=1,
        )
        / np.where(size > 0, size, 1)[:, None]
    )
    length = np.ptp(corners.reshape(-1, 3), axis=0).max() or 1.0
    # What is equal up to round-off is to be in the same order on all machines.
    rough = np.round(size / (size.max() or 1.0), 4)
    place = np.round(middle / length, 4)
    order = np.lexsort((place[:, 2], place[:, 1], place[:, 0], -rough))
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    return rank[patch]
