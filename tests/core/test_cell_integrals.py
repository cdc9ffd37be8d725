"""Integrals over cells and values there, by loops of our own, against DOLFINx's of the same."""

from __future__ import annotations

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from helpers.laws import make
from helpers.states import bend
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Gravity,
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
from dolfin_elastic.core.jit import cell_integrals, compile_expression
from dolfin_elastic.core.jit.cell_integrals import CellExpression, can_be_packed
from dolfin_elastic.core.jit.vectorise import _in_lanes
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.solvers.assembly.assembler import compiled, in_cells
from dolfin_elastic.solvers.assembly.two_stage.form import moduli
from dolfin_elastic.solvers.audit.equilibrium import EnergyBook

COMM = MPI.COMM_WORLD
SOFT = NeoHookean(E=1.0, nu=0.3, density=1.0)


@pytest.fixture(autouse=True, params=[cell_integrals.MANY_CELLS, 0], ids=["few", "many"])
def cells_from_which_lanes_pay(request, monkeypatch):
    """All cases cell by cell, and eight cells at once."""
    monkeypatch.setattr(cell_integrals, "MANY_CELLS", request.param)


FUSED = 5e-15
"""In lanes other products and sums are fused: some roundings in each of a few hundred terms."""


def check(problem: Problem, *, by_loop: bool = True, within: float = FUSED) -> None:
    """Residual and energy, to the rounding errors of sums of some ten terms."""
    bend(problem)
    whole = compiled(problem, [problem.weak_form.residual])[0]
    cells, others = in_cells(problem, problem.weak_form.residual)
    assert (cells is not None) == by_loop
    found, known = (
        la.vector(problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs) for _ in range(2)
    )
    if cells is not None:
        cells.add_to(found.array)
    if others is not None:
        fem.assemble_vector(found.array, others)
    fem.assemble_vector(known.array, whole)
    for vector in (found, known):
        vector.scatter_reverse(la.InsertMode.add)
    size = largest(COMM, float(np.max(np.abs(known.array), initial=0.0)))
    assert size > 0.0
    off = np.abs(found.array - known.array)
    assert largest(COMM, float(np.max(off, initial=0.0))) < 1e-14 * 10 * size
    energy = problem.weak_form.strain_energy
    assert energy is not None
    stored, varying = in_cells(problem, energy)
    assert ((stored is not None), (varying is not None)) == (by_loop, not by_loop)
    exact = total(COMM, float(fem.assemble_scalar(compiled(problem, [energy])[0])))
    book = EnergyBook(problem).stored()
    assert book["strain"] - book.get("dissipated", 0.0) == pytest.approx(exact, rel=1e-12)
    for region in problem.regions:
        check_values(problem, region, by_loop=by_loop, within=within)


def check_values(problem: Problem, region: MaterialRegion, *, by_loop: bool, within: float) -> None:
    """Moduli, cell by cell bit by bit: the kernel is the same, and so is all that it gets."""
    dim = problem.body.dim
    points = np.concatenate([np.full((1, dim), 0.25), np.full((1, dim), 0.1)])
    expression = compile_expression(COMM, moduli(problem, region), points, problem.jit)
    values = CellExpression(moduli(problem, region), points, problem.w, problem.jit)
    assert (values.kernel is not None) == by_loop
    assert values.in_lanes == (by_loop and cell_integrals.MANY_CELLS == 0)
    cells = region.cells[::-1]
    known = expression.eval(problem.body.mesh, cells).reshape(len(cells), values.size)
    assert not known.size or np.any(known)
    off = within * float(np.max(np.abs(known), initial=0.0)) if values.in_lanes else 0.0
    np.testing.assert_allclose(values.eval(cells), known, rtol=0.0, atol=off)
    room = np.full((len(cells), values.size), np.nan)
    assert values.eval(cells, room) is room
    np.testing.assert_allclose(room, known, rtol=0.0, atol=off)


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("degree", [1, 2])
def test_loads_and_springs_beside_them(degree):
    """Weight is an integral over cells, pressure and springs are not."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    loads = [Gravity(), Pressure(on="top", value=0.1)]
    supports = [Support(on="left"), Spring(on="right", stiffness=[0.2, 0.1, 0.3])]
    check(Problem(body, SOFT, degree=degree, supports=supports, loads=loads))


@pytest.mark.sample(2)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", [name for name in MATERIALS if name != "textbook"])
def test_laws(name, degree):
    """Functions, choices and comparisons, too.

    Derivatives of principal stretches divide by what close ones differ by, which has half of the
    digits where a series does not yet take its place.
    """
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 1))
    law = make(name)
    of_stretches = ("hencky", "j2-logarithmic", "ogden", "corotated", "fixed-corotated")
    within = 2e-13 if name in of_stretches else FUSED
    check(Problem(body, law, degree=degree, formulation="displacement"), within=within)


@pytest.mark.long
def test_several_materials():
    """One integral each, with cells of its own."""
    body = name_parts(
        rectangle_body(size=(2.0, 1.0), cells=(4, 2)),
        regions={"soft": Selector(box=[[0, 0], [1, 1]]), "stiff": Selector(box=[[1, 0], [2, 1]])},
    )
    laws = {"soft": SOFT, "stiff": StVenantKirchhoff(E=3.0, nu=0.2)}
    check(Problem(body, laws, degree=2, supports=[Support(on="left")]))


@pytest.mark.sample(2)
@pytest.mark.parametrize("nu", [0.499, 0.5])
def test_pressures_beside_displacements(nu):
    """The unknowns of a cell are those of both, one by one."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    check(Problem(body, NeoHookean(E=1.0, nu=nu), degree=2, supports=[Support(on="left")]))


def test_another_coefficient_is_packed():
    """A modulus that varies in space is a function, too."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    law = NeoHookean(E="1 + x", nu=0.3)
    problem = Problem(body, law, degree=1, supports=[Support(on="left")])
    check(problem)
    along_edges = fem.Function(fem.functionspace(body.mesh, ("N1curl", 1)))
    assert not can_be_packed(along_edges, problem.w)


@pytest.mark.long
def test_a_load_that_varies_leaves_the_law_in_the_loop():
    """Each term of a form goes its own way."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 2))
    loads = [BodyForce(value=["x", 0, "y*z"]), Gravity(), Pressure(on="top", value="0.1*x")]
    problem = Problem(body, SOFT, degree=1, supports=[Support(on="left")], loads=loads)
    cells, others = in_cells(problem, problem.weak_form.residual)
    assert cells is not None
    assert others is not None
    check(problem)


@pytest.mark.parametrize(
    "line",
    [
        "int a = b ? 1 : 3;",
        "double a = jn(2, b);",
        "double a = b % 2;",
        "if (b) a = 1.0;",
        "double a = b < 1 ? 2.0 : 3.0;",
        "float a = 1.0;",
        "double a = (double)b;",
        "double a = FE[entity_local_index[0]][1];",
        "double a = I * 2.0;",
    ],
)
def test_code_that_is_not_known_stays_as_it_is(line):
    """Then the kernel is called cell by cell."""
    known = "// numbers,\ndouble b = sqrt(w[0]) + pow(2, c[1]); // of a cell,"
    assert len((_in_lanes(f"{{\n{known}\n}}") or "").splitlines()) == 3
    assert _in_lanes(f"{{\n{known}\n{line}\n}}") is None
    assert _in_lanes("") is None


def test_rules_of_high_degree_leave_the_stack_alone():
    """Numbers of eight cells at their 1331 points would take 8 MB."""
    body = box_body(size=(1.0, 0.8, 0.6), cells=(2, 2, 1))
    loads = [Pressure(on="top", value=0.1)]
    law, supports = NeoHookean(E=1.0, nu=0.499), [Support(on="left")]
    problem = Problem(body, law, degree=2, supports=supports, loads=loads, quadrature_degree=20)
    bend(problem)
    region = problem.regions[0]
    points, _ = basix.make_quadrature(body.mesh.basix_cell(), 20)
    values = CellExpression(moduli(problem, region), points, problem.w, problem.jit)
    assert (len(points), values.in_lanes) == (1331, False)
    assert np.isfinite(values.eval(region.cells)).all()


def test_elementary_functions():
    """Logarithm, exponential and powers to two units in the last place, and what is not finite."""
    body = box_body(size=(1, 1, 1), cells=(5, 5, 5))
    problem = Problem(body, SOFT, degree=1)
    fields = [fem.Function(fem.functionspace(body.mesh, ("DG", 0))) for _ in range(2)]
    x, t = (f.x.array for f in fields)
    rng = np.random.default_rng(4)
    x[:], t[:] = np.exp(rng.uniform(-3, 3, len(x))), rng.uniform(-600, 600, len(x))
    x[::2] = 1 + 1e-3 * rng.standard_normal(len(x[::2]))
    t[::2] = rng.standard_normal(len(t[::2]))
    x[-20:-10] = [0.0, -1.0, np.inf, np.nan, 5e-324, 1e-310, 1.0, 1e308, -0.0, 0.5]
    t[-20:-10] = [0.0, -1e4, np.inf, np.nan, -np.inf, 1e4, 710.0, -745.0, 1e-300, 1.0]
    base, power = fields
    wanted = ufl.as_vector(
        [ufl.ln(base), ufl.exp(power), base ** (-2 / 3), base**2, base**2.5, base**-40.0]
    )
    values = CellExpression(wanted, np.full((1, 3), 0.25), problem.w, problem.jit)
    with np.errstate(all="ignore"):
        known = [np.log(x), np.exp(t), x ** (-2 / 3), x**2, x**2.5, x**-40.0]
        found = values.eval(np.arange(len(x), dtype=np.int32)).T
        for one, other in zip(found, known, strict=True):
            assert np.array_equal(np.isfinite(one), np.isfinite(other))
            plain = np.isfinite(other)
            assert np.array_equal(one[~plain], other[~plain], equal_nan=True)
            np.testing.assert_allclose(one[plain], other[plain], rtol=4.5e-16, atol=5e-324)
