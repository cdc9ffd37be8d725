"""Cases of vibration and buckling: what may stand in them, and what they leave on disk."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Case, read_case, run
from dolfin_elastic.case.check.report import report
from dolfin_elastic.cli.app import main
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.state import Mode, State

TABLES: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [4, 1], "cells": [4, 1]}, "degree": 2},
    "materials": {
        "steel": {"law": "st-venant-kirchhoff", "E": "2 GPa", "nu": 0.3, "density": 1000}
    },
    "support": [{"on": "left"}],
    "load": [{"kind": "traction", "on": "right", "value": ["-1 MPa", 0]}],
    "output": {"frames": 8, "amplitude": 0.2},
}


def case(**tables: Any) -> Case:
    return Case.from_dict({**TABLES, **tables}, file="case.toml")


def names(folder: Path, comm: MPI.Comm) -> set[str]:
    return on_root(comm, lambda: {path.name for path in folder.iterdir()})


def frames(folder: Path) -> tuple[np.ndarray, list[str]]:
    """Times of the first animation, and which array each frame shows."""
    text = (folder / "mode_01.xdmf").read_text()
    times = np.array([float(t) for t in re.findall(r'Time Value="([^"]+)"', text)])
    return times, re.findall(r"modes_data/0001.h5:/(\w+)<", text)


def test_vibration(folder: Path, comm: MPI.Comm) -> None:
    """A table, an animation of each mode over its period, and a summary; nothing of steps."""
    found = list(run(case(modal={"count": 2}), output=folder, comm=comm))
    assert all(isinstance(mode, Mode) for mode in found)
    wanted = {"mode_01.xdmf", "mode_02.xdmf", "modes.csv", "modes_data", "summary.json"}
    assert names(folder, comm) == wanted
    if comm.rank:
        return
    times, shown = frames(folder)
    first = found[0].frequency
    assert times == pytest.approx(np.arange(8) / 8 / first, rel=1e-12)
    assert shown == [f"frame{k}" for k in (0, 1, 2, 3, 4, 3, 2, 1)]
    with h5py.File(folder / "modes_data/0001.h5") as file:
        moved = [np.array(file[f"frame{k}"]) for k in range(5)]
    assert np.max(np.linalg.norm(moved[0], axis=1)) == pytest.approx(0.2 * 4, rel=1e-12)
    for k in range(5):
        assert moved[k] == pytest.approx(np.cos(k * np.pi / 4) * moved[0], abs=1e-12)
    rows = list(csv.DictReader((folder / "modes.csv").open()))
    assert [float(row["frequency"]) for row in rows] == [mode.frequency for mode in found]
    assert float(rows[0]["omega"]) == pytest.approx(2 * np.pi * first, rel=1e-12)
    assert rows[0]["kind"] == "elastic"
    found_summary = json.loads((folder / "summary.json").read_text())
    assert found_summary["status"] == "completed"
    assert re.fullmatch(r"Krylov-Schur with factors, \d iterations?", found_summary["eigensolver"])
    assert found_summary["modes"][1]["frequency"] == found[1].frequency
    assert found_summary["whole"]["x"] == pytest.approx(4000, rel=1e-12)
    assert 0.6 < found_summary["effective_shares"]["y"] < 1.0


def test_preload_and_leftovers(folder: Path, comm: MPI.Comm) -> None:
    """The preload has its steps in files of its own; a later run removes what it does not write."""
    _, loaded = case(modal={"count": 1, "preload": True}, statics={"steps": 2}).analyses()
    found = list(run(loaded, output=folder, comm=comm))
    assert [type(step) for step in found] == [State, State, State, Mode]
    steps = {"results.xdmf", "results_data", "history.csv", "summary.json"}
    assert names(folder, comm) == steps | {"mode_01.xdmf", "modes.csv", "modes_data"}
    if comm.rank == 0:
        with h5py.File(folder / "modes_data/0001.h5") as file:
            mean = (np.array(file["frame0"]) + np.array(file["frame4"])) / 2
        # It moves about the loaded state: E/(1 - nu^2) and no lateral strain across.
        assert np.min(mean[:, 0]) == pytest.approx(-1e6 / 2e9 * 0.91 * 4, rel=2e-2)
    list(run(case(buckling={"count": 1}), output=folder, comm=comm))
    assert names(folder, comm) == {"mode_01.xdmf", "modes.csv", "modes_data", "summary.json"}
    list(run(case(statics={"steps": 1}, output={}), output=folder, comm=comm))
    assert names(folder, comm) == steps


def test_rigid_and_buckling_modes(folder: Path, comm: MPI.Comm) -> None:
    """What has no period is shown over one second."""
    free = case(support=[], load=[], modal={"count": 1})
    assert [mode.kind for mode in run(free, output=folder, comm=comm)] == 3 * ["rigid"] + [
        "elastic"
    ]
    if comm.rank == 0:
        assert frames(folder)[0] == pytest.approx(np.arange(8) / 8, rel=1e-12)
    comm.barrier()
    (mode,) = run(case(buckling={"count": 1}), output=folder, comm=comm)
    if comm.rank == 0:
        assert frames(folder)[0] == pytest.approx(np.arange(8) / 8, rel=1e-12)
        rows = list(csv.DictReader((folder / "modes.csv").open()))
        assert float(rows[0]["load_factor"]) == mode.load_factor
        assert json.loads((folder / "summary.json").read_text())["modes"][0]["kind"] == "buckling"


TWO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 1, 1}; Rectangle(2) = {2, 0, 0, 1, 1};
Physical Surface("base") = {1}; Physical Surface("lid") = {2};
Transfinite Surface {1, 2};
Transfinite Curve {1:8} = 3;
"""


def test_two_bodies(folder: Path, comm: MPI.Comm) -> None:
    """Each has its rigid modes, by name, and every frequency is there twice."""
    on_root(comm, lambda: (folder / "two.geo").write_text(TWO) and None)
    tables = {
        **TABLES,
        "mesh": {"file": "two.geo", "degree": 1},
        "support": [],
        "load": [],
        "modal": {},
    }
    both = Case.from_dict(tables, folder)
    problem = both.make_problem(both.read_body(comm))
    found = [mode for mode in both.make_solver(problem).steps() if isinstance(mode, Mode)]
    assert [mode.name for mode in found[:6]] == [
        "base: move along x",
        "base: move along y",
        "base: turn about z through (0.5, 0.5) m",
        "lid: move along x",
        "lid: move along y",
        "lid: turn about z through (2.5, 0.5) m",
    ]
    elastic = np.array([mode.frequency for mode in found[6:]]).reshape(3, 2)
    assert elastic[:, 0] == pytest.approx(elastic[:, 1], rel=1e-8)
    assert np.all(np.diff(elastic[:, 0]) > 1e-3 * elastic[0, 0])
    assert found[0].effective["x"] == pytest.approx(1000, rel=1e-9)


@pytest.mark.usefixtures("serial_only")
def test_picture(folder: Path, comm: MPI.Comm) -> None:
    """Each mode is drawn; what has no size is refused."""
    output = {"pictures": [{"file": "m.png"}], "frames": 1}
    list(run(case(modal={"count": 2}, output=output), output=folder, comm=comm))
    assert {"m_0001.png", "m_0002.png"} < names(folder, comm)
    output = {"pictures": [{"field": "von_mises"}]}
    with pytest.raises(InputError, match=r"output.pictures\[0\].field: a mode has no 'von_mises'"):
        report(case(modal={}, output=output), comm=comm)


def test_tables() -> None:
    """Beside [statics], with a preload; units; back to TOML."""
    read = case(modal={"below": "2 kHz", "preload": True}, statics={"steps": 2})
    assert read.modal is not None
    assert read.modal.below == 2000
    assert [one.analysis for one in read.analyses()] == ["statics", "modal"]
    assert Case.from_dict(read.to_dict(), file="case.toml") == read
    for tables, text in (
        ({"modal": {"count": 3, "below": 2}}, "modal: count and below given together"),
        ({"modal": {"below": "2 m"}}, 'modal.below: .*in Hz, for example "440 Hz"'),
        ({"modal": {"cout": 2}}, "did you mean 'count'"),
    ):
        with pytest.raises(InputError, match=text):
            case(**tables)
    with pytest.raises(InputError, match="materials.steel.density: this key is missing; .modal. n"):
        steel = {"law": "linear-elastic", "E": 1, "nu": 0}
        report(case(modal={}, materials={"steel": steel}))


def test_check(comm: MPI.Comm) -> None:
    """A free body is right in [modal], not in [buckling]; loads without preload are noted."""
    found = report(case(support=[], modal={}), comm=comm)
    assert found.analysis == "modal"
    assert found.linear_solver == "54 unknowns, direct solver"
    assert any("modes are those at rest" in note for note in found.notes)
    with pytest.raises(InputError, match="there is no support"):
        report(case(support=[], buckling={}), comm=comm)


def test_command_line(
    folder: Path,
    comm: MPI.Comm,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The table on screen."""
    if comm.size > 1:
        pytest.skip("tells on rank 0 only")
    monkeypatch.chdir(folder)  # docker/run refuses an output that it would not keep
    for key, texts in (
        (
            "modal",
            (
                "done: 2 modes",
                "solver: Krylov-Schur with factors",
                "[Hz]",
                "of the body's mass that a mode moves",
            ),
        ),
        ("buckling", ("load factor", "mode_01.xdmf, mode_02.xdmf, modes.csv, summary.json")),
    ):
        file = folder / f"{key}.toml"
        file.write_text(case(**{key: {"count": 2}}).to_toml())
        assert read_case(file).analysis == key
        monkeypatch.setattr("sys.argv", ["x", "run", str(file), "-o", str(folder / key)])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 0
        out = capsys.readouterr().out
        assert [text for text in texts if text not in out] == [], out
