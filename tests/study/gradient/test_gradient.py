"""Gradients by adjoints against central differences of solutions, and Taylor's remainder."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.bodies import soft_and_hard
from helpers.stacked import stacked
from matplotlib.figure import Figure
from mpi4py import MPI

from dolfin_elastic import (
    Cavity,
    Contact,
    Energy,
    Fixed,
    Force,
    LinearElastic,
    MooneyRivlin,
    NeoHookean,
    Pressure,
    Problem,
    Spring,
    Statics,
    StVenantKirchhoff,
    Support,
    Tie,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.study.gradient.gradient import Asked, Gradients, gradient, gradients_of
from dolfin_elastic.study.gradient.modes import with_one_more
from dolfin_elastic.study.gradient.parameters import Equilibrium, parameters
from dolfin_elastic.study.gradient.table import draw_bars
from dolfin_elastic.study.gradient.written import largest_values

COMM = MPI.COMM_WORLD
STEP = 1e-3
BEND, PULL = [0.0, 0.0, -2e4], [2e4, 0.0, 0.0]


def box(**more: Any) -> Any:
    return box_body(size=(2, 1, 1), cells=(4, 2, 2), **more)


def fung(F: Any, mu: Any, b: Any) -> Any:
    """An exponential energy in Python."""
    C = F.T * F
    return mu / (2 * b) * (ufl.exp(b * (ufl.tr(C) - 3 - 2 * ufl.ln(ufl.det(F)))) - 1)


def held(law: Any, **more: Any) -> Problem:
    given = {"loads": [Traction(on="right", value=BEND)], "degree": 1, **more}
    return Problem(box(), law, supports=[Fixed(on="left")], **given)


def inflated() -> Problem:
    """A quarter of a tube around a given volume: the pressure is an unknown beside the fields."""
    body = rectangle_body(size=(1, 1), cells=(3, 6))
    radius, angle = 1 + body.mesh.geometry.x[:, 0], np.pi / 2 * body.mesh.geometry.x[:, 1]
    body.mesh.geometry.x[:, 0] = radius * np.cos(angle)
    body.mesh.geometry.x[:, 1] = radius * np.sin(angle)
    symmetry = [
        Support(on="bottom", displacement=["free", 0]),
        Support(on="top", displacement=[0, "free"]),
    ]
    air = Cavity(on="left", volume_ratio=1.3, name="air")
    return Problem(body, NeoHookean(E=1e6, nu=0.3), supports=symmetry, loads=[air], degree=1)


def tied() -> Problem:
    return Problem(
        stacked(size=(1.0, 0.6), lower=(4, 3), upper=(5, 3)),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Fixed(on="bottom")],
        loads=[Traction(on="top", value=[5e4, 0.0])],
        ties=[Tie(on="above", to="below")],
        degree=1,
    )


def pressed(degree: int) -> Problem:
    """A block on a floor, without friction."""
    return Problem(
        box(),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="left", displacement=[0, 0, "free"]), Fixed(on="right")],
        loads=[Pressure(on="top", value=2e4)],
        contacts=[
            Contact(
                on="bottom",
                plane={"point": [0, 0, -0.01], "normal": [0, 0, 1]},
                gap_tolerance=1e-10,
            )
        ],
        degree=degree,
    )


@dataclass(frozen=True)
class Kind:
    make: Callable[[], Problem]
    of: tuple[str, ...]
    by: tuple[str, ...] = ("E",)
    tolerance: float = 1e-8
    more: dict[str, Any] = field(default_factory=dict)


FORCE = ("mean displacement_z on right", "strain_energy", "reaction_z of left")
KINDS = {
    "linear": Kind(
        lambda: held(LinearElastic(E=1e6, nu=0.3)),
        ("displacement_z of tip", "norm:8 von_mises", "mean pressure on top"),
        ("E", "nu"),
    ),
    "st-venant-kirchhoff": Kind(lambda: held(StVenantKirchhoff(E=1e6, nu=0.3)), FORCE),
    "neo-hookean": Kind(
        lambda: held(NeoHookean(E=1e6, nu=0.3), degree=2),
        ("mean displacement on right", "norm:8 von_mises on right", "integral energy_density"),
        ("E", "nu"),
    ),
    "mooney-rivlin": Kind(lambda: held(MooneyRivlin(c10=1e5, c01=5e4, K=1e6)), FORCE, ("c10", "K")),
    "energy of one's own": Kind(
        lambda: held(Energy(fung, mu=4e5, b=0.7)), FORCE[:2], ("parameters.mu", "parameters.b")
    ),
    "incompressible": Kind(
        lambda: held(NeoHookean(mu=3e5, nu=0.5), degree=2, loads=[Pressure(on="top", value=1e4)]),
        ("mean displacement_z on right", "strain_energy", "norm:8 von_mises"),
        ("mu",),
    ),
    "follower pressure": Kind(
        lambda: held(NeoHookean(E=1e6, nu=0.3), loads=[Pressure(on="top", value=1e4)]), FORCE
    ),
    "tie": Kind(tied, ("mean displacement_x on top", "strain_energy")),
    "cavity": Kind(
        inflated,
        ("mean displacement on right", "strain_energy", "reaction_y of bottom"),
        ("E", "nu"),
    ),
    "contact": Kind(lambda: pressed(1), ("mean displacement_z on top", "strain_energy")),
    "contact of quadratic faces": Kind(
        lambda: pressed(2), ("mean displacement_z on top", "strain_energy")
    ),
    "spring": Kind(
        lambda: Problem(
            box(),
            NeoHookean(E=1e6, nu=0.3),
            supports=[Spring(on="left", normal=1e6, tangential=1e6)],
            loads=[Traction(on="right", value=PULL)],
            degree=1,
        ),
        FORCE[:2],
    ),
}


def solved(problem: Problem, asked: Asked, found: list[Any], *, gradients: bool) -> None:
    """Appends the gradients, or the numbers alone, of the last state."""
    solver, probes = Statics(problem, rtol=1e-12), {"tip": [2.0, 0.4, 0.3][: problem.body.dim]}
    every = Gradients(asked, problem, None, probes)

    def look(newton: Any, state: Any) -> None:
        if state.done < 1.0:
            return
        if gradients:
            found.extend(every.at(newton, state))
        else:
            found.append(
                Equilibrium(newton, every._numbers_of, every._functionals, state.t)
                .evaluated()
                .numbers
            )

    solver.observer = look
    for _ in solver.steps():
        pass


def numbers(kind: Kind, key: str, factor: float) -> np.ndarray:
    """Of the solution with another value of a constant."""
    problem, found = kind.make(), []
    problem.parameters[key].value = float(problem.parameters[key].value) * factor
    solved(problem, Asked(kind.of), found, gradients=False)
    return np.array(found[-1])


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_constants(name: str) -> None:
    """Central differences of fourth order of solutions, whose errors are 1e-9 of the numbers.

    Taylor's remainder of a step h falls like h^2: the slope is 2, to what the next term leaves.
    """
    kind, found = KINDS[name], list[Any]()
    keys = [f"materials.body.{one}" for one in kind.by]
    solved(kind.make(), Asked(kind.of, keys, keys[:1]), found, gradients=True)
    here = np.array([one.value for one in found])
    for number, key in enumerate(keys):
        values = {k: numbers(kind, key, 1 + k * STEP) for k in (-2, -1, 1, 2)}
        slopes = (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * STEP)
        told = np.array([one.by[number].at * one.by[number].value for one in found])
        np.testing.assert_allclose(
            told, slopes, atol=kind.tolerance * np.abs(here).max(), rtol=1e-6
        )
        np.testing.assert_allclose(told / here, slopes / here, atol=20 * kind.tolerance)
        remainders = [np.abs(values[k] - here - k * STEP * told) / np.abs(here) for k in (1, 2)]
        for small, large in zip(*remainders, strict=True):
            assert large < 1e-9 or np.log2(large / small) == pytest.approx(2.0, abs=0.05)
    for one in found:  # all cells together are the constant
        whole = total(COMM, float(one.cells[keys[0]].sum()))
        assert whole == pytest.approx(
            one.by[0].at * one.by[0].value, rel=1e-7, abs=1e-9 * abs(one.value)
        )


# --- loads, supports and the shape ---

TABLES: dict[str, Any] = {
    "mesh": {"box": {"size": [2, 1, 1], "cells": [4, 2, 2]}, "degree": 1},
    "materials": {"gel": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": 1000}},
    "support": [{"on": "left"}, {"on": "right", "displacement": ["free", "free", "5 cm"]}],
    "load": [
        {"on": "top", "kind": "pressure", "value": "20 kPa"},
        {"on": "right", "kind": "traction", "value": ["10 kPa", 0, 0]},
        {"kind": "gravity", "value": [0, 0, -9.81]},
    ],
    "statics": {"rtol": 1e-12},
}
KEYS = {
    "load[0].value": (20.0, "kPa"),
    "load[1].value[1]": (0.0, "Pa"),
    "support[1].displacement[2]": (5.0, "cm"),
    "materials.gel.density": (1000.0, "kg/m^3"),
}


@pytest.mark.long
@pytest.mark.parametrize("key", KEYS)
def test_other_keys_of_a_case(key: str) -> None:
    """The problem is made anew with them; supports move what they prescribe."""
    case, (value, unit) = Case.from_dict(TABLES), KEYS[key]
    of = ["mean displacement_x on top", "strain_energy", "reaction_z of left"]
    here = gradient(case, of, [key])
    (step,) = {one.by[0].at * STEP or 10.0 for one in here.gradients}

    def at(k: int) -> np.ndarray:
        text = value + k * step
        changed = case.changed({key: f"{text!r} {unit}" if unit else text})
        return np.array([one.value for one in gradient(changed, of).gradients])

    slopes = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)
    told = np.array([one.by[0].value for one in here.gradients])
    np.testing.assert_allclose(told, slopes, rtol=1e-6)


BARE = {
    "materials.gel.E": "Pa",
    "materials.gel.nu": "",
    "materials.gel.density": "kg/m^3",
    "support[1].displacement[0]": "m",
    "support[2].angle": "rad",
    "support[3].stiffness[1]": "N/m^3",
    "load[0].value": "Pa",
    "load[1].value[2]": "m/s^2",
    "load[2].force[0]": "N",
    "load[2].moment[1]": "N*m",
    "load[3].value": "1/s",
    "contact[0].sphere.radius": "mm",
    "contact[0].sphere.center[1]": "mm",
    "contact[0].motion[1]": "m",
    "contact[0].stiffness": "N/m^3",
    "contact[1].cone.half_angle": "deg",
    "contact[1].gap_tolerance": "mm",
}


def test_numbers_without_a_unit_have_that_of_the_case() -> None:
    """SI, but for lengths and angles beside a mesh."""
    ball = {"radius": 300.0, "center": [500.0, -300.0, 1.0]}
    cone = {"tip": [500.0, -1.0, 0.0], "axis": [0, -1, 0], "half_angle": 1.25}
    tables: dict[str, Any] = {
        "mesh": {"box": {"size": [1000, 1000, 1000], "cells": [1, 1, 1]}, "unit": "mm"},
        "materials": {"gel": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1e3}},
        "support": [
            {"on": "left"},
            {"on": "right", "displacement": [0.001, 0, 0]},
            {"on": "top", "kind": "rotation", "point": [0, 0, 0], "axis": "x", "angle": 0.1},
            {"on": "back", "kind": "spring", "stiffness": [0, 1e5, 0]},
        ],
        "load": [
            {"on": "front", "kind": "pressure", "value": 2e4},
            {"kind": "gravity", "value": [0, 0, -9.81]},
            {"on": "front", "kind": "remote-force", "force": [1.0, 0, 0]},
            {"kind": "centrifugal", "value": 3.0, "axis": "x"},
        ],
        "contact": [
            {"on": "bottom", "sphere": ball, "motion": [0.0, 1e-4, 0.0], "stiffness": 1e12},
            {"on": "bottom", "cone": cone, "gap_tolerance": 0.1},
        ],
        "statics": {},
    }
    tables["load"][2]["moment"] = [0.0, 5.0, 0.0]
    case = Case.from_dict(tables)
    problem = Case.from_dict({**tables, "contact": []}).make_problem(case.read_body())
    found = {one.key: one for one in parameters([*BARE], problem, case)}
    assert {key: one.unit for key, one in found.items()} == BARE
    assert found["materials.gel.nu"].room == pytest.approx(0.2)
    assert math.isinf(found["materials.gel.E"].room)


SIDES = {"on": ["left", "right", "front", "back"], "displacement": [0, 0, "free"]}
PLATE = {"on": "top", "kind": "rigid", "rotation": [0, 0, 0]}
SHEARED = [
    {"on": "bottom"},
    {"on": "top", "displacement": ["20 cm", 0, 0]},
    {"on": ["front", "back"], "displacement": ["free", 0, 0]},
    {"on": ["left", "right"], "displacement": ["0.2*z*t", 0, 0]},
]
TURNED = {
    "on": "right",
    "kind": "rigid",
    "displacement": ["free", "free", "free"],
    "rotation": [0, 0, "free"],
    "force": ["1 kN", "2 kN", 0],
}
PLATED = [SIDES, {"on": "bottom"}]
BESIDE: dict[str, tuple[list[Any], float, str]] = {
    "rigid surface under a force": ([{"on": "left"}, TURNED], 0.3, "support[1].force[1]"),
    "bolt": (
        [{"on": "left"}, {"on": "right", "displacement": [0, "free", "free"]}],
        0.3,
        "load[1].value",
    ),
    "enclosed": (SHEARED, 0.5, "load[0].value[2]"),
    "enclosed under a plate": (
        [*PLATED, {**PLATE, "displacement": [0, 0, "free"], "force": [0, 0, "-10 kN"]}],
        0.5,
        "support[2].force[2]",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", BESIDE)
def test_unknowns_that_prescribe_or_are_prescribed(name: str) -> None:
    """Motions of rigid surfaces, and pressures that are known up to a constant.

    The differences are of second order, the steps a thousandth.
    """
    supports, nu, key = BESIDE[name]
    loads = [{"on": "gel", "kind": "bolt", "axis": "x", "value": "2 kN"}] * (name == "bolt")
    degree = 1 if nu < 0.5 else 2
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [2, 1, 1], "cells": [2, 2, 2]}, "degree": degree},
            "materials": {"gel": {"law": "neo-hookean", "mu": 3e5, "nu": nu, "density": 1000}},
            "support": supports,
            "load": [{"kind": "gravity", "value": [3, 0, -9.81]}, *loads],
            "statics": {"rtol": 1e-12},
        }
    )
    held = "left" if nu < 0.5 else "bottom"
    of = ["mean pressure on right", f"reaction_z of {held}", "strain_energy"]
    found = gradient(case, of, [key]).gradients
    number, unit = found[0].by[0].at, found[0].by[0].unit
    sides = [
        np.array([o.value for o in gradient(case.changed({key: text}), of).gradients])
        for k in (1 + STEP, 1 - STEP)
        for text in [f"{k * number!r} {unit}".strip()]
    ]
    here = np.array([one.value for one in found])
    told = np.array([one.by[0].at * one.by[0].value for one in found])
    slopes = (sides[0] - sides[1]) / (2 * STEP)
    np.testing.assert_allclose(told, slopes, rtol=1e-5, atol=1e-8 * np.abs(here).max())


@pytest.mark.long
def test_numbers_that_depend_on_loads() -> None:
    """Growth is part of the elastic strain: energy and stress change with it at rest, too."""
    tables = {
        **TABLES,
        "materials": {"gel": {**TABLES["materials"]["gel"], "expansion": 1e-3}},
        "load": [{"kind": "thermal", "value": "20 K"}],
    }
    case, of = Case.from_dict(tables), ["strain_energy", "mean von_mises", "reaction_z of left"]
    told = [one.by[0].value for one in gradient(case, of, ["load[0].value"]).gradients]
    sides = [
        np.array([one.value for one in gradient(case.changed({"load[0].value": v}), of).gradients])
        for v in ("20.02 K", "19.98 K")
    ]
    np.testing.assert_allclose(told, (sides[0] - sides[1]) / 0.04, rtol=1e-5)  # of second order


SHAPES = {
    "force": ({"on": "right", "kind": "force", "value": [0, 0, "-20 kN"]}, 1),
    "pressure": ({"on": "top", "kind": "pressure", "value": "10 kPa"}, 2),
}


@pytest.mark.long
@pytest.mark.parametrize("name", SHAPES)
def test_shape(name: str) -> None:
    """A surface moves along its normal: nodes are moved by hand, and the problem is solved anew."""
    load, degree = SHAPES[name]
    of = [
        "mean displacement_z on right",
        "strain_energy",
        "norm:8 von_mises",
        "displacement of tip",
    ]
    tables = {
        **TABLES,
        "mesh": {**TABLES["mesh"], "degree": degree},
        "support": [{"on": "left"}],
        "load": [load],
        "output": {"probes": {"tip": [1.83, 0.41, 0.87]}},
    }
    case = Case.from_dict(tables)

    def at(distance: float, offsets: tuple[str, ...] = ()) -> Any:
        body = case.read_body(COMM)
        x = body.mesh.geometry.x
        x[np.isclose(x[:, 2], 1.0), 2] += distance
        return gradient(case, of, offsets=offsets, body=body).gradients

    def values(distance: float) -> np.ndarray:
        return np.array([one.value for one in at(distance)])

    found = at(0.0, ("top",))
    told = np.array([one.by[0].value for one in found])
    slopes = (8 * (values(STEP) - values(-STEP)) - (values(2 * STEP) - values(-2 * STEP))) / (
        12 * STEP
    )
    np.testing.assert_allclose(told, slopes, rtol=1e-7)
    for one in found:
        assert one.nodes is not None
        assert one.nodes.shape[1] == 3


def test_cells() -> None:
    """A constant in one cell: the law has an array of values in its place."""
    of, where = Asked(["strain_energy"], fields=["materials.body.E"]), 3
    body, found = box(), list[Any]()

    def problem(factor: float) -> Problem:
        values = np.full(len(body.owned_cells()), 1e6)
        if COMM.rank == 0:
            values[where] *= factor
        return Problem(
            body,
            NeoHookean(E=values, nu=0.3),
            supports=[Fixed(on="left")],
            loads=[Traction(on="right", value=BEND)],
            degree=1,
        )

    solved(problem(1.0), of, found, gradients=True)
    told = COMM.bcast(found[0].cells["materials.body.E"][where] if COMM.rank == 0 else None)
    sides = list[Any]()
    for factor in (1 + STEP, 1 - STEP):
        solved(problem(factor), Asked(["strain_energy"]), sides, gradients=False)
    assert told == pytest.approx((sides[0][0] - sides[1][0]) / (2 * STEP), rel=1e-6)


# --- frequencies ---


@pytest.mark.long
def test_frequencies() -> None:
    """A bar whose first frequencies differ: constants, a cell's modulus and the shape."""
    tables = {
        "mesh": {"box": {"size": [2, 0.5, 0.3], "cells": [6, 2, 2]}, "degree": 2},
        "materials": {"steel": {"law": "linear-elastic", "E": "2 GPa", "nu": 0.3, "density": 1000}},
        "support": [{"on": "left"}],
        "modal": {"count": 3},
    }
    case, of = Case.from_dict(tables), ["frequency_1", "frequency_2"]
    keys = {"materials.steel.E": (2.0, "GPa"), "materials.steel.nu": (0.3, "")}
    keys["materials.steel.density"] = (1000.0, "")
    found = gradient(case, of, [*keys], fields=["materials.steel.E"], offsets=["top"]).gradients

    def at(key: str, k: int) -> np.ndarray:
        value, unit = keys[key]
        number = value * (1 + k * STEP)
        changed = case.changed({key: f"{number!r} {unit}" if unit else number})
        return np.array([one.value for one in gradient(changed, of).gradients])

    for number, key in enumerate(keys):
        slopes = (8 * (at(key, 1) - at(key, -1)) - (at(key, 2) - at(key, -2))) / (12 * STEP)
        told = np.array([one.by[number].at * one.by[number].value for one in found])
        np.testing.assert_allclose(told, slopes, rtol=1e-6)
    # f is that of sqrt(E/rho).
    for one in found:
        assert one["materials.steel.E"].value * 2.0 == pytest.approx(one.value / 2, rel=1e-9)
        density = one["materials.steel.density"].value * 1000.0
        assert density == pytest.approx(-one.value / 2, rel=1e-9)
        whole = total(COMM, float(one.cells["materials.steel.E"].sum()))
        assert whole == pytest.approx(one.value / 2, rel=1e-9)

    def thicker(distance: float) -> np.ndarray:
        body = case.read_body(COMM)
        x = body.mesh.geometry.x
        x[np.isclose(x[:, 2], 0.3), 2] += distance
        return np.array([one.value for one in gradient(case, of, body=body).gradients])

    slopes = (thicker(STEP) - thicker(-STEP)) / (2 * STEP)
    told = np.array([one["offset of top"].value for one in found])
    np.testing.assert_allclose(told, slopes, rtol=1e-5)  # of second order


@pytest.mark.long
@pytest.mark.parametrize("law", ["linear-elastic", "neo-hookean"])
def test_load_factors(law: str) -> None:
    """A strut with sides of different thickness: constants, loads, a cell's modulus, the shape."""
    tables = {
        "mesh": {"box": {"size": [2, 0.3, 0.2], "cells": [6, 2, 2]}, "degree": 2},
        "materials": {"steel": {"law": law, "E": "2 GPa", "nu": 0.3}},
        "support": [{"on": "left"}],
        "load": [
            {"on": "right", "kind": "traction", "value": ["-1 MPa", 0, 0]},
            {"on": "top", "kind": "traction", "value": [0, 0, "-10 kPa"]},
        ],
        "buckling": {"count": 2},
    }
    case, of = Case.from_dict(tables), ["load_factor_1"]
    keys = {"materials.steel.E": (2.0, "GPa"), "materials.steel.nu": (0.3, "")}
    keys |= {"load[0].value[0]": (-1.0, "MPa"), "load[1].value[2]": (-10.0, "kPa")}
    (found,) = gradient(case, of, [*keys], fields=["materials.steel.E"], offsets=["top"]).gradients

    def at(key: str, k: int) -> float:
        value, unit = keys[key]
        number = value * (1 + k * 1e-3)
        changed = case.changed({key: f"{number!r} {unit}" if unit else number})
        return gradient(changed, of).gradients[0].value

    for number, key in enumerate(keys):
        slope = (8 * (at(key, 1) - at(key, -1)) - (at(key, 2) - at(key, -2))) / (12 * 1e-3)
        told = found.by[number].at * found.by[number].value
        # Load factors are known to 1e-9, their differences to 1e-6.
        assert told == pytest.approx(slope, rel=1e-5, abs=2e-6 * found.value)
    # Proportional to E, and to 1 over both loads together.
    assert 2.0 * found["materials.steel.E"].value == pytest.approx(found.value, rel=1e-7)
    loads = sum(found[key].at * found[key].value for key in [*keys][2:])
    assert loads == pytest.approx(-found.value, rel=1e-7)
    whole = total(COMM, float(found.cells["materials.steel.E"].sum()))
    assert whole == pytest.approx(found.value, rel=1e-7)

    def thicker(distance: float) -> float:
        body = case.read_body(COMM)
        x = body.mesh.geometry.x
        x[np.isclose(x[:, 2], 0.2), 2] += distance
        return gradient(case, of, body=body).gradients[0].value

    slope = (thicker(2e-4) - thicker(-2e-4)) / 4e-4
    assert found["offset of top"].value == pytest.approx(slope, rel=1e-4)  # of second order


def test_frequencies_without_derivative() -> None:
    """The mode behind the last one is found, too; a stretch across the plane is an unknown."""
    steel = {"law": "linear-elastic", "E": "2 GPa", "nu": 0.3, "density": 1000}
    plane = {"rectangle": {"size": [2, 1], "cells": [4, 2]}, "geometry": "plane-stress"}
    tables = {
        "mesh": {**plane, "degree": 1},
        "materials": {"steel": steel},
        "support": [{"on": "left"}],
        "modal": {"count": 2},
    }
    case = Case.from_dict(tables)
    for number, count in ((1, 2), (2, 3)):
        modal = with_one_more(case, [f"frequency_{number}"]).modal
        assert modal is not None
        assert modal.count == count
    with pytest.raises(InputError, match="mode 3 is not among the 2 of the case"):
        with_one_more(case, ["frequency_3"])
    with pytest.raises(InputError, match="with unknowns beside the displacement"):
        gradient(case, ["frequency_1"], ["materials.steel.E"])


# --- what is refused ---


def refused(of: str, by: str = "", **more: Any) -> str:
    tables = {**TABLES, **more}
    with pytest.raises(InputError) as error:
        gradient(Case.from_dict(tables), [of], [by] if by else [])
    return str(error.value)


def test_what_has_no_derivative() -> None:
    assert "'percentile:95 von_mises on right' has no derivative" in refused(
        "percentile:95 von_mises on right"
    )
    assert "did you mean 'left'" in refused("reaction_x of lefft")
    assert "; reaction_x or reaction_y or reaction_z" in refused("reaction_q of left")
    assert "did you mean" in refused("mean von_mises on rigth")
    for key in ("mesh.box.size[0]", "statics.rtol"):
        assert f"'{key}' is no number of a material" in refused("strain_energy", key)
    assert "known: E, density" in refused("strain_energy", "materials.gel.F")
    viscous = {"gel": {**TABLES["materials"]["gel"], "viscous": [{"ratio": 0.5, "time": 1.0}]}}
    remembers = refused("strain_energy", materials=viscous, statics={"steps": 2})
    assert "materials that remember" in remembers


def test_what_depends_on_places_has_no_derivative_by_the_shape(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Prescribed displacements and constants that are formulas change where nodes move.

    It is said before anything is solved.
    """
    monkeypatch.setattr(Case, "make_solver", lambda *_, **__: pytest.fail("it was solved"))
    formula = {"on": "right", "displacement": ["0.1*z", 0, 0]}
    soft = {"gel": {**TABLES["materials"]["gel"], "E": "1e6*(1+z)"}}
    cases = {"Support": {"support": [{"on": "left"}, formula]}, "gel.E": {"materials": soft}}
    for what, more in cases.items():
        tables = {**TABLES, "support": [{"on": "left"}], **more}
        with pytest.raises(InputError, match=f"by the shape with '{what}'"):
            gradient(Case.from_dict(tables), ["strain_energy"], offsets=["top"])
    key = "materials.gel.E"
    assert "which is no number" in refused("strain_energy", key, materials=soft)


def test_numbers_that_are_zero() -> None:
    """Steps of displacements are those of cells; where none is known, and of norms, it is told."""
    small = {"box": {"size": ["2 mm", "1 mm", "1 mm"], "cells": [4, 2, 2]}, "degree": 1}
    held = [{"on": "left"}, {"on": "right", "displacement": ["0.1 mm", 0, 0]}]
    case = Case.from_dict({**TABLES, "mesh": small, "support": held, "load": []})
    of, key = ["reaction_x of left", "strain_energy"], "support[1].displacement[1]"
    found = gradient(case, of, [key]).gradients
    sides = [
        np.array([one.value for one in gradient(case.changed({key: y}), of).gradients])
        for y in (1e-6, -1e-6)
    ]
    told = [one.by[0].value for one in found]
    slopes = (sides[0] - sides[1]) / 2e-6
    scale = [abs(one.value) / 1e-4 for one in found]
    assert np.all(np.abs(told - slopes) < 1e-5 * np.array(scale))
    mooney = {"gel": {"law": "mooney-rivlin", "c10": "0.1 MPa", "c01": "0 MPa", "K": "1 MPa"}}
    supports = [{"on": "left"}]
    message = refused("strain_energy", "materials.gel.c01", materials=mooney, load=[])
    assert "where no size of a step is known" in message
    message = refused("von_mises", "materials.gel.E", support=supports, load=[])
    assert "where a norm has no derivative" in message


@pytest.mark.long
def test_two_materials() -> None:
    """Each has cells of its own."""
    problem = Problem(
        soft_and_hard(box(), at=1.0),
        {"soft": NeoHookean(E=1e6, nu=0.3), "hard": LinearElastic(E=3e6, nu=0.2)},
        supports=[Fixed(on="left")],
        loads=[Force(on="right", value=BEND)],
        degree=1,
    )
    keys, found = ["materials.soft.E", "materials.hard.E"], list[Any]()
    solved(problem, Asked(["strain_energy"], keys, keys), found, gradients=True)
    for one in found[0].by:
        whole = total(COMM, float(found[0].cells[one.key].sum()))
        assert whole == pytest.approx(one.at * one.value, rel=1e-9)
    # Homogeneous of degree -1 in both stiffnesses at small strains: W(s E) = W(E)/s.
    both = sum(one.at * one.value for one in found[0].by)
    assert both < 0.0


def test_bars_of_both_signs() -> None:
    """A colour each, numbers with the minus of the axis; those of short bars have room, too."""
    axis = Figure().subplots()
    draw_bars(axis, [("E", 1.0), ("nu", -0.001), ("load", -0.4), ("radius", 0.0)])
    inks = [bar.get_facecolor() for bar in axis.patches]
    assert inks[1] == inks[2] and inks[0] == inks[3] and inks[0] != inks[1]
    assert [one.get_text() for one in axis.texts] == ["+1 %", "−0.001 %", "−0.4 %", "0"]
    assert axis.get_xlim() == pytest.approx((-0.75, 1.35))


def test_fields_are_told_and_edges_once(caplog: pytest.LogCaptureFixture) -> None:
    """The largest value of each field of gradient.xdmf; a surface with an edge is told once."""
    tables = {**TABLES, "surfaces": {"roof": ["top", "front"]}}
    asked = Asked(["strain_energy"], fields=["materials.gel.E"], offsets=["roof"])
    found = gradients_of(Case.from_dict(tables), asked)
    (one,) = found.gradients
    assert one.nodes is not None
    most = largest(COMM, float(np.abs(one.cells["materials.gel.E"]).max()) / (2.0 / 96))
    shape = largest(COMM, float(np.linalg.norm(one.nodes, axis=1).max()))
    assert largest_values(found) == [
        f"strain_energy by materials.gel.E: at most {quantity(most, 'J')} per m^3",
        f"strain_energy by shape: at most {quantity(shape, 'J')} per m",
    ]
    if COMM.rank == 0:  # that alone logs
        assert caplog.text.count("the surface 'roof' has an edge") == 1
