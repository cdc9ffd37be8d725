"""`PieceFunctions`: functions of vertices by which contact between two surfaces is weighted.

Faces of the side that carries the pressures and of the other one are cut by each other where they
lie now, see `ties.segments`; a point of these pieces is compared with the nearest one of the other
side's face, which is curved where the face is quadratic.  With the places x_s and x_m of both and
the outward normal n of the other side there, the gap is

    g = n . (x_s - x_m),    its first variation    n . (N_s du_s - N_m du_m),

for x_s - x_m is along n.  Relative to the other side, and its normal carried along, the point moves
by

    N_s du_s - N_m du_m - g dn,    dn = - sum of (n . N_m,i du_m) a_i

with the dual tangents a_i: not at all where both sides turn together.  So forces on both sides have
no moment, neither that of the pressures nor that of friction.  The functions are those of
`VertexFunctions` on the carrying side, made of the part of each face that lies opposite something;
areas are those of the reference surface.

Source: B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989; T. Cichosz & M. Bischoff, Comput.
Methods Appl. Mech. Engrg. 200 (2011) 1317 (faces covered in part); P. Wriggers, Computational
Contact Mechanics, 2nd ed., Springer 2006, section 4.1 (nearest points).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.constraints.ties.exchange import Owners
from dolfin_elastic.problem.constraints.ties.facets import Facets, areas, opposite, owned
from dolfin_elastic.problem.constraints.ties.segments import Pairs, Segments, pairs_of
from dolfin_elastic.problem.constraints.ties.shapes import (
    shape_bends,
    shape_functions,
    shape_slopes,
)
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.vertex_functions import VertexFunctions

COVERED = 1e-3
"""Share of a vertex's area that lies opposite something from which on there is contact."""

AROUND = 3.0
"""Pieces of a face that is in reach, over this reach: all, also where the gap widens."""

NEWTON = 6
"""Iterations to the nearest point of a quadratic face: they converge quadratically."""

_NONE = 1e-20
"""Share of a vertex's area that counts as none."""

_SINGULAR = 1e-12
"""Eigenvalue of a face's mass matrix over its largest below which it is round-off."""


class Side:
    """The facets of one side that this rank owns. Collective to make.

    Attributes:
        nodes: Global nodes of the displacement, shape (facets, nodes).
        X: Reference places of the nodes of the displacement or of the geometry, whichever are
            more, shape (facets, nodes, dim) [m].
        moved: Displacements of these from those of `nodes`, shape (nodes of `X`, nodes).
        vertices: Local vertices in the space of multipliers, shape (facets, dim).
    """

    def __init__(self, context: FormContext, names: Sequence[str], S: fem.FunctionSpace) -> None:
        body, V = context.body, context.unknowns.V
        found = owned(body, V, names)
        self.nodes, shape = found.nodes, found.nodes.shape
        count = max(found.x.shape[1], shape[1])
        self.X = at_more_nodes(body.dim, found.x.shape[1], count) @ found.x
        self.moved = at_more_nodes(body.dim, shape[1], count)
        self._local = V.dofmap.index_map.global_to_local(self.nodes.ravel()).reshape(shape)
        vertices = owned(body, S, names).nodes
        self.vertices = S.dofmap.index_map.global_to_local(vertices.ravel()).reshape(vertices.shape)

    def at(self, u: FloatArray) -> Facets:
        """The facets where a displacement puts them. Local."""
        moved = u.reshape(-1, self.X.shape[2])[self._local]
        return Facets(self.X + self.moved @ moved, self.nodes)


def at_more_nodes(d: int, few: int, many: int) -> FloatArray:
    """What a facet with so many nodes has at them from values at few, shape (many, few)."""
    ends = np.eye(d)
    middle = [(ends[i] + ends[j]) / 2 for i, j in ([(0, 1)], [(1, 2), (0, 2), (0, 1)])[d - 2]]
    return shape_functions(np.vstack([ends, *middle])[None, :many], few)[0]


class Opposite(NamedTuple):
    """What of the other side lies opposite the points, each array shape (pieces, points, ...).

    Attributes:
        gap: Distance along the normal [m].
        normal: Of the other side, outward, (..., dim).
        tangents: dx/dxi of the face, (..., dim, dim - 1) [m].
        bend: n . d2x/dxi2, (..., dim - 1, dim - 1) [m].
        slopes: Of the shape functions of the displacement, (..., nodes, dim - 1).
    """

    gap: FloatArray
    normal: FloatArray
    tangents: FloatArray
    bend: FloatArray
    slopes: FloatArray


class OnFaces(NamedTuple):
    """The functions psi = w dual l on the faces of the carrying side, with their hats l.

    Attributes:
        dual: Shape (faces, dim, dim).
        inverse: Of the mass matrices [1/m^2].
        means: Integrals of the hats, shape (faces, dim) [m^2].
        share: Part of each face by which `dual` is biorthogonal.
    """

    dual: FloatArray
    inverse: FloatArray
    means: FloatArray
    share: FloatArray


class PieceFunctions(VertexFunctions):
    """The functions of a contact between two surfaces. Collective to make.

    "Facets" are pieces here.  Nodes are those of both sides, and shape functions of the other side
    are negative, so that displacements are those relative to it.

    Args:
        pair: The contact, of whose carrying side its multiplier is a field.
        sides: Names of the surfaces of the carrying and of the other side.
        reach: Distance beyond which nothing lies opposite [m].
        thickness: Of a plane body [m].
        u: The displacement; by default the present one.

    Attributes:
        reach: As given; the thickness, too.
        about_axis: The body is axisymmetric.
        share: Part of the area of each owned vertex that lies opposite something.
        covered: Of which of them enough does.
        opposed: Part of each owned face that lies opposite something.
        hats: Barycentric coordinates of the points, shape (pieces, points, dim).
        there: What lies opposite the points.
        near: Faces of the carrying side.
        pairs: What was cut.
        near_enough: Of which of these faces something lies within reach.
        face: That of each piece.
        faces: The functions on these.
        opposite_hats: Barycentric coordinates there.
        fading: Overlaps that do not act yet, at vertices; None: there are none [m].
    """

    def __init__(
        self,
        pair: ContactPair,
        context: FormContext,
        sides: Sequence[Sequence[str]],
        reach: float,
        thickness: float,
        u: fem.Function | None = None,
    ) -> None:
        self._u = context.unknowns.u if u is None else u
        S, V = pair.lam.function_space, context.unknowns.V
        self._context, self._pair, self._dim = context, pair, context.body.dim
        self._map, self._node_map = S.dofmap.index_map, V.dofmap.index_map
        self._owners = Owners(pair.comm, self._map.local_range[0], self._map.size_local)
        nodes = self._node_map
        self.node_owners = Owners(pair.comm, nodes.local_range[0], nodes.size_local)
        self.near, self._far = (Side(context, names, S) for names in sides)
        self.reach, self.thickness, self.about_axis = reach, thickness, context.axisymmetric
        self.fading: fem.Function | None = None
        around = 2 * np.pi if context.axisymmetric else 1.0
        faces = Facets(self.near.X, self.near.nodes)
        whole = thickness * around / self._dim * areas(faces, axisymmetric=context.axisymmetric)
        self._vertices = self.near.vertices
        self._whole = self.summed(np.repeat(whole[:, None], self._dim, axis=1)[..., None])[:, 0]
        self._at: FloatArray = np.empty(0)
        self.renew()

    # --- where the two sides are now ---

    def renew(self) -> bool:
        """Cuts the faces anew if anything has moved; False: a place is not finite. Collective."""
        pair, u = self._pair, self._u.x.array
        moved, finite = not np.array_equal(u, self._at), bool(np.all(np.isfinite(u)))
        changes = total(pair.comm, np.array([moved, not finite], dtype=float))
        if changes[1] > 0.0:
            return False
        if changes[0] > 0.0:
            self._at = u.copy()
            self.pairs = self._pairs(AROUND * self.reach)
            pieces = self.pairs.pieces()
            nearest = np.full(len(self.pairs.near.x), np.inf)
            np.minimum.at(nearest, pieces.near, pieces.gaps)
            self.near_enough = nearest <= self.reach
            self._take(self.pairs.near, self.pairs.far, pieces[self.near_enough[pieces.near]])
        return True

    def within(
        self, reach: float, motion: FloatArray | None = None
    ) -> tuple[Facets, Facets, Segments]:
        """Facets of both sides, and pieces that are no farther from each other. Collective.

        Args:
            motion: After this one of all local nodes [m].
        """
        pairs = self._pairs(reach, motion)
        return pairs.near, pairs.far, pairs.pieces()

    def _pairs(self, reach: float, motion: FloatArray | None = None) -> Pairs:
        """See `within`: what is cut. Collective."""
        u = self._u.x.array if motion is None else self._u.x.array + motion
        near = self.near.at(u)
        far = opposite(self._pair.comm, near, self._far.at(u), reach)
        return pairs_of(near, far, reach, facing=True)

    def farthest(self, motion: FloatArray) -> float:
        """By how much a motion of all local nodes moves both sides together [m]. Collective."""
        ways = (side.at(motion).x - side.X for side in (self.near, self._far))
        most = [float(np.max(np.linalg.norm(way, axis=2), initial=0.0)) for way in ways]
        return sum(largest(self._pair.comm, one) for one in most)

    def gaps_over(
        self, motion: FloatArray, reach: float, offsets: FloatArray, *, after: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Gaps of all points that are within reach before or after a motion [m]. Collective.

        Args:
            motion: Of all local nodes [m].
            offsets: At local vertices, which gaps are less by [m].
            after: The points are those after it.

        Returns:
            Gaps before the motion, and their changes.
        """
        near, far, pieces = self.within(reach, motion if after else None)
        hats, there = self.lying_opposite(near, far, pieces)
        numbers = np.concatenate([near.nodes[pieces.near], far.nodes[pieces.far]], axis=1)
        shapes = relative_shapes(pieces.near_coordinates, hats, near.nodes.shape[1])
        change = np.sum(there.normal * (shapes @ self.values(motion, numbers)), axis=2)
        of = self.near.vertices[pieces.near]
        gaps = there.gap - np.einsum("nqi,ni->nq", pieces.near_coordinates, offsets[of])
        return gaps - change if after else gaps, change

    def nearest_within(self, reach: float) -> tuple[FloatArray, FloatArray]:
        """Gaps of the pieces that are nearest to each other of all, and places [m]. Collective."""
        _, _, pieces, gaps = self.signed_within(reach)
        least = smallest(self._pair.comm, float(np.min(pieces.gaps, initial=np.inf)))
        some = pieces.gaps <= least * (1 + 1e-9)
        return gaps[some], pieces.places[some]

    def signed_within(self, reach: float) -> tuple[Facets, Facets, Segments, FloatArray]:
        """See `within`; and gaps of the pieces, negative where they overlap [m]. Collective."""
        near, far, pieces = self.within(reach)
        inside = self.lying_opposite(near, far, pieces)[1].gap.mean(axis=1) < 0.0
        return near, far, pieces, np.where(inside, -pieces.gaps, pieces.gaps)

    def lying_opposite(
        self, near: Facets, far: Facets, pieces: Segments
    ) -> tuple[FloatArray, Opposite]:
        """See `_nearest`: of the points of pieces. Local."""
        s, i, j = pieces.near_coordinates, pieces.near, pieces.far
        x = np.einsum("nqk,nkd->nqd", shape_functions(s, near.x.shape[1]), near.x[i])
        return _nearest(x, far.x[j], pieces.far_coordinates, near.nodes.shape[1])

    def _take(self, near: Facets, far: Facets, pieces: Segments) -> None:
        s, i, j, k = pieces.near_coordinates, pieces.near, pieces.far, near.nodes.shape[1]
        self.hats = s
        self.opposite_hats, self.there = self.lying_opposite(near, far, pieces)
        self.shapes = relative_shapes(s, self.opposite_hats, k)
        t = self.there.tangents
        self._dual = t @ np.linalg.inv(t.swapaxes(2, 3) @ t)
        self._numbers = np.concatenate([near.nodes[i], far.nodes[j]], axis=1)
        self._vertices, self.face = self.near.vertices[i], i
        self.X = np.einsum("nqk,nkd->nqd", shape_functions(s, near.x.shape[1]), self.near.X[i])
        self._weight(pieces)

    def measure(self, pieces: Segments) -> FloatArray:
        """Reference areas of points over their shares, shape (pieces, points) [m^2].

        Args:
            pieces: Of the faces of the carrying side.
        """
        s, X, d = pieces.near_coordinates, self.near.X[pieces.near], self._dim
        tangents = np.einsum("nqka,nkd->nqda", shape_slopes(s, X.shape[1]), X)
        metric = np.linalg.det(tangents.swapaxes(-1, -2) @ tangents)
        result: FloatArray = self.thickness * np.sqrt(metric) / (d - 1)
        if self.about_axis:
            result *= 2 * np.pi * np.einsum("nqk,nk->nq", shape_functions(s, X.shape[1]), X[..., 0])
        return result

    def _weight(self, pieces: Segments) -> None:
        """Takes psi and areas over the pieces."""
        s, i, d = pieces.near_coordinates, pieces.near, self._dim
        X = self.near.X
        self.weights = weights = pieces.shares * self.measure(pieces)
        masses, means, covered = (np.zeros((len(X), *shape)) for shape in ((d, d), (d,), ()))
        np.add.at(masses, i, np.einsum("nq,nqi,nqj->nij", weights, s, s))
        parts = np.einsum("nq,nqi->ni", weights, s)
        np.add.at(means, i, parts)
        np.add.at(covered, i, pieces.shares.sum(axis=1))
        # Of the sliver of a face the functions would be those of a slope: they fade into hats.
        share = np.where(covered < 1 - 1e-9, covered, 1.0)[:, None, None]
        inverse = np.linalg.pinv(masses, rcond=_SINGULAR, hermitian=True)
        dual = share * means[:, :, None] * inverse + (1 - share) * np.eye(d)
        self.faces = OnFaces(dual, inverse, means, share[:, 0, 0])
        self.psi = np.einsum("nq,nij,nqj->nqi", weights, dual[i], s)
        self.opposed = np.minimum(covered, 1.0)
        self._areas = self.summed(parts[..., None])[:, 0]
        self.share: FloatArray = np.asarray(np.minimum(self._areas / self._whole, 1.0))
        self.covered: BoolArray = np.asarray(self.share > COVERED)

    @property
    def areas(self) -> FloatArray:  # type: ignore[override]
        """See `VertexFunctions`: of what lies opposite something now. Collective.

        Where nothing does it is none, as good as: it is divided by.
        """
        self.renew()
        return np.where(self.covered, self._areas, _NONE * self._whole)

    def look_within(self, reach: float) -> None:
        """Changes the distance beyond which nothing lies opposite [m]. Collective."""
        self.reach, self._at = reach, np.empty(0)
        self.renew()

    def between_vertices(self, values: FloatArray) -> FloatArray:
        """A linear function of the vertices at the points, shape (pieces, points). Local.

        Args:
            values: At local vertices, owned ones first.
        """
        return np.einsum("nqi,ni->nq", self.hats, values[self._vertices])

    # --- as of one side ---

    def means(self, values: FloatArray) -> FloatArray:
        """See `VertexFunctions`; 0 where nothing lies opposite."""
        return np.where(self.covered[:, None], super().means(values), 0.0)

    def displacements(self, of_nodes: FloatArray | None = None) -> FloatArray:
        """See `VertexFunctions`: relative to the other side. Collective."""
        return self.relative((self._u.x.array if of_nodes is None else of_nodes).reshape(-1))

    def relative(self, field: FloatArray, *, turned: bool = True) -> FloatArray:
        """A field of displacements at the points, see the module. Collective.

        Args:
            field: Its local entries, owned ones first.
            turned: Relative to the other side's normal, too.
        """
        self.renew()
        found = self.values(field, self._numbers)
        if not turned:
            return np.asarray(self.shapes @ found)
        along = self.there.normal @ _far_half(found).swapaxes(1, 2)
        turns = along[:, :, None] @ self.there.slopes @ self._levers.swapaxes(2, 3)
        return np.asarray(self.shapes @ found + turns[:, :, 0])

    def values(self, field: FloatArray, nodes: IntArray) -> FloatArray:
        """A field of displacements at global nodes, shape (..., dim). Collective.

        Args:
            field: Its local entries, owned ones first.
        """
        rows = field[: self.node_owners.count * self._dim].reshape(-1, self._dim)
        return self.node_owners.values_at(rows, nodes).reshape(*nodes.shape, self._dim)

    @property
    def _levers(self) -> FloatArray:
        """Dual tangents times the gap: forces act beside the face.

        Less what does not act yet: by overlaps of several elements they would squeeze these.
        """
        gaps = self.there.gap
        if self.fading is not None:
            gaps = gaps - self.between_vertices(self.fading.x.array)
        return gaps[..., None, None] * self._dual

    def spread(self, vectors: FloatArray, *, turned: bool = True) -> FloatArray:
        """See `VertexFunctions`: those on the other side are opposite. Collective."""
        at_nodes, there = self.shapes.swapaxes(1, 2) @ vectors, self.there
        if turned:
            turns = vectors[:, :, None] @ self._levers @ there.slopes.swapaxes(2, 3)
            _far_half(at_nodes)[:] += turns[:, :, 0].swapaxes(1, 2) @ there.normal
        added = self.to_owners(self._numbers, at_nodes)
        result = np.zeros((self._node_map.size_local + self._node_map.num_ghosts, self._dim))
        result[: len(added)] = added
        return result.reshape(-1)

    def to_owners(self, nodes: IntArray, vectors: FloatArray) -> FloatArray:
        """Sums vectors at global nodes, at those that this rank owns, (nodes, dim). Collective."""
        ids, back = np.unique(nodes, return_inverse=True)
        at, d = back.ravel(), self._dim
        parts = [np.bincount(at, v.ravel(), len(ids)) for v in np.moveaxis(vectors, -1, 0)]
        sums: FloatArray = np.stack(parts, axis=1)
        rows, columns = np.repeat(ids, d), np.tile(np.arange(d), len(ids))
        return np.asarray(self.node_owners.summed(rows, columns, sums.ravel(), d).toarray())

    def opposite(self, vectors: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Vectors at the points, at the owned vertices of the other side where there are any.

        Collective.

        Args:
            vectors: Shape (pieces, points, dim).

        Returns:
            Nodes of the displacement, and lengths and directions of the sums there.
        """
        half, hats = self.shapes.shape[2] // 2, self.opposite_hats.swapaxes(1, 2)
        sums = self.to_owners(self._numbers[:, half : half + self._dim], hats @ vectors)
        lengths = np.linalg.norm(sums, axis=1)
        nodes = np.flatnonzero(lengths > 0).astype(np.int32)
        return nodes, lengths[nodes], sums[nodes] / lengths[nodes, None]

    def nodes(self, which: BoolArray) -> IntArray:
        """See `VertexFunctions`: of both sides."""
        return np.asarray(self._numbers[which])


def _far_half(of_nodes: FloatArray) -> FloatArray:
    """What of values at the nodes of both sides is that of the other side: a view."""
    return of_nodes[:, of_nodes.shape[1] // 2 :]


def relative_shapes(near: FloatArray, far: FloatArray, count: int) -> FloatArray:
    """Shape functions of a point's displacement relative to the one opposite, both with `count`."""
    return np.concatenate([shape_functions(near, count), -shape_functions(far, count)], axis=2)


def _nearest(
    x: FloatArray, far: FloatArray, start: FloatArray, nodes: int
) -> tuple[FloatArray, Opposite]:
    """The points of faces that are nearest to others. Local.

    Args:
        x: Where they are, shape (n, points, dim) [m].
        far: Nodes of the face of each, shape (n, nodes, dim) [m].
        start: Barycentric coordinates to begin with, shape (n, points, dim).
        nodes: How many of the displacement a face has.

    Returns:
        Barycentric coordinates, and what lies there.
    """
    count, d = far.shape[1], far.shape[2]
    seconds = np.einsum("kab,nkd->ndab", shape_bends(d, count), far)[:, None]
    where = np.array(start)
    for _ in range(1 if count == d else NEWTON):
        slopes = shape_slopes(where, count)
        off = x - np.einsum("nqk,nkd->nqd", shape_functions(where, count), far)
        t = np.einsum("nqka,nkd->nqda", slopes, far)
        metric = t.swapaxes(-1, -2) @ t
        bent = metric - np.einsum(
            "nqd,nqdab->nqab", off, np.broadcast_to(seconds, (*t.shape, d - 1))
        )
        # Beyond the centre of curvature the point would be the farthest.
        good = np.linalg.det(bent) > 0.1 * np.linalg.det(metric)
        J = np.where(good[..., None, None], bent, metric)
        step = np.linalg.solve(J, np.einsum("nqda,nqd->nqa", t, off)[..., None])[..., 0]
        step = np.clip(step, -0.5, 0.5) if count > d else step
        where[..., 1:] += step
        where[..., 0] -= step.sum(axis=-1)
    t = np.einsum("nqka,nkd->nqda", shape_slopes(where, count), far)
    off = x - np.einsum("nqk,nkd->nqd", shape_functions(where, count), far)
    if d == 2:
        n = np.stack([t[..., 1, 0], -t[..., 0, 0]], axis=-1)
    else:
        n = np.asarray(np.cross(t[..., 0], t[..., 1]), dtype=np.float64)
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    bend = np.einsum("nqd,nqdab->nqab", n, np.broadcast_to(seconds, (*t.shape, d - 1)))
    gap = np.einsum("nqd,nqd->nq", n, off)
    return where, Opposite(gap, n, t, bend, shape_slopes(where, nodes))
