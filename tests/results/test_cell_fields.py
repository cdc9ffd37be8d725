"""Expressions of the fields of cells: what the form compiler gets."""

from __future__ import annotations

import dolfinx
import ffcx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from ffcx.compiler import compile_ufl_objects

from dolfin_elastic import (
    Gravity,
    Growth,
    NeoHookean,
    Problem,
    Support,
    Thermal,
    Traction,
    box_body,
)
from dolfin_elastic.core.jit import options
from dolfin_elastic.core.jit.compile import _named, _with_numbered_labels
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.results.cell_fields import cell_components
from dolfin_elastic.results.fields import FIELDS

GROWN = [[1.1, 0.02, 0.01], [0.03, 1.2, 0.02], [0.01, 0.02, 1.05]]


def fields_of(problem: Problem) -> ufl.core.expr.Expr:
    names = [name for name, field in FIELDS.items() if field.formula is not None]
    found = cell_components(problem, problem.regions[0], fem.Function(problem.W), names)
    return ufl.as_vector([part for parts in found if parts for part in parts])


@pytest.mark.timeout(100)  # it takes a second, and took more than an hour
@pytest.mark.parametrize(
    ("law", "formulation"), [("guccione", "displacement"), ("corotated", "mixed")]
)
def test_all_fields_beside_growth(law, formulation, comm):
    """FFCx finds equal expressions of stress to be equal path by path, unless they are one object.

    The residual of a law with a pressure has three of the rotation.
    """
    kind = MATERIALS[law]
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm),
        kind(**kind.example),
        loads=[Growth(value=GROWN)],
        degree=2,
        formulation=formulation,
    )
    points = np.full((1, 3), 0.25)
    for form in ((fields_of(problem), points), problem.weak_form.residual):
        compile_ufl_objects([form], ffcx.get_options({"scalar_type": dolfinx.default_scalar_type}))


def keys(comm, **changed) -> list[str]:
    """Names of the compiled residual, tangent and fields of a block."""
    numbers = {"E": 1e6, "nu": 0.3, "growth": GROWN, "warmth": 30, "pull": 5, "along": "1e-3*x"}
    numbers |= changed
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm),
        NeoHookean(E=numbers["E"], nu=numbers["nu"], density=1000, expansion="12 ppm/K"),
        supports=[Support(on="left", displacement=[0, 0, numbers["along"]])],
        loads=[
            Growth(value=numbers["growth"]),
            Thermal(value=numbers["warmth"]),
            Traction(on="right", value=[0, numbers["pull"], 0]),
            Gravity(),
        ],
        degree=1,
    )
    fields = _with_numbered_labels(fields_of(problem))
    forms = [problem.weak_form.residual, problem.weak_form.tangent]
    forms += [(fields, np.full((1, 3), 0.25))]
    return [_named(form, options(comm))[0] for form in forms]


@pytest.mark.parametrize(
    "changed",
    [
        {"E": 2e6},
        {"nu": 0.4},
        {"growth": [[1.1, 0, 0], [0, 1, 0], [0, 0, 2]]},
        {"growth": [1.1, 1.2, 1]},
        {"warmth": 0},
        {"pull": 0},
        {"along": "sin(y)*t"},
    ],
)
def test_a_change_of_numbers_compiles_nothing(changed, comm):
    """Numbers are constants of the forms, zeros and ones too; supports stand in no form."""
    assert keys(comm, **changed) == keys(comm)
