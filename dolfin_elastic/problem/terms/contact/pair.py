"""`ContactPair`: a surface of the body and a rigid obstacle, as terms and as numbers.

The pressure per reference area is p = max(0, lam - eps g), with the gap g of the current place
X + u, the penalty eps and the multiplier lam; its virtual work is the integral of p n . v over the
reference surface, n the obstacle's normal.  As n is the gradient of g it has the potential
(p^2 - lam^2)/(2 eps), so the tangent is symmetric.  For the pressure of the steps of an implicit
motion see `step`.

Source: P. Wriggers, Computational Contact Mechanics, 2nd ed., Springer 2006, sections 6.3.4 and
10.3.4 (augmented Lagrange, Uzawa); P. Alart & A. Curnier, Comput. Methods Appl. Mech. Eng. 92
(1991) 353.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.mesh.geometry.simplices import (
    cell_corners,
    cells_beside_facets,
    dofs_on_facets,
    facet_corners,
    prepare_facets,
)
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.spaces import Unknowns
from dolfin_elastic.problem.term import Acting
from dolfin_elastic.problem.terms.contact.depths import UNSEEN, Depth, Faces, deepest_of
from dolfin_elastic.problem.terms.contact.step import ContactStep, InSteps
from dolfin_elastic.problem.terms.contact.surfaces import (
    FACTOR,
    at_nodes,
    heights_over,
    mean_height,
    nodal,
    owned_areas,
    penalties,
)

SOFT = 0.1
"""Penalty in dynamics over that in statics.

In an explicit scheme a node that hits in mid-step gains energy where the penalty is stiff, see
`stable_step.CONTACT`; and a penalty stiffer than the cells above it only shortens the stable step.
"""

SLACK = 1e-9
"""Gap, over the size of a cell, up to which a surface is in contact.

A body that only lies on an obstacle has a stiffness against it then, round-off or not; the pull
that such a gap makes is 1e-8 of the modulus.
"""

SQUEEZE = 1e-2
"""Penetration that statics leaves over the height by which the pressure shortens an element.

No body is stiffer than a layer of one element that cannot widen, so forces err by less than this.
"""

ENDED = 1e-6
"""Pressure over that of the multiplier which is but round-off: it ends there, at whatever gap."""

FAR = 1e30
"""Gap [m] beyond all others."""

STRIDE = 0.5
"""Share of an obstacle's radius that it may move in one step, lest it jump over a surface."""

TOUCHING = 0.25
"""Gap, over the height of the elements, up to which faces show on which side of it the body is."""

MOST_PLACES = 200
"""On the way of a node through a thin obstacle that are looked at."""

LOOKS = 64
"""Places of an obstacle on its way in a step at which its depth is looked at."""

PASSED = 0.1
"""Depth over the height of the elements up to which an obstacle only grazes the surface."""

HALVINGS = 30
"""Of a step in which an obstacle moves too far."""

_ALONG = 1e-6
"""Part of a normal that is free where the displacement along it is prescribed."""


class ForceAlong(Protocol):
    """The force of an obstacle on the body along a direction.

    Attributes:
        stiffness: Force per depth where all of the surface is in contact [N/m].
    """

    stiffness: float

    def value(self) -> float:
        """The present force [N]. Collective."""

    def row(self) -> FloatArray:
        """Its derivative by the unknowns, owned entries [N/m]. Collective."""


class _Pressures(InSteps):
    """Gaps and pressures of one contact on one body. Collective to make.

    Args:
        index: From 0, in the case.
        thickness: Of a plane body [m].
        surfaces: Names of those that carry the pressures; by default all of the contact.

    Attributes:
        contact: What the user wrote.
        label: What results call it.
        index: As given.
        facets: Local facets of its surfaces, ghosts too.
        lam: Multiplier [Pa], a value at each vertex; 0 in motion.
        penalty: eps [Pa/m], one number a cell beside the surface.
        size: Mean height of the cells over the surface [m].
        tolerance: Largest penetration that statics ever leaves [m], see `allowed_gap`.
        eps: Penalty at the owned vertices [Pa/m].
        carrier: Which of the displacement's owned nodes are on the side whose force is the
            contact's; None: all of the surface.
        softness: By how much a pressure there shortens the element behind it [m/Pa].
        slack: Gap that counts as none [m], see `SLACK`.
        pulls_to: Gap up to which each owned vertex pulls until the next update [m]; 0: none.
        augments: Multipliers are those of statics; in motion there are penalties alone.
        nodes: Owned vertices of the surface in the space of `lam`.
        nodes_of_displacement: The same vertices in the displacement's space.
        follows: Supports that must not move the body through the obstacle in one step.
    """

    linear, restrains, opens, account = False, True, True, "contact"
    carrier: BoolArray | None = None
    states = "open", "pressed"

    def __init__(
        self, contact: Contact, context: FormContext, index: int, thickness: float
    ) -> None:
        body = context.body
        self.contact, self.label, self._context = contact, contact.label, context
        self._axisymmetric = context.geometry == "axisymmetric"
        self.comm, self._dim = body.comm, body.dim
        prepare_facets(body.mesh)
        facets = np.unique(np.concatenate([body.surface(name) for name in self._names(contact)]))
        self.facets = facets.astype(np.int32)
        self.lam, self.nodes, self.nodes_of_displacement = nodal(context, facets, 1)
        every = self.lam.function_space.tabulate_dof_coordinates()
        self._places: FloatArray = np.asarray(every[self.nodes, : body.dim])
        self.memory, self.index = {f"contact_{index}": self.lam}, index
        self.follows: Constraints | None = None
        self.at_rest = not contact.moves and contact.push is None
        heights = heights_over(body, facets)
        self.penalty = penalties(context, *heights)
        self.size = mean_height(body, facets, heights)
        self.tolerance = contact.gap_tolerance or 1e-3 * self.size
        self.eps = at_nodes(body, facets, self.penalty, self.lam.function_space)[self.nodes]
        self.softness = FACTOR / self.eps
        if contact.stiffness is not None:
            self.penalty.x.array[self.penalty.x.array > 0.0] = self.eps[:] = contact.stiffness
        self._first = self.penalty.x.array.copy(), self.eps.copy()
        self._areas = owned_areas(body, self.facets, None if self._axisymmetric else thickness)
        self.pose = Pose(context, contact.centre)
        self.shift = self.pose.shift
        if contact.between is None:
            self._at_nodes = contact.obstacle.followed()
        self.pulls_to: FloatArray = np.zeros(len(self.nodes))
        self.slack, self.augments = SLACK * cell_size(body), True
        self._reach = context.constant(self.slack)
        self.step = ContactStep(context, self.pose, self.size)

    def _names(self, contact: Contact) -> Sequence[str]:
        """Of the surfaces that carry the pressures."""
        return contact.surfaces

    def begin(self, *, moving: bool) -> None:
        """See `Term`: motion has penalties alone, and softer ones where the user gave none."""
        factor = SOFT if moving else 1.0
        self.augments, self.step.begun = not moving, False
        if self.contact.stiffness is None:
            self.penalty.x.array[:] = factor * self._first[0]
            self.eps = factor * self._first[1]
        if moving:
            self.lam.x.array[:] = 0.0

    # --- numbers at the nodes ---

    def places(self) -> FloatArray:
        """Reference places of the owned nodes of the surface, shape (n, dim)."""
        return self._places

    def gaps(self) -> tuple[FloatArray, FloatArray]:
        """Gaps [m] and obstacle's normals at the owned nodes, (n,) and (n, dim). Not collective."""
        gaps, normals = self.contact.obstacle.gaps(self.seen())
        return gaps, self.pose.to_space(normals)

    def nodal_normals(self) -> FloatArray:
        """Normals at the owned nodes in an iteration, as the obstacle has them, (n, dim). Local."""
        return self._at_nodes.gaps(self.seen())[1]

    def seen(self) -> FloatArray:
        """Places of the owned nodes as the obstacle sees them, (n, dim)."""
        return self.step.at_stage(self.places(), self._of_nodes)

    def _of_nodes(self, of_all: FloatArray) -> FloatArray:
        """The rows of the owned nodes of what all nodes have."""
        return np.asarray(of_all[self.nodes_of_displacement])

    def pressures(self, penalty: FloatArray | None = None) -> FloatArray:
        """Pressure per reference area at the owned nodes of the surface, of the step [Pa].

        Collective.

        Args:
            penalty: In place of `eps` [Pa/m].
        """
        lam, eps = self.lam.x.array[self.nodes], self.eps if penalty is None else penalty
        first, last = (lam - eps * gaps for gaps in self.end_gaps())
        found = self.step.pressures(first, last, -eps * (self.reach + self.pulls_to))
        return np.where(self.pulls_to > 0.0, found, np.maximum(0.0, found))

    def values(self) -> FloatArray:
        """Multipliers at the owned nodes of the surface [Pa]. Not collective."""
        return np.asarray(self.lam.x.array[self.nodes])

    def end_gaps(self) -> tuple[FloatArray, FloatArray]:
        """`pressing_gaps` at both ends of the step [m]. Collective."""
        if not self.step.on:
            gaps = self.pressing_gaps()
            return gaps, gaps
        first, last = self.step.ends(self.places(), self._of_nodes)
        return self.contact.obstacle.gaps(first)[0], self.contact.obstacle.gaps(last)[0]

    @property
    def reach(self) -> float:
        """Gap [m] up to which the surface is in contact."""
        return float(self._reach.value)

    def nodal_gaps(self) -> tuple[IndexArray, FloatArray]:
        """Owned nodes of the displacement on the surface, and gaps there [m]. Not collective."""
        return self.nodes_of_displacement, self.gaps()[0]

    def every_gap(self) -> FloatArray:
        """Gaps of all points of the surface that count as its penetration [m]. Not collective."""
        return self.nodal_gaps()[1]

    def pressing_gaps(self) -> FloatArray:
        """Gaps that the pressures at the owned nodes follow [m]. Collective."""
        return self.gaps()[0]

    def nodal_pressures(self) -> tuple[IndexArray, FloatArray]:
        """Owned nodes of the displacement on the surface, and pressures there [Pa]. Collective."""
        return self.nodes_of_displacement, self.pressures()

    def area(self) -> float:
        """Reference area on which there is pressure [m^2]. Collective."""
        return self.area_above(self.levels())

    def levels(self) -> FloatArray:
        """Pressures at the owned nodes, where there is none minus the gap over the softness [Pa].

        Linear between vertices, it ends where there is neither. Collective.
        """
        pressures, gaps = self.pressures(), self.pressing_gaps()
        return np.where(pressures > 0.0, pressures, -np.abs(gaps) / self.softness)

    def area_above(self, levels: FloatArray) -> float:
        """Reference area on which a function that is linear on facets is above 0 [m^2]. Collective.

        Args:
            levels: Its values at the owned nodes.
        """
        S = self.lam.function_space
        level = np.zeros((S.dofmap.index_map.size_local, 1))
        level[self.nodes, 0] = levels
        own, areas = self._areas
        corners = with_ghosts(S.dofmap.index_map, level)[dofs_on_facets(S, own), 0]
        return total(self.comm, float(np.sum(areas * self.opposed() * positive_share(corners))))

    def opposed(self) -> FloatArray | float:
        """Part of each owned facet that lies opposite something."""
        return 1.0

    def along(self, way: FloatArray) -> ForceAlong:
        """The obstacle's force on the body along a unit vector. Collective."""
        raise NotImplementedError


class ContactPair(_Pressures):
    """One contact on one body. Collective to make."""

    _what, _rounds = "the obstacle", " by `offset` of a mesh"

    def share(self) -> FloatArray:
        """Part of the area of each owned node that lies opposite something, (n,). Not collective.

        A pressure on little area hardly moves the gap: its multiplier would grow on and on.
        """
        return np.ones(len(self.nodes))

    def gap_error(self) -> tuple[float, float]:
        """Largest distance from the obstacle of nodes that press or penetrate [m]. Collective.

        And that at which statics leaves them [m].  A node counts by its `share`.
        """
        gaps, lam = self.pressing_gaps(), self.lam.x.array[self.nodes]
        least = ENDED * largest(self.comm, float(np.max(lam, initial=0.0)))
        off = np.abs(gaps * self.share())[(self.pressures() > least) | (gaps < 0)]
        return largest(self.comm, float(np.max(off, initial=0))), allowed_gap(self)

    def unsettled(self) -> bool:
        """See `Term`: a node that presses is off its obstacle, beyond the tolerance.

        Under the law of motion it may be.
        """
        if not self.augments:
            return False
        off, allowed = self.gap_error()
        return off > allowed

    def augment(self) -> None:
        """Uzawa's update lam <- max(0, lam - eps g). Collective."""
        self.lam.x.array[self.nodes] = np.maximum(0.0, self.pressures())
        self.lam.x.scatter_forward()

    # --- where it touches ---

    def spots(self) -> tuple[FloatArray, FloatArray]:
        """Gaps [m] where those of the start are judged, and the reference places, (n, dim) [m]."""
        return self.gaps()[0], self.places()

    def assume(self, closed: bool | None, *, near: bool = False) -> None:
        """See `Term`."""
        # Closed is what is less than `FAR` away: opposite that there is nothing.
        reach = self.tolerance if near else FAR / 2
        self._reach.value = self.slack if closed is None else reach if closed else -FAR

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """See `Term`: as if the obstacle could pull, too; but not along its way under a force."""
        gaps, normals = self.gaps()
        within = gaps <= (self.size if near else self.reach)
        if self.contact.push is not None:
            way = self.contact.way(normals.shape[1])
            normals -= np.outer(normals @ way, way)
            lengths = np.linalg.norm(normals, axis=1)
            within &= lengths > _ALONG
            normals /= np.where(within, lengths, 1.0)[:, None]
        yield self.nodes_of_displacement[within], normals[within]

    def point_states(self) -> tuple[FloatArray, IndexArray]:
        """See `Term`."""
        return self.places(), (self.pressures() > 0.0).astype(np.int32)

    def distance(self) -> float:
        """See `Term`."""
        gap = smallest(self.comm, float(np.min(self.gaps()[0], initial=np.inf)))
        return gap if gap > self.reach else 0.0

    @stage("contact")
    def check_start(self) -> str:
        """See `Term`: no surface begins deep inside its obstacle, or touches it from within."""
        if self.contact.push is not None and self.contact.mass is None:
            return ""  # the force moves it to where it touches
        (gap, place), unit = nearest_spot(self), self._context.body.unit
        file = ", and is `unit` that of the file" if self.contact.shape == "mesh" else ""
        if gap < -self.size:
            raise InputError(
                f"at the start '{self.label}' lies {unit.length(-gap)} deep in the obstacle, "
                f"at {unit.point(place)}",
                where=f"contact[{self.index}].{self.contact.shape}",
                expected=f"at most an element deep, {unit.length(self.size)}; "
                f"does the normal point to the free side{file}?",
            )
        if gap < self.size and self._lies_behind():
            raise InputError(
                f"the body lies inside the obstacle that '{self.label}' touches, at "
                f"{unit.point(place)}",
                where=f"contact[{self.index}].{self.contact.shape}",
                expected="the body on its free side: turn the normal round, or change `inside`",
            )
        if gap >= -self.tolerance:
            return ""
        return (
            f"at the start '{self.label}' lies {unit.length(-gap)} deep in its obstacle, at "
            f"{unit.point(place)}: what the penalty stores there throws it off"
        )

    def _lies_behind(self) -> bool:
        """Whether elements are deeper in the obstacle than their faces that touch. Collective."""
        mesh, d = self._context.body.mesh, self._dim
        if largest(self.comm, float(np.max(np.abs(self._context.unknowns.u.x.array), initial=0))):
            return False  # it begins elsewhere
        beside, _ = cells_beside_facets(mesh, self.facets)
        middles = (
            self.pose.seen(corners.mean(axis=1)[:, :d] - self.shift.value)
            for corners in (facet_corners(mesh, self.facets), cell_corners(mesh, beside))
        )
        outer, inner = (self.contact.obstacle.gaps(places)[0] for places in middles)
        touches = np.abs(outer) < TOUCHING * self.size
        return total(self.comm, float(np.sum((inner - outer)[touches]))) < 0.0

    def conflict(self, constraints: Constraints) -> tuple[str, tuple[float, ...]] | None:
        """See `Term`: the obstacle pushes into nodes that are held along its normal.

        No state has these nodes outside.  What is prescribed, and where the obstacle is, are those
        of the time that was set last; all else is the problem's displacement.

        Returns:
            That in words, and the reference place of the deepest of these nodes [m]; None: none is
            deeper than the tolerance.
        """
        local = self.comm.allgather(_deepest_held(self, self._context.unknowns, constraints))
        if (found := min((one for one in local if one is not None), default=None)) is None:
            return None
        ((_, *place), gap, names), unit = found, self._context.body.unit
        by = f"the support '{names[0]}'" if names else "the axis"
        text = (
            f"the obstacle of contact[{self.index}] '{self.label}' pushes {unit.length(-gap)} "
            f"deep into nodes that {by} holds, at {unit.point(place)}"
        )
        return text, tuple(place)

    # --- time ---

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`: moves the obstacle, unless a force does."""
        if self.contact.push is None:
            self.pose.put(self.contact.pose_at(t, default, self._dim))

    def within_stride(self, t: float, goal: float, acting: Acting) -> float:
        """See `Term`: the obstacle moves no farther than it is thick; supports count by `follows`.

        Nor does it pass the surface: it goes to where it is deepest first. Collective.
        """
        if self.at_rest and self.follows is None:
            return goal
        goal = self._deepest(t, goal, acting)
        if not np.isfinite(stride := STRIDE * self.contact.obstacle.thickness):
            return goal

        for _ in range(HALVINGS):
            if _travel(self, acting(t), acting(goal)) <= stride:
                break
            goal = t + (goal - t) / 2
        return goal

    def _deepest(self, t: float, goal: float, acting: Acting) -> float:
        """Where the obstacle is deepest in the body at rest, if it is less deep at the end.

        A hook's edge that is beyond the nose at the end of the step has bent the hook on its way.
        Collective.
        """
        if self.at_rest or self.contact.between is not None or self.contact.push is not None:
            return goal
        u, ways = self._context.unknowns.u.x.array, np.linspace(t, goal, LOOKS + 1)
        poses = [self.contact.pose_at(*acting(s), self._dim) for s in ways]
        places = (self._seen_from(u.reshape(-1, self._dim) - at[:, 0], at) for at in poses)
        gaps = [np.min(self.contact.obstacle.gaps(x)[0], initial=np.inf) for x in places]
        least = np.array([smallest(self.comm, float(gap)) for gap in gaps])
        deepest = int(np.argmin(least))
        passes = least[deepest] < min(least[0], least[-1], 0.0) - PASSED * self.size
        return float(ways[deepest]) if passes else goal

    def longest_step(self, motion: FloatArray) -> float:
        """See `Term`: of nodes that are outside of the obstacle, and deep in it on the way."""
        way = self.pose.to_obstacle(self._of_nodes(motion.reshape(-1, self._dim)))
        return smallest(self.comm, float(np.min(self._free_shares(way), initial=1.0)))

    def passes(self, back: FloatArray, pose: FloatArray) -> bool:
        """See `Term`."""
        u = self._context.unknowns.u.x.array + back
        before = self._seen_from(u.reshape(-1, self._dim) - pose[:, 0], pose)
        shares = self._free_shares(before - self.seen())
        return smallest(self.comm, float(np.min(shares, initial=1.0))) < 1.0

    def _seen_from(self, past: FloatArray, pose: FloatArray) -> FloatArray:
        """See `seen`, in another pose.

        Args:
            past: Displacements less the obstacle's of all nodes [m].
        """
        return self.pose.seen(self.places() + self._of_nodes(past), pose[:, 1:])

    def _free_shares(self, way: FloatArray) -> FloatArray:
        """The share of its straight way after which each node is deep in a thin obstacle.

        Args:
            way: From here on, as the obstacle sees it, (n, dim) [m].
        """
        depth, shares = self.contact.obstacle.thickness, np.ones(len(way))
        if not np.isfinite(depth):
            return shares
        x, lengths = self.seen(), np.linalg.norm(way, axis=1)
        some = np.flatnonzero(lengths > STRIDE * depth)
        gaps, _ = self.contact.obstacle.gaps(x[some])
        some = some[(gaps > -depth / 2) & (gaps < lengths[some])]
        x, way, found = x[some], way[some], shares[some]
        count = int(min(np.ceil(2 * np.max(lengths[some], initial=0.0) / depth), MOST_PLACES))
        for part in range(1, count):
            gaps, _ = self.contact.obstacle.gaps(x + part / count * way)
            found = np.where((found == 1.0) & (gaps < -depth / 2), part / count, found)
        shares[some] = found
        return shares

    def advance(self) -> None:
        """See `Term`: no node has passed through its obstacle within the time step.

        Raises:
            ConvergenceError: One has.
        """
        if not self.step.begun:
            return
        if (found := self.intrusion()) is not None:
            raise ConvergenceError(found[0], advice=found[2])
        if self.contact.between is not None:
            return
        past = self.step.start.x.array.reshape(-1, self._dim)
        start, end = self._seen_from(past, self._begun), self.seen()
        passed = self.places()[self._free_shares(start - end) < 1.0].round(12).tolist()
        if places := [place for part in self.comm.allgather(passed) for place in part]:
            unit, depth = self._context.body.unit, self.contact.obstacle.thickness
            farthest = largest(self.comm, float(np.linalg.norm(end - start, axis=1).max(initial=0)))
            times = farthest / depth / STRIDE
            raise ConvergenceError(
                f"{len(places)} nodes of '{self.label}' pass through its obstacle within one time "
                f"step, one of them that at {unit.point(min(places))}: they move by up to "
                f"{unit.length(farthest)}, the obstacle is {unit.length(2 * depth)} thick",
                advice=f"a dt {times:.2g} times as small, or a thicker obstacle",
            )

    # --- depths between vertices ---

    @cached_property
    def _faces(self) -> Faces:
        own = self.facets < self._context.body.mesh.topology.index_map(self._dim - 1).size_local
        return Faces(self._context, self.facets[own])

    @cached_property
    def _edges(self) -> FloatArray:
        return self.contact.obstacle.edges(self._dim)

    def deepest(self) -> Depth:
        """The deepest point of faces in it, or of its edges in elements. Collective."""
        obstacle, u = self.contact.obstacle, self._context.unknowns.u.x.array
        faces = self._faces.at(u.reshape(-1, self._dim) - self.shift.value).seen_from(self.pose)
        gaps = obstacle.gaps(faces.corners)[0].min(axis=1)
        near = gaps < faces.sizes
        faces, seen = faces.some(near), np.maximum(0.0, -gaps[near])
        under = faces.under(obstacle.gaps(faces.x)[0])
        return deepest_of(self.comm, under, faces.entered(self._edges, seen, obstacle.edge_radius))

    def intrusion(self) -> tuple[str, tuple[float, ...], str] | None:
        """See `Term`: it lies deeper in what it touches than its vertices see."""
        found, unit = self.deepest(), self._context.body.unit
        if found.unseen <= UNSEEN:
            return None
        text = (
            f"{self._what} lies {unit.length(found.depth)} deep in '{self.label}', between the "
            f"vertices of a face, at {unit.point(found.place)}; the longest edge of the face is "
            f"{unit.length(found.size)}"
        )
        advice = (
            f"edges rounded{self._rounds} with a radius of {unit.length(found.size / 2)}, or "
            "faces there that are no longer than twice the radius that they have"
        )
        return text, found.place, advice

    # --- results ---

    @stage("contact")
    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: largest penetration [m] and area under pressure [m^2]."""
        depth = largest(self.comm, float(np.max(-self.every_gap(), initial=0.0)))
        depth = max(depth, self.deepest().depth)
        first, second = f"penetration_{self.label}", f"contact_area_{self.label}"
        result[first] = max(result.get(first, 0.0), depth)
        result[second] = result.get(second, 0.0) + self.area()


def positive_share(corners: FloatArray) -> FloatArray:
    """Share of each edge or triangle on which a linear function is above 0, shape (n,).

    Args:
        corners: Its values, shape (n, 2 or 3).
    """
    high, *middle, low = np.sort(corners, axis=1)[:, ::-1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        some = high / (high - low)
        for value in middle:
            below = low / (low - high) * low / (low - value)
            some = np.where(value > 0.0, 1.0 - below, some * high / (high - value))
    return np.where(low > 0.0, 1.0, np.where(high > 0.0, some, 0.0))


def allowed_gap(pair: ContactPair) -> float:
    """Distance from the obstacle at which statics leaves nodes that press [m]. Collective.

    As the pressure squeezes the elements, without the user's word, see `SQUEEZE`.
    """
    if pair.contact.gap_tolerance is not None:
        return pair.tolerance
    squeezed = float(np.max(pair.pressures() * pair.softness, initial=0.0))
    least = max(pair.slack, SQUEEZE * largest(pair.comm, squeezed))
    return min(pair.tolerance, least)


def nearest_spot(pair: ContactPair) -> tuple[float, tuple[float, ...]]:
    """Smallest gap [m], and where [m], alike on any number of ranks. Collective."""
    gaps, places = pair.spots()
    local = [
        (float(gap), tuple(place.round(12).tolist()))
        for gap, place in zip(gaps, places, strict=True)
        if gap <= np.min(gaps, initial=np.inf) + 1e-9 * pair.size
    ]
    rows = [row for part in pair.comm.allgather(local) for row in part]
    least = min((gap for gap, _ in rows), default=np.inf) + 1e-9 * pair.size
    near = (row for row in rows if row[0] <= least)
    return min(near, key=lambda row: row[1], default=(np.inf, ()))


def _travel(
    pair: ContactPair, start: tuple[float, Amplitude], end: tuple[float, Amplitude]
) -> float:
    """How far an obstacle moves, and supports do [m]. Collective."""
    poses = [pair.contact.pose_at(*at, pair._dim) for at in (start, end)]
    result = float(np.linalg.norm(poses[1][:, 0] - poses[0][:, 0]))
    if pair.contact.rotation is not None:
        u = pair._context.unknowns.u.x.array.reshape(-1, pair._dim)
        ways = np.subtract(*(pair._seen_from(u, pose) for pose in poses))
        result += largest(pair.comm, float(np.max(np.linalg.norm(ways, axis=1), initial=0.0)))
    if pair.follows is not None:
        (one,), (two,) = (pair.follows.values_at([t], default) for t, default in (start, end))
        result += largest(pair.comm, float(np.max(np.abs(two - one), initial=0.0)))
    return result


def _deepest_held(
    pair: ContactPair, unknowns: Unknowns, constraints: Constraints
) -> tuple[list[float], float, list[str]] | None:
    """The deepest of this rank's nodes, see `conflict`: a key, its gap [m], who holds it.

    The key orders nodes by depth and place, alike on any number of ranks; the place [m] ends it.
    Collective.
    """
    dim = unknowns.V.dofmap.index_map_bs
    u, own = unknowns.u.x.array, unknowns.V.dofmap.index_map.size_local * dim
    saved = u.copy()
    constraints.impose(u[:own], constraints.values.x.array)
    gaps, normals = pair.gaps()
    u[:] = saved
    free, nodes = constraints.free_directions(own, dim), pair.nodes_of_displacement
    for motion in (one for one in constraints.rigid_motions if one.free):
        dofs = constraints.motion_directions(motion)[0]
        dofs = dofs[dofs < own]
        free[dofs, dofs % dim] = 1.0
    left = np.einsum("nij,nj->ni", free.reshape(-1, dim, dim)[nodes], normals)
    inside = (gaps < -pair.tolerance) & (np.abs(left).max(axis=1, initial=0.0) < _ALONG)
    places = pair.places().round(12) + 0.0
    keys = [
        ([round(gaps[k] / pair.size, 9), *places[k].tolist()], k) for k in np.flatnonzero(inside)
    ]
    if not keys:
        return None
    key, k = min(keys)
    forces = np.zeros(own)
    forces.reshape(-1, dim)[nodes[k]] = normals[k]
    holders = constraints.reactions(forces)
    names = [one.label for one, at, rows in holders if np.any(rows[at == nodes[k]])]
    return key, float(gaps[k]), names
