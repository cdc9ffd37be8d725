"""`BodyFriction`: friction between two deformable surfaces, its tractions at vertices.

What moves past each other is compared where points lie opposite each other now: the motion w of
`CoulombFriction` grows in each step by the mean of the difference of both sides' displacements in
that step.  So it is that of the step's pairs, and a rigid motion of both together adds nothing.
In an implicit motion the pairs are those of the stage.  Springs store no more on another area than
they did: they become shorter where it grows, and what they lose where it shrinks is dissipated.
The tangent leaves the turn of the normal and the change of pairs out.

Source: T. W. McDevitt & T. A. Laursen, Int. J. Numer. Meth. Engng 48 (2000) 1525; that of
`CoulombFriction`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.problem.terms.bodies.contact import BodyContact
from dolfin_elastic.problem.terms.contact.friction import CoulombFriction, shortened
from dolfin_elastic.problem.terms.contact.nodal import NodalContact
from dolfin_elastic.problem.terms.contact.nodal_friction import NodalFriction
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.vertex import VertexContact
from dolfin_elastic.problem.terms.contact.vertex_friction import VertexFriction


class BodyFriction(VertexFriction):
    """Friction of one contact between two surfaces of the mesh. Collective to make."""

    joins = True
    _first_areas: FloatArray | None = None  # at the start of a step [m^2]
    _way: FloatArray  # of the whole step, by the pairs of its stage [m]
    _within: FloatArray

    def __init__(self, pair: BodyContact, context: FormContext, index: int) -> None:
        self._bodies, self._pieces = pair, pair.pieces
        V = context.unknowns.V
        self._path, self._before = fem.Function(V), fem.Function(V)
        super().__init__(pair, context, index)
        more = {f"motion_{index}": self._path, f"before_{index}": self._before}
        self.memory = {**self.memory, **more}

    def _moved(self) -> FloatArray:
        """See `CoulombFriction`."""
        result = self._of(self._path) + self._pieces.means(self._step_so_far())
        if self._first_areas is not None:
            springs = self._of(self._path) - self._of(self._stuck)
            result -= (1 - shortened(self._first_areas, self._pieces.areas)) * springs
        return result

    def motions(self, motion: FloatArray) -> FloatArray:
        """See `VertexFriction`: as the tangent has them."""
        return self._pieces.means(self._pieces.relative(motion, turned=False))

    def _step_so_far(self) -> FloatArray:
        """What points have moved past each other in the step [m]. Collective."""
        u = self._context.unknowns.u.x.array
        return self._pieces.relative(u - self._before.x.array)

    def begin(self, *, moving: bool) -> None:
        """See `CoulombFriction`."""
        self._before.x.array[:] = self._context.unknowns.u.x.array
        self._first_areas = None  # of a step that an earlier run has not found
        super().begin(moving=moving)

    def begin_step(self) -> None:
        """See `Term`."""
        super().begin_step()
        self._first_areas = self._pieces.areas

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        super().leave_stage(found=found)
        if self._stage is not None:
            way = self._pieces.means(self._step_so_far())
            self._way = np.asarray(way / (1 - self._old))
            self._within = self._pieces.areas

    def _in_step(self) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
        """See `CoulombFriction`."""
        assert self._first_areas is not None
        return self._way, (self._first_areas, self._within, self._pieces.areas)

    def advance(self) -> None:
        """See `CoulombFriction`."""
        moved = self._moved() if self._stage is None else self._begun + self._way
        super().advance()
        self._first_areas = None
        self._put(self._path, moved)
        self._before.x.array[:] = self._context.unknowns.u.x.array

    def energy(self) -> float:
        """See `CoulombFriction`: on what lies opposite each other now."""
        self.areas = self._pieces.areas
        return super().energy()

    def blocks(self) -> Blocks:
        """See `VertexFriction`: areas are those opposite each other now."""
        self.areas = self._pieces.areas
        return super().blocks()

    def slip_limits(self) -> tuple[IndexArray, FloatArray, FloatArray]:
        """See `Term`: of both sides."""
        self.areas = self._pieces.areas
        nodes, limits, normals = super().slip_limits()
        pressures = self._pieces.at_points((limits / self.areas)[:, None])
        others, more, directions = self._pieces.opposite(pressures * self._vertices.normals())
        return (
            np.concatenate([nodes, others]),
            np.concatenate([limits, more]),
            np.concatenate([normals, directions]),
        )

    def partings(self, fields: Sequence[FloatArray]) -> FloatArray:
        """See `Term`: points in contact do not part along the surfaces, either."""
        return self._bodies.partings(fields, all_ways=True)

    def _lost_now(self) -> FloatArray:
        """See `CoulombFriction`."""
        self.areas = self._pieces.areas
        return super()._lost_now()


def make_frictions(pairs: Sequence[ContactPair], context: FormContext) -> Iterator[CoulombFriction]:
    """Those of the contacts with friction. Collective."""
    for index, pair in enumerate(pairs):
        if pair.contact.friction > 0.0:
            if isinstance(pair, BodyContact):
                yield BodyFriction(pair, context, index)
            elif isinstance(pair, VertexContact):
                yield VertexFriction(pair, context, index)
            elif isinstance(pair, NodalContact):
                yield NodalFriction(pair, context, index)
