"""Quadratic cells in Gmsh that follow the surfaces of the CAD file."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.mesh.formats.cad.folded import (
    EDGES,
    nodes_of,
    relax_folded,
    straighten_folded,
)
from dolfin_elastic.mesh.formats.cad.shapes import Lengths

_LARGE, _FAIR = 60.0, 45.0
"""Angles in degrees by which the edge of a cell turns along a curved surface: from the first on the
estimated error of a peak there is too small, with the second it was right (fillets of brackets)."""


def follow_curves(
    gmsh: ModuleType, dim: int, curved: bool | None, lengths: Lengths, *, sized: bool
) -> tuple[str, list[str]]:
    """Makes the cells quadratic, with their boundary nodes on the CAD surfaces.

    Where cells would fold, in a thin wall or at a small fillet, nodes inside the body near them
    move as those of an elastic body, and what still folds gets straight edges.  (Gmsh's own
    "HighOrderElastic" moves the whole body, which takes a minute for 8e4 cells; "HighOrder" can end
    the process: it throws in a thread of OpenMP.)

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
    relax_folded(gmsh, dim)
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
        tags, normals = _atnodes_of(gmsh, dim, tag)
        order = np.argsort(tags, kind="stable")
        at = order[np.minimum(np.searchsorted(tags, vertices, sorter=order), len(tags) - 1)]
        known = (tags[at] == vertices)[..., None]
        result.append((int(tag), np.where(known, normals[at], np.nan)))
    return result


def _atnodes_of(gmsh: ModuleType, dim: int, tag: int) -> tuple[IntArray, FloatArray]:
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


def is_curved(gmsh: ModuleType, dim: int) -> bool:
    """Whether a quadratic facet of the boundary has a middle node off its straight edge."""
    rise, chord, _ = _arcs(gmsh, dim)
    return bool(np.any(rise > 1e-6 * chord))


def _arcs(gmsh: ModuleType, dim: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rise and chord of the edges of the boundary's quadratic facets, and their middle nodes."""
    _, _, x = nodes_of(gmsh, dim - 1)
    a, b, c = (x[:, list(which)].reshape(-1, 3) for which in zip(*EDGES[dim - 1], strict=True))
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
    x = nodes_of(gmsh, dim)[2][:, : dim + 1, :dim]
    volume = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum()
    count = volume / size**dim * (np.sqrt(2.0) if dim == 3 else 2 / np.sqrt(3.0))  # regular ones
    bounded = "; without sizes, in case and file, elements follow all such surfaces"
    return [
        f"one element spans {angles[worst]:.0f} degrees of a round face "
        f"{lengths.near([middle[worst].tolist()])}: its peak stress is not known; mesh.size = "
        f'"{lengths.text(size, 1)}" or a [[mesh.refine]] of that face follows it, '
        f"with about {count:.2g} elements{bounded if sized else ''}"
    ]
