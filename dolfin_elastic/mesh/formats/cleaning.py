"""Faults of mesh files: corrected or refused on one rank, or checked by all ranks in shares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import agree, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray
from dolfin_elastic.mesh.body import connected_components
from dolfin_elastic.mesh.formats.raw import RawMesh, format_points


def clean(raw: RawMesh) -> RawMesh:
    """Corrects what DOLFINx could not read, with a note for each correction.

    Local: called on one rank.

    Raises:
        MeshError: A fault that cannot be corrected.
    """
    steps: list[Callable[[RawMesh], RawMesh]] = [
        _indices,
        _duplicates,
        _used,
        _numbers,
        _planar,
        _collapsed,
        _branching,
        _pieces,
    ]
    for step in steps:
        raw = step(raw)
    return raw


def straight(raw: RawMesh) -> RawMesh:
    """The mesh with straight cells: the midside nodes of quadratic ones are left out.

    Local: called on one rank.  Sets of nodes that are surfaces lose them without harm; others that
    hold some are not whole any more.
    """
    if raw.order == 1:
        return raw
    midside = np.zeros(len(raw.points), dtype=bool)
    midside[raw.cells] = True
    midside[_corners(raw)] = False
    covered = raw.surfaces.keys() - raw.uncovered.keys()
    nodes = {n: rows[~midside[rows]] if n in covered else rows for n, rows in raw.nodes.items()}
    count = np.count_nonzero(midside)
    text = f"quadratic elements read as straight ones, without {count} midside nodes"
    raw = replace(
        raw,
        cells=_corners(raw),
        order=1,
        nodes=nodes,
        information=(*raw.information, text),
    )
    return _restricted(raw, ~midside, "are midside nodes, which straight elements have not")


def _noted(raw: RawMesh, note: str, **changes: object) -> RawMesh:
    return replace(raw, notes=(*raw.notes, note), **changes)  # type: ignore[arg-type]


def _corners(raw: RawMesh) -> IntArray:
    return raw.cells[:, : raw.dim + 1]


def _midpoints(raw: RawMesh, rows: BoolArray | IntArray) -> FloatArray:
    return np.asarray(raw.points[_corners(raw)[rows][:5]].mean(axis=1))


def _near(raw: RawMesh, rows: BoolArray | IntArray, count: int) -> str:
    """Where cells are, of which there are `count`."""
    return format_points(_midpoints(raw, rows), count, raw.unit)


def _indices(raw: RawMesh) -> RawMesh:
    low, high = raw.cells.min(), raw.cells.max()
    if low < 0 or high >= len(raw.points):
        raise MeshError(
            f"elements refer to the point {high if high >= len(raw.points) else low}, "
            f"but there are {len(raw.points)} points"
        )
    return raw


def _duplicates(raw: RawMesh) -> RawMesh:
    corners = np.sort(_corners(raw), axis=1)
    order = np.lexsort(corners.T)
    new = np.ones(len(order), dtype=bool)
    new[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    if new.all():
        return raw
    # lexsort is stable: of equal cells the first remains.
    keep = np.sort(order[new])
    first = np.empty(len(order), dtype=np.int64)
    first[order] = np.searchsorted(keep, order[new])[np.cumsum(new) - 1]
    count = len(order) - len(keep)
    again = np.setdiff1d(np.arange(len(order)), keep)
    note = f"{count} duplicate elements (removed) {_near(raw, again, count)}"
    regions = {name: np.unique(first[rows]) for name, rows in raw.regions.items()}
    data = {name: values[keep] for name, values in raw.cell_data.items()}
    return _noted(raw, note, cells=raw.cells[keep], regions=regions, cell_data=data)


def _used(raw: RawMesh) -> RawMesh:
    used = np.zeros(len(raw.points), dtype=bool)
    used[raw.cells] = True
    unused = int(np.count_nonzero(~used))
    if unused == 0:
        return raw
    note = unused_text(unused, len(used))
    rest = _restricted(raw, used, "belong to no element")
    return replace(rest, information=(*rest.information, note))


def _restricted(raw: RawMesh, used: BoolArray, why: str) -> RawMesh:
    """The mesh with the points in use; parts that lose members with others are not whole."""
    new = np.cumsum(used) - 1
    kept: dict[str, dict[str, IntArray]] = {"surfaces": {}, "edges": {}, "nodes": {}}
    incomplete = dict(raw.incomplete)
    for parts, things in zip(kept, ("facets", "edges", "nodes"), strict=True):
        for name, rows in getattr(raw, parts).items():
            inside = used[rows].reshape(len(rows), -1).all(axis=1)
            if not inside.all():
                lost = f"{np.count_nonzero(~inside)} of its {len(rows)} {things}"
                incomplete.setdefault(name, f"{lost} {why}")
            kept[parts][name] = new[rows[inside]]
    data = {name: values[used] for name, values in raw.point_data.items()}
    whole = {n: used[rows].all(axis=1) for n, rows in raw.face_facets.items()}
    of_faces = {n: new[rows[whole[n]]] for n, rows in raw.face_facets.items()}
    normals = {n: rows[whole[n]] for n, rows in raw.face_normals.items()}
    return replace(
        raw,
        points=raw.points[used],
        face_facets=of_faces,
        face_normals=normals,
        cells=new[raw.cells],
        point_data=data,
        incomplete=incomplete,
        surfaces=kept["surfaces"],
        edges=kept["edges"],
        nodes=kept["nodes"],
    )


def _numbers(raw: RawMesh) -> RawMesh:
    bad = np.flatnonzero(~np.isfinite(raw.points).all(axis=1))
    if len(bad):
        raise MeshError(
            f"{len(bad)} points have coordinates that are not numbers",
            expected=f"the first is point {bad[0] + 1} of those in use",
        )
    return raw


def _planar(raw: RawMesh) -> RawMesh:
    """Drops the third coordinate of a plane body."""
    if raw.dim == 3 or raw.points.shape[1] == 2:
        return raw
    spread = np.ptp(raw.points, axis=0)
    if spread[2] > 1e-8 * spread.max():
        raise MeshError(
            f"the mesh is a surface in space: {len(raw.cells)} triangles, z from "
            f"{raw.points[:, 2].min():.6g} to {raw.points[:, 2].max():.6g}",
            expected="shells are not supported: a volume mesh of tetrahedra is "
            "needed, or triangles in a plane z = constant",
        )
    return replace(raw, points=raw.points[:, :2])


def _collapsed(raw: RawMesh) -> RawMesh:
    nodes = np.sort(raw.cells, axis=1)
    bad = (nodes[:, 1:] == nodes[:, :-1]).any(axis=1)
    if bad.any():
        count = np.count_nonzero(bad)
        raise MeshError(
            f"{count} elements use the same point twice, {_near(raw, bad, count)}",
            expected="remesh there",
        )
    return raw


def _branching(raw: RawMesh) -> RawMesh:
    """Refuses facets between more than two cells: the body would overlap itself."""
    corners = _corners(raw)
    facets = np.sort(
        np.concatenate([np.delete(corners, i, axis=1) for i in range(raw.dim + 1)]), axis=1
    )
    order = np.lexsort(facets.T)
    facets = facets[order]
    third = (facets[2:] == facets[:-2]).all(axis=1)
    if third.any():
        where = raw.points[facets[2:][third][:5]].mean(axis=1)
        count = np.count_nonzero(third)
        raise MeshError(
            f"{count} facets lie between three or more elements: the mesh overlaps "
            f"itself, {format_points(where, count, raw.unit)}",
            expected="remesh there",
        )
    second = np.flatnonzero((facets[1:] == facets[:-1]).all(axis=1))
    return _hinged(raw, order[second] % len(corners), order[second + 1] % len(corners))


def _hinged(raw: RawMesh, here: IntArray, there: IntArray) -> RawMesh:
    """Notes pieces that share nodes and no facet, from the cells on both sides of inner facets."""
    corners = _corners(raw)
    pieces, label = connected_components(len(corners), np.stack([here, there], axis=1))
    if pieces == 1:
        return raw
    of_nodes = np.stack([corners.ravel(), np.repeat(label, raw.dim + 1)], axis=1)
    nodes, count = np.unique(np.unique(of_nodes, axis=0)[:, 0], return_counts=True)
    shared = nodes[count > 1]
    if not len(shared):
        return raw
    return _noted(
        raw,
        f"pieces of the mesh share {len(shared)} nodes but no facet, "
        f"{format_points(raw.points[shared], len(shared), raw.unit)}: they are hinged there, where "
        "stress is singular, and may turn freely about them",
    )


def _pieces(raw: RawMesh) -> RawMesh:
    corners, n = _corners(raw), len(raw.points)
    _, label = connected_components(n, corners)
    sizes = np.bincount(label[corners[:, 0]])
    sizes = np.sort(sizes[sizes > 0])[::-1]
    if len(sizes) == 1:
        return raw
    text = ", ".join(str(s) for s in sizes[:5]) + (" ..." if len(sizes) > 5 else "")
    raw = _noted(
        raw,
        f"the mesh is in {len(sizes)} unconnected pieces of {text} elements: each "
        "moves on its own where no contact or [[tie]] holds it",
    )
    same = _same_places(raw, label)
    if not len(same):
        return raw
    return _noted(
        raw,
        f"{len(same)} nodes of different pieces have the same coordinates, "
        f"{format_points(raw.points[same], len(same), raw.unit)}: the pieces touch there and are "
        "not joined; where they are to be, merge the nodes (in Gmsh: Coherence Mesh;), or "
        "[[tie]] their surfaces",
    )


def _same_places(raw: RawMesh, piece: IntArray) -> IntArray:
    """Vertices that are where one of another piece is, one of each place."""
    nodes = np.unique(_corners(raw))
    near = 1e-9 * np.linalg.norm(np.ptp(raw.points[nodes], axis=0))
    coordinates = np.round(raw.points[nodes] / near)
    order = np.lexsort((piece[nodes], *coordinates.T))
    here, there = order[:-1], order[1:]
    same = (coordinates[here] == coordinates[there]).all(axis=1) & (
        piece[nodes[here]] != piece[nodes[there]]
    )
    return np.asarray(nodes[there[same]])


def check_distributed(comm: MPI.Comm, cells: IntArray, points: int, dim: int) -> None:
    """Refuses faults at which DOLFINx's mesh creation would abort in C++.

    Collective.

    Args:
        cells: This rank's share of the cells (global points, vertices first).
        points: Number of points in this rank's share.
        dim: 2 or 3.

    Raises:
        MeshError: Points that do not exist, duplicate cells, or facets between three cells.
    """
    agree(comm, _out_of_range(cells, int(total(comm, points))))
    corners = np.sort(cells[:, : dim + 1], axis=1)
    collapsed = int(total(comm, int((corners[:, 1:] == corners[:, :-1]).any(axis=1).sum())))
    if collapsed:
        raise MeshError(f"{collapsed} elements use the same point twice", expected="remesh")
    twice = int(total(comm, _repeated(comm, corners, corners.sum(axis=1)[None], 1)))
    if twice:
        raise MeshError(f"{twice} duplicate elements", expected="save each element once")
    sums = corners.sum(axis=1) - corners.T  # of the facet without each corner
    branching = int(total(comm, _repeated(comm, corners, sums, 2)))
    if branching:
        raise MeshError(
            f"{branching} facets lie between three or more elements: the mesh overlaps itself",
            expected="remesh",
        )


def unused_points(comm: MPI.Comm, cells: IntArray, points: int) -> IntArray:
    """Global numbers of the points that no cell uses, sorted, the same on all ranks. Collective.

    Args:
        cells: This rank's share of the cells, which `check_distributed` has looked at.
        points: Number of points in this rank's share.
    """
    starts = np.cumsum([0, *comm.allgather(points)])
    here = np.unique(cells)
    ends = np.searchsorted(here, starts)
    used = np.zeros(points, dtype=bool)
    for part in comm.alltoall([here[a:b] for a, b in pairwise(ends)]):
        used[part - starts[comm.rank]] = True
    local = starts[comm.rank] + np.flatnonzero(~used)
    return np.concatenate(comm.allgather(local.astype(np.int64)))


def without(numbers: IntArray, unused: IntArray) -> IntArray:
    """Numbers of points after others are left out. Not collective.

    Args:
        numbers: Before, of any shape.
        unused: What is left out, sorted.
    """
    return np.asarray(numbers - np.searchsorted(unused, numbers)) if len(unused) else numbers


def unused_text(count: int, points: int) -> str:
    """What is said of points that are left out."""
    return f"{count} of {points} points belong to no element (dropped)"


def _out_of_range(cells: IntArray, points: int) -> MeshError | None:
    bad = cells[(cells < 0) | (cells >= points)]
    if len(bad) == 0:
        return None
    return MeshError(f"elements refer to the point {bad[0]}, but there are {points} points")


_AT_ONCE = 1 << 18
"""Rows of a rank that are compared at a time: sorting them takes several times their memory."""


def _repeated(comm: MPI.Comm, corners: IntArray, sums: IntArray, most: int) -> int:
    """Number of cells or facets that occur more than `most` times, each on one rank. Collective.

    Args:
        corners: Points of cells in ascending order, shape (cells, corners).
        sums: Of the points of the cells, shape (1, cells), or of their facets without each
            corner, shape (corners, cells): equal ones go to the same rank at the same time.
    """
    rounds = 1 + int(comm.allreduce(sums.size, op=MPI.MAX)) // _AT_ONCE
    turns, result = sums % rounds, 0
    for turn in range(rounds):
        rows, ranks = [], []
        for i, (own, turn_of) in enumerate(zip(sums, turns, strict=True)):
            chosen = np.flatnonzero(turn_of == turn)
            rows.append(corners[chosen] if len(sums) == 1 else np.delete(corners[chosen], i, 1))
            ranks.append(own[chosen] // rounds % comm.size)
        target = np.concatenate(ranks)
        order = np.argsort(target, kind="stable")
        ends = np.searchsorted(target[order], np.arange(1, comm.size))
        sent = np.split(np.concatenate(rows)[order], ends)
        _, counts = np.unique(np.concatenate(comm.alltoall(sent)), axis=0, return_counts=True)
        result += int(np.count_nonzero(counts > most))
    return result
