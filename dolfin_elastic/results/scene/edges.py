"""Lines that are drawn on a surface: sharp edges, borders of patches, silhouettes."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IntArray

SHARP = 35.0
"""Angle between triangles from which on the edge between them is sharp [degrees]."""
_SHORT, _JAGGED, _BEND = 0.6, 0.1, 40.0
"""Edges are chance, as rounded bodies have them, where connected ones are no longer than this share
of the body's diagonal, or the mean of their smooth pieces, with such bends [degrees] between."""
_BLUNT, _LEAST = 60.0, 0.1
"""No chance are edges at which the surface turns so much, and longer than this share."""


def sharp_edges(
    x: FloatArray,
    triangles: IntArray,
    patch: IntArray | None = None,
    known: BoolArray | None = None,
) -> IntArray:
    """Edges where a surface ends or turns, or a patch ends, but none of a rounded body.

    Args:
        x: Points [m], shape (n, 3), those that triangles share once.
        triangles: Shape (m, 3).
        patch: Number of each triangle's patch, shape (m,).
        known: Triangles of which the patches say all: between two of them nothing else is sharp.

    Returns:
        Pairs of points, shape (k, 2).
    """
    normals = _unit(_normals(x, triangles))
    pairs_of, owner = sides(triangles)
    same = (pairs_of[1:] == pairs_of[:-1]).all(axis=1)
    single = ~(np.append(same, False) | np.append(False, same))
    first = np.flatnonzero(same)
    a, b = owner[first], owner[first + 1]
    turns = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", normals[a], normals[b]), -1, 1)))
    border = np.zeros(len(first), dtype=bool) if patch is None else patch[a] != patch[b]
    sharp = (turns > SHARP) & ~border
    if known is not None:
        sharp &= ~(known[a] & known[b])
    pairs = np.concatenate([pairs_of[first[sharp]], pairs_of[single]])
    turns = np.concatenate([turns[sharp], np.full(single.sum(), 180.0)])
    kept = no_chance(x, pairs, turns, float(np.linalg.norm(np.ptp(x, axis=0))))
    return np.concatenate([pairs[kept], pairs_of[first[border]]])


def no_chance(x: FloatArray, pairs: IntArray, turns: FloatArray, size: float) -> BoolArray:
    """Which edges are no chance: those of coarse faces of a bend turn little, and often.

    Args:
        x: Points [m].
        pairs: Points of each edge, shape (k, 2).
        turns: By which the surface turns at each [degrees], shape (k,).
        size: Diagonal of the body [m].
    """
    ahead = x[pairs[:, 1]] - x[pairs[:, 0]]
    lengths = np.linalg.norm(ahead, axis=1)
    # At each point where two edges meet: are they one smooth line?
    points, of = pairs.ravel(), np.repeat(np.arange(len(pairs)), 2)
    outward = _unit(np.stack([ahead, -ahead], axis=1).reshape(-1, 3))
    order = np.argsort(points, kind="stable")
    _, start, count = np.unique(points[order], return_index=True, return_counts=True)
    one, other = order[start[count == 2]], order[start[count == 2] + 1]
    smooth = np.einsum("ij,ij->i", outward[one], outward[other]) < -np.cos(np.radians(_BEND))
    piece = _components(of[one[smooth]], of[other[smooth]], len(pairs))
    chain = _components(pairs[:, 0], pairs[:, 1], len(x))[pairs[:, 0]]
    whole = np.bincount(chain, lengths, minlength=1)
    piece_length = np.bincount(piece, lengths, minlength=1)[piece]

    def mean(values: AnyArray) -> FloatArray:
        return np.asarray(
            np.bincount(chain, lengths * values, minlength=1) / np.maximum(whole, 1e-300)
        )

    blunt = (mean(turns) >= _BLUNT) & (whole >= _LEAST * size)
    kept = blunt | ((whole >= _SHORT * size) & (mean(piece_length) >= _JAGGED * size))
    return np.asarray(kept[chain])


def silhouette(x: FloatArray, triangles: IntArray, back: FloatArray, least: float) -> IntArray:
    """Edges between triangles that are seen from in front and from behind.

    Where the surface is seen at a grazing angle, single flat faces turn away by chance; the short
    lines around them are left out.

    Args:
        least: Length of the shortest line [m].

    Returns:
        Pairs of points, shape (k, 2).
    """
    ahead = _normals(x, triangles) @ back > 0
    pairs_of, owner = sides(triangles)
    same = (pairs_of[1:] == pairs_of[:-1]).all(axis=1)
    pairs = pairs_of[1:][same & (ahead[owner[1:]] != ahead[owner[:-1]])]
    chain = _components(pairs[:, 0], pairs[:, 1], len(x))[pairs[:, 0]]
    lengths = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    return pairs[np.bincount(chain, lengths, minlength=1)[chain] >= least]


def _components(a: AnyArray, b: AnyArray, count: int) -> AnyArray:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    joints = coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
    return np.asarray(connected_components(joints, directed=False)[1])


def _normals(x: FloatArray, t: IntArray) -> FloatArray:
    """Normals of triangles, twice as long as their areas."""
    return np.asarray(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]))


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(float).tiny)[:, None])


def sides(t: IntArray) -> tuple[IntArray, IntArray]:
    """Sides of triangles as sorted pairs of points, equal ones in a row, and their triangles."""
    pairs = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    order = np.lexsort(pairs.T)
    return pairs[order], order % max(len(t), 1)
