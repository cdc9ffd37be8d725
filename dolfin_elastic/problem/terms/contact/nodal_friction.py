"""`NodalFriction`: friction of linear faces, in UFL."""

from __future__ import annotations

from functools import cached_property

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Kind
from dolfin_elastic.problem.terms.contact.friction import ALL, CoulombFriction
from dolfin_elastic.problem.terms.contact.nodal import NodalContact, touch


class NodalFriction(CoulombFriction):
    """Friction of one contact of linear faces. Collective to make."""

    def __init__(self, pair: NodalContact, context: FormContext, index: int) -> None:
        super().__init__(pair, context, index)
        self._touch = touch(pair)

    def _penalty(self) -> FloatArray:
        """Of the contact at its nodes [Pa/m]: mean over the area around each. Collective.

        So nodal forces are nodal tractions times nodal areas.
        """
        space, at = self._context.unknowns.W, self._touch
        v, one = sum(self._context.v), self._context.constant(1.0)
        works = [one * v * at.area, self._pair.penalty * v * at.area]
        forms = compile_forms(self._comm, works, options(self._comm))
        dofs, dim = self._context.unknowns.displacement_dofs, self._context.body.dim
        A, eps = (assembled(form, space)[dofs].reshape(-1, dim)[self.nodes, 0] for form in forms)
        self.areas = A
        return eps / A

    @cached_property
    def _traction(self) -> Expr:
        at = self._touch
        X = self._context.X
        moved = self._pair.step.place(X) - X - self._stuck
        trial = self._tau - self._share * self._pair.penalty * moved
        trial -= ufl.dot(trial, at.normal) * at.normal
        limit, square = self._mu * at.pressure, ufl.inner(trial, trial)
        sticks = ufl.le(square, (limit / ALL) ** 2)
        # Of points that stick the length is not asked for, and may be 0.
        length = ufl.sqrt(ufl.conditional(sticks, 1.0, square))
        traction = at.closed * ufl.conditional(sticks, 1.0, limit / length) * trial
        return self._pair.pose.acting_in_form(traction)

    def form(self, kind: Kind) -> ufl.Form | None:
        """See `Term`."""
        if kind != "work":
            return None
        return ufl.inner(self._traction, self._context.v) * self._touch.area
