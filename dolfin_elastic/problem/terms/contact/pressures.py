"""`Pressures`: gaps and pressures of a surface that touches something, at its nodes.

The pressure per reference area is p = max(0, lam - eps g), see `pair`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from dolfin_elastic.core.ghosts import with_ghosts
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import cell_size
from dolfin_elastic.mesh.geometry.simplices import dofs_on_facets, prepare_facets
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.constraints.rows import Constraints
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.pose import Pose
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


class LinearGaps(Protocol):
    """Gaps at the owned vertices, and how they change.

    Attributes:
        areas: Reference areas over which the pressures act, (n,) [m^2].
    """

    areas: FloatArray

    def rates(self, motion: FloatArray) -> FloatArray:
        """How the gaps that are kept closed open along a motion, (n,) [m]. Collective.

        0 at others.  Times `areas` they are minus the derivative by the multipliers of the work of
        contact along the motion.

        Args:
            motion: Of all local nodes, (nodes * dim,) [m].
        """

    def spread(self, pressures: FloatArray) -> FloatArray:
        """Derivative of the gaps by the unknowns, times areas and pressures. Collective.

        Args:
            pressures: At the owned vertices, (n,) [Pa].

        Returns:
            Owned entries of all unknowns [N].
        """

    def left_out(self, motion: FloatArray, multipliers: FloatArray) -> FloatArray | None:
        """What of derivatives by the unknowns the tangent and `spread` leave out. Collective.

        Args:
            motion: Of all local nodes; the work of contact along it is differentiated.
            multipliers: At the owned vertices, by which the gaps count.

        Returns:
            Owned entries of all unknowns; None: nothing.
        """
        return None


class Pressures(InSteps):
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
        kept: Which owned vertices are in contact, whatever moves, see `keep`; None: as gaps tell.
        augments: Multipliers are those of statics; in motion there are penalties alone.
        nodes: Owned vertices of the surface in the space of `lam`.
        nodes_of_displacement: The same vertices in the displacement's space.
        follows: Supports that must not move the body through the obstacle in one step.
    """

    linear, restrains, opens, account = False, True, True, "contact"
    carrier: BoolArray | None = None
    kept: BoolArray | None = None
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
        found = self.step.pressures(first, last, self.least(eps))
        pulls = self.pulls_to > 0.0 if self.kept is None else self.kept
        return np.where(pulls, found, np.maximum(0.0, found))

    def least(self, eps: FloatArray) -> FloatArray:
        """Trial pressures from which on owned vertices are in contact [Pa]. Not collective."""
        if self.kept is None:
            return np.asarray(-eps * (self.reach + self.pulls_to))
        return np.where(self.kept, -np.inf, np.inf)

    def keep(self, pressing: BoolArray | None) -> None:
        """These owned vertices stay in contact and no other gets there; None: as gaps tell.

        So forces beside an equilibrium are smooth, also where a vertex has nearly opened or closed.
        Penalties may be others meanwhile; the multipliers of other vertices are lost. Collective.
        """
        self.kept = pressing

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

    @property
    def linearised(self) -> LinearGaps:
        """The gaps beside the present state, with what is kept. Collective."""
        raise NotImplementedError


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
