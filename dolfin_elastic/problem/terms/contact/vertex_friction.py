"""`VertexFriction`: friction of quadratic faces, its tractions at their vertices.

Tractions are weighted as the pressures are, see `vertex_functions`: with the mean motion w_I past
the obstacle at a vertex, the virtual work is the sum of t_I . (integral of psi_I v).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks, Multipliers
from dolfin_elastic.problem.terms.contact.friction import ALL, OPEN, SLIP, STICK, CoulombFriction
from dolfin_elastic.problem.terms.contact.multipliers import SETTLED, TractionIterate, across
from dolfin_elastic.problem.terms.contact.pair import allowed_gap
from dolfin_elastic.problem.terms.contact.vertex import VertexContact
from dolfin_elastic.problem.terms.contact.vertex_functions import blocks_of, diagonal

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class VertexFriction(CoulombFriction):
    """Friction of one contact of quadratic faces. Collective to make.

    Attributes:
        multipliers: Its tractions.
    """

    nodal = True
    multipliers: VertexTractions

    def __init__(self, pair: VertexContact, context: FormContext, index: int) -> None:
        super().__init__(pair, context, index)
        self._vertices, self._functions, self._dim = pair, pair.functions, context.body.dim
        self.springs, self.areas = self._share * self._penalty(), pair.functions.areas
        self.multipliers = VertexTractions(self, pair)

    def _penalty(self) -> FloatArray:
        """See `CoulombFriction`."""
        return self._vertices.eps

    def _moved(self) -> FloatArray:
        """See `CoulombFriction`: means."""
        functions, pose = self._functions, self._pair.pose
        if pose.last is None:  # places would add their round-off
            return functions.means(functions.displacements()) - pose.shift.value
        return functions.means(self._vertices.places_of_points() - functions.X)

    def _with(self, motion: FloatArray) -> tuple[IndexArray, FloatArray]:
        """See `CoulombFriction`: faces move linearly."""
        return self._functions.at_nodes(motion)

    def nodal_tractions(self) -> tuple[IndexArray, FloatArray]:
        """See `CoulombFriction`: linear between the vertices."""
        return self._functions.at_nodes(self._pair.pose.to_space(self.tractions()))

    def nodal_status(self) -> tuple[IndexArray, IndexArray]:
        """See `CoulombFriction`: between vertices a point slides where one of them does."""
        status = self.status()
        kinds = np.column_stack([status != OPEN, status == SLIP]).astype(float)
        nodes, found = self._functions.at_nodes(kinds)
        closed, slides = (found > 0.0).T
        return nodes, np.where(closed, np.where(slides, SLIP, STICK), OPEN).astype(np.int32)

    def motions(self, motion: FloatArray) -> FloatArray:
        """Means of a motion of local nodes, as the obstacle sees it, (n, dim) [m]. Collective."""
        means = self._functions.means(self._functions.displacements(motion))
        return self._pair.pose.to_obstacle(means)

    # --- forces ---

    def tractions(self) -> FloatArray:
        """See `CoulombFriction`."""
        now = self.multipliers.iterate
        return super().tractions() if now is None else now.acting

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`; what the iteration solves with acts as its tangent has it."""
        functions, acting = self._functions, self._pair.pose.acting
        t, now = self.tractions(), self.multipliers.iterate
        if now is not None:
            more = functions.at_points(acting(t - now.values))
            forces += functions.spread(more, turned=False)
            t = now.values
        forces += functions.spread(functions.at_points(acting(t)))

    def blocks(self) -> Blocks:
        """See `Term`: sum of H_I^T (-dt_I/du), H_I the integral of psi_I N.

        With m = trial/|trial|, where a point sticks it is dt = d(trial), and where it slides
        dt = mu m dp + mu p/|trial| (1 - m m) d(trial).  By the motion d(trial) = -eps_t P dw; by
        the turn of the normal, P = 1 - n n, it is -(n . y) dn - n (y . dn) with the trial before
        its projection, y = tau - eps_t (w - s).  Vectors are those in space.
        """
        from scipy.sparse import csr_array, eye_array, kron

        pair, areas, now = self._vertices, self.areas, self.multipliers.iterate
        to_space = self._pair.pose.to_space
        _, falls = pair.state()
        active, eps = falls > 0, self.springs
        if now is None:
            _, trial, limit = self._tractions()
            tau = self._of(self._tau)
            slides = np.linalg.norm(trial, axis=1) > limit / ALL
        else:
            limit, tau, slides = now.limits, now.values, now.slides
            trial, eps = tau - self.springs[:, None] * now.off, now.stiffness
        pair.near |= active
        nodes, h = self._functions.rows(pair.near)
        _, G = self._functions.rows(pair.near, pair.normals())

        trial, n, d = to_space(trial), to_space(pair.nodal_normals()), self._dim
        slides &= active
        size = np.where(slides, np.linalg.norm(trial, axis=1), 1.0)
        m = trial / size[:, None]
        one, P = np.eye(d), np.eye(d) - n[:, :, None] * n[:, None, :]
        by_trial = np.where(slides, limit / size, active)[:, None, None] * one
        by_trial -= np.where(slides, limit / size, 0.0)[:, None, None] * m[:, :, None] * m[:, None]

        rows = diagonal(by_trial @ P * (eps / areas)[:, None, None])
        rows @= csr_array(kron(h, eye_array(d)))
        softer = np.where(slides, self.coefficient * falls / areas, 0.0)
        rows += diagonal((softer[:, None] * m)[:, :, None]) @ G
        if (curvatures := pair.curvatures()) is not None:
            y = tau
            if now is None:
                y = y - eps[:, None] * (self._moved() - self._of(self._stuck))
            y = to_space(y)
            turn = np.sum(n * y, axis=1)[:, None, None] * one + n[:, :, None] * y[:, None, :]
            rows += diagonal(by_trial @ turn @ curvatures) @ self._at_own(nodes)
        spread = csr_array(kron(h.T, pair.pose.pushes))
        return blocks_of(nodes, csr_array(spread @ rows), h, d)

    def _at_own(self, nodes: IntArray) -> csr_array:
        """Picks the displacement of each vertex out of those of nodes, by components.

        Args:
            nodes: Global, sorted; of vertices that have never been in contact not all.
        """
        from scipy.sparse import csr_array, eye_array, kron

        d, index_map = self._dim, self._context.unknowns.V.dofmap.index_map
        own = index_map.local_to_global(self.nodes)
        places = np.minimum(np.searchsorted(nodes, own), max(len(nodes) - 1, 0))
        there = np.flatnonzero(nodes[places] == own) if len(nodes) else np.zeros(0, dtype=int)
        picked = csr_array(
            (np.ones(len(there)), (there, places[there])), shape=(len(own), len(nodes))
        )
        return csr_array(kron(picked, eye_array(d)))


class VertexTractions(Multipliers):
    """The tractions of one contact as unknowns, where its pressures are.

    Attributes:
        iterate: They in an iteration of Newton's method; None: they follow the displacement.
    """

    def __init__(self, friction: VertexFriction, pair: VertexContact) -> None:
        self._friction, self._pair = friction, pair
        self.iterate: TractionIterate | None = None

    def linearise(self) -> bool:
        """See `Multipliers`."""
        friction, pressures = self._friction, self._pair.multipliers.iterate
        if pressures is None:
            return False
        before, n, mu = self.iterate, self._pair.nodal_normals(), friction.coefficient
        t = across(friction.multiplier if before is None else before.values, n)
        y, off, slides = friction.trial(t, n, mu * pressures.values)
        if before is not None:
            slides &= ~(before.slides & (np.sum(y * before.along, axis=1) < 0.0))
        size = np.where(slides, np.linalg.norm(y, axis=1), 1.0)
        self.iterate = TractionIterate(
            values=t,
            off=off,
            normals=n,
            slides=slides,
            along=y / size[:, None],
            turns=mu * pressures.values / size,
            mu=mu,
            springs=friction.springs,
            pressures=pressures,
        )
        return True

    def foresee(self, motion: FloatArray) -> None:
        """See `Multipliers`."""
        if self.iterate is not None:
            self.iterate.foresee(self._friction.motions(motion))

    def take_step(self, share: float) -> None:
        """See `Multipliers`."""
        if self.iterate is not None:
            self.iterate.step(share)

    def holds(self) -> bool:
        """See `Multipliers`: points that stick have not moved, others slide along their traction.

        The traction of these is mu p.
        """
        if (now := self.iterate) is None:
            return True
        comm, closed, limit = self._pair.comm, now.pressures.active, now.limits
        y, off, slides = self._friction.trial(now.values, self._pair.nodal_normals(), limit)
        law = y * (limit / np.where(slides, np.linalg.norm(y, axis=1), 1.0))[:, None]
        wrong = np.linalg.norm(law - now.values, axis=1)[closed & slides]
        slip = np.linalg.norm(off, axis=1)[closed & ~slides]
        most, error, slip = (
            largest(comm, float(np.max(one, initial=0.0))) for one in (limit, wrong, slip)
        )
        return error <= SETTLED * most and slip <= allowed_gap(self._pair)

    def end(self, *, found: bool) -> None:
        """See `Multipliers`: the law of the springs has the same tractions here."""
        (now, self.iterate), friction = (self.iterate, None), self._friction
        if now is not None and found:
            n = self._pair.nodal_normals()
            _, off, slides = friction.trial(now.values, n, now.limits)
            sticks = now.values + friction.springs[:, None] * off
            friction.multiplier = np.where(slides[:, None], now.values, sticks)
