"""`SurfaceGaps`: how far two surfaces of the mesh are from each other, and what follows from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.terms.bodies.functions import PieceFunctions
from dolfin_elastic.problem.terms.bodies.start import StartOffsets
from dolfin_elastic.problem.terms.contact.depths import Depth, Faces, deepest_of, vertices_near
from dolfin_elastic.problem.terms.contact.pair import FAR, nearest_spot
from dolfin_elastic.problem.terms.contact.vertex import VertexContact, gap_rates

FIRST, SLOWLY, FARTHEST = 0.01, 4.0, 3.0
"""Distances over the diagonal of all bodies at which the other side is looked for, step by step."""

SLOW, LEFT = 1e-9, 0.5
"""Speed over that of the fastest body that is none; and the gap, over the distance up to which both
sides are compared, that a motion of bodies leaves which has begun beyond it."""

PASSED = 0.5
"""Depth over that beyond which nothing lies opposite down to which a step may lead."""


class SurfaceGaps(VertexContact):
    """Gaps of a contact between two surfaces, which hold each other where they touch.

    Attributes:
        pieces: What of both lies opposite each other; the same as `functions`.
        offsets: What counts as no gap.
    """

    joins = True
    _what, _rounds = "a vertex of the other side", ""
    sides: Sequence[Sequence[str]]
    pieces: PieceFunctions
    offsets: StartOffsets

    def _at_points(self) -> tuple[FloatArray, FloatArray]:
        """See `VertexContact`."""
        finite, there = self.pieces.renew(), self.pieces.there
        return there.gap if finite else np.full_like(there.gap, np.nan), there.normal

    def _mean(self, gaps: FloatArray) -> FloatArray:
        return self._mean_of(self.pieces, gaps)

    def _mean_of(self, pieces: PieceFunctions, gaps: FloatArray) -> FloatArray:
        offsets = self.offsets.field.x.array[self.nodes]
        return np.where(pieces.covered, pieces.means(gaps[..., None])[:, 0] - offsets, FAR)

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`: how much of the initial overlap acts."""
        self.offsets.set_time(t, default)

    def gaps(self) -> tuple[FloatArray, FloatArray]:
        """See `ContactPair`: mean ones. Collective."""
        gaps, normals = self._at_points()
        mean = self.pieces.means(normals)
        length = np.linalg.norm(mean, axis=1)[:, None]
        along = np.divide(mean, length, out=np.eye(1, self._dim) + 0 * mean, where=length > 0)
        return self._mean(gaps), along

    def nodal_normals(self) -> FloatArray:
        """See `ContactPair`. Collective."""
        return self.gaps()[1]

    def nodal_gaps(self) -> tuple[IndexArray, FloatArray]:
        """See `ContactPair`: mean ones; not a number where nothing is opposite. Collective."""
        nodes, gaps = self.pieces.at_nodes(self.pressing_gaps()[:, None])
        return nodes, np.where(gaps[:, 0] < FAR / 4, gaps[:, 0], np.nan)

    def share(self) -> FloatArray:
        """See `ContactPair`."""
        return self.pieces.share

    def opposed(self) -> FloatArray:
        """See `ContactPair`."""
        return self.pieces.opposed

    def every_gap(self) -> FloatArray:
        """See `ContactPair`: those of all points opposite the other side. Collective."""
        return self._acting()[0].ravel()

    @cached_property
    def _others(self) -> Faces:
        body = self._context.body
        found = [body.owned_facets(name) for name in self.sides[1]]
        return Faces(self._context, np.unique(np.concatenate(found)).astype(np.int32))

    def deepest(self) -> Depth:
        """See `ContactPair`: the deepest vertices of each side within the other. Collective."""
        u = self._context.unknowns.u.x.array.reshape(-1, self._dim)
        one, other = self._faces.at(u), self._others.at(u)
        local = self.offsets.field.x.array, np.minimum(self.every_gap(), 0.0)
        given, seen = (
            largest(self.comm, float(np.max(np.abs(part), initial=0.0))) for part in local
        )
        found = [
            a.entered(vertices_near(self.comm, b, a), np.full(len(a.x), seen), -given)
            for a, b in ((one, other), (other, one))
        ]
        return deepest_of(self.comm, *found)

    def _acting(self) -> tuple[FloatArray, FloatArray]:
        """Gaps less their offsets at the points, and normals. Collective."""
        gaps, normals = self._at_points()
        return gaps - self.pieces.between_vertices(self.offsets.field.x.array), normals

    def spots(self) -> tuple[FloatArray, FloatArray]:
        """See `ContactPair`: of the meshes, as far away as they are. Collective."""
        reach = FIRST
        gaps: FloatArray = self._at_points()[0].reshape(-1)
        places: FloatArray = self.pieces.X.reshape(-1, self._dim)
        farthest = float(span(self._context.body))
        while not total(self.comm, len(gaps)) and reach < FARTHEST:
            gaps, places = self.pieces.nearest_within(reach * farthest)
            reach *= SLOWLY
        return gaps, places

    def distance(self) -> float:
        """See `Term`."""
        acting = smallest(self.comm, float(np.min(self.pressing_gaps(), initial=np.inf)))
        return nearest_spot(self)[0] if acting > self.reach else 0.0

    def longest_step(self, motion: FloatArray) -> float:
        """See `Term`: points get no deeper than half of what is compared with the other side.

        Collective.
        """
        pieces, limit = self.pieces, PASSED * self.pieces.reach
        if total(self.comm, float(not np.isfinite(motion).all())) > 0.0:
            return 1.0
        most = pieces.farthest(motion)
        deepest = smallest(self.comm, float(np.min(self._acting()[0], initial=np.inf)))
        if most <= limit and deepest >= -limit:
            return 1.0
        share, offsets = 1.0, self.offsets.field.x.array
        for after in (False, True):
            first, change = pieces.gaps_over(motion, pieces.reach + most, offsets, after=after)
            floor = np.minimum(-limit, (first - pieces.reach) / 2)
            passes = (first > -pieces.reach) & (first + change < floor)
            share = min(share, float(np.min((floor - first)[passes] / change[passes], initial=1.0)))
        return smallest(self.comm, share)

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """See `Term`: both sides, each as if the other one stood still."""
        yield from super().held(near=near)
        gaps, normals = self._acting()
        within = gaps <= (self.size if near else self.reach)
        nodes, _, directions = self.pieces.opposite(normals * within[..., None])
        yield nodes, -directions

    def partings(self, fields: Sequence[FloatArray], *, all_ways: bool = False) -> FloatArray:
        """See `Term`.

        Args:
            all_ways: Not only along the normal.
        """
        closed, means = self.pressing_gaps() <= self.reach, self.pieces.means
        columns = [
            (means(self.pieces.relative(one)) if all_ways else gap_rates(self, one))[closed].ravel()
            for one in fields
        ]
        return np.stack(columns, axis=1)

    def way_to_meet(self, motion: FloatArray) -> float:
        """See `Term`: of vertices; of all points as far as the other side is compared with."""
        pieces, gaps, rates = self.pieces, self.pressing_gaps(), gap_rates(self, motion)
        meets = pieces.covered & (gaps > self.slack) & (rates < -SLOW)
        share = smallest(self.comm, float(np.min(gaps[meets] / -rates[meets], initial=np.inf)))
        reach, far = 2 * pieces.reach, FARTHEST * float(span(self._context.body))
        while not np.isfinite(share) and reach < far:
            first, change = pieces.gaps_over(motion, reach, self.offsets.field.x.array, after=False)
            meets = (first > pieces.reach) & (change < -SLOW)
            ways = (first[meets] - LEFT * pieces.reach) / -change[meets]
            share = smallest(self.comm, float(np.min(ways, initial=np.inf)))
            reach *= 2
        return share

    def conflict(self, constraints: Constraints) -> None:
        """See `Term`: both sides may be held."""

    def check_start(self) -> str:
        """See `Term`: no overlap acts that is deeper than an element."""
        acting, unit = self.pressing_gaps(), self._context.body.unit
        gap = smallest(self.comm, float(np.min(acting, initial=np.inf)))
        if gap >= -self.tolerance:
            return ""
        text = f"at the start '{self.label}' overlap by {unit.length(-gap)}, at "
        text += unit.point(nearest_spot(self)[1])
        if gap < -self.size:
            raise InputError(
                text,
                where=f"contact[{self.index}].between",
                expected=f"at most an element deep, {unit.length(self.size)}; "
                'interference = "ignore"; in statics it grows with the load',
            )
        return f"{text}: what the penalty stores there throws them apart"
