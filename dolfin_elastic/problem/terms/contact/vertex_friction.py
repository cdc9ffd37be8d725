"""`VertexFriction`: friction of quadratic faces, its tractions at their vertices.

Tractions are weighted as the pressures are, see `vertex_functions`: with the mean motion w_I past
the obstacle at a vertex, the virtual work is the sum of t_I . (integral of psi_I v).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.problem.terms.contact.friction import ALL, OPEN, SLIP, STICK, CoulombFriction
from dolfin_elastic.problem.terms.contact.vertex import VertexContact
from dolfin_elastic.problem.terms.contact.vertex_functions import blocks_of, diagonal

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class VertexFriction(CoulombFriction):
    """Friction of one contact of quadratic faces. Collective to make."""

    nodal = True

    def __init__(self, pair: VertexContact, context: FormContext, index: int) -> None:
        super().__init__(pair, context, index)
        self._vertices, self._functions, self._dim = pair, pair.functions, context.body.dim
        self._eps, self.areas = self._share * self._penalty(), pair.functions.areas

    def _penalty(self) -> FloatArray:
        """See `CoulombFriction`."""
        return self._vertices.eps

    def _moved(self) -> FloatArray:
        """See `CoulombFriction`: means."""
        return self._functions.means(self._functions.displacements()) - self._pair.shift.value

    def _with(self, motion: FloatArray) -> tuple[IndexArray, FloatArray]:
        """See `CoulombFriction`: faces move linearly."""
        return self._functions.at_nodes(motion)

    def nodal_tractions(self) -> tuple[IndexArray, FloatArray]:
        """See `CoulombFriction`: linear between the vertices."""
        return self._functions.at_nodes(self.tractions())

    def nodal_status(self) -> tuple[IndexArray, IndexArray]:
        """See `CoulombFriction`: between vertices a point slides where one of them does."""
        status = self.status()
        kinds = np.column_stack([status != OPEN, status == SLIP]).astype(float)
        nodes, found = self._functions.at_nodes(kinds)
        closed, slides = (found > 0.0).T
        return nodes, np.where(closed, np.where(slides, SLIP, STICK), OPEN).astype(np.int32)

    # --- forces ---

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`."""
        forces += self._functions.spread(self._functions.at_points(self.tractions()))

    def blocks(self) -> Blocks:
        """See `Term`: sum of H_I^T (-dt_I/du), H_I the integral of psi_I N.

        With m = trial/|trial|, where a point sticks it is dt = d(trial), and where it slides
        dt = mu m dp + mu p/|trial| (1 - m m) d(trial).  By the motion d(trial) = -eps_t P dw; by
        the turn of the normal, P = 1 - n n, it is -(n . y) dn - n (y . dn) with the trial before
        its projection, y = tau - eps_t (w - s).
        """
        from scipy.sparse import csr_array, eye_array, kron

        pair, areas = self._vertices, self.areas
        _, trial, limit = self._tractions()
        _, falls = pair.state()
        active = falls > 0
        pair.near |= active
        nodes, h = self._functions.rows(pair.near)
        _, G = self._functions.rows(pair.near, pair.normals())

        n, d = pair.nodal_normals(), self._dim
        length = np.linalg.norm(trial, axis=1)
        slides = active & (length > limit / ALL)
        size = np.where(slides, length, 1.0)
        m = trial / size[:, None]
        one, P = np.eye(d), np.eye(d) - n[:, :, None] * n[:, None, :]
        by_trial = np.where(slides, limit / size, active)[:, None, None] * one
        by_trial -= np.where(slides, limit / size, 0.0)[:, None, None] * m[:, :, None] * m[:, None]

        H = csr_array(kron(h, eye_array(d)))
        rows = diagonal(by_trial @ P * (self._eps / areas)[:, None, None]) @ H
        softer = np.where(slides, float(self._mu.value) * falls / areas, 0.0)
        rows += diagonal((softer[:, None] * m)[:, :, None]) @ G
        if (curvatures := pair.curvatures()) is not None:
            y = self._of(self._tau) - self._eps[:, None] * (self._moved() - self._of(self._stuck))
            turn = np.sum(n * y, axis=1)[:, None, None] * one + n[:, :, None] * y[:, None, :]
            rows += diagonal(by_trial @ turn @ curvatures) @ self._at_own(nodes)
        return blocks_of(nodes, csr_array(H.T @ rows), h, d)

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
