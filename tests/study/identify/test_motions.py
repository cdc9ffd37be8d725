"""Derivatives by linear solutions against differences of fourth order of whole runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.stacked import stacked

from dolfin_elastic import Case
from dolfin_elastic.study.gradient.parameters import WEIGHTS
from dolfin_elastic.study.identify import runs as runs_module
from dolfin_elastic.study.identify.measured import Measured, MeasuredCurve, MeasuredField, Number
from dolfin_elastic.study.identify.runs import Runs
from dolfin_elastic.study.identify.unknowns import read_unknowns

CLOSE = {"gap_tolerance": "1e-10 m"}
GEL = {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}
FLAT = {"rectangle": {"size": [2, 1], "cells": [6, 3]}}
ROLLER = {"cylinder": {"axis": "z", "point": [0.1, 1.5], "radius": "0.5 m"}}
HELD = [{"on": "bottom", "name": "bottom"}, {"on": "left", "displacement": [0, "free"]}]
STEP = 1e-3


def on_an_obstacle(degree: int, **more: Any) -> Case:
    rolled = {"on": "top", "name": "roller", **ROLLER, "motion": [0, -0.08], **CLOSE}
    return Case.from_dict(
        {
            "mesh": {**FLAT, "degree": degree},
            "materials": {"gel": GEL},
            "statics": {"rtol": 1e-12},
            "support": HELD,
            "contact": [rolled],
            **more,
        }
    )


def curve(name: str, times: list[float]) -> MeasuredCurve:
    at = np.array(times)
    return MeasuredCurve(Number.read("t"), Number.read(name), at, np.ones(len(at)))


def field(points: list[list[float]]) -> MeasuredField:
    n = len(points)
    never = np.full(n, np.nan)
    return MeasuredField(np.array(points), np.ones((n, 2)), (0, 1), never, (0,) * n)


def compare(case: Case, sets: list[Measured], keys: list[str], rel: float = 1e-6) -> None:
    """One run has what differences of others tell."""
    unknowns = read_unknowns(case, keys, {})
    runs = Runs(case, unknowns, sets)
    values = np.array([one.constant.start for one in unknowns])
    runs.plan(values)
    count, ends = runs.count, (values, np.zeros(len(values)), np.full(len(values), np.inf))
    numbers, slopes = runs.jacobian(values, *ends)
    assert runs.count == count + 1
    for i, value in enumerate(values):
        parts = []
        for k, weight in WEIGHTS.items():
            changed = values.copy()
            changed[i] += k * STEP * value
            parts.append(weight / STEP * runs.numbers(changed))
        whole, told = np.sum(parts, axis=0), value * slopes[:, i]
        size = np.maximum(np.abs(whole), 0.1 * np.abs(numbers))
        assert np.all(np.abs(told - whole) <= rel * size)


KEYS = ["materials.gel.E", "materials.gel.nu"]
POINTS = field([[0.5, 0.9], [1.5, 0.5]])
ON_TOP = [{"on": "top", "kind": "pressure", "value": "20 kPa"}]
FLOOR = {"on": "bottom", "plane": {"point": [0, -0.01], "normal": [0, 1]}, **CLOSE}
PUSHED = {"on": "top", "name": "roller", **ROLLER, "force": "8 kN", "direction": [0, -1], **CLOSE}
OBSTACLES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "moved": ({}, ["reaction_x of left", "reaction_y of bottom"]),
    "pressed": (
        {
            "support": [{"on": "left", "name": "left"}, {"on": "right"}],
            "contact": [FLOOR],
            "load": ON_TOP,
        },
        ["reaction_y of left"],
    ),
    "pushed": ({"contact": [PUSHED]}, ["reaction_x of left", "tip_y"]),
}


QUADRATIC = pytest.param(2, marks=pytest.mark.long)


@pytest.mark.parametrize("degree", [1, QUADRATIC])
@pytest.mark.parametrize(
    "name", ["moved", *(pytest.param(one, marks=pytest.mark.long) for one in list(OBSTACLES)[1:])]
)
def test_obstacles(name: str, degree: int) -> None:
    """Also reactions where supports hold what presses; a force moves a roller."""
    more, names = OBSTACLES[name]
    sets = [*(curve(one, [0.6, 1.0]) for one in names), POINTS]
    output = {"output": {"probes": {"tip": [1.9, 0.9]}}}
    compare(on_an_obstacle(degree, **output, **more), sets, KEYS)


TWO = {
    "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}},
    "materials": {"lower": {**GEL, "E": "0.5 MPa", "on": "lower"}, "upper": {**GEL, "E": "2 MPa"}},
    "support": [{"on": "bottom", "name": "bottom"}, {"on": "top", "displacement": [0, "free"]}],
    "load": [{"on": "top", "kind": "pressure", "value": "0.1 MPa"}],
    "contact": [{"between": ["above", "below"], **CLOSE}],
    "statics": {"rtol": 1e-12},
}


@pytest.mark.parametrize("degree", [1, QUADRATIC])
def test_two_bodies(degree: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their faces cut each other anew where they move, which the tangent does not know."""
    body = stacked(size=(1.0, 0.6), lower=(4, 3), upper=(5, 3))
    monkeypatch.setattr(runs_module, "read_body", lambda *_: body)
    sets = [curve("reaction_y of bottom", [1.0]), field([[0.3, 0.5], [0.7, 0.9]])]
    case = Case.from_dict({**TWO, "mesh": {**TWO["mesh"], "degree": degree}})
    compare(case, sets, ["materials.lower.E", "materials.upper.nu"])


FREE = {"displacement": [0, "free"], "rotation": "free", "force": [0, "-8 kN"]}
OTHERS: dict[str, dict[str, Any]] = {
    "unsymmetric": {
        "support": [{"on": "left", "name": "left"}],
        "load": [{"on": "right", "kind": "pressure", "value": "30 kPa"}, *ON_TOP],
    },
    "rigid": {
        "support": [{"on": "left", "name": "left"}, {"on": "right", "kind": "rigid", **FREE}]
    },
    "iterated": {
        "support": [{"on": "left", "name": "left"}],
        "load": ON_TOP,
        "contact": [FLOOR],
        "solver": {"method": "iterative"},
    },
}


@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.long) for one in OTHERS])
def test_other_tangents(name: str) -> None:
    """Follower loads, a rigid surface that a force turns, and a solver that has no factors."""
    at_edge = field([[0.5, 0.9], [2.0, 0.0], [2.0, 1.0]])
    case = on_an_obstacle(1, **{"contact": [], **OTHERS[name]})
    compare(case, [curve("reaction_y of left", [0.6, 1.0]), at_edge], KEYS)
