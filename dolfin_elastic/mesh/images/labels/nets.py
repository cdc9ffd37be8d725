"""Surfaces between the regions of an image, conforming where three of them meet.

They consist of the faces between voxels of different regions (a surface net) whose corners are
moved by the windowed sinc filter: it takes the steps of the voxels away and keeps volumes, where
repeated means shrink small bodies.  Corners where surfaces meet move along the common line only,
those at the end of the image in its plane.  Then all surfaces are shifted by a constant each, for
what regions have lost or won: a few hundredths of a voxel, or more of the smallest bodies.

Source: S. F. F. Gibson, "Constrained elastic surface nets", MICCAI (1998) 888; G. Taubin, T. Zhang
and G. Golub, "Optimal surface smoothing as filter design", ECCV (1996) 283.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.formats.surfaces.filling.bodies import region_volumes
from dolfin_elastic.mesh.formats.surfaces.filling.plc import OUTSIDE, Plc

OUTER = "outer"
"""Name of the surface of all regions; of each of several ones it is `NAME-outer`."""
_TIMES = 4
"""Corrections of volumes."""
_FARTHEST = 0.5
"""Voxels by which one of them shifts a surface at most."""


@dataclass(frozen=True)
class Smoothing:
    """The windowed sinc filter.

    Attributes:
        degree: Of its polynomial; 0 leaves the surface as it is.
        band: Frequencies that pass, of 0 to 2.
    """

    degree: int
    band: float


@dataclass(frozen=True)
class _Faces:
    """Faces between voxels.

    Attributes:
        corners: By voxels: whole numbers are their middles, shape (n, 3).
        quads: Rows of these, shape (m, 4).
        regions: Behind and in front, `OUTSIDE` or rows of the names, shape (m, 2).
        sides: End of the image, 2 axis + (0 or 1); -1 for faces within it; shape (m,).
    """

    corners: FloatArray
    quads: IntArray
    regions: IntArray
    sides: IntArray


def surfaces_between(
    regions: AnyArray, affine: FloatArray, names: Sequence[str], smoothing: Smoothing
) -> Plc:
    """The complex of surfaces between regions. Local.

    Args:
        regions: Number of the region of each voxel, 1 for the first name; 0 is not meshed; shape
            (ni, nj, nk).
        affine: From indices to places; see `Image`.
        names: Of the regions, that of number 1 first.
        smoothing: Degree 0 leaves the steps of the voxels.
    """
    faces = _faces(regions)
    keys = np.column_stack([faces.regions, faces.sides])
    kinds, patches = np.unique(keys, axis=0, return_inverse=True)
    patches = patches.reshape(-1)
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    corners = faces.corners * spacing
    if smoothing.degree:
        corners = _smoothed(corners, faces, patches, smoothing)
    first, second, third, fourth = faces.quads.T
    diagonals = [
        np.linalg.norm(corners[a] - corners[b], axis=1)
        for a, b in ((first, third), (second, fourth))
    ]
    short = (diagonals[0] <= diagonals[1])[:, None, None]
    triangles = np.where(
        short, faces.quads[:, [[0, 1, 2], [0, 2, 3]]], faces.quads[:, [[0, 1, 3], [1, 2, 3]]]
    ).reshape(-1, 3)
    plc = Plc(
        corners,
        triangles,
        np.repeat(faces.regions, 2, axis=0),
        np.repeat(patches, 2),
        list(names),
        [_name(kind, names, affine) for kind in kinds],
    )
    if smoothing.degree:
        voxels = np.bincount(regions.ravel(), minlength=len(names) + 1)[1:] * np.prod(spacing)
        for _ in range(_TIMES):
            plc = _corrected(
                plc, np.asarray(voxels), kinds[:, 2] >= 0, _FARTHEST * float(spacing.min())
            )
    if np.linalg.det(affine[:3, :3]) < 0:  # a mirrored image turns normals round
        plc = replace(plc, triangles=np.ascontiguousarray(plc.triangles[:, ::-1]))
    return replace(plc, points=plc.points / spacing @ affine[:3, :3].T + affine[:3, 3])


def _name(kind: IntArray, names: Sequence[str], affine: FloatArray) -> str:
    """Name of the surface between two regions, or of that at a side of the image."""
    a, b, side = map(int, kind)
    if b != OUTSIDE:
        return f"{names[a]}-{names[b]}"
    if side < 0:
        return OUTER if len(names) == 1 else f"{names[a]}-{OUTER}"
    axis, end = divmod(side, 2)
    along = affine[:3, axis] * (1 if end else -1)
    most = int(np.argmax(np.abs(along)))
    return "xyz"[most] + ("max" if along[most] > 0 else "min")


def _faces(regions: AnyArray) -> _Faces:
    """The faces between voxels of different regions; those of two regions belong to the first."""
    padded = np.pad(regions, 1)
    shape = np.array(padded.shape) + 1
    ids, pairs, sides = [], [], []
    for axis in range(3):
        below, above = (
            padded[tuple(s if k == axis else slice(None) for k in range(3))]
            for s in (slice(None, -1), slice(1, None))
        )
        at = np.stack(np.nonzero(below != above), axis=1)
        behind, in_front = (one[tuple(at.T)].astype(np.int64) for one in (below, above))
        u, v = (axis + 1) % 3, (axis + 2) % 3
        # Corner (i, j, k) of the grid is the lower one of voxel (i, j, k).
        corner = at.copy()
        corner[:, axis] += 1
        quad = []
        for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
            one = corner.copy()
            one[:, u] += du
            one[:, v] += dv
            quad.append((one[:, 0] * shape[1] + one[:, 1]) * shape[2] + one[:, 2])
        rows = np.stack(quad, axis=1)
        turn = (behind == 0) | ((in_front != 0) & (behind > in_front))
        rows[turn] = rows[turn][:, ::-1]
        ids.append(rows)
        swapped = np.where(turn, in_front, behind), np.where(turn, behind, in_front)
        pairs.append(np.stack(swapped, axis=1))
        end = np.where(at[:, axis] == 0, 2 * axis, -1)
        sides.append(np.where(at[:, axis] == padded.shape[axis] - 2, 2 * axis + 1, end))
    used, quads = np.unique(np.concatenate(ids), return_inverse=True)
    index = np.stack(np.unravel_index(used, tuple(shape)), axis=1)
    # Voxel 0 of the image is voxel 1 here, and its lower corner half a voxel below its middle.
    both = np.concatenate(pairs) - 1
    corners = np.asarray(index - 1.5, dtype=np.float64)
    return _Faces(corners, quads.reshape(-1, 4), both, np.concatenate(sides))


def _smoothed(
    corners: FloatArray, faces: _Faces, patches: IntArray, smoothing: Smoothing
) -> FloatArray:
    """The corners after the filter, shape (n, 3)."""
    from scipy.sparse import coo_array

    count = len(corners)
    ends = faces.quads[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2)
    keys, of, uses = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    of, each = of.reshape(-1), np.repeat(patches, 4)
    low, high = np.full(len(keys), len(patches)), np.full(len(keys), -1)
    np.minimum.at(low, of, each)
    np.maximum.at(high, of, each)
    line = (uses != 2) | (low != high)
    on_line = np.zeros(count, dtype=bool)
    on_line[keys[line]] = True
    planes = np.zeros(count, dtype=np.int64)
    for side in range(6):
        planes[np.unique(faces.quads[faces.sides == side])] |= 1 << side
    a, b = np.concatenate([keys, keys[:, ::-1]]).T
    follows = ~on_line[a] | np.concatenate([line, line])
    follows &= planes[a] & planes[b] == planes[a]
    a, b = a[follows], b[follows]
    number = np.bincount(a, minlength=count)
    mean = coo_array((1.0 / number[a], (a, b)), shape=(count, count)).tocsr()
    free = number > 0

    def step(x: FloatArray) -> FloatArray:
        """1 - L/2 of the Laplacian L; corners without neighbours stay."""
        return np.asarray(np.where(free[:, None], (x + mean @ x) / 2, x))

    centre = corners.mean(axis=0)
    before, now = corners - centre, step(corners - centre)
    weights = _sinc(smoothing)
    result = weights[0] * before + weights[1] * now
    for weight in weights[2:]:
        before, now = now, 2 * step(now) - before
        result += weight * now
    return np.asarray(result + centre)


def _sinc(smoothing: Smoothing) -> FloatArray:
    """Weights of Chebyshev's polynomials, by Hamming's window; what is constant passes."""
    n = np.arange(1, smoothing.degree + 1)
    angle = np.arccos(1 - smoothing.band / 2)
    window = 0.54 + 0.46 * np.cos(np.pi * n / (smoothing.degree + 1))
    weights = np.concatenate([[angle / np.pi], window * 2 * np.sin(n * angle) / (n * np.pi)])
    return np.asarray(weights / weights.sum())


def _corrected(plc: Plc, wanted: FloatArray, fixed: BoolArray, most: float) -> Plc:
    """The complex after shifts of its patches that give regions their volumes.

    Args:
        wanted: Volumes of the regions, shape (regions,).
        fixed: Whether a patch stays, shape (patches,).
        most: Largest shift, in the unit of the points.
    """
    x = plc.points[plc.triangles]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2
    # A patch that is shifted by 1 changes its regions by its area; lines move by half of that.
    free = ~fixed[plc.patches]
    vertex = np.zeros_like(plc.points)
    held = np.zeros(len(plc.points), dtype=bool)
    held[plc.triangles[~free]] = True
    for corner in plc.triangles.T:
        np.add.at(vertex, corner[free], normals[free])
    vertex[held] = 0
    length = np.linalg.norm(vertex, axis=1, keepdims=True)
    vertex = np.divide(vertex, length, out=np.zeros_like(vertex), where=length > 0)
    several = _of_several(plc)
    vertex[several] = 0
    change = np.einsum("tj,tcj->t", normals, vertex[plc.triangles]) / 3
    moves = np.zeros((len(wanted) + 1, len(fixed)))
    np.add.at(moves, (plc.regions[:, 0], plc.patches), change)
    np.add.at(moves, (plc.regions[:, 1], plc.patches), -change)
    shift = np.linalg.lstsq(moves[:-1], wanted - region_volumes(plc), rcond=1e-6)[0].clip(
        -most, most
    )
    each = np.zeros(len(plc.points))
    each[plc.triangles] = shift[plc.patches][:, None]
    return replace(plc, points=plc.points + each[:, None] * vertex)


def _of_several(plc: Plc) -> BoolArray:
    """Whether a corner belongs to several patches, shape (n,)."""
    low, high = np.full(len(plc.points), len(plc.patch_names)), np.full(len(plc.points), -1)
    for corner in plc.triangles.T:
        np.minimum.at(low, corner, plc.patches)
        np.maximum.at(high, corner, plc.patches)
    return np.asarray(low != high)
