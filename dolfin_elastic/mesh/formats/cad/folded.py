"""Quadratic cells in Gmsh that fold: their middle nodes move, or their edges become straight."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray

_LEAST = 0.1
"""Smallest over largest determinant of the map of a curved cell; in straight ones it is 1."""
_LOADS = 2
"""Steps in which the boundary is curved."""
_POOR = 0.4
"""The same of cells whose nodes, and those of their neighbours, move: in a flange of six sizes no
more edges become straight then than if the whole body moves, and the worst cell is no thinner."""

EDGES = {
    1: [(0, 1, 2)],
    2: [(0, 1, 3), (1, 2, 4), (2, 0, 5)],
    3: [(0, 1, 4), (1, 2, 5), (2, 0, 6), (3, 0, 7), (3, 2, 8), (3, 1, 9)],
}
"""Ends and middle of the edges of Gmsh's quadratic line, triangle and tetrahedron."""
KINDS = {1: 8, 2: 9, 3: 11}
"""Their types."""


def nodes_of(gmsh: ModuleType, dim: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Tags, nodes of shape (n, k) and their places (n, k, 3) of the quadratic cells of a kind."""
    cells, nodes = gmsh.model.mesh.getElementsByType(KINDS[dim])
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    nodes = np.asarray(nodes).reshape(len(cells), -1)
    at = order[np.searchsorted(tags, nodes, sorter=order)]
    return np.asarray(cells), nodes, np.asarray(coordinates).reshape(-1, 3)[at]


def _folded(gmsh: ModuleType, dim: int) -> IntArray:
    """Positions of the cells whose map is singular, or almost, somewhere in them."""
    return np.flatnonzero(_shapes(gmsh, dim) < _LEAST)


def _shapes(gmsh: ModuleType, dim: int) -> FloatArray:
    """Smallest over largest determinant of the map of each cell; below 0 where it is folded."""
    tags = gmsh.model.mesh.getElementsByType(KINDS[dim])[0].tolist()
    low, high = (
        np.asarray(gmsh.model.mesh.getElementQualities(tags, name))
        for name in ("minDetJac", "maxDetJac")
    )
    # Cells that run the other way round have negative determinants throughout.
    side = np.sign(low + high)
    smallest, largest = np.minimum(low * side, high * side), np.maximum(np.abs(low), np.abs(high))
    return np.divide(smallest, largest, out=np.full(len(largest), np.inf), where=largest > 0.0)


def _lost(gmsh: ModuleType, dim: int, folded: IntArray) -> BoolArray:
    """Whether a cell folds at a corner whose edges all lie on curved faces, as on a smooth surface.

    There no node within the body, nor one that slides in a plane face, makes a difference.

    Args:
        folded: Positions of cells, shape (n,).
    """
    flat = "Plane" if dim == 3 else "Line"
    held = [
        gmsh.model.mesh.getNodes(*e)[0]
        for e in gmsh.model.getEntities()
        if e[0] < dim - 1 or (e[0] == dim - 1 and gmsh.model.getType(*e) != flat)
    ]
    _, nodes, x = (rows[folded] for rows in nodes_of(gmsh, dim))
    middle = {frozenset(ends): c for *ends, c in EDGES[dim]}
    others = [[b for b in range(dim + 1) if b != a] for a in range(dim + 1)]
    middles = [[middle[frozenset((a, b))] for b in others[a]] for a in range(dim + 1)]
    x, corners = x[..., :dim], x[:, : dim + 1, None, :dim]
    tangents = 4 * x[:, middles] - 3 * corners - x[:, others]
    side = np.sign(np.linalg.det(x[:, others] - corners))
    det: FloatArray = np.linalg.det(tangents) * side
    singular = det < _LEAST * np.abs(det).max(axis=1, keepdims=True)
    on_surface = np.isin(nodes, np.concatenate(held))[:, middles].all(axis=2)
    return np.asarray((singular & on_surface).any(axis=1))


def relax_folded(gmsh: ModuleType, dim: int) -> None:
    """Gives middle nodes inside the body, near folded cells, the places of an elastic equilibrium.

    Nothing moves where that can mend no cell.  The displacement is that from straight edges, in
    steps from one equilibrium to the next: given on curved faces, zero at the corners and outside
    of the patch.  All cells are equally stiff, whatever their size, so that small ones deform less
    (T. E. Tezduyar et al., ASME AMD-143 (1992) 7: without the Jacobian), and those about to fold.

    Args:
        dim: 2 or 3, of quadratic cells.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import spsolve

    shapes = _shapes(gmsh, dim)
    folded = np.flatnonzero(shapes < _LEAST)
    if not len(folded) or _lost(gmsh, dim, folded).all():
        return
    _, nodes, places = nodes_of(gmsh, dim)
    poor = nodes[shapes < _POOR]
    patch = np.flatnonzero(np.isin(nodes, poor).any(axis=1))
    tags, at = np.unique(nodes[patch], return_inverse=True)
    at = at.reshape(len(patch), -1)
    curved = np.zeros((len(tags), dim))
    curved[at] = places[patch, :, :dim]
    x, middle = curved.copy(), np.zeros(len(tags), dtype=bool)
    for a, b, c in EDGES[dim]:
        x[at[:, c]] = (curved[at[:, a]] + curved[at[:, b]]) / 2
        middle[at[:, c]] = True
    ways = _ways(gmsh, dim, tags)
    ways[~middle | np.isin(tags, np.delete(nodes, patch, axis=0))] = 0.0
    node, way = np.nonzero(ways.any(axis=2))
    if not len(node):
        return
    columns, dofs = np.arange(len(node))[:, None], dim * node[:, None] + np.arange(dim)
    T = csr_matrix(
        (ways[node, way].ravel(), (dofs.ravel(), np.repeat(columns, dim))), (x.size, len(node))
    )
    rows = (dim * at[:, :, None] + np.arange(dim)).reshape(len(at), -1)
    size = rows.shape[1]
    pairs = np.repeat(rows, size, axis=1).ravel(), np.tile(rows, (1, size)).ravel()
    moves: BoolArray = np.asarray(ways.any(axis=(1, 2)))
    rise = np.where(moves[:, None], 0.0, curved - x).ravel() / _LOADS
    for _ in range(_LOADS):
        K = csr_matrix((_stiffness(x[at]).ravel(), pairs), shape=2 * (x.size,))
        x = x + (rise - T @ spsolve((T.T @ K @ T).tocsc(), T.T @ (K @ rise))).reshape(x.shape)
    for tag, place in zip(tags[moves], x[moves], strict=True):
        gmsh.model.mesh.setNode(int(tag), [*place.tolist(), 0.0][:3], [])


def _ways(gmsh: ModuleType, dim: int, tags: IntArray) -> FloatArray:
    """Directions in which nodes may move, as rows; zero where there are less than `dim`.

    All within the body, those of the plane in a plane face (in 2D of the line), none elsewhere.

    Returns:
        Shape (nodes, dim, dim).
    """
    flat = "Plane" if dim == 3 else "Line"
    ways = np.tile(np.eye(dim), (len(tags), 1, 1))
    for entity in gmsh.model.getEntities():
        if entity[0] == dim:
            continue
        own = np.isin(tags, gmsh.model.mesh.getNodes(*entity)[0])
        ways[own] = 0.0
        if entity[0] == dim - 1 and gmsh.model.getType(*entity) == flat and own.any():
            x = gmsh.model.mesh.getNodes(*entity, True)[1].reshape(-1, 3)[:, :dim]
            ways[own, : dim - 1] = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][
                : dim - 1
            ]
    return ways


def _stiffness(x: FloatArray) -> FloatArray:
    """Stiffness of quadratic cells in units of their volume, Lame's constants both 1.

    Args:
        x: Places of the nodes in Gmsh's order, shape (n, k, dim).

    Returns:
        Shape (n, k dim, k dim).
    """
    n, nodes, dim = x.shape
    width, unit = dim + 1, np.eye(dim + 1)
    pairs: FloatArray = np.zeros((n, nodes * dim, nodes * dim))
    # Exact for quadratic functions; A. H. Stroud, Approximate Calculation of Multiple Integrals.
    low = (1 - 1 / np.sqrt(dim + 2)) / width
    for L in low + (1 - width * low) * unit:
        dN = np.zeros((nodes, width))
        dN[:width] = np.diag(4 * L - 1)
        for a, b, c in EDGES[dim]:
            dN[c] = 4 * (L[a] * unit[b] + L[b] * unit[a])
        local = dN[:, 1:] - dN[:, :1]
        G = local @ np.linalg.inv(np.transpose(x, (0, 2, 1)) @ local)
        pairs += G.reshape(n, -1, 1) * G.reshape(n, 1, -1)
    K = pairs.reshape(n, nodes, dim, nodes, dim)
    same = np.trace(K, axis1=2, axis2=4)[:, :, None, :, None] * np.eye(dim)[:, None, :]
    return np.asarray(K + K.transpose(0, 1, 4, 3, 2) + same).reshape(pairs.shape)


def straighten_folded(gmsh: ModuleType, dim: int, halvings: int = 0) -> list[list[float]]:
    """Makes the edges of folded cells straighter, and of those that then fold; their middles.

    Args:
        dim: 2 or 3, of quadratic cells.
        halvings: Of the rise of the edges of a cell, before they become straight.
    """
    times = np.zeros(len(gmsh.model.mesh.getElementsByType(KINDS[dim])[0]), dtype=np.int64)
    while len(at := np.setdiff1d(_folded(gmsh, dim), np.flatnonzero(times > halvings))):
        times[at] += 1
        _, nodes, x = nodes_of(gmsh, dim)
        share = np.where(times[at] <= halvings, 0.5, 0.0)[:, None]
        for a, b, c in EDGES[dim]:
            straight = (x[at, a] + x[at, b]) / 2
            places = straight + share * (x[at, c] - straight)
            for tag, place in zip(nodes[at, c], places, strict=True):
                gmsh.model.mesh.setNode(int(tag), place.tolist(), [])
    if not times.any():
        return []
    _, _, x = nodes_of(gmsh, dim)
    middles = x[times > 0, : dim + 1].mean(axis=1)
    return [[float(part) for part in middle] for middle in middles]
