"""Fields against values worked out by hand, on every law, in space and in plane strain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_box, create_rectangle
from mpi4py import MPI

from dolfin_elastic import LinearElastic, NeoHookean, StVenantKirchhoff, Textbook
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS, check_field_names
from dolfin_elastic.results.grid import to_nodes
from dolfin_elastic.results.quantity import Extremes

COMM = MPI.COMM_WORLD
E_MODULUS, NU = 200.0, 0.3
MU = E_MODULUS / (2 * (1 + NU))
LMBDA = E_MODULUS * NU / ((1 + NU) * (1 - 2 * NU))
H = np.array([[0.10, 0.20, -0.05], [0.03, -0.08, 0.04], [0.00, 0.06, 0.12]])


def make_body(dim: int) -> Body:
    """A unit cube or square with two named regions."""
    mesh = (
        create_box(COMM, [[0, 0, 0], [1, 1, 1]], [4, 2, 2], CellType.tetrahedron)
        if dim == 3
        else create_rectangle(COMM, [[0, 0], [1, 1]], [4, 3], CellType.triangle)
    )
    local = mesh.topology.index_map(dim)
    cells = np.arange(local.size_local + local.num_ghosts, dtype=np.int32)
    middles = mesh.geometry.x[mesh.geometry.dofmap].mean(axis=1)
    left = middles[:, 0] < 0.5
    return Body(mesh, regions={"left": cells[left], "right": cells[~left]})


def make_state(
    problem: Problem, place: Callable[[FloatArray], FloatArray], **more: object
) -> State:
    """The state in which the displacement is `place` of the reference coordinates."""
    u = fem.Function(problem.V)
    u.interpolate(lambda x: place(x)[: problem.body.dim])
    return State(1, 1.0, u, **more)  # type: ignore[arg-type]


def gradient(dim: int) -> FloatArray:
    """H, without what crosses the plane in 2D."""
    inside = np.outer(np.arange(3) < dim, np.arange(3) < dim)
    return np.where(inside, H, 0.0)


def by_hand(law: type[Law], F: FloatArray) -> tuple[FloatArray, float]:
    """Cauchy stress and energy density of a law, written out."""
    one, J = np.eye(3), np.linalg.det(F)
    green, small = (F.T @ F - one) / 2, (F + F.T) / 2 - one
    if law is LinearElastic:
        energy = MU * np.sum(small**2) + LMBDA / 2 * np.trace(small) ** 2
        return LMBDA * np.trace(small) * one + 2 * MU * small, energy
    if law is StVenantKirchhoff:
        S = LMBDA * np.trace(green) * one + 2 * MU * green
        return F @ S @ F.T / J, MU * np.sum(green**2) + LMBDA / 2 * np.trace(green) ** 2
    if law is Textbook:
        return LMBDA * np.trace(green) * one + 2 * MU * green, np.nan
    tau = MU * (F @ F.T - one) + LMBDA * np.log(J) * one
    return tau / J, (MU / 2 * (np.sum(F**2) - 3) - MU * np.log(J) + LMBDA / 2 * np.log(J) ** 2)


def mises(sigma: FloatArray) -> float:
    """Von Mises stress from the six components."""
    (a, d, e), (_, b, f), (_, _, c) = (sigma + sigma.T) / 2
    return float(
        np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 2 + 3 * (d**2 + e**2 + f**2))
    )


def worst(difference: FloatArray) -> float:
    """Largest absolute value on all ranks."""
    return float(COMM.allreduce(np.abs(difference).max(initial=0.0), op=MPI.MAX))


@pytest.mark.sample(5)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", [LinearElastic, StVenantKirchhoff, NeoHookean, Textbook])
def test_homogeneous_deformation(law: type[Law], dim: int, degree: int) -> None:
    problem = Problem(make_body(dim), law(E=E_MODULUS, nu=NU), degree=degree)
    F = np.eye(3) + gradient(dim)
    state = make_state(problem, lambda x: gradient(dim) @ x)
    names = ["von_mises", "cauchy_stress", "first_piola", "pressure", "green_strain", "jacobian"]
    names += ["von_mises_cell", "cauchy_stress_cell", "pressure_cell"]
    names += ["energy_density"] if law is not Textbook else []
    values = Evaluator(problem, names)(state)
    sigma, energy = by_hand(law, F)
    J = np.linalg.det(F)
    first = sigma if law.linear else J * sigma @ np.linalg.inv(F).T
    expected = {
        "von_mises": mises(sigma),
        "cauchy_stress": sigma,
        "first_piola": first,
        "pressure": -np.trace(sigma) / 3,
        "green_strain": (F + F.T) / 2 - np.eye(3) if law.linear else (F.T @ F - np.eye(3)) / 2,
        "jacobian": J,
        "energy_density": energy,
    }
    for name in names:
        right = np.reshape(expected[name.removesuffix("_cell")], -1)
        assert worst(values[name] - right) < 1e-9 * E_MODULUS, name


@pytest.mark.long
def test_every_law_has_stresses() -> None:
    body = make_body(3)
    for law in MATERIALS.values():
        try:
            problem = Problem(body, law(E=E_MODULUS, nu=NU), degree=1)
        except InputError:
            continue  # laws with other constants
        state = make_state(problem, lambda x: 0 * x)
        assert worst(Evaluator(problem, ["von_mises"])(state)["von_mises"]) < 1e-9


def test_stress_follows_the_law_of_each_region() -> None:
    laws = {"left": LinearElastic(E=E_MODULUS, nu=NU), "right": LinearElastic(E=3e3, nu=NU)}
    problem = Problem(make_body(3), laws, degree=1)
    state = make_state(problem, lambda x: H @ x)
    names = ["von_mises", "von_mises_cell", "region", "material", "rank"]
    values = Evaluator(problem, names)(state)
    right = values["region"][:, 0] == 1
    sigma, _ = by_hand(LinearElastic, np.eye(3) + H)
    expected = np.where(right, 3e3 / E_MODULUS, 1.0) * mises(sigma)
    assert worst(values["von_mises_cell"][:, 0] / expected - 1) < 1e-12
    # At the nodes of the interface stands the larger one; neither is smeared over it.
    own = problem.V.dofmap.index_map.size_local
    beside = problem.V.tabulate_dof_coordinates()[:own, 0] > 0.5 - 1e-9
    expected = np.where(beside, 3e3 / E_MODULUS, 1.0) * mises(sigma)
    assert worst(values["von_mises"][:, 0] / expected - 1) < 1e-12
    assert worst(values["material"] - values["region"]) == 0
    assert worst(values["rank"] - COMM.rank) == 0
    assert COMM.allreduce(int(right.sum())) not in (0, problem.body.num_cells)


@pytest.mark.parametrize("degree", [1, 2])
def test_average_at_nodes_preserves_constants_and_mean(degree: int) -> None:
    problem = Problem(make_body(3), LinearElastic(E=1.0, nu=NU), degree=degree)
    mesh, own = problem.body.mesh, problem.body.owned_cells()
    assert worst(to_nodes(problem.V, np.full((len(own), 2), 7.0)) - 7.0) < 1e-13
    middles = mesh.geometry.x[mesh.geometry.dofmap[own]].mean(axis=1)
    nodal = to_nodes(problem.V, middles)
    assert worst(nodal - problem.V.tabulate_dof_coordinates()) < 0.5
    volume = COMM.allreduce(float(np.abs(signed_volumes(cell_corners(mesh, own))).sum()))
    assert abs(volume - 1) < 1e-13
    lowest = COMM.allreduce(nodal.min(), op=MPI.MIN)
    assert lowest >= COMM.allreduce(middles.min(initial=9.0), op=MPI.MIN) - 1e-13  # no overshoot


def test_nodal_von_mises() -> None:
    problem = Problem(make_body(2), NeoHookean(E=E_MODULUS, nu=NU), degree=2)
    state = make_state(problem, lambda x: gradient(2) @ x)
    sigma, _ = by_hand(NeoHookean, np.eye(3) + gradient(2))
    values = Evaluator(problem, ["von_mises_nodal"])(state)["von_mises_nodal"]
    assert len(values) == problem.V.dofmap.index_map.size_local
    assert worst(values - mises(sigma)) < 1e-10


@pytest.mark.parametrize("dim", [2, 3])
def test_reactions_balance(dim: int) -> None:
    problem = Problem(make_body(dim), StVenantKirchhoff(E=E_MODULUS, nu=NU), degree=1)
    state = make_state(problem, lambda x: gradient(dim) @ x)
    forces = Evaluator(problem, ["reaction"])(state)["reaction"]
    assert np.abs(COMM.allreduce(forces.sum(axis=0))).max() < 1e-12 * E_MODULUS
    # On x = 1 they are the resultant of P N.
    x = problem.V.tabulate_dof_coordinates()[: len(forces)]
    inside = np.all((x[:, :dim] > 1e-9) & (x[:, :dim] < 1 - 1e-9), axis=1)
    assert worst(forces[inside]) < 1e-12 * E_MODULUS


def test_motion_has_velocities_and_statics_has_none() -> None:
    problem = Problem(make_body(2), LinearElastic(E=1.0, nu=NU, density=2.0), degree=1)
    v = fem.Function(problem.V)
    v.interpolate(lambda x: (x[0], 2 + 0 * x[0]))
    moving = make_state(problem, lambda x: 0 * x, v=v, a=v)
    values = Evaluator(problem, ["velocity", "acceleration"])(moving)
    own = problem.V.dofmap.index_map.size_local
    x = problem.V.tabulate_dof_coordinates()[:own]
    assert worst(values["velocity"] - np.stack([x[:, 0], 2 + 0 * x[:, 0], 0 * x[:, 0]], 1)) < 1e-14
    assert worst(values["acceleration"] - values["velocity"]) < 1e-14
    with pytest.raises(InputError, match="in statics only"):
        Evaluator(problem, ["reaction"])(moving)
    with pytest.raises(InputError, match="in motion only"):
        Evaluator(problem, ["velocity"])(make_state(problem, lambda x: 0 * x))


@pytest.mark.parametrize("degree", [1, 2])
def test_extremes_and_their_places(degree: int) -> None:
    laws = {"left": LinearElastic(E=E_MODULUS, nu=NU), "right": LinearElastic(E=3e3, nu=NU)}
    problem = Problem(make_body(3), laws, degree=degree)
    found = Extremes(problem).of(make_state(problem, lambda x: H @ x))
    sigma, _ = by_hand(LinearElastic, np.eye(3) + H)
    assert found["von_mises"].value == pytest.approx(15 * mises(sigma))
    assert found["von_mises"].part == "right"
    assert found["von_mises"].place[0] >= 0.5 - 1e-12
    J = np.linalg.det(np.eye(3) + H)
    assert found["min_jacobian"].value == pytest.approx(J) == found["max_jacobian"].value
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    lengths = np.linalg.norm(corners @ H.T, axis=1)
    assert found["displacement"].value == pytest.approx(lengths.max())
    assert np.allclose(found["displacement"].place, corners[np.argmax(lengths)])


def test_unknown_fields_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'von_mises'"):
        check_field_names(["von_misses"], make_body(2))
    problem = Problem(make_body(2), Textbook(E=1.0, nu=NU), degree=1)
    with pytest.raises(InputError, match="no strain energy"):
        Evaluator(problem, ["energy_density"])


def test_table_is_complete() -> None:
    for name, field in FIELDS.items():
        assert field.description, name
        assert field.formula or field.values, name
        assert (field.values is None) == (field.centre == "cell" and bool(field.formula)), name
        assert not field.recovered or (field.centre == "node" and field.formula), name
