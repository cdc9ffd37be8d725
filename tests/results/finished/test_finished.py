"""Folders of results are read back: fields, history, case; and folders that are none."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.states import COMM, displacement, make_problem, make_state

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.finished.run import FinishedRun, column_unit
from dolfin_elastic.results.outputs import History, Summary, Xdmf

CASE = {"title": "A beam", "statics": {"steps": 2}}


def written(folder: Path, dim: int, degree: int) -> Problem:
    """Two steps of a state with known displacements."""
    problem = make_problem(dim, degree, cells=1)
    fields = ("displacement", "von_mises", "cauchy_stress_cell", "rank")
    outputs = (Xdmf(fields=fields), History(), Summary(case=CASE))
    writers = [output.open(problem, folder) for output in outputs]
    for step in (1, 2):
        state = make_state(problem, step, step / 2, numbers={"tip_x": 0.25 * step}, done=step / 2)
        for writer in writers:
            writer.write(state)
    for writer in writers:
        writer.close()
    return problem


@pytest.mark.parametrize(("dim", "degree"), [(3, 2), (2, 1), (2, 2), (3, 1)])
def test_what_a_run_has_left(folder: Path, dim: int, degree: int) -> None:
    """Every number as it was computed, on cells with their mid-edge nodes in VTK's order."""
    problem = written(folder, dim, degree)
    nodes, cells = problem.V.dofmap.index_map.size_global, problem.body.num_cells
    on_root(COMM, lambda: check(folder, dim, degree, (nodes, cells)))


def check(folder: Path, dim: int, degree: int, count: tuple[int, int]) -> None:
    run = FinishedRun(folder)
    assert run.case == CASE
    assert run.summary["status"] == "completed"
    assert run.steps == [0.5, 1.0]
    assert run.dim == dim
    assert run.history["step"].tolist() == [1, 2]
    assert run.history["tip_x"].tolist() == [0.25, 0.5]
    assert (run.units["tip_x"], run.units["t"]) == ("m", "")
    grid = run.grid()
    assert (grid.n_points, grid.n_cells) == count
    assert set(run.fields()) == {"displacement", "von_mises", "cauchy_stress_cell", "rank"}
    assert grid.cell_data["cauchy_stress_cell"].shape == (count[1], 9)
    assert set(grid.cell_data["rank"]) == set(range(COMM.size))
    inside = np.where(np.arange(3) < dim, displacement(grid.points.T).T, 0.0)
    assert np.abs(grid.point_data["displacement"] - inside).max() < 1e-14
    assert np.abs(run.grid(0).point_data["displacement"] - inside / 2).max() < 1e-14
    # VTK's own volumes of the cells: nodes in another order would change them, or their sign.
    name = "Area" if dim == 2 else "Volume"
    sizes = grid.compute_cell_sizes()[name]
    assert sizes.min() > 0
    assert sizes.sum() == pytest.approx(2.0, rel=1e-12)
    assert set(grid.celltypes) == {{(2, 1): 5, (2, 2): 22, (3, 1): 10, (3, 2): 24}[dim, degree]}
    for step in (2, -3):
        with pytest.raises(InputError, match=f"no step {step}; 0 to 1, or -1 for the last"):
            run.grid(step)


def test_what_is_no_result_or_damaged(folder: Path) -> None:
    """What is wrong, and where; a history with half a row is that of a run that goes on."""
    written(folder / "beam", 2, 1)
    on_root(COMM, lambda: check_damaged(folder / "beam"))


def check_damaged(beam: Path) -> None:
    (beam.parent / "sweep/001").mkdir(parents=True)
    for file in ("sweep/sweep.json", "sweep/001/summary.json"):
        (beam.parent / file).write_text("{}")
    for name, what in (
        ("beem", "no such folder; did you mean 'beam'"),
        ("beam/results.xdmf", "this is a file; expected the folder"),
        ("beam/results_data", "it holds no summary.json"),
        ("sweep", "it holds the results of a sweep; sweep.html there .* one run: .*001$"),
    ):
        with pytest.raises(InputError, match=what):
            FinishedRun(beam.parent / name)
    with (beam / "history.csv").open("a") as file:
        file.write("3,1.5")
    assert FinishedRun(beam).history["step"].tolist() == [1, 2]
    with h5py.File(beam / "results_data/000001.h5", "a") as data:
        del data["displacement"]
    with pytest.raises(InputError, match=r"000001.h5:/displacement: cannot be read"):
        FinishedRun(beam).grid()
    xdmf = (beam / "results.xdmf").read_text()
    (beam / "results.xdmf").write_text(xdmf.replace("results_data/", "../results_data/"))
    with pytest.raises(InputError, match="is no data set of a file beside it"):
        FinishedRun(beam)
    (beam / "results.xdmf").write_text(xdmf[:-30])
    with pytest.raises(InputError, match=r"results.xdmf: cannot be read"):
        FinishedRun(beam)
    (beam / "results.xdmf").unlink()
    with pytest.raises(InputError, match="it holds no fields of steps"):
        FinishedRun(beam).grid()
    (beam / "summary.json").write_text(json.dumps([1]))
    with pytest.raises(InputError, match="this is no summary of a run"):
        FinishedRun(beam)


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("tip_x", "m"),
        ("reaction_left_y", "N"),
        ("notch_von_mises", "Pa"),
        ("notch_green_strain_xy", ""),
        ("tip_velocity_z", "m/s"),
        ("lid_rx", "rad"),
        ("torque_hub", "N m"),
        ("min_jacobian", ""),
        ("strain_energy", "J"),
        ("momentum_x", "kg m/s"),
        ("angular_momentum_z", "kg m^2/s"),
        ("pressure_chamber", "Pa"),
        ("external_work", "J"),
        ("P11", "Pa"),
        ("F11", ""),
        ("lid_ux", "m"),
        ("reaction_end_velocity_x", "N"),
        ("reaction_zone_von_mises", "Pa"),
    ],
)
def test_units_of_columns(column: str, unit: str) -> None:
    """By the rules by which columns get their names."""
    assert column_unit(column, timed=False) == unit


# --- folders of strangers ---


def changed_array(beam: Path, name: str, **how: Any) -> None:
    """An array of the last step in place of one that the run has written."""
    with h5py.File(beam / "results_data/000001.h5", "a") as data:
        shape = data[name].shape
        del data[name]
        data.create_dataset(name, **{"shape": shape, "dtype": "f8", **how})


def linked_array(beam: Path) -> None:
    with h5py.File(beam / "results_data/000001.h5", "a") as data:
        del data["displacement"]
        data["displacement"] = h5py.ExternalLink("/etc/other.h5", "/a")


def renamed_field(beam: Path, name: str) -> None:
    xdmf = (beam / "results.xdmf").read_text()
    (beam / "results.xdmf").write_text(xdmf.replace('Name="von_mises"', f'Name="{name}"'))


def shape_in_text(beam: Path, name: str, old: str, new: str) -> None:
    """Another shape in text and file."""
    xdmf = (beam / "results.xdmf").read_text()
    (beam / "results.xdmf").write_text(xdmf.replace(f'"{old}"', f'"{new}"'))
    changed = tuple(int(n) for n in new.split())
    with h5py.File(beam / "results_data/mesh.h5", "a") as data:
        del data[name]
        data.create_dataset(name, changed, "i8")


def giant(beam: Path) -> None:
    how = {"shape": (1 << 31, 3), "chunks": (1 << 18, 3), "compression": "gzip"}
    changed_array(beam, "displacement", **how)


STRANGE: dict[str, tuple[Callable[[Path], None], str]] = {
    "giant": (giant, "'/displacement' states 51.5 GB, more than a file of"),
    "external storage": (
        lambda beam: changed_array(beam, "von_mises", external=[("/etc/passwd", 0, 1 << 20)]),
        "'/von_mises' is stored in another file",
    ),
    "external link": (linked_array, "'/displacement' is a link to another file"),
    "texts": (
        lambda beam: changed_array(beam, "von_mises", dtype="S8"),
        "'von_mises' holds .*, no numbers",
    ),
    "field outside": (
        lambda beam: renamed_field(beam, "x/../../outside"),
        "'x/../../outside' is no name of a field",
    ),
    "escape": (lambda beam: renamed_field(beam, "&#10;a"), "is no name of a field"),
    "cells": (lambda beam: shape_in_text(beam, "cells", "4 3", "4 2"), r"\(4, 2\), not \(n, 3\)"),
    "entity": (
        lambda beam: (beam / "results.xdmf").write_text('<!DOCTYPE x [<!ENTITY a "b">]><x/>'),
        "definitions of entities",
    ),
    "deep summary": (
        lambda beam: (beam / "summary.json").write_text("[" * 100000),
        "summary.json: cannot be read",
    ),
    "pipe": (
        lambda beam: (beam / "results.xdmf").unlink() or os.mkfifo(beam / "results.xdmf"),
        "'results.xdmf' in it is a pipe",
    ),
    "link": (
        lambda beam: (
            (beam / "results_data/000001.h5").unlink()
            or (beam / "results_data/000001.h5").symlink_to("/dev/zero")
        ),
        "'results_data/000001.h5' in it is a link",
    ),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_folders_of_strangers(folder: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    """One message, before anything large is read, and nothing of HDF5's own."""
    change, said = STRANGE[kind]
    written(folder / "beam", 2, 1)

    def look() -> None:
        change(folder / "beam")
        with pytest.raises(InputError, match=said):
            FinishedRun(folder / "beam").grid()

    on_root(COMM, look)
    assert "HDF5" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("summary", "where", "found"),
    [
        ({"extremes": []}, "extremes", "a list"),
        ({"reactions": 3}, "reactions", "a number"),
        ({"reactions": {"left": [1, None]}}, "reactions.left[1]", "null"),
        ({"error": {"von_mises": {"value": "1"}}}, "error.von_mises.value", "a text"),
        ({"extremes": {"von_mises": None}}, "extremes.von_mises", "null"),
        ({"steps": True}, "steps", "true or false"),
        ({"modes": [[]]}, "modes[0]", "a list"),
        ({"case": {"mesh": None}}, "case.mesh", "null"),
        ({"error": {"elsewhere": None, "von_mises": {"error": None}}, "model": None}, "", ""),
    ],
)
def test_types_of_the_summary(tmp_path: Path, summary: Any, where: str, found: str) -> None:
    """One message names the key; null is what is unknown."""
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    if not where:
        assert FinishedRun(tmp_path).summary == summary
        return
    with pytest.raises(InputError) as caught:
        FinishedRun(tmp_path)
    assert f"summary.json: {where}: this is {found}; expected" in str(caught.value)
