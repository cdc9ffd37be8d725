"""Two boxes, one on the other, that share no node where they touch."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.mesh import Body, Selector, name_parts
from dolfin_elastic.mesh.distribute import make_mesh
from dolfin_elastic.mesh.geometry.simplices import boundary_facets, cells_beside_facets, facet_nodes


def grid(size: tuple[float, ...], cells: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points and simplices of a box with a corner at the origin (Kuhn's partition)."""
    dim = len(size)
    counts = np.array(cells) + 1
    order = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, dim)
    steps = np.append(np.cumprod(counts[:0:-1])[::-1], 1)
    corner = order[(order < np.array(cells)).all(axis=1)] @ steps
    paths = [np.cumsum([0, *steps[list(p)]]) for p in permutations(range(dim))]
    return order * (np.array(size) / cells), np.concatenate([corner[:, None] + p for p in paths])


def quadratic(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with midside nodes, triangles or tetrahedra."""
    ends = list(combinations(range(cells.shape[1]), 2))[::-1]
    edges, number = np.unique(
        np.sort(np.concatenate([cells[:, pair] for pair in ends]), axis=1),
        axis=0,
        return_inverse=True,
    )
    middle = len(points) + number.reshape(len(ends), -1).T
    return np.concatenate([points, points[edges].mean(axis=1)]), np.hstack([cells, middle])


def stacked(
    size: tuple[float, ...],
    lower: tuple[int, ...],
    upper: tuple[int, ...],
    *,
    gap: float = 0.0,
    shift: float = 0.0,
    width: float | None = None,
    order: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Body:
    """Two boxes of equal height, of which together `size` is the outline, with meshes of their own.

    Args:
        size: Of both together, the last along the direction of the stack.
        lower: Cells of the lower one.
        upper: Cells of the upper one.
        gap: Between the two.
        shift: Of the upper one along x.
        width: Of the upper one along x; by default that of the lower one.
        order: Of the geometry: straight or quadratic cells.
        comm: The ranks.

    Returns:
        With regions "lower" and "upper", the surfaces "below" and "above" where they touch (upper
        face of the lower box, lower face of the upper one), and "bottom", "top", "left", "right"
        (x), in 3D "front" and "back" (y) of both.
    """
    dim, half = len(size), size[-1] / 2
    a, b = (grid((*size[:-1], half), cells) for cells in (lower, upper))
    if order == 2:
        a, b = quadratic(*a), quadratic(*b)
    over = b[0] * np.array([(width or size[0]) / size[0], *[1.0] * (dim - 1)])
    over[:, 0] += shift
    over[:, -1] += half + gap
    points = np.concatenate([a[0], over])
    cells = np.concatenate([a[1], len(a[0]) + b[1]]).astype(np.int64)
    if comm.rank:
        cells, points = cells[:0], points[:0]
    body = Body(make_mesh(comm, cells, points, order))
    mesh, z = body.mesh, dim - 1
    low = np.asarray(mesh.topology.original_cell_index) < len(a[1])
    facets = boundary_facets(mesh)
    flat = np.ptp(mesh.geometry.x[facet_nodes(mesh, facets)][:, :, z], axis=1) < 1e-9
    beside, _ = cells_beside_facets(mesh, facets)
    at = mesh.geometry.x[facet_nodes(mesh, facets)][:, :, z].mean(axis=1)
    inside = flat & (np.abs(at - half - np.where(low[beside], 0.0, gap)) < 1e-9)
    named = body.named(
        regions={
            "lower": np.flatnonzero(low).astype(np.int32),
            "upper": np.flatnonzero(~low).astype(np.int32),
        },
        surfaces={
            "below": facets[inside & low[beside]],
            "above": facets[inside & ~low[beside]],
        },
    )
    axes = {"left": ("x", "min"), "right": ("x", "max")}
    if dim == 3:
        axes |= {"front": ("y", "min"), "back": ("y", "max")}
    ends = "xyz"[z]
    axes |= {"bottom": (ends, "min"), "top": (ends, "max")}
    return name_parts(
        named, surfaces={n: Selector(plane=axis, at=at) for n, (axis, at) in axes.items()}
    )


def quarter_rings(
    radii: tuple[float, float, float],
    inner: tuple[int, int],
    outer: tuple[int, int],
    order: int,
    *,
    overlap: float = 0.0,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Body:
    """A quarter of two rings, one around the other, that share no node where they touch.

    Args:
        radii: Inside, where they touch, outside.
        inner: Cells of the inner one along the circle, and across.
        outer: Cells of the outer one.
        order: Of the geometry: straight or quadratic cells.
        overlap: By how much the outer one begins inside the inner one.
        comm: The ranks.

    Returns:
        With the surfaces "bore", "outside" (of the inner ring), "inside" and "rim" (of the outer
        ring), and "bottom" (y = 0) and "left" (x = 0) of both.
    """
    points, cells, first = [], [], 0
    spans = radii[:2], (radii[1] - overlap, radii[2])
    for (low, high), counts in zip(spans, (inner, outer), strict=True):
        polar, rows = grid((np.pi / 2, high - low), counts)
        rows = rows[:, [0, 1, 2]]
        if order == 2:
            polar, rows = quadratic(polar, rows)
        r, angle = low + polar[:, 1], polar[:, 0]
        points.append(np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1))
        cells.append(first + rows)
        first += len(polar)
    x, rows = np.concatenate(points), np.concatenate(cells).astype(np.int64)
    if comm.rank:
        x, rows = x[:0], rows[:0]
    body = Body(make_mesh(comm, rows, x, order))
    mesh = body.mesh
    corners = mesh.geometry.x[mesh.geometry.dofmap[:, :3]]
    edge = (radii[1] - overlap) * np.cos(np.pi / 4 / inner[0])
    inside = np.linalg.norm(corners.mean(axis=1), axis=1) < edge
    facets = boundary_facets(mesh)
    beside, _ = cells_beside_facets(mesh, facets)
    ends = mesh.geometry.x[facet_nodes(mesh, facets)]
    r = np.linalg.norm(ends, axis=2)
    on = {
        name: np.all(np.abs(r - radius) < 1e-9, axis=1)
        for name, radius in zip(
            ("bore", "middle", "within", "rim"), (*radii[:2], spans[1][0], radii[2]), strict=True
        )
    }
    return body.named(
        surfaces={
            "bore": facets[on["bore"]],
            "outside": facets[on["middle"] & inside[beside]],
            "inside": facets[on["within"] & ~inside[beside]],
            "rim": facets[on["rim"]],
            "bottom": facets[np.all(np.abs(ends[:, :, 1]) < 1e-9, axis=1)],
            "left": facets[np.all(np.abs(ends[:, :, 0]) < 1e-9, axis=1)],
        }
    )
