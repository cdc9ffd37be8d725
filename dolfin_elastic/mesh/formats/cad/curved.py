"""Quadratic cells in Gmsh that follow the surfaces of the CAD file."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.cad.shapes import Lengths

_LEAST = 0.1
"""Smallest over largest determinant of the map of a curved cell; in straight ones it is 1."""


_LARGE, _FAIR = 60.0, 45.0
"""Angles in degrees by which the edge of a cell turns along a curved surface: from the first on the
estimated error of a peak there is too small, with the second it was right (fillets of brackets)."""


def follow_curves(
    gmsh: ModuleType, dim: int, curved: bool | None, lengths: Lengths, *, sized: bool
) -> tuple[str, list[str]]:
    """Makes the cells quadratic, with their boundary nodes on the CAD surfaces.

    Where cells would fold, in a thin wall or at a small fillet, Gmsh moves nodes inside the body as
    if it were elastic, and what still folds gets straight edges.  The first takes a minute for 8e4
    cells, and is left out where it could mend none.  (Gmsh's other optimisation, "HighOrder", can
    end the process: it throws in a thread of OpenMP.)

    Args:
        dim: 2 or 3.
        curved: None: only if a face of the body is curved.
        sized: Whether the case or the file gives sizes of elements.

    Returns:
        What has been done, and notes on what is doubtful.
    """
    flat = "Plane" if dim == 3 else "Line"
    properties = map(gmsh.model.mesh.getElementProperties, gmsh.model.mesh.getElementTypes(dim))
    if curved is None and (
        any(order > 1 for _, _, order, *_ in properties)  # as a .geo file says
        or all(gmsh.model.getType(*face) == flat for face in gmsh.model.getEntities(dim - 1))
    ):
        return "", []
    gmsh.model.mesh.setOrder(2)
    if curved is None and not is_curved(gmsh, dim):
        gmsh.model.mesh.setOrder(1)
        return "", []
    notes = _coarse(gmsh, dim, lengths, sized=sized)
    if not _lost(gmsh, dim, _folded(gmsh, dim)).all():
        gmsh.model.mesh.optimize("HighOrderElastic")
    straight = straighten_folded(gmsh, dim)
    if not straight:
        return ", elements curved", notes
    return (
        f", elements curved, but {len(straight)} are too large to follow the round face "
        f"{lengths.near(straight)}: stress there is unreliable; a smaller mesh.size helps"
    ), notes


def exact_normals(gmsh: ModuleType, dim: int) -> list[tuple[int, FloatArray]]:
    """Normals of faces (curves of a plane body) at the vertices of their elements. Local.

    Returns:
        Of each face its number and the unit normals, to one side or the other, shape (elements,
        dim, 3), in the order in which the mesh is saved; NaN where Gmsh does not know them, as at
        the tip of a cone.
    """
    result = []
    for _, tag in gmsh.model.getEntities(dim - 1):
        kinds, _, nodes = gmsh.model.mesh.getElements(dim - 1, tag)
        rows: list[IntArray] = [np.empty((0, dim), dtype=np.int64)]
        for kind, of_kind in zip(kinds, nodes, strict=True):
            width = gmsh.model.mesh.getElementProperties(kind)[3]
            rows.append(np.asarray(of_kind, dtype=np.int64).reshape(-1, width)[:, :dim])
        vertices = np.concatenate(rows)
        tags, normals = _at_nodes(gmsh, dim, tag)
        order = np.argsort(tags, kind="stable")
        at = order[np.minimum(np.searchsorted(tags, vertices, sorter=order), len(tags) - 1)]
        known = (tags[at] == vertices)[..., None]
        result.append((int(tag), np.where(known, normals[at], np.nan)))
    return result


def _at_nodes(gmsh: ModuleType, dim: int, tag: int) -> tuple[IntArray, FloatArray]:
    """Nodes on a face or curve, and its unit normals there."""
    try:
        tags, _, t = gmsh.model.mesh.getNodes(dim - 1, tag, True, True)
        if dim == 3:
            normals: FloatArray = np.asarray(gmsh.model.getNormal(tag, t)).reshape(-1, 3)
        else:
            along = np.asarray(gmsh.model.getDerivative(1, tag, t)).reshape(-1, 3)
            normals = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    except Exception:  # Gmsh's own error: a surface without parameters
        normals = np.empty((0, 3))
    if not len(normals) or len(tags) != len(normals):
        return np.zeros(1, dtype=np.int64), np.full((1, 3), np.nan)  # no node has the number 0
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    good = np.isfinite(length) & (length > 0)
    return np.asarray(tags, dtype=np.int64), np.where(
        good, normals / np.where(good, length, 1), np.nan
    )


_EDGES = {
    1: [(0, 1, 2)],
    2: [(0, 1, 3), (1, 2, 4), (2, 0, 5)],
    3: [(0, 1, 4), (1, 2, 5), (2, 0, 6), (3, 0, 7), (3, 2, 8), (3, 1, 9)],
}
"""Ends and middle of the edges of Gmsh's quadratic line, triangle and tetrahedron."""
_KINDS = {1: 8, 2: 9, 3: 11}
"""Their types."""


def _nodes(gmsh: ModuleType, dim: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Tags, nodes of shape (n, k) and their places (n, k, 3) of the quadratic cells of a kind."""
    cells, nodes = gmsh.model.mesh.getElementsByType(_KINDS[dim])
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    nodes = np.asarray(nodes).reshape(len(cells), -1)
    at = order[np.searchsorted(tags, nodes, sorter=order)]
    return np.asarray(cells), nodes, np.asarray(coordinates).reshape(-1, 3)[at]


def is_curved(gmsh: ModuleType, dim: int) -> bool:
    """Whether a quadratic facet of the boundary has a middle node off its straight edge."""
    rise, chord, _ = _arcs(gmsh, dim)
    return bool(np.any(rise > 1e-6 * chord))


def _arcs(gmsh: ModuleType, dim: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rise and chord of the edges of the boundary's quadratic facets, and their middle nodes."""
    _, _, x = _nodes(gmsh, dim - 1)
    a, b, c = (x[:, list(which)].reshape(-1, 3) for which in zip(*_EDGES[dim - 1], strict=True))
    return np.linalg.norm(c - (a + b) / 2, axis=1), np.linalg.norm(b - a, axis=1), c


def _coarse(gmsh: ModuleType, dim: int, lengths: Lengths, *, sized: bool) -> list[str]:
    """A note where cells are too large for a curved surface.

    The tangent of a circle of which an edge is a chord turns by 4 atan(2 rise/chord).
    """
    rise, chord, middle = _arcs(gmsh, dim)
    angles = np.degrees(4 * np.arctan2(2 * rise, chord))
    worst = int(np.argmax(angles)) if len(angles) else 0
    if not len(angles) or angles[worst] < _LARGE:
        return []
    size = chord[worst] * _FAIR / angles[worst]
    x = _nodes(gmsh, dim)[2][:, : dim + 1, :dim]
    volume = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum()
    count = volume / size**dim * (np.sqrt(2.0) if dim == 3 else 2 / np.sqrt(3.0))  # regular ones
    bounded = "; without sizes, in case and file, elements follow all such surfaces"
    return [
        f"one element spans {angles[worst]:.0f} degrees of a round face "
        f"{lengths.near([middle[worst].tolist()])}: its peak stress is not known; mesh.size = "
        f'"{lengths.text(size, 1)}" or a [[mesh.refine]] of that face follows it, '
        f"with about {count:.2g} elements{bounded if sized else ''}"
    ]


def _folded(gmsh: ModuleType, dim: int) -> IntArray:
    """Positions of the cells whose map is singular, or almost, somewhere in them."""
    tags = gmsh.model.mesh.getElementsByType(_KINDS[dim])[0].tolist()
    low, high = (
        np.asarray(gmsh.model.mesh.getElementQualities(tags, name))
        for name in ("minDetJac", "maxDetJac")
    )
    # Cells that run the other way round have negative determinants throughout.
    side = np.sign(low + high)
    smallest, largest = np.minimum(low * side, high * side), np.maximum(np.abs(low), np.abs(high))
    return np.flatnonzero(smallest < _LEAST * largest)


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
    _, nodes, x = (rows[folded] for rows in _nodes(gmsh, dim))
    middle = {frozenset(ends): c for *ends, c in _EDGES[dim]}
    others = [[b for b in range(dim + 1) if b != a] for a in range(dim + 1)]
    middles = [[middle[frozenset((a, b))] for b in others[a]] for a in range(dim + 1)]
    x, corners = x[..., :dim], x[:, : dim + 1, None, :dim]
    tangents = 4 * x[:, middles] - 3 * corners - x[:, others]
    side = np.sign(np.linalg.det(x[:, others] - corners))
    det: FloatArray = np.linalg.det(tangents) * side
    singular = det < _LEAST * np.abs(det).max(axis=1, keepdims=True)
    on_surface = np.isin(nodes, np.concatenate(held))[:, middles].all(axis=2)
    return np.asarray((singular & on_surface).any(axis=1))


def straighten_folded(gmsh: ModuleType, dim: int, halvings: int = 0) -> list[list[float]]:
    """Makes the edges of folded cells straighter, and of those that then fold; their middles.

    Args:
        dim: 2 or 3, of quadratic cells.
        halvings: Of the rise of the edges of a cell, before they become straight.
    """
    times = np.zeros(len(_nodes(gmsh, dim)[0]), dtype=np.int64)
    while len(at := np.setdiff1d(_folded(gmsh, dim), np.flatnonzero(times > halvings))):
        times[at] += 1
        _, nodes, x = _nodes(gmsh, dim)
        share = np.where(times[at] <= halvings, 0.5, 0.0)[:, None]
        for a, b, c in _EDGES[dim]:
            straight = (x[at, a] + x[at, b]) / 2
            places = straight + share * (x[at, c] - straight)
            for tag, place in zip(nodes[at, c], places, strict=True):
                gmsh.model.mesh.setNode(int(tag), place.tolist(), [])
    _, _, x = _nodes(gmsh, dim)
    middles = x[times > 0, : dim + 1].mean(axis=1)
    return [[float(part) for part in middle] for middle in middles]
