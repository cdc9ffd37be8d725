"""`Faces`: how deep a surface and what it touches are in each other, between their vertices, too.

Pressures follow gaps at vertices, or their means around them: an edge that enters a face between
its vertices is not seen by them.  Here every face is compared with an obstacle at a lattice of its
points; and the edges and corners of an obstacle, or the vertices of another body, with the faces:
a point within an element behind the surface lies as deep as the nearest face is far.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import basix
import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import facet_points, facet_shape_functions
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, dofs_on_facets
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose

LATTICE = 4
"""Parts of an edge of a face between the points that are looked at."""

UNSEEN = 0.25
"""Depth beyond that of the vertices, over the longest edge of the face, that no state may have.

The sag of a face over a ball is an eighth of its edge times that over the radius: a face as long as
the ball's diameter has this depth.  The edge of a box that statics presses into one grows from 0.05
to it while vertices beside it still carry half of what smaller faces would.
"""

_INSIDE, _CHUNK = 1e-9, 2_000_000


class Depth(NamedTuple):
    """A deepest point; the larger one is the first that counts.

    Attributes:
        unseen: Depth beyond what vertices see, over the longest edge of the face.
        depth: How deep it is [m].
        size: Longest edge of the face there, as it is now [m].
        place: Reference place on the face [m].
    """

    unseen: float = 0.0
    depth: float = 0.0
    size: float = 0.0
    place: tuple[float, ...] = ()


class Faces:
    """Facets of a surface that a rank owns, with the elements that touch their vertices.

    Args:
        facets: Local ones.
    """

    def __init__(self, context: FormContext, facets: IndexArray) -> None:
        mesh, V, d = context.body.mesh, context.unknowns.V, context.body.dim
        self._nodes = dofs_on_facets(V, facets)
        local, self._parts = _lattice(d)
        if context.unknowns.degree == 1:
            self._parts = np.arange(d)[None]
        self._X, _ = facet_points(mesh, facets, local)
        self._shapes = facet_shape_functions(d, context.unknowns.degree, local)
        touched = np.zeros(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, bool)
        touched[self._nodes[:, :d]] = True
        beside = touched[V.dofmap.list[:, : d + 1]].any(axis=1)
        self._cells = V.dofmap.list[beside, : d + 1]
        corners = mesh.geometry.dofmap[:, : d + 1]
        self._corners = mesh.geometry.x[corners[beside], :d]
        cells, opposite = cells_beside_facets(mesh, facets)
        self._behind = V.dofmap.list[cells, opposite]
        self._deep = mesh.geometry.x[corners[cells, opposite], :d]

    def at(self, u: FloatArray) -> MovedFaces:
        """Them where a displacement of all local nodes, (nodes, dim), puts them."""
        x, cells = self._X + self._shapes @ u[self._nodes], self._corners + u[self._cells]
        return MovedFaces(self._X, x, self._deep + u[self._behind], cells, self._parts)


def _lattice(d: int) -> tuple[FloatArray, IntArray]:
    """Vertices and a lattice of points of the reference facet, and the parts between these."""
    cell = basix.CellType.interval if d == 2 else basix.CellType.triangle
    found = basix.create_lattice(cell, LATTICE, basix.LatticeType.equispaced, exterior=True)
    points = np.asarray(found).reshape(-1, d - 1)
    at = {tuple(row): k + d for k, row in enumerate(np.rint(LATTICE * points).astype(int).tolist())}
    shifts = [[(0,), (1,)]] if d == 2 else [[(0, 0), (1, 0), (0, 1)], [(1, 0), (1, 1), (0, 1)]]
    corners = [
        [at.get(tuple(np.add(row, shift).tolist())) for shift in shape]
        for row in at
        for shape in shifts
    ]
    return np.vstack([np.eye(d)[:, 1:], points]), np.array(
        [one for one in corners if None not in one]
    )


class MovedFaces(NamedTuple):
    """Faces at some state.

    Attributes:
        X: Reference places of their vertices and the other points, (faces, points, dim) [m].
        x: Where these are.
        behind: Where the vertex behind each face is, (faces, dim) [m].
        cells: Where the vertices of the elements are, (elements, dim + 1, dim) [m].
        parts: Points at the vertices of flat parts of each face, (parts, dim).
    """

    X: FloatArray
    x: FloatArray
    behind: FloatArray
    cells: FloatArray
    parts: IntArray

    @property
    def corners(self) -> FloatArray:
        """Places of the vertices, (faces, dim, dim) [m]."""
        return self.x[:, : self.x.shape[2]]

    @property
    def sizes(self) -> FloatArray:
        """Longest edges [m]."""
        corners = self.corners
        return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0)

    def some(self, which: BoolArray) -> MovedFaces:
        """Some of the faces."""
        faces = self.X[which], self.x[which], self.behind[which]
        return MovedFaces(*faces, self.cells, self.parts)

    def seen_from(self, pose: Pose) -> MovedFaces:
        """They as an obstacle sees them, where they are less its displacement."""
        x, behind, cells = (pose.seen(at) for at in (self.x, self.behind, self.cells))
        return MovedFaces(self.X, x, behind, cells, self.parts)

    def under(self, gaps: FloatArray) -> Depth:
        """The deepest of the points under an obstacle. Local.

        Args:
            gaps: Of all points, shape (faces, points) [m].
        """
        if not len(gaps):
            return Depth()
        seen = np.maximum(0.0, -gaps[:, : self.x.shape[2]].min(axis=1))
        depths, sizes = np.maximum(0.0, -gaps.min(axis=1)), self.sizes
        at = self.X[np.arange(len(gaps)), gaps.argmin(axis=1)]
        return _deepest(depths, depths - seen, sizes, at)

    def entered(self, edges: FloatArray, seen: FloatArray, rounding: float = 0.0) -> Depth:
        """The deepest of points of edges that are within elements behind the faces. Local.

        Args:
            edges: Ends of each, shape (n, 2, dim) [m]; of points both are alike.
            seen: Depth at the faces that vertices see [m].
            rounding: Radius around the edges that belongs to what enters [m].
        """
        d, found = self.x.shape[2], [self.x[:0, 0]]
        if not len(self.x) or not len(edges):
            return Depth()
        T = (self.cells[:, 1:] - self.cells[:, :1]).swapaxes(1, 2)
        for c, e in self._near(edges):
            arms = (edges[e] - self.cells[c, :1])[..., None]
            along = np.linalg.solve(T[c][:, None], arms)[..., 0]
            whole = np.concatenate([1 - along.sum(axis=2, keepdims=True), along], axis=2)
            start, change = whole[:, 0], whole[:, 1] - whole[:, 0]
            with np.errstate(divide="ignore", invalid="ignore"):
                cuts = (-_INSIDE - start) / change
            never = np.where((change == 0) & (start < -_INSIDE), np.inf, 0.0)
            low = np.where(change > 0, cuts, never).max(axis=1, initial=0.0)
            high = np.where(change < 0, cuts, 1.0).min(axis=1, initial=1.0)
            some = low <= high
            share = np.stack([low, (low + high) / 2, high], axis=1)[some, :, None]
            ends = edges[e[some]]
            found.append((ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])).reshape(-1, d))
        points = np.unique(np.concatenate(found), axis=0)
        if not len(points):
            return Depth()
        depths, f = self._depths(points)
        at = self.X[f, :d].mean(axis=1)
        return _deepest(depths + rounding, depths + rounding - seen[f], self.sizes[f], at)

    def _near(self, edges: FloatArray) -> Iterator[tuple[IntArray, IntArray]]:
        """Elements and edges whose boxes overlap, some at a time."""
        low, high = self.cells.min(axis=1), self.cells.max(axis=1)
        lowest, highest = edges.min(axis=1), edges.max(axis=1)
        near = (lowest <= high.max(axis=0)) & (highest >= low.min(axis=0))
        some = np.flatnonzero(near.all(axis=1))
        rows = max(1, _CHUNK // max(len(some), 1))
        for first in range(0, len(low) if len(some) else 0, rows):
            here = slice(first, first + rows)
            meets = (lowest[some] <= high[here, None]) & (highest[some] >= low[here, None])
            c, e = np.nonzero(meets.all(axis=2))
            yield c + first, some[e]

    def _depths(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """How far points lie behind the nearest face, or from its edges [m]; and which it is."""
        d, count = self.x.shape[2], len(self.parts)
        corners = self.x[:, self.parts].reshape(-1, d, d)
        depths, faces = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        T = corners[:, 1:] - corners[:, :1]
        n = np.stack([T[:, 0, 1], -T[:, 0, 0]], axis=1) if d == 2 else np.cross(T[:, 0], T[:, 1])
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
        inward = np.repeat(self.behind, count, axis=0) - corners[:, 0]
        n = n * np.sign(np.einsum("fd,fd->f", inward, n))[:, None]
        dual = np.linalg.pinv(T.swapaxes(1, 2))
        rows = max(1, _CHUNK // (8 * len(corners)))
        for first in range(0, len(points), rows):
            here = slice(first, first + rows)
            arms = points[here, None, None] - corners
            s = np.einsum("fad,pfd->pfa", dual, arms[:, :, 0])
            over = (s >= -_INSIDE).all(axis=2) & (s.sum(axis=2) <= 1 + _INSIDE)
            ahead = np.einsum("pfd,fd->pf", arms[:, :, 0], n)
            far = np.full(over.shape, np.inf)
            for k in range(d):  # in a plane these are the ends
                side = corners[:, (k + 1) % d] - corners[:, k] if d > 2 else 0 * corners[:, k]
                square = np.sum(side * side, axis=1) + (d == 2)
                t = np.clip(np.einsum("pfd,fd->pf", arms[:, :, k], side) / square, 0.0, 1.0)
                off = np.linalg.norm(arms[:, :, k] - t[..., None] * side, axis=2)
                far = np.minimum(far, off)
            far = np.where(over, ahead, far)
            nearest = np.abs(far).argmin(axis=1)
            faces[here], depths[here] = nearest // count, far[np.arange(len(far)), nearest]
        return depths, faces


def deepest_of(comm: MPI.Comm, *local: Depth) -> Depth:
    """The deepest of several on all ranks. Collective."""
    every = [one for part in comm.allgather(local) for one in part]
    return max(every)._replace(depth=max(one.depth for one in every))


def _deepest(depths: FloatArray, unseen: FloatArray, sizes: FloatArray, at: FloatArray) -> Depth:
    """The point that is most unseen, with the depth of the deepest."""
    k = int(np.argmax(unseen / sizes))
    place = tuple(float(one) for one in at[k].round(12))
    share, deepest = float(unseen[k] / sizes[k]), float(depths.max())
    return Depth(max(share, 0.0), max(deepest, 0.0), float(sizes[k]), place)


def vertices_near(comm: MPI.Comm, faces: MovedFaces, others: MovedFaces) -> FloatArray:
    """Vertices of the faces of all ranks near the elements of others, (n, 2, dim). Collective."""
    d = faces.x.shape[2]
    boxes = comm.allgather(
        [
            others.cells.min(axis=(0, 1), initial=np.inf),
            others.cells.max(axis=(0, 1), initial=-np.inf),
        ]
    )
    points = faces.corners.reshape(-1, d)
    parts = [points[((points >= low) & (points <= high)).all(axis=1)] for low, high in boxes]
    found = np.unique(np.concatenate(comm.alltoall(parts)), axis=0)
    return np.stack([found, found], axis=1)
