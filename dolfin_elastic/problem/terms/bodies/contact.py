"""`BodyContact`: contact between two deformable surfaces.

One side carries the pressures: that with the finer faces, of alike ones the softer.  Its mean gaps,
pressures and potential are those of `VertexContact`; forces on both sides come from the same
points, so that action is reaction.  The tangent leaves the change of the cut out.

In a step of an implicit motion the cut is that of its stage, and the pressures are those of
`step` with the mean gaps of the cuts at both ends.  As these weight gaps otherwise, the
work of the pressures in the step is a little off the change of the energy W.  With the mean motions
w_I past each other, forces k p_I A_I w_I beside the pressures do the rest of the work,

    k sum of A_I p_I w_I . w_I = W0 - W1 - sum of A_I p_I n_I . w_I,

a discrete gradient of W by these motions: energy, and both momenta, for each force has an opposite
one on the same line, are conserved exactly in the midpoint rule.

Source: P. Wriggers, Computational Contact Mechanics, 2nd ed., Springer 2006, sections 4.3 and 9.5;
M. A. Puso & T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601; A. Popp, B. Wohlmuth,
M. W. Gee & W. A. Wall, SIAM J. Sci. Comput. 34 (2012) B421; in steps that of `step`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.mesh.geometry.curved import facet_areas
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets, prepare_facets
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.model.self_contact import AnyContact
from dolfin_elastic.problem.constraints.ties.facets import longest_edge, owned
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks, Kind
from dolfin_elastic.problem.terms.bodies.cut_changes import CutChanges
from dolfin_elastic.problem.terms.bodies.functions import PieceFunctions
from dolfin_elastic.problem.terms.bodies.gaps import SurfaceGaps
from dolfin_elastic.problem.terms.bodies.start import StartOffsets, overlap_reach
from dolfin_elastic.problem.terms.contact.nodal import NodalContact
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.surfaces import uniaxial_modulus
from dolfin_elastic.problem.terms.contact.vertex import (
    VertexContact,
    VertexGaps,
    Way,
    blocks_between,
    stored,
)

log = logging.getLogger("dolfin_elastic")

ALIKE = 1.2
"""Ratio of the sizes of the faces of two sides up to which the softer one carries the pressures."""


class BodyContact(SurfaceGaps):
    """One contact between two surfaces of the mesh. Collective to make.

    Args:
        thickness: Of a plane body [m].

    Attributes:
        sides: Names of the surfaces that carry the pressures, and of the others.
    """

    flat = False
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
        self.pieces.fading = self._at_end.fading = self.offsets.fading
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

    def _over_step(self) -> Way:
        """See `VertexContact`: at the stage, whose pieces all directions are of."""
        gaps, normals = self._at_points()
        return Way(gaps, gaps, normals, normals)

    def _means_over(self, way: Way) -> tuple[FloatArray, FloatArray]:
        """See `VertexContact`: each with the cut of its end."""
        if not self.step.on:
            return super()._means_over(way)
        self._end.x.array[:] = self.step.past_ends()[1].reshape(-1)
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

    # --- the tangent ---

    def curvatures(self) -> None:
        """See `VertexContact`: friction leaves the turn of normals out of its tangent."""

    @property
    def linearised(self) -> VertexGaps:
        """See `Pressures`."""
        return _BodyGaps(self)

    def by_positions(self, motion: FloatArray, of_gaps: FloatArray) -> FloatArray:
        """Derivatives by the places of the undeformed body at the present displacement. Collective.

        Of the number of `CutChanges`; they may change the gaps at the start, too.

        Args:
            motion: At all local nodes, shape (nodes * dim,), along which no gap opens.
            of_gaps: What the gap at each owned vertex counts, shape (n,).

        Returns:
            At owned nodes of the displacement, shape (nodes, dim).
        """
        pieces, blocks, start = self.pieces, self.blocks(), -of_gaps * self.offsets.slopes()
        turned = np.einsum("nde,nd->ne", blocks.values, pieces.values(motion, blocks.rows))
        result = CutChanges(self, pieces, self.state()[0]).by_positions(motion, of_gaps)
        result += self._by_places(pieces, of_gaps) - pieces.to_owners(blocks.columns, turned)
        if largest(self.comm, float(np.abs(start).max(initial=0.0))) > 0.0:
            undeformed = fem.Function(self._context.unknowns.V)
            given = self._context, self.sides, pieces.reach, pieces.thickness
            rest = PieceFunctions(self, *given, undeformed)
            cut = CutChanges(self, rest, np.zeros_like(start))
            result += cut.by_positions(0 * motion, start) + self._by_places(rest, start)
        return result

    def _by_places(self, pieces: PieceFunctions, of_gaps: FloatArray) -> FloatArray:
        """Derivatives of gaps by the places of nodes, with the cut as it is. Collective.

        Args:
            of_gaps: See `by_positions`.
        """
        weights = pieces.at_points((of_gaps / pieces.areas)[:, None])
        rows = pieces.spread(weights * pieces.there.normal).reshape(-1, self._dim)
        return rows[: pieces.node_owners.count]

    def _turning(self, pressures: FloatArray, gaps: FloatArray) -> Blocks:
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
        return blocks_between(pieces.nodes(some), K.transpose(0, 1, 3, 2, 4))


class _BodyGaps(VertexGaps):
    """See `LinearGaps`. Collective to make."""

    def __init__(self, pair: BodyContact) -> None:
        super().__init__(pair)
        self._cut = CutChanges(pair, pair.pieces, pair.state()[0])

    def left_out(self, motion: FloatArray, multipliers: FloatArray) -> FloatArray:
        """See `LinearGaps`: what the cut changes."""
        return self._cut.transposed(-motion, multipliers)


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
        # Harmonic means: where some faces are smaller, contact is expected.
        inverse = facet_areas(body.mesh, facets.astype(np.int32)) ** (-1 / (body.dim - 1))
        sums = total(body.comm, np.array([inverse.sum(), float(len(facets)), float(stiffness)]))
        sizes.append(float(sums[1] / sums[0]))
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
