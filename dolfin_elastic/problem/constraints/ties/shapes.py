"""Shape functions of facets at barycentric coordinates, for all of many facets at once."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray

_MIDDLE = {2: [(0, 1)], 3: [(1, 2), (0, 2), (0, 1)]}
"""Ends of the edges of midside nodes."""


def shape_functions(where: FloatArray, nodes: int) -> FloatArray:
    """Lagrange's functions of a facet.

    Args:
        where: Barycentric coordinates, shape (n, points, d).
        nodes: Of the facet: its vertices, or midside nodes, too.

    Returns:
        Shape (n, points, nodes).
    """
    d = where.shape[2]
    if nodes == d:
        return where
    edges = [4 * where[..., i] * where[..., j] for i, j in _MIDDLE[d]]
    return np.concatenate([where * (2 * where - 1), np.stack(edges, axis=-1)], axis=-1)


def shape_slopes(where: FloatArray, nodes: int) -> FloatArray:
    """Their derivatives by the coordinates but the first, which is 1 less the others.

    Args:
        where: See `shape_functions`.

    Returns:
        Shape (n, points, nodes, d - 1).
    """
    d = where.shape[2]
    along = np.vstack([-np.ones(d - 1), np.eye(d - 1)])
    if nodes == d:
        return np.broadcast_to(along, (*where.shape, d - 1))
    own = (4 * where[..., None] - 1) * along
    edges = [
        4 * (where[..., i, None] * along[j] + where[..., j, None] * along[i]) for i, j in _MIDDLE[d]
    ]
    return np.concatenate([own, np.stack(edges, axis=-2)], axis=-2)


def shape_bends(d: int, nodes: int) -> FloatArray:
    """Their second derivatives, which are constant, shape (nodes, d - 1, d - 1)."""
    along = np.vstack([-np.ones(d - 1), np.eye(d - 1)])
    products = along[:, None, :, None] * along[None, :, None, :]
    if nodes == d:
        return np.zeros((d, d - 1, d - 1))
    edges = [4 * (products[i, j] + products[j, i]) for i, j in _MIDDLE[d]]
    return np.concatenate([4 * products[range(d), range(d)], edges])
