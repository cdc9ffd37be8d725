"""Files that are written: round trips, kills, full disks, pictures."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import ROOT
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from helpers.bodies import made
from helpers.states import COMM, displacement, make_problem, make_state
from mpi4py import MPI

from dolfin_elastic import Case, LinearElastic, NeoHookean, restart, run
from dolfin_elastic.core import timing
from dolfin_elastic.core.errors import InputError, OutputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results import files, hdf5
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.finished.draw import round_off_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.hdf5 import Rows
from dolfin_elastic.results.outputs import (
    History,
    Modes,
    Picture,
    Summary,
    Xdmf,
)
from dolfin_elastic.results.scene import colour_bar, pictures, renderer, scene
from dolfin_elastic.results.scene.appearance import Appearance
from dolfin_elastic.results.scene.clip import Clip
from dolfin_elastic.results.scene.colour_bar import ColourBar, colour_map, make_colour_bar
from dolfin_elastic.results.scene.drawn_field import DrawnField
from dolfin_elastic.results.scene.edges import no_chance, silhouette
from dolfin_elastic.results.scene.pictures import Painter, _round_off, picture
from dolfin_elastic.results.scene.scene import window
from dolfin_elastic.results.scene.surface import gather_surface
from dolfin_elastic.results.writer import Output


def grids(path: Path) -> list[ET.Element]:
    """The time steps of an XDMF file."""
    return ET.parse(path).getroot().findall("./Domain/Grid/Grid")


def item(path: Path, element: ET.Element | None) -> AnyArray:
    """What a reader gets for the `DataItem` below an element, checked against its description."""
    data = element.find("DataItem") if element is not None else None
    assert data is not None
    assert data.text
    file, name = data.text.split(":")
    with h5py.File(path.parent / file, "r") as h5:
        values = h5[name][:]
    assert values.shape == tuple(int(n) for n in data.attrib["Dimensions"].split())
    assert values.dtype.kind == {"Float": "f", "Int": "i"}[data.attrib["NumberType"]]
    assert values.dtype.itemsize == int(data.attrib["Precision"])
    return np.asarray(values)


def attributes(path: Path, grid: ET.Element) -> dict[str, AnyArray]:
    """Name to values of a time step."""
    return {a.attrib["Name"]: item(path, a) for a in grid.findall("Attribute")}


# --- XDMF ---


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_xdmf_round_trip(folder: Path, dim: int, degree: int) -> None:
    problem = make_problem(dim, degree)
    stresses = ("von_mises", "cauchy_stress", "von_mises_cell", "cauchy_stress_cell")
    writer = Xdmf(fields=("displacement", *stresses, "rank")).open(problem, folder)
    for step in (1, 2):
        writer.write(make_state(problem, step, step / 2))
    writer.close()
    on_root(COMM, lambda: check_round_trip(problem, folder / "results.xdmf", dim, degree))


def check_round_trip(problem: Problem, path: Path, dim: int, degree: int) -> None:
    text = path.read_text()
    assert "include" not in text
    assert "xpointer" not in text
    steps = grids(path)
    assert [float(g.find("Time").attrib["Value"]) for g in steps] == [0.5, 1.0]  # type: ignore[union-attr]
    points, cells = (item(path, steps[1].find(name)) for name in ("Geometry", "Topology"))
    assert len(points) == problem.V.dofmap.index_map.size_global
    assert len(cells) == problem.body.num_cells
    assert len(np.unique(points.round(12), axis=0)) == len(points)
    assert sorted(np.unique(cells)) == list(range(len(points)))
    check_shape(points[cells], dim, degree)
    values = attributes(path, steps[1])
    inside = np.where(np.arange(3) < dim, displacement(points.T).T, 0.0)
    error = np.abs(values["displacement"] - inside)
    assert error.max() < 1e-14, "the displacement is written as it is, also at mid-edges"
    for end, rows in (("", points), ("_cell", cells)):
        deviator = values[f"cauchy_stress{end}"].reshape(-1, 3, 3)
        deviator = deviator - np.trace(deviator, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        mises = np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
        assert len(mises) == len(rows)
        assert np.allclose(mises, values[f"von_mises{end}"][:, 0], rtol=1e-10)
    assert set(np.unique(values["rank"])) == set(range(COMM.size))


def check_shape(x: AnyArray, dim: int, degree: int) -> None:
    """Cells of the right total and sign of volume, with nodes in VTK's order."""
    corners = x[:, : dim + 1]
    edges = (corners[:, 1:] - corners[:, :1])[:, :, :dim]
    volumes = np.linalg.det(edges) / (2 if dim == 2 else 6)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(2.0)
    if degree == 2:
        pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)][: 3 if dim == 2 else 6]
        for i, (a, b) in enumerate(pairs):
            assert np.allclose(x[:, dim + 1 + i], (x[:, a] + x[:, b]) / 2, atol=1e-14)
    assert x.shape[1] == {(2, 1): 3, (2, 2): 6, (3, 1): 4, (3, 2): 10}[dim, degree]


def test_stress_is_written_for_its_cell(folder: Path) -> None:
    problem = make_problem()
    writer = Xdmf(fields=("displacement", "cauchy_stress_cell")).open(problem, folder)
    writer.write(make_state(problem))
    on_root(COMM, lambda: check_stress(folder / "results.xdmf"))


def check_stress(path: Path) -> None:
    """Recomputes F and the stress of each cell from what is in the file alone."""
    grid = grids(path)[0]
    points, cells = (item(path, grid.find(name)) for name in ("Geometry", "Topology"))
    values = attributes(path, grid)
    x, u = points[cells], values["displacement"][cells]
    gradient = np.linalg.solve(x[:, 1:] - x[:, :1], u[:, 1:] - u[:, :1]).transpose(0, 2, 1)
    F = np.eye(3) + gradient
    J = np.linalg.det(F)[:, None, None]
    mu, lmbda = 1e6 / 2.6, 1e6 * 0.3 / (1.3 * 0.4)
    sigma = (mu * (F @ F.transpose(0, 2, 1) - np.eye(3)) + lmbda * np.log(J) * np.eye(3)) / J
    found = values["cauchy_stress_cell"].reshape(-1, 3, 3)
    assert np.allclose(found, sigma, rtol=1e-9, atol=1e-4)


def test_default_fields_in_statics_and_motion(folder: Path) -> None:
    problem = make_problem(2)
    v = fem.Function(problem.V)
    for name, more in (("still", {}), ("moving", {"v": v, "a": v})):
        Xdmf(file=f"{name}.xdmf").open(problem, folder).write(make_state(problem, **more))
    found = on_root(
        COMM,
        lambda: {
            name: set(attributes(p := folder / f"{name}.xdmf", grids(p)[0]))
            for name in ("still", "moving")
        },
    )
    assert found["still"] == {"displacement", "von_mises", "cauchy_stress"}
    assert found["moving"] == {*found["still"], "velocity"}


def test_every_third_step_and_always_the_last(folder: Path) -> None:
    problem = make_problem(2)
    writer = Xdmf(every=3).open(problem, folder)
    for step in range(8):
        writer.write(make_state(problem, step, step / 7))
    problem.u.x.array[:] = np.nan  # as after a failed step
    writer.close("failed", "no convergence")
    names, last = on_root(COMM, lambda: last_step(folder / "results.xdmf"))
    assert names == ["step 0", "step 3", "step 6", "step 7"]
    assert np.isfinite(last).all()


def last_step(path: Path) -> tuple[list[str], AnyArray]:
    steps = grids(path)
    return [g.attrib["Name"] for g in steps], attributes(path, steps[-1])["displacement"]


def test_a_new_run_replaces_the_old_one(folder: Path) -> None:
    problem = make_problem(2)
    for count in (3, 1):
        writer = Xdmf().open(problem, folder)
        for step in range(count):
            writer.write(make_state(problem, step))
        writer.close()
    found = on_root(COMM, lambda: sorted(p.name for p in (folder / "results_data").iterdir()))
    assert found == ["000000.h5", "mesh.h5"]


KILLED = """
import sys
from pathlib import Path
from helpers.states import make_problem, make_state
from dolfin_elastic.results.outputs import Xdmf
problem = make_problem(3, 1, cells=6)
writer = Xdmf().open(problem, Path(sys.argv[1]))
for step in range(1, 100000):
    writer.write(make_state(problem, step, float(step)))
"""


@pytest.mark.skipif(COMM.size > 1, reason="starts a program of its own")
@pytest.mark.parametrize("delay", [0.0, 0.013, 0.029])
def test_every_named_step_survives_a_kill(folder: Path, delay: float) -> None:
    # Under mpirun the program must not take this one's place in the run.
    mine = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_", "PMI_"))}
    mine["PYTHONPATH"] = os.pathsep.join(
        [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    )
    run = subprocess.Popen([sys.executable, "-c", KILLED, str(folder)], cwd=ROOT, env=mine)
    path = folder / "results.xdmf"
    end = time.monotonic() + 120
    while not (path.exists() and len(grids(path)) > 5) and time.monotonic() < end:
        assert run.poll() is None, "the program ended by itself"
        time.sleep(0.01)
    time.sleep(delay)
    run.send_signal(signal.SIGKILL)
    run.wait()
    steps = grids(path)
    assert len(steps) > 5
    for number, grid in enumerate(steps, start=1):
        points = item(path, grid.find("Geometry"))
        u = attributes(path, grid)["displacement"]
        assert np.allclose(u, displacement(points.T, float(number)).T, rtol=1e-13)


# --- heavy data ---


def test_rows_of_all_ranks_form_one_array(folder: Path) -> None:
    first, own = COMM.rank * (COMM.rank + 1) // 2, COMM.rank + 1  # 1, 2, 3 ... rows
    count = COMM.size * (COMM.size + 1) // 2
    numbers = np.arange(first, first + own)[:, None]
    arrays = {
        "a": Rows(numbers * [1.0, 0.5], first, count),
        "b": Rows(numbers.astype(np.int32), first, count),
        "none": Rows(np.zeros((0, 3)), 0, 0),
    }
    hdf5.write(COMM, folder / "x.h5", arrays)
    a, b, none = on_root(COMM, lambda: read_all(folder / "x.h5"))
    assert np.array_equal(a, np.arange(count)[:, None] * [1.0, 0.5])
    assert np.array_equal(b, np.arange(count)[:, None])
    assert none.shape == (0, 3)


def read_all(path: Path) -> tuple[AnyArray, AnyArray, AnyArray]:
    with h5py.File(path, "r") as file:
        return file["a"][:], file["b"][:], file["none"][:]


def test_a_full_disk_raises_on_all_ranks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = make_problem(2)
    writer = Xdmf().open(problem, folder)
    writer.write(make_state(problem, 1))

    def full(size: Path) -> Any:
        return type("Usage", (), {"free": 1000})

    monkeypatch.setattr(files.shutil, "disk_usage", full)
    with pytest.raises(OutputError, match=r"no space left.*make room"):
        writer.write(make_state(problem, 2))
    names, _ = on_root(COMM, lambda: last_step(folder / "results.xdmf"))
    assert names == ["step 1"]


@pytest.mark.parametrize("moment", ["before", "between"])
def test_a_file_size_limit_raises_on_all_ranks(
    folder: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """The system refuses to write: to rank 0 that lays the file out, or to all that fill it."""
    resource = pytest.importorskip("resource")
    old, opened = resource.getrlimit(resource.RLIMIT_FSIZE), hdf5.open_together
    rows = Rows(np.ones((100_000, 3)), COMM.rank * 100_000, COMM.size * 100_000)

    def limit(*arguments: Any) -> Any:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, old[1]))
        return opened(*arguments) if arguments else None

    if moment == "before":
        limit()
    else:
        monkeypatch.setattr(hdf5, "open_together", limit)
    try:
        with pytest.raises(OutputError, match="cannot write"):
            hdf5.write(COMM, folder / "big.h5", {"a": rows, "b": rows})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    COMM.barrier()


@pytest.mark.parametrize("kind", [Xdmf, History, Summary, Picture, Modes])
def test_a_folder_that_cannot_be_made(folder: Path, kind: type[Output]) -> None:
    on_root(COMM, lambda: (folder / "taken").write_text("a file"))
    with pytest.raises(OutputError, match=r"cannot write .*taken"):
        kind().open(make_problem(2), folder / "taken")


# --- tables ---


def moving_state(problem: Problem, step: int) -> State:
    v = fem.Function(problem.V)
    return make_state(
        problem,
        step,
        0.1 * step,
        v=v,
        a=v,
        newton=3,
        krylov=7,
        max_displacement=0.25,
        energies={"total": 3.0, "strain": 1.0, "kinetic": 2.0, "external": 4.0},
        reactions={"foot, left": np.array([1.0, 2.0, 3.0])},
        momenta={"linear": np.array([4.0, 5.0, 6.0]), "angular": np.array([7.0, 8.0, 9.0])},
    )


def test_history(folder: Path) -> None:
    problem = make_problem()
    writer = History().open(problem, folder)
    for step in (0, 1):
        writer.write(moving_state(problem, step))
        count = on_root(COMM, lambda: (folder / "history.csv").read_bytes().count(b"\r\n"))
        assert count == step + 2, "each row is on disk at once"
    writer.close()
    rows = on_root(COMM, lambda: read_csv(folder / "history.csv"))
    assert list(rows[0]) == [
        "step",
        "t",
        "load_factor",
        "newton",
        "krylov",
        "max_displacement",
        "strain_energy",
        "kinetic_energy",
        "external_energy",
        "total_energy",
        "reaction_foot, left_x",
        "reaction_foot, left_y",
        "reaction_foot, left_z",
        "momentum_x",
        "momentum_y",
        "momentum_z",
        "angular_momentum_x",
        "angular_momentum_y",
        "angular_momentum_z",
    ]
    assert [float(v) for v in rows[1].values()] == [
        1,
        0.1,
        1,
        3,
        7,
        0.25,
        1,
        2,
        4,
        3,
        1,
        2,
        3,
        4,
        5,
        6,
        7,
        8,
        9,
    ]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_history_of_statics_in_the_plane(folder: Path) -> None:
    problem = make_problem(2)
    writer = History().open(problem, folder)
    writer.write(make_state(problem, reactions={"foot": np.array([1.0, 2.0])}))
    writer.close()
    (row,) = on_root(COMM, lambda: read_csv(folder / "history.csv"))
    assert list(row)[-2:] == ["reaction_foot_x", "reaction_foot_y"]


def test_summary(folder: Path) -> None:
    problem = make_problem(degree=2)
    path = folder / "summary.json"
    with timing.timed():
        writer = Summary().open(problem, folder)
        assert on_root(COMM, lambda: json.loads(path.read_text()))["status"] == "running"
        for step in range(3):
            writer.write(moving_state(problem, step))
        problem.u.x.array[:] = np.nan
        writer.close("failed", InputError("too steep", where="here"))
    found = on_root(COMM, lambda: json.loads(path.read_text()))
    assert (found["status"], found["reason"]) == ("failed", "here: too steep")
    sizes = {
        "dofs": problem.num_dofs,
        "cells": problem.body.num_cells,
        "ranks": COMM.size,
        "steps": 2,
        "newton_iterations": 9,
        "krylov_iterations": 21,
        "max_displacement": 0.25,
        "strain_energy": 1.0,
    }
    assert {name: found[name] for name in sizes} == sizes
    assert found["reactions"] == {"foot, left": [1.0, 2.0, 3.0]}
    assert {"mesh", "compile", "assemble", "solve", "output", "total"} <= set(found["timings"])
    assert 0 < found["timings"]["output"] <= found["timings"]["total"]
    memory = found["peak_memory"]
    assert 1e7 < memory["largest_rank"] <= memory["sum"] <= memory["largest_rank"] * COMM.size
    assert found["extremes"]["von_mises"]["value"] > 0
    assert len(found["extremes"]["von_mises"]["place"]) == 3
    assert {"dolfin_elastic", "dolfinx", "petsc"} <= set(found["versions"])


def test_summary_is_updated_during_a_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dolfin_elastic.results.writers import summary

    monkeypatch.setattr(summary, "_INTERVAL", -1.0)
    problem = make_problem(2)
    writer = Summary().open(problem, folder)
    writer.write(make_state(problem, max_displacement=float("nan")))
    found = on_root(COMM, lambda: json.loads((folder / "summary.json").read_text()))
    assert (found["steps"], found["status"]) == (1, "running")
    assert found["max_displacement"] is None, "JSON has no word for NaN"


@pytest.mark.parametrize(("there", "before"), [("running", "running"), ("completed", "completed")])
def test_a_summary_that_its_writer_does_not_close(there: str, before: str, tmp_path: Path) -> None:
    """Its status becomes "stopped" where it is the one to be changed, and no other one does."""
    from dolfin_elastic.results.writers.summary import mark_stopped

    mark_stopped(tmp_path, before=before)
    assert not [*tmp_path.iterdir()], "there is none before the first step"
    path = tmp_path / "summary.json"
    for status, after in ((there, "stopped"), ("failed", "failed")):
        path.write_text(json.dumps({"status": status, "dofs": 8}))
        mark_stopped(tmp_path, "here", before=before)
        found = json.loads(path.read_text())
        assert (found["status"], found["dofs"]) == (after, 8)
        assert found.get("reason") == ("here" if after == "stopped" else None)


# --- records ---


def test_unknown_fields_and_files_are_refused(folder: Path) -> None:
    """Names of fields where the body is known, before anything is removed."""
    problem = make_problem(2, 1)
    before = [folder / name for name in ("results.xdmf", "picture.png")]
    on_root(COMM, lambda: [file.touch() for file in before])
    with pytest.raises(InputError, match="did you mean 'von_mises'"):
        Xdmf(fields=["von_mise"]).open(problem, folder)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cannot show 'rank'; one of displacement, .*, material$"):
        Picture(field="rank").open(problem, folder)
    assert all(file.is_file() for file in before)
    with pytest.raises(InputError, match=r"does not end with \.xdmf"):
        Xdmf(file="results.vtu")
    with pytest.raises(InputError, match="every"):
        Picture(every=0)
    assert Xdmf(fields=["displacement"]).fields == ("displacement",)  # type: ignore[arg-type]


# --- pictures ---


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (3, 1), (3, 2)])
def test_pictures(folder: Path, dim: int, degree: int) -> None:
    problem = make_problem(dim, degree)
    picture(problem, make_state(problem), folder / "a.png")
    on_root(COMM, lambda: check_picture(folder / "a.png"))


def check_picture(path: Path) -> None:
    """Neither empty nor black: many colours on a light ground."""
    import pyvista

    image = np.asarray(pyvista.read(str(path)).point_data.active_scalars)[:, :3]
    assert len(image) > 1e6
    assert len(np.unique(image, axis=0)) > 200
    assert image[0].min() > 200


def names(folder: Path) -> list[str]:
    """Files of a folder, the same on all ranks."""
    return on_root(COMM, lambda: sorted(p.name for p in folder.iterdir()))


@pytest.mark.long
def test_pictures_during_a_run(folder: Path) -> None:
    """Steps 3, 7, 8, 9 as a solver may show them: each second one or what follows, and the last."""
    problem = make_problem(2)
    many, last = Picture(every=2, field="displacement"), Picture(file="last.png")
    writers = [many.open(problem, folder), last.open(problem, folder)]
    for step in (3, 7, 8, 9):
        for writer in writers:
            writer.write(make_state(problem, step, step / 9))
    problem.u.x.array[:] = np.nan  # as after a failed step
    for writer in writers:
        writer.close("failed", "no convergence")
    numbered = [f"picture_{step:06d}.png" for step in (3, 7, 8, 9)]
    assert names(folder) == ["last.png", *numbered]
    assert on_root(COMM, lambda: many.listing(folder)) == numbered
    assert on_root(COMM, lambda: last.listing(folder)) == ["last.png"]


def test_a_picture_that_cannot_be_drawn(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """One warning, also in a series; the run goes on, and draws those that can be drawn."""
    problem, draw = make_problem(2), renderer.RENDERER.draw

    def fails(user: object, data: Sequence[Path], drawn: Path) -> None:
        if len(told) < 2:
            told.append(drawn)
            raise OutputError("cannot draw a picture: no display")
        draw(user, data, drawn)

    told: list[Path] = []
    monkeypatch.setattr(renderer.RENDERER, "draw", fails)
    writer = Picture(every=1).open(problem, folder)
    for step in range(3):
        writer.write(make_state(problem, step, step / 2))
    writer.close()
    assert names(folder) == ["picture_000002.png"]
    warnings = [r.message for r in caplog.records if r.levelname == "WARNING"]
    shown = ["cannot draw a picture: no display; the run goes on"] if COMM.rank == 0 else []
    assert warnings == shown or COMM.rank


@pytest.mark.parametrize(
    ("clips", "low", "high", "area", "edges"),
    [
        ([Clip(0, 1.0)], 0.0, 1.0, 6.0, 12.0),
        ([Clip(0, 1.4, above=False), Clip(2, 0.5, above=True)], 1.4, 2.0, 2.8, 8.4),
    ],
)
def test_sections(clips: list[Clip], low: float, high: float, area: float, edges: float) -> None:
    """Surface and section of what planes leave of a beam of 2 x 1 x 1, on any number of ranks."""
    problem = make_problem(3, degree=2, cells=1)
    painter = Painter(problem, ("displacement",))
    try:
        found = painter.panels(make_state(problem), Appearance(clips=clips))
    finally:
        painter.close()
    assert len(found) == (problem.body.comm.rank == 0)
    for one in found:
        x, u = one.scene.points, one.frame.u
        assert low - 1e-5 <= x[:, 0].min() < x[:, 0].max() <= high + 1e-5
        # Between points of a section h = 1/2 apart u is linear: |u''| h^2/8 = 0.4/32.
        np.testing.assert_allclose(u, displacement(x.T).T, atol=0.0125)
        corners = x[one.scene.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.linalg.norm(across, axis=1).sum() / 2 == pytest.approx(area, rel=1e-4)
        # The camera shows what is drawn, undeformed and deformed, and nothing beside it.
        seen = window(np.vstack([x, x + one.scale * u]), one.view)
        np.testing.assert_allclose(one.seen, seen, rtol=0, atol=1e-12)
        # What is left is a box: its edges are drawn, the rims of the sections among them, and
        # nothing that the triangles of a section would add.
        lines = x[one.scene.edges]
        lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
        assert lengths.sum() == pytest.approx(edges, rel=1e-4)


@pytest.mark.parametrize(("aside", "turn", "kept"), [(0, 45, 60), (0.05, 45, 0), (0.05, 90, 60)])
def test_zigzags_of_rounded_bodies_are_no_edges(aside: float, turn: float, kept: int) -> None:
    """Where the surface turns little, short pieces with bends between them are chance.

    Args:
        aside: How much nearer to the middle of a ring of 60 points every other one is.
        turn: Of the surface at the ring [degrees].
        kept: Edges that are left.
    """
    around, i = np.linspace(0, 2 * np.pi, 60, endpoint=False), np.arange(60)
    radius = 1 - aside * (i % 2)
    ring = np.stack([radius * np.cos(around), radius * np.sin(around), 0 * around], axis=1)
    pairs = np.stack([i, (i + 1) % 60], axis=1)
    assert no_chance(ring, pairs, np.full(60, float(turn)), 2.8).sum() == kept


def test_silhouettes_have_no_short_lines() -> None:
    """The equator of two cones, but not the outline of a single face that is turned away."""
    import pyvista

    around, i = np.linspace(0, 2 * np.pi, 60, endpoint=False), np.arange(60)
    ring = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    above = np.stack([i, (i + 1) % 60, 0 * i + 60], axis=1)
    below = np.stack([(i + 1) % 60, i, 0 * i + 61], axis=1)
    faces = np.insert(np.vstack([above, below]), 0, 3, axis=1)
    coarse = pyvista.PolyData(np.vstack([ring, [[0, 0, 0.4], [0, 0, -0.4]]]), faces.ravel())
    body = coarse.subdivide(2)
    x, triangles = np.asarray(body.points, dtype=float), body.faces.reshape(-1, 4)[:, 1:]
    inner = int(np.flatnonzero((x[triangles, 2] > 0.05).all(axis=1))[0])
    turned = triangles.copy()
    turned[inner] = turned[inner][::-1]
    for t in (triangles, turned):
        back = np.array([0.0, 0.0, 1.0])
        assert len(silhouette(x, t, back, 0.0)) == 240 + 3 * int(t is turned)
        assert len(silhouette(x, t, back, 0.25 * body.length)) == 240


def test_a_new_run_removes_old_pictures(folder: Path) -> None:
    """Those with its own names, and no others."""
    old = ["picture.png", "picture_000000.png", "picture_12345.png"]
    others = ["my_picture.png", "picture_1.png", "picture_a.png"]
    on_root(COMM, lambda: [(folder / name).touch() for name in (*old, *others)] and None)
    Picture(every=2).open(make_problem(2), folder).close()
    assert names(folder) == others


def test_many_pictures_are_listed_briefly(folder: Path) -> None:
    on_root(COMM, lambda: [(folder / f"a_{n:04d}.png").touch() for n in (2, 9999, 10000)] and None)
    on_root(COMM, lambda: [(folder / f"a_{n:04d}.png").touch() for n in range(10)] and None)
    listed = on_root(COMM, lambda: Picture(file="a.png").listing(folder))
    assert listed == ["a_0000.png ... a_10000.png (12 pictures)"]


@pytest.mark.long
@pytest.mark.usefixtures("own_renderer")
def test_one_renderer_for_all_pictures(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends with the last output that draws; a second run gets a new one."""
    started, ended = [], []
    begin, end = renderer.Renderer.__init__, renderer.Renderer.close
    monkeypatch.setattr(renderer.Renderer, "__init__", lambda d: (started.append(d), begin(d))[1])
    monkeypatch.setattr(renderer.Renderer, "close", lambda d: (ended.append(d), end(d))[1])
    problem = make_problem(2)
    writers = [Picture(file=f"{n}.png", every=1).open(problem, folder) for n in "ab"]
    for step in (1, 2):
        for writer in writers:
            writer.write(make_state(problem, step, step / 2))
    root = int(COMM.rank == 0)
    writers[0].close()
    assert (len(started), len(ended)) == (root, 0)
    writers[1].close()
    assert ended == started
    images = [on_root(COMM, (folder / f"a_00000{n}.png").read_bytes) for n in (1, 2)]
    assert images[0] != images[1], "each picture is a new one"


@pytest.mark.long
def test_a_renderer_that_dies(folder: Path) -> None:
    """An error that says why, and the next picture is drawn by another one."""
    if COMM.rank:
        return
    user, bad = object(), folder / "bad.npz"
    bad.write_text("no picture")
    with pytest.raises(OutputError, match="cannot draw a picture: .*pickle"):
        renderer.RENDERER.draw(user, [bad], folder / "a.png")
    assert renderer.RENDERER._renderer is None
    renderer.RENDERER.release(user)


def test_a_renderer_that_is_closed_leaves_nothing_open() -> None:
    if COMM.rank:
        return
    one = renderer.Renderer()
    one.close()
    assert one._process.returncode is not None
    streams = (one._process.stdin, one._process.stdout, one._output)
    assert [stream.closed for stream in streams if stream] == [True] * 3


def image(path: Path) -> AnyArray:
    """Rows of pixels from the bottom, red, green and blue."""
    import pyvista

    read = pyvista.read(str(path))
    return np.asarray(read.point_data.active_scalars)[:, :3].reshape(*read.dimensions[1::-1], 3)


@pytest.mark.long
def test_colours_are_those_of_the_bar(folder: Path) -> None:
    """Also where the undeformed body lies over the deformed one."""
    problem = make_problem(2)
    problem.u.interpolate(lambda x: np.stack([0.3 + 0.2 * x[0], 0 * x[0]]))
    picture(problem, State(1, 1.0, problem.u), folder / "a.png", field="jacobian")
    if COMM.rank == 0:
        pixels = image(folder / "a.png")[300:800, 100:1200].reshape(-1, 3)
        shades, counts = np.unique(pixels, axis=0, return_counts=True)
        coloured = np.ptp(shades, axis=1) > 60
        assert coloured.any()
        # det F is 1.2 everywhere, on a bar from 0 to 1.25; neighbouring shades differ by 5.
        expected = 255 * np.array(colour_map()(1.2 / 1.25)[:3])
        assert np.abs(shades[coloured][counts[coloured].argmax()] - expected).max() < 6
        share = counts[coloured].max() / counts[coloured].sum()
        assert share > 0.95, "only where lines pass there are other colours"


def test_round_off_gets_no_colours(folder: Path) -> None:
    """A body that has only been carried elsewhere has one colour."""
    problem = make_problem(2)
    problem.u.interpolate(lambda x: np.stack([0.7 / 3 + 0 * x[0], 0.1 + 0 * x[0]]))
    picture(problem, State(1, 1.0, problem.u), folder / "a.png")
    if COMM.rank == 0:
        middle = image(folder / "a.png")[500:600, 500:700].reshape(-1, 3)
        assert np.ptp(middle, axis=0).max() < 3


@pytest.mark.parametrize("field", ["energy_density", "von_mises", "green_strain", "displacement"])
def test_round_off_and_small_values(field: str) -> None:
    """What a rotation leaves of a field is round-off to a picture, strains of 1e-6 are not."""
    problem, c, s = make_problem(2), np.cos(0.5), np.sin(0.5)
    noise, found = _round_off(problem, FIELDS[field].unit), []
    for stretch, by in ((1.0, (c, s)), (1 + 1e-6, (1.0, 0.0))):
        a, b = by
        problem.u.interpolate(
            lambda x, a=a, b=b, k=stretch: np.stack(
                [k * (a * x[0] - b * x[1]) - x[0], b * x[0] + a * x[1] - x[1]]
            )
        )
        values = Evaluator(problem, [field])(State(1, 1.0, problem.u))[field]
        found.append(COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX))
    if field != "displacement":  # a rotation is a displacement, but no strain
        assert found[0] < noise
    assert found[1] > 5 * noise


@pytest.mark.long
@pytest.mark.parametrize("dim", [2, 3])
def test_pictures_of_materials(folder: Path, dim: int) -> None:
    """One colour for each, and its name."""
    mesh = make_problem(dim).body.mesh
    middle = compute_midpoints(mesh, mesh.topology.dim, np.arange(own_cells(mesh), dtype=np.int32))
    left = np.flatnonzero(middle[:, 0] < 1).astype(np.int32)
    right = np.flatnonzero(middle[:, 0] >= 1).astype(np.int32)
    body = Body(mesh, regions={"left": left, "right": right})
    rubber = NeoHookean(E=1e6, nu=0.3)
    problem = Problem(body, {"left": rubber, "right": rubber}, degree=1)
    state = make_state(problem)
    for field in ("material", "region"):
        picture(problem, state, folder / f"{field}.png", field=field, view="z")
    if COMM.rank == 0:
        pixels = image(folder / "material.png")
        assert_hue(pixels[560, 300], "blue")
        assert_hue(pixels[560, 900], "red")


def own_cells(mesh: Any) -> int:
    return int(mesh.topology.index_map(mesh.topology.dim).size_local)


def assert_hue(pixel: AnyArray, hue: str) -> None:
    assert int(np.argmax(pixel)) == {"red": 0, "blue": 2}[hue], pixel


def test_headlines_of_pictures() -> None:
    problem = make_problem(2)
    state = make_state(problem, load_factor=0.6)
    assert pictures._headline(state, Appearance()) == ("load 60 %   |   deformation \u00d7 1")
    assert pictures._headline(state, Appearance(10.0, title="A beam")) == (
        "A beam   |   load 60 %   |   deformation \u00d7 10"
    )
    moving = make_state(problem, 3, 0.05, v=problem.u)
    assert pictures._headline(moving, Appearance()) == ("t = 0.05 s   |   deformation \u00d7 1")


def bar_of(field: str, values: Sequence[float]) -> ColourBar:
    """The colour bar of some values."""
    tensor, x = FIELDS[field].shape == "tensor", np.array(values)
    return scene.bar_of(x, x, field, FIELDS[field].unit, tensor=tensor)


def test_labels_of_colour_bars() -> None:
    """A tensor has one colour at a point: its norm."""
    names = ("cauchy_stress", "von_mises", "jacobian", "displacement", "error")
    labels = [bar_of(field, [1.0, 2e3, 5e4]).label for field in names]
    assert labels == [
        "Cauchy stress\nnorm of the tensor\n[kPa]",
        "von Mises stress\n[kPa]",
        "det F",
        "displacement\n[km]",
        "estimated error of\nthe stress\n[kPa]",
    ]


@pytest.mark.parametrize(
    ("values", "label"),
    [
        ([1.27, 3.0, 1000.0], "safety factor\n5 and more alike"),
        ([0.3, 4.9], "safety factor"),
    ],
)
def test_safety_factors_from_zero_to_five(values: list[float], label: str) -> None:
    """Up to 1000, the largest one, all that matters had one colour; in all pictures one is red."""
    bar = bar_of("safety_factor", values)
    np.testing.assert_allclose(bar.ticks, (0, 1, 2, 3, 4, 5), rtol=1e-12)
    assert bar.label == label and bar.reversed


def test_colours_that_show_edges_and_shades() -> None:
    """None is nearly black, at half the range neither; small safety factors are yellow."""
    shades = np.array([colour_map()(x)[:3] for x in np.linspace(0, 1, 65)])
    light = shades @ (0.2126, 0.7152, 0.0722)  # relative luminance, ITU-R BT.709
    assert light.min() > 0.25
    assert light[32] > 0.5
    assert np.all(np.diff(light) > 0)  # even in lightness, for the colour-blind
    red, green, blue = colour_map(warm_first=True)(0.05)[:3]
    assert min(red, green) > 2 * blue


@pytest.mark.parametrize(
    ("values", "noise", "ticks", "unit"),
    [
        ([0.0, 0.4], 0.0, (0, 100, 200, 300, 400), "mPa"),
        ([-23.0, 21.0], 0.0, (-30, -20, -10, 0, 10, 20, 30), "Pa"),
        ([1e6, 2.3e6], 0.0, (1, 1.5, 2, 2.5), "MPa"),
        ([5e-10, 7e-10], 4e-4, (0, 100, 200, 300, 400), "µPa"),
        ([3.0, 3.0 + 1e-12], 1e-3, (0, 1, 2, 3), "Pa"),
        ([0.0, np.nan], 0.0, (0, 0.2, 0.4, 0.6, 0.8, 1), "Pa"),
        ([np.nan], 0.0, (0, 0.2, 0.4, 0.6, 0.8, 1), "Pa"),
        ([999.9999999999], 0.0, (0, 0.2, 0.4, 0.6, 0.8, 1), "kPa"),
    ],
)
def test_colour_bars(
    values: list[float], noise: float, ticks: tuple[float, ...], unit: str
) -> None:
    found = make_colour_bar(np.array(values), "Pa", noise)
    assert (found.ticks, found.unit) == (ticks, unit)


@pytest.mark.parametrize(
    ("ticks", "first", "form"),
    [((0, 5), "0", "%.0f"), ((0, 2.5, 5), "0.0", "%.1f"), ((0, 1e-7), "0", "%.4g")],
)
def test_digits_of_ticks(ticks: tuple[float, ...], first: str, form: str) -> None:
    assert colour_bar._form(ticks) == form
    assert form % ticks[0] == first


@pytest.mark.parametrize("degree", [1, 2])
def test_the_surface_is_closed_and_oriented_outwards(degree: int) -> None:
    from dolfin_elastic.results.grid import Grid

    problem = make_problem(3, degree)
    x = problem.V.tabulate_dof_coordinates()
    surface = gather_surface(Grid(problem.V), {"x": x})
    assert (surface is None) == (COMM.rank > 0)
    if surface:
        a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a) / 2
        assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(10.0)
        assert np.einsum("ij,ij->", normals, a) / 3 == pytest.approx(2.0)  # divergence theorem
        assert np.array_equal(surface.values["x"], surface.points)


def test_the_neutral_axis_of_a_beam_is_drawn_without_stress() -> None:
    """|sigma| = E k |y - 1/2| in pure bending, where the edges between nodes cross the axis.

    The von Mises stress was interpolated between nodes at y = 1/4 and 3/4: 50 instead of 0.  What
    is left is that an edge is divided into eight: its middle piece has 1/8 of its stress.
    """
    points = [(0, 0), (0, 1), (1, 0.5), (2, 0), (2, 1)]
    body = made(COMM, [(0, 1, 2), (0, 3, 2), (1, 4, 2), (3, 4, 2)], points)
    law = LinearElastic(E=100.0, nu=0.0, allowable=50.0)
    problem = Problem(body, law, degree=2)
    problem.u.interpolate(lambda x: (2 * x[0] * (x[1] - 0.5), -(x[0] ** 2)))
    state = State(1, 1.0, problem.u)
    for name in ("von_mises", "safety_factor", "pressure", "displacement"):
        drawn = DrawnField(problem, name)
        assert not drawn.linear
        surface = gather_surface(drawn.grid, {"value": drawn.at_nodes(state)})
        if surface is None:
            continue
        value, (x, y) = drawn.shown(surface.values["value"])[:, 0], surface.points[:, :2].T
        sigma = 200 * (y - 0.5)
        right = {
            "von_mises": np.abs(sigma),
            "safety_factor": 50 / np.maximum(np.abs(sigma), 50 / 1000),
            "pressure": -sigma / 3,
            "displacement": np.hypot(2 * x * (y - 0.5), x**2),
        }[name]
        np.testing.assert_allclose(value, right, rtol=1e-9, atol=1e-9)
        if name == "von_mises":
            assert np.sum(np.abs(y - 0.5) < 1e-12) == 2 * 4 + 1, "points on the axis are drawn"
            for a, b in ((0, 1), (1, 2), (2, 0)):
                ends = surface.triangles[:, [a, b]]
                between = value[ends].mean(axis=1) - np.abs(200 * (y[ends].mean(axis=1) - 0.5))
                assert between.max() < 100 / 8 + 1e-9


def test_means_of_cells_and_contact_are_drawn_without_overshoots() -> None:
    """Shape functions of nodes are negative in places: a step from 0 to 1 would begin at -1/8."""
    problem = make_problem(2, 2)
    grid = DrawnField(problem, "contact_pressure").grid
    assert DrawnField(problem, "jacobian").linear
    assert DrawnField(problem, "contact_pressure").linear
    step = (problem.V.tabulate_dof_coordinates()[:, :1] > 0.9).astype(float)
    lines = gather_surface(grid, {"a": step, "b": step}, linear=["a"])
    if lines is not None:
        assert lines.values["a"].min() == 0.0 and lines.values["a"].max() == 1.0
        assert lines.values["b"].min() < -0.1
        x = lines.points[:, 0]
        assert np.allclose(lines.values["a"][:, 0][x > 1.0], 1.0)


def test_a_material_without_allowable_stress_spoils_no_neighbour() -> None:
    """Nodes without a value (NaN) leave the points between the others their values."""
    problem = make_problem(2, 2)
    x = problem.V.tabulate_dof_coordinates()[:, :1]
    drawn = gather_surface(
        DrawnField(problem, "pressure").grid, {"a": np.where(x > 1.2, np.nan, x)}
    )
    if drawn is not None:
        at, value = drawn.points[:, 0], drawn.values["a"][:, 0]
        known = ~np.isnan(value)
        assert np.allclose(value[known], at[known]) and known[at <= 1.0].all()
        assert not known[at > 1.2].any()


@pytest.mark.parametrize(("curve", "unloaded"), [("load-unload", True), ("ramp", False)])
def test_the_end_of_an_unloaded_run(
    curve: str, unloaded: bool, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It is said, with the largest of the run; the stress of round-off has no error."""
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}},
            "materials": {"m": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": [0, 0, -100], "curve": curve}],
            "statics": {"steps": 4},
        }
    )
    caplog.set_level("INFO", "dolfin_elastic")
    # From the middle, where the load is largest, it goes on elsewhere.
    states = run(case, output=folder / "a")
    while (state := next(states)).step < 3:
        most = state.max_displacement
    states.close()
    caplog.clear()
    *_, state = restart(folder / "a")
    found = on_root(COMM, lambda: json.loads((folder / "a/summary.json").read_text()))
    said = on_root(COMM, lambda: [r for r in caplog.records if "is unloaded" in r.getMessage()])
    assert (state.max_displacement < 1e-12 * most) == unloaded == bool(said)
    assert ("error" in found) != unloaded
    most = most if unloaded else state.max_displacement
    largest = {"step": 2, "load_factor": 0.5} if unloaded else {"step": 4, "load_factor": 1.0}
    assert found["largest"] == {**largest, "max_displacement": pytest.approx(most, rel=1e-9)}
    assert found.get("unloaded") == ({"step": 2, "load_factor": 0.5} if unloaded else None)
    if unloaded:
        assert f"is {most:.5g} m in step 2 (load parameter 0.5)" in said[0].getMessage()


def test_the_end_of_a_run_whose_body_has_moved_away(folder: Path) -> None:
    """Both ends are 0.1 m from where they were, one of them later: nothing has stress, or an error.

    The body is squeezed most where the second end begins to move, in step 2.
    """
    moved = {"left": "ramp", "right": [[0, 0], [0.5, 0], [1, 1]]}
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}},
            "materials": {
                "m": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "allowable": "1 MPa"}
            },
            "support": [
                {"on": end, "displacement": [0.1, 0, 0], "curve": curve}
                for end, curve in moved.items()
            ],
            "statics": {"steps": 4},
        }
    )
    *_, state = run(case, output=folder / "a")
    found = on_root(COMM, lambda: json.loads((folder / "a/summary.json").read_text()))
    assert state.max_displacement == pytest.approx(0.1, rel=1e-12)
    assert "error" not in found
    assert found["unloaded"] == {"step": 2, "load_factor": 0.5}
    assert found["verdict"]["text"].startswith("not known: the stress at the end is nothing but")
    # Pictures of the last state mark nothing.
    noise = on_root(COMM, lambda: round_off_of(FinishedRun(folder / "a"), "von_mises"))
    assert found["extremes"]["von_mises"]["value"] < noise < 1e-3
