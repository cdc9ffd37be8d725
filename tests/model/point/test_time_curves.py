"""Relaxation, creep and loops of a material at a point, against a standard linear solid."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dolfin_elastic import J2, LinearElastic, NeoHookean
from dolfin_elastic.case.material_report import read_laws, write
from dolfin_elastic.cli.console_materials import as_json, report_table
from dolfin_elastic.model.point import time_curves as module
from dolfin_elastic.model.point.report import material_report
from dolfin_elastic.model.point.tested import LawUnderTest
from dolfin_elastic.model.point.time_curves import TimeCurves, time_curves
from dolfin_elastic.report.laws import materials_of

SUDDEN, LONG, TAU = 1e6, 0.5e6, 2.0


def solid() -> LinearElastic:
    """A standard linear solid: its whole stress relaxes, so do uniaxial tests with one time."""
    branch = {"ratio": 1 - LONG / SUDDEN, "time": TAU}
    keys = {"viscous_on": "whole", "viscous_constants": "instantaneous"}
    return LinearElastic.model_validate({"E": SUDDEN, "nu": 0.3, "viscous": [branch], **keys})


def errors(curves: TimeCurves) -> list[float]:
    """Relative errors of relaxation, of creep, and of what the three loops lose."""
    strain, t = curves.held - 1, curves.t
    relaxation = strain * (LONG + (SUDDEN - LONG) * np.exp(-t / TAU))
    fading = np.exp(-t / TAU * LONG / SUDDEN)
    creep = strain * SUDDEN * (1 / LONG - (1 / LONG - 1 / SUDDEN) * fading)
    found = [
        np.abs(curves.relaxation / relaxation - 1).max(),
        np.abs((curves.creep - 1) / creep - 1).max(),
    ]
    for loop in curves.loops:
        x = 2 * np.pi * loop.frequency * TAU
        lost = np.pi * strain**2 * (SUDDEN - LONG) * x / (1 + x**2)
        found.append(abs(loop.lost / lost - 1))
    return found


@pytest.mark.long
def test_a_standard_linear_solid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Relaxation is exact in each step; creep and loops are of second order in its length.

    The fastest cycles are ten times as fast as the solid relaxes: the third one still drifts.
    """
    found = []
    for steps in (180, 360):
        monkeypatch.setattr(module, "_STEPS", steps)
        curves = time_curves(solid(), 1.1)
        assert curves is not None
        found.append(errors(curves))
    coarse, fine = found
    assert max(coarse[0], fine[0]) < 1e-13
    assert coarse[1] < 2e-3
    assert coarse[1] / fine[1] == pytest.approx(4, rel=0.15)
    assert coarse[2] < 1e-2
    assert coarse[3:] == pytest.approx([0, 0], abs=5e-3)
    assert np.array(coarse[3:]) / fine[3:] == pytest.approx(4, rel=0.15)


@pytest.mark.long
def test_a_rate_of_ones_own_is_as_the_law_that_is_built_in(tmp_path: Path) -> None:
    """A Maxwell branch by its rate, whose times are not told, beside one of small deviation.

    At strains of 10 % they differ by less than 1 % of the stress, and backward Euler by 1 %.
    """
    (tmp_path / "case.toml").write_text(
        """
        [materials.gel]
        energy = "mu0/2*(I1bar - 3) + K/2*(J - 1)^2 + mu1/2*(tr(Cbar*inv(Cv)) - 3)"
        history = {Cv = {start = "I", determinant = 1}}
        rate = {Cv = "(Cbar - tr(Cbar*inv(Cv))/3*Cv)/tau"}
        parameters = {mu0 = "1 MPa", mu1 = "1 MPa", K = "50 MPa", tau = "2 s"}
        [materials.built-in]
        energy = "mu0/2*(I1bar - 3) + K/2*(J - 1)^2"
        viscous = [{ratio = 1, time = "2 s"}]
        parameters = {mu0 = "1 MPa", K = "50 MPa"}
        """
    )
    laws = read_laws(str(tmp_path / "case.toml"), {})
    own, built_in = (time_curves(laws[name], 2.0) for name in ("gel", "built-in"))
    assert own is not None
    assert built_in is not None
    for one, other in ((own.relaxation, built_in.relaxation), (own.creep - 1, built_in.creep - 1)):
        there = np.interp(np.log(own.t[1:]), np.log(built_in.t[1:]), other[1:])
        assert one[1:] == pytest.approx(there, rel=0.03)


def test_a_memory_that_takes_no_time(tmp_path: Path) -> None:
    """Mullins' effect: only the first of equal cycles of a rubber that softens loses energy."""
    (tmp_path / "case.toml").write_text(
        """
        [materials.rubber]
        energy = "mu/2*(I1 - 3) - mu*ln(J) + m/r*ln(cosh(max(W - (mu/2*(I1 - 3) - mu*ln(J)), 0)/m))"
        history = {W = 0}
        next = {W = "max(W, mu/2*(I1 - 3) - mu*ln(J))"}
        parameters = {mu = "1 MPa", r = 1.6, m = "10 kPa"}
        """
    )
    law = read_laws(str(tmp_path / "case.toml"), {})["rubber"]
    report = material_report(law)
    assert report.over_time is not None
    (loop,) = report.over_time.loops
    third = len(loop.stretch) // 3
    first, last = loop.nominal[: third + 1], loop.nominal[-third - 1 :]
    assert np.trapezoid(last, loop.stretch[-third - 1 :]) == pytest.approx(0, abs=1e-9 * 1e6)
    assert np.trapezoid(first, loop.stretch[: third + 1]) > 10
    assert loop.lost > 0
    files = [path.name for path in write("rubber", report, tmp_path)]
    assert "rubber_loops.png" in files
    assert "rubber_creep.csv" not in files
    assert [f.text for f in report.findings if f.check == "loops"]


def test_nothing_that_takes_no_time_is_told() -> None:
    assert time_curves(NeoHookean(E=1e6, nu=0.3), 2.0) is None
    assert time_curves(J2(E=200e9, nu=0.3, yield_stress=250e6, hardening=2e9), 1.01) is None


def test_a_metal_that_creeps_up_to_its_hardening() -> None:
    """Under twice its yield stress Perzyna's metal flows until it has hardened to it."""
    keys = {"E": 200e9, "nu": 0.3, "yield": 250e6, "hardening": 20e9, "plastic_viscosity": 1e9}
    curves = time_curves(J2.model_validate(keys), 1.01)
    assert curves is not None
    assert curves.relaxation[0] == pytest.approx(500e6, rel=1e-9)
    assert curves.creep[-1] - 1 == pytest.approx(500e6 / 200e9 + 250e6 / 20e9, rel=1e-3)


@pytest.mark.long
def test_files_and_pages(tmp_path: Path) -> None:
    law = solid()
    report = material_report(LawUnderTest(law).given)
    assert report.over_time is not None
    finding = next(f for f in report.findings if f.check == "creep")
    assert finding.values["end"] == pytest.approx(0.2, rel=1e-6)
    assert "100 kPa" in finding.text
    files = {path.name: path for path in write("rubber", report, tmp_path)}
    rows = np.loadtxt(files["rubber_creep.csv"], delimiter=",", skiprows=1)
    assert rows[:, 2] == pytest.approx(report.over_time.creep, rel=1e-11)
    loops = np.loadtxt(files["rubber_loops.csv"], delimiter=",", skiprows=1)
    assert len(np.unique(loops[:, 0])) == 3
    assert files["rubber_loops.png"].stat().st_size > 10_000
    table = json.loads(as_json(report_table(report)))["over_time"]
    assert len(table["loops"]) == 3
    branch = {"ratio": 0.5, "time": "2 s"}
    text = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "viscous": [branch]}
    (page,) = materials_of({"materials": {"rubber": text}})
    assert any("under a nominal stress of" in str(chart) for chart in page.charts)
    assert "creep" in dict(page.constants)
