"""A fine surface is bound to a body and follows it: a character's skin, a scan, a printed shell.

A point follows the cell that is nearest to it: with its displacement at the nearest point of that
cell and, beyond it, its gradient there.  So an affine motion is exact, also far outside, and the
quadratic displacements of quadratic cells do not run away there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.startup.elsewhere import elsewhere
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.facets_of_files import read_triangles
from dolfin_elastic.results.exports.moving import Binding, mesh_of
from dolfin_elastic.results.finished.run import FinishedRun

_SIDES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
"""Corners beside the nodes in the middle of the edges of a tetrahedron, in VTK's order."""
_STEPS = 20
"""Of Newton's method at most; a curved cell needs about four."""
_EXACT = 1e-12
_OUTSIDE = 1e-6
"""Distance from the body over its length up to which a point counts as inside."""


def read_skin(path: Path, metres: float) -> tuple[FloatArray, IntArray]:
    """Corners [m] and triangles of a surface, in the order of its file. Not collective.

    Args:
        metres: Metres per unit of the file, where it states none.

    Raises:
        MeshError: It cannot be read, or is no surface.
    """
    points, triangles = read_triangles(path, metres)
    if not np.isfinite(points).all():
        raise MeshError("it has coordinates that are no finite numbers", where=path.name)
    return points, triangles


def bound(run: FinishedRun, path: Path) -> Binding:
    """A surface that follows the body of a run. Not collective.

    Raises:
        InputError: The body is plane.
        MeshError: The surface cannot be read.
    """
    if run.dim != 3:
        raise InputError(
            "the body is plane, and a surface of a file follows solids only",
            where=str(path),
            expected="leave it out: the body itself is exported",
        )
    points, triangles = read_skin(path, run.metres)
    nodes, cells = mesh_of(run)
    owner, straight = _nearest(nodes, cells, points)
    own = cells[owner]
    weights, smooth, nearest = _weights(nodes[own], points, straight)
    off = np.linalg.norm(points - nearest, axis=1)
    outside = off > _OUTSIDE * np.ptp(nodes, axis=0).max()
    note = ""
    if outside.any():
        unit = LengthUnit.of(run.metres)
        note = (
            f"{outside.sum()} of {len(points)} points of {path.name} lie outside of the body, "
            f"at most {off.max() / unit.metres:.3g} {unit.name}; they follow its nearest elements"
        )
    return Binding(triangles, points, own, weights, smooth, note)


def _nearest(nodes: FloatArray, cells: IntArray, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """The straight cell nearest to each point, and the nearest point of it."""
    with elsewhere():
        import pyvista as pv

    rows = np.insert(cells[:, :4], 0, 4, axis=1)
    kinds = np.full(len(cells), pv.CellType.TETRA, dtype=np.uint8)
    grid = pv.UnstructuredGrid(rows.ravel(), kinds, nodes)
    found, places = grid.find_closest_cell(points, return_closest_point=True)
    return np.atleast_1d(np.asarray(found, dtype=np.int64)), np.atleast_2d(places)


def _weights(
    nodes: FloatArray, points: FloatArray, straight: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What points take of the displacements and of the fields of their cells' nodes.

    Args:
        nodes: Of the cell of each point [m], shape (n, 4 or 10, 3).
        points: Shape (n, 3) [m].
        straight: Nearest places in the cells without their curves [m], shape (n, 3).

    Returns:
        Two of shape (n, 4 or 10), and the places in the cells from which the points go on [m],
        shape (n, 3).
    """
    corners = nodes[:, :4]
    local = _step(corners, straight, np.full((len(points), 3), 0.25))[0] + 0.25
    if nodes.shape[1] > corners.shape[1]:
        curved = local.copy()
        for _ in range(_STEPS):
            step, _ = _step(nodes, points, curved)
            curved = np.clip(curved + step, -3.0, 4.0)  # far points must not send it astray
            if np.abs(step).max(initial=0.0) < _EXACT:
                break
        inside = (_barycentric(curved) > -_EXACT).all(axis=1)
        local[inside] = curved[inside]
    values, _ = _shapes(local, nodes.shape[1])
    places = np.einsum("nk,nkj->nj", values, nodes)
    _, slopes = _step(nodes, points, local)
    return values + np.einsum("nkj,nj->nk", slopes, points - places), values, places


def _step(
    nodes: FloatArray, points: FloatArray, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A step of Newton's method to the coordinates of points in their cells.

    Returns:
        Shape (n, 3), and the gradients of the shape functions in space [1/m], shape (n, k, 3).
    """
    values, slopes = _shapes(local, nodes.shape[1])
    inverse = np.linalg.pinv(np.einsum("nki,nkj->nij", nodes, slopes))
    gap = points - np.einsum("nk,nkj->nj", values, nodes)
    return np.einsum("nij,nj->ni", inverse, gap), np.einsum("nkj,nji->nki", slopes, inverse)


def _barycentric(local: FloatArray) -> FloatArray:
    return np.column_stack([1 - local.sum(axis=1), local])


def _shapes(local: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Shape functions of a tetrahedron in VTK's order, and their gradients.

    Args:
        local: Coordinates in the cell, shape (n, 3).
        width: Number of nodes, 4 or 10.

    Returns:
        Shapes (n, width) and (n, width, 3).
    """
    b, db = _barycentric(local), np.vstack([-np.ones(3), np.eye(3)])
    if width == len(db):
        return b, np.broadcast_to(db, (len(b), *db.shape))
    values = [b * (2 * b - 1), *(4 * b[:, [i]] * b[:, [j]] for i, j in _SIDES)]
    middle = [4 * (b[:, i, None] * db[j] + b[:, j, None] * db[i])[:, None] for i, j in _SIDES]
    return np.hstack(values), np.hstack([(4 * b - 1)[:, :, None] * db, *middle])
