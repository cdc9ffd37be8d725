"""Modes as exports: all of them as states, or the period of one; against the animations' files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.case.check.report import report
from dolfin_elastic.cli.tools.convert import convert
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.results.exports.export import export
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.finished.modes import as_modes
from dolfin_elastic.results.finished.run import FinishedRun

pytestmark = pytest.mark.usefixtures("serial_only")

TABLES: dict[str, Any] = {
    "mesh": {"box": {"size": [4, 1, 0.5], "cells": [4, 1, 1]}, "degree": 1},
    "materials": {"a": {"law": "linear-elastic", "E": "2 GPa", "nu": 0.3, "density": 1000}},
    "support": [{"on": "left"}],
    "modal": {"count": 2},
    "output": {"frames": 8, "exports": [{"file": "a.frd"}, {"file": "a.ply"}]},
}


@pytest.fixture(autouse=True)
def _anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results in /tmp go with docker/run's sandbox, which is right here."""
    monkeypatch.delenv("DOLFIN_ELASTIC_SHOWN", raising=False)


@pytest.fixture(scope="module")
def results(folder_of_module: Path) -> Path:
    """Results of two modes, with the exports of the case."""
    list(run(Case.from_dict(TABLES), output=folder_of_module / "beam", comm=MPI.COMM_SELF))
    return folder_of_module / "beam"


def moved(results: Path, mode: int, frame: int = 0) -> Any:
    with h5py.File(results / f"modes_data/{mode:04d}.h5") as file:
        return np.array(file[f"frame{frame}"])


def frequencies(results: Path) -> list[float]:
    rows = csv.DictReader((results / "modes.csv").open())
    return [float(row["frequency"]) for row in rows]


def test_all_modes(results: Path) -> None:
    """The case's exports have a state for each mode; .frd says that these are modes.

    An `exports` of modes left nothing at all, and said nothing.
    """
    text = (results / "a.frd").read_text()
    heads = [line for line in text.splitlines() if line.startswith("  100CL")]
    assert [float(line[12:24]) for line in heads] == pytest.approx(frequencies(results), rel=1e-6)
    assert [line[56:58] for line in heads] == [" 2", " 2"]  # a frequency
    assert [int(k.split()[1]) for k in text.splitlines() if k.startswith("    1PMODE")] == [1, 2]
    assert {path.name for path in results.glob("*.ply")} == {"a_0000.ply", "a_0001.ply"}


def test_a_load_factor_below_zero(folder: Path) -> None:
    """A bar in tension buckles if its load is turned round; "100CL" had 1E-99 for it."""
    tables = {**TABLES, "buckling": {"count": 1, "negative": True}}
    del tables["modal"]
    tables["load"] = [{"kind": "traction", "on": "right", "value": [1e6, 0.0, 0.0]}]
    tables["output"] = {"exports": [{"file": "a.frd"}]}
    list(run(Case.from_dict(tables), output=folder / "bar", comm=MPI.COMM_SELF))
    row = next(csv.DictReader((folder / "bar/modes.csv").open()))
    text = (folder / "bar/a.frd").read_text()
    head = next(line for line in text.splitlines() if line.startswith("  100CL"))
    assert float(row["load_factor"]) < 0
    assert float(head[12:24]) == pytest.approx(float(row["load_factor"]), rel=1e-6)


def test_states_of_modes(results: Path, tmp_path: Path) -> None:
    """All digits of the animations' first frames, at the frequencies."""
    export(FinishedRun(results), tmp_path / "a.csv", ExportSettings())
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    for k, f in enumerate(frequencies(results)):
        of = table[table["t"] == f]
        found = np.column_stack([of[f"displacement_{a}"] for a in "xyz"])
        assert (found == moved(results, k + 1)).all()


def test_one_mode(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A period in ParaView's file, and as a surface."""
    target = results / "period.vtkhdf"
    convert(results, target, mode=2)
    with h5py.File(target) as file:
        times = file["VTKHDF/Steps/Values"][:]
        starts = file["VTKHDF/Steps/PointDataOffsets/displacement"][:]
        values = file["VTKHDF/PointData/displacement"][:]
    assert times * frequencies(results)[1] == pytest.approx(np.arange(8) / 8, rel=1e-12)
    want = moved(results, 2, 3)
    assert (values[starts[3] : starts[3] + len(want)] == want).all()
    assert starts[5] == starts[3]  # what is the same is there once
    assert len(values) == 5 * len(want)
    convert(results, results / "period.glb", mode=2)
    assert "period.glb written: 8 states, 20 points" in capsys.readouterr().out


def test_what_is_not_there(results: Path, tmp_path: Path) -> None:
    """One message each: what is wrong, and what is right."""
    finished = FinishedRun(results)
    with pytest.raises(InputError, match=r"beam: it holds no mode 3; 1 to 2, or 0 for all"):
        as_modes(finished, 3)
    (results / "mode_02.xdmf").rename(tmp_path / "mode_02.xdmf")
    with pytest.raises(InputError, match=r"mode_02.xdmf: there is no such file"):
        as_modes(finished, 2)
    (tmp_path / "mode_02.xdmf").rename(results / "mode_02.xdmf")
    finished.summary = {}
    with pytest.raises(InputError, match=r"no mode at all; the results of \[modal\] or"):
        as_modes(finished, 0)
    with pytest.raises(InputError, match="no field 'von_mises'; known: displacement$"):
        export(FinishedRun(results), tmp_path / "a.glb", ExportSettings(field="von_mises"))
    exports = {"exports": [{"file": "a.glb", "field": "von_mises"}]}
    with pytest.raises(InputError, match=r"output.exports\[0\].field: a mode has no 'von_mises'"):
        report(Case.from_dict({**TABLES, "output": exports}), comm=MPI.COMM_SELF)


@pytest.mark.parametrize(
    ("source", "target", "what"),
    [
        ("beems", "a.glb", "beems: there is no such folder; did you mean 'beam'"),
        ("beems", "a.xdmf", "beems: there is no such folder"),
        ("beam/summary.json", "a.glb", "this is a file; expected the folder of the results"),
    ],
)
def test_what_is_no_folder(results: Path, source: str, target: str, what: str) -> None:
    """`convert` said that there is no mesh file."""
    with pytest.raises(InputError, match=what):
        convert(results.parent / source, results / target)


def test_what_is_no_skin(results: Path, tmp_path: Path) -> None:
    """The formats of surfaces were not among those that are right."""
    (tmp_path / "skin.txt").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"skin.txt.*unknown suffix '.txt'.*\.stl, \.obj, \.ply"):
        convert(results, results / "a.glb", skin=tmp_path / "skin.txt")
