"""The tangent in two stages against the form that FFCx compiles from the whole of it."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import la
from helpers.annulus import annulus
from helpers.laws import make
from helpers.states import bend
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Growth,
    NeoHookean,
    Pressure,
    Problem,
    Selector,
    Spring,
    StVenantKirchhoff,
    Support,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.matrix import BilinearForm
from dolfin_elastic.solvers.assembly.two_stage.form import (
    TwoStageForm,
    in_two_stages,
    tangent_of_external_terms,
)

COMM = MPI.COMM_WORLD
SOFT = NeoHookean(E=1.0, nu=0.3)
RUBBER = NeoHookean(E=1.0, nu=0.499)


def check(problem: Problem) -> None:
    """Both matrices and both liftings, to round-off: of sums of some ten terms, 1e-13 at most."""
    assert in_two_stages(problem)
    bend(problem)
    assembler = Assembler(problem)
    assert assembler.tangent.form.__class__ is TwoStageForm
    split = TwoStageForm(problem, tangent_of_external_terms(problem))
    whole = BilinearForm(compiled(problem, [problem.weak_form.tangent])[0])
    values, products, rows = [], [], assembler.size
    goals = problem.w.x.array + 0.1
    for form in (split, whole):
        matrix = form.matrix()
        form.assemble(matrix, assembler.bcs)
        matrix.scatter_reverse()
        values.append(matrix.data[: matrix.indptr[rows]].copy())
        for bc in assembler.bcs:
            bc.g.x.array[:] = goals
        out = la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs)
        form.lift(out.array, assembler.bcs, goals, problem.w.x.array)
        out.scatter_reverse(la.InsertMode.add)
        product = out.array[:rows].copy()
        # Their rows are replaced.
        product[assembler.prescribed_dofs] = product[assembler.fixed_pressures] = 0.0
        products.append(product)
    assert_alike(*values)
    assert_alike(*products)
    assembler.destroy()


def assert_alike(a: np.ndarray, b: np.ndarray) -> None:
    size = largest(COMM, float(np.max(np.abs(b), initial=0.0)))
    assert size > 0.0
    assert largest(COMM, float(np.max(np.abs(a - b), initial=0.0))) < 1e-13 * size


@pytest.mark.sample(3)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", MATERIALS)
def test_laws(name, degree):
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    supports = [Support(on="left")]
    check(Problem(body, make(name), degree=degree, formulation="displacement", supports=supports))


def test_inertia_follows_its_factor_and_is_added_in_each_state():
    """Its matrix is assembled where the factor is another, and must stand beside any tangent."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 1, 1))
    law = NeoHookean(E=1.0, nu=0.3, density=2.0)
    problem = Problem(body, law, degree=1, supports=[Support(on="left")])
    factor, trial = problem.constant(2.0), ufl.TrialFunction(problem.W)
    inertia = factor * problem.weak_form.inertia(trial, problem.v)
    assembler = Assembler(problem)
    split = TwoStageForm(problem, inertia)
    whole = BilinearForm(compiled(problem, [problem.weak_form.tangent + inertia])[0])
    for factor.value in (2.0, 2.0, 5.0):
        bend(problem)
        values = []
        for form in (split, whole):
            matrix = form.matrix()
            form.assemble(matrix, assembler.bcs)
            matrix.scatter_reverse()
            values.append(matrix.data[: matrix.indptr[assembler.size]].copy())
        assert_alike(*values)
    assembler.destroy()


@pytest.mark.parametrize("nu", [0.499, 0.5])
def test_rubber(nu):
    """Beside a compliance 1/k, exact incompressibility has a strain of its own, J - 1."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    check(Problem(body, NeoHookean(E=1.0, nu=nu), degree=2, supports=[Support(on="left")]))


def test_enclosed_body_whose_pressure_is_fixed_at_a_node():
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    supports = [Support(on=side) for side in ("left", "right", "bottom", "top")]
    check(Problem(body, NeoHookean(E=1.0, nu=0.5), degree=2, supports=supports))


def test_plane_body_with_its_thickness():
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    supports = [Support(on="left", displacement=["0.1*y", 0.0])]
    check(Problem(body, SOFT, degree=2, thickness=0.3, supports=supports))


@pytest.mark.parametrize("law", [SOFT, RUBBER], ids=["soft", "rubber"])
def test_curved_cells_in_which_the_gradients_vary(law):
    body = annulus(COMM, 3)
    assert body.mesh.geometry.cmap.degree == 2
    check(Problem(body, law, degree=2, supports=[Support(on="inside")]))


@pytest.mark.long
@pytest.mark.parametrize("law", [SOFT, RUBBER], ids=["soft", "rubber"])
def test_two_materials_constants_that_vary_growth_springs_and_pressure(law):
    body = name_parts(
        box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2)),
        regions={
            "below": Selector(box=((0, 0, 0), (1, 1, 0.5))),
            "above": Selector(box=((0, 0, 0.5), (1, 1, 1))),
        },
    )
    laws = {"below": StVenantKirchhoff(E="3 + x*y", nu=0.2), "above": law}
    loads = [
        Growth(on="below", value=[1.1, 1.0, 0.9]),
        Pressure(on="right", value=0.2),
        BodyForce(value=[0, 0, 1]),
    ]
    supports = [Support(on="left"), Spring(on="top", stiffness=[2.0, 1.0, 0.0])]
    check(Problem(body, laws, degree=2, loads=loads, supports=supports))


def test_dead_loads_leave_nothing_to_compile_but_the_stress():
    body = box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2))
    problem = Problem(body, SOFT, supports=[Support(on="left")], loads=[BodyForce(value=[0, 0, 1])])
    assert tangent_of_external_terms(problem).empty()


@pytest.mark.parametrize(
    ("geometry", "formulation"),
    [("axisymmetric", "displacement"), ("plane-stress", "displacement")],
)
def test_other_unknowns_and_gradients_are_left_to_the_form_compiler(geometry, formulation):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, SOFT, geometry=geometry, formulation=formulation, degree=2)
    assert not in_two_stages(problem)
    assert Assembler(problem).tangent.form.__class__ is BilinearForm
