"""`CoulombFriction`: the tangential traction between a surface of the body and a rigid obstacle.

With w = u - (displacement of the obstacle) the traction on the body is, as in plasticity without
hardening,

    trial = P (tau - eps_t (w - s)),    t = trial min(1, mu p/|trial|),    P = 1 - n n,

with Coulomb's coefficient mu, the contact pressure p, the obstacle's normal n at the present place,
the tangential penalty eps_t, a multiplier tau and the place s at which the point sticks.  A step
that is accepted moves s to where it makes the trial equal to t: so t is the trial of the next step
if nothing moves, turned with the normal; points that stick keep s, and do not creep.  In statics
tau <- t together with the multiplier of the pressure (Uzawa) until points that stick are within
the gap's tolerance of s; in motion tau = 0.

Slip over a step ds = s - s(before) does the work -t . ds per area, which is lost.  While points
slide the tangent is not symmetric: the traction depends on the pressure, but not the other way
round.

Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97; P. Wriggers, Computational
Contact Mechanics, 2nd ed., Springer 2006, sections 5.2.2 and 10.5.2.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.term import Kind, Term
from dolfin_elastic.problem.terms.contact import ContactPair, uniaxial_modulus
from dolfin_elastic.problem.terms.nodal_contact import touch

log = logging.getLogger("dolfin_elastic")

ALL = 1 - 1e-9
"""Share of mu p from which on a traction is that of slip: both sides of it are but round-off."""

OPEN, STICK, SLIP = 0, 1, 2
"""Status of a point of the surface."""


@dataclass(frozen=True)
class _Law:
    """In UFL.

    Attributes:
        traction: On the body [Pa].
        lost: Work of the step's slip per reference area [J/m^2].
        still: The condition of points that are below Coulomb's limit.
    """

    traction: Expr
    lost: Expr
    still: Expr


class CoulombFriction(Term):
    """Friction of one contact. Collective to make.

    Args:
        pair: The contact, whose pressure and nodes it has; its coefficient is above 0.
        index: From 0, in the case.

    Attributes:
        nodes: Owned nodes of the surface in the displacement's space.
    """

    linear = symmetric = False
    restrains = follows_path = dissipates = True

    def __init__(self, pair: ContactPair, context: FormContext, index: int) -> None:
        self._pair, self._context, self._comm = pair, context, pair.comm
        self.label, self.shift, self.at_rest = pair.label, pair.shift, pair.at_rest
        self.nodes, self._mu = pair.nodes_of_displacement, context.constant(pair.contact.friction)
        self._share = min(
            shear_modulus(region.typical) / uniaxial_modulus(region) for region in context.regions
        )
        V = context.unknowns.V
        self._tau, self._stuck = fem.Function(V), fem.Function(V)
        self._lost = fem.Function(pair.lam.function_space)
        self.memory = {
            f"friction_{index}": self._tau,
            f"stick_{index}": self._stuck,
            f"friction_work_{index}": self._lost,
        }
        self._augments, self._moving = True, False
        # Known once a run begins: [Pa/m] at the nodes, and where they were accepted last [m].
        self._eps: FloatArray = np.empty(0)
        self._accepted: FloatArray = np.empty(0)

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
        self._eps = self._share * self._nodal_penalty()
        moved = self._moved()
        elsewhere = not (moving and self._moving) or not np.array_equal(moved, self._accepted)
        if largest(self._comm, float(elsewhere)):
            self._tau.x.array[:] = self._lost.x.array[:] = 0.0
            self._put(self._stuck, moved)
        self._moving = moving

    def _nodal_penalty(self) -> FloatArray:
        """Of the contact at its nodes [Pa/m]: mean over the area around each. Collective.

        So nodal forces are nodal tractions times nodal areas. A node without an area of its own, at
        the vertex of a quadratic triangle, has the penalty of Uzawa's update.
        """
        space, at = self._context.unknowns.W, touch(self._pair)
        v, one = sum(self._context.v), self._context.constant(1.0)
        works = [one * v * at.area, self._pair.penalty * v * at.area]
        forms = compile_forms(self._comm, works, options(self._comm))
        dofs, dim = self._context.unknowns.displacement_dofs, self._context.body.dim
        A, eps = (assembled(form, space)[dofs].reshape(-1, dim)[self.nodes, 0] for form in forms)
        least = 1e-9 * largest(self._comm, float(np.max(A, initial=0.0)))
        return np.divide(eps, A, out=at.nodal_penalty.copy(), where=least < A)

    # --- forms ---

    @cached_property
    def _law(self) -> _Law:
        at = touch(self._pair)
        spring = self._share * self._pair.penalty
        moved = self._context.u - self._pair.shift - self._stuck
        trial = self._tau - spring * moved
        trial -= ufl.dot(trial, at.normal) * at.normal
        limit, square = self._mu * at.pressure, ufl.inner(trial, trial)
        sticks = ufl.le(square, limit**2)
        # Of points that stick the length is not asked for, and may be 0.
        length = ufl.sqrt(ufl.conditional(sticks, 1.0, square))
        share = at.closed * ufl.conditional(sticks, 1.0, limit / length)
        lost = ufl.conditional(sticks, 0.0, limit * (length - limit) / spring)
        still = ufl.lt(square, (ALL * limit) ** 2)
        return _Law(share * trial, lost, still)

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`."""
        if kind != "work":
            return None
        return ufl.inner(self._law.traction, self._context.v) * touch(self._pair).area

    # --- numbers at the nodes ---

    def _moved(self) -> FloatArray:
        """Displacement relative to the obstacle at the owned nodes, (n, dim) [m]."""
        u = self._context.unknowns.u.x.array.reshape(-1, self._context.body.dim)
        return np.asarray(u[self.nodes] - self._pair.shift.value)

    def _of(self, field: fem.Function) -> FloatArray:
        """A vector field at the owned nodes of the surface, (n, dim)."""
        rows = field.x.array.reshape(-1, self._context.body.dim)
        return np.asarray(rows[self.nodes])

    def _put(self, field: fem.Function, values: FloatArray) -> None:
        """Sets a vector field there. Collective."""
        rows = field.x.array.reshape(-1, self._context.body.dim)
        rows[self.nodes] = values
        field.x.scatter_forward()

    def _tractions(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Traction and trial at the owned nodes, (n, dim) [Pa], and mu p, (n,) [Pa]."""
        pair, eps = self._pair, self._eps / self._share
        gaps, n = pair.gaps()
        limit = float(self._mu.value) * np.maximum(0.0, pair.lam.x.array[pair.nodes] - eps * gaps)
        trial = self._of(self._tau) - self._eps[:, None] * (self._moved() - self._of(self._stuck))
        trial -= np.sum(trial * n, axis=1)[:, None] * n
        length = np.linalg.norm(trial, axis=1)
        share = np.divide(limit, length, out=np.ones_like(limit), where=length > limit)
        share[limit == 0.0] = 0.0
        return share[:, None] * trial, trial, limit

    def tractions(self) -> FloatArray:
        """Tangential traction per reference area at the owned nodes, (n, dim) [Pa]."""
        return self._tractions()[0]

    def status(self) -> IndexArray:
        """`OPEN`, `STICK` or `SLIP` of the owned nodes. Not collective."""
        _, trial, limit = self._tractions()
        slips = np.linalg.norm(trial, axis=1) >= ALL * limit
        return np.where(limit > 0.0, np.where(slips, SLIP, STICK), OPEN).astype(np.int32)

    def held(self, *, near: bool = False) -> Iterator[tuple[IndexArray, FloatArray]]:
        """See `Term`: points in contact are held along the obstacle as if they stuck."""
        gaps, normals = self._pair.gaps()
        within = gaps <= self._pair.reach
        nodes, n = self.nodes[within], normals[within]
        for axis in np.eye(self._context.body.dim):
            tangents = axis - n * (n @ axis)[:, None]
            lengths = np.linalg.norm(tangents, axis=1)
            some = lengths > 0.1  # those of the other axes span the plane without it
            yield nodes[some], tangents[some] / lengths[some, None]

    # --- a run ---

    def unsettled(self) -> bool:
        """See `Term`: a node that sticks is off the place where it does, beyond the tolerance."""
        if not self._augments:
            return False
        n = self._pair.gaps()[1]
        off = self._moved() - self._of(self._stuck)
        off -= np.sum(off * n, axis=1)[:, None] * n
        slip = np.linalg.norm(off[self.status() == STICK], axis=1)
        return largest(self._comm, float(np.max(slip, initial=0.0))) > self._pair.tolerance

    def augment(self) -> None:
        """Uzawa's update tau <- t. Collective.

        The body goes back by what the springs gave way, from where Newton's method starts again:
        else all points whose traction is beyond half of its limit would seem to slide.
        """
        unknowns = self._context.unknowns
        t, _, limit = self._tractions()
        back = (t - self._of(self._tau)) / self._eps[:, None] * (limit > 0.0)[:, None]
        self._put(unknowns.u, self._of(unknowns.u) + back)
        unknowns.u_to_w()
        self._put(self._tau, t)

    def advance(self) -> None:
        """See `Term`: points that slip stick where they are now, under the present traction."""
        lost = self._lost.x.array
        own = assembled(self._lost_at_nodes, self._lost.function_space)
        lost[: len(own)] += own
        t, trial, limit = self._tractions()
        moves = np.linalg.norm(trial, axis=1) > limit
        moves |= limit == 0.0
        spring, stuck = self._eps[:, None], self._of(self._stuck)
        stuck[moves] = (self._moved() + (t - self._of(self._tau)) / spring)[moves]
        self._put(self._stuck, stuck)

    def commit(self) -> None:
        """See `Term`."""
        self.advance()
        super().commit()
        self._accepted = self._moved()

    # --- results ---

    @cached_property
    def _forms(self) -> list[fem.Form]:
        """Area under pressure, and that sticks of it [m^2], and the work lost by the step [J]."""
        at, law = touch(self._pair), self._law
        pressed = ufl.conditional(ufl.gt(at.pressure, 0.0), 1.0, 0.0)
        sums = pressed, ufl.conditional(law.still, pressed, 0.0), law.lost
        return compile_forms(self._comm, [one * at.area for one in sums], options(self._comm))

    @cached_property
    def _lost_at_nodes(self) -> fem.Form:
        """The work lost by the step, dealt out to the nodes [J]."""
        q = ufl.TestFunction(self._lost.function_space)
        form = self._law.lost * q * touch(self._pair).area
        return compile_forms(self._comm, [form], options(self._comm))[0]

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: share of the area under pressure that sticks, and the work lost [J]."""
        own = self._lost.x.index_map.size_local
        local = [float(fem.assemble_scalar(form)) for form in self._forms]
        local.append(float(self._lost.x.array[:own].sum()))
        pressed, stuck, lately, before = total(self._comm, np.array(local))
        result[f"stick_share_{self.label}"] = float(stuck / pressed) if pressed > 0.0 else 0.0
        result[f"friction_dissipation_{self.label}"] = float(before + lately)


def make_frictions(pairs: Sequence[ContactPair], context: FormContext) -> Iterator[CoulombFriction]:
    """Those of the contacts with friction. Collective."""
    for index, pair in enumerate(pairs):
        if pair.contact.friction > 0.0:
            yield CoulombFriction(pair, context, index)
