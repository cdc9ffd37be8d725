"""`BodyContact`: contact between two deformable surfaces.

One side carries the pressures: that with the finer faces, of alike ones the softer.  Its mean gaps,
pressures and potential are those of `VertexContact`; forces on both sides come from the same
points, so that action is reaction.  The tangent leaves the change of the cut out.

In a step of an implicit motion the cut is that of its stage, and the pressures are those of
`contact_step` with the mean gaps of the cuts at both ends.  As these weight gaps otherwise, the
work of the pressures in the step is a little off the change of the energy W.  With the mean motions
w_I past each other, forces k p_I A_I w_I beside the pressures do the rest of the work,

    k sum of A_I p_I w_I . w_I = W0 - W1 - sum of A_I p_I n_I . w_I,

a discrete gradient of W by these motions: energy, and both momenta, for each force has an opposite
one on the same line, are conserved exactly in the midpoint rule.

Source: P. Wriggers, Computational Contact Mechanics, 2nd ed., Springer 2006, sections 4.3 and 9.5;
M. A. Puso & T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601; A. Popp, B. Wohlmuth,
M. W. Gee & W. A. Wall, SIAM J. Sci. Comput. 34 (2012) B421; in steps that of `contact_step`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, prepare_facets
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.self_contact import AnyContact
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.constraints.ties.facets import longest_edge, owned
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks, Kind
from dolfin_elastic.problem.terms.bodies.functions import PieceFunctions
from dolfin_elastic.problem.terms.bodies.start import StartOffsets, overlap_reach
from dolfin_elastic.problem.terms.contact import FAR, ContactPair, nearest_spot, uniaxial_modulus
from dolfin_elastic.problem.terms.nodal_contact import NodalContact
from dolfin_elastic.problem.terms.vertex_contact import VertexContact, Way, stored

log = logging.getLogger("dolfin_elastic")

ALIKE = 1.2
"""Ratio of the sizes of the faces of two sides up to which the softer one carries the pressures."""

FIRST, SLOWLY, FARTHEST = 0.01, 4.0, 3.0
"""Distances over the diagonal of all bodies at which the other side is looked for, step by step."""

SLOW, LEFT = 1e-9, 0.5
"""Speed over that of the fastest body that is none; and the gap, over the distance up to which both
sides are compared, that a motion of bodies leaves which has begun beyond it."""

PASSED = 0.5
"""Depth over that beyond which nothing lies opposite down to which a step may lead."""


class BodyContact(VertexContact):
    """One contact between two surfaces of the mesh. Collective to make.

    Args:
        thickness: Of a plane body [m].

    Attributes:
        sides: Names of the surfaces that carry the pressures, and of the others.
        pieces: What of both lies opposite each other; the same as `functions`.
        offsets: What counts as no gap.
    """

    flat = False
    joins = True
    _start: tuple[FloatArray, float]  # mean gaps [m] and energy [J] at the start of a step

    def __init__(
        self, contact: Contact, context: FormContext, index: int, thickness: float
    ) -> None:
        self.sides, softer, text = _carrier_first(contact, context)
        log.info("contact '%s': %s", contact.label, text)
        super().__init__(contact, context, index, thickness)
        if contact.stiffness is None:  # that of the softer side: the stiffer one is not to crush it
            self.penalty.x.array[:] *= softer
            self.eps *= softer
        self._bound_other_side()
        self._first = self.penalty.x.array.copy(), self.eps.copy()
        edge, self.offsets = self.pieces.reach, StartOffsets(contact, self.lam.function_space)
        if (reach := overlap_reach(self.pieces, context.body)) > edge:
            self.pieces.look_within(reach)
        self.offsets.take(self.nodes, self._mean(self._at_points()[0]), edge)
        self.offsets.set_time(0.0, CONSTANT)
        self.carrier = np.zeros(context.unknowns.V.dofmap.index_map.size_local, dtype=bool)
        self.carrier[self.functions.every[2]] = True

    def _names(self, contact: Contact) -> Sequence[str]:
        """See `ContactPair`."""
        return self.sides[0]

    def _bound_other_side(self) -> None:
        """Puts the largest penalty into the elements beside the other side, for `form`."""
        mesh = self._context.body.mesh
        facets = np.concatenate([self._context.body.surface(name) for name in self.sides[1]])
        cells, _ = cells_beside_facets(mesh, np.unique(facets).astype(np.int32))
        largest_one = largest(self.comm, float(np.max(self.penalty.x.array, initial=0.0)))
        self.penalty.x.array[self.penalty.function_space.dofmap.list[cells, 0]] = largest_one
        self.penalty.x.scatter_forward()

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`: a row of the tangent has the nodes of both sides."""
        bound = super().form(kind)
        return None if bound is None else 2 * bound

    def _make_functions(self, thickness: float) -> PieceFunctions:
        context = self._context
        sides = (owned(context.body, context.unknowns.V, names) for names in self.sides)
        reach = longest_edge(self.comm, *sides)
        self._end = fem.Function(context.unknowns.V)
        self.pieces, self._at_end = (
            PieceFunctions(self, context, self.sides, reach, thickness, u)
            for u in (None, self._end)
        )
        return self.pieces

    # --- gaps ---

    def _at_points(self) -> tuple[FloatArray, FloatArray]:
        """See `VertexContact`."""
        finite, there = self.pieces.renew(), self.pieces.there
        return there.gap if finite else np.full_like(there.gap, np.nan), there.normal

    def _over_step(self) -> Way:
        """See `VertexContact`: at the stage, whose pieces all directions are of."""
        gaps, normals = self._at_points()
        return Way(gaps, gaps, normals, normals)

    def _mean(self, gaps: FloatArray) -> FloatArray:
        return self._mean_of(self.pieces, gaps)

    def _mean_of(self, pieces: PieceFunctions, gaps: FloatArray) -> FloatArray:
        offsets = self.offsets.field.x.array[self.nodes]
        return np.where(pieces.covered, pieces.means(gaps[..., None])[:, 0] - offsets, FAR)

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`: how much of the initial overlap acts."""
        self.offsets.set_time(t, default)

    def _means_over(self, way: Way) -> tuple[FloatArray, FloatArray]:
        """See `VertexContact`: each with the cut of its end."""
        if not self.step.on:
            return super()._means_over(way)
        self._end.x.array[:] = self.step.ends()[1].reshape(-1)
        finite, gaps = self._at_end.renew(), self._at_end.there.gap
        return self._start[0], self._mean_of(self._at_end, gaps if finite else gaps + np.nan)

    def begin_step(self) -> None:
        """See `Term`."""
        super().begin_step()
        self._start = self.pressing_gaps(), self.energy()

    def forces(self) -> FloatArray:
        """See `VertexContact`; in the midpoint rule with what is missing, see the module."""
        way = self._over_step()
        pressures, _ = self.state(way)
        vectors = self.pieces.at_points(pressures[:, None]) * way.along
        if self.step.on and self.step.ahead == 1.0:
            vectors += self.pieces.at_points(self._missing(pressures, vectors))
        return self.pieces.spread(vectors)

    def _missing(self, pressures: FloatArray, vectors: FloatArray) -> FloatArray:
        """k p_I w_I at the owned vertices [Pa]. Collective.

        Args:
            pressures: There [Pa].
            vectors: Forces of these at the points, integrals included [N].
        """
        moved = self.pieces.relative(self._end.x.array - self.step.start.x.array)
        w, gaps = self.pieces.means(moved), self._at_end.there.gap
        energy = stored(self, self._mean_of(self._at_end, gaps), self._at_end.areas)
        weights = self.pieces.areas * pressures
        local = np.array([np.sum(weights[:, None] * w * w), weights.sum(), np.sum(vectors * moved)])
        square, force, work = total(self.comm, local)
        if not square > self.step.short * force:
            return np.zeros_like(w)
        return np.asarray((self._start[1] - energy - work) / square * pressures[:, None] * w)

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
        most = pieces.farthest(motion)
        deepest = smallest(self.comm, float(np.min(self._acting()[0], initial=np.inf)))
        if (most <= limit and deepest >= -limit) or not np.isfinite(most):
            return 1.0
        share, offsets = 1.0, self.offsets.field.x.array
        for after in (False, True):
            first, change = pieces.gaps_over(motion, pieces.reach + most, offsets, after=after)
            floor = np.minimum(-limit, (first - pieces.reach) / 2)
            passes = (first > -pieces.reach) & (first + change < floor)
            share = min(share, float(np.min((floor - first)[passes] / change[passes], initial=1.0)))
        return smallest(self.comm, share)

    # --- the tangent ---

    def curvatures(self) -> None:
        """See `VertexContact`: friction leaves the turn of normals out of its tangent."""

    def _turning(self, pressures: FloatArray) -> Blocks:
        """Minus the derivative of the forces by the second variation of gaps. Collective.

        With the metric a, the bend b, A = a - g b and

            dxi = A^-1 ((du_s - du_m) . t + g n . du_m,xi),    q = n . du_m,xi + b dxi,

        it is d2g = - (n . du_m,xi) dxi - dxi (n . du_m,xi) - dxi b dxi + g q a^-1 q.
        """
        pieces, d = self.pieces, self._dim
        some: BoolArray = np.asarray(pieces.beside(self.near).any(axis=1))
        weights = pieces.at_points(pressures[:, None])[some, :, 0]
        g, n, t, b, slopes = (values[some] for values in pieces.there)
        N = pieces.at(some)
        g, shape = g[..., None, None], (*g.shape, d - 1, d * N.shape[2])
        D = np.concatenate([np.zeros_like(slopes), slopes], axis=2)
        along = np.einsum("nqka,nqd->nqakd", D, n).reshape(shape)
        across = np.einsum("nqk,nqda->nqakd", N, t).reshape(shape)
        metric = t.swapaxes(-1, -2) @ t
        inverse, one = np.linalg.inv(metric), np.eye(d - 1)
        dxi = np.linalg.solve(metric - g * b, across + g * along)
        mixed = g * inverse @ b - one
        M = np.block([[g * inverse, mixed], [mixed.swapaxes(-1, -2), b @ (g * inverse @ b) - b]])
        V = np.concatenate([along, dxi], axis=2)
        MV = -weights[..., None, None] * (M @ V)
        count, width = len(V), V.shape[-1]
        rows = V.shape[1] * V.shape[2]
        V, MV = (values.reshape(count, rows, width) for values in (V, MV))
        K = (V.swapaxes(1, 2) @ MV).reshape(count, width // d, d, width // d, d)
        return self._blocks_between(pieces.nodes(some), K.transpose(0, 1, 3, 2, 4))

    # --- a run ---

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
            (means(self.pieces.relative(one)) if all_ways else self.rates(one))[closed].ravel()
            for one in fields
        ]
        return np.stack(columns, axis=1)

    def rates(self, motion: FloatArray) -> FloatArray:
        """Changes of the mean gaps of owned vertices by a motion of local nodes [m]. Collective.

        Without the turn of normals.
        """
        along = np.sum(self._at_points()[1] * self.pieces.relative(motion), axis=2)
        return self.pieces.means(along[..., None])[:, 0]

    def way_to_meet(self, motion: FloatArray) -> float:
        """See `Term`: of vertices; of all points as far as the other side is compared with."""
        pieces, gaps, rates = self.pieces, self.pressing_gaps(), self.rates(motion)
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
        acting = self.pressing_gaps()
        gap, unit = (
            smallest(self.comm, float(np.min(acting, initial=np.inf))),
            self._context.body.unit,
        )
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


def _carrier_first(
    contact: Contact, context: FormContext
) -> tuple[tuple[tuple[str, ...], ...], float, str]:
    """Both sides, first the one that carries the pressures. Collective.

    Returns:
        With the share of its stiffness per depth that the other one has, at most 1, and why.
    """
    body, unit = context.body, context.body.unit
    prepare_facets(body.mesh)
    sizes, moduli = [], []
    for names in contact.sides:
        facets = np.unique(np.concatenate([body.owned_facets(name) for name in names]))
        cells, _ = cells_beside_facets(body.mesh, facets.astype(np.int32))
        stiffness = sum(
            uniaxial_modulus(one) * int(np.isin(cells, one.cells).sum()) for one in context.regions
        )
        area = float(facet_areas(body.mesh, facets.astype(np.int32)).sum())
        sums = total(body.comm, np.array([area, float(len(facets)), float(stiffness)]))
        sizes.append(float(sums[0] / sums[1]) ** (1 / (body.dim - 1)))
        moduli.append(float(sums[2] / sums[1]))
    alike = max(sizes) <= ALIKE * min(sizes)
    second = moduli[1] < moduli[0] / ALIKE if alike else sizes[1] < sizes[0]
    one, other = (1, 0) if second else (0, 1)
    sides = contact.sides[one], contact.sides[other]
    what = f"{'+'.join(sides[0])} carries the pressures"
    faces = f"faces {unit.length(sizes[one])} against {unit.length(sizes[other])}"
    share = moduli[other] / sizes[other] / (moduli[one] / sizes[one])
    return (
        sides,
        min(1.0, share),
        f"{what} ({faces}{', the softer side' if alike and second else ''})",
    )


def make_contacts(
    contacts: Sequence[AnyContact], context: FormContext, thickness: float
) -> tuple[ContactPair, ...]:
    """All contacts on a body with obstacles and between surfaces. Collective.

    Args:
        thickness: Of a plane body [m].
    """
    return tuple(
        _made(contact, context, i, thickness)
        for i, contact in enumerate(contacts)
        if isinstance(contact, Contact)
    )


def _made(contact: Contact, context: FormContext, index: int, thickness: float) -> ContactPair:
    if contact.between is not None:
        return BodyContact(contact, context, index, thickness)
    if context.unknowns.degree > 1 or not contact.obstacle.in_forms:
        return VertexContact(contact, context, index, thickness)
    return NodalContact(contact, context, index, thickness)
