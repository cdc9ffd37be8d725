"""Motion that starts from the results of another run, or from fields of the mesh's file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root

BAR: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [1, 0.1], "cells": [8, 1]}},
    "materials": {"rubber": {"law": "neo-hookean", "E": 1e5, "nu": 0.3, "density": 1000}},
    "support": [{"on": "left"}],
    "load": [{"kind": "gravity", "value": [0, -0.01]}],
}
MOTION = {"end": "40 ms", "dt": "10 ms"}


def case(folder: Path, **tables: Any) -> Case:
    return Case.from_dict({**BAR, **tables}, folder, file="case.toml")


def test_from_statics(folder: Path, comm: MPI.Comm) -> None:
    """It goes on resting; from half the load it moves; linear elements take from quadratic ones."""
    statics = case(folder, statics={"steps": 2})
    *_, known = run(statics, output=folder / "before", comm=comm)
    still = case(folder, dynamics={**MOTION, "start": {"file": "before"}})
    states = list(run(still, output=folder / "still", comm=comm))
    assert [s.max_displacement for s in states] == pytest.approx(
        len(states) * [known.max_displacement], rel=1e-7
    )
    half = {"file": "before/results.xdmf", "step": 1}
    first, *_, last = run(
        case(folder, dynamics={**MOTION, "start": half}), output=folder / "half", comm=comm
    )
    assert first.max_displacement == pytest.approx(0.5 * known.max_displacement, rel=1e-3)
    assert last.max_displacement > first.max_displacement
    explicit = {"scheme": "symplectic-euler", "end": "1 ms", "start": {"file": "before"}}
    first = next(run(case(folder, dynamics=explicit), output=folder / "linear", comm=comm))
    assert first.max_displacement == pytest.approx(known.max_displacement, rel=1e-9)
    written = on_root(comm, lambda: json.loads((folder / "still/summary.json").read_text()))
    assert written["case"]["dynamics"]["start"] == {"file": "before"}


@pytest.mark.parametrize("file", ["before", "before/results.xdmf"])
def test_from_its_own_folder(file: str, folder: Path, comm: MPI.Comm) -> None:
    """It would overwrite what it starts from: nothing is touched, nor by analyses before it."""
    list(run(case(folder, statics={}), output=folder / "before", comm=comm))
    motion = {**MOTION, "start": {"file": file}}
    for tables in ({"dynamics": motion}, {"statics": {}, "dynamics": motion}):
        with pytest.raises(InputError, match=r"dynamics.start.file: .* own results"):
            list(run(case(folder, **tables), output=folder / "before", comm=comm))
    names = on_root(comm, lambda: {one.name for one in (folder / "before").iterdir()})
    assert {"results.xdmf", "summary.json"} <= names


def test_from_motion(folder: Path, comm: MPI.Comm) -> None:
    """With its velocity, if that is among the fields; initial_velocity takes its place."""
    fields = {"fields": ["displacement", "velocity"]}
    moving = case(folder, dynamics=MOTION, output=fields)
    *_, before = run(moving, output=folder / "before", comm=comm)
    on = case(folder, dynamics={**MOTION, "start": {"file": "before"}})
    first = next(run(on, output=folder / "on", comm=comm))
    assert first.energies["kinetic"] == pytest.approx(before.energies["kinetic"])
    start = {"start": {"file": "before"}, "initial_velocity": [0, 0]}
    first = next(run(case(folder, dynamics={**MOTION, **start}), output=folder / "off", comm=comm))
    assert first.energies["kinetic"] == 0.0
    assert first.max_displacement == pytest.approx(before.max_displacement)


def test_from_fields(folder: Path, comm: MPI.Comm) -> None:
    """Of the mesh's file, in its unit."""

    def write() -> None:
        x, y = np.meshgrid(np.linspace(0, 1000, 9), [0.0, 100.0], indexing="ij")
        points = np.column_stack([x.ravel(), y.ravel()])
        cells = [[2 * i, 2 * i + 2, 2 * i + 3] for i in range(8)]
        cells += [[2 * i, 2 * i + 3, 2 * i + 1] for i in range(8)]
        bent = np.column_stack([0 * points[:, 0], 1e-5 * points[:, 0] ** 2, 0 * points[:, 0]])
        data = {"bent": bent, "thrown": 2 * bent, "level": points[:, 0]}
        meshio.Mesh(points, [("triangle", np.array(cells))], data).write(folder / "bar.xdmf")

    on_root(comm, write)
    tables = {
        "mesh": {"file": "bar.xdmf", "unit": "mm"},
        "surfaces": {"left": {"plane": "x", "at": "min"}},
        "load": [],
    }
    start = {"displacement": "bent", "velocity": "thrown"}
    moving = case(folder, **tables, dynamics={**MOTION, "start": start})
    first = next(run(moving, output=folder / "moving", comm=comm))
    assert first.max_displacement == pytest.approx(1e-2, rel=1e-9)
    speed = np.max(np.abs(first.v.x.array)) if first.v is not None else 0.0
    assert comm.allreduce(speed, op=MPI.MAX) == pytest.approx(2e-2, rel=1e-9)
    for name, message in (("bend", "no field 'bend'; did you mean 'bent'"), ("level", "1 numbers")):
        wrong = case(folder, **tables, dynamics={**MOTION, "start": {"displacement": name}})
        with pytest.raises(InputError, match=f"dynamics.start.displacement: .*{message}"):
            report(wrong, comm=comm)


def test_what_does_not_fit(folder: Path, comm: MPI.Comm) -> None:
    """Sizes of both meshes, steps, files, and keys beside each other."""
    list(run(case(folder, statics={}), output=folder / "before", comm=comm))
    finer = {"rectangle": {"size": [1, 0.1], "cells": [9, 1]}}
    for start, tables, message in (
        ({"file": "before"}, {"mesh": finer}, "48 of the 57 nodes of this mesh .* of the 51 po"),
        ({"file": "before", "step": 7}, {}, "dynamics.start.step: '.*' has no step 7; .*0, 1"),
        ({"file": "nowhere"}, {}, "dynamics.start.file: there is no file '.*nowhere'"),
        ({"file": "before", "velocity": "v"}, {}, "dynamics.start.velocity: both are those"),
        ({"step": 3}, {}, "dynamics.start.step: there is no file with steps"),
        ({}, {}, "dynamics.start: no state is given"),
    ):
        with pytest.raises(InputError, match=message):
            report(case(folder, **tables, dynamics={**MOTION, "start": start}), comm=comm)
    for key, value in (("preload", True), ("initial_displacement", [0, 0])):
        keys = {**MOTION, "start": {"file": "before"}, key: value}
        with pytest.raises(InputError, match="leave one of them out"):
            case(folder, dynamics=keys)
