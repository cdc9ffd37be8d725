"""The connected bodies of which the regions of a complex consist, and their volumes."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.surfaces.filling.plc import Plc
from dolfin_elastic.mesh.formats.surfaces.nesting import winding
from dolfin_elastic.mesh.formats.surfaces.topology import signed_volumes


def region_volumes(plc: Plc) -> FloatArray:
    """Volumes of the regions, shape (regions,)."""
    parts, count = signed_volumes(plc.points[plc.triangles]), len(plc.region_names)
    behind, in_front = (np.bincount(side + 1, parts, count + 1)[1:] for side in plc.regions.T)
    return np.asarray(behind - in_front)


def bodies_of(plc: Plc) -> tuple[IntArray, IntArray]:
    """The body behind and in front of each triangle, -1 for none, and the region of each body.

    The surface of a body consists of an outer shell and of those of its cavities.  Where a region
    touches itself in an edge, triangles belong to one shell that have the region between them.

    Returns:
        Shape (m, 2), and (bodies,).
    """
    result = np.full((len(plc.triangles), 2), -1)
    regions: list[int] = []
    parts = signed_volumes(plc.points[plc.triangles])
    for region in range(len(plc.region_names)):
        sides = [np.flatnonzero(plc.regions[:, side] == region) for side in (0, 1)]
        rows = np.concatenate(sides)
        if not len(rows):
            continue
        side = np.repeat([0, 1], [len(one) for one in sides])
        turned = plc.triangles[rows]
        turned[side == 1] = turned[side == 1][:, ::-1]
        shells = _shells(plc.points, turned)
        signed = np.where(side == 0, parts[rows], -parts[rows])
        volume = np.bincount(shells, signed).astype(np.float64)
        body = _nested(plc.points, turned, shells, volume)
        result[rows, side] = body[shells] + len(regions)
        regions += [region] * (int(body.max()) + 1)
    return result, np.array(regions, dtype=np.int64)


def _shells(points: FloatArray, triangles: IntArray) -> IntArray:
    """Number of the shell of each triangle, whose normals point out of one region, shape (n,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(triangles)
    ends = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    owner = np.repeat(np.arange(count), 3)
    forward = ends[:, 0] < ends[:, 1]
    keys = np.sort(ends, axis=1)
    key = keys[:, 0] * np.int64(len(points)) + keys[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    sizes = np.diff(starts, append=len(order))
    pair = starts[sizes == 2]
    links = [np.column_stack([owner[order[pair]], owner[order[pair + 1]]])]
    for start, size in zip(starts[sizes > 2], sizes[sizes > 2], strict=True):
        uses = order[start : start + size]
        links.append(_round_an_edge(points, triangles, keys[uses[0]], owner[uses], forward[uses]))
    a, b = np.concatenate(links).T
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _round_an_edge(
    points: FloatArray, triangles: IntArray, edge: IntArray, owner: IntArray, forward: BoolArray
) -> IntArray:
    """Pairs of triangles at an edge that have the region between them, shape (k, 2)."""
    along = points[edge[1]] - points[edge[0]]
    along /= np.linalg.norm(along)
    third = triangles[owner].sum(axis=1) - edge.sum()
    out = points[third] - points[edge[0]]
    out -= np.outer(out @ along, along)
    across = np.cross(along, out[0])
    angle = np.arctan2(out @ across / np.linalg.norm(out[0]), out @ out[0] / np.linalg.norm(out[0]))
    order = np.argsort(angle)
    owner, forward = owner[order], forward[order]
    # Of a triangle that runs along the edge, the region lies at smaller angles.
    previous = np.roll(np.arange(len(owner)), 1)
    rows = np.flatnonzero(forward & ~forward[previous])
    return np.column_stack([owner[previous[rows]], owner[rows]])


def _nested(
    points: FloatArray, triangles: IntArray, shells: IntArray, volume: FloatArray
) -> IntArray:
    """The body of each shell: an outer one, and those of cavities of the smallest around them."""
    result = np.full(len(volume), -1)
    outer = np.flatnonzero(volume > 0)
    result[outer] = np.arange(len(outer))
    if len(outer) == 1:
        result[:] = 0
        return result
    for shell in np.flatnonzero(volume <= 0):
        inside = points[triangles[np.argmax(shells == shell)]].mean(axis=0)
        for around in outer[np.argsort(volume[outer])]:
            if winding(points[triangles[shells == around]], inside[None])[0] > 0.5:
                result[shell] = result[around]
                break
    return result
