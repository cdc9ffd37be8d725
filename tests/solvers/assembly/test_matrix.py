"""The tangent in two stages against the form that FFCx compiles from the whole of it."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import la
from helpers.annulus import annulus
from helpers.laws import make
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
from dolfin_elastic.solvers.assembly.matrix import (
    BilinearForm,
    SplitForm,
    in_two_stages,
    tangent_of_surroundings,
)

COMM = MPI.COMM_WORLD
SOFT = NeoHookean(E=1.0, nu=0.3)


def bend(problem: Problem) -> None:
    """A smooth displacement of a tenth of the body, without symmetry."""
    dim = problem.body.dim

    def u(x: np.ndarray) -> np.ndarray:
        return 0.05 * np.array([x[0] * x[1], np.sin(x[1] + x[0]), x[0] ** 2 + x[1]])[:dim]

    problem.u.interpolate(u)
    problem.unknowns.u_to_w()


def both(problem: Problem) -> tuple[SplitForm, BilinearForm]:
    weak_form = problem.weak_form
    assert in_two_stages(problem)
    split = SplitForm(problem, tangent_of_surroundings(problem))
    return split, BilinearForm(compiled(problem, [weak_form.tangent])[0])


def check(problem: Problem) -> None:
    """Both matrices and both liftings, to round-off: of sums of some ten terms, 1e-13 at most."""
    bend(problem)
    bcs, values = problem.dirichlet.bcs, []
    for form in both(problem):
        matrix = form.matrix()
        form.assemble(matrix, bcs)
        matrix.scatter_reverse()
        rows = problem.V.dofmap.index_map.size_local * problem.V.dofmap.index_map_bs
        values.append(matrix.data[: matrix.indptr[rows]].copy())
    assert_alike(*values)
    goals, products = problem.dirichlet.values.x.array.copy(), []
    goals += 0.1
    problem.dirichlet.values.x.array[:] = goals
    for form in both(problem):
        out = la.vector(problem.V.dofmap.index_map, problem.V.dofmap.index_map_bs)
        form.lift(out.array, bcs, goals, problem.w.x.array)
        out.scatter_reverse(la.InsertMode.add)
        product = out.array[:rows].copy()
        product[problem.dirichlet.owned] = 0.0  # their rows are replaced
        products.append(product)
    assert_alike(*products)


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


def test_plane_body_with_its_thickness():
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    supports = [Support(on="left", displacement=["0.1*y", 0.0])]
    check(Problem(body, SOFT, degree=2, thickness=0.3, supports=supports))


def test_curved_cells_in_which_the_gradients_vary():
    body = annulus(COMM, 3)
    assert body.mesh.geometry.cmap.degree == 2
    check(Problem(body, SOFT, degree=2, supports=[Support(on="inside")]))


@pytest.mark.long
def test_two_materials_constants_that_vary_growth_springs_and_pressure():
    body = name_parts(
        box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2)),
        regions={
            "below": Selector(box=((0, 0, 0), (1, 1, 0.5))),
            "above": Selector(box=((0, 0, 0.5), (1, 1, 1))),
        },
    )
    laws = {"below": StVenantKirchhoff(E="3 + x*y", nu=0.2), "above": SOFT}
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
    assert tangent_of_surroundings(problem).empty()


@pytest.mark.parametrize(
    ("geometry", "formulation"),
    [("axisymmetric", "displacement"), ("plane-stress", "displacement"), ("plane-strain", "mixed")],
)
def test_other_unknowns_and_gradients_are_left_to_the_form_compiler(geometry, formulation):
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, SOFT, geometry=geometry, formulation=formulation, degree=2)
    assert not in_two_stages(problem)
    assert Assembler(problem).tangent.form.__class__ is BilinearForm
