"""Probes: fields at points of the undeformed body, in parallel."""

from __future__ import annotations

import csv
import json
from typing import Any

import numpy as np
import pytest
from helpers.bodies import soft_and_hard

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookean,
    Probe,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh import EdgeSelector, PointSelector, name_parts
from dolfin_elastic.mesh.geometry.locate import locate
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.probes import ProbePoint

FREE = "free"


def affine(dim: int, degree: int) -> tuple[Problem, Any]:
    """A body whose whole boundary is moved by a linear displacement, solved."""
    body = (rectangle_body, box_body)[dim - 2](size=[1.0] * dim, cells=[3] * dim)
    moved = ["0.2*x + 0.1*y", "0.05*x - 0.1*y", "0.1*z"][:dim]
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        degree=degree,
        supports=[Support(on=list(body.surfaces), displacement=moved)],
    )
    *_, state = Statics(problem, rtol=1e-12).steps()
    return problem, state


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_linear_fields_are_exact(dim, degree):
    """A linear displacement and its constant stress, at a corner, on a facet and inside."""
    problem, state = affine(dim, degree)
    points = {"corner": [1.0] * dim, "facet": [1 / 3] * dim, "inside": [0.3, 0.41, 0.77][:dim]}
    found = Probe(problem, points, ["displacement", "first_piola", "jacobian"])(state)
    H = np.array([[0.2, 0.1, 0], [0.05, -0.1, 0], [0, 0, 0.1 * (dim == 3)]])
    F = np.eye(3) + H
    J = np.linalg.det(F)
    mu, lmbda = 1e6 / 2.6, 0.3e6 / (1.3 * 0.4)
    inverse = np.linalg.inv(F).T
    P = mu * (F - inverse) + lmbda * np.log(J) * inverse
    for name, X in points.items():
        # Round-off of a solve to 1e-12 and of a mean.
        u = H[:dim, :dim] @ X
        np.testing.assert_allclose(found[f"{name}_displacement"], u, atol=1e-12)
        np.testing.assert_allclose(found[f"{name}_first_piola"], P.ravel(), atol=1e-4)
        np.testing.assert_allclose(found[f"{name}_jacobian"], J, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_stress_at_the_clamped_end_of_a_bar(degree):
    """A hanging bar, held without friction: sigma_xx = f (L - x), linear in x.

    Quadratic elements hold it exactly, and so does the fit; linear ones have the mean of each cell,
    and at an inner corner the mean of those means, within a tenth of a cell's change.
    """
    body = rectangle_body(size=(1.0, 0.5), cells=(8, 4))
    tables: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1.0, 0.5], "cells": [8, 4]}, "degree": degree},
        "materials": {"steel": {"law": "linear-elastic", "E": 1e6, "nu": 0.0}},
        "support": [
            {"on": "left", "displacement": [0, FREE]},
            {"on": "bottom", "displacement": [FREE, 0]},
        ],
        "load": [{"kind": "body-force", "value": [100.0, 0]}],
    }
    case = Case.from_dict(tables)
    problem = case.make_problem(body)
    *_, state = Statics(problem, rtol=1e-12).steps()
    found = Probe(problem, {"in": [0.5, 0.25], "end": [0.0, 0.5]}, ["cauchy_stress"])(state)
    near = 1e-8 if degree == 2 else 100 / 8 / 10
    assert found["in_cauchy_stress"][0] == pytest.approx(50.0, abs=near)
    if degree == 2:
        assert found["end_cauchy_stress"][0] == pytest.approx(100.0, abs=near)


def test_each_material_has_its_own_stress():
    """Two materials side by side under one strain: no mean over the joint."""
    body = soft_and_hard(box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2)), at=1.0)
    problem = Problem(
        body,
        {
            "soft": LinearElastic(E=1.0, nu=0.0),
            "hard": LinearElastic(E=5.0, nu=0.0, allowable=1.0),
        },
        supports=[Support(on=list(body.surfaces), displacement=[0, 0, "0.1*z"])],
        degree=1,
    )
    *_, state = Statics(problem).steps()
    points = {"soft": [0.99, 0.5, 0.4], "hard": [1.01, 0.5, 0.4]}
    found = Probe(problem, points, ["von_mises", "safety_factor"])(state)
    assert found["soft_von_mises"] == pytest.approx([0.1], rel=1e-9)
    assert found["hard_von_mises"] == pytest.approx([0.5], rel=1e-9)
    assert np.isnan(found["soft_safety_factor"])  # it has no allowable stress
    assert found["hard_safety_factor"] == pytest.approx([2.0], rel=1e-9)


@pytest.mark.parametrize("order", [("soft", "hard"), ("hard", "soft")])
def test_on_an_interface_the_first_material_counts(order):
    """However the cells are numbered and shared out."""
    body = soft_and_hard(box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2)), at=1.0)
    laws = {"soft": LinearElastic(E=1.0, nu=0.0), "hard": LinearElastic(E=5.0, nu=0.0)}
    problem = Problem(
        body,
        {name: laws[name] for name in order},
        supports=[Support(on=list(body.surfaces), displacement=[0, 0, "0.1*z"])],
        degree=1,
    )
    *_, state = Statics(problem).steps()
    points = {f"p{k}": [1.0, 0.25 * k, 0.5] for k in range(5)}  # corners, edges and sides
    found = Probe(problem, points, ["von_mises"])(state)
    stress = 0.1 if order[0] == "soft" else 0.5
    for values in found.values():
        assert values == pytest.approx([stress], rel=1e-9)


def block(**output: Any) -> dict[str, Any]:
    return {
        "mesh": {"box": {"size": [20, 10, 10], "cells": [2, 1, 1]}, "unit": "mm", "degree": 1},
        "materials": {"rubber": {"law": "linear-elastic", "E": 1e6, "nu": 0.0}},
        "support": [{"on": "left"}, {"on": "right", "displacement": ["2 mm", 0, 0]}],
        "output": output,
    }


def test_columns_of_the_history(folder):
    probes = {
        "tip": [20, "0.5 cm", 5],
        "middle": {"at": [10, 0, 0], "fields": ["displacement", "von_mises"]},
    }
    case = Case.from_dict(block(probes=probes))
    assert Case.from_dict(case.to_dict()) == case
    *_, state = run(case, output=folder / "out")
    assert state.numbers["tip_x"] == pytest.approx(2e-3, rel=1e-9)
    *_, row = csv.DictReader((folder / "out" / "history.csv").open())
    assert float(row["tip_x"]) == pytest.approx(2e-3, rel=1e-9)
    assert float(row["middle_x"]) == pytest.approx(1e-3, rel=1e-9)
    assert float(row["middle_von_mises"]) == pytest.approx(1e5, rel=1e-9)
    assert [name for name in row if name.startswith(("tip", "middle"))] == [
        *("tip_x", "tip_y", "tip_z"),
        *("middle_x", "middle_y", "middle_z", "middle_von_mises"),
    ]


def test_moments_of_supports(folder):
    """Columns where they are asked for: F x 5 mm of half the block's width about its rim, else 0.

    In `summary.json` those of all supports about their middle.
    """
    about = {"left": "middle", "right": ["2 cm", 5, 0]}
    case = Case.from_dict(block(moments=about))
    assert Case.from_dict(case.to_dict()) == case
    [*_] = run(case, output=folder / "out")
    *_, row = csv.DictReader((folder / "out" / "history.csv").open())
    names = [f"moment_{name}_{axis}" for name in about for axis in "xyz"]
    assert [name for name in row if name.startswith("moment")] == names
    # 1e5 Pa on 1 cm^2, 5 mm above the point: about y.
    wanted = [0, 0, 0, 0, 10 * 5e-3, 0]
    np.testing.assert_allclose([float(row[name]) for name in names], wanted, atol=1e-10)
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert list(summary["moments"]) == ["left", "right"]
    np.testing.assert_allclose(summary["moments"]["right"]["about"], [0.02, 5e-3, 5e-3])
    np.testing.assert_allclose(summary["moments"]["right"]["moment"], 0, atol=1e-10)


def test_moments_about_several_points(folder):
    """M_P = M_middle + (middle - P) x F about points and parts: names of columns tell which."""
    about = {"edge": ["2 cm", 5, 0], "own": "middle", "lid": "top", "foot": "bottom"}
    case = Case.from_dict(block(moments={"left": "bottom", "right": about}))
    assert Case.from_dict(case.to_dict()) == case
    [*_] = run(case, output=folder / "out")
    *_, row = csv.DictReader((folder / "out" / "history.csv").open())
    names = [name for name in row if name.startswith("moment")]
    stems = ["moment_left", *(f"moment_right_{name}" for name in about)]
    assert names == [f"{stem}_{axis}" for stem in stems for axis in "xyz"]
    # 10 N along x, in the middle of faces at z = 5 mm: above the edge and bottom, below the top.
    wanted = [-0.05, 0.05, 0.0, -0.05, 0.05]
    found = np.array([float(row[name]) for name in names]).reshape(-1, 3)
    np.testing.assert_allclose(found[:, 1], wanted, atol=1e-10)
    np.testing.assert_allclose(found[:, [0, 2]], 0, atol=1e-10)


@pytest.mark.parametrize(
    ("moments", "message"),
    [
        ({"lft": "middle"}, r"output.moments.lft: there is no support or contact 'lft'.*left"),
        ({"left": [0, 0]}, r"output.moments.left: 2 coordinates given, the body has 3"),
        ({"left": "midle"}, r"output.moments.left: there is no point 'midle'; .*mean 'middle'\?"),
        (
            {"left": "botom"},
            r"'botom'; did you mean 'bottom'\? \(a point is \"middle\", \[x, y, z\]",
        ),
        ({"left": "anchor"}, r"no point 'anchor'; known: back, bottom, .*middle.* \(a point is"),
        ({"left": 3}, r"output.moments.left: 3 is no point; expected \"middle\", .*; or a table"),
        ({"left": [0, 1, "x"]}, r"output.moments.left\[2\]: .*'x'"),
        ({"left": [0, True, 1]}, r"output.moments.left\[1\]: true is wrong"),
        ({"left": {}}, r"output.moments.left: no point is given; expected names, each with"),
        ({"left": {"bolt": [1]}}, r"output.moments.left.bolt: \[1\] is no point; expected \"mi"),
        ({"left": {"bolt": {"a": "middle"}}}, r"output.moments.left.bolt: .* is no point"),
        ({"left": {"bolt": "tpo"}}, r"output.moments.left.bolt: .*'tpo'; did you mean 'top'"),
        ({"left": {" ": "middle"}}, r'output.moments.left: " " is no name of a point'),
        (
            {"left": {"a_b": "middle"}, "left_a": {"b": "middle"}},
            r"output.moments.left_a.b: there are two moments called 'moment_left_a_b_x'",
        ),
        ({"hub": "middle"}, r"output.moments.hub: history.csv has moment_hub of the rigid surface"),
    ],
)
def test_invalid_moments_are_refused(moments, message):
    tables = block(moments=moments)
    tables["support"].append({"kind": "rigid", "on": "top", "name": "hub"})
    tables["support"].append({"on": "bottom", "name": "left_a"})
    with pytest.raises(InputError, match=message):
        report(Case.from_dict(tables))


def test_a_probe_with_the_name_of_a_moment(folder):
    """Neither of them takes the place of the other."""
    twins = {"probes": {"moment_left_bolt": [0, 0, 0]}, "moments": {"left": {"bolt": "middle"}}}
    with pytest.raises(InputError, match="moment_left_bolt_x"):
        list(run(Case.from_dict(block(**twins)), output=folder / "out"))
    assert not (folder / "out").exists()


def test_a_point_that_is_an_empty_part():
    """A surface without facets has no middle; it is no nan in the history."""
    body = box_body(size=(1.0, 1.0, 1.0), cells=(1, 1, 1))
    body = body.named(surfaces={"none": np.zeros(0, dtype=np.int32)})
    problem = Problem(body, LinearElastic(E=1.0, nu=0.0), supports=[Support(on="left")], degree=1)
    with pytest.raises(InputError, match=r"output.moments.left.a: 'none' is empty; expected \"mid"):
        Probe.of({}, problem, 1.0, {"left": {"a": "none"}})


def test_means_over_surfaces(folder):
    """Of a stretched block: u is linear in x, the stress one number; both exact."""
    probes = {
        "end": {"surface": "right", "fields": ["displacement", "cauchy_stress"]},
        "side": {"surface": "top", "fields": ["displacement", "von_mises"]},
    }
    *_, state = run(Case.from_dict(block(probes=probes)), output=folder / "out")
    assert state.numbers["end_x"] == pytest.approx(2e-3, rel=1e-9)
    assert state.numbers["end_cauchy_stress_xx"] == pytest.approx(1e5, rel=1e-9)
    assert state.numbers["side_x"] == pytest.approx(1e-3, rel=1e-9)
    assert state.numbers["side_von_mises"] == pytest.approx(1e5, rel=1e-9)
    *_, row = csv.DictReader((folder / "out" / "history.csv").open())
    assert float(row["side_x"]) == pytest.approx(1e-3, rel=1e-9)


def test_a_mean_over_a_surface_of_revolution(folder):
    """u_r = c r on a disc: the mean of r over its area is 2/3 of the radius, on a rim all of it."""
    body = rectangle_body(size=(3.0, 1.0), cells=(3, 1))
    law = {"a": LinearElastic(E=1.0, nu=0.0)}
    problem = Problem(body, law["a"], geometry="axisymmetric", degree=1)
    problem.u.interpolate(lambda x: (0.01 * x[0], 0.0 * x[0]))
    state = State(step=0, t=0.0, u=problem.u, v=problem.u)
    lid = ProbePoint(on="top", fields=("displacement", "velocity"))
    found = Probe.of({"lid": lid, "rim": ProbePoint(on="right")}, problem, 1.0)(state)
    np.testing.assert_allclose(found["lid_displacement"], [0.02, 0], rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(found["lid_velocity"], [0.02, 0], rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(found["rim_displacement"], [0.03, 0], rtol=1e-12, atol=1e-16)


def test_no_probes(folder):
    *_, state = run(Case.from_dict(block()), output=folder / "out")
    assert not state.numbers


@pytest.mark.parametrize(
    ("probes", "message"),
    [
        ({"tip": [20, 5]}, r"output.probes.tip: .*expected 3 numbers"),
        ({"tip": [20, 5, 11]}, r"outside of the body: tip \(20, 5, 11\) mm, 5.1 mm from"),
        ({"tip": {"at": [1, 1, 1], "fields": ["rank"]}}, "a probe cannot read 'rank'"),
        ({"tip": {"at": [1, 1, 1], "fields": ["von_mise"]}}, "von_mises"),
        ({"tip": {"at": [1, 1, 1], "fields": ["velocity"]}}, "no 'velocity' in statics"),
        ({"tip": {"place": [1, 1, 1]}}, "output.probes.tip: unknown key 'place'"),
        ({"tip": "top"}, "output.probes.tip"),
        ({"end": {"surface": "rigth"}}, r"output.probes.end.surface: no surface 'rigth'.*right"),
        ({"end": {"surface": "right", "at": [1, 1, 1]}}, "at and surface are given together"),
        ({"end": {"fields": ["von_mises"]}}, "no position is given"),
    ],
)
def test_invalid_probes_are_refused(probes, message):
    with pytest.raises(InputError, match=message):
        case = Case.from_dict(block(probes=probes))
        check(case, case.read_body())


@pytest.mark.parametrize("name", ["reaction_left", "max", "reaction_left_x"])
def test_names_of_other_results(name, folder):
    """Refused before anything is written."""
    given = [0, 0, 0] if name == "reaction_left" else {"at": [0, 0, 0], "fields": ["von_mises"]}
    tables = block(probes={name: given})
    tables["support"] = [{"on": "left", "displacement": [0, 0, 0]}]
    case = Case.from_dict(tables)
    if name != "reaction_left":
        [*_] = run(case, output=folder / "other")  # these differ: reaction_left_x_von_mises
        return
    with pytest.raises(InputError, match="two results called 'reaction_left_x'"):
        next(run(case, output=folder / "out"))
    assert not (folder / "out").exists()


def test_two_columns_of_one_name(folder):
    probes = {"a": [0, 0, 0], "a_von": {"at": [0, 0, 0], "fields": ["von_mises"]}}
    case = Case.from_dict(block(probes=probes))
    [*_] = run(case, output=folder / "out")  # these differ
    problem = case.make_problem(case.read_body())
    probe = Probe(problem, {"a": [0.0, 0.0, 0.0]})
    state = next(Statics(problem).steps())
    with pytest.raises(InputError, match="two results called 'a_x'"):
        probe.add_to(probe.add_to(state))


@pytest.mark.parametrize("degree", [1, 2])
def test_a_point_a_little_outside(degree):
    """0.03 of a cell beyond a side, as on a round surface that is flat between nodes."""
    problem, state = affine(2, degree)
    found = Probe(problem, {"out": [1.01, 0.5]})(state)["out_displacement"]
    np.testing.assert_allclose(found, [0.2 * 1.01 + 0.05, 0.05 * 1.01 - 0.05], atol=1e-12)
    with pytest.raises(InputError, match=r"outside of the body: far \(1.02, 0.5\)"):
        locate(problem.body, {"out": [1.01, 0.5], "far": [1.02, 0.5]})


def test_exactly_one_rank_has_a_point():
    """A node in the middle that several ranks share."""
    body = box_body(size=(1.0, 1.0, 1.0), cells=(2, 2, 2))
    place = locate(body, {"middle": [0.5, 0.5, 0.5]})["middle"]
    assert body.comm.allreduce(int(place.cell >= 0)) == 1
    assert (place.cell >= 0) == (place.rank == body.comm.rank)


@pytest.mark.parametrize("degree", [1, 2])
def test_means_over_edges_and_points(degree: int) -> None:
    """Of linear fields: their values at the middle of an edge, and at the mean of the nodes."""
    problem, state = affine(3, degree)
    body = name_parts(
        problem.body,
        edges={"seam": EdgeSelector(between=["left", "top"])},
        points={"tip": PointSelector(nearest=(1, 1, 1)), "face": PointSelector(of="right")},
    )
    problem = Problem(body, NeoHookean(E=1e6, nu=0.3), degree=degree)
    fields = ("displacement", "jacobian")
    probes = {name: ProbePoint(on=name, fields=fields) for name in ("seam", "tip", "face", "right")}
    found = Probe.of(probes, problem, 1.0)(state)
    H = np.array([[0.2, 0.1, 0], [0.05, -0.1, 0], [0, 0, 0.1]])
    for name, X in (("seam", [0, 0.5, 1]), ("tip", [1, 1, 1]), ("face", [1, 0.5, 0.5])):
        np.testing.assert_allclose(found[f"{name}_displacement"], H @ X, atol=1e-12)
        np.testing.assert_allclose(found[f"{name}_jacobian"], np.linalg.det(np.eye(3) + H))
    np.testing.assert_allclose(found["right_displacement"], found["face_displacement"], atol=1e-12)


def test_probes_by_name_that_fail() -> None:
    with pytest.raises(InputError, match="at and on are given together"):
        ProbePoint(at=[0, 0], on="left")
    case = Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
        materials={"a": {"law": "linear-elastic", "E": 1, "nu": 0}},
        support=[{"on": "left"}],
        output={"probes": {"tip": {"on": "lft"}}},
    )
    with pytest.raises(InputError, match=r"output.probes.tip.on: no surface 'lft' .* 'left'"):
        check(case, case.read_body())


# --- reactions ---


@pytest.mark.parametrize("dim", [2, 3])
def test_reactions_are_summed_up(dim: int) -> None:
    """Over a surface they are the support's reaction, and so is what its nodes bear together.

    They could not be probed.
    """
    make = box_body if dim == 3 else rectangle_body
    body = make(size=(2.0, 1.0, 1.0)[:dim], cells=(2, 1, 1)[:dim])
    pull = [1e3, 2e3, 3e3][:dim]
    problem = Problem(
        body,
        LinearElastic(E=1e6, nu=0.3),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=pull)],
        degree=1,
    )
    *_, state = Statics(problem, steps=1).steps()
    corners = [(0.0, y, z)[:dim] for y in (0.0, 1.0) for z in (0.0, 1.0)]
    corners = list(dict.fromkeys(corners))
    points = {f"n{i}": ProbePoint(at=list(x), fields=("reaction",)) for i, x in enumerate(corners)}
    probes = {
        **points,
        "held": ProbePoint(on="left", fields=("reaction", "displacement")),
        "free": ProbePoint(at=[2.0, 1.0, 1.0][:dim], fields=("reaction",)),
    }
    probe = Probe.of(probes, problem, 1.0)
    found = probe(state)
    assert np.allclose(found["held_reaction"], state.reactions["left"], rtol=0, atol=1e-9)
    assert np.allclose(found["held_reaction"], -np.array(pull), rtol=1e-9)
    assert np.allclose(sum(found[f"{name}_reaction"] for name in points), found["held_reaction"])
    assert np.allclose(found["free_reaction"], 0.0, atol=1e-6)
    assert np.allclose(found["held_displacement"], 0.0)
    assert {f"held_reaction_{x}" for x in "xyz"[:dim]} <= probe.numbers(state).keys()


def test_a_reaction_is_at_a_node() -> None:
    """Between nodes there is none: the nearest one is named."""
    body = rectangle_body(size=(2.0, 1.0), cells=(2, 1))
    problem = Problem(body, LinearElastic(E=1e6, nu=0.3), supports=[Support(on="left")], degree=1)
    with pytest.raises(InputError) as caught:
        Probe.of({"p": ProbePoint(at=[0.0, 0.4], fields=("reaction",))}, problem, 1.0)
    assert str(caught.value) == (
        "output.probes.p: there is no node at (0, 0.4) m, and a reaction is a force at nodes; "
        "the nearest is at (0, 0) m; or on = the name of a part"
    )
