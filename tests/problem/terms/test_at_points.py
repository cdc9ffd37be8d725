"""Formulas at the points of integrals: the integrals of UFL, and no form for each formula."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from ffcx.naming import compute_signature
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    BodyForce,
    Gravity,
    Pressure,
    Problem,
    Spring,
    StVenantKirchhoff,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.mesh import EdgeSelector, PointSelector, name_parts
from dolfin_elastic.model.amplitude import CONSTANT
from dolfin_elastic.model.values import COORDINATES, Parts
from dolfin_elastic.solvers.assembly.assembler import compiled
from dolfin_elastic.solvers.assembly.nodal_forces import Forces

LAW = StVenantKirchhoff(E=1e6, nu=0.3, density=1000.0)
SIDES = ("right", "top")
"""In the corners between them a cell has a facet on each."""


def formula(text: str) -> Formula:
    return Formula.parse(text, allowed=COORDINATES)


def body(dim: int) -> Body:
    make = box_body if dim == 3 else rectangle_body
    found = make(size=(1,) * dim, cells=(2,) * dim)
    rims = {"rim": EdgeSelector(between=["right", "top"])} if dim == 3 else {}
    return name_parts(found, edges=rims, points={"ends": PointSelector(of="right")})


@pytest.mark.parametrize(
    ("kind", "names", "dim", "degree"),
    [
        ("region", (), 2, 1),
        ("region", (), 3, 2),
        ("surface", SIDES, 2, 2),
        ("surface", ("right",), 3, 1),
        ("surface", SIDES, 3, 2),
        ("edge", ("rim",), 3, 2),
        ("point", ("ends",), 2, 1),
    ],
)
def test_integrals_are_those_of_ufl(
    kind: str, names: tuple[str, ...], dim: int, degree: int
) -> None:
    """Of formulas with jumps: equal to round-off only if all points are those of the rule."""
    lower = kind in ("edge", "point")
    problem = Problem(
        body(dim),
        LAW,
        loads=[Traction(on=list(names), value=[1.0] * dim)] if kind == "surface" else [],
        supports=[Spring(on=list(names), stiffness=[1.0] * dim)] if lower else [],
        degree=degree,
    )
    context = problem.context
    make = {"region": context.volumes, "surface": context.areas}
    measure = context.held(names).measure if lower else make[kind](names)
    jump = formula("exp(x*t)*where(x < 0.61*y + 0.0137, 1, 3) + z")
    values = (jump, formula("t - y^3"), 2.0)[:dim]
    place = dict(zip("xyz", [*context.X, 0.0], strict=False), t=context.t)
    number, *items = (v if isinstance(v, float) else v.ufl(**place) for v in (jump, *values))
    parts = Parts(kind, names)
    evaluated = context.scalar(jump, CONSTANT, parts) * context.vector(values, None, parts)
    factors = number * ufl.as_vector(items), evaluated
    forms = compiled(problem, [ufl.inner(factor, context.v) * measure for factor in factors])
    context.set_time(0.7, CONSTANT)
    by_ufl, at_points = (fem.assemble_vector(form).array for form in forms)
    size = float(np.abs(by_ufl).max(initial=0.0))
    size = problem.body.comm.allreduce(size, op=MPI.MAX)
    assert size > 1e-3
    np.testing.assert_allclose(at_points, by_ufl, rtol=0, atol=2e-14 * size)


def loaded(first: str, second: str, degree: int = 1) -> Problem:
    """A load of each kind, and springs, with formulas in some components."""
    return Problem(
        body(2),
        LAW,
        loads=[
            Traction(on="right", value=[first, "2*t"]),
            Pressure(on=list(SIDES), value=second),
            BodyForce(value=[0, first]),
            Gravity(value=[second, 0]),
        ],
        supports=[Spring(on="left", normal=f"2 + ({first})", displacement=[second, 0])],
        degree=degree,
    )


def test_another_formula_is_the_same_form() -> None:
    """The name by which compiled forms are found, with formulas in the components and without.

    Of a vector with one formula or several; a formula in t only is a number that changes.
    """
    names = []
    for first, second in (("x*y", "1e3*x"), ("sin(3*x)/(1 + y^2)", "where(y < 0.5, exp(x), 7)")):
        weak_form = loaded(first, second).weak_form
        forms = (weak_form.residual, weak_form.tangent, weak_form.stored("springs"))
        names.append([compute_signature([form], "") for form in forms])
    assert names[0] == names[1]
    for one, other in (
        ([0, "x"], ["x", "x*y"]),
        ([0, 3], [0, "sin(t)"]),
    ):
        works = [
            Problem(body(2), LAW, loads=[Traction(on="right", value=value)], degree=1).weak_form
            for value in (one, other)
        ]
        first_name, second_name = (compute_signature([w.external], "") for w in works)
        assert first_name == second_name


def test_explicit_forces_follow_formulas_in_place_and_time() -> None:
    """Packed once: only what changes with time is read again."""
    problem = Problem(
        body(2),
        LAW,
        loads=[
            Pressure(on=list(SIDES), value="1e3*x*t"),
            BodyForce(value=["x*(1 + t)", "y"]),
        ],
        degree=1,
    )
    (form,) = compiled(problem, [problem.weak_form.residual])
    dofmap = problem.V.dofmap
    forces = Forces(
        problem, problem.weak_form.residual, la.vector(dofmap.index_map, dofmap.index_map_bs)
    )
    for t in (0.3, 2.0):
        problem.set_time(t)
        forces.renew()
        forces.assemble()
        whole = fem.assemble_vector(form)
        whole.scatter_reverse(la.InsertMode.add)
        expected = whole.array[: len(forces.owned)]
        np.testing.assert_allclose(forces.owned, expected, rtol=0, atol=1e-12)
