"""`CoulombFriction`: the tangential traction between a surface of the body and a rigid obstacle.

With the motion w past the obstacle, w = u - (displacement of the obstacle), the traction on the
body is, as in plasticity without hardening,

    trial = P (tau - eps_t (w - s)),    t = trial min(1, mu p/|trial|),    P = 1 - n n,

with Coulomb's coefficient mu, the contact pressure p, the obstacle's normal n at the present place,
the tangential penalty eps_t, a multiplier tau and the place s at which the point sticks.  A step
that is accepted moves s to where it makes the trial equal to t: so t is the trial of the next step
if nothing moves, turned with the normal; points that stick keep s, and do not creep.  In statics
tau <- t together with the multiplier of the pressure (Uzawa) until points that stick are within
the gap's tolerance of s, and where points have slipped: these stick where they are.

In motion tau = 0, and the springs e = w - s store eps_t e . e/2.  In an implicit step with the
share alpha of the old displacement in that of its stage, t of the stage gives e_s = -t/eps_t and

    e1 = e0 + (e_s - e0)/(1 - alpha),

of which what is beyond Coulomb's limit at the end of the step is lost, too.  With alpha <= 1/2
-t . (w1 - w0) is at least the change of what e stores: friction makes no energy in any step, and
with alpha = 1/2 points that stick lose none.

A vertex that pulls until equilibrium is found, see `vertex_contact`, has a p below 0 in this law,
and a traction that is turned round, so that Newton's method sees no kink.  No equilibrium has one.

Of an obstacle that turns w, s and all vectors are as it sees them, see `pose`.

Slip over a step ds = s - s(before) does the work -t . ds per area, which is lost.  While points
slide the tangent is not symmetric: the traction depends on the pressure, but not the other way
round.

Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97; P. Wriggers, Computational
Contact Mechanics, 2nd ed., Springer 2006, sections 5.2.2 and 10.5.2; M. Ortiz & E. P. Popov, Int.
J. Numer. Methods Eng. 21 (1985) 1561 (midpoint return); F. Armero & E. Petocz, Comput. Methods
Appl. Mech. Eng. 179 (1999) 151 (friction in steps).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.term import StepWeights, Term
from dolfin_elastic.problem.terms.contact.multipliers import across
from dolfin_elastic.problem.terms.contact.pair import ContactPair, allowed_gap
from dolfin_elastic.problem.terms.contact.surfaces import FACTOR, uniaxial_modulus

log = logging.getLogger("dolfin_elastic")

ALL = 1 - 1e-9
"""Share of mu p from which on a traction is told as that of slip: the rest is but round-off.

Up to mu p over it points stick in the law: those that slid in the last step do so at the start of
the next, as if the load turned round; else the tangent there would have no stiffness against it.
"""

STILL = 1e-9
"""Slip over that since a point stuck up to which it has not turned: it may rest, to round-off."""

ROUGH = 1e9
"""Coefficient at which nothing slides."""

HALF_SPACE = 2.0
"""Stiffness per length of a surface along itself over the shear modulus, at least: 2/(1 - nu)."""

OPEN, STICK, SLIP = 0, 1, 2
"""Status of a point of the surface."""


class _Tractions(Term):
    """Tractions of one contact at its nodes. Collective to make.

    Args:
        pair: The contact, whose pressure and nodes it has; its coefficient is above 0.
        index: From 0, in the case.

    Attributes:
        nodes: Owned nodes of the surface in the displacement's space at which points stick.
        areas: Reference area around each of these, once a run has begun [m^2].
        springs: Tangential penalty at these, once a run has begun [Pa/m].
    """

    linear = symmetric = False
    restrains = follows_path = dissipates = True
    account = "contact"
    states = "open", "sticking", "sliding"
    pose: Pose

    def __init__(self, pair: ContactPair, context: FormContext, index: int) -> None:
        self._pair, self._context, self._comm = pair, context, pair.comm
        self.label, self.pose, self.at_rest = pair.label, pair.pose, pair.at_rest
        self.nodes, self._mu = pair.nodes_of_displacement, context.constant(pair.contact.friction)
        self._share = min(
            shear_modulus(region.typical) / uniaxial_modulus(region) for region in context.regions
        )
        V = context.unknowns.V
        self._tau, self._stuck, self._slid = (fem.Function(V) for _ in range(3))
        self._lost = fem.Function(pair.lam.function_space)
        self.memory = {
            f"friction_{index}": self._tau,
            f"stick_{index}": self._stuck,
            f"friction_work_{index}": self._lost,
            f"slip_{index}": self._slid,
        }
        self._augments, self._moving = True, False
        self.springs: FloatArray = np.empty(0)
        self.areas: FloatArray = np.empty(0)
        self._accepted: FloatArray = np.empty(0)  # where the nodes were accepted last [m]
        self._begun: FloatArray = np.empty(0)  # where the nodes were at the start of a step [m]
        self._old = 0.0
        self._stage: FloatArray | None = None  # tractions of the stage that was found [Pa]

    def _penalty(self) -> FloatArray:
        """Of the pressure at the nodes [Pa/m]. Collective."""
        raise NotImplementedError

    # --- numbers at the nodes ---

    def _moved(self) -> FloatArray:
        """Displacement relative to the obstacle at the owned nodes, (n, dim) [m]. Collective."""
        pair = self._pair
        if pair.pose.last is None:  # places would add their round-off
            u = self._context.unknowns.u.x.array.reshape(-1, self._context.body.dim)
            return np.asarray(u[self.nodes] - pair.pose.shift.value)
        return pair.seen() - pair.places()

    def _of(self, field: fem.Function) -> FloatArray:
        """A vector field at the owned nodes of the surface, (n, dim)."""
        rows = field.x.array.reshape(-1, self._context.body.dim)
        return np.asarray(rows[self.nodes])

    @property
    def coefficient(self) -> float:
        """Coulomb's, or what makes points stick, see `stick`."""
        return float(self._mu.value)

    @property
    def multiplier(self) -> FloatArray:
        """tau at the owned nodes, (n, dim) [Pa]."""
        return self._of(self._tau)

    @multiplier.setter
    def multiplier(self, values: FloatArray) -> None:
        self._put(self._tau, values)

    def _put(self, field: fem.Function, values: FloatArray) -> None:
        """Sets a vector field there. Collective."""
        rows = field.x.array.reshape(-1, self._context.body.dim)
        rows[self.nodes] = values
        field.x.scatter_forward()

    def _tractions(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Traction and trial at the owned nodes, (n, dim) [Pa], and mu p, (n,) [Pa]. Collective."""
        pair, n = self._pair, self._pair.nodal_normals()
        limit = self.coefficient * pair.pressures(np.asarray(self.springs / self._share))
        trial, _, slides = self.trial(self._of(self._tau), n, limit)
        length = np.linalg.norm(trial, axis=1)
        share = np.divide(limit, length, out=np.ones_like(limit), where=slides)
        share[limit == 0.0] = 0.0
        return share[:, None] * trial, trial, limit

    def trial(
        self, t: FloatArray, n: FloatArray, limit: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Trial tractions, the motions since points stuck, and which of them slide. Collective.

        Args:
            t: Multipliers, (n, dim) [Pa].
            n: Normals, (n, dim).
            limit: mu p, (n,) [Pa].
        """
        off = self._moved() - self._of(self._stuck)
        trial = across(t - self.springs[:, None] * off, n)
        slides: BoolArray = np.asarray(np.linalg.norm(trial, axis=1) > limit / ALL)
        return trial, across(off, n), slides

    def tractions(self) -> FloatArray:
        """Per reference area at the owned nodes, (n, dim) [Pa]. Collective."""
        return self._tractions()[0]

    def nodal_tractions(self) -> tuple[IndexArray, FloatArray]:
        """Owned nodes of the surface, and tractions per reference area there, (n, dim) [Pa].

        Collective.
        """
        return self.nodes, self.pose.to_space(self.tractions())

    def nodal_status(self) -> tuple[IndexArray, IndexArray]:
        """Owned nodes of the surface, and `OPEN`, `STICK` or `SLIP` of each. Collective."""
        return self.nodes, self.status()

    def status(self) -> IndexArray:
        """`OPEN`, `STICK` or `SLIP` of the owned nodes. Collective."""
        _, trial, limit = self._tractions()
        return status_of(trial, limit)

    def slip_limits(self) -> tuple[IndexArray, FloatArray, FloatArray]:
        """See `Term`: mu p over the areas."""
        pressures = self._tractions()[2] / self.coefficient
        limits = self._pair.contact.friction * self.areas * pressures
        return self.nodes, limits, self._pair.gaps()[1]

    def stick(self, always: bool) -> None:
        """See `Term`."""
        self._mu.value = ROUGH if always else self._pair.contact.friction

    def point_states(self) -> tuple[FloatArray, IndexArray]:
        """See `Term`."""
        return self._pair.places(), self.status()

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """See `Term`: points in contact are held along the obstacle as if they stuck."""
        for nodes, n in self._pair.held():
            for axis in np.eye(self._context.body.dim):
                tangents = axis - n * (n @ axis)[:, None]
                lengths = np.linalg.norm(tangents, axis=1)
                some = lengths > 0.1  # those of the other axes span the plane without it
                yield nodes[some], tangents[some] / lengths[some, None]


class CoulombFriction(_Tractions):
    """Friction of one contact, which remembers where points stick. Collective to make."""

    def begin(self, *, moving: bool) -> None:
        """See `Term`: all points stick where they are, unless a preload has just ended there."""
        self._augments = not moving
        if moving:
            self._tau.x.array[:] = 0.0
        else:
            log.info(
                "friction at '%s': the result depends on the order of the loads, which grow in "
                "steps",
                self.label,
            )
        self.springs = self._share * self._penalty()
        moved = self._moved()
        elsewhere = not (moving and self._moving) or not np.array_equal(moved, self._accepted)
        if largest(self._comm, float(elsewhere)):
            for field in (self._tau, self._lost, self._slid):
                field.x.array[:] = 0.0
            self._put(self._stuck, moved)
        self._moving = moving

    def unsettled(self) -> bool:
        """See `Term`: a node that sticks is off the place where it does, beyond the tolerance."""
        if not self._augments:
            return False
        n = self._pair.nodal_normals()
        off = across(self._moved() - self._of(self._stuck), n)
        slip = np.linalg.norm(off[self.status() == STICK], axis=1)
        return largest(self._comm, float(np.max(slip, initial=0.0))) > allowed_gap(self._pair)

    def augment(self) -> None:
        """Uzawa's update tau <- t. Collective.

        The body goes back by what the springs gave way, from where Newton's method starts again:
        else all points whose traction is beyond half of its limit would seem to slide.  It goes
        along the obstacle only: tau is of an earlier normal, and gaps have an update of their own.
        """
        unknowns, n = self._context.unknowns, self._pair.nodal_normals()
        t, _, limit = self._tractions()
        back = (t - self._of(self._tau)) / self.springs[:, None] * (limit > 0.0)[:, None]
        back = across(back, n)
        nodes, motion = self._with(self.pose.to_space(back))
        unknowns.u.x.array.reshape(-1, self._context.body.dim)[nodes] += motion
        unknowns.u.x.scatter_forward()
        unknowns.u_to_w()
        self._put(self._tau, t)

    def _with(self, motion: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Nodes that move with those at which points stick, and how. Collective."""
        return self.nodes, motion

    def begin_step(self) -> None:
        """See `Term`."""
        self._begun = self._moved()

    def enter_stage(self, step: StepWeights, pose: FloatArray | None) -> None:
        """See `Term`."""
        self._old, self._stage = step.alpha_f if self._pair.in_steps else 0.0, None

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        # A stage that is the end of the step needs no more than its state.
        self._stage = self.tractions() if found and self._old > 0.0 else None

    def energy(self) -> float:
        """See `Term`: of the springs, in motion."""
        stored = self._stored(self.tractions() / self.springs[:, None], self.areas)
        return total(self._comm, 0.0 if self._augments else float(stored.sum()))

    def _stored(self, springs: FloatArray, areas: FloatArray) -> FloatArray:
        """What they store at each node [J]."""
        return np.asarray(areas * self.springs * np.sum(springs**2, axis=1) / 2)

    def _in_step(self) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """The motion of a step past the obstacle [m]; areas before, in and after it. Collective."""
        return self._moved() - self._begun, (self.areas, self.areas, self.areas)

    def _advance_by_step(self, t: FloatArray) -> None:
        """Moves s by the traction of the step's stage, see the module."""
        way, (before, within, after) = self._in_step()
        first, moved = self._begun - self._of(self._stuck), self._begun + way
        old = first * shortened(before, within)
        e = old + (-t / self.springs[:, None] - old) / (1 - self._old)
        n, limit = self._pair.nodal_normals(), self._tractions()[2]
        e = across(e, n)
        length = self.springs * np.linalg.norm(e, axis=1)
        e *= np.divide(limit, length, out=np.ones_like(limit), where=length > limit)[:, None]
        e *= shortened(within, after)
        work = self._stored(first, before) - within * np.sum(t * way, axis=1)
        self._lost.x.array[self._pair.nodes] += work - self._stored(e, after)
        self._put(self._stuck, moved - e)

    def advance(self) -> None:
        """See `Term`: points that slip stick where they are now, under the present traction."""
        self._put(self._slid, self._slides())
        if self._stage is not None:
            stage, self._stage = self._stage, None
            self._advance_by_step(stage)
            self._accepted = np.empty(0)
            return
        self._lost.x.array[self._pair.nodes] += self._lost_now()
        t, trial, limit = self._tractions()
        moves = np.linalg.norm(trial, axis=1) > limit / ALL
        moves |= limit == 0.0
        tau, stuck = self._of(self._tau), self._of(self._stuck)
        if self._augments:  # s is the place, to which Uzawa's updates would draw what sticks next
            tau[moves] = t[moves]
            self._put(self._tau, tau)
        stuck[moves] = (self._moved() + (t - tau) / self.springs[:, None])[moves]
        self._put(self._stuck, stuck)
        self._accepted = np.empty(0)  # a run that begins where an earlier one did is none after it

    def commit(self) -> None:
        """See `Term`."""
        self.advance()
        super().commit()
        self._accepted = self._moved()

    # --- results ---

    def _lost_now(self) -> FloatArray:
        """Work that the step's slip has lost, of each owned node [J]. Collective."""
        _, trial, limit = self._tractions()
        beyond = np.maximum(np.linalg.norm(trial, axis=1) - limit, 0.0)
        return np.asarray(self.areas * limit * beyond / self.springs)

    def _slides(self) -> FloatArray:
        """How far the owned nodes have slid since they stuck or turned, (n, dim). Collective.

        Times the springs, against the motion [Pa].
        """
        t, trial, limit = self._tractions()
        slips, before = (status_of(trial, limit) == SLIP)[:, None], self._of(self._slid)
        now = (trial - t) * slips
        along, square = np.sum(now * before, axis=1), np.sum(before**2, axis=1)
        return now + before * slips * (along >= -STILL * square)[:, None]

    def stuck_area(self) -> float:
        """Reference area that sticks [m^2]. Collective.

        As the pressure does, what is left to Coulomb's limit ends within an element: where it meets
        minus the traction that would undo the slip since points stuck, over an element's length.
        """
        t, trial, limit = self._tractions()
        status = status_of(trial, limit)
        slides = -HALF_SPACE / FACTOR * np.linalg.norm(self._slides(), axis=1)
        opens = self.coefficient * np.minimum(self._pair.levels(), 0.0)
        left = limit - np.linalg.norm(t, axis=1)
        choices = [status == STICK, status == SLIP]
        return self._pair.area_above(np.select(choices, [left, slides], opens))

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: share of the area under pressure that sticks, and the work lost [J]."""
        area, before = self._pair.area(), self._lost.x.array[self._pair.nodes]
        lost = float(self._lost_now().sum() + before.sum())
        result[f"stick_share_{self.label}"] = self.stuck_area() / area if area > 0.0 else 0.0
        result[f"friction_dissipation_{self.label}"] = total(self._comm, lost)


def status_of(trial: FloatArray, limit: FloatArray) -> IndexArray:
    """`OPEN`, `STICK` or `SLIP` of each node, from its trial traction and mu p [Pa]."""
    slips = np.linalg.norm(trial, axis=1) >= ALL * limit
    return np.where(limit > 0.0, np.where(slips, SLIP, STICK), OPEN).astype(np.int32)


def shortened(before: FloatArray, after: FloatArray) -> FloatArray:
    """Length of springs over that on another area, (n, 1): what they store does not grow."""
    return np.asarray(np.sqrt(np.minimum(1.0, before / after)))[:, None]
