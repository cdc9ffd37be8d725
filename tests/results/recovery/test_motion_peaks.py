"""The worst stress of a motion: that of its worst state, also after a restart, on any ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.runs import begun, finished, history, summary

from dolfin_elastic import Case, LinearElastic, Problem, rectangle_body, run
from dolfin_elastic.core.si_text import number
from dolfin_elastic.results.finished.findings import extremes_of, key_figures, lines_of_motion
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.recovery.motion_peaks import MotionPeaks, _pairs
from dolfin_elastic.results.recovery.peaks import Peak
from dolfin_elastic.results.verdict import SAFEST

STRETCH = 1e-3
SLOW = 1e-6
"""Share of inertia in a bar of 1 m that is bent within 4 s: pi^2/8 1/s^2 over (1300/s)^2."""
STEEL = {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3, "density": 7850}
BAR: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [1, 0.25], "cells": [8, 2]}, "degree": 2, "unit": "m"},
    "materials": {"steel": {**STEEL, "allowable": "400 MPa"}},
    "support": [{"on": "left"}, {"on": "right", "displacement": ["free", STRETCH]}],
    "output": {"fields": ["displacement"], "checkpoint": {"every": 1}},
}
SLOWLY = {"curve": "sin(pi*t/8)^2"}
MOTION = {
    "support": [BAR["support"][0], {**BAR["support"][1], **SLOWLY}],
    "dynamics": {"end": "8 s", "dt": "1 s"},
}


def bar(**tables: Any) -> Case:
    """A bar that is bent, in motion most at 4 s, and back."""
    return Case.from_dict({**BAR, **tables})


def check_same(found: Any, known: Any) -> None:
    """Of one motion, but for round-off."""
    assert found.keys() == known.keys()
    for name, row in known.items():
        off = {"value": pytest.approx(row["value"]), "place": pytest.approx(row["place"])}
        assert found[name] == {**row, **off}


def test_a_slow_motion_is_as_bad_as_its_worst_equilibrium(folder: Path) -> None:
    """Singular at the clamped edge: the value elsewhere counts.  A restart after it keeps it."""
    for _ in run(bar(statics={}), output=folder / "statics"):
        pass
    begun(bar(**MOTION), folder / "motion", 6)
    assert finished(folder / "motion") == [7, 8]
    written, known = summary(folder / "motion"), summary(folder / "statics")["error"]
    assert set(written["motion"]) == {
        "von_mises",
        "elsewhere",
        "safety_factor",
        "safety_factor_elsewhere",
    }
    for name, row in written["motion"].items():
        assert row["value"] == pytest.approx(known[name]["value"], rel=SLOW)
        assert (row["step"], row["t"]) == (4, pytest.approx(4.0))
        for key in ("place", "part", "surface", "singular"):
            assert row[key] == known[name][key]
    assert written["extremes"]["safety_factor"]["value"] > 100  # straight again
    least = written["motion"]["safety_factor_elsewhere"]
    text = written["verdict"]["text"]
    assert text.startswith(f"not known: stress {number(least['value'], 2)} times below 400 MPa")
    assert ", t = 4 s (not at the edge of the support 'left'" in text
    assert text.endswith("but its error is not estimated in motion")
    lines = lines_of_motion(written)
    of_all = [line for line in lines if "t = 4 s" in line]
    assert [line.partition("  ")[0] for line in of_all] == [
        "largest von Mises stress",
        "largest von Mises stress, singular",
        "smallest safety factor",
        "smallest safety factor, singular",
    ]
    assert [line[:36].rstrip() for line in lines if line not in of_all] == [
        "largest von Mises stress at the end",
        "smallest safety factor at the end",
    ]
    singular = [row for row in extremes_of(written) if row.singular]
    assert [row.name.partition(",")[2] for row in singular] == [" singular"] * 2
    figure = key_figures(FinishedRun(folder / "motion"))["safety_factor"]
    assert figure.value.value == least["value"]
    assert "singular" in figure.other
    assert "at the end" not in figure.name


def test_uniform_stress(folder: Path) -> None:
    """E times the stretch at 4 s, nowhere singular; without an allowable stress a number."""
    steel = {**STEEL, "nu": 0.0}
    held = {"on": "left", "displacement": [0, "free"]}
    pulled = {"on": "right", "displacement": [STRETCH, "free"], **SLOWLY}
    beside = {"on": "bottom", "displacement": ["free", 0]}
    case = bar(
        **{**MOTION, "support": [held, beside, pulled]},
        materials={"steel": steel},
    )
    for _ in run(case, output=folder):
        pass
    written = summary(folder)
    peak = written["motion"]["von_mises"]
    assert peak["value"] == pytest.approx(210e9 * STRETCH, rel=SLOW)
    assert (peak["step"], peak["singular"]) == (4, "")
    assert written["motion"].keys() == {"von_mises", "elsewhere"}
    assert written["motion"]["elsewhere"] is None
    assert written["verdict"]["kind"] == "result"
    assert written["verdict"]["text"].startswith("largest von Mises stress 210 MPa, on ‘")
    assert ", t = 4 s" in written["verdict"]["text"]


@pytest.mark.parametrize("scheme", ["newmark", "central-differences"])
def test_every_state_counts(folder: Path, scheme: str) -> None:
    """As probes of every state have it, of a bar that is struck."""
    least = {"on": "all", "fields": ["safety_factor"], "values": ["min"]}
    struck = {"kind": "traction", "on": "right", "value": ["20 MPa", 0]}
    explicit = scheme == "central-differences"
    case = bar(
        mesh={**BAR["mesh"], "degree": 1},
        support=[{"on": "left"}],
        load=[{**struck, "curve": "sin(pi*t/1e-3)"}],
        dynamics={"scheme": scheme, "end": "2 ms"} | ({} if explicit else {"dt": "0.1 ms"}),
        regions={"all": {"box": [[-1, -1], [2, 2]]}},
        output={**BAR["output"], "probes": {"least": least}},
    )
    for _ in run(case, output=folder / "whole"):
        pass
    rows, peak = history(folder / "whole"), summary(folder / "whole")["motion"]["safety_factor"]
    worst = min(rows, key=lambda row: row["least_safety_factor_min"])
    assert peak["value"] == pytest.approx(worst["least_safety_factor_min"])
    assert (peak["step"], peak["t"]) == (worst["step"], pytest.approx(worst["t"]))
    assert 0 < rows.index(worst) < len(rows) - 1
    if explicit:
        begun(case, folder / "again", rows[rows.index(worst) + 1]["step"])
        finished(folder / "again")
        check_same(summary(folder / "again")["motion"], summary(folder / "whole")["motion"])


def test_a_worse_state_without_regular_places() -> None:
    """Then the value elsewhere is not known: that of a state that is hardly loaded is not it."""
    weak, worse = Peak(1.0, (0.5, 0.0), "", 0.0), Peak(9.0, (0.0, 0.0), "", 0.0, singular="edge")
    rows = dict(_pairs("von_mises", weak, None)) | dict(_pairs("von_mises", worse, None))
    assert rows == {"von_mises": worse, "elsewhere": worse}
    problem = Problem(rectangle_body(size=[1, 1], cells=[1, 1]), LinearElastic(E=1, nu=0))
    for peak, known in ((worse, None), (weak, weak.as_json())):
        saved = {"von_mises": worse.as_json(), "elsewhere": peak.as_json()}
        assert MotionPeaks(problem, saved).as_json()["elsewhere"] == known


def test_largest_values_of_a_motion() -> None:
    """With place and part; nothing is said of a body without stress, or before the end."""
    stress = {"value": 1.84e8, "place": [0.016, -1e-18], "part": "steel"}
    safety = {"value": 1.36, "place": [0.016, 0.0], "part": ""}
    found = {"steps": 3, "extremes": {"von_mises": stress, "safety_factor": safety}}
    materials = {"steel": {}, "rubber": {}}
    assert lines_of_motion(
        {**found, "case": {"materials": materials}, "model": {"mesh": {"metres": 0.001}}}
    ) == [
        f"{'largest von Mises stress':<36} 184 MPa at (16, 0) mm, in ‘steel’",
        f"{'smallest safety factor':<36} 1.36 at (16, 0) mm",
    ]
    of_one = lines_of_motion({**found, "case": {"materials": {"steel": {}}}})
    assert [line[37:] for line in of_one] == ["184 MPa at (0.016, 0) m", "1.36 at (0.016, 0) m"]
    unbounded = {**safety, "value": SAFEST}
    (line,) = lines_of_motion({**found, "extremes": {"safety_factor": unbounded}})
    assert "more than 1000 at" in line
    assert lines_of_motion({**found, "extremes": {"von_mises": {**stress, "value": 0.0}}}) == []
    assert lines_of_motion({**found, "steps": 0}) == []
    assert lines_of_motion({**found, "extremes": {}}) == []
