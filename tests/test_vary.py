"""Materials that vary in space: fields of mesh files, formulas, directions, safety factors."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Selector,
    Statics,
    Support,
    box_body,
    name_parts,
    read_body,
    rectangle_body,
)
from dolfin_elastic.case import Case
from dolfin_elastic.check import report
from dolfin_elastic.errors import InputError, MeshError
from dolfin_elastic.meshes import Body
from dolfin_elastic.meshes.fields import MeshField
from dolfin_elastic.meshes.shapes import cell_corners
from dolfin_elastic.model.kinematics import green_strain
from dolfin_elastic.model.law import Law
from dolfin_elastic.model.varying import Direction
from dolfin_elastic.parallel import on_root
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.extremes import extremes
from dolfin_elastic.run import run
from dolfin_elastic.varying import Binder

COMM = MPI.COMM_WORLD
SHARED = Path(__file__).resolve().parents[2] / "shared" / "meshes"
FREE = "free"


@pytest.fixture
def folder() -> Iterator[Path]:
    """One folder for all ranks."""
    made = COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else "")
    yield Path(made)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(made)


def made(action: Callable[[], object]) -> None:
    """Makes a file on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def middles(body: Body) -> np.ndarray:
    return cell_corners(body.mesh).mean(axis=1)


def largest(values: np.ndarray) -> float:
    return COMM.allreduce(float(np.max(values, initial=-np.inf)), op=MPI.MAX)


def bar(cells: int, n: int = 1, dim: int = 3) -> Body:
    """1 x 0.1 x 0.1."""
    if dim == 2:
        return rectangle_body(size=(1.0, 0.1), cells=(cells, n))
    return box_body(size=(1.0, 0.1, 0.1), cells=(cells, n, n))


def pulled(body: Body, laws: Any, degree: int = 1, by: float = 0.01) -> tuple[Problem, Any]:
    """Stretched along x with all lateral displacement blocked where nothing moves freely."""
    sides = ["bottom", "top"] if body.dim == 2 else ["bottom", "top", "front", "back"]
    axis = {"bottom": 2, "top": 2, "front": 1, "back": 1} if body.dim == 3 else {}
    held = [
        Support(
            on=side,
            displacement=[
                0 if i == axis.get(side, body.dim - 1) else FREE for i in range(body.dim)
            ],
        )
        for side in sides
    ]
    ends = [
        Support(on="left", displacement=[0] + [FREE] * (body.dim - 1)),
        Support(on="right", displacement=[by] + [FREE] * (body.dim - 1)),
    ]
    problem = Problem(body, laws, supports=[*held, *ends], degree=degree)
    *_, state = Statics(problem).steps()
    return problem, state


# --- bars in series and in parallel ---


def halves(body: Body, axis: int = 0, names: tuple[str, str] = ("one", "two")) -> Body:
    low, high = [0.0, 0.0, 0.0], [1.0, 0.1, 0.1]
    middle = [*high]
    middle[axis] = high[axis] / 2
    start = [*low]
    start[axis] = middle[axis]
    return name_parts(
        body,
        regions={
            names[0]: Selector(box=(low, middle)),
            names[1]: Selector(box=(start, high)),
        },
    )


def modulus(E: float, nu: float) -> float:
    """Of a bar that cannot move sideways."""
    return E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))


TWO = {"one": LinearElastic(E=1e9, nu=0.3), "two": LinearElastic(E=3e9, nu=0.2)}
ONE, OTHER = modulus(1e9, 0.3), modulus(3e9, 0.2)
AREA, BY = 0.01, 0.01


def at_x(problem: Problem, x: float) -> np.ndarray:
    """Displacements along x at the nodes of a plane, of all ranks."""
    places = problem.V.tabulate_dof_coordinates()
    near = np.abs(places[:, 0] - x) < 1e-9
    own = problem.u.x.array.reshape(-1, problem.body.dim)[near, 0]
    return np.concatenate(COMM.allgather(own))


@pytest.mark.parametrize("degree", [1, 2])
def test_bars_in_series(degree: int) -> None:
    problem, state = pulled(halves(bar(4)), TWO, degree)
    stiffness = AREA / (0.5 / ONE + 0.5 / OTHER)
    assert state.reactions["right"][0] == pytest.approx(stiffness * BY, rel=1e-10)
    interface = BY * (0.5 / ONE) / (0.5 / ONE + 0.5 / OTHER)
    found = at_x(problem, 0.5)
    assert len(found) >= 4
    np.testing.assert_allclose(found, interface, rtol=1e-10)


def test_bars_in_parallel() -> None:
    problem, state = pulled(halves(bar(4, 2), axis=2), TWO)
    force = AREA / 2 * (ONE + OTHER) * BY
    assert state.reactions["right"][0] == pytest.approx(force, rel=1e-10)
    np.testing.assert_allclose(at_x(problem, 0.5), BY / 2, rtol=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_jump_along_facets_is_two_regions(degree: int) -> None:
    """The same two bars from one law whose constants jump."""
    law = LinearElastic(E="where(x < 0.5, 1e9, 3e9)", nu="where(x < 0.5, 0.3, 0.2)")
    _, state = pulled(bar(4), law, degree)
    stiffness = AREA / (0.5 / ONE + 0.5 / OTHER)
    assert state.reactions["right"][0] == pytest.approx(stiffness * BY, rel=1e-10)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the folder ../shared/meshes is absent")
def test_two_named_regions_of_a_real_file() -> None:
    """Two tetrahedra glued at z = 0: what is pushed into one end comes out at the other."""
    body = read_body(SHARED / "two_regions_named_v41.msh")
    assert set(body.regions) == {"upper", "lower"}
    laws = {"upper": LinearElastic(E=1e6, nu=0), "lower": LinearElastic(E=3e6, nu=0)}
    blocked = Support(on="interface", displacement=[0, 0, "z + 0.01"])
    problem = Problem(body, laws, supports=[blocked, Support(on=["side_a", "side_b"])])
    *_, state = Statics(problem).steps()
    assert sum(np.asarray(r) for r in state.reactions.values()) == pytest.approx(
        np.zeros(3), abs=1e-9
    )


# --- formulas against closed forms ---


@pytest.mark.parametrize(("degree", "rate"), [(1, 2), (2, 4)])
def test_bar_with_a_graded_modulus(degree: int, rate: int) -> None:
    """Force over stretch is 1 / integral of 1/(E A), here E = 1e6 (1 + x)^2: A 2e6."""
    errors = []
    for n in (4, 8):
        _, state = pulled(bar(n, dim=2), LinearElastic(E="1e6*(1 + x)^2", nu=0), degree)
        errors.append(abs(state.reactions["right"][0] / (0.1 * 2e6 * BY) - 1))
    assert errors[1] < 0.01
    assert np.log2(errors[0] / errors[1]) > rate - 0.2


def test_density_varies_in_weight_and_inertia() -> None:
    """rho = 1000 (1 + 2 z/0.1): the mean is 2000, so is the mass of 0.01 m^3 times it."""
    law = LinearElastic(E=1e6, nu=0.3, density="1000*(1 + 2*z/0.1)")
    for degree in (1, 2):
        problem = Problem(
            bar(4), law, supports=[Support(on="bottom")], loads=[Gravity()], degree=degree
        )
        *_, state = Statics(problem).steps()
        assert state.reactions["bottom"][2] == pytest.approx(20 * 9.81, rel=1e-10)
        one = ufl.as_vector([0.0, 0.0, 1.0])
        mass = fem.form(ufl.action(problem.inertia(one, problem.v), _ones(problem)))
        assert COMM.allreduce(fem.assemble_scalar(mass)) == pytest.approx(20, rel=1e-10)


def _ones(problem: Problem) -> fem.Function:
    ones = fem.Function(problem.V)
    ones.x.array[:] = 1
    return ones


def test_weight_of_a_region_with_varying_density() -> None:
    body = halves(bar(4))
    laws = {
        "one": LinearElastic(E=1e6, nu=0.3, density="1000*(1 + x)"),
        "two": LinearElastic(E=1e6, nu=0.3, density=10),
    }
    for degree in (1, 2):
        loads = [Gravity(on="one"), Gravity(on="two")]
        problem = Problem(body, laws, supports=[Support(on="bottom")], loads=loads, degree=degree)
        *_, state = Statics(problem).steps()
        weight = 9.81 * AREA * (1000 * (0.5 + 0.125) + 10 * 0.5)
        assert state.reactions["bottom"][2] == pytest.approx(weight, rel=1e-10)


def test_explicit_motion_of_a_varying_material() -> None:
    """Momentum of a free fall is g M t whatever varies."""
    law = LinearElastic(E="1e5*(1 + x)", nu=0.2, density="1000*(2 - x)")
    problem = Problem(bar(4), law, loads=[Gravity()])
    *_, state = Dynamics(problem, end=1e-3, scheme="symplectic-euler").steps()
    assert state.momenta["linear"][2] == pytest.approx(-9.81 * 15 * 1e-3, rel=1e-9)


PAIRS = {"E": 2e6, "nu": 0.25, "K": 4e6 / 3, "lmbda": 8e5, "mu": 8e5}


@pytest.mark.parametrize("pair", [("E", "nu"), ("E", "lmbda"), ("nu", "K"), ("K", "mu")])
def test_any_two_constants_that_vary(pair: tuple[str, str]) -> None:
    """A formula that gives the same number everywhere is that number."""
    given = {name: f"{PAIRS[name]!r}*(1 + 0*x)" for name in pair}
    _, varied = pulled(bar(2), NeoHookean(**given))
    _, plain = pulled(bar(2), NeoHookean(E=2e6, nu=0.25))
    assert varied.reactions["right"] == pytest.approx(plain.reactions["right"], rel=1e-10)
    one_number = {pair[0]: given[pair[0]], pair[1]: PAIRS[pair[1]]}
    _, mixed = pulled(bar(2), NeoHookean(**one_number))
    assert mixed.reactions["right"] == pytest.approx(plain.reactions["right"], rel=1e-10)


def test_another_formula_compiles_nothing() -> None:
    problems = [
        Problem(bar(2), NeoHookean(E=E, nu=nu, density=rho), loads=[Gravity()])
        for E, nu, rho in (("1e6*(1 + x)", 0.3, "10*(1 + y)"), ("sin(x) + 7e5", 0.1, "5 + z"))
    ]
    for name in ("residual", "tangent", "strain_energy", "external"):
        one, other = (getattr(problem, name).signature() for problem in problems)
        assert one == other


def test_typical_law_has_numbers_only() -> None:
    law = LinearElastic(E="2e6*x", nu=0.25, density=3)
    bound = Binder(bar(8), 1).bind(law, bar(8).owned_cells())
    assert bound.typical.E == pytest.approx(1e6, rel=1e-12)
    assert bound.typical.mu == pytest.approx(4e5, rel=1e-12)
    assert bound.typical.deferred() == {}
