"""Verdicts on one part from several runs: each row, all of them together, and runs of two parts."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import pytest

from dolfin_elastic.cli.tools.report import _range
from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.report.safety import Safety, safety_of
from dolfin_elastic.report.several import write_pages
from dolfin_elastic.results.finished.run import FinishedRun

STEEL = {"law": "linear-elastic", "E": "200 GPa", "nu": 0.3, "allowable": "235 MPa"}
LARGE = {"law": "st-venant-kirchhoff", "E": 2e11, "nu": 0.3}
LINEAR = {"verdict": "stable", "reason": "laws of small strains know no buckling; ..."}
STABLE = {"verdict": "stable"}


def finished(
    folder: Path, name: str, case: dict[str, Any] | None = None, **summary: Any
) -> FinishedRun:
    """A folder with a summary alone."""
    (folder / name).mkdir()
    mesh = {"dim": 3, "volume": 2.0, "extent": [2, 1, 1], "metres": 1.0}
    tables = {"materials": {"steel": STEEL}, "support": [{"on": "left"}], **(case or {})}
    content = {
        **{"status": "completed", "cells": 100, "dofs": 900, "degree": 2, "steps": 1, "t": 1.0},
        **{"load_factor": 1.0, "case": tables, "model": {"mesh": mesh}},
        **summary,
    }
    (folder / name / "summary.json").write_text(json.dumps(content), encoding="utf-8")
    return FinishedRun(folder / name)


def stressed(folder: Path, factor: float = 2.5, **other: Any) -> FinishedRun:
    row = {"value": factor, "place": [0.5, 0, 0], "part": "steel", "error": 0.05}
    peaks = {"safety_factor": row, "von_mises": {**row, "value": 235e6 / factor}}
    values = {"extremes": peaks, "error": peaks, "stability": LINEAR, **other}
    return finished(folder, "strength", **values)


def buckled(folder: Path, *factors: float, case: dict[str, Any] | None = None) -> FinishedRun:
    modes = [{"mode": k, "kind": "buckling", "load_factor": x} for k, x in enumerate(factors, 1)]
    tables = {"buckling": {}, "materials": {"steel": LARGE}, **(case or {})}
    return finished(folder, "buckling", tables, steps=0, modes=modes)


def swinging(folder: Path, *frequencies: float) -> FinishedRun:
    modes = [
        {"mode": k, "kind": "elastic", "frequency": x, "shape": "bending in y"}
        for k, x in enumerate(frequencies, 1)
    ]
    return finished(folder, "modes", {"modal": {}}, steps=0, modes=modes)


def judged(*runs: FinishedRun, excitation: tuple[float, float] | None = None) -> Safety:
    return safety_of(runs, [run.folder.name for run in runs], excitation)


def rows_of(safety: Safety) -> list[tuple[str, int, str]]:
    return [(row.what, row.run, row.verdict) for row in safety.rows]


def test_all_of_it_holds(tmp_path: Path) -> None:
    """Stress, buckling and frequencies: one row each, and the same body in other words."""
    runs = stressed(tmp_path), buckled(tmp_path, -3.0, 12.0), swinging(tmp_path, 5.0, 40.0)
    safety = judged(*runs, excitation=(10.0, 20.0))
    words = [("strength", 1, "holds"), ("stability", 2, "holds"), ("frequencies", 3, "holds")]
    assert rows_of(safety) == words
    assert [row.value and row.value.value for row in safety.rows] == [2.5, 12.0, 5.0]
    assert (safety.kind, safety.differences) == ("good", ())  # "200 GPa" is 2e11
    assert safety.text == "Holds: strength, stability and frequencies"
    assert "100 elements of degree 2, 2 m" in safety.same
    assert "5 Hz lies below it, 40 Hz above" in safety.rows[2].text


@pytest.mark.parametrize(
    ("frequencies", "excitation", "verdict", "words"),
    [
        ((5.0, 15.0, 40.0), (10.0, 20.0), "does not hold", "mode 2, 15 Hz (bending in y)"),
        ((5.0, 10.0), (10.0, 20.0), "does not hold", "mode 2"),
        ((5.0, 8.0), (10.0, 20.0), "cannot be judged", "known up to 8 Hz only"),
        ((25.0, 40.0), (10.0, 20.0), "holds", "the lowest is 25 Hz"),
        ((5.0, 8.0), None, "cannot be judged", "no range of excitation is given"),
    ],
)
def test_frequencies(
    tmp_path: Path,
    frequencies: tuple[float, ...],
    excitation: tuple[float, float] | None,
    verdict: str,
    words: str,
) -> None:
    """A mode among those that are excited; none, but more may follow; none at all."""
    (row,) = judged(swinging(tmp_path, *frequencies), excitation=excitation).rows
    assert row.verdict == verdict
    assert words in row.text


@pytest.mark.parametrize(
    ("factor", "stability", "verdicts"),
    [
        (0.9, LINEAR, ["does not hold"]),
        (5.0, LINEAR, ["cannot be judged"]),  # deflections add to the effect of the loads
        (5.0, STABLE, ["holds", "holds"]),  # which a run with large displacements has seen
        (12.0, LINEAR, ["holds"]),
        (12.0, {"verdict": "unstable"}, ["does not hold", "holds"]),
        (12.0, {"verdict": None, "reason": "?"}, ["cannot be judged", "holds"]),
    ],
)
def test_stability(
    tmp_path: Path, factor: float, stability: dict[str, Any], verdicts: list[str]
) -> None:
    """The factor of buckling beside the equilibrium of statics, which small strains leave open."""
    safety = judged(stressed(tmp_path, stability=stability), buckled(tmp_path, factor))
    assert [row.verdict for row in safety.rows if row.what == "stability"] == verdicts


def test_strength(tmp_path: Path) -> None:
    """It is judged apart from stability; what is known too badly is not judged."""
    for name, factor, verdict in (("a", 2.5, "holds"), ("b", 0.8, "does not hold")):
        (tmp_path / name).mkdir()
        rows = judged(stressed(tmp_path / name, factor), swinging(tmp_path / name, 5.0)).rows
        assert (rows[0].verdict, rows[0].what) == (verdict, "strength")
        assert rows[1].what == "stability"  # small strains, and no [buckling] among the runs
        assert rows[1].verdict == "cannot be judged"
    failed = finished(tmp_path, "failed", status="failed")
    assert rows_of(judged(failed)) == [("strength", 1, "cannot be judged")]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"materials": {"steel": {**LARGE, "E": "210 GPa"}}}, "E of ‘steel’"),
        ({"materials": {"iron": LARGE}}, "the material ‘steel’ and the material ‘iron’"),
        ({"support": [{"on": "right"}]}, "the supports"),
    ],
)
def test_other_parts(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    """No verdict on all, whatever holds of each; the page is made, with a warning."""
    safety = judged(stressed(tmp_path), buckled(tmp_path, 12.0, case=change))
    assert safety.kind == "warn"
    assert safety.text.startswith("No verdict on one part, the runs differ; holds: strength")
    assert safety.differences == (f"‘buckling’ against ‘strength’: {words}",)


def test_other_meshes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Finer elements are of the same body, unless its volume has changed."""
    mesh = {"dim": 3, "volume": 2.004, "extent": [2, 1, 1]}
    first, finer = stressed(tmp_path), finished(tmp_path, "finer", cells=800, model={"mesh": mesh})
    assert "‘finer’ has another mesh of it: 800 elements" in judged(first, finer).same
    mesh["volume"] = 2.5
    other = finished(tmp_path, "other", cells=800, model={"mesh": mesh})
    (difference,) = judged(first, other).differences
    assert "the body (volumes 2 m³ and 2.5 m³)" in difference
    with caplog.at_level(logging.WARNING):
        page = write_pages([first.folder, other.folder], tmp_path / "page.html")
    assert "not of one part" in caplog.text
    assert "The runs are not of one part" in page.read_text(encoding="utf-8")


def test_range() -> None:
    """Two frequencies in ascending order, with units or in Hz."""
    assert _range(None) is None
    assert _range(("2", "5 kHz")) == (2.0, 5000.0)
    for words in (("5 Hz", "2 Hz"), ("2 m", "5 m"), ("-1", "2"), ("x", "y")):
        with pytest.raises(CaseError, match="excitation"):
            _range(words)


def test_motion(tmp_path: Path) -> None:
    """The largest displacement of all times; its stress has no estimated error."""
    row = {"value": 2.0, "place": [0.5, 0, 0], "part": "steel", "t": 0.2}
    peaks = {"safety_factor": row, "von_mises": {**row, "value": 1e8}}
    folder = finished(tmp_path, "gust", {"dynamics": {}}, extremes=peaks, motion=peaks).folder
    text = "step,t,max_displacement,kinetic_energy\n1,0.1,0.5,1\n2,0.2,0.75,1\n3,0.3,0.25,1\n"
    (folder / "history.csv").write_text(text)
    (found,) = judged(FinishedRun(folder)).rows
    assert (found.what, found.verdict) == ("motion", "cannot be judged")
    assert found.text.endswith("; largest displacement 750 mm at t = 200 ms")
