"""Supports, springs and forces on edges and points: closed forms, on any number of ranks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.nodal_forces import forces, moved, total
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Dashpot,
    Dynamics,
    Force,
    LinearElastic,
    LineForce,
    Modal,
    PointForce,
    Problem,
    Spring,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh import EdgeSelector, PointSelector, name_parts
from dolfin_elastic.problem.state import State
from dolfin_elastic.problem.terms.edges_points import points_of

E, NU = 1e6, 0.3
LAW = LinearElastic(E=E, nu=NU)


def bar(scale: float = 1.0) -> Body:
    """2 x 1 x 1 with names for an edge, corners and a set of nodes."""
    box = box_body(size=(2, 1, 1), cells=(3, 2, 2), scale=scale)
    corner = {"a": (0, 0, 0), "b": (0, 1, 0), "c": (0, 0, 1), "d": (2, 1, 1)}
    return name_parts(
        box,
        edges={
            "rim": EdgeSelector(between=["right", "top"]),
            "foot": EdgeSelector(between=["left", "bottom"]),
            "long": EdgeSelector(between=["front", "bottom"]),
        },
        points={
            **{name: PointSelector(nearest=place) for name, place in corner.items()},
            "end": PointSelector(of="right"),
        },
        scale=scale,
    )


def solved(problem: Problem) -> State:
    """Its equilibrium in one step."""
    return list(Statics(problem, steps=1).steps())[-1]


# --- supports ---


@pytest.mark.parametrize("degree", [1, 2])
def test_three_points_hold_a_bar_without_stress(degree: int) -> None:
    """Six conditions at three corners: uniaxial tension is exact to round-off (patch test)."""
    supports = [
        Support(on="a"),
        Support(on="b", displacement=["free", "free", 0]),
        Support(on="c", displacement=[0, "free", "free"]),
        Support(on="b", name="b again", displacement=[0, "free", "free"]),
    ]
    problem = Problem(
        bar(),
        LAW,
        supports=supports,
        loads=[Traction(on="right", value=[1e3, 0, 0]), Traction(on="left", value=[-1e3, 0, 0])],
        degree=degree,
    )
    state = solved(problem)
    x = problem.V.tabulate_dof_coordinates()
    exact = 1e3 / E * x * [1, -NU, -NU]
    np.testing.assert_allclose(state.u.x.array.reshape(-1, 3), exact, atol=1e-12)
    for reaction in state.reactions.values():  # the loads balance each other
        np.testing.assert_allclose(reaction, 0, atol=1e-8)


@pytest.mark.parametrize("degree", [1, 2])
def test_an_edge_holds_its_midside_nodes_and_bears_the_moment(degree: int) -> None:
    """The edge x = z = 0 carries the force, an edge at x = 2 half the weight of a beam.

    Both reactions follow from equilibrium: F/4 and 3F/4 of a force at 3/4 of the span.
    """
    body = bar()
    foot, far = Support(on="foot"), Support(on="rim", displacement=["free", "free", 0])
    force = PointForce(at=[1.5, 0.5, 1], value=[0, 0, -800])
    problem = Problem(body, LAW, supports=[foot, far], loads=[force], degree=degree)
    nodes = body.comm.allreduce(len(problem.constraints.reaction_dofs["foot"]), op=MPI.SUM)
    assert nodes == 3 * (3 if degree == 1 else 5)
    state = solved(problem)
    np.testing.assert_allclose(state.reactions["foot"], [0, 0, 200], atol=1e-6)
    np.testing.assert_allclose(state.reactions["rim"][2], 600, atol=1e-6)


def test_a_set_of_nodes_with_a_single_one_is_held_whole() -> None:
    """The parts of a name are held together: its facets, its edges and its nodes."""
    body = bar()
    both = body.named(surfaces={"set": body.surfaces["left"]}, points={"set": body.points["d"]})
    held = [
        Problem(b, LAW, supports=[Support(on=on)], degree=1)
        for b, on in ((both, "set"), (body, "left"))
    ]
    counts = [
        body.comm.allreduce(len(p.constraints.reaction_dofs[label]), op=MPI.SUM)
        for p, label in zip(held, ("set", "left"), strict=True)
    ]
    assert counts[0] == counts[1] + 3


# --- forces ---


def resultants(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Sum of nodal forces, and of their products with the places."""
    problem.set_time(1.0)
    x, nodal = forces(problem)
    return total(problem, nodal), total(problem, np.einsum("ni,nj->nij", x, nodal))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("whole", [False, True])
def test_line_force_on_an_edge(degree: int, whole: bool) -> None:
    """Along the edge y = z = 0 of length 2: integrals of x and of the constant are exact."""
    value: list[Any] = [0, "3*x", 6]
    load = Force(on="long", value=[0, 0, 6]) if whole else LineForce(on="long", value=value)
    force, moment = resultants(Problem(bar(), LAW, loads=[load], degree=degree))
    np.testing.assert_allclose(force, [0, 0, 6] if whole else [0, 6, 12], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(
        moment[0], [0, 0, 6] if whole else [0, 8, 12], rtol=1e-13, atol=1e-13
    )


@pytest.mark.parametrize("degree", [1, 2])
def test_point_forces_on_nodes(degree: int) -> None:
    """Nine vertices at the end, each with the force, or with a ninth of it."""
    for kind, share in ((PointForce, 9), (Force, 1)):
        load = kind(on=["end", "d"], value=["2 N", 0, "x + y"])
        force, _ = resultants(Problem(bar(), LAW, loads=[load], degree=degree))
        np.testing.assert_allclose(force, share * np.array([2, 0, 2.5]), rtol=1e-13)


def test_force_on_nodes_that_facets_do_not_cover() -> None:
    """A set of nodes that is no surface shares it out among its nodes."""
    body = bar()
    body = body.named(surfaces={"set": body.surfaces["left"]}, points={"set": body.points["d"]})
    body = replace(body, uncovered={"set": 1})
    problem = Problem(
        body, LAW, supports=[Support(on="right")], loads=[Force(on="set", value=[0, 0, 6])]
    )
    np.testing.assert_allclose(resultants(problem)[0], [0, 0, 6], atol=1e-12)
    assert isinstance(problem.loads[0], PointForce)


def test_point_force_by_name_is_that_by_place() -> None:
    body = bar()
    found = [
        resultants(Problem(body, LAW, loads=[load], degree=1))
        for load in (PointForce(on="d", value=[1, 2, 3]), PointForce(at=[2, 1, 1], value=[1, 2, 3]))
    ]
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-13)
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-12)


# --- springs ---


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("whole", [False, True])
def test_bar_on_springs_along_edges(degree: int, whole: bool) -> None:
    """Pulled up against springs on two edges of length 1 each, in parallel: u = F/(2 k).

    The bar may move along z alone; its own shear adds nothing, since E is 1e4 times stiffer.
    """
    k, F = 500.0, 30.0
    stiff = LinearElastic(E=1e4 * E, nu=NU)
    names = ["foot", "rim"]
    stiffness = [f"{2 * k if whole else k} {'N/m' if whole else 'N/m^2'}", 0, 0]
    springs = Spring(on=names, stiffness=[stiffness[1], 0, stiffness[0]], total=whole)
    guides = [
        Support(on=name, name=name, displacement=[0, 0, "free"]) for name in ("foot", "rim", "b")
    ]
    load = Force(on=["foot", "rim"], value=[0, 0, F])
    problem = Problem(bar(), stiff, supports=[springs, *guides], loads=[load], degree=degree)
    state = solved(problem)
    np.testing.assert_allclose(state.u.x.array.reshape(-1, 3)[:, 2], F / (2 * k), rtol=1e-6)
    np.testing.assert_allclose(state.energies["springs"], F**2 / (4 * k), rtol=1e-6)


def test_three_point_springs_and_a_dashpot() -> None:
    """Statically determinate: the springs' forces are those of equilibrium, u = F/k each.

    A plate on springs at (0, 0), (0, 1) and on the edge x = 2, with the force at its middle: half
    of it goes to the edge, a quarter to each point.
    """
    stiff = LinearElastic(E=1e4 * E, nu=NU)
    supports = [
        Spring(on=["a", "b"], stiffness=[0, 0, "100 N/m"]),
        Spring(on="rim", stiffness=[0, 0, "400 N/m"], total=True),
        Dashpot(on="d", viscosity=[1, 1, "1 N*s/m"]),
        Support(on="a", displacement=[0, 0, "free"], name="pin"),
        Support(on="b", displacement=[0, "free", "free"], name="roller"),
    ]
    load = PointForce(at=[1, 0.5, 0.5], value=[0, 0, -80])
    problem = Problem(bar(), stiff, supports=supports, loads=[load], degree=1)
    state = solved(problem)
    x = problem.V.tabulate_dof_coordinates()
    w = state.u.x.array.reshape(-1, 3)[:, 2]
    np.testing.assert_allclose(w, -0.2 + 0.1 * x[:, 0] / 2, rtol=1e-6)


def test_point_springs_in_a_plane_are_of_the_whole_thickness() -> None:
    square = name_parts(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        points={"l": PointSelector(nearest=(0, 0)), "r": PointSelector(nearest=(1, 0))},
    )
    problem = Problem(
        square,
        LinearElastic(E=1e11, nu=NU),
        supports=[
            Spring(on=["l", "r"], stiffness=[0, 50]),
            Support(on=["l"], displacement=[0, "free"], name="guide"),
        ],
        loads=[PointForce(at=[0.5, 1], value=[0, -10])],
        thickness=0.01,
        degree=1,
    )
    state = solved(problem)
    np.testing.assert_allclose(state.u.x.array.reshape(-1, 2)[:, 1], -0.1, rtol=1e-6)


@pytest.mark.parametrize("degree", [1, 2])
def test_energy_of_springs_on_edges_and_points(degree: int) -> None:
    """At any displacement: by Gauss points on the edges of its polynomials, and at the nodes."""
    springs = [
        Spring(on=["rim", "long"], stiffness=["200*(1 + x)", 300, 0], displacement=[0.1, 0, 0]),
        Spring(on=["a", "end"], stiffness=[10, 20, 30]),
    ]
    problem = Problem(bar(), LAW, supports=springs, degree=degree)
    moved(problem, 0.01)
    energy = problem.weak_form.stored("springs")
    assert energy is not None
    (form,) = compile_forms(problem.body.comm, [energy], options(problem.body.comm))
    found = problem.body.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)
    u = problem.u
    expected = _energy_by_hand(problem, u.x.array.reshape(-1, 3))
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def _energy_by_hand(problem: Problem, u: FloatArray) -> float:
    """Sum over nodes of "a" and "end"; edges by Gauss points of the displacement's polynomial."""
    body, energy = problem.body, 0.0
    for kind, names, k, base in (
        ("edge", ["rim", "long"], lambda x: np.array([200 * (1 + x[0]), 300, 0]), [0.1, 0, 0]),
        ("point", ["a", "end"], lambda x: np.array([10, 20, 30]), [0, 0, 0]),
    ):
        points = points_of(body, kind, names, 8)
        for X, weights, cell, local in zip(
            points.X, points.weights, points.cells, points.local, strict=True
        ):
            table = problem.V.element.basix_element.tabulate(0, local)[0, :, :, 0]
            values = table @ u[problem.V.dofmap.list[cell]] - base
            for x, weight, w in zip(X, weights, values, strict=True):
                energy += 0.5 * weight * float(k(x) @ w**2)
    return float(body.comm.allreduce(energy, op=MPI.SUM))


# --- motion ---

HEAVY = LinearElastic(E=1e9, nu=0.0, density=1000.0)


def test_mode_of_a_mass_on_springs() -> None:
    """2000 kg on 4 kN/m heaves with sqrt(k/m)/(2 pi); half of the springs are on an edge."""
    supports = [
        Spring(on=["a", "b"], stiffness=[0, 0, 1000]),
        Spring(on="rim", stiffness=[0, 0, 2000], total=True),
        Support(on=["a", "b"], displacement=[0, 0, "free"], name="guide"),
        Support(on="rim", displacement=["free", 0, "free"], name="side"),
    ]
    problem = Problem(bar(), HEAVY, supports=supports, degree=1)
    found = [mode.frequency for mode in Modal(problem, count=2).modes()]
    assert min(abs(f / (np.sqrt(2) / (2 * np.pi)) - 1) for f in found) < 1e-4


@pytest.mark.parametrize("k", [1e3, 1e9])
def test_point_springs_and_the_stable_step(k: float) -> None:
    """An explicit motion with stiff springs at a corner stays bounded: its energy is conserved."""
    spring = Spring(on="d", stiffness=[k, k, k])
    problem = Problem(bar(), HEAVY, supports=[spring, Support(on="foot")], degree=1)
    states = list(
        Dynamics(
            problem, scheme="central-differences", end=2e-2, initial_velocity=["x", 0, 0], every=10
        ).steps()
    )
    energies = [state.energies["total"] for state in states]
    np.testing.assert_allclose(energies, energies[0], rtol=0.1)  # else it grows without bound


# --- what does not fit ---


@pytest.mark.parametrize(
    ("supports", "loads", "says"),
    [
        ([Spring(on="rim", normal=3)], [], "'rim'.normal: an edge has no normal"),
        (
            [Spring(on="a", stiffness=["1 N/m^3", 0, 0])],
            [],
            "the unit is not that of a spring on",
        ),
        ([Spring(on="left", stiffness=["1 N/m", 0, 0])], [], "per area N/m^3; or N/m of the whole"),
        ([Spring(on=["left", "a"], stiffness=[1, 0, 0])], [], "'left', 'a' are of several dim"),
        ([Support(on="rm")], [], "no surface 'rm' in box 2 x 1 x 1; did you mean 'rim'"),
        ([], [PointForce(on="rim", value=[0, 0, 1])], "load[0].on: 'rim' is an edge, not a point"),
        ([], [LineForce(on="a", value=[0, 0, 1])], "load[0].on: 'a' is a point, not an edge"),
        ([], [PointForce(on="d", value=[0, 1])], "load[0].value: 2 components"),
        ([], [Force(on="d", value=[0, 1])], "load[0].value: 2 components"),
        ([], [Force(on=["left", "a"], value=[0, 0, 1])], "load[0].on: 'left', 'a' are of several"),
    ],
)
def test_what_does_not_fit(supports: list[Any], loads: list[Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        Problem(bar(), LAW, supports=supports, loads=loads, degree=1)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "keys", "says"),
    [
        (PointForce, {"at": [0, 0, 0], "on": "a"}, "on: on and at are given together"),
        (PointForce, {"on": []}, "on: no name is given"),
        (LineForce, {"start": [0, 0, 0]}, "end: this key is missing"),
        (LineForce, {"on": "rim", "tolerance": 1}, "tolerance: tolerance needs coordinates"),
    ],
)
def test_keys_that_do_not_go_together(kind: Any, keys: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        kind(value=[0, 0, 1], **keys)
    assert says in str(caught.value)
