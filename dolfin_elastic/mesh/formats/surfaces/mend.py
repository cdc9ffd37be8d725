"""Mending of surfaces: what `repair = true` does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh.formats.surfaces.crossings import crossings
from dolfin_elastic.mesh.formats.surfaces.readers.polygons import MOST_CORNERS, cut
from dolfin_elastic.mesh.formats.surfaces.surface import (
    ELSEWHERE,
    ON_EDGE,
    Fault,
    Surface,
    counted,
    find_faults,
    minority,
    on_edges,
    turned_outwards,
)
from dolfin_elastic.mesh.formats.surfaces.topology import (
    OneSidedError,
    oriented,
    signed_volumes,
)

_GAPS = (1e-7, 1e-6, 1e-5)
"""Distances of corners that are made one, over the size of the body."""
_SMALL = 0.1
"""Extent of a hole that is closed, over that of the body; any of up to four edges is."""
_FEW = 4
_PASSES = 20


@dataclass(frozen=True)
class Mended:
    """A surface after repair.

    Attributes:
        surface: Without faults, all shells outwards, if `mend` made it.
        steps: What has been done, in words.
        distance: By which the surface has moved at most, in the file's unit.
    """

    surface: Surface
    steps: list[str]
    distance: float


def mend(surface: Surface, name: str, unit: LengthUnit) -> Mended:
    """Mends a surface. Local.

    In this order: near corners are made one, doubled triangles left out, edges divided, triangles
    turned, small holes closed, bodies that run into each other united.

    Raises:
        MeshError: The first fault that is left.
    """
    mended = _mended(surface, name, unit)
    if faults := find_faults(mended.surface):
        error = faults[0].error(name, unit)
        raise MeshError(f"repair cannot mend this: {error.what}", where=name, expected=ELSEWHERE)
    return replace(mended, surface=turned_outwards(mended.surface))


def with_outlook(surface: Surface, faults: list[Fault], name: str) -> list[Fault]:
    """The faults of a surface, which offer repair only where it mends all of them. Local.

    Why repair ends without a result at all is for its own message.
    """
    if not any(fault.remedy for fault in faults):
        return faults
    try:
        mends = not find_faults(_mended(surface, name, METRE).surface)
    except MeshError:
        return faults
    return faults if mends else [replace(fault, remedy="") for fault in faults]


def _mended(surface: Surface, name: str, unit: LengthUnit) -> Mended:
    """After all steps, whatever they have left."""
    size, steps, moved = surface.size, list[str](), 0.0
    surface, gap = _welded(surface, size, name)
    if gap:
        moved = gap
        steps.append(f"corners up to {unit.length(gap * unit.metres)} apart made one")
    if len(surface.doubled):
        count, surface = len(surface.triangles), surface.without_doubled()
        count -= len(surface.triangles)
        steps.append(f"{counted(count, 'doubled triangle', 'doubled triangles')} left out")
    surface, count = _divided(surface, ON_EDGE * size)
    if count:
        steps.append(f"{counted(count, 'edge', 'edges')} divided")
        moved = max(moved, ON_EDGE * size)
    surface, count = _turned(surface)
    if count:
        steps.append(f"{counted(count, 'triangle', 'triangles')} turned round")
    surface, count, deep = _closed(surface, size)
    if count:
        steps.append(f"{counted(count, 'triangle', 'triangles')} added in holes")
        moved = max(moved, deep)
    if surface.edges.is_closed and not len(surface.edges.crowded):
        surface, united = _united(surface, name)
        steps += ["bodies that ran into each other united"] * united
    return Mended(surface, steps, moved)


def _welded(surface: Surface, size: float, name: str) -> tuple[Surface, float]:
    """With near corners made one, up to the distance after which the fewest edges are open."""
    best, gap, least = surface, 0.0, surface.wrong
    for share in _GAPS:
        if not least:
            break
        other, _ = surface.welded(share * size, name)
        if other.wrong < least:
            best, gap, least = other, share * size, other.wrong
    return best, gap


def _divided(surface: Surface, near: float) -> tuple[Surface, int]:
    """With edges divided where corners of others lie on them."""
    count = 0
    for _ in range(_PASSES):
        found = {side // 3: (side, corners) for side, corners in on_edges(surface, near)}
        if not found:
            break
        new, of = list[tuple[int, int, int]](), list[int]()
        for row, (side, corners) in found.items():
            a, b, c = np.roll(surface.triangles[row], -(side % 3))
            line = [a, *corners, b]
            new += [(p, q, c) for p, q in pairwise(line) if c not in (p, q)]
            of += [row] * (len(new) - len(of))
        rest = np.setdiff1d(np.arange(len(surface.triangles)), list(found))
        surface = surface.with_triangles(
            np.concatenate([surface.triangles[rest], np.array(new, dtype=np.int64)]),
            np.concatenate([rest, np.array(of, dtype=np.int64)]),
        )
        count += len(found)
    return surface, count


def _turned(surface: Surface) -> tuple[Surface, int]:
    """With all triangles as their neighbours, and how many were not."""
    try:
        shell, turned = oriented(surface.edges)
    except OneSidedError:
        return surface, 0  # found again
    few = minority(shell, turned)
    triangles = np.where(few[:, None], surface.triangles[:, ::-1], surface.triangles)
    return replace(surface, triangles=np.ascontiguousarray(triangles)), int(few.sum())


def _closed(surface: Surface, size: float) -> tuple[Surface, int, float]:
    """With small holes closed, how many triangles that took, and how far from a rim these lie."""
    added: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    of, deep = list[int](), 0.0
    for sides in _loops(surface):
        rim = surface.edges.ends[sides][::-1]
        extent = float(np.ptp(surface.points[rim], axis=0).max())
        if len(rim) > _FEW and (extent > _SMALL * size or len(rim) > MOST_CORNERS):
            continue
        rows, _ = cut(surface.points, np.array([len(rim)]), rim, "")
        added.append(rows)
        of += [int(sides[0]) // 3] * len(rows)
        deep = max(deep, extent / 2)
    new = np.concatenate(added)
    if not len(new):
        return surface, 0, 0.0
    every = np.arange(len(surface.triangles))
    closed = surface.with_triangles(
        np.concatenate([surface.triangles, new]),
        np.concatenate([every, np.array(of, dtype=np.int64)]),
    )
    return closed, len(new), deep


def _loops(surface: Surface) -> list[IntArray]:
    """Sides with one triangle, one after the other round each hole."""
    edges = surface.edges
    following: dict[int, list[int]] = {}
    for side in edges.open:
        following.setdefault(int(edges.starts[side]), []).append(int(side))
    result = []
    while following:
        loop, at = list[int](), next(iter(following))
        first = at
        while at in following:
            side = following[at].pop()
            if not following[at]:
                del following[at]
            loop.append(side)
            at = int(edges.ends[side])
            if at == first:
                result.append(np.array(loop, dtype=np.int64))
                break
    return result


def _united(surface: Surface, name: str) -> tuple[Surface, bool]:
    """With bodies that run into each other made one, and whether there were any."""
    pairs = crossings(surface.points, surface.triangles, most=100_000)
    if not len(pairs):
        return surface, False
    try:
        surface = turned_outwards(surface)
    except OneSidedError:
        return surface, False  # found again
    shell, _ = oriented(surface.edges)
    s, t = shell[pairs].T
    if (s == t).any():
        return surface, False  # found again
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = int(shell.max()) + 1
    graph = coo_array((np.ones(len(s)), (s, t)), shape=(count, count))
    cluster = connected_components(graph, directed=False)[1]
    many = np.bincount(cluster) > 1
    rest = surface.kept(~many[cluster[shell]])
    for k in np.flatnonzero(many):
        shells = [np.flatnonzero(shell == j) for j in np.flatnonzero(cluster == k)]
        rest = _beside(rest, *_union(surface, shells, name))
    return rest, True


def _union(
    surface: Surface, shells: list[IntArray], name: str
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Points, triangles, groups and solids of several shells as one."""
    try:
        import manifold3d
    except ImportError:
        raise MeshError(
            "bodies that run into each other are united by manifold3d, which is not installed",
            where=name,
            expected="pip install manifold3d",
        ) from None
    parts = []
    for rows in shells:
        used, local = np.unique(surface.triangles[rows], return_inverse=True)
        mesh = manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(surface.points[used]),
            tri_verts=local.reshape(-1, 3).astype(np.uint64),
            face_id=rows.astype(np.uint64),
        )
        parts.append(manifold3d.Manifold(mesh))
    made = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add).to_mesh64()
    triangles = np.asarray(made.tri_verts).astype(np.int64)
    of = np.asarray(made.face_id).astype(np.int64)
    points = np.asarray(made.vert_properties)[:, :3].astype(np.float64)
    solids = np.full(len(of), surface.solids[shells[0][0]])
    return points, triangles, surface.groups[of], solids


def _beside(
    surface: Surface, points: FloatArray, triangles: IntArray, groups: IntArray, solids: IntArray
) -> Surface:
    return replace(
        surface,
        points=np.concatenate([surface.points, points]),
        triangles=np.concatenate([surface.triangles, triangles + len(surface.points)]),
        groups=np.concatenate([surface.groups, groups]),
        solids=np.concatenate([surface.solids, solids]),
    )


def volume_as_it_stood(surface: Surface) -> float:
    """Volume between the triangles, each once, and their middle, turned as most of their shell."""
    once = np.setdiff1d(np.arange(len(surface.triangles)), surface.doubled)
    turned, _ = _turned(surface.kept(once))
    return abs(float(signed_volumes(turned.corners).sum()))
