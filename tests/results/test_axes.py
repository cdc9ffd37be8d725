"""Components in local axes: against rotation by hand, Lame's tube, and laws with fibres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.annulus import FREE, annulus, solved
from helpers.runs import history
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    CylindricalAxes,
    Guccione,
    HolzapfelGasserOgden,
    LinearElastic,
    NeoHookean,
    Orthotropic,
    Pressure,
    Probe,
    Problem,
    RectangularAxes,
    Support,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS, check_field_names
from dolfin_elastic.results.finished.run import column_unit
from dolfin_elastic.results.quantity import Quantity

COMM = MPI.COMM_WORLD
AXIS, POINT = np.array([1.0, 2.0, 2.0]) / 3, np.array([-0.3, 0.2, -0.1])
AXES = {
    "bore": CylindricalAxes(axis=tuple(AXIS), point=tuple(POINT)),
    "plate": RectangularAxes(x=(1, 1, 0), y=(-1, 1, 1)),
}
TRIADS = {"bore": "rtz", "plate": "xyz"}
NODES = ("displacement", "reaction", "normal", "cauchy_stress")
CELLS = ("cauchy_stress_cell", "first_piola", "green_strain", "log_strain", "fibre")


def at(rows: Any) -> float:
    return largest(COMM, float(np.abs(rows).max(initial=0.0)))


def state_of(problem: Problem, u: Any) -> State:
    function = fem.Function(problem.V)
    function.interpolate(u)
    return State(1, 1.0, function)


def bent(x: Any) -> Any:
    return np.array([0.2 * x[0] * x[1], -0.1 * x[1] + 0.3 * x[2] ** 2, 0.1 * x[0] + 0.2 * x[2]])


def triad(axes: str, X: Any) -> Any:
    """Unit vectors by the definition of each kind, shape (n, 3, 3), one a row."""
    if axes == "plate":
        x, y = np.array([1, 1, 0]) / np.sqrt(2), np.array([-1, 1, 1]) / np.sqrt(3)
        return np.broadcast_to([x, y, np.cross(x, y)], (len(X), 3, 3))
    r = (X - POINT) - ((X - POINT) @ AXIS)[:, None] * AXIS
    r /= np.linalg.norm(r, axis=1)[:, None]
    return np.stack([r, np.cross(AXIS, r), np.broadcast_to(AXIS, r.shape)], axis=1)


def barycentres(problem: Problem) -> Any:
    mesh = problem.body.mesh
    own = mesh.topology.index_map(mesh.topology.dim).size_local
    return mesh.geometry.x[mesh.geometry.dofmap[:own]].mean(axis=1)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_rotation_by_hand(degree: int) -> None:
    """Q sigma Q^T and Q u with Q by the definition of the axes: to round-off of the largest."""
    law = Guccione(**Guccione.example) if degree == 1 else NeoHookean(E=1e5, nu=0.3)
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, law, degree=degree, supports=[Support(on="left")], axes=AXES)
    some = {"rtz": ("rr", "rt", "tr", "zz"), "xyz": ("xx", "zy")}
    letters = {
        (name, axes): [*row] if FIELDS[name].shape == "vector" else some[row]
        for name in (*NODES, *CELLS)
        if degree == 1 or name != "fibre"
        for axes, row in TRIADS.items()
    }
    names = [f"{n}_{end}_in_{axes}" for (n, axes), ends in letters.items() for end in ends]
    rows = Evaluator(problem, [*NODES, *CELLS, *names])(state_of(problem, bent))
    for (name, axes), ends in letters.items():
        whole = rows[name]
        places = problem.places[: len(whole)] if name in NODES else barycentres(problem)
        Q = triad(axes, places)
        if FIELDS[name].shape == "vector":
            expected = np.einsum("nia,na->ni", Q, whole)
        else:
            tensors = np.einsum("nia,nab,njb->nij", Q, whole.reshape(-1, 3, 3), Q)
            pairs = [[TRIADS[axes].index(letter) for letter in end] for end in ends]
            expected = np.column_stack([tensors[:, i, j] for i, j in pairs])
        found = np.column_stack([rows[f"{name}_{end}_in_{axes}"] for end in ends])
        assert at(found - expected) < 1e-13 * at(whole), (name, axes)


def test_on_the_axis_the_angle_is_zero() -> None:
    """There r and t are those of the coordinate axis most normal to the axis, with round-off, too.

    The field at nodes and the formula inside cells agree: a triangle has its barycentre there.
    """
    middle = CylindricalAxes(axis="z", point=(1 / 3, 1 / 3))
    body = rectangle_body(size=(1, 1), cells=(1, 1))
    problem = Problem(body, NeoHookean(E=1.0, nu=0.3), degree=1, axes={"hole": middle})
    axes = problem.axes["hole"]
    near = np.array([[1 / 3, 1 / 3], [1 / 3 - 1e-14, 1 / 3 + 1e-15]])
    assert np.array_equal(axes.at(near), [np.eye(3)] * 2)
    names = [f"first_piola_{end}_in_hole" for end in ("rr", "rt", "tr", "tt")]
    rows = Evaluator(problem, ["first_piola", *names])(
        state_of(problem, lambda x: 0.1 * x[:2] ** 2)
    )
    Q = axes.at(barycentres(problem)[:, :2])
    P = np.einsum("nia,nab,njb->nij", Q, rows["first_piola"].reshape(-1, 3, 3), Q)
    found = np.column_stack([rows[name] for name in names])
    assert at(found - P[:, :2, :2].reshape(-1, 4)) < 1e-15
    along_x = CylindricalAxes(axis="x").placed(1.0, 3)
    assert np.allclose(along_x.at(np.zeros((1, 3)))[0], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])


A, B, PRESSURE, E, NU = 1.0, 2.0, 1e5, 1e9, 0.3
C = PRESSURE * A**2 / (B**2 - A**2)
LAME = {
    "cauchy_stress_rr_in_bore": lambda r: C * (1 - B**2 / r**2),
    "cauchy_stress_tt_in_bore": lambda r: C * (1 + B**2 / r**2),
    "cauchy_stress_zz_in_bore": lambda r: 2 * NU * C + 0 * r,
    "cauchy_stress_rt_in_bore": lambda r: 0 * r,
    "displacement_r_in_bore": lambda r: (1 + NU) / E * C * ((1 - 2 * NU) * r + B**2 / r),
    "displacement_t_in_bore": lambda r: 0 * r,
}
"""A thick tube under inner pressure in plane strain (Timoshenko and Goodier, Theory of Elasticity
(1970), section 28)."""


def tube(kind: str, n: int) -> Problem:
    law, load = LinearElastic(E=E, nu=NU), {"value": PRESSURE}
    if kind == "plane":
        held = [Support(on="x0", displacement=[0, FREE]), Support(on="y0", displacement=[FREE, 0])]
        return Problem(
            annulus(COMM, n),
            law,
            supports=held,
            loads=[Pressure(on="inside", **load)],
            axes={"bore": CylindricalAxes()},
        )
    return Problem(
        rectangle_body(size=(1, 1 / 4), cells=(n, 2), origin=(1, 0)),
        law,
        supports=[Support(on=["bottom", "top"], displacement=[FREE, 0])],
        loads=[Pressure(on="left", **load)],
        geometry="axisymmetric",
        axes={"bore": CylindricalAxes(axis="y")},
    )


@pytest.mark.parametrize("kind", ["plane", "axisymmetric"])
def test_thick_tube(kind: str) -> None:
    """Nodes on curved triangles, and of a body of revolution about y, against Lame.

    Recovered stress at the surface converges with h^2: to 0.6 % of the pressure with 16 cells
    across the wall, and at least 2.9 times better than with 8.  Displacements to 1e-4.
    """
    errors = {}
    for n in (8, 16):
        problem = tube(kind, n)
        state = solved(problem, 1)
        rows = Evaluator(problem, LAME)(state)
        X = problem.places[: len(rows["displacement_r_in_bore"])]
        r = np.hypot(X[:, 0], X[:, 1]) if kind == "plane" else X[:, 0]
        errors[n] = {name: at(rows[name][:, 0] - exact(r)) for name, exact in LAME.items()}
    for name in LAME:
        if name.startswith("cauchy"):
            assert errors[16][name] < 0.006 * PRESSURE
            assert errors[16][name] <= errors[8][name] / 2.9
        else:
            assert errors[16][name] < 1e-4 * LAME["displacement_r_in_bore"](A)
    inside = "inside" if kind == "plane" else "left"
    mean = Quantity("displacement_r_in_bore", inside, "mean").on(problem).of(state).value
    assert mean == pytest.approx(LAME["displacement_r_in_bore"](A), rel=1e-4)
    # Stress at the quadrature points of the surface: of one order less than recovered stress.
    mean = Quantity("cauchy_stress_rr_in_bore", inside, "mean").on(problem).of(state).value
    assert mean == pytest.approx(-PRESSURE, rel=0.005)
    place = (1.5 * np.cos(0.5), 1.5 * np.sin(0.5)) if kind == "plane" else (1.5, 0.1)
    found = Probe(problem, {"p": place}, [*LAME, "cauchy_stress_cell_tt_in_bore"])(state)
    for name, exact in LAME.items():
        assert found[f"p_{name}"] == pytest.approx(
            exact(1.5), rel=1e-3, abs=1e-4 * (PRESSURE if "stress" in name else C / E)
        )
    assert found["p_cauchy_stress_cell_tt_in_bore"] == pytest.approx(C * (1 + B**2 / 1.5**2), 2e-3)


def test_bar_along_and_across_its_fibres() -> None:
    """Tension s of a bar whose fibres are at an angle a in its plane: s cos^2, s sin^2, -s sin cos.

    Strains in these axes are the compliances times them (Jones, Mechanics of Composite Materials
    (1999), section 2.6), which gives the displacement; law and axes to round-off.
    """
    a, s = 0.4, 1e6
    keys = {**Orthotropic.example, "E1": 10e9, "E2": 1e9, "E3": 0.8e9, "G12": 0.7e9}
    law = Orthotropic(
        **{**keys, "axis1": [np.cos(a), np.sin(a), 0], "axis2": [-np.sin(a), np.cos(a), 0]}
    )
    stress = {
        "11": s * np.cos(a) ** 2,
        "22": s * np.sin(a) ** 2,
        "12": -s * np.sin(a) * np.cos(a),
        "33": 0.0,
    }
    e11 = stress["11"] / law.E1 - law.nu12 / law.E1 * stress["22"]
    e22 = stress["22"] / law.E2 - law.nu12 / law.E1 * stress["11"]
    e33 = -law.nu13 / law.E1 * stress["11"] - law.nu23 / law.E2 * stress["22"]
    e12 = stress["12"] / (2 * law.G12)
    Q = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
    strain = Q.T @ np.array([[e11, e12, 0], [e12, e22, 0], [0, 0, e33]]) @ Q
    problem = Problem(box_body(size=(2, 1, 1), cells=(2, 1, 1)), law, degree=1)
    state = state_of(problem, lambda x: strain @ x)
    expected = {f"cauchy_stress_{end}_in_material": v for end, v in stress.items()}
    expected |= {f"green_strain_{end}_in_material": v for end, v in (("11", e11), ("12", e12))}
    rows = Evaluator(problem, [*expected, "cauchy_stress"])(state)
    for name, value in expected.items():
        scale = s if "stress" in name else e22
        assert at(rows[name] - value) < 1e-12 * scale, name
    assert np.allclose(rows["cauchy_stress"][:, 0], s, rtol=1e-12)  # tension along x
    most = Quantity("cauchy_stress_11_in_material").on(problem).of(state)
    assert most.value == pytest.approx(stress["11"], rel=1e-12) and most.part == "body"


FIBRES = {
    "guccione": Guccione(**Guccione.example),
    "holzapfel-gasser-ogden": HolzapfelGasserOgden(**HolzapfelGasserOgden.example),
}


@pytest.mark.parametrize("name", FIBRES)
def test_axes_of_the_material_at_finite_strain(name: str) -> None:
    """By hand in the deformed body; and a rotation of the whole changes nothing.

    Guccione has one direction: axis 2 is nearest to z, which is most normal to it.
    """
    law = FIBRES[name]
    F = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.05, 0.0, 1.05]])
    c, s = np.cos(2.0), np.sin(2.0)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    problem = Problem(box_body(size=(1, 1, 1), cells=(1, 1, 1)), law, degree=1)
    fields = ("cauchy_stress_cell", "second_piola", "first_piola")
    ends = ["11", "31"]
    names = [f"{n}_{end}_in_material" for n in fields for end in ends]
    evaluate = Evaluator(problem, [*fields, *names])
    rows = evaluate(state_of(problem, lambda x: (F - np.eye(3)) @ x))
    turned = evaluate(state_of(problem, lambda x: (R @ F - np.eye(3)) @ x))

    def normed(first: Any, towards: Any) -> Any:
        e = first / np.linalg.norm(first)
        f = towards - (towards @ e) * e
        f /= np.linalg.norm(f)
        return np.array([e, f, np.cross(e, f)])

    second = getattr(law, "fibre2", None)
    reference = normed(np.array(law.fibre), np.array([0, 0, 1.0] if second is None else second))
    current = normed(F @ reference[0], F @ reference[1])
    # The third axis is normal to the deformed plane of the first two: along cof F e_3.
    nanson = np.linalg.inv(F).T @ reference[2]
    assert np.allclose(current[2], nanson / np.linalg.norm(nanson), atol=1e-14)
    legs = {"cauchy_stress_cell": (current, current), "second_piola": (reference, reference)}
    for field in fields:
        left, right = legs.get(field, (current, reference))
        expected = (left @ rows[field][:1].reshape(-1, 3, 3) @ right.T).reshape(-1, 9)
        found = np.column_stack([rows[f"{field}_{end}_in_material"] for end in ends])
        if len(found):
            chosen = expected[:, [0, 6]]
            assert np.allclose(found, chosen, rtol=0, atol=1e-12 * at_rows(found))
            again = np.column_stack([turned[f"{field}_{end}_in_material"] for end in ends])
            assert np.allclose(again, found, rtol=0, atol=1e-11 * at_rows(found))


def at_rows(rows: Any) -> float:
    return float(np.abs(rows).max())


def bar(**more: Any) -> dict[str, Any]:
    """A bar of wood, pulled."""
    keys = dict.fromkeys(("E2", "E3", "G12", "G13", "G23"), "1 GPa")
    wood = {"law": "orthotropic", "E1": "10 GPa", **keys, "nu12": 0.3, "nu13": 0.3, "nu23": 0.3}
    return {
        "mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}, "degree": 1},
        "materials": {"wood": wood},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": ["1 MPa", 0, 0]}],
        "axes": {
            "bore": {"kind": "cylindrical", "axis": "x", "point": [0, 0.5, 0.5]},
            "plate": {"kind": "rectangular", "x": [1, 1, 0], "y": [-1, 1, 0]},
        },
        **more,
    }


@pytest.mark.long
def test_a_case(folder: Path) -> None:
    """Fields, probes, tables and units of a run, and the case as text."""
    names = ["cauchy_stress_rr_in_bore", "cauchy_stress_11_in_material"]
    output = {
        "fields": ["displacement", *names],
        "formats": ["xdmf", "csv"],
        "probes": {
            "tip": {"at": [2, 0.5, 0.9], "fields": ["displacement_r_in_bore", *names]},
            "end": {"on": "right", "fields": names, "values": ["max", "mean"]},
        },
    }
    made = Case.from_dict(bar(output=output))
    assert Case.from_dict(made.to_dict()) == made
    check(made, made.read_body(COMM))
    for _ in run(made, output=folder):
        pass
    row = history(folder)[-1]
    assert row["tip_displacement_r_in_bore"] < 0  # it contracts
    assert row["end_cauchy_stress_11_in_material_mean"] == pytest.approx(1e6, rel=0.02)
    for column in ("tip_cauchy_stress_rr_in_bore", "end_cauchy_stress_11_in_material_max"):
        assert column_unit(column, timed=False) == "Pa"
    assert column_unit("tip_displacement_r_in_bore", timed=False) == "m"
    heads = [next(file.open()).strip() for file in sorted((folder / "results_csv").glob("*.csv"))]
    assert sum(f",{name}" in head for name in names for head in heads) >= len(names)


WRONG = {
    "unknown axes": ({}, "cauchy_stress_rr_in_bora", "no axes 'bora'", "bore"),
    "a direction they have not": (
        {},
        "cauchy_stress_xx_in_bore",
        "the axes 'bore' are r, t, z",
        "cauchy_stress_rr_in_bore",
    ),
    "an isotropic law": (
        {"materials": {"steel": {"law": "linear-elastic", "E": "1 GPa", "nu": 0.3}}},
        "cauchy_stress_11_in_material",
        "no material has a first direction",
        "fibres",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_fields_of_a_case(name: str) -> None:
    """`check` names the key; a problem in Python says the same."""
    tables, field, what, expected = WRONG[name]
    made = Case.from_dict(bar(output={"fields": ["displacement", field]}, **tables))
    body = made.read_body(COMM)
    with pytest.raises(InputError) as error:
        check(made, body)
    assert error.value.where == "output.fields[1]"
    assert what in str(error.value) and expected in error.value.expected
    if "axes" in name or "direction" in name:
        with pytest.raises(InputError, match=what):
            Evaluator(made.make_problem(body), [field])
        with pytest.raises(InputError, match=what):
            Quantity(field, "right", "mean").on(made.make_problem(body))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("cauchy_stress_rq_in_bore", "'cauchy_stress_"),
        ("cauchy_stress_r_in_bore", "'cauchy_stress_"),
        ("cauchy_stress_rx_in_bore", "'cauchy_stress_"),
        ("displacement_rr_in_bore", "displacement_r_in_bore"),
        ("cauchy_stress_rr_in_material", "_in_material"),
        ("displacement_1_in_material", "_in_material"),
        ("von_mises_rr_in_bore", "_in_bore"),
        ("principal_stresses_r_in_bore", "_in_bore"),
    ],
)
def test_names_of_no_field(name: str, expected: str) -> None:
    """Scalars and principal values have no components, nodes no axes of a material."""
    with pytest.raises(InputError, match="no field") as error:
        check_field_names([name], rectangle_body(size=[1, 1], cells=[1, 1]))
    assert expected in error.value.expected
    with pytest.raises(InputError, match="no field"):
        Quantity(name)


BAD: dict[str, tuple[dict[str, Any], str, str]] = {
    "zero axis": ({"kind": "cylindrical", "axis": [0, 0, 0]}, "axes.a.axis", "zero"),
    "short point": ({"kind": "cylindrical", "point": [0, 0]}, "axes.a.point", "2 components"),
    "askew": (
        {"kind": "rectangular", "x": [1, 0, 0], "y": [1, 1, 0]},
        "axes.a.y",
        "at 45 degrees",
    ),
    "no y": ({"kind": "rectangular", "x": [1, 0, 0]}, "axes.a.y", "missing"),
    "no kind": ({"x": [1, 0, 0]}, "axes.a.kind", "missing"),
    "unknown kind": ({"kind": "spherical"}, "axes.a.kind", "unknown kind"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_axes(name: str) -> None:
    """One error that names the key, on every rank."""
    table, where, what = BAD[name]
    with pytest.raises(InputError, match=what) as error:
        made = Case.from_dict(bar(axes={"a": table}))
        check(made, made.read_body(COMM))
    assert error.value.where == where


@pytest.mark.parametrize("name", ["material", "in_in_out", "a b", "", "ü"])
def test_names_that_axes_cannot_have(name: str) -> None:
    """In a case and in Python."""
    axes = {"kind": "cylindrical"}
    with pytest.raises(InputError, match="axes cannot be called"):
        Case.from_dict(bar(axes={name: axes}))
    with pytest.raises(InputError, match="axes cannot be called"):
        body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
        Problem(body, NeoHookean(E=1.0, nu=0.3), axes={name: CylindricalAxes()})


def test_axes_in_two_dimensions() -> None:
    """Cylindrical ones about z, of a body of revolution about its axis too."""
    about_y = CylindricalAxes(axis="y")
    for kind, one, expected in (
        (False, about_y, '"z"'),
        (True, CylindricalAxes(axis="x"), '"y" with'),
        (True, CylindricalAxes(axis="y", point=(1.0, 0.0)), '"y" with'),
        (False, RectangularAxes(x=(1, 0, 0), y=(0, 0, 1)), "two components"),
    ):
        with pytest.raises(InputError, match="plane of the body") as error:
            one.placed(1.0, 2, axisymmetric=kind)
        assert expected in error.value.expected
    hoop = about_y.placed(1.0, 2, axisymmetric=True).at(np.array([[2.0, 1.0], [0.0, 1.0]]))
    assert np.array_equal(hoop, [[[1, 0, 0], [0, 0, -1], [0, 1, 0]]] * 2)
