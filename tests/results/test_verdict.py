"""The verdict on a run: each kind from the numbers of its summary, and of a computed one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dolfin_elastic import Case, run
from dolfin_elastic.report.words import what_was_computed
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import Verdict, verdict_of

PEAK = {"value": 4.0, "place": [0.1, 0.0, 0.005], "part": "steel", "error": 0.1}
PEAK |= {"surface": "fillet", "singular": "", "unresolved": ""}
RIM = {**PEAK, "value": 0.8, "singular": "the edge of the support 'left'"}
RIM["place"] = [0.1, 0.03, 0.045]
CASE = {"materials": {"steel": {"allowable": "235 MPa"}}}
RELEASED = {"on": "t", "curve": [[0, 0], [0.5, 1], [1, 0], [60, 0]]}
RECORDS = [
    {"value": [{"table": [[0, 0], [1, 1e7], [2, 0]]}, 0]},
    {"moment": [{"file": "m.csv", "unit": "N*m"}]},
]


def summary(**changed: Any) -> dict[str, Any]:
    model = {"mesh": {"metres": 0.001}}
    base = {"status": "completed", "steps": 1, "t": 1.0, "case": CASE, "model": model}
    return {**base, "stability": {"verdict": "stable"}, **changed}


def of_safety(peak: dict[str, Any], **more: Any) -> dict[str, Any]:
    return summary(error={"safety_factor": peak, "von_mises": peak, **more})


UNLOADED = {"max_displacement": 2.0, "step": 3}
STRESS = {**PEAK, "value": 9.27e7}
LAST = {"extremes": {"safety_factor": {"value": 3.0, "place": [0.0, 0.0, 0.0], "part": "steel"}}}
IN_MOTION = {key: value for key, value in PEAK.items() if key not in ("error", "unresolved")}
IN_MOTION |= {"value": 0.8, "t": 0.012, "step": 24}
MODES = [
    {"kind": "rigid", "frequency": 0.0},
    {"kind": "elastic", "frequency": 208.6, "effective_x": 0.02, "effective_y": 0.33},
    {"kind": "elastic", "frequency": 101.0, "effective_x": 0.02, "effective_y": 0.33},
]


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (of_safety(PEAK), "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’"),
        (
            of_safety(RIM, safety_factor_elsewhere={**PEAK, "surface": ""}),
            "holds: 4 times below 235 MPa, ± 10 %, at (100, 0, 5) mm "
            "(not at the edge of the support 'left', 50 mm away: singular)",
        ),
        (of_safety(RIM), "not known: stress 1.2 times above 235 MPa, on ‘fillet’, but it is"),
        (
            of_safety({**PEAK, "value": 0.8}),
            "fails: von Mises stress 293.8 MPa is 1.2 times the allowable 235 MPa, ± 10 %",
        ),
        (
            of_safety({**PEAK, "value": 0.8, "error": 9.1}),
            "not known: stress 1.2 times above 235 MPa, on ‘fillet’, but it is known to 910 %",
        ),
        (
            of_safety({**PEAK, "value": 4.05e-5, "singular": "an edge"}),
            "not known: stress 25000 times above 235 MPa, on ‘fillet’, but it is singular at an",
        ),
        (of_safety({**PEAK, "value": 0.4, "error": 0.5}), "fails: von Mises stress 587.5 MPa is"),
        (of_safety({**PEAK, "value": 1.06}), "not known: stress 1.06 times below 235 MPa, ± 10 %"),
        (of_safety({**PEAK, "error": 0.4}), "not known: stress 4 times below 235 MPa, on ‘fillet’"),
        (
            of_safety({**PEAK, "error": None}, may_be_larger={"unresolved": "an element turns"}),
            "not known: stress 4 times below 235 MPa, on ‘fillet’, but an element turns",
        ),
        (
            {**of_safety(PEAK), "stability": {"verdict": "not judged", "reason": "flutter"}},
            "not known: stress 4 times below 235 MPa, ± 10 %, on ‘fillet’, "
            "but its stability is not judged: flutter",
        ),
        (of_safety({**PEAK, "value": 1000.0}), "holds: more than 1000 times below 235 MPa"),
        ({**of_safety(PEAK), "case": {}}, "holds: 4 times below the allowable stress, ± 10 %"),
        (
            {**of_safety(PEAK), "stability": {"verdict": "stable", "may_buckle": True}},
            "not known: stress 4 times below 235 MPa, ± 10 %, on ‘fillet’, but so slender a part",
        ),
        (
            {**of_safety(PEAK), "stability": None},
            "not known: stress 4 times below 235 MPa, ± 10 %, on ‘fillet’, "
            "but its stability is not judged: no reason is given",
        ),
        (
            {**of_safety(PEAK), "audit": {"verdict": "warn", "reasons": ["energy: 4 %"]}},
            "not known: stress 4 times below 235 MPa, ± 10 %, on ‘fillet’, "
            "but the audit has doubts: energy: 4 %",
        ),
        (
            {**of_safety(PEAK), "max_displacement": 1.0, "largest": UNLOADED},
            "not known: stress 4 times below 235 MPa, ± 10 %, on ‘fillet’, "
            "but that is the end of the run alone: it was deformed more in step 3",
        ),
        (
            {**summary(**LAST), "max_displacement": 1.0, "largest": UNLOADED},
            "not known: stress 3 times below 235 MPa, at (0, 0, 0) mm, but "
            "that is the end of the run alone: it was deformed more in step 3",
        ),
        (
            {**summary(**LAST), "unloaded": {"step": 2, "load_factor": 0.5}},
            "not known: the stress at the end is nothing but round-off; the part was strained "
            "most in step 2, at load parameter 0.5: a run with statics.end = 0.5 is judged there",
        ),
        (
            summary(unloaded={"step": 2, "load_factor": 3.0}, timed=True),
            "the stress at the end is nothing but round-off; the part was strained most in step "
            '2, at t = 3 s: a run with statics.end = "3 s" is judged there',
        ),
        (of_safety({**PEAK, "value": None}), "largest displacement not known, without stress"),
        (
            summary(**LAST),
            "not known: stress 3 times below 235 MPa, at (0, 0, 0) mm, but "
            "that is the end of the motion alone, and its error is not estimated in motion",
        ),
        (
            summary(**LAST, motion={"safety_factor": {**IN_MOTION, "value": 1.2}}),
            "not known: stress 1.2 times below 235 MPa, on ‘fillet’, t = 12 ms, but "
            "its error is not estimated in motion",
        ),
        (
            summary(**LAST, motion={"safety_factor": RIM, "safety_factor_elsewhere": IN_MOTION}),
            "fails: von Mises stress 293.8 MPa is 1.2 times the allowable 235 MPa, on ‘fillet’, "
            "t = 12 ms (not at the edge of the support 'left', 50 mm away: singular)",
        ),
        (
            summary(**LAST, motion={"von_mises": {**IN_MOTION, "value": 9.27e7}}),
            "not known: stress 3 times",
        ),
        (
            summary(motion={"von_mises": {**IN_MOTION, "value": 9.27e7}}),
            "largest von Mises stress 92.7 MPa, on ‘fillet’, t = 12 ms",
        ),
        (
            summary(error={"von_mises": STRESS}),
            "largest von Mises stress 92.7 MPa, ± 10 %, on ‘fillet’",
        ),
        (
            summary(error={"von_mises": {**STRESS, "error": 0.5}}),
            "not known: the largest von Mises stress, on ‘fillet’: it is known to 50 % only",
        ),
        (summary(extremes={"displacement": {"value": 1e-3}}), "largest displacement 1 mm"),
        (
            {**of_safety(PEAK), "audit": {"verdict": "fail", "reasons": ["forces: 3 %"]}},
            "not known: the audit fails: forces: 3 %",
        ),
        ({**of_safety(PEAK), "stability": {"verdict": "unstable"}}, "fails: the equilibrium is"),
        (
            {**of_safety(PEAK), "load_factor": 0.5, "case": {**CASE, "statics": {"end": 0.5}}},
            "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’; with 50 % of the load",
        ),
        (
            {**of_safety(PEAK), "load_factor": 2.0, "case": {**CASE, "statics": {"end": 2}}},
            "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’; with 200 % of the load",
        ),
        (
            {
                **of_safety(PEAK),
                "load_factor": 2.0,
                "case": {**CASE, "load": [{"value": {"field": "p", "file": "thermal.vtu"}}]},
            },
            "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’; with 200 % of the load",
        ),
        *(
            (
                {**of_safety(PEAK), "load_factor": 2.0, "case": {**CASE, "load": [load]}},
                "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’; at load parameter 2",
            )
            for load in ({"on": "t", "curve": [[0, 1], [2, 3]]}, {"value": ["5 - t", 0]}, *RECORDS)
        ),
        (
            {**of_safety(PEAK), "load_factor": 0.3, "case": {**CASE, "statics": {"end": 0.5}}},
            "not known: 4 times below 235 MPa, ± 10 %, on ‘fillet’, but the run has ended early; w",
        ),
        (
            {**of_safety(PEAK), "load_factor": 0.3, "timed": True},
            "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’",
        ),
        (
            {**of_safety(PEAK), "load_factor": 0.3, "energies": {"relaxing": 0.0}},
            "holds: 4 times below 235 MPa, ± 10 %, on ‘fillet’",
        ),
        (
            {**of_safety(PEAK), "limit_points": [0.153, 0.4]},
            "not known: 4 times below 235 MPa, ± 10 %, on ‘fillet’, but it buckles, tips over or "
            "snaps through at 15 % of the load",
        ),
        (
            summary(status="failed", load_factor=0.153, diagnosis={"cause": "unstable"}),
            "fails: no stable equilibrium beyond 15 % of the load: it buckles",
        ),
        (summary(status="failed", steps=0), "not known: no solution was found in the first step"),
        (
            summary(status="failed", load_factor=0.5),
            "not known: no solution was found beyond 50 % of the load",
        ),
        (
            summary(status="failed", load_factor=0.5, case={"load": [RELEASED]}),
            "not known: no solution was found beyond load parameter 0.5",
        ),
        (
            summary(status="failed", load_factor=60.0, timed=True, case={"load": [RELEASED]}),
            "not known: no solution was found beyond t = 60 s",
        ),
        (
            summary(status="stopped", t=0.2, case={"dynamics": {"end": 1}}),
            "not known: the run was stopped after t = 200 ms",
        ),
        (
            summary(modes=MODES, whole={"x": 1.0, "y": 1.0}),
            "lowest natural frequency 101 Hz: 33 % of the mass",
        ),
        (summary(modes=[{"kind": "unstable", "frequency": 0.0}]), "fails: the loaded part is"),
        (
            summary(modes=[{"kind": "buckling", "load_factor": f} for f in (-0.5, 3.25, 4.0)]),
            "it buckles at 3.25 times the load, without imperfections",
        ),
        (
            summary(modes=[{"kind": "buckling", "load_factor": 0.22}]),
            "fails: it buckles at 0.22 times the load",
        ),
        (
            summary(modes=[{"kind": "buckling", "load_factor": -0.22}]),
            "it buckles under loads of the opposite sign only",
        ),
    ],
)
def test_verdict(content: dict[str, Any], text: str) -> None:
    found = verdict_of(content)
    assert found is not None
    assert found.text.startswith(text)
    kinds = [kind for kind in ("holds", "fails", "not known") if text.startswith(f"{kind}: ")]
    assert found.kind == (kinds[0] if kinds else "result")


def test_what_has_yielded_comes_first() -> None:
    """A stress of the end, with the load off, says nothing of the way."""
    numbers = {"yielded_fraction": 0.24, "max_plastic_strain": 0.0084}
    content = of_safety(PEAK) | {"numbers": numbers, "max_displacement": 0.0019477}
    found = verdict_of(content)
    assert found is not None
    assert found.kind == "result"
    assert found.text == (
        "24 % of the volume has yielded, plastic strain up to 0.84 %; displacement at the end up "
        "to 1.948 mm"
    )
    nothing = {"yielded_fraction": 0.0, "max_plastic_strain": 0.0}
    untouched = verdict_of(content | {"numbers": nothing})
    assert untouched is not None
    assert untouched.kind == "holds"


@pytest.mark.parametrize(
    ("rows", "acts"),
    [
        ({"load": [RELEASED, RELEASED]}, False),
        ({"load": [{"on": "t", "curve": "load-unload"}]}, False),
        ({"load": [RELEASED, {"on": "t"}]}, True),
        ({"load": [{"on": "t", "curve": [[0, 0], [1, 0.1]]}]}, True),
        ({"load": [{"on": "t", "curve": {"file": "a.csv"}}]}, True),
        ({"load": [RELEASED], "support": [{"on": "a"}, {"on": "b", "moment": 3.0}]}, True),
        ({"support": [{"on": "a"}]}, True),
    ],
    ids=str,
)
def test_a_part_that_was_unloaded_is_said_to_be(rows, acts, tmp_path):
    """Not that it has its full loads."""
    content = {**of_safety(PEAK), "load_factor": 1.0, "case": {**CASE, **rows}}
    found = verdict_of(content)
    assert found is not None
    assert found.text.endswith("; no load acts at the end") != acts
    (tmp_path / "summary.json").write_text(json.dumps({**content, "steps": 4}), encoding="utf-8")
    told = " ".join(what_was_computed(FinishedRun(tmp_path), dim=3))
    assert ("; no load acts at the end." in told) != acts
    full = not any("curve" in row for row in rows.get("load", ()))
    assert ("full values" in told) == full


@pytest.mark.parametrize(
    "key",
    [
        "stability",
        "audit",
        "case",
        "model",
        "error",
        "extremes",
        "largest",
        "whole",
        "modes",
        "limit_points",
        "diagnosis",
        "energies",
    ],
)
@pytest.mark.parametrize("value", ["text", 1, [1], {"mesh": 1, "materials": [], "reasons": 1}])
def test_of_strangers_summary(key: str, value: object) -> None:
    """Whatever a file of a stranger has in place of a table, there is a verdict."""
    peak = {**PEAK, "place": 1, "part": [1]}
    for content in (of_safety(peak), summary(modes=MODES), summary(status="failed")):
        assert verdict_of({**content, key: value}) is not None


@pytest.mark.parametrize("content", [summary(status="running"), summary(steps=0), {}])
def test_no_verdict(content: dict[str, Any]) -> None:
    assert verdict_of(content) is None


@pytest.mark.parametrize(("force", "kind"), [(-10e3, "not known"), (-100.0, "holds")])
def test_a_column_that_may_buckle(force: float, kind: str, folder: Path) -> None:
    """At 4.6 times Euler's load small strains see no buckling, which is said.

    Euler, clamped and free: pi^2 E I/(4 L^2) = 2.7 kN of 210 GPa, 10 mm square and 400 mm.
    """
    case = Case(
        mesh={"box": {"size": [0.4, 0.01, 0.01], "cells": [10, 1, 1]}, "degree": 2},
        materials={"steel": {"material": "steel S235"}},
        support=[{"kind": "fixed", "on": "left"}],
        load=[{"kind": "force", "on": "right", "value": [force, 0, 0]}],
    )
    for _ in run(case, output=folder):
        pass
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert found["verdict"]["kind"] == kind
    assert found["stability"]["may_buckle"] == (kind == "not known")
    assert Verdict(**found["verdict"]) == verdict_of(found)
