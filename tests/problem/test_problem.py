"""`Problem`: covering, names, one sum of terms, consistent derivatives, nothing compiled twice."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from helpers.laws import make
from mpi4py import MPI

import dolfin_elastic
from dolfin_elastic import (
    BodyForce,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.mesh import Body
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.registry import MATERIALS, Isotropic
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral

E, NU = 1e6, 0.3
FREE = "free"


def square() -> Body:
    return name_parts(
        rectangle_body(size=(1.0, 1.0), cells=(4, 4)),
        regions={
            "west": Selector(box=((0, 0), (0.5, 1))),
            "east": Selector(box=((0.5, 0), (1, 1))),
            "south": Selector(box=((0, 0), (1, 0.5))),
        },
    )


def wave(problem: Problem, seed: int) -> np.ndarray:
    """A smooth nodal field that is the same function of place on every rank."""
    x = problem.V.tabulate_dof_coordinates()[:, : problem.body.dim]
    k = np.random.default_rng(seed).uniform(1, 3, (problem.body.dim, problem.body.dim))
    return (0.05 * np.sin(x @ k + seed)).ravel()


def dot(problem: Problem, a: np.ndarray, b: np.ndarray) -> float:
    """Over the entries of all ranks, each once."""
    size = problem.W.dofmap.index_map.size_local * problem.W.dofmap.index_map_bs
    return problem.body.comm.allreduce(float(a[:size] @ b[:size]), op=MPI.SUM)


# --- materials cover the body ---


def test_every_cell_needs_exactly_one_material():
    soft = LinearElastic(E=E, nu=NU)
    with pytest.raises(MeshError) as caught:
        Problem(square(), {"west": soft}, degree=1)
    assert "16 of 32 elements have no material" in str(caught.value)
    with pytest.raises(MeshError) as caught:
        Problem(square(), {"west": soft, "east": soft, "south": soft}, degree=1)
    assert "16 elements have more than one material" in str(caught.value)
    with pytest.raises(MeshError) as caught:
        Problem(square(), {"wset": soft, "east": soft}, degree=1)
    assert "did you mean 'west'" in str(caught.value)
    Problem(square(), {"west": soft, "east": soft}, degree=1)


def test_unknown_names_and_wrong_vectors():
    law = LinearElastic(E=E, nu=NU)
    for wrong, says in (
        ({"supports": [Support(on="lfet", displacement=[0, 0])]}, "did you mean 'left'"),
        ({"loads": [Traction(on="rihgt", value=[0, 0])]}, "did you mean 'right'"),
        ({"loads": [BodyForce(on="wset", value=[0, 0])]}, "did you mean 'west'"),
        ({"supports": [Support(on="left", displacement=[0, 0, 0])]}, "3 components"),
        ({"loads": [Traction(on="left", value=[0, 0, 1])]}, "3 components"),
        ({"loads": [Gravity()]}, "density"),
    ):
        with pytest.raises(InputError) as caught:
            Problem(square(), law, degree=1, **wrong)
        assert says in str(caught.value)


def test_missing_density_names_its_material():
    laws = {"west": LinearElastic(E=E, nu=NU, density=1.0), "east": LinearElastic(E=E, nu=NU)}
    with pytest.raises(InputError) as caught:
        Problem(square(), laws, loads=[Gravity()], degree=1)
    assert "materials.east" in str(caught.value)
    # Weight on the region that has a density is as good as it was.
    with pytest.raises(InputError):
        Problem(square(), laws, loads=[Gravity(on="east")], degree=1)


# --- one sum of terms, with consistent derivatives ---


def assembled(problem: Problem, form: fem.Form) -> np.ndarray:
    vector = la.vector(problem.V.dofmap.index_map, problem.V.dofmap.index_map_bs)
    fem.assemble_vector(vector.array, form)
    vector.scatter_reverse(la.InsertMode.add)
    return vector.array.copy()


OTHER = {
    name: {"E": 2 * E, "nu": 0.2} for name, kind in MATERIALS.items() if issubclass(kind, Isotropic)
}
"""Constants of a second material of the same law; of other laws it is the same material."""


def waves(problem: Problem, seed: int) -> np.ndarray:
    """The same for all unknowns."""
    found = fem.Function(problem.W)
    found.x.array[problem.unknowns.mixed_dofs(np.arange(len(problem.u.x.array)))] = wave(
        problem, seed
    )
    if problem.mixed:
        found.sub(1).interpolate(lambda x: 0.01 * np.cos(seed * x[0] - x[1]))
    return found.x.array.copy()


SPLIT = [name for name, kind in MATERIALS.items() if issubclass(kind, SplitLaw)]


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("name", "formulation"),
    [(name, "displacement") for name in MATERIALS] + [(name, "mixed") for name in SPLIT],
)
def test_tangent_is_the_derivative_of_the_residual(name, formulation):
    """K w against differences of the residual, fourth order; w K v = v K w iff an energy exists."""
    laws = {"west": make(name), "east": make(name, **OTHER.get(name, {}))}
    problem = Problem(
        square(),
        laws,
        degree=2,
        loads=[Traction(on="right", value=["1e4*x", 0])],
        formulation=formulation,
    )
    assembler = Assembler(problem)
    u, w = waves(problem, 1), waves(problem, 2)
    x, out = assembler.create_vector(), assembler.create_vector()

    def residual(at: np.ndarray) -> np.ndarray:
        x.array_w[:] = at[: assembler.size]
        assembler.residual.evaluate(x, out)
        return out.array_r.copy()

    h = 1e-3
    numeric = (
        8 * (residual(u + h * w) - residual(u - h * w))
        - (residual(u + 2 * h * w) - residual(u - 2 * h * w))
    ) / (12 * h)
    residual(u)
    assembler.tangent.assemble(x)

    def product(direction: np.ndarray) -> np.ndarray:
        x.array_w[:] = direction[: assembler.size]
        assembler.tangent.matrix.mult(x, out)
        return out.array_r.copy()

    exact, other = product(w), product(waves(problem, 3))
    comm = problem.body.comm
    worst, scale = (
        comm.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX)
        for a in (exact - numeric, exact)
    )
    assert worst < 1e-8 * scale
    forth, back = dot(problem, waves(problem, 3), exact), dot(problem, w, other)
    asymmetry = abs(forth - back) / abs(forth)
    assert asymmetry < 1e-12 if problem.has_energy else asymmetry > 1e-4
    x.destroy()
    out.destroy()
    assembler.destroy()


LOADS = {
    "body force": BodyForce(value=[1e5, 0]),
    "in a region": BodyForce(on="south", value=[0, "1e5*x"]),
    "in two": BodyForce(on=["west", "south"], value=[1e5, 0]),
    "weight": Gravity(),
    "weight of a region": Gravity(on=["east", "south"]),
    "traction": Traction(on=["right", "top"], value=[0, 1e5]),
}


@pytest.mark.sample(6)
@pytest.mark.parametrize("load", [*LOADS, "all of them"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("materials", [1, 2])
def test_residual_is_the_sum_of_its_terms(materials, degree, load):
    """Each term is integrated alone and its total is known; then all of them in one form.

    Several terms on one part of the body differ in their quadrature: they must not be mixed up.
    """
    laws = {
        "west": LinearElastic(E=E, nu=NU, density=100.0),
        "east": LinearElastic(E=2 * E, nu=NU, density=300.0),
    }
    loads = [*LOADS.values()] if load == "all of them" else [LOADS[load]]
    problem = Problem(
        square(), laws if materials == 2 else laws["west"], loads=loads, degree=degree
    )
    east = 300.0 if materials == 2 else 100.0
    totals = {
        "body force": (1e5, 0),
        "in a region": (0, 1e5 / 4),
        "in two": (0.75e5, 0),
        "weight": (0, -9.81 * (100 + east) / 2),
        "weight of a region": (0, -9.81 * (east / 2 + 100 / 4)),
        "traction": (0, 2e5),
    }
    expected = np.sum(list(totals.values()), axis=0) if load == "all of them" else totals[load]
    problem.u.x.array[:] = wave(problem, 1)
    forms = compile_forms(
        problem.body.comm,
        [problem.weak_form.residual, problem.weak_form.internal, problem.weak_form.external],
        problem.jit,
    )
    whole, internal, external = (assembled(problem, form) for form in forms)
    mask = np.tile(np.eye(2), (1, len(whole) // 2))
    found = [dot(problem, external, row) for row in mask]
    # Where the named regions overlap the load acts once: it is a force per volume.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-8)
    difference = whole - (internal - external)
    scale = dot(problem, internal, internal) + dot(problem, external, external)
    assert dot(problem, difference, difference) < 1e-26 * scale


@pytest.mark.sample(6)
@pytest.mark.parametrize(
    "name", [n for n, kind in MATERIALS.items() if kind(**kind.example).has_energy]
)
def test_internal_forces_are_the_derivative_of_the_energy(name):
    problem = Problem(square(), make(name), degree=2)
    energy = compiled(problem, [problem.weak_form.strain_energy])[0]
    force = compile_forms(problem.body.comm, [problem.weak_form.internal], problem.jit)[0]
    u, w, h = wave(problem, 1), wave(problem, 2), 1e-3

    def psi(s: float) -> float:
        problem.u.x.array[:] = u + s * h * w
        return integral(problem, energy)

    numeric = (8 * (psi(1) - psi(-1)) - (psi(2) - psi(-2))) / (12 * h)
    problem.u.x.array[:] = u
    assert dot(problem, assembled(problem, force), w) == pytest.approx(numeric, rel=1e-9)


def test_energy_and_residual_see_the_same_laws():
    """A rigid rotation costs nothing; a law without energy leaves none to ask for."""
    problem = Problem(square(), StVenantKirchhoff(E=E, nu=NU), degree=1)
    x = problem.V.tabulate_dof_coordinates()[:, :2]
    c, s = np.cos(1.0), np.sin(1.0)
    problem.u.x.array[:] = (x @ np.array([[c, s], [-s, c]]) - x).ravel()
    energy, force = (
        compile_forms(problem.body.comm, [form], problem.jit)[0]
        for form in (problem.weak_form.strain_energy, problem.weak_form.internal)
    )
    assert abs(integral(problem, energy)) < 1e-25 * E
    assert dot(problem, *[assembled(problem, force)] * 2) < (1e-14 * E) ** 2
    assert (
        Problem(square(), MATERIALS["textbook"](E=E, nu=NU), degree=1).weak_form.strain_energy
        is None
    )
    assert not Problem(
        square(),
        {"west": NeoHookean(E=E, nu=NU), "east": MATERIALS["textbook"](E=E, nu=NU)},
        degree=1,
    ).has_energy


def test_inertia_is_the_mass():
    problem = Problem(
        square(),
        {
            "west": LinearElastic(E=E, nu=NU, density=3.0),
            "east": LinearElastic(E=E, nu=NU, density=5.0),
        },
        degree=2,
    )
    one = ufl.as_vector([1.0, 0.0])
    mass = compile_forms(
        problem.body.comm, [problem.weak_form.inertia(one, problem.v)], problem.jit
    )[0]
    forces = assembled(problem, mass).reshape(-1, 2)
    ones = np.ones_like(forces).ravel()
    assert dot(problem, forces.ravel(), ones) == pytest.approx(4.0, rel=1e-13)


# --- supports that meet ---


def test_the_later_support_holds():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    law = LinearElastic(E=E, nu=NU)
    left = Support(on="left", displacement=[0, 0])
    top = Support(on="top", displacement=[0.2, FREE], name="lid")
    for order, value in (((left, top), 0.2), ((top, left), 0.0)):
        problem = Problem(body, law, supports=order, degree=1)
        *_, state = Statics(problem).steps()
        x = problem.V.tabulate_dof_coordinates()
        corner = np.flatnonzero((np.abs(x[:, 0]) < 1e-9) & (np.abs(x[:, 1] - 1) < 1e-9))
        found = [float(problem.u.x.array[2 * i]) for i in corner]
        everywhere = [v for values in body.comm.allgather(found) for v in values]
        np.testing.assert_allclose(everywhere, value, atol=1e-15)
        assert set(state.reactions) == {"left", "lid"}
        # What holds the body sums to nothing, however the corner is shared.
        total = sum(state.reactions.values())
        assert np.abs(total).max() < 1e-9 * np.abs(state.reactions["lid"]).max()


# --- nothing is compiled twice ---


def forms_of(**numbers: Any) -> Problem:
    law = NeoHookean(E=numbers["E"], nu=numbers["nu"], density=numbers["density"])
    return Problem(
        square(),
        law,
        supports=[Support(on="left", displacement=[numbers["hold"], 0])],
        loads=[
            Traction(on="right", value=[numbers["pull"], 1.0]),
            Gravity(),
            BodyForce(value=[numbers["pull"] * 2, "x*t"]),
        ],
        degree=1,
    )


def test_other_numbers_compile_nothing():
    """All numbers are constants of the forms: the signatures, and so the compiled code, stay."""
    first = forms_of(E=1e6, nu=0.3, density=1000.0, hold=0.0, pull=5.0)
    other = forms_of(E=7.3e9, nu=0.1, density=0.5, hold=0.1, pull=-3.0)
    for name in ("residual", "tangent", "strain_energy", "external"):
        forms = [getattr(problem.weak_form, name) for problem in (first, other)]
        assert forms[0].signature() == forms[1].signature(), name


@pytest.mark.long
def test_the_cache_does_not_grow(comm, folder, monkeypatch):
    """Counted in the folder itself, through a solve at other loads, times and constants."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))

    def count() -> int:
        comm.barrier()
        return comm.bcast(len(list(Path(folder).rglob("*.c"))))

    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    counts = []
    for number in (1.0, 2.5):
        problem = Problem(
            body,
            LinearElastic(E=E * number, nu=NU / number),
            supports=[Support(on="left", displacement=[0, 0])],
            loads=[Traction(on="right", value=[number, "y*t"])],
            degree=1,
        )
        _ = [*Statics(problem, steps=3).steps()]
        counts.append(count())
    assert counts[0] >= 3
    assert counts[1] == counts[0]


def test_time_moves_loads_and_supports():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[Support(on="left", displacement=["t", 0])],
        loads=[
            Traction(on="right", value=[1.0, 0], curve="t^2"),
            Traction(on="right", value=[0, "10*t"]),
        ],
        degree=1,
    )
    form = compile_forms(body.comm, [problem.weak_form.external], problem.jit)[0]
    for t in (0.0, 0.5, 2.0):
        problem.set_time(t)
        forces = assembled(problem, form).reshape(-1, 2)
        ones = np.ones(forces.shape[0])
        assert dot(problem, forces.ravel(), np.outer(ones, [1, 0]).ravel()) == pytest.approx(
            t**2, abs=1e-14
        )
        assert dot(problem, forces.ravel(), np.outer(ones, [0, 1]).ravel()) == pytest.approx(
            10 * t, abs=1e-13
        )
        held = problem.constraints
        assert (
            body.comm.allreduce(
                float(held.values.x.array[held.prescribed_dofs].max(initial=-1.0)), op=MPI.MAX
            )
            == t
        )


@pytest.mark.long
def test_more_exact_integration_can_be_asked_for():
    """Quadratic elements under-integrate on purpose; degree 6 changes little, so both are right."""
    energies = []
    for degree in (None, 6):
        body = box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2))
        problem = Problem(
            body,
            NeoHookean(E=E, nu=NU),
            degree=2,
            quadrature_degree=degree,
            supports=[Support(on="left"), Support(on="right", displacement=[0.2, 0.1, 0])],
        )
        *_, state = Statics(problem).steps()
        energies.append(state.energies["strain"])
    assert energies[0] == pytest.approx(energies[1], rel=1e-2)
    assert energies[0] != energies[1]


def test_weight_of_a_region_needs_its_density_only():
    """The other region may be without; 3 kg/m^3 times g times half a square metre."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    body = name_parts(
        body,
        regions={
            "low": Selector(box=[[0, 0], [1, 0.5]]),
            "high": Selector(box=[[0, 0.5], [1, 1]]),
        },
    )
    laws = {"low": LinearElastic(E=1e4, nu=0.3, density=3), "high": LinearElastic(E=1e4, nu=0.3)}
    held = [Support(on="bottom")]
    problem = Problem(body, laws, supports=held, loads=[Gravity(on="low")], degree=1)
    *_, state = Statics(problem).steps()
    assert state.reactions["bottom"][1] == pytest.approx(3 * 9.81 / 2, rel=1e-10)
    with pytest.raises(InputError, match="materials.high"):
        Problem(body, laws, supports=held, loads=[Gravity(on="high")], degree=1)


def test_a_body_that_nothing_holds_is_refused():
    problem = Problem(
        rectangle_body(size=(1.0, 1.0), cells=(2, 2)),
        LinearElastic(E=1, nu=0.3),
        supports=[Support(on="left", displacement=[0, "free"])],
        degree=1,
    )
    with pytest.raises(InputError, match="as a rigid body it can move along y"):
        next(Statics(problem).steps())


def test_no_public_name_is_a_module_s():
    """Python would put the module in its place as soon as anything imports from it."""
    for name in dolfin_elastic.__all__:
        assert find_spec(f"dolfin_elastic.{name}") is None, name
        assert callable(getattr(dolfin_elastic, name)), name
