"""Manufactured solutions: a displacement, and the loads that keep it in equilibrium.

The exact displacement is given; body forces f = -div P and tractions t = P N follow from the law by
UFL.  They enter as a load of our own: a `Load` whose `virtual_work` is written with its context,
which is how any load is added.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfin_elastic import Problem, Support
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.mesh import Body
from dolfin_elastic.model.kinematics import deformation_gradient, embedded
from dolfin_elastic.model.loads import Load, LoadContext
from dolfin_elastic.model.materials.law import Law

E, NU = 1e3, 0.3
QUADRATURE = {"quadrature_degree": 6}


EXACT = {
    2: ["0.1*sin(pi*x)*cos(pi*y/2)", "0.1*(cos(pi*x/2)*sin(pi*y) + x^2*y/2)"],
    3: ["0.1*sin(2*x)*cos(y)*exp(z/2)", "0.1*cos(2*y)*sin(z + x)", "0.1*sin(2*z)*cos(x - y)"],
}
"""The displacement by dimension, as a user writes it."""


def exact(dim: int, X: Any) -> Expr:
    """The same as a UFL vector."""
    place = dict(zip("xyz", X, strict=False))
    return ufl.as_vector([Formula.parse(text, allowed="xyz").ufl(**place) for text in EXACT[dim]])


class Manufactured(Load):
    """Body force and tractions that keep a given displacement in equilibrium.

    At load factor s they are those of s times the displacement, as supports grow too.
    """

    kind: str = "manufactured"
    value: list[Any] = []  # noqa: RUF012  a pydantic field
    law: Any
    on: list[str]

    @cached_property
    def values(self) -> tuple[float, ...]:
        return ()

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        mesh = ufl.domain.extract_unique_domain(context.v)
        dim = len(context.v)
        grown = context.vector((1.0,) * dim, None)[0] * exact(dim, ufl.SpatialCoordinate(mesh))
        F = embedded(deformation_gradient(grown))
        P = self.law.stress(F)
        P = ufl.as_matrix([[P[i, j] for j in range(dim)] for i in range(dim)])
        return -ufl.inner(ufl.div(P), context.v) * context.volumes(())(
            metadata=QUADRATURE
        ) + ufl.inner(P * ufl.FacetNormal(mesh), context.v) * context.areas(self.on)(
            metadata=QUADRATURE
        )


def held_and_loaded(body: Body, law: Law, other: Law, degree: int) -> Problem:
    """Tractions on the right, the displacement all round it; the forces are those of a law."""
    held = [name for name in body.surfaces if name != "right"]
    return Problem(
        body,
        law,
        degree=degree,
        supports=[Support(on=held, displacement=EXACT[body.dim])],
        loads=[Manufactured(law=other, on=["right"])],
    )
