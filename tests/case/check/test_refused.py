"""What a check refuses: formulas without a value, steps without end, names of nothing."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from helpers.cube import cube

from dolfin_elastic import run
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError

BOX = {"size": [2, 1, 1], "cells": [2, 1, 1]}
MOTION = {"end": 0.1, "dt": 0.01}
LID = {"plane": {"axis": "-z", "at": 1.1}, "on": "top"}


def case(**tables: Any) -> Case:
    """A block of 2 x 1 x 1 m held at x = 0 and pulled at its other end."""
    defaults: dict[str, Any] = {
        "mesh": {"box": BOX, "degree": 1},
        "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [1e3, 0, 0]}],
    }
    return Case(**{**defaults, **tables})


def load(**keys: Any) -> dict[str, Any]:
    return {"load": [{"kind": "traction", "on": "right", "value": [1e3, 0, 0], **keys}]}


def held(**keys: Any) -> dict[str, Any]:
    return {"support": [{"on": "left"}, {"on": "right", **keys}]}


FORMULAS: dict[str, tuple[dict[str, Any], str]] = {
    "place": (
        {"support": [{"on": "left", "displacement": ["1/x", 0, 0]}]},
        r"support 'left': the prescribed displacement is not finite at \(0, 0, 0\) m",
    ),
    "plane inside": (
        {"support": [{"on": "left"}, {"on": "top", "displacement": ["1/(x - 1)", 0, 0]}]},
        r"support 'top': the prescribed displacement is not finite at \(1, 0, 1\) m",
    ),
    "curve of a load": (load(curve="1/t"), r"load\[0\]\.curve: '1/t' is infinite at t = 0"),
    "curve in motion": (
        {**load(curve="ln(t)"), "dynamics": MOTION},
        r"load\[0\]\.curve: 'ln\(t\)' is infinite at t = 0; .* from 0 to 0\.1",
    ),
    "curve that ends": (
        load(curve="sqrt(0.5 - t)"),
        r"load\[0\]\.curve: 'sqrt\(0\.5 - t\)' is not a real number at t = 0\.525",
    ),
    "curve of a support": (
        held(displacement=[0.01, 0, 0], curve="1/t"),
        r"support\[1\]\.curve: '1/t' is infinite at t = 0",
    ),
    "load within": (
        load(value=["1/(t - 0.5)", 0, 0]),
        r"load\[0\]\.value\[0\]: '1/\(t - 0\.5\)' has no finite value at t = 0\.5; a formula that",
    ),
    "load at a place and a time": (
        load(value=[1, 0, "sqrt(2.52 - x - t)"]),
        r"load\[0\]\.value\[2\]: 'sqrt\(2\.52 - x - t\)' has no finite value at \(2, \S+, \S+\) m "
        r"at t = 0\.525; ",
    ),
    "total force": (
        {"load": [{"kind": "force", "on": "right", "value": [0, "ln(x - 2)", 0]}]},
        r"load\[0\]\.value\[1\]: 'ln\(x - 2\)' has no finite value at \(2, \S+, \S+\) m; ",
    ),
    "pressure of two loads": (
        {
            "load": [
                {"kind": "gravity", "value": [0, 0, "-9.81*t"]},
                {"kind": "pressure", "on": "right", "value": "ln(x - 2)"},
            ],
            "materials": {"m": {"law": "linear-elastic", "E": 1e6, "nu": 0.3, "density": 1000}},
        },
        r"load\[1\]\.value: 'ln\(x - 2\)' has no finite value at \(2, \S+, \S+\) m; ",
    ),
    "force at a point": (
        {"load": [{"kind": "point-force", "at": [2, 1, 1], "value": [0, "sqrt(x - y - 1.5)", 0]}]},
        r"load\[0\]\.value\[1\]: 'sqrt\(x - y - 1\.5\)' has no finite value at \(2, 1, 1\) m; ",
    ),
    "obstacle": (
        {"contact": [{**LID, "motion": [0, 0, "-1/t"]}]},
        r"contact\[0\]\.motion: '-1/t' is infinite at t = 0",
    ),
    "curve of an obstacle": (
        {"contact": [{**LID, "motion": [0, 0, -1e-3], "curve": "1/t"}]},
        r"contact\[0\]\.curve: '1/t' is infinite at t = 0",
    ),
    "base of springs": (
        held(kind="spring", normal=1e6, displacement=["1/(x - 2)", 0, 0]),
        r"support\[1\]\.displacement: '1/\(x - 2\)' has no finite value at \(2, \S+, \S+\) m",
    ),
    "springs": (
        held(kind="spring", stiffness=["1/(x - 2)", 1, 1]),
        r"support\[1\]\.stiffness: '1/\(x - 2\)' has no finite value at \(2, \S+, \S+\) m",
    ),
    "growth": (
        {"load": [{"kind": "growth", "value": ["1/(t - 0.5)", 1, 1]}]},
        r"load\[0\]\.value: '1/\(t - 0\.5\)' has no finite value at t = 0\.5",
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_without_a_value(name: str) -> None:
    """`check` passed them, but those of a load at its end; `run` then blamed something else."""
    tables, text = FORMULAS[name]
    with pytest.raises(InputError, match=text):
        report(case(**tables))


EDGE = {"edges": {"rim": {"between": ["right", "top"]}}, "mesh": {"box": BOX, "degree": 1}}
POINT = {"points": {"tip": {"nearest": [2, 1, 1]}}, "mesh": {"box": BOX, "degree": 1}}

BETWEEN: dict[str, tuple[dict[str, Any], str]] = {
    "displacement": (
        {"support": [{"on": "left"}, {"on": "top", "displacement": ["1e-6/(x - 0.503)", 0, 0]}]},
        r"support\[1\]\.displacement: '.*' has no finite value near \(0\.503, \S+, 1\) m",
    ),
    "of even order": (
        {"support": [{"on": "left"}, {"on": "top", "displacement": ["1e-6/(x-0.3)^2", 0, 0]}]},
        r"support\[1\]\.displacement: .* near \(0\.3, ",
    ),
    "negative power": (
        {"support": [{"on": "left"}, {"on": "top", "displacement": ["(x-0.3)^(-2)", 0, 0]}]},
        r"support\[1\]\.displacement: .* near \(0\.3, ",
    ),
    "tangent": (
        held(displacement=["tan(pi*y*0.7)", 0, 0]),
        r"support\[1\].* near \(2, 0\.714286, ",
    ),
    "roller": (
        {"support": [{"on": "left"}, {"kind": "roller", "on": "top", "displacement": "1/(y-0.3)"}]},
        r"support\[1\]\.displacement: .* near \(\S+, 0\.3, 1\) m",
    ),
    "traction": (
        load(value=["1/(z - 0.37)", 0, 0]),
        r"load\[0\]\.value: .* near \(2, \S+, 0\.37\) m",
    ),
    "traction on nodes": (
        load(value=["1/(y - 1)", 0, 0]),
        r"load\[0\]\.value: .* near \(2, 1, \S+\) m",
    ),
    "traction, pole through nodes": (
        load(on="top", value=["1/(x - 1)", 0, 0]),
        r"load\[0\]\.value: .* near \(1, \S+, 1\) m",
    ),
    "body force, pole on the surface": (
        {"load": [{"kind": "body-force", "value": ["1/x^2", 0, 0]}]},
        r"load\[0\]\.value: .* near \(0, 0\.\d+, ",
    ),
    "springs, pole through nodes": (
        {
            "support": [
                {"on": "left"},
                {"kind": "spring", "on": "top", "stiffness": ["1/(x - 1)^2", 1, 1]},
            ]
        },
        r"support\[1\]\.stiffness: .* near \(1, ",
    ),
    "pressure": (
        {"load": [{"kind": "pressure", "on": "top", "value": "1/(x - t)"}]},
        r"load\[0\]\.value: .* near \(0\.025, \S+, 1\) m at t = 0\.025",
    ),
    "body force": (
        {"load": [{"kind": "body-force", "value": ["1/(x - 1.1)", 0, 0]}]},
        r"load\[0\]\.value: .* near \(1\.1, ",
    ),
    "warmth": (
        {
            "load": [{"kind": "thermal", "value": "1/(x - 1.1)"}],
            "materials": {"m": {"law": "linear-elastic", "E": 1e6, "nu": 0.3, "expansion": 1e-5}},
        },
        r"load\[0\]\.value: .* near \(1\.1, ",
    ),
    "springs": (
        held(kind="spring", stiffness=["1/(y - 0.3)^2", 1, 1]),
        r"support\[1\]\.stiffness: .* near \(2, 0\.3, ",
    ),
    "springs on an edge": (
        {
            **EDGE,
            "support": [
                {"on": "left"},
                {"kind": "spring", "on": "rim", "stiffness": ["1/(y - 0.3)^2", 1, 1]},
            ],
        },
        r"support\[1\]\.stiffness: .* near \(2, 0\.3, 1\) m",
    ),
    "springs at a point": (
        {
            **POINT,
            "support": [
                {"on": "left"},
                {"kind": "spring", "on": "tip", "stiffness": ["1/(y - 1)", 1, 1]},
            ],
        },
        r"support\[1\]\.stiffness: .* has no finite value at \(2, 1, 1\) m",
    ),
    "line force": (
        {**EDGE, "load": [{"kind": "line-force", "on": "rim", "value": ["1/(y - 0.3)", 0, 0]}]},
        r"load\[0\]\.value: .* near \(2, 0\.3, 1\) m",
    ),
    "line by its ends": (
        {
            "load": [
                {
                    "kind": "line-force",
                    "start": [2, 0, 1],
                    "end": [2, 1, 1],
                    "value": ["1/(y-.3)", 0, 0],
                }
            ]
        },
        r"load\[0\]\.value: .* near \(2, 0\.3, 1\) m",
    ),
    "time": (load(value=["1/(t - 0.503)", 0, 0]), r"load\[0\]\.value: .* near t = 0\.503"),
    "curve": (load(curve="1/(t - 0.503)"), r"load\[0\]\.curve: .* near t = 0\.503"),
    "curve with poles": (load(curve="tan(pi*t)"), r"load\[0\]\.curve: .* near t = 0\.5"),
    "at the end of a step": (load(curve="tan(pi*t/0.95)"), r"load\[0\]\.curve: .* near t = 0\.475"),
    "angle": (
        held(kind="rotation", point=[0, 0, 0], axis="x", angle="1e-3/(t - 0.503)"),
        r"support\[1\]: .* near t = 0\.503",
    ),
    "obstacle": (
        {"contact": [{**LID, "motion": [0, 0, "1e-4/(t - 0.503)"]}]},
        r"contact\[0\]\.motion: .* near t = 0\.503",
    ),
    "start": (
        {"dynamics": {**MOTION, "initial_velocity": ["1/(x - 0.503)", 0, 0]}},
        r"dynamics\.initial_velocity: .* near \(0\.503, ",
    ),
    "material": (
        {"materials": {"m": {"law": "neo-hookean", "E": "1e6/(x - 0.503)^2", "nu": 0.3}}},
        r"materials\.m\.E: .* near \(0\.503, ",
    ),
    "material, pole through nodes": (
        {"materials": {"m": {"law": "neo-hookean", "E": "1e6/(x - 1)^2", "nu": 0.3}}},
        r"materials\.m\.E: .* near \(1, ",
    ),
}


@pytest.mark.parametrize("name", BETWEEN)
def test_formulas_without_a_value_between_nodes(name: str) -> None:
    """Nodes, points of integration and times that are looked at have values."""
    tables, text = BETWEEN[name]
    with pytest.raises(InputError, match=text):
        report(case(**tables))


def test_a_run_has_no_poles_either() -> None:
    """Before anything is computed or written."""
    tables, text = BETWEEN["displacement"]
    with pytest.raises(InputError, match=text):
        next(run(case(**tables), output="none"))


def test_quotients_that_stay_finite() -> None:
    """Removable singularities, jumps, peaks that have a value, and poles that can be integrated."""
    for formula in (
        "1e-3*sin(x - 0.503)/(x - 0.503)",
        "1e-3*(exp(x - 0.503) - 1)/(x - 0.503)",
        "1e-3/where(x < 0.503, -1, 1)",
        "where(x < 0.6, 0, 1e-3/(x - 0.503))",
        "1e-3/(1 + (x - 0.503)^2)",
        "1e-12/(1e-9 + (x - 0.503)^2)",
        "1e-3*(x - 0.503)^2",
        "1e-3*tan(x/2)",
    ):
        moved = [{"on": "left"}, {"on": "top", "displacement": [formula, 0, 0]}]
        assert report(case(support=moved)).notes is not None
    for where, formula in (
        ("right", "1e3/sqrt(abs(y - 0.3))"),  # contact pressure under an edge
        ("top", "1e3/sqrt(abs(x - 1))"),  # the same through nodes
        ("top", "1e3/sqrt((x - 1)^2 + y^2)"),  # about a node
    ):
        assert report(case(**load(on=where, value=[formula, 0, 0]))).notes is not None
    graded = {"m": {"law": "neo-hookean", "E": "1e6/sqrt(x)", "nu": 0.3}}
    assert report(case(materials=graded)).notes is not None


def test_a_pole_on_the_axis_that_the_circumference_makes_up_for() -> None:
    """The integral of 1/r over a disc is finite."""
    disc_mesh = {"rectangle": {"size": [2, 1], "cells": [2, 1]}, "degree": 1}
    mesh = {**disc_mesh, "geometry": "axisymmetric"}
    disc = load(on="top", value=[0, "1e3/x"])
    found = report(case(mesh=mesh, support=[{"on": "bottom"}], **disc))
    assert found.notes is not None


def test_formulas_that_have_values() -> None:
    """At the rim of where they end, and where no load acts yet."""
    for tables in (
        {"support": [{"on": "left", "displacement": ["1e-3/(x + 1)", 0, 0]}]},
        load(curve="sqrt(1 - t)"),
        load(value=["1e3/t", 0, 0]),
    ):
        assert report(case(**tables)).notes is not None


NUMBERS: dict[str, tuple[dict[str, Any], str]] = {
    "dt": (
        {"dynamics": {"end": 0.1, "dt": 1e-300}},
        r"dynamics\.dt: 1e-300 s would be 1e\+299 steps up to dynamics\.end = 0\.1 s; at least",
    ),
    "first step": (
        {"dynamics": {"end": 0.1, "dt": 1e-20, "adaptive": True}},
        r"dynamics\.dt: .* at least 1e-13 s",
    ),
    "explicit dt": (
        {"dynamics": {"end": 1, "dt": 1e-12, "scheme": "central-differences"}},
        r"dynamics\.dt: .* at least 1e-09 s",
    ),
    "every": ({"dynamics": {**MOTION, "every": "1e-300 s"}}, r"dynamics\.every: 1e-300 s would be"),
    "steps": ({"statics": {"steps": 1e12}}, r"statics\.steps: .* at most 1e\+06"),
    "max_step": ({"statics": {"max_step": 1e-15}}, r"statics\.max_step: .* at least 1e-06"),
    "scale": (
        {"output": {"pictures": [{"scale": float("nan")}]}},
        r"output\.pictures\[0\]\.scale: NaN is wrong; expected a finite number",
    ),
    "endless": (
        {"output": {"pictures": [{"scale": float("inf")}]}},
        r"output\.pictures\[0\]\.scale: Infinity is wrong; expected a finite number",
    ),
    "probe": (
        {"output": {"probes": {"": [1, 0.5, 0.5]}}},
        r'output\.probes\."": "" is no name of a probe',
    ),
    "blank probe": (
        {"output": {"probes": {"a\nb": [1, 0.5, 0.5]}}},
        r'output\.probes\."a\\nb": "a\\nb" is no name of a probe',
    ),
    "unit": (
        {"mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}, "unit": ""}},
        r"mesh\.unit: '' is no unit of length",
    ),
    "no folder": ({"output": {"folder": " "}}, r'output\.folder: " " is no name of a folder'),
    "picture above": (
        {"output": {"pictures": [{"file": "../a.png"}]}},
        r"output\.pictures\[0\]\.file: '\.\./a\.png' lies outside the folder of the results",
    ),
    "picture elsewhere": (
        {"output": {"pictures": [{"file": "/tmp/a.png"}]}},
        r"output\.pictures\[0\]\.file: '/tmp/a\.png' lies outside the folder of the results",
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_what_nobody_means(name: str) -> None:
    """`check` passed them: runs without end, names of nothing, files anywhere."""
    tables, text = NUMBERS[name]
    with pytest.raises(InputError, match=text):
        case(**tables)


@pytest.mark.parametrize(
    ("box", "text"),
    [
        (
            {"size": [1, 1, 1], "cells": [10**9] * 3},
            r"cells: 6e\+27 elements are too many; at most",
        ),
        ({"size": [1e-300, 1, 1], "cells": [1, 1, 1]}, r"size: an edge of 1e-300 m is too short"),
        ({"size": [1, 1, 1e-8], "cells": [1, 1, 1]}, r"size: an edge of 1e-08 m is too short"),
    ],
)
def test_boxes_that_cannot_be_made(box: dict[str, Any], text: str) -> None:
    """DOLFINx ended them with errors of its own, as "vector::reserve"."""
    with pytest.raises(InputError, match=r"mesh\.box\." + text):
        report(case(mesh={"box": box}))


def test_pictures_in_folders_of_their_own() -> None:
    assert case(output={"pictures": [{"file": "views/a.png"}]}).output.pictures[0].file


@pytest.mark.parametrize("output", ["", " "])
def test_a_run_without_a_name_of_its_folder(output: str) -> None:
    """An empty variable of a script would be the current folder, whose files are overwritten."""
    with pytest.raises(InputError, match=f'^output: "{output}" is no name of a folder'):
        next(run(Case.from_dict(tomllib.loads(cube())), output=output))


@pytest.mark.parametrize(
    ("folder", "why"),
    [
        ("file/results", "file is a file"),
        ("file", "file is a file"),
        ("/proc/results", "no such file"),
        ("a\0b", "that is no name"),
    ],
)
def test_folders_that_cannot_be_made(tmp_path: Path, folder: str, why: str) -> None:
    (tmp_path / "file").write_text("")
    made = Case.from_dict(case(output={"folder": folder}).to_dict(), tmp_path)
    with pytest.raises(InputError, match=rf"output\.folder: the folder of the results, .*{why}"):
        report(made)


def test_a_folder_whose_name_is_too_long() -> None:
    with pytest.raises(InputError, match=r"output\.folder: \"x+\.\.\.: file name too long; a sho"):
        case(output={"folder": "x" * 300})


def test_reactions_are_read_at_nodes() -> None:
    """Said before the run, in the words of the run."""
    probe = {"at": [0, 0.4, 0], "fields": ["reaction"]}
    with pytest.raises(InputError, match=r"output\.probes\.p: there is no node at \(0, 0\.4, 0\)"):
        report(case(output={"probes": {"p": probe}}))
    report(case(output={"probes": {"p": {**probe, "at": [0, 1, 0]}}}))


def test_a_check_leaves_nothing_behind(tmp_path: Path) -> None:
    """Folders that can be made are not."""
    made = Case.from_dict(case(output={"folder": "deep/results"}).to_dict(), tmp_path)
    report(made)
    assert list(tmp_path.iterdir()) == []
