"""The surface for which the facets of a boundary stand: where it has edges, and where it is round.

A mesh has facets where a body has a round face, and these meet at angles as at an edge.  Of a body
that was meshed from a CAD file the exact normals of the faces are known at the corners of each
facet: the normals on both sides agree within a face and where faces join smoothly, and differ at
edges.  Of other meshes the facets are all that is known.  There two facets whose normals differ by
up to 30 degrees are taken for parts of one smooth face, and by up to 60 degrees where the next edge
is parallel and has a like angle: a chain of such edges is an arc, a lone one an edge.

Facets of straight cells cut the arc off.  With normals n at the ends x of an edge the arc rises by
s = (n1 - n0) . (x1 - x0)/8 above its middle, and over a triangle by the mean of its three edges,
over a line by 2/3 of s.  In terms of the angles t between the facets this mean gap is

    A/6 sum(t/l) over the edges of length l of a triangle of area A,    l (t0 + t1)/24 of a line,

which is the same on a circle and on a sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import la
from dolfinx.mesh import Mesh

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import cell_gradients, facet_areas
from dolfin_elastic.mesh.geometry.ridges import Ridges, cell_ridges
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    facet_corners,
    longest_edges,
)

EDGE = np.deg2rad(10.0)
"""Angle between the exact normals of two faces from which on they meet in an edge.  At a re-entrant
one of 190 degrees the stress grows by 7 % where cells are halved."""
_SMOOTH, _ARC = np.deg2rad(30.0), np.deg2rad(60.0)
"""Angles between facets, see the module."""
_FLAT = np.deg2rad(1.0)
"""Below this angle two facets are parts of one that is flat."""
_ALIKE = 3.0
"""Largest ratio of the angles at neighbouring edges of an arc."""
_PARALLEL = 0.5
"""Least sum of the squared cosines between an edge and those at the next vertex."""


@dataclass(frozen=True)
class KnownSurface:
    """What is known of the surface beyond the places of the facets; all by `boundary_facets`.

    Attributes:
        normals: Its outward unit normals at the corners of each facet, shape (facets, d, d); NaN
            where they are not known.
        arcs: Whether each edge of a facet (in the plane each end) lies within an arc, as was found
            on the mesh that was refined, shape (facets, d): the edge opposite to corner k.  None
            on all ranks: it was not refined.
        gap: Mean height of the surface above the facet [m], shape (facets,); NaN where it follows
            from the facets.
        off: Largest distance of the nodes of each facet from the surface that they are to lie on
            [m], shape (facets,).
        surfaces: Number in the CAD model of the surface of each facet, 0: of none; shape (facets,).
            None on all ranks: it was not refined.
    """

    normals: FloatArray
    arcs: BoolArray | None
    gap: FloatArray
    off: FloatArray
    surfaces: IntArray | None = None


class BoundaryShape:
    """The shape of a body's boundary. Collective to make.

    Attributes:
        facets: Local facets of the boundary, each on one rank, shape (facets,).
        cells: The cell of each.
        numbers: Local ridge of that cell that each edge of the facet is, shape (facets, d); edge k
            is opposite to corner k.
        angles: Interior angle of the body at each edge [rad], shape (facets, d): exact where
            normals are known.
        turns: Angle between the two facets there [rad], negative where the body is re-entrant; 0
            where the edge has not two facets.
        smooth: Whether each edge lies within a smooth face, or where two join smoothly.
        arcs: Whether it lies within an arc of straight facets.
        exact: Whether exact normals are known on both sides.
    """

    def __init__(self, mesh: Mesh, known: KnownSurface | None = None) -> None:
        self.facets = boundary_facets(mesh)
        self._mesh, self._known = mesh, known
        self.cells, local = cells_beside_facets(mesh, self.facets)
        self._corners, self.numbers = facet_ridges(mesh.topology.dim, local)
        d = mesh.topology.dim
        self._ridges = Ridges(mesh, np.repeat(self.cells, d), self.numbers.reshape(-1))
        self._frames = _frames(mesh, self.cells, local)
        by_facets, edge = self._interior_angles(self._frames)
        self.turns = np.asarray(np.where(edge, np.pi - by_facets, 0.0))
        self.arcs, self.exact = self._arcs(), np.zeros_like(edge)
        self.angles = by_facets
        self.smooth: BoolArray = edge & ((np.abs(self.turns) < _SMOOTH) | self.arcs)
        if known is None:
            return
        frames = _exact_frames(known.normals, facet_corners(mesh, self.facets))
        given: BoolArray = np.asarray(np.isfinite(frames).all(axis=2))
        count = self._ridges.of_rows(given[..., None].astype(float))[..., 0]
        self.exact = np.asarray(edge & (count > 1.5))
        exact, _ = self._interior_angles(np.where(given[..., None], frames, self._frames))
        self.angles = np.where(self.exact, exact, by_facets)
        self.smooth = np.where(self.exact, np.abs(exact - np.pi) < EDGE, self.smooth)

    def _interior_angles(self, frames: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Interior angle at each edge of the facets, and whether two meet there. Collective."""
        rows = np.concatenate([frames, np.ones((*frames.shape[:2], 1))], axis=2)
        sums = self._ridges.of_rows(rows)
        normal, inward, count = sums[..., :3], sums[..., 3:6], sums[..., 6]
        # Of unit vectors a, b: |a + b|^2 = 2 + 2 a.b; seen from outside, a re-entrant edge is a
        # valley.
        cosine = np.clip(np.sum(inward**2, axis=-1) / 2 - 1, -1.0, 1.0)
        angle = np.arccos(cosine)
        valley = np.sum(normal * inward, axis=-1) > 0
        two = np.asarray(np.abs(count - 2) < 0.5)
        return np.asarray(np.where(valley, 2 * np.pi - angle, angle)), two

    # --- arcs of straight facets ---

    def _arcs(self) -> BoolArray:
        """Edges whose neighbour is parallel and has a like angle. Collective."""
        within = (np.abs(self.turns) > _FLAT) & (np.abs(self.turns) < _ARC)
        if not total(self._mesh.comm, int(within.any())):
            return within
        before = None if self._known is None else self._known.arcs
        alike = (self._next_is_alike() if before is None else before).astype(float)
        return within & (self._ridges.of_rows(alike[..., None])[..., 0] > 0.5)

    def _next_is_alike(self) -> BoolArray:
        """Whether at the corner opposite to each edge there are others like it. Collective."""
        mesh, d = self._mesh, self._mesh.topology.dim
        vertices = mesh.topology.connectivity(d, 0).array.reshape(-1, d + 1)
        vertices = np.take_along_axis(vertices[self.cells], self._corners, axis=1)
        along = self._along()
        marked = (np.abs(self.turns) > _FLAT) & (np.abs(self.turns) < _ARC)
        square = along[..., :, None] * along[..., None, :]
        # Two facets beside each edge add a half each.
        rows = np.stack([marked * 0.5, marked * 0.5 * self.turns], axis=-1)
        rows = (rows[..., None, None] * square[:, :, None]).reshape(*marked.shape, 2 * d * d)
        work = la.vector(mesh.topology.index_map(0), rows.shape[-1])
        table = work.array.reshape(-1, rows.shape[-1])
        for k in range(d):
            for end in range(d):
                if end != k:
                    np.add.at(table, vertices[:, end], rows[:, k])
        work.scatter_reverse(la.InsertMode.add)
        work.scatter_forward()
        there = table[vertices].reshape(*marked.shape, 2, d, d)
        count, turn = np.moveaxis(np.einsum("fki,fkmij,fkj->fkm", along, there, along), -1, 0)
        mean = turn / np.where(count > 0, count, 1.0)
        ratio = mean / np.where(marked, self.turns, np.inf)
        return np.asarray(
            marked & (count > _PARALLEL) & (ratio > 1 / _ALIKE) & (ratio < _ALIKE), dtype=bool
        )

    def _along(self) -> FloatArray:
        """Unit vectors along the edges of the facets; in the plane, where these are points, x."""
        d = self._mesh.topology.dim
        if d == 2:
            return np.broadcast_to(np.array([1.0, 0.0]), (len(self.facets), 2, 2))
        x = facet_corners(self._mesh, self.facets)
        along = np.stack([x[:, (k + 2) % 3] - x[:, (k + 1) % 3] for k in range(3)], axis=1)
        return np.asarray(along / np.linalg.norm(along, axis=2, keepdims=True))

    # --- how well facets follow the surface ---

    @cached_property
    def gap(self) -> FloatArray:
        """Mean height of the surface above each facet [m], negative where it lies below. Local.

        Zero of curved cells, whose facets follow it far better.
        """
        mesh, known = self._mesh, self._known
        d = mesh.topology.dim
        if mesh.geometry.cmap.degree > 1:
            return np.zeros(len(self.facets))
        turns, areas = np.where(self.arcs, self.turns, 0.0), facet_areas(mesh, self.facets)
        x = facet_corners(mesh, self.facets)
        if d == 2:
            result = areas * turns.sum(axis=1) / 24
        else:
            sides = np.stack([x[:, (k + 2) % 3] - x[:, (k + 1) % 3] for k in range(3)], axis=1)
            result = areas / 6 * (turns / np.linalg.norm(sides, axis=2)).sum(axis=1)
        if known is None:
            return np.asarray(result)
        result = np.where(np.isfinite(known.gap), known.gap, result)
        rises = [
            np.sum((known.normals[:, j] - known.normals[:, i]) * (x[:, j] - x[:, i]), axis=1) / 8
            for i in range(d)
            for j in range(i)
        ]
        exact = np.mean(rises, axis=0) * (2 / 3 if d == 2 else 1.0)
        return np.asarray(np.where(np.isfinite(exact), exact, result))

    @cached_property
    def turn(self) -> FloatArray:
        """Angle [rad] by which the surface turns along each facet, shape (facets,). Local.

        Of straight facets without exact normals that to the next one of the same face.  A facet of
        length h with nodes off the surface by s counts as the chord of an arc that rises by s,
        which turns by 4 atan(2 s/h).
        """
        kinks = np.where(self.smooth & (np.abs(self.turns) > _FLAT), np.abs(self.turns), 0.0)
        result = kinks.max(axis=1, initial=0.0)
        if self._mesh.geometry.cmap.degree > 1:  # normals vary linearly along quadratic facets
            result = np.maximum(result, 2 * _spread(self._frames[..., :3]))
        if self._known is not None:
            exact = _spread(self._known.normals)
            result = np.where(np.isfinite(exact), exact, result)
            length = longest_edges(facet_corners(self._mesh, self.facets))
            result = np.maximum(result, 4 * np.arctan2(2 * self.off, length))
        return result

    @property
    def off(self) -> FloatArray:
        """As `KnownSurface.off`; 0 where nothing is known. Local."""
        return np.zeros(len(self.facets)) if self._known is None else self._known.off

    @cached_property
    def bend(self) -> FloatArray:
        """Largest curvature of each facet's surface [1/m], negative where it is re-entrant. Local.

        That of the linear map from steps in the facet to changes of the normal, which is exact on
        cylinders and spheres; shape (facets,).
        """
        x, normals = facet_corners(self._mesh, self.facets), self._corner_normals()
        steps, changes = x[:, 1:] - x[:, :1], normals[:, 1:] - normals[:, :1]
        if self._mesh.topology.dim == 2:
            return np.asarray(np.sum(steps * changes, axis=(1, 2)) / np.sum(steps**2, axis=(1, 2)))
        first = _unit(steps[:, 0])
        plane = np.stack([first, _unit(_without(steps[:, 1], first))], axis=2)
        changes, steps = changes @ plane, steps @ plane
        result = np.linalg.solve(steps, changes)
        values = np.linalg.eigvalsh((result + np.swapaxes(result, 1, 2)) / 2)
        largest = np.argmax(np.abs(values), axis=1)[:, None]
        return np.asarray(np.take_along_axis(values, largest, axis=1)[:, 0])

    def _corner_normals(self) -> FloatArray:
        """Normals at the corners, exact or about those of the facets; shape (facets, d, d)."""
        d = self._mesh.topology.dim
        middles = self._frames[..., :d]
        if self._mesh.geometry.cmap.degree == 1:
            half = np.where(self.smooth, self.turns, 0.0) / 2
            middles = middles - half[..., None] * self._frames[..., 3 : 3 + d]
        # Of normals that vary linearly, those at the middles of edges give those at the corners.
        result = middles.sum(axis=1, keepdims=True) - 2 * middles if d == 3 else middles[:, ::-1]
        if self._known is not None:
            result = np.where(np.isfinite(self._known.normals), self._known.normals, result)
        return np.asarray(result)

    def known(self) -> KnownSurface:
        """What a mesh that is refined from this one takes over."""
        d = self._mesh.topology.dim
        normals = np.full((len(self.facets), d, d), np.nan)
        if self._known is not None:
            normals = self._known.normals
        gap = np.where(np.isfinite(normals).all(axis=(1, 2)), np.nan, self.gap)
        return KnownSurface(normals, self.arcs, gap, self.off)


def _spread(normals: FloatArray) -> FloatArray:
    """Largest angle between the n unit normals of each facet; NaN of unknown ones."""
    result = np.zeros(len(normals))
    for i in range(normals.shape[1]):
        for j in range(i):
            apart = np.linalg.norm(normals[:, i] - normals[:, j], axis=1)
            result = np.maximum(result, 2 * np.arcsin(np.minimum(apart / 2, 1.0)))
    return result


def facet_vertices(dim: int) -> IntArray:
    """Local vertices of the corners of each facet of a cell, shape (dim + 1, dim)."""
    return np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])


def facet_ridges(dim: int, local: IndexArray) -> tuple[IntArray, IndexArray]:
    """Local vertices of facets, and local ridges of their cells opposite to each.

    Args:
        local: Number of each facet in its cell, shape (facets,).

    Returns:
        Shape (facets, dim) both.
    """
    corners = facet_vertices(dim)
    ridges = [{int(k) for k in row} for row in cell_ridges(dim)]
    facets = [[int(k) for k in row] for row in corners]
    numbers = [[ridges.index({*row} - {k}) for k in row] for row in facets]
    return corners[local], np.array(numbers, dtype=np.int32)[local]


def _frames(mesh: Mesh, cells: IndexArray, local: IndexArray) -> FloatArray:
    """Outward normal and direction into the facet at its edges, shape (facets, d, 6). Local."""
    d = mesh.topology.dim
    result = np.zeros((len(cells), d, 6))
    for facet in range(d + 1):
        rows = np.flatnonzero(local == facet)
        nodes = mesh.geometry.x[mesh.geometry.dofmap[cells[rows]], :d]
        corners, numbers = facet_ridges(d, np.array([facet]))
        for k in range(d):
            ridge = tuple(cell_ridges(d)[numbers[0, k]])
            frame = _frame(nodes, mesh.geometry.cmap.degree, facet, ridge, int(corners[0, k]))
            result[rows, k] = frame
    return result


def _frame(
    nodes: FloatArray, degree: int, facet: int, ridge: tuple[int, ...], other: int
) -> FloatArray:
    """As `_frames`, at one edge of one facet of cells by their nodes, shape (cells, 6)."""
    dim = nodes.shape[2]
    corners = np.concatenate([np.zeros((1, dim)), np.eye(dim)])
    middle = corners[list(ridge)].mean(axis=0)
    J = cell_gradients(nodes, degree, middle[None])[:, 0]
    outward = np.ones(dim) if facet == 0 else -np.eye(dim)[facet - 1]
    n = np.einsum("cji,j->ci", np.linalg.inv(J), outward)
    inward = J @ (corners[other] - middle)
    if dim == 3:
        along = J @ (corners[ridge[1]] - corners[ridge[0]])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        inward -= np.sum(inward * along, axis=1, keepdims=True) * along
    result = np.zeros((len(nodes), 6))
    result[:, :dim] = n / np.linalg.norm(n, axis=1, keepdims=True)
    result[:, 3 : 3 + dim] = inward / np.linalg.norm(inward, axis=1, keepdims=True)
    return result


def _exact_frames(normals: FloatArray, x: FloatArray) -> FloatArray:
    """As `_frames`, from the exact normals at the corners; NaN where these are not known."""
    d = normals.shape[1]
    result = np.zeros((len(normals), d, 6))
    for k in range(d):
        ends = [j for j in range(d) if j != k]
        n = _unit(normals[:, ends].sum(axis=1))
        inward = x[:, k] - x[:, ends].mean(axis=1)
        inward = _without(inward, n)
        if d == 3:  # both in the tangent plane, so that they agree on both sides of a smooth edge
            inward = _without(inward, _unit(_without(x[:, ends[1]] - x[:, ends[0]], n)))
        result[:, k, :d], result[:, k, 3 : 3 + d] = n, _unit(inward)
    return result


def _without(vectors: FloatArray, direction: FloatArray) -> FloatArray:
    """Vectors less their components along unit vectors, shape (n, d)."""
    return np.asarray(vectors - np.sum(vectors * direction, axis=1, keepdims=True) * direction)


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1; NaN of those that have none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, np.nan))
