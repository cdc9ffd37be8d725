"""`VertexContact`: contact of quadratic faces, its pressures at their vertices.

With the mean gap g_I at a vertex, see `vertex_functions`, the penalty eps and the multiplier lam,

    p_I = max(0, lam_I - eps g_I),

and the virtual work is the sum of p_I times the integral of psi_I n . v.  It has the potential sum
of A_I (p_I^2 - lam_I^2)/(2 eps); uniform pressures pass the patch test.

In statics a vertex that pressed in the last equilibrium pulls until the next one is found, and
opens with the update of its multiplier: in the first iterations a body that bends or turns would
leave what it presses on, fall back on it, and leave it again.  Where Newton's method has the
pressures as unknowns, see `multipliers`, it does so in the first iteration only.

Source: P. Wriggers, Computational Contact Mechanics, 2nd ed., Springer 2006, sections 6.3.4 and
10.3.4 (sets of active constraints that change between equilibria); and that of the functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import la

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.shapes.shapes import Plane, Shape
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks, Kind, Means, Multipliers
from dolfin_elastic.problem.terms.contact.bulges import FaceBulges
from dolfin_elastic.problem.terms.contact.multipliers import RIGID, SETTLED, PressureIterate
from dolfin_elastic.problem.terms.contact.nodal import RULE
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.pressures import LinearGaps
from dolfin_elastic.problem.terms.contact.surfaces import FACTOR
from dolfin_elastic.problem.terms.contact.vertex_functions import VertexFunctions, blocks_of


class Way(NamedTuple):
    """What the points of the functions pass in a step.

    Attributes:
        first: Gaps at its start, shape (facets, points) [m].
        last: Gaps at its end.
        along: Direction of the forces, see `step`, shape (facets, points, dim).
        normals: The obstacle's at the end.
    """

    first: FloatArray
    last: FloatArray
    along: FloatArray
    normals: FloatArray


class _Followed(ContactPair):
    """A contact whose obstacle is followed through an iteration, see `Shape.followed`."""

    _followed: tuple[Shape, ...] = ()
    multipliers: VertexPressures

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        super().begin(moving=moving)
        self._forget()

    def commit(self) -> None:
        """See `Term`."""
        super().commit()
        self._forget()

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        super().leave_stage(found=found)
        self._forget()

    def advance(self) -> None:
        """See `Term`."""
        super().advance()
        self._forget()

    def rollback(self) -> None:
        """See `Term`."""
        super().rollback()
        self._forget()

    def unsettled(self) -> bool:
        """See `Term`: or a vertex pulls, which the next update opens."""
        pulls = (self.pulls_to > 0.0) & (self.pressures() < -self.eps * self.reach)
        return largest(self.comm, float(np.any(pulls))) > 0.0 or super().unsettled()

    def augment(self) -> None:
        """See `Term`."""
        super().augment()
        self.open()

    def pressures(self, penalty: FloatArray | None = None) -> FloatArray:
        """See `ContactPair`."""
        now = self.multipliers.iterate
        return super().pressures(penalty) if now is None else now.acting

    def values(self) -> FloatArray:
        """See `ContactPair`."""
        now = self.multipliers.iterate
        return super().values() if now is None else now.values

    @property
    def stiff(self) -> FloatArray:
        """Penalty at the owned vertices that leaves next to no gap [Pa/m]."""
        return np.asarray(RIGID * np.maximum(self._first[1], FACTOR / self.softness))

    def keep(self, pressing: BoolArray | None) -> None:
        """See `Pressures`: as stiff as in Newton's method, whose factors serve for the tangent."""
        super().keep(pressing)
        self.eps = self._first[1] if pressing is None else self.stiff

    def _forget(self) -> None:
        """What an iteration has learnt of an obstacle's normals does not outlive it."""
        for obstacle in self._followed:
            obstacle.forget()
        self.open()

    def open(self) -> None:
        """Vertices that pressed in the last equilibrium pull before they open, others do not."""
        self.delays = False
        self.pulls_to[:] = np.where(self.lam.x.array[self.nodes] > 0.0, self.size, 0.0)


class VertexContact(_Followed):
    """One contact of quadratic faces.  Its forces are in no form. Collective to make.

    Args:
        index: From 0, in the case.
        thickness: Of a plane body [m].

    Attributes:
        functions: By which gaps are weighted.
        bulges: What keeps faces straight between vertices that press.
        near: Which of the owned vertices have ever been in contact.
        multipliers: Its pressures.
    """

    nodal = True

    def __init__(
        self, contact: Contact, context: FormContext, index: int, thickness: float
    ) -> None:
        super().__init__(contact, context, index, thickness)
        if contact.between is None:
            self._of_points, *self._of_ends = (contact.obstacle.followed() for _ in range(3))
            self._followed = self._at_nodes, self._of_points, *self._of_ends
        self.functions = self._make_functions(thickness)
        self.bulges = FaceBulges(self, self.functions, context)
        self.near: BoolArray = np.zeros(len(self.nodes), dtype=bool)
        self.multipliers = VertexPressures(self)

    def _make_functions(self, thickness: float) -> VertexFunctions:
        return VertexFunctions(self, self._context, thickness)

    # --- gaps and pressures ---

    def places_of_points(self) -> FloatArray:
        """The points of the functions as the obstacle sees them, (facets, points, dim) [m]."""
        return self.step.at_stage(self.functions.X, self.functions.displacements)

    def _at_points(self) -> tuple[FloatArray, FloatArray]:
        """Gaps and normals there, shapes (facets, points) and (facets, points, dim)."""
        gaps, normals = _measured(self.functions, self._of_points, self.places_of_points())
        return gaps, self.pose.to_space(normals)

    def _over_step(self) -> Way:
        """Gaps and normals at the points over the step; of a state all ends are alike."""
        if not self.step.on:
            gaps, normals = self._at_points()
            return Way(gaps, gaps, normals, normals)
        first, last = self.step.ends(self.functions.X, self.functions.displacements)
        before = _measured(self.functions, self._of_ends[0], first)[0]
        gaps, normals = _measured(self.functions, self._of_ends[1], last)
        middle = _measured(self.functions, self._of_points, (first + last) / 2)[1]
        along = self.step.mean_normals((before, gaps), last - first, middle)
        return Way(before, gaps, self.pose.acting(along), self.pose.to_space(normals))

    def end_gaps(self) -> tuple[FloatArray, FloatArray]:
        """See `ContactPair`: mean gaps."""
        return self._means_over(self._over_step())

    def _means_over(self, way: Way) -> tuple[FloatArray, FloatArray]:
        """Mean gaps at both ends of the step. Collective."""
        first = self._mean(way.first)
        return first, self._mean(way.last) if self.step.on else first

    def nodal_gaps(self) -> tuple[IndexArray, FloatArray]:
        """See `ContactPair`: those of midside nodes, too."""
        _, _, nodes = self.functions.every
        X = self._context.unknowns.V.tabulate_dof_coordinates()[nodes, : self._dim]
        places = self.step.at_stage(X, lambda of_all: of_all[nodes])
        return nodes, self.contact.obstacle.gaps(places)[0]

    def pressing_gaps(self) -> FloatArray:
        """See `ContactPair`: mean gaps."""
        return self._mean(self._at_points()[0])

    def _mean(self, gaps: FloatArray) -> FloatArray:
        return self.functions.means(gaps[..., None])[:, 0]

    def state(self, way: Way | None = None) -> tuple[FloatArray, FloatArray]:
        """Pressures at the owned vertices, and how they fall with their gap [Pa/m]. Collective.

        In a step with the gap at its stage; those that fall are in contact.

        Args:
            way: Of `_over_step`, where it is known.
        """
        way = self._over_step() if way is None else way
        if (now := self.multipliers.iterate) is not None:
            return now.acting, now.falls
        lam, least = self.lam.x.array[self.nodes], self.least(self.eps)
        first, last = (lam - self.eps * gaps for gaps in self._means_over(way))
        pressures = self.step.pressures(first, last, least)
        return pressures, self.eps * self.step.softening(first, last, least)

    def nodal_pressures(self) -> tuple[IndexArray, FloatArray]:
        """See `ContactPair`: linear between the vertices."""
        nodes, pressures = self.functions.at_nodes(self.pressures()[:, None])
        return nodes, pressures[:, 0]

    # --- forces ---

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`: of linear elements, as the trapezoidal rule has it."""
        if kind != "bound" or self._context.unknowns.degree > 1:
            return None
        measure = self._context.measures.contact_area(self.contact.surfaces, RULE)
        return self.penalty * sum(self._context.v) * measure

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`."""
        forces += self.forces()

    def forces(self) -> FloatArray:
        """Nodal forces on the body before the ranks are summed, (nodes * dim,) [N]. Collective."""
        way = self._over_step()
        pressures, _ = self.state(way)
        return self.functions.spread(self.bulges.loads(pressures, way.last)[..., None] * way.along)

    def energy(self) -> float:
        """See `Term`: the potential has the multiplier at rest."""
        gaps = self._at_points()[0]
        return stored(self, self._mean(gaps), self.functions.areas) + self.bulges.energy(gaps)

    def blocks(self) -> Blocks:
        """See `Term`: sum of (eps/A_I) G_I G_I, less that of the pressures by the normals' turn.

        G_I is the integral of psi_I n . N.  Vertices that have ever been in contact keep their
        blocks, of zeros, so that the tangent's pattern seldom changes.
        """
        from scipy.sparse import diags_array

        way = self._over_step()
        pressures, falls = self.state(way)
        self.near |= falls > 0
        if self.delays and self.augments:
            self.pulls_to[falls > 0] = self.size
        nodes, G = self.functions.rows(self.near, way.normals)
        same = way.along is way.normals
        pushes = G if same else self.functions.rows(self.near, way.along)[1]
        stiffness = diags_array(falls / self.functions.areas)
        result = blocks_of(nodes, pushes.T @ stiffness @ G, G, self._dim)
        if self.bulges.some:
            some, values = self.bulges.tangent(way.normals)
            result += blocks_between(self.functions.nodes(some), values)
        if self.multipliers.iterate is not None:
            pressures = self.values()
        return result if self.flat else result + self._turning(pressures, way.last)

    def means(self) -> Means:
        """See `Term`."""
        from scipy.sparse import csr_array, diags_array

        nodes, rows = self.functions.rows(np.ones(len(self.nodes), dtype=bool))
        weights = csr_array(diags_array(1 / self.functions.areas) @ rows)
        return Means(self.nodes_of_displacement, weights, nodes)

    @property
    def flat(self) -> bool:
        """The obstacle is a plane."""
        return isinstance(self.contact.obstacle, Plane)

    def normals(self) -> FloatArray:
        """Along which gaps grow at the points of the functions, (facets, points, dim)."""
        return self._over_step().normals

    def curvatures(self) -> FloatArray | None:
        """Second derivatives of the gap at the owned vertices, (n, dim, dim) [1/m]; None: 0."""
        if self.flat:
            return None
        return self.pose.matrices_to_space(self._at_nodes.curvature(self.seen()))

    def curvatures_of_points(self) -> FloatArray:
        """Those at the points of the functions, (facets, points, dim, dim) [1/m]."""
        x, (first, rows) = self.places_of_points(), self.functions.distinct
        curvature = self._of_points.curvature(x.reshape(-1, self._dim)[first])
        curvature = self.pose.matrices_to_space(curvature)
        return curvature[rows].reshape(*x.shape, self._dim)

    def _turning(self, pressures: FloatArray, gaps: FloatArray) -> Blocks:
        """Minus the derivative of the forces by the turn of the normals. Collective.

        Args:
            pressures: At the owned vertices [Pa].
            gaps: At the points of the functions [m].
        """
        at_points = self.bulges.loads(pressures, gaps)
        some: BoolArray = np.asarray(self.functions.beside(self.near).any(axis=1))
        curvature = self.curvatures_of_points()[some]
        N = self.functions.at(some)
        values = -np.einsum(
            "fq,fqk,fql,cd,fqde->fklce",
            at_points[some],
            N,
            N,
            self.pose.pushes,
            curvature,
            optimize=True,
        )
        return blocks_between(self.functions.nodes(some), values)

    def along(self, way: FloatArray) -> _ForceOfVertices:
        """See `ContactPair`."""
        return _ForceOfVertices(self, way)

    @property
    def linearised(self) -> VertexGaps:
        """See `Pressures`."""
        return VertexGaps(self)


class VertexPressures(Multipliers):
    """The pressures of one contact as unknowns.

    Attributes:
        iterate: They in an iteration of Newton's method; None: they follow the displacement.
    """

    def __init__(self, pair: VertexContact) -> None:
        self._pair = pair
        self.iterate: PressureIterate | None = None

    def linearise(self) -> bool:
        """See `Multipliers`: in statics."""
        pair = self._pair
        if not pair.augments:
            return False
        gaps, p, before = pair.pressing_gaps(), pair.values(), self.iterate
        presses = p > 0.0 if before is None else before.active
        stays = (p >= -pair.eps * pair.reach) & (gaps < pair.size)
        active = np.where(presses, stays, gaps <= pair.reach)
        values = np.where(active, p, 0.0)
        self.iterate = PressureIterate(
            values=values, gaps=gaps, active=active, stiffness=pair.stiff
        )
        return True

    def foresee(self, motion: FloatArray) -> None:
        """See `Multipliers`."""
        if self.iterate is not None:
            self.iterate.foresee(gap_rates(self._pair, motion))

    def take_step(self, share: float) -> None:
        """See `Multipliers`."""
        if self.iterate is not None:
            self.iterate.step(share)

    def holds(self) -> bool:
        """See `Multipliers`: no vertex that presses is off its obstacle, and none pulls."""
        if (now := self.iterate) is None:
            return True
        pair = self._pair
        gaps, most = pair.pressing_gaps(), largest(pair.comm, float(np.max(now.values, initial=0)))
        pulls = now.active & (now.values < -pair.eps * pair.reach)
        # Nor do its pressures differ from those of the law, which have the gaps in them.
        loose = now.active & (np.abs(gaps) > np.maximum(pair.slack, SETTLED * most / pair.eps))
        off, allowed = pair.gap_error()
        return off <= allowed and not largest(pair.comm, float(np.any(pulls | loose)))

    def end(self, *, found: bool) -> None:
        """See `Multipliers`: the law of the penalty has the same pressures here."""
        (now, self.iterate), pair = (self.iterate, None), self._pair
        if now is not None and found:
            gaps = pair.pressing_gaps()
            left = np.where(now.active | (gaps < 0.0), gaps, 0.0)
            pair.lam.x.array[pair.nodes] = now.values + pair.eps * left
            pair.lam.x.scatter_forward()
            pair.open()  # what was left in the iterations pulls no more


def gap_rates(pair: VertexContact, motion: FloatArray) -> FloatArray:
    """Changes of the mean gaps of owned vertices by a motion of local nodes [m]. Collective.

    Without the turn of normals.
    """
    along = np.sum(pair.normals() * pair.functions.displacements(motion), axis=2)
    return pair.functions.means(along[..., None])[:, 0]


def blocks_between(nodes: IntArray, values: FloatArray) -> Blocks:
    """Blocks of all pairs of nodes (facets, k) of facets, from (facets, k, k, dim, dim)."""
    shape, d = values.shape[:3], values.shape[-1]
    i, j = np.broadcast_to(nodes[:, :, None], shape), np.broadcast_to(nodes[:, None], shape)
    return Blocks(i.ravel(), j.ravel(), values.reshape(-1, d, d))


def nodal_forces(pair: VertexContact, vectors: FloatArray) -> FloatArray:
    """Forces at the points of the functions, as owned entries of all unknowns [N]. Collective.

    Args:
        vectors: With integrals, shape (facets, points, dim) [N].
    """
    nodes, dim = pair._context.unknowns.V.dofmap.index_map, vectors.shape[-1]
    vector = la.vector(nodes, dim)
    vector.array[:] = pair.functions.spread(vectors)
    vector.scatter_reverse(la.InsertMode.add)
    return of_unknowns(pair, vector.array[: nodes.size_local * dim])


def of_unknowns(pair: VertexContact, forces: FloatArray) -> FloatArray:
    """Owned entries of the displacement as those of all unknowns. Not collective."""
    unknowns = pair._context.unknowns
    result = np.zeros(unknowns.W.dofmap.index_map.size_local * unknowns.W.dofmap.index_map_bs)
    result[unknowns.mixed_dofs(np.arange(len(forces), dtype=np.int32))] = forces
    return result


def stored(pair: VertexContact, gaps: FloatArray, areas: FloatArray) -> float:
    """The energy of mean gaps at vertices with some areas [J]. Collective."""
    lam = pair.lam.x.array[pair.nodes]
    squares = np.maximum(lam - pair.eps * gaps, 0.0) ** 2 - lam**2
    return total(pair.comm, float(np.sum(areas * squares / (2 * pair.eps))))


def _measured(
    functions: VertexFunctions, obstacle: Shape, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gaps and normals of an obstacle where the points of the functions are."""
    first, rows = functions.distinct
    gaps, normals = obstacle.gaps(x.reshape(-1, x.shape[-1])[first])
    return gaps[rows].reshape(x.shape[:-1]), normals[rows].reshape(x.shape)


class VertexGaps(LinearGaps):
    """See `LinearGaps`."""

    def __init__(self, pair: VertexContact) -> None:
        self._pair, self.areas = pair, pair.functions.areas
        self._gaps, self._normals = pair._at_points()

    def rates(self, motion: FloatArray) -> FloatArray:
        """See `LinearGaps`: bulges depend on the multipliers, too."""
        pair, functions = self._pair, self._pair.functions
        along = np.sum(self._normals * functions.displacements(motion), axis=2)
        rates = functions.means(along[..., None])[:, 0]
        if pair.bulges.some:
            rates += pair.bulges.by_multipliers(self._gaps, along) / self.areas
        return rates if pair.kept is None else rates * pair.kept

    def spread(self, pressures: FloatArray) -> FloatArray:
        """See `LinearGaps`."""
        at_points = self._pair.functions.at_points(pressures[:, None])
        return nodal_forces(self._pair, at_points * self._normals)


class _ForceOfVertices:
    """See `ForceAlong`."""

    def __init__(self, pair: VertexContact, way: FloatArray) -> None:
        self._pair, self._way = pair, way
        self.stiffness = total(pair.comm, float(np.sum(pair.functions.areas * pair.eps)))

    def value(self) -> float:
        """See `ForceAlong`."""
        forces = self._pair.forces().reshape(-1, len(self._way))
        return total(self._pair.comm, float(np.sum(forces @ self._way)))

    def row(self) -> FloatArray:
        """See `ForceAlong`."""
        pair, functions = self._pair, self._pair.functions
        (pressures, falls), normals = pair.state(), pair.normals()
        along = functions.means((normals @ self._way)[..., None])[:, 0]
        softer = functions.at_points((-falls * along)[:, None])
        softer += pair.bulges.pressures(normals @ self._way)[..., None]
        turns = pair.curvatures_of_points() @ self._way
        loads = pair.bulges.loads(pressures, pair._at_points()[0])
        at_points = softer * normals + loads[..., None] * turns
        return nodal_forces(pair, at_points)
