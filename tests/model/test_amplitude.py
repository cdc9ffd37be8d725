"""Amplitudes over time: what is written is what happens."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from dolfin_elastic import (
    Case,
    Contact,
    Rigid,
    Rotation,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.amplitude import CONSTANT, RAMP, amplitude
from dolfin_elastic.model.loads import Traction
from dolfin_elastic.model.supports.displacement import Support
from dolfin_elastic.model.values import components, depends_on_time


@pytest.mark.parametrize(
    ("written", "t", "value"),
    [
        ("constant", -1.0, 1.0),
        ("constant", 5.0, 1.0),
        ("ramp", -1.0, 0.0),
        ("ramp", 0.0, 0.0),
        ("ramp", 0.25, 0.25),
        ("ramp", 1.0, 1.0),
        ("ramp", 3.0, 1.0),
        ("sin(pi*t)", 0.5, 1.0),
        ("t^2", 3.0, 9.0),
        ("t", 0.7, 0.7),
        ("2", 0.1, 2.0),
        ("where(t < 1, 5, -1)", 0.5, 5.0),
        ("where(t < 1, 5, -1)", 1.0, -1.0),
        ([[0, 0], [2, 10], [3, 4]], -1.0, 0.0),
        ([[0, 0], [2, 10], [3, 4]], 1.0, 5.0),
        ([[0, 0], [2, 10], [3, 4]], 2.5, 7.0),
        ([[0, 0], [2, 10], [3, 4]], 9.0, 4.0),
        ([["10 ms", 1], ["30 ms", 3]], 0.02, 2.0),
        ([[1, 7]], 0.0, 7.0),
        ("smooth", -1.0, 0.0),
        ("smooth", 0.25, 5 / 32),  # 3 s^2 - 2 s^3
        ("smooth", 0.5, 0.5),
        ("smooth", 2.0, 1.0),
        ("load-unload", -1.0, 0.0),
        ("load-unload", 0.2, 0.4),
        ("load-unload", 0.5, 1.0),
        ("load-unload", 0.8, 0.4),
        ("load-unload", 1.5, 0.0),
        ("t-1", 3.0, 2.0),
        ({"smooth": [[0, 1], [2, 5], [3, 1]]}, -1.0, 1.0),
        ({"smooth": [[0, 1], [2, 5], [3, 1]]}, 0.5, 1 + 4 * 5 / 32),
        ({"smooth": [[0, 1], [2, 5], [3, 1]]}, 2.0, 5.0),
        ({"smooth": [[0, 1], [2, 5], [3, 1]]}, 2.5, 3.0),
        ({"smooth": [[0, 1], ["2 s", 5]]}, 3.0, 5.0),
    ],
)
def test_value_at_a_time(written, t, value):
    assert amplitude(written).at(t) == pytest.approx(value, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("rmap", "did you mean 'ramp'"),
        ("sin(x)", "x"),
        ("", "formula"),
        (3.0, "not a curve"),
        ([], "pairs"),
        ([[0, 1, 2]], "pairs"),
        ([0, 1], "pairs"),
        ([[0, 0], [0, 1]], "increase"),
        ([[1, 0], [0, 1]], "increase"),
        ([[0, "a"]], "a"),
        ("load-unlaod", "did you mean 'load-unload'"),
        ({"smoth": [[0, 1]]}, "unknown key 'smoth'"),
        ({"smooth": 1}, "pairs"),
        ({"smooth": [[1, 0], [0, 1]]}, "increase"),
        ({"smooth": [[0, 1]], "file": "a.csv"}, "unknown key 'file'"),
        ({"file": 3}, "expected a text"),
        ({"time": "t"}, "file: this key is missing"),
    ],
)
def test_what_is_no_curve_is_refused(written, says):
    with pytest.raises(InputError) as caught:
        amplitude(written)
    assert says in str(caught.value)


def test_an_amplitude_stays_itself():
    assert amplitude(RAMP) is RAMP
    assert CONSTANT.at(0.3) == 1.0


def test_curves_of_loads_and_supports_survive_being_written():
    table = [[0.0, 1.0], [2.0, 0.0]]
    for curve in ("ramp", "load-unload", "t^2", table, {"smooth": table}):
        load = Traction(on="top", value=[0, 0, 1], curve=curve)
        assert load.model_dump()["curve"] == curve
        again = Traction(**load.model_dump())
        times = np.linspace(-1, 3, 9)
        assert [again.curve.at(t) for t in times] == [load.curve.at(t) for t in times]
    assert Support(on="top").model_dump()["curve"] is None


def test_who_says_how_it_changes():
    """A curve, else a formula in t, else the solver."""
    assert Traction(on="top", value=[0, 0, 1]).amplitude is None
    assert Traction(on="top", value=["t*x", 0, 1]).amplitude is CONSTANT
    assert Traction(on="top", value=["t*x", 0, 1], curve="ramp").amplitude.written == "ramp"
    assert Support(on="top", displacement=[0, "0.1*x", "free"]).amplitude is None
    assert Support(on="top", displacement=[0, "0.1*t", "free"]).amplitude is CONSTANT


def test_each_component_has_its_own_amplitude():
    """At half the load a number is halved; a formula in t beside it, t^2 or 0.25, is not."""
    x = np.zeros((1, 3))
    moves = ["t^2", 2.0, "2"]
    support = Support(on="top", displacement=moves)
    assert [np.squeeze(support.at(i, x, 0.5, RAMP)) for i in range(3)] == [0.25, 1.0, 1.0]
    turned = Rotation(on="top", point=[0, 0, 0], axis=[0, 0, 1], angle=0.0, displacement=moves)
    assert [float(turned.at(i, x, 0.5, RAMP)[0]) for i in range(3)] == [0.25, 1.0, 1.0]
    plate = Rigid(on="top", displacement=moves, rotation=[0, "t", 1.0])
    assert plate.at_time(plate.motion(3), 0.5, RAMP) == (0.25, 1.0, 1.0, 0.0, 0.5, 0.5)
    ball = Contact(on="top", sphere={"center": [0, 0, 0], "radius": 1}, motion=moves)
    assert ball.displacement_at(0.5, RAMP, 3) == [0.25, 1.0, 1.0]
    named = Contact(on="top", plane={"axis": "z", "at": 0}, motion=moves, curve="constant")
    assert named.displacement_at(0.5, RAMP, 3) == [0.25, 2.0, 2.0]


def test_time_in_formulas_is_seen():
    assert depends_on_time(components([0, "sin(t)"], "m"))
    assert not depends_on_time(components([0, "sin(x)"], "m"))
    assert not depends_on_time(components(["1 mm", 2.0], "m"))


# --- curves in files ---

TABLES = {"mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1}}
TABLES |= {"materials": {"steel": {"law": "linear-elastic", "E": "1 GPa", "nu": 0.3}}}


def case_with(curve, folder):
    floor = {"axis": "z", "at": 0}
    faces = [["left", "right"], ["front", "back"], ["bottom", "top"]]
    rows = {
        "load": [{"kind": "traction", "on": "top", "value": [0, 0, 1], "curve": curve}],
        "support": [{"on": "bottom", "curve": curve}],
        "contact": [{"on": "bottom", "plane": floor, "motion": [0, 0, 1], "curve": curve}],
        "periodic": {"pairs": faces, "gradient": np.diag([2.0, 1, 1]).tolist(), "curve": curve},
    }
    return Case.from_dict({**TABLES, **rows}, folder, file="case.toml")


@pytest.mark.parametrize(
    ("text", "curve", "value"),
    [
        ("0,1\n2,5\n", {}, 2.0),
        ("# measured\n\nt;force\n0;1\n2;5\n", {}, 2.0),
        ("t, a, b\n0, 9, 1\n2, 9, 3\n", {"time": "t", "value": "b"}, 1.5),
        ("b,t\n1,0\n3,2\n", {"time": "t", "value": "b"}, 1.5),
        ("time\tb\n0 ms\t1\n2000 ms\t3\n", {}, 1.5),
    ],
)
@pytest.mark.usefixtures("serial_only")
def test_curve_in_a_file(tmp_path, text, curve, value):
    (tmp_path / "history.csv").write_text(text)
    case = case_with({"file": "history.csv", **curve}, tmp_path)
    assert case.load[0].amplitude.at(0.5) == value
    assert case.support[0].amplitude.at(0.5) == value
    assert case.contact[0].displacement_at(0.5, RAMP, 3) == [0, 0, value]
    assert case.periodic.gradient_at(0.5, RAMP)[0, 0] == 1 + value
    again = Case.from_dict(tomllib.loads(case.to_toml()), tmp_path)
    assert again.to_toml() == case.to_toml()
    assert again.load[0].amplitude.at(0.5) == value


@pytest.mark.parametrize(
    ("text", "curve", "says"),
    [
        ("0,1\n", {"file": "histroy.csv"}, "did you mean 'history.csv'"),
        ("t,a\n0,1\n", {"file": "history.csv", "value": "b"}, "no column 'b'"),
        ("0,1\n", {"file": "history.csv", "time": "t"}, "no headings"),
        ("t,a\n", {"file": "history.csv"}, "no numbers"),
        ("t,a\n0,1\n0\n", {"file": "history.csv"}, "line 3 ends too early: '0'"),
        ("0\n1\n", {"file": "history.csv"}, "two columns"),
        ("0,1\n0,2\n", {"file": "history.csv"}, "increase"),
        ("0,1\n1,x\n", {"file": "history.csv"}, "'x' is not a number, in line 2: '1,x'"),
        ("0;1\n0,5;2\n", {"file": "history.csv"}, "in line 2: '0,5;2'; decimal points, not"),
        ("0,1,2,5\n0,3,2,7\n", {"file": "history.csv"}, "are its commas decimal ones"),
    ],
)
@pytest.mark.usefixtures("serial_only")
def test_files_that_hold_no_curve(tmp_path, text, curve, says):
    (tmp_path / "history.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        case_with(curve, tmp_path)
    assert "case.toml: support[0].curve" in str(caught.value)
    assert says in str(caught.value)


def test_a_file_that_was_not_read():
    with pytest.raises(InputError) as caught:
        amplitude({"file": "history.csv"}).at(0.0)
    assert "not been read" in str(caught.value)
