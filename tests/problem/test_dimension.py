"""Two-dimensional bodies: plane strain, plane stress with its thickness solved for, axisymmetry.

Uniaxial states are those of a bar with free sides, solved at a point to 1e-12; the tube is Lame's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Dynamics,
    Gravity,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    Textbook,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator

FREE = "free"
E, NU = 1e6, 0.3

UNIAXIAL = {
    (StVenantKirchhoff, 0.8): (1.052615789355, -1.44e5),
    (StVenantKirchhoff, 1.5): (0.790569415042, 9.375e5),
    (NeoHookean, 0.8): (1.067338369279, -2.400053819880e5),
    (NeoHookean, 1.5): (0.880174591807, 3.782801763943e5),
}
"""Law and stretch to lateral stretch and P11 [Pa], both sides free."""

PLANE_STRAIN = {
    (StVenantKirchhoff, 1.5): (0.681385143869, 1.030219780220e6),
    (NeoHookean, 1.5): (0.824923642240, 4.024361498652e5),
    (StVenantKirchhoff, 0.8): (1.074376895826, -1.582417582418e5),
    (NeoHookean, 0.8): (1.094876055994, -2.686315278790e5),
}
"""The same with the thickness held."""


def pulled(law: Any, stretch: float, degree: int, **how: Any) -> tuple[Problem, State]:
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 2))
    problem = Problem(
        body,
        law,
        degree=degree,
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="right", displacement=[stretch - 1, FREE]),
        ],
        **how,
    )
    *_, state = Statics(problem, steps=2, rtol=1e-13).steps()
    return problem, state


def lateral(problem: Problem) -> float:
    """Stretch across, from the highest node."""
    moved = problem.u.x.array.reshape(-1, 2)[:, 1]
    comm = problem.body.comm
    low = comm.allreduce(float(moved.min(initial=0.0)), op=MPI.MIN)
    return 1 + low + comm.allreduce(float(moved.max(initial=0.0)), op=MPI.MAX)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("kind", "stretch"), UNIAXIAL)
def test_plane_stress_solves_for_the_thickness(kind, stretch, degree):
    across, P11 = UNIAXIAL[kind, stretch]
    problem, state = pulled(
        kind(E=E, nu=NU), stretch, degree, geometry="plane-stress", thickness=0.01
    )
    assert lateral(problem) == pytest.approx(across, abs=1e-11)
    assert state.reactions["right"][0] == pytest.approx(P11 * 0.01, rel=1e-10)
    values = Evaluator(problem, ["cauchy_stress", "jacobian"])(state)
    comm = problem.body.comm
    out_of_plane = np.abs(values["cauchy_stress"][:, 8]).max(initial=0.0)
    assert comm.allreduce(float(out_of_plane), op=MPI.MAX) < 1e-8 * E
    off = np.abs(values["jacobian"] - stretch * across**2).max(initial=0.0)
    assert comm.allreduce(float(off), op=MPI.MAX) < 1e-10


@pytest.mark.parametrize(("kind", "stretch"), PLANE_STRAIN)
def test_plane_strain_holds_it(kind, stretch):
    across, P11 = PLANE_STRAIN[kind, stretch]
    problem, state = pulled(kind(E=E, nu=NU), stretch, 1)
    assert lateral(problem) == pytest.approx(across, abs=1e-11)
    assert state.reactions["right"][0] == pytest.approx(P11, rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_plane_stress_of_an_incompressible_sheet(degree):
    """P11 = mu (s - s^-2), s the stretch: the pressure is found with the thickness."""
    problem, state = pulled(
        NeoHookean(E=E, nu=0.5), 1.5, degree, geometry="plane-stress", formulation="mixed"
    )
    assert lateral(problem) == pytest.approx(1.5**-0.5, abs=1e-11)
    assert state.reactions["right"][0] == pytest.approx(E / 3 * (1.5 - 1.5**-2), rel=1e-10)


def test_linear_plane_stress_has_its_modulus():
    """A sheet held along two sides: sigma = E/(1 - nu^2) eps."""
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    held = [
        Support(on=["bottom", "top"], displacement=[FREE, 0]),
        Support(on="left", displacement=[0, FREE]),
        Support(on="right", displacement=[1e-3, FREE]),
    ]
    problem = Problem(
        body, LinearElastic(E=E, nu=NU), supports=held, geometry="plane-stress", degree=1
    )
    *_, state = Statics(problem).steps()
    assert state.reactions["right"][0] == pytest.approx(1e-3 * E / (1 - NU**2), rel=1e-10)


# --- axisymmetric bodies ---


def tube(nu: float, degree: int, n: int, **how: Any) -> float:
    """Error in L2 of the radial displacement of Lame's tube, a = 1, b = 2, p = 1e5."""
    body = rectangle_body(size=(1.0, 0.25), cells=(n, n // 4), origin=(1.0, 0.0))
    problem = Problem(
        body,
        LinearElastic(E=E, nu=nu),
        degree=degree,
        supports=[Support(on=["bottom", "top"], displacement=[FREE, 0])],
        loads=[Traction(on="left", value=[1e5, 0])],
        geometry="axisymmetric",
        **how,
    )
    [*_] = Statics(problem).steps()
    r = problem.V.tabulate_dof_coordinates()[:, 0]
    own = problem.V.dofmap.index_map.size_local
    exact = (1 + nu) / E * (1e5 / 3) * ((1 - 2 * nu) * r + 4 / r)
    off = (problem.u.x.array.reshape(-1, 2)[:, 0] - exact)[:own]
    sums = body.comm.allreduce(np.array([np.sum(off**2), own]))
    return float(np.sqrt(sums[0] / sums[1]))


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("nu", "degree", "how", "rate"),
    [
        (0.3, 1, {}, 2),
        (0.3, 2, {}, 3),
        (0.5, 1, {"formulation": "mixed"}, 1.5),
        (0.5, 2, {}, 3),
    ],
)
def test_thick_tube(nu, degree, how, rate):
    cells = np.array([8, 16, 32])
    found = [tube(nu, degree, n, **how) for n in cells]
    print(found)
    assert np.polyfit(np.log(1 / cells), np.log(found), 1)[0] >= rate - 0.1


def test_axisymmetric_bar():
    """A round bar of radius 0.5 stretched by a half: the uniaxial state, times its area."""
    across, P11 = UNIAXIAL[NeoHookean, 1.5]
    body = rectangle_body(size=(0.5, 1.0), cells=(2, 4))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, 0.5]),
        ],
        geometry="axisymmetric",
        degree=1,
    )
    *_, state = Statics(problem, steps=2, rtol=1e-13).steps()
    assert state.reactions["top"][1] == pytest.approx(P11 * np.pi / 4, rel=1e-10)
    r = problem.V.tabulate_dof_coordinates()[:, 0]
    off = np.abs(problem.u.x.array.reshape(-1, 2)[:, 0] - (across - 1) * r).max(initial=0.0)
    assert body.comm.allreduce(float(off), op=MPI.MAX) < 1e-11


@pytest.mark.parametrize(
    ("stretch", "pressure"),
    [(1.1, 0.131562278444), (1.5, 0.428228409097), (2.0, 0.574053572307)],
)
def test_incompressible_tube_blown_up(stretch, pressure):
    """Inner radius 1, outer 2, mu = 1, no axial stretch: closed form of Rivlin (1949)."""
    n = 32
    body = rectangle_body(size=(1.0, 1 / 16), cells=(n, 2), origin=(1.0, 0.0))
    problem = Problem(
        body,
        NeoHookean(mu=1.0, nu=0.5),
        degree=2,
        supports=[
            Support(on=["bottom", "top"], displacement=[FREE, 0]),
            Support(on="left", displacement=[stretch - 1, FREE]),
        ],
        geometry="axisymmetric",
    )
    *_, state = Statics(problem, steps=4).steps()
    found = state.reactions["left"][0] / (2 * np.pi * stretch / 16)
    assert found == pytest.approx(pressure, rel=1e-5)


def test_axisymmetric_weight_and_fall():
    """Mass is that of the whole ring: pi (b^2 - a^2) h times density."""
    law = LinearElastic(E=E, nu=NU, density=1000.0)
    body = rectangle_body(size=(1.0, 0.5), cells=(4, 2), origin=(1.0, 0.0))
    mass = np.pi * 3 * 0.5 * 1000
    how: dict[str, Any] = {"loads": [Gravity()], "geometry": "axisymmetric"}
    standing = Problem(
        body, law, supports=[Support(on="bottom", displacement=[FREE, 0])], degree=1, **how
    )
    *_, state = Statics(standing).steps()
    assert state.reactions["bottom"][1] == pytest.approx(mass * 9.81, rel=1e-10)
    falling = Problem(body, law, degree=1, **how)
    *_, state = Dynamics(falling, end=0.1, dt=0.05, rtol=1e-12).steps()
    assert state.energies["kinetic"] == pytest.approx(mass * 0.981**2 / 2, rel=1e-8)


def test_thickness_scales_forces_and_energies():
    answers = []
    for thickness in (1.0, 0.02):
        _, state = pulled(NeoHookean(E=E, nu=NU), 1.2, 1, thickness=thickness)
        answers.append(np.array([state.reactions["right"][0], state.energies["strain"]]))
    np.testing.assert_allclose(answers[1], 0.02 * answers[0], rtol=1e-11)


# --- every law ---

POWERFUL = [name for name, kind in MATERIALS.items() if kind(**kind.example).has_energy]
ROUND = [name for name in POWERFUL if not MATERIALS[name].directions]
FLAT = [
    name
    for name in POWERFUL
    if "fibre" not in MATERIALS[name].directions and name != "j2-logarithmic"
]
"""What can be computed in plane stress, and is symmetric to its plane."""


def bar(law: Any, geometry: str) -> tuple[float, float]:
    """Force and energy of a unit bar stretched by a fifth, its sides free; symmetric ends."""
    if geometry == "solid":
        body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 1))
        pull, how, free = "right", {}, [FREE, FREE]
        held = [
            Support(on="left", displacement=[0, FREE, FREE]),
            Support(on="front", displacement=[FREE, 0, FREE]),
            Support(on="bottom", displacement=[FREE, FREE, 0]),
        ]
        held.append(Support(on="right", displacement=[0.2, *free]))
    elif geometry == "plane-stress":
        body, how, pull = (
            rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
            {"geometry": geometry},
            "right",
        )
        held = [
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="right", displacement=[0.2, FREE]),
        ]
    else:
        body, how, pull = (
            rectangle_body(size=(1.0, 1.0), cells=(1, 1)),
            {"geometry": geometry},
            "top",
        )
        held = [
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, 0.2]),
        ]
    area = np.pi if geometry == "axisymmetric" else 1.0
    problem = Problem(body, law, supports=held, formulation="displacement", **{"degree": 1, **how})
    *_, state = Statics(problem, steps=2, rtol=1e-12).steps()
    force = np.linalg.norm(state.reactions[pull])
    return force / area, state.energies["strain"] / area


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("name", "geometry"),
    [(name, "plane-stress") for name in POWERFUL if name in FLAT]
    + [(name, "axisymmetric") for name in ROUND],
)
def test_every_law_is_the_same_in_every_geometry(name, geometry):
    """A homogeneous uniaxial state is exact in all of them, for laws symmetric to their planes."""
    axes = {"axis1": [1, 0, 0], "axis2": [0, 1, 0]} if name == "orthotropic" else {}
    law = MATERIALS[name](**{**MATERIALS[name].example, **axes})
    np.testing.assert_allclose(bar(law, geometry), bar(law, "solid"), rtol=1e-8)


# --- what is refused ---


@pytest.mark.parametrize(
    ("origin", "dim", "how", "message"),
    [
        (0.0, 2, {"geometry": "plane-stres"}, "did you mean 'plane-stress'"),
        (0.0, 3, {"geometry": "plane-stress"}, "three-dimensional body is not 'plane-stress'"),
        (-0.5, 2, {"geometry": "axisymmetric"}, "points of the mesh have a negative radius"),
        (0.0, 2, {"thickness": 0.0}, "thickness"),
        (0.0, 2, {"geometry": "axisymmetric", "thickness": 0.1}, "only a plane body has"),
        (0.0, 3, {"thickness": 0.1}, "only a plane body has"),
    ],
)
def test_refusals(origin, dim, how, message):
    body = box_body(size=(1.0,) * dim, cells=(2,) * dim, origin=(origin,) + (0.0,) * (dim - 1))
    with pytest.raises(InputError, match=message):
        Problem(body, LinearElastic(E=E, nu=NU), degree=1, **how)


def test_an_axisymmetric_body_may_move_along_its_axis_only():
    body = rectangle_body(size=(1.0, 1.0), cells=(2, 2))
    problem = Problem(body, LinearElastic(E=E, nu=NU), geometry="axisymmetric", degree=1)
    with pytest.raises(InputError, match="it can move along y;"):
        next(Statics(problem).steps())


# --- the textbook's duck ---


def test_the_textbook_square_pressed_and_turned():
    """Stretch (0.5, 1), then a rotation by 30 degrees; E = 1e7 Pa, nu = 0.4999, plane strain.

    Printed texts give 1 for the second Green strain, which is the stretch: the strain is 0.  The
    stress -3 (lmbda + 2 mu)/8 and -3 lmbda/8 stays along x and y though the body has turned.
    """
    turn = np.array([[np.cos(np.pi / 6), -0.5], [0.5, np.cos(np.pi / 6)]])
    F = turn @ np.diag([0.5, 1.0])
    np.testing.assert_allclose(F, [[0.433012701892, -0.5], [0.25, 0.866025403784]], atol=1e-12)
    body = rectangle_body(size=(1.0, 1.0), cells=(3, 3))
    problem = Problem(body, Textbook(E=1e7, nu=0.4999), degree=1)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: (F - np.eye(2)) @ x[:2])
    state = State(step=1, t=1.0, u=u)
    values = Evaluator(problem, ["green_strain", "cauchy_stress"])(state)
    strain, stress = values["green_strain"], values["cauchy_stress"]
    wanted = np.zeros(9)
    wanted[0] = -0.375
    np.testing.assert_allclose(strain, np.tile(wanted, (len(strain), 1)), atol=1e-13)
    np.testing.assert_allclose(stress[:, 0], -6.251666777786e9, rtol=1e-12)
    np.testing.assert_allclose(stress[:, 4], -6.249166611108e9, rtol=1e-12)
    np.testing.assert_allclose(stress[:, 1], 0.0, atol=1e-3)
