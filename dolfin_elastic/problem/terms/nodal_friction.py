"""`NodalFriction`: friction of linear faces, in UFL."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Kind
from dolfin_elastic.problem.terms.friction import ALL, CoulombFriction
from dolfin_elastic.problem.terms.nodal_contact import NodalContact, touch


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
    def _law(self) -> _Law:
        at = self._touch
        spring = self._share * self._pair.penalty
        moved = self._context.u - self._pair.shift - self._stuck
        trial = self._tau - spring * moved
        trial -= ufl.dot(trial, at.normal) * at.normal
        limit, square = self._mu * at.pressure, ufl.inner(trial, trial)
        sticks = ufl.le(square, (limit / ALL) ** 2)
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
        return ufl.inner(self._law.traction, self._context.v) * self._touch.area

    @cached_property
    def _forms(self) -> list[fem.Form]:
        """Area under pressure, and that sticks of it [m^2]."""
        at, law = self._touch, self._law
        pressed = ufl.conditional(ufl.gt(at.pressure, 0.0), 1.0, 0.0)
        sums = pressed, ufl.conditional(law.still, pressed, 0.0)
        return compile_forms(self._comm, [one * at.area for one in sums], options(self._comm))

    @cached_property
    def _lost_at_nodes(self) -> fem.Form:
        """The work lost by the step, dealt out to the nodes [J]."""
        q = ufl.TestFunction(self._lost.function_space)
        form = self._law.lost * q * self._touch.area
        return compile_forms(self._comm, [form], options(self._comm))[0]

    def _step(self) -> tuple[float, float, FloatArray]:
        """See `CoulombFriction`."""
        pressed, stuck = (float(fem.assemble_scalar(form)) for form in self._forms)
        lost = assembled(self._lost_at_nodes, self._lost.function_space)
        return pressed, stuck, lost[self._pair.nodes]
