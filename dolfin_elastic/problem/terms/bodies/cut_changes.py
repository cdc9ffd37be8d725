"""`CutChanges`: how forces and gaps of two surfaces change with what of them lies opposite.

The tangent of contact between two surfaces is exact for pieces of the faces that keep the places
and shares of their points; but the faces cut each other anew where they move.  Of a number

    sum of p_I T_I + c_I g_I,    T_I = sum of psi_I n . (N a),    g_I = (sum of psi_I g)/A_I

with pressures p_I, a motion a and mean gaps g_I, what this changes is found backwards, vector by
vector.  With psi = w dual l, where dual is made of integrals of the faces' hats l, it is on a face

    sum of w f(s),    f = (dual l) . h + m . l + l . M l,    h_I = p_I n . (N a) + c_I g/A_I,

where m and M are what the integrals change of dual and A_I; f by the coordinates s of a point is in
closed form with the point opposite, whose coordinates xi are where x - x_m is along n:

    dxi = (a - g b)^-1 t . dx,    dg = n . dx,    dn = - a^i b_ij dxi_j

with its tangents t, their dual a^i, the metric a and the bend b.  Coordinates and shares by the
corners y of a flat part of the other face are differences.  Where pieces come or go with y, as
where nodes of both sides coincide, their integrals of f are: the mean of both sides.  Then y by the
nodes is in closed form, see `Pairs.by_nodes`.
Source: M. A. Puso & T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 4891 (derivatives of
pieces); K. Fischer & P. Wriggers, Comput. Mech. 36 (2005) 226 (those of mortar integrals).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.problem.constraints.ties.segments import Pairs, Segments, joined
from dolfin_elastic.problem.constraints.ties.shapes import (
    shape_bends,
    shape_functions,
    shape_slopes,
)
from dolfin_elastic.problem.terms.bodies.functions import PieceFunctions, relative_shapes
from dolfin_elastic.problem.terms.contact.vertex import VertexContact, of_unknowns

STEP, JUMPS = 1e-6, 1e-3
"""Of the differences, over a flat part; and by how much points move in one where pieces differ."""

_AROUND = 1e-3
"""By how much the other part is larger where pairs are looked for that have pieces in a step."""


class _Cut(NamedTuple):
    """Pieces, and how they change with the corners y of the parts of the other side.

    Attributes:
        pairs: Those that have pieces here or after a step of y.
        pieces: They, and behind them those of pairs where they differ after each step of y.
        first: Which of them are there now.
        shares: Derivatives of the shares, shape (pieces, points, components of y).
        hats: Of the coordinates but the first, shape (pieces, points, d - 1, components of y).
    """

    pairs: Pairs
    pieces: Segments
    first: BoolArray
    shares: FloatArray
    hats: FloatArray


class _ByIntegrals(NamedTuple):
    """Derivatives by what the faces' duals and the areas of vertices are made of.

    Attributes:
        m: By the integrals of the hats, shape (faces, d).
        M: By the integrals of their products, shape (faces, d, d).
        share: By the part of each face that is covered, shape (faces,).
    """

    m: FloatArray
    M: FloatArray
    share: FloatArray


def _changes(pairs: Pairs, chosen: BoolArray) -> _Cut:
    """Differences of all pieces. Local.

    Args:
        chosen: Near facets, of which pieces are taken.
    """
    d = pairs.near.x.shape[2]

    def pieces(pairs: Pairs, y: FloatArray) -> Segments:
        found = pairs.pieces(y)
        return found[chosen[found.near]]

    some: BoolArray = np.zeros(len(pairs.y), dtype=bool)
    middle = pairs.y.mean(axis=1, keepdims=True)
    for y in (pairs.y, middle + (1 + _AROUND) * (pairs.y - middle)):
        some[pieces(pairs, y).pair] = True
    pairs = pairs[some]
    steps = STEP * np.eye(d * (d - 1)).reshape(-1, d, d - 1)
    here = pieces(pairs, pairs.y)
    ends = [[pieces(pairs, pairs.y + sign * step) for step in steps] for sign in (1, -1)]
    stays = _stay(here, [*ends[0], *ends[1]], len(pairs.y))
    sides = [[one[stays[one.pair]] for one in side] for side in ends]
    parts, steady = [here], stays[here.pair]
    shares = [np.zeros((*here.shares.shape, len(steps)))]
    hats = [np.zeros((*here.shares.shape, d - 1, len(steps)))]
    shares[0][steady] = _slopes(*([one.shares for one in side] for side in sides))
    hats[0][steady] = _slopes(*([one.near_coordinates[..., 1:] for one in side] for side in sides))
    for sign, side in zip((1, -1), ends, strict=True):
        for k, one in enumerate(side):
            comes = one[~stays[one.pair]]
            parts.append(comes)
            shares.append(sign / (2 * STEP) * comes.shares[..., None] * np.eye(len(steps))[k])
            hats.append(np.zeros((*comes.shares.shape, d - 1, len(steps))))
    every = joined(parts)
    first: BoolArray = np.arange(len(every.pair)) < len(here.pair)
    return _Cut(pairs, every, first, np.concatenate(shares), np.concatenate(hats))


def _stay(here: Segments, ends: Sequence[Segments], count: int) -> BoolArray:
    """Which pairs have the same pieces here and after all steps, shape (count,)."""
    counts = [np.bincount(one.pair, minlength=count) for one in (here, *ends)]
    result: BoolArray = np.all(np.array(counts) == counts[0], axis=0)
    places = [one.near_coordinates[result[one.pair]] for one in (here, *ends)]
    jumps = [np.abs(one - places[0]).max(axis=(1, 2)) > JUMPS for one in places[1:]]
    pair = here.pair[result[here.pair]]
    result[pair[np.any(jumps, axis=0)]] = False
    return result


def _slopes(first: Sequence[FloatArray], last: Sequence[FloatArray]) -> FloatArray:
    """Differences, by the last axis."""
    return np.asarray((np.stack(first, axis=-1) - np.stack(last, axis=-1)) / (2 * STEP))


class CutChanges:
    """What the cut changes at the present displacement. Collective.

    Args:
        pair: The contact with the forces and gaps of the number.
        functions: Of these, made of the pieces at the present displacement.
        pressures: p_I at the owned vertices, shape (n,).
    """

    def __init__(
        self, pair: VertexContact, functions: PieceFunctions, pressures: FloatArray
    ) -> None:
        functions.renew()
        self._pair, self._functions, self._pressures = pair, functions, pressures
        pairs = functions.pairs
        self._cut = _changes(pairs, functions.near_enough)
        near, far, pieces = pairs.near, pairs.far, self._cut.pieces
        s, i, k = pieces.near_coordinates, pieces.near, near.nodes.shape[1]
        hats, there = functions.lying_opposite(near, far, pieces)
        self._gap, self._normal = there.gap, there.normal
        self._shapes = relative_shapes(s, hats, k)
        self._numbers = np.concatenate([near.nodes[i], far.nodes[pieces.far]], axis=1)
        self._area = functions.measure(pieces)
        # By the coordinates of the points:
        ahead = np.einsum("nqka,nkd->nqda", shape_slopes(s, near.x.shape[1]), near.x[i])
        t, b = there.tangents, there.bend
        metric = t.swapaxes(-1, -2) @ t
        bent = metric - there.gap[..., None, None] * b
        xi = np.linalg.solve(bent, t.swapaxes(-1, -2) @ ahead)
        self._of_gap = np.einsum("nqd,nqda->nqa", there.normal, ahead)
        self._of_normal = -t @ np.linalg.solve(metric, b @ xi)
        self._of_shapes = np.concatenate([shape_slopes(s, k), -there.slopes @ xi], axis=2)
        growth = _growth(s, functions.near.X[i], about_axis=functions.about_axis)
        self._of_area = self._area[..., None] * growth

    def transposed(self, motion: FloatArray, of_gaps: FloatArray) -> FloatArray:
        """Derivatives of the number of the module, owned entries of all unknowns. Collective.

        Args:
            motion: a at all local nodes, shape (nodes * dim,).
            of_gaps: c_I at the owned vertices, shape (n,).
        """
        return of_unknowns(self._pair, self._by(motion, of_gaps)[0].ravel())

    def by_positions(self, motion: FloatArray, of_gaps: FloatArray) -> FloatArray:
        """Those by the places of the undeformed body, at owned nodes, shape (nodes, dim).

        Of the cut and of reference areas. Collective.

        Args:
            motion: See `transposed`, as for the other one.
        """
        functions, here = self._functions, self._cut.first
        rows, by_areas = self._by(motion, of_gaps)
        pieces = self._cut.pieces[here]
        X = functions.near.X[pieces.near]
        slopes, _, dual = _tangents(pieces.near_coordinates, X)
        weights = pieces.shares * by_areas[here]
        of_X = np.einsum("nq,nqka,nqda->nkd", weights, slopes, dual)
        if functions.about_axis:
            N = shape_functions(pieces.near_coordinates, X.shape[1])
            radii = np.einsum("nqk,nk->nq", N, X[..., 0])
            of_X[..., 0] += np.einsum("nq,nqk->nk", weights / radii, N)
        return rows + functions.to_owners(functions.pairs.near.nodes[pieces.near], of_X)

    def _by(self, motion: FloatArray, of_gaps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By the cut, at owned nodes, and by the logarithms of the measures of points. Collective.

        Args:
            motion: See `transposed`, as for the other one.
        """
        functions, (pairs, pieces, _, of_shares, of_hats) = self._functions, self._cut
        c = np.where(functions.covered, of_gaps / functions.areas, 0.0)
        means = functions.means(functions.there.gap[..., None])[:, 0]
        at_vertices = np.stack([self._pressures, c, -c * means], axis=1)
        p, c, areas = np.moveaxis(functions.at_vertices(at_vertices, functions.near.vertices), 2, 0)
        integrals = self._by_integrals(motion, p, c)
        integrals.m[:] += areas
        by_areas, by_hats = self._by_points(motion, p, c, integrals)
        by_shares = by_areas + integrals.share[pieces.near][:, None]
        by_y = np.einsum("nq,nqk->nk", by_shares, of_shares)
        by_y += np.einsum("nqa,nqak->nk", by_hats, of_hats)
        of_pairs = np.zeros((len(pairs.y), by_y.shape[1]))
        np.add.at(of_pairs, pieces.pair, by_y)
        sides = pairs.by_nodes(of_pairs.reshape(pairs.y.shape))
        nodes = pairs.near.nodes[pairs.near_facet], pairs.far.nodes[pairs.far_facet]
        forces = np.concatenate([functions.near.moved.T @ side for side in sides], axis=1)
        return functions.to_owners(np.concatenate(nodes, axis=1), forces), by_areas

    def _by_integrals(self, motion: FloatArray, p: FloatArray, c: FloatArray) -> _ByIntegrals:
        """Of the number by what the duals are made of. Collective.

        Args:
            p: At the vertices of faces, shape (faces, d).
            c: There, over A_I, shape (faces, d).
        """
        functions, faces = self._functions, self._functions.faces
        s, i, there = functions.hats, functions.face, functions.there
        along = np.sum(there.normal * functions.relative(motion, turned=False), axis=2)
        h = p[i][:, None] * along[..., None] + c[i][:, None] * there.gap[..., None]
        dual = np.zeros_like(faces.dual)
        np.add.at(dual, i, np.einsum("nq,nqi,nqj->nij", functions.weights, h, s))
        share, means = faces.share[:, None], faces.means[..., None]
        M = -share[..., None] * faces.inverse @ (means * dual) @ faces.inverse
        unlike = np.sum(dual * (means * faces.inverse - np.eye(s.shape[2])), axis=(1, 2))
        m = share * np.sum(dual * faces.inverse, axis=2)
        return _ByIntegrals(m, M, np.where(faces.share < 1.0, unlike, 0.0))

    def _by_points(
        self, motion: FloatArray, p: FloatArray, c: FloatArray, by: _ByIntegrals
    ) -> tuple[FloatArray, FloatArray]:
        """Of the number by the places of all points, shapes (pieces, points, ...). Collective.

        By the logarithms of their measures, over their shares, and by their coordinates.

        Args:
            p: See `_by_integrals`, as for c.
        """
        s, i = self._cut.pieces.near_coordinates, self._cut.pieces.near
        d, dual, m, M = s.shape[2], self._functions.faces.dual[i], by.m[i][:, None], by.M[i]
        values = self._functions.values(motion, self._numbers)
        moves = self._shapes @ values
        along = np.sum(self._normal * moves, axis=2)
        of_along = np.einsum("nqda,nqd->nqa", self._of_normal, moves)
        of_along += np.einsum("nqd,nqka,nkd->nqa", self._normal, self._of_shapes, values)
        h = p[i][:, None] * along[..., None] + c[i][:, None] * self._gap[..., None]
        inner = h @ dual + m
        f = np.sum((inner + s @ M) * s, axis=2)
        psi = s @ dual.swapaxes(1, 2)
        slopes = (inner + s @ (M + M.swapaxes(1, 2))) @ np.vstack([-np.ones(d - 1), np.eye(d - 1)])
        slopes += (psi @ p[i][..., None]) * of_along + (psi @ c[i][..., None]) * self._of_gap
        slopes = self._of_area * f[..., None] + self._area[..., None] * slopes
        return self._area * f, self._cut.pieces.shares[..., None] * slopes


def _tangents(s: FloatArray, X: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes of the shape functions, tangents and dual tangents of faces at points."""
    slopes = shape_slopes(s, X.shape[1])
    t = np.einsum("nqka,nkd->nqda", slopes, X)
    return slopes, t, t @ np.linalg.inv(t.swapaxes(-1, -2) @ t)


def _growth(s: FloatArray, X: FloatArray, *, about_axis: bool) -> FloatArray:
    """Derivatives of the logarithm of the reference area by coordinates, see `measure`.

    Args:
        s: Barycentric coordinates, shape (pieces, points, d).
        X: Nodes of the face of each piece, shape (pieces, nodes, d) [m].
        about_axis: Whether reference areas are those of rings.
    """
    _, tangents, dual = _tangents(s, X)
    bends = np.einsum("kab,nkd->ndab", shape_bends(s.shape[2], X.shape[1]), X)
    result = np.einsum("nqda,ndab->nqb", dual, bends)
    if about_axis:
        radii = np.einsum("nqk,nk->nq", shape_functions(s, X.shape[1]), X[..., 0])
        result += tangents[:, :, 0] / radii[..., None]
    return np.asarray(result)
