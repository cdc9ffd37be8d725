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

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import ConvergenceError, InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.simplices import (
    cell_corners,
    cells_beside_facets,
    facet_corners,
)
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.spaces import Unknowns
from dolfin_elastic.problem.term import Acting
from dolfin_elastic.problem.terms.contact.depths import UNSEEN, Depth, Faces, deepest_of
from dolfin_elastic.problem.terms.contact.pressures import Pressures

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

TURN = np.pi / 2
"""Angle by which it may turn in one step: two rotations do not tell whole turns between them."""

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


class ContactPair(Pressures):
    """One contact on one body. Collective to make."""

    _what, _rounds = "the obstacle", " (`rounding` of a box or cone, `offset` of a mesh)"

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

        Nor does it turn by more than `TURN`, or pass the surface: it goes to where it is deepest
        first. Collective.
        """
        if self.at_rest and self.follows is None:
            return goal
        goal = self._deepest(t, goal, acting)
        stride, angle = STRIDE * self.contact.obstacle.thickness, self.contact.angle_at
        for _ in range(HALVINGS):
            ends = acting(t), acting(goal)
            if abs(angle(*ends[1]) - angle(*ends[0])) <= TURN and _travel(self, *ends) <= stride:
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
        least = np.array(gaps)
        self.comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
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
