"""Pressure that follows its surface: closed forms, resultants, symmetry of the tangent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.annulus import FREE, annulus, radial, solved
from helpers.bodies import made
from helpers.nodal_forces import forces, moved, total
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookean,
    Pressure,
    Problem,
    Selector,
    Statics,
    StVenantKirchhoff,
    Support,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.solvers.assembly.assembler import Assembler

E, NU = 1e6, 0.3
CORNERS = np.array([[1.0, 1, 0], [3, 1, 0], [1, 3, 0], [1, 1, 1]])


@pytest.mark.parametrize("law", [StVenantKirchhoff, LinearElastic])
def test_nodal_forces_of_a_tetrahedron(comm, law):
    """A third of each face's area vector for each corner: of the deformed faces, but in a linear
    problem of the undeformed ones.  Areas by hand from the corners (1, 1, 0), ...
    """
    body = made(comm, [[0, 1, 2, 3]], CORNERS)
    problem = Problem(body, law(E=E, nu=NU), loads=[Pressure(on="all", value=1.0)], degree=1)
    x = problem.V.tabulate_dof_coordinates()
    corner = np.array([np.linalg.norm(CORNERS - p, axis=1).argmin() for p in x], dtype=int)
    shift = np.array([[0, 0, 0], [0, 0, 0], [0, -1, 0], [0, 0, 0]])
    problem.u.x.array[:] = shift[corner].ravel()
    _, nodal = forces(problem)
    found = np.zeros((4, 3))
    found[corner[: len(nodal)]] = nodal
    found = comm.allreduce(found, op=MPI.SUM)
    deformed = np.array([[1 / 6, 1 / 3, 1 / 3], [-1 / 6, 0, 0], [0, -1 / 3, 0], [0, 0, -1 / 3]])
    at_rest = np.array([[1 / 3, 1 / 3, 2 / 3], [-1 / 3, 0, 0], [0, -1 / 3, 0], [0, 0, -2 / 3]])
    exact = at_rest if law is LinearElastic else deformed
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-15)  # round-off


@pytest.mark.parametrize("degree", [1, 2])
def test_closed_surface_has_no_resultant(comm, degree):
    """Neither force nor moment, however the body is deformed: the divergence theorem."""
    body = name_parts(
        box_body(size=(1, 1, 1), cells=(2, 2, 2), comm=comm), surfaces={"all": Selector(all=True)}
    )
    problem = Problem(
        body,
        StVenantKirchhoff(E=E, nu=NU),
        degree=degree,
        loads=[Pressure(on="all", value="2 kPa")],
    )
    moved(problem, 0.3)
    x, nodal = forces(problem)
    now = x + problem.u.x.array[: x.size].reshape(-1, 3)
    size = total(problem, np.abs(nodal)).max()
    assert size > 100
    assert np.abs(total(problem, nodal)).max() < 1e-13 * size
    assert np.abs(total(problem, np.cross(now, nodal))).max() < 1e-13 * size


# --- when the tangent is symmetric ---


def loaded_cube(on: Any, supports: list[Support], value: Any, degree: int) -> Problem:
    body = name_parts(
        box_body(size=(1, 1, 1), cells=(2, 2, 2)), surfaces={"all": Selector(all=True)}
    )
    law = StVenantKirchhoff(E=E, nu=NU)
    load = Pressure(on=on, value=value)
    return Problem(body, law, degree=degree, supports=supports, loads=[load])


SIDES = ["left", "right", "front", "back"]
ALONG = [
    Support(on=["left", "right"], displacement=[0, FREE, FREE]),
    Support(on=["front", "back"], displacement=[FREE, "0.1*t", FREE]),
]
RIMS = {
    "open rim": ("top", [Support(on="bottom")], "0.1 MPa", False),
    "closed surface": ("all", [Support(on="bottom")], "0.1 MPa", True),
    "uneven": ("all", [Support(on="bottom")], "1e5*x", False),
    "even, growing": ("all", [Support(on="bottom")], "1e5*t", True),
    "rim clamped": ("bottom", [Support(on="bottom")], "0.1 MPa", True),
    "rim slides in its planes": ("top", ALONG, "0.1 MPa", True),
    "rim held in part": ("top", ALONG[:1], "0.1 MPa", False),
    "rim held across": ("top", [Support(on=SIDES, displacement=[FREE, FREE, 0])], "0.1 MPa", True),
    "rim moved out of its planes": (
        "top",
        [Support(on=["left", "right"], displacement=["0.1*y", FREE, FREE]), ALONG[1]],
        "0.1 MPa",
        False,
    ),
    "rim moved, one way only": (
        "top",
        [Support(on=SIDES, displacement=["0.1*y", "0.1*x", FREE])],
        "0.1 MPa",
        True,
    ),
}


def asymmetry(problem: Problem) -> float:
    """|w K v - v K w| over |w K v| for two vectors of all unknowns."""
    assembler = Assembler(problem)
    x, y, out = (assembler.create_vector() for _ in range(3))
    assembler.get(x)
    assembler.tangent.assemble(x)
    for vector, seed in ((x, 2), (y, 3)):
        moved(problem, 0.2, seed)
        assembler.get(vector)
    assembler.tangent.matrix.mult(x, out)
    forth = out.dot(y)
    assembler.tangent.matrix.mult(y, out)
    found = abs(forth - out.dot(x)) / abs(forth)
    for vector in (x, y, out):
        vector.destroy()
    assembler.destroy()
    return found


@pytest.mark.sample(4)
@pytest.mark.parametrize("case", RIMS)
@pytest.mark.parametrize("degree", [1, 2])
def test_symmetric_where_it_says_so(monkeypatch, case, degree):
    """The tangent itself agrees: round-off, or a skew part of the size of the pressure."""
    on, supports, value, symmetric = RIMS[case]
    problem = loaded_cube(on, supports, value, degree)
    assert problem.symmetric == symmetric
    monkeypatch.setattr(Problem, "symmetric", False)  # or PETSc would take it for granted
    problem.set_time(1.0)
    moved(problem, 0.05)
    # At the prescribed values, in or out of the rim's planes.
    held = problem.constraints.dofs
    problem.u.x.array[held] = problem.constraints.values.x.array[held]
    found = asymmetry(problem)
    assert found < 1e-13 if symmetric else found > 1e-6


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("geometry", "on", "supports", "symmetric"),
    [
        ("plane-strain", "top", [Support(on="bottom")], False),
        ("plane-strain", "all", [Support(on="bottom")], True),
        ("plane-strain", "top", [Support(on=["left", "right"], displacement=[0, FREE])], True),
        ("plane-strain", "top", [Support(on=["left", "right"], displacement=["y", FREE])], True),
        ("plane-stress", "all", [Support(on="bottom")], False),
        ("axisymmetric", "top", [Support(on="right", displacement=[FREE, 0])], True),
        ("axisymmetric", "top", [Support(on="bottom")], False),
    ],
)
def test_symmetric_in_a_plane(comm, monkeypatch, geometry, on, supports, symmetric):
    """The rim are two points; one component at each is enough, and the axis holds its own."""
    body = name_parts(
        rectangle_body(size=(1, 1), cells=(3, 3), comm=comm),
        surfaces={"all": Selector(all=True)},
    )
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=supports,
        loads=[Pressure(on=on, value="20 kPa")],
        geometry=geometry,
        degree=1,
    )
    assert problem.symmetric == symmetric
    monkeypatch.setattr(Problem, "symmetric", False)
    problem.set_time(1.0)
    moved(problem, 0.05)
    if geometry == "axisymmetric":  # nothing leaves the axis
        problem.u.x.array[problem.constraints.dofs] = 0.0
    found = asymmetry(problem)
    assert found < 1e-13 if symmetric else found > 1e-6


def test_linear_problem_stays_linear(comm):
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm)
    how: dict[str, Any] = {"supports": [Support(on="bottom")]}
    load = Pressure(on="top", value="1e3*x")
    small = Problem(body, LinearElastic(E=E, nu=NU), loads=[load], degree=1, **how)
    large = Problem(body, StVenantKirchhoff(E=E, nu=NU), loads=[load], degree=1, **how)
    assert (small.linear, small.symmetric, small.loads_change) == (True, True, False)
    assert (large.linear, large.symmetric, large.loads_change) == (False, False, True)


# --- closed forms ---


SYMMETRY = [
    Support(on="x0", displacement=[0, FREE]),
    Support(on="y0", displacement=[FREE, 0]),
]
ANNULUS = {
    "linear-elastic": (0.1906666667, 0.1213333333, None),
    "st-venant-kirchhoff": (0.2126182643, 0.1236369167, 79372.2795),
    "neo-hookean": (0.2583377593, 0.1721350882, 104553.7516),
    "fixed-corotated": (0.2464533341, 0.1604641443, 97569.9218),
}
"""Radial displacements at both radii and energy of the whole ring at 0.1 MPa inside: the ordinary
differential equation of the radius, solved by a spectral method; linear: Lame."""


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ANNULUS)
def test_ring_under_inner_pressure(comm, name):
    """Plane strain, P2 on curved triangles: displacements to 1e-4 on 20x20 squares of them,
    of which the law that softens leaves the most.
    """
    problem = Problem(
        annulus(comm, 20),
        MATERIALS[name](E=E, nu=NU),
        degree=2,
        supports=SYMMETRY,
        loads=[Pressure(on="inside", value="100 kPa")],
    )
    assert problem.symmetric  # the ends of the arc slide on the axes
    state = solved(problem)
    inner, outer, energy = ANNULUS[name]
    assert radial(problem, 1) == pytest.approx(inner, rel=1e-4)
    assert radial(problem, 2) == pytest.approx(outer, rel=1e-4)
    if energy is not None:
        assert 4 * state.energies["strain"] == pytest.approx(energy, rel=1e-4)


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ANNULUS)
def test_tube_under_inner_pressure(comm, name):
    """The same in one dimension more, as a body of revolution: nodal values of P2 to 1e-6."""
    body = rectangle_body(size=(1, 1 / 16), cells=(128, 2), origin=(1, 0), comm=comm)
    problem = Problem(
        body,
        MATERIALS[name](E=E, nu=NU),
        degree=2,
        supports=[Support(on=["bottom", "top"], displacement=[FREE, 0])],
        loads=[Pressure(on="left", value="100 kPa")],
        geometry="axisymmetric",
    )
    assert problem.symmetric
    state = solved(problem)
    inner, outer, energy = ANNULUS[name]
    assert radial(problem, 1) == pytest.approx(inner, rel=1e-6)
    assert radial(problem, 2) == pytest.approx(outer, rel=1e-6)
    if energy is not None:
        assert 16 * state.energies["strain"] == pytest.approx(energy, rel=2e-6)


def test_lame_sphere(comm):
    """A hollow sphere as a body of revolution: u = p a^3/(E (b^3 - a^3)) ((1 - 2 nu) r
    + (1 + nu) b^3/(2 r^2)), Lame; 0.08 at a = 1, b = 2.
    """
    problem = Problem(
        annulus(comm, 20),
        LinearElastic(E=E, nu=NU),
        degree=2,
        supports=[Support(on="y0", displacement=[FREE, 0])],
        loads=[Pressure(on="inside", value="100 kPa")],
        geometry="axisymmetric",
    )
    solved(problem, 1)
    assert radial(problem, 1) == pytest.approx(0.08, rel=1e-4)


def test_incompressible_tube_under_pressure(comm):
    """Displacement and pressure unknown: mu = 1, blown up to 1.5 times its inner radius.

    Closed form of Rivlin (1949), p = 0.428228409097; u(a) is 1e5 times less sure than p is near
    the flattening curve, so 1e-5 as where the displacement is prescribed.
    """
    body = rectangle_body(size=(1, 1 / 16), cells=(32, 2), origin=(1, 0), comm=comm)
    problem = Problem(
        body,
        NeoHookean(mu=1.0, nu=0.5),
        degree=2,
        supports=[Support(on=["bottom", "top"], displacement=[FREE, 0])],
        loads=[Pressure(on="left", value=0.428228409097)],
        geometry="axisymmetric",
    )
    solved(problem)
    assert radial(problem, 1) == pytest.approx(0.5, rel=2e-5)


def test_sheet_drawn_on_its_edges(comm):
    """Plane stress: suction on the edges of current thickness, equibiaxial stretch 1.2.

    Closed form: P11 = 2.339894681426e5 Pa, thickness 0.842587004051 of what it was.
    """
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(2, 2), comm=comm),
        NeoHookean(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Pressure(on=["right", "top"], value=-2.339894681426e5 / (1.2 * 0.842587004051))],
        geometry="plane-stress",
        degree=1,
    )
    *_, _ = Statics(problem, steps=3, rtol=1e-12).steps()
    x = problem.V.tabulate_dof_coordinates()[:, :2]
    off = np.abs(problem.u.x.array.reshape(-1, 2) - 0.2 * x).max(initial=0.0)
    assert comm.allreduce(float(off), op=MPI.MAX) < 1e-10  # the twelve digits of the stress


# --- what is read ---


def test_case_with_pressure(comm):
    """A case file's table, back and forth; formulas in x, y, z and t."""
    case = Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
        materials={"rubber": {"law": "st-venant-kirchhoff", "E": "1 MPa", "nu": 0.3}},
        support=[{"on": "bottom"}],
        load=[
            {"kind": "pressure", "on": "top", "value": "0.3 bar", "curve": "t^2"},
            {"kind": "pressure", "on": "top", "value": "1e3*z*t"},
        ],
    )
    again = Case.from_dict(case.to_dict())
    assert again.to_toml() == case.to_toml()
    assert again.load[0].values == (3e4,)
    problem = case.make_problem(case.read_body(comm))
    problem.set_time(0.5)
    _, nodal = forces(problem)
    assert total(problem, nodal)[2] == pytest.approx(-(3e4 * 0.25 + 500), rel=1e-13)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"on": "top", "value": [1, 2, 3]}, "value: [1, 2, 3] is not a number"),
        ({"on": "top", "value": "3 mm"}, "value: '3 mm' has the wrong unit"),
        ({"on": "top"}, "value: this key is missing"),
        ({"value": 1}, "on: this key is missing"),
        ({"on": "top", "value": "q*x"}, "q"),
    ],
)
def test_what_is_no_pressure(wrong, says):
    with pytest.raises(InputError) as caught:
        Pressure(**wrong)
    assert says in str(caught.value)
