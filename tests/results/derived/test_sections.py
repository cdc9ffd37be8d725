"""Forces and moments across sections: those of the loads and reactions beyond, to round-off."""

from __future__ import annotations

import csv
import json
from math import pi
from typing import Any

import numpy as np
import pytest
from dolfinx import la
from dolfinx.mesh import locate_entities
from helpers.bodies import soft_and_hard
from helpers.states import last

from dolfin_elastic import (
    Case,
    Dynamics,
    Force,
    LinearElastic,
    NeoHookean,
    Problem,
    Section,
    SectionForces,
    Support,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.model.loads import BodyForce
from dolfin_elastic.model.supports.springs import Spring
from dolfin_elastic.results.derived.sections import distance_from_plane
from dolfin_elastic.results.finished.run import column_unit

ROUND_OFF = 1e-10
"""Of the load, what a direct solver leaves; nothing else is between a section and the loads."""


def with_surface(body: Body, **markers: Any) -> Body:
    mesh, d = body.mesh, body.dim - 1
    mesh.topology.create_connectivity(d, d + 1)
    found = {name: locate_entities(mesh, d, marker) for name, marker in markers.items()}
    return body.named(surfaces={n: np.sort(f).astype(np.int32) for n, f in found.items()})


def bar(dim: int = 3) -> Body:
    """10 x 2 x 2 with an inner surface at 5; a piece of one at 2.5, as a crack would be."""
    make = {2: rectangle_body, 3: box_body}[dim]
    body = make(size=[10.0, 2.0, 2.0][:dim], cells=[8, 2, 2][:dim])
    return with_surface(
        body,
        cut=lambda x: np.isclose(x[0], 5.0),
        crack=lambda x: np.isclose(x[0], 2.5) & (x[1] < 1.01),
    )


SECTIONS = {
    "cut": Section(on="cut"),
    "mid": Section(plane="x", at=6.4),
    "root": Section(plane="x", at=3.1, about="left"),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "law",
    [
        LinearElastic(E=1e6, nu=0.3),
        NeoHookean(E=1e6, nu=0.3),
        NeoHookean(E=1e6, nu=0.4999),
    ],
    ids=["linear", "large", "pressure"],
)
def test_a_bent_bar(law, degree):
    """The load at its end, and its moment: bent by a tenth of its length."""
    force = np.array([500.0, 30.0, -100.0])
    problem = Problem(
        bar(),
        law,
        degree=degree,
        formulation="mixed" if law.nu > 0.49 else "displacement",
        supports=[Support(on="left")],
        loads=[Force(on="right", value=[*force])],
    )
    state = last(problem, rtol=1e-12)
    found = SectionForces(problem, SECTIONS)(state)
    held = state.moments["left"].about_point([0, 1, 1], state.reactions["left"])
    for section in found.values():
        np.testing.assert_allclose(section.force, force, atol=ROUND_OFF * 500)
        # Moments about one point are those of the support, the other way round.
        about = section.moment.about_point([0, 1, 1], section.force)
        np.testing.assert_allclose(about, -held, atol=ROUND_OFF * 5000)
    if law.linear:
        for name, x in {"cut": 5.0, "mid": 6.4, "root": 0.0}.items():
            arm = np.array([10 - x, 0, 0])  # the traction is even over its face
            np.testing.assert_allclose(
                found[name].moment.value, moment_of(arm, force), atol=ROUND_OFF * 5000
            )


@pytest.mark.parametrize("dim", [2, 3])
def test_the_weight_beyond(dim):
    """Half the weight, with its lever of a quarter of the length, whatever side is asked for."""
    body = soft_and_hard(bar(dim), at=5.0)
    weight = [0.0] * (dim - 1) + [-7.0]
    problem = Problem(
        body,
        {"soft": LinearElastic(E=1e3, nu=0.3), "hard": LinearElastic(E=1e6, nu=0.3)},
        supports=[Support(on="left")],
        loads=[BodyForce(value=weight)],
        **({"thickness": 2.0} if dim == 2 else {}),
    )
    asked = {"cut": Section(on="cut"), "plane": Section(plane="x", at=5.0)}
    asked["soft"] = Section(on="cut", side="soft")
    found = SectionForces(problem, asked)(last(problem, rtol=1e-12))
    half = 7.0 * 20.0
    for name, sign in {"cut": 1, "plane": 1, "soft": -1}.items():
        force, moment = found[name].force, found[name].moment.value
        np.testing.assert_allclose(force, sign * np.array(weight) * 20.0, atol=ROUND_OFF * half)
        bent = sign * half * 2.5 * (1 if dim == 3 else -1)
        assert moment[1 if dim == 3 else 0] == pytest.approx(bent, rel=ROUND_OFF)


def test_a_closed_curved_surface():
    """A core hangs in its matrix: what it exerts is its weight. One axis tells no sides."""
    body = rectangle_body(size=(2.0, 2.0), cells=(16, 16), origin=(-1, -1))
    x = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)
    core = np.linalg.norm(x, axis=1) < 0.6
    count = body.mesh.topology.index_map(2).size_local
    owned = {"core": core[:count], "matrix": ~core[:count]}
    body = body.named(regions={n: np.flatnonzero(m).astype(np.int32) for n, m in owned.items()})
    topology = body.mesh.topology
    topology.create_connectivity(2, 1)
    marks = la.vector(topology.index_map(1), 2)
    rows = marks.array.reshape(-1, 2)
    for column, mask in enumerate(owned.values()):
        facets = topology.connectivity(2, 1).array.reshape(-1, 3)[:count][mask]
        rows[facets.ravel(), column] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    marks.scatter_forward()
    round_it = np.flatnonzero((rows > 0).all(axis=1)).astype(np.int32)
    body = body.named(surfaces={"round": round_it})
    problem = Problem(
        body,
        {"core": LinearElastic(E=1e6, nu=0.3), "matrix": LinearElastic(E=1e4, nu=0.3)},
        supports=[Support(on=["left", "right"])],
        loads=[BodyForce(value=[0, -3.0])],
    )
    state = last(problem, rtol=1e-12)
    found = SectionForces(problem, {"round": Section(on="round", side="core")})(state)["round"]
    cells = body.mesh.comm.allreduce(int(owned["core"].sum()))
    expected = [0, -3.0 * cells * (2 / 16) ** 2 / 2]
    np.testing.assert_allclose(found.force, expected, atol=ROUND_OFF * 10)
    with pytest.raises(InputError, match="two sides that cannot be distinguished"):
        SectionForces(problem, {"round": Section(on="round")})


def test_a_body_of_revolution():
    """A tube hangs on its top: the force along the axis is that of the load at its foot."""
    body = rectangle_body(size=(1.0, 3.0), cells=(3, 9), origin=(1, 0))
    problem = Problem(
        body,
        LinearElastic(E=1e6, nu=0.3),
        geometry="axisymmetric",
        supports=[Support(on="top")],
        loads=[Traction(on="bottom", value=[0, -10.0])],
    )
    sections = SectionForces(problem, {"waist": Section(plane="y", at=1.4)})
    numbers = sections.numbers(state := last(problem, rtol=1e-12))
    assert numbers == {"section_force_waist_y": pytest.approx(10.0 * 3 * pi, rel=ROUND_OFF)}
    assert numbers["section_force_waist_y"] == pytest.approx(state.reactions["top"][1], rel=1e-10)


@pytest.mark.parametrize("scheme", ["central-differences", "generalized-alpha"])
def test_nothing_crosses_in_free_fall(scheme):
    """Inertia and weight of the cells beside a section cancel."""
    problem = Problem(
        bar(2),
        LinearElastic(E=1e6, nu=0.3, density=1000.0),
        degree=1,
        loads=[BodyForce(value=[0, -9810.0])],
    )
    motion = Dynamics(problem, scheme=scheme, end=0.05, dt=None if "central" in scheme else 0.01)
    *_, state = motion.steps()
    found = SectionForces(problem, {"cut": Section(on="cut")})(state)["cut"]
    np.testing.assert_allclose(found.force, 0.0, atol=1e-8 * 9810 * 10)


def test_columns_and_units(folder):
    """From a case file: columns of the history, numbers of the summary, their units."""
    tables = {
        "mesh": {"box": {"size": [10, 2, 2], "cells": [5, 1, 1]}, "unit": "mm", "degree": 1},
        "materials": {"m": {"law": "linear-elastic", "E": 1e9, "nu": 0.0}},
        "support": [{"on": "left"}],
        "load": [{"kind": "force", "on": "right", "value": [0, 0, "-3 N"]}],
        "output": {"sections": {"mid": {"plane": "x", "at": "4 mm", "about": [5, 1, 1]}}},
    }
    [*_] = run(Case.from_dict(tables), output=folder / "out")
    with (folder / "out" / "history.csv").open() as file:
        *_, row = csv.DictReader(file)
    assert float(row["section_force_mid_z"]) == pytest.approx(-3, rel=ROUND_OFF)
    assert float(row["section_moment_mid_y"]) == pytest.approx(3 * 5e-3, rel=ROUND_OFF)
    assert column_unit("section_force_mid_z", timed=False) == "N"
    assert column_unit("section_moment_mid_y", timed=False) == "N m"


@pytest.mark.parametrize(
    ("at", "off"), [("4 mm", None), (5.0, "'mid' by up to 1 mm from x = 5 mm")], ids=["on", "off"]
)
def test_a_plane_that_cuts_cells_is_said_to_lie_beside_its_facets(folder, at, off):
    """Once, in `check`, and in the run's log and summary, which the report shows."""
    tables = {
        "mesh": {"box": {"size": [10, 2, 2], "cells": [5, 1, 1]}, "unit": "mm", "degree": 1},
        "materials": {"m": {"law": "linear-elastic", "E": 1e9, "nu": 0.0}},
        "support": [{"on": "left"}],
        "load": [{"kind": "force", "on": "right", "value": [0, 0, "-3 N"]}],
        "output": {"sections": {"mid": {"plane": "x", "at": at}, "end": {"plane": "x", "at": 8}}},
    }
    case = Case.from_dict(tables)
    [*_] = run(case, output=folder / "out")
    summary = json.loads((folder / "out" / "summary.json").read_text())
    for notes in (report(case).notes, summary["model"]["warnings"]):
        found = [note for note in notes if "output.sections" in note]
        assert len(found) == (off is not None)
        assert all(off in note and "'end'" not in note for note in found)


@pytest.mark.parametrize(("at", "off"), [(5.0, 0.0), (5.1, 0.1), (6.4, 0.15), (6.9, 0.65)])
def test_how_far_the_facets_lie_from_a_plane(at, off):
    """Columns of cells are 1.25 long, cut by diagonals: at 6.9 facets reach from 6.25 to 7.5."""
    found = distance_from_plane(bar(), Section(plane="x", at=at))
    assert found == pytest.approx(off, abs=1e-12)


@pytest.mark.parametrize(
    ("section", "where", "message"),
    [
        ({"on": "cutt"}, "output.sections.s.on", "no surface 'cutt'"),
        ({"on": "right"}, "output.sections.s.on", "on the boundary"),
        ({"on": "crack"}, "output.sections.s.on", "two sides that cannot"),
        ({"on": "cut", "side": "rightt"}, "output.sections.s.side", "no region 'rightt'"),
        ({"on": "cut", "side": "all"}, "output.sections.s.side", "two sides that cannot"),
        (
            {"plane": "x", "at": 11},
            "output.sections.s.at",
            "no elements lie on both sides of x = 11",
        ),
        (
            {"plane": "x", "at": 0.1},
            "output.sections.s.at",
            "of x = 0.1 m; between 0.3125 and 9.688 m",
        ),
        ({"plane": "x", "at": 5, "about": "lefft"}, "output.sections.s.about", "no point 'lefft'"),
    ],
)
def test_what_is_no_section(section, where, message):
    body = bar()
    body = body.named(regions={"all": body.owned_cells()})
    problem = Problem(body, LinearElastic(E=1e6, nu=0.3), supports=[Support(on="left")])
    with pytest.raises((InputError, MeshError), match=message) as caught:
        SectionForces(problem, {"s": Section(**section)})
    assert caught.value.where == where
    if section.get("on") == "cutt":
        assert "'cut'" in str(caught.value)


def test_loads_of_neither_side():
    problem = Problem(
        bar(),
        LinearElastic(E=1e6, nu=0.3),
        supports=[Support(on="left")],
        loads=[Traction(on="cut", value=[1.0, 0, 0])],
    )
    with pytest.raises(InputError, match="acts on the section itself"):
        SectionForces(problem, {"s": Section(on="cut")})
    spring = Spring(on="cut", stiffness=[1e3, 1e3, 1e3])
    held = Problem(bar(), LinearElastic(E=1e6, nu=0.3), supports=[spring])
    with pytest.raises(InputError, match="acts on the section itself"):
        SectionForces(held, {"s": Section(on="cut")})
    force = SectionForces(problem, {"s": Section(plane="x", at=2.5)})(last(problem, rtol=1e-12))[
        "s"
    ].force
    np.testing.assert_allclose(force, [4.0, 0, 0], atol=ROUND_OFF * 4)


@pytest.mark.parametrize(
    "section", [{}, {"on": "cut", "plane": "x", "at": 1}, {"plane": "x"}, {"at": 1}]
)
def test_where_is_it(section):
    with pytest.raises(InputError, match="not clear where the section is"):
        Section(**section)
