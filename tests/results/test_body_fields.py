"""Fields of the body in results: the numbers that were given, in every file and at every point."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Case,
    LinearElastic,
    Probe,
    Problem,
    box_body,
    rectangle_body,
    run,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.mesh.read import read_body
from dolfin_elastic.model.axes import CylindricalAxes
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import check_field_names, field_table
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.outputs import FORMATS
from dolfin_elastic.results.probes import ProbePoint

COMM = MPI.COMM_WORLD
LAW = LinearElastic(E=1e6, nu=0.3)


def linear(x: np.ndarray) -> dict[str, np.ndarray]:
    """Scalar, vectors and tensor at places, linear so that quadratic elements have them, too."""
    s = 2 + x[:, 0] - 0.5 * x[:, 1]
    v = np.stack([x[:, 0] - x[:, 1], 1 + 0.1 * x[:, 0], 0.3 * x[:, 1]], axis=1)
    return {
        "s": s[:, None],
        "v2": v[:, :2],
        "v3": v,
        "T": np.einsum("ni,j->nij", v, [1.0, -2.0, 0.5]).reshape(-1, 9),
    }


def given(dim: int) -> Body:
    """With such fields at points, and in cells their values at the barycentres."""
    made = (box_body if dim == 3 else rectangle_body)(size=(1,) * dim, cells=(2,) * dim)
    middles = made.mesh.geometry.x[made.mesh.geometry.dofmap].mean(axis=1)
    for name, values in linear(made.mesh.geometry.x).items():
        made.fields[name] = MeshField("point", values)
    for name, values in linear(middles).items():
        made.fields[f"{name} of cells"] = MeshField("cell", values)
    return made


NAMES = ("s", "v2", "v3", "T")


def padded(values: np.ndarray) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, int(values.shape[1] == 2))))


@pytest.mark.parametrize(("dim", "degree"), [(2, 2), (3, 1)])
def test_points_and_cells_have_the_values_that_were_given(dim: int, degree: int) -> None:
    """To round-off, of quadratic elements between the points by their shape functions."""
    problem = Problem(given(dim), LAW, degree=degree)
    evaluate = Evaluator(problem, [n + end for n in NAMES for end in ("", " of cells")])
    values = evaluate(State(0, 0.0, problem.u))
    mesh = problem.body.mesh
    own = values["s of cells"].shape[0]
    middles = mesh.geometry.x[mesh.geometry.dofmap[:own]].mean(axis=1)
    points = evaluate.grid.points()
    for name, known in linear(points).items():
        np.testing.assert_allclose(values[name], padded(known), rtol=0, atol=1e-14)
        at = linear(middles)[name] if own else known[:0]
        np.testing.assert_array_equal(values[f"{name} of cells"], padded(at))


def test_fields_of_a_case(folder: Path) -> None:
    """In XDMF, once for all steps, and at points and over a part in history.csv."""
    plate(folder / "part.vtu")
    output = {
        "fields": ["displacement", "s", "half"],
        "pictures": [{"field": ["s", "half"]}],
        "probes": {
            "tip": {"at": [1, 1], "fields": ["s", "v", "half", "displacement_of_mesh"]},
            "edge": {"on": "right", "fields": ["s"]},
            "most": {"on": "right", "fields": ["s", "v"], "values": ["max", "mean"]},
        },
    }
    tables = TABLES | {"mesh": {"file": "part.vtu", "degree": 1}, "output": output}
    case = Case.from_dict(tables, folder)
    check(case, case.read_body())
    *_, state = run(case, output=folder / "out")
    one = {"tip_s": 2.5, "tip_v_x": 0.0, "tip_v_y": 1.1, "tip_half": 1.0}
    one |= {"tip_displacement_of_mesh": 7.5, "edge_s": 2.75}
    one |= {"most_s_max": 3.0, "most_s_mean": 2.75, "most_v_mean_x": 0.5, "most_v_mean_y": 1.1}
    for column, value in one.items():
        assert state.numbers[column] == pytest.approx(value, abs=1e-14), column
    on_root(COMM, lambda: _read_back(folder / "out"))


def _read_back(folder: Path) -> None:
    finished = FinishedRun(folder)
    assert finished.units["tip_v_x"] == finished.units["tip_s"] == ""
    for step in (0, -1):
        grid = finished.grid(step)
        at = np.asarray(grid.points)
        np.testing.assert_allclose(grid["s"], 2 + at[:, 0] - 0.5 * at[:, 1], rtol=0, atol=1e-14)
        middles = grid.cell_centers().points
        np.testing.assert_array_equal(grid["half"], middles[:, 0] > 0.5)
    assert np.abs(grid["displacement"]).max() < 1
    assert (folder / "picture.png").is_file()
    mesh = (folder / "results_data" / "mesh.h5").read_bytes()
    later = (folder / "results_data" / "000001.h5").read_bytes()
    assert b"half" in mesh
    assert b"half" not in later


TABLES: dict[str, Any] = {
    "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2]}, "degree": 1},
    "materials": {"one": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}},
    "surfaces": {"left": {"plane": "x", "at": "min"}, "right": {"plane": "x", "at": "max"}},
    "support": [{"on": "left"}],
    "load": [{"kind": "pressure", "on": "right", "value": 1.0}],
    "statics": {"steps": 2},
}


def plate(file: Path) -> None:
    """A square with fields at points and cells, one of them named as a field of results."""
    side = np.linspace(0.0, 1.0, 4)
    x = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = np.arange(16).reshape(4, 4)
    a, b, c, d = (corner[i : 3 + i, j : 3 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    cells = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    x = np.column_stack([x, np.zeros(16)])
    s = 2 + x[:, 0] - 0.5 * x[:, 1]
    half = (x[cells].mean(axis=1)[:, 0] > 0.5).astype(float)
    v = np.stack([x[:, 0] - x[:, 1], 1 + 0.1 * x[:, 0], 0 * x[:, 0]], axis=1)
    data = {"s": s, "v": v, "displacement": 3 * s, "points": s}
    mesh = meshio.Mesh(x, [("triangle", cells)], point_data=data, cell_data={"half": [half]})
    on_root(COMM, lambda: mesh.write(file))


def test_fields_of_a_mesh_file_come_out_again(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """In each format, read again as a mesh with fields; names of results get an ending."""
    plate(folder / "part.vtu")
    body = read_body(folder / "part.vtu")
    problem = Problem(body, LAW, degree=1)
    names = ("s", "v", "half", "points_of_mesh", "displacement", "displacement_of_mesh")
    state = State(0, 0.0, problem.u, done=1.0)
    for name in ("xdmf", "vtu", "vtkhdf", "csv", "msh"):
        writer = FORMATS[name](fields=names).open(problem, folder)
        writer.write(state)
        writer.close()
    if COMM.rank == 0:
        assert "the field of the body is 'displacement_of_mesh'" in caplog.text
    for file in ("results.xdmf", "results.msh", "results_vtu/000000_0.vtu"):
        if file.endswith(".vtu") and COMM.size > 1:
            continue  # a piece of each rank
        again = read_body(folder / file)
        s = 2 + again.mesh.geometry.x[:, 0] - 0.5 * again.mesh.geometry.x[:, 1]
        for field, factor in (("s", 1), ("points_of_mesh", 1), ("displacement_of_mesh", 3)):
            found = again.fields[field].values
            np.testing.assert_allclose(found[:, 0], factor * s, rtol=0, atol=2e-14, err_msg=file)
        assert not again.fields["displacement"].values.any()
        middles = again.mesh.geometry.x[again.mesh.geometry.dofmap].mean(axis=1)
        np.testing.assert_array_equal(again.fields["half"].values[:, 0], middles[:, 0] > 0.5)


def test_probes_have_the_values_at_vertices() -> None:
    """Those of the array; round an axis those of the vector at (0.5, 1): r is along (1, 2)."""
    body = given(3)
    vertex = [0.5, 1.0, 0.5]
    known = {name: row[0] for name, row in linear(np.array([vertex])).items()}
    problem = Problem(body, LAW, degree=1, axes={"z": CylindricalAxes()})
    names = ["s", "v3", "T", "v2", "v3_r_in_z", "T_rr_in_z"]
    probe = Probe(problem, {"at": vertex, "inside": [0.3, 0.2, 0.9]}, names)
    state = State(0, 0.0, problem.u)
    found = probe(state)
    e = np.array([1, 2, 0]) / np.sqrt(5)
    np.testing.assert_allclose(found["at_v3_r_in_z"], [e @ known["v3"]], atol=1e-14)
    np.testing.assert_allclose(
        found["at_T_rr_in_z"], [e @ known["T"].reshape(3, 3) @ e], atol=1e-14
    )
    written = Evaluator(problem, names)(state)
    here = np.all(np.abs(problem.places[: len(written["s"])] - vertex) < 1e-12, axis=1)
    for name in ("v3_r_in_z", "T_rr_in_z"):
        at = np.broadcast_to(found[f"at_{name}"], (int(here.sum()), 1))
        np.testing.assert_allclose(written[name][here], at, atol=1e-14)
    for name, row in known.items():
        size = 3 if name.startswith("v") else len(row)
        np.testing.assert_allclose(found[f"at_{name}"], padded(row[None])[0, :size], atol=1e-14)
    assert found["inside_s"] == pytest.approx([2.2], abs=1e-14)


def test_numbers_of_a_part() -> None:
    """Mean, largest and integral of what is linear, and of cells that of their area."""
    body = given(2)
    problem = Problem(body, LAW, degree=2)
    probes = {
        "right": ProbePoint(on="right", fields=("s", "v2"), values=("max", "integral")),
    }
    found = Probe.of(probes, problem, 1.0)(State(0, 0.0, problem.u))
    np.testing.assert_allclose(found["right_s_max"], [3.0], rtol=1e-14)
    np.testing.assert_allclose(found["right_s_area_integral"], [2.75], rtol=1e-14)
    np.testing.assert_allclose(found["right_v2_area_integral"], [0.5, 1.1], rtol=1e-13)


def test_names_that_results_cannot_hold() -> None:
    body = given(2)
    own = len(body.mesh.geometry.x)
    body.fields["six"] = MeshField("point", np.zeros((own, 6)))
    body.fields["a/b"] = MeshField("point", np.zeros((own, 1)))
    body.fields["rank"] = MeshField("point", np.zeros((own, 1)))
    assert check_field_names(["s", "s", "rank_of_mesh"], body) == ("s", "rank_of_mesh")
    for name, message in (
        ("six", "the field 'six' of the body has 6 components"),
        ("a/b", "the field 'a/b' of the body has a name"),
        ("v2 of cell", "there is no field 'v2 of cell'; did you mean 'v2 of cells'"),
    ):
        with pytest.raises(InputError, match=message):
            check_field_names([name], body)
    assert field_table(body)["rank_of_mesh"].centre == "node"
    body.fields["rank_of_mesh"] = MeshField("point", np.ones((own, 1)))  # of an earlier run
    found = {name: row.of_body for name, row in field_table(body).items() if "rank_" in name}
    assert found["rank_of_mesh"] is body.fields["rank_of_mesh"]
    assert found["rank_of_mesh_of_mesh"] is body.fields["rank"]
    with pytest.raises(InputError, match="a probe cannot read 'rank'"):
        Probe(Problem(body, LAW, degree=1), {"at": [0, 0]}, ["rank"])


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (
            {"fields": ["hlaf"]},
            r"output.fields\[0\]: there is no field 'hlaf'; did you mean 'half'",
        ),
        ({"pictures": [{"field": "hlaf"}]}, r"output.pictures\[0\].field: .*'half'"),
        ({"probes": {"a": {"at": [0, 0], "fields": ["hlaf"]}}}, "output.probes.a.fields: .*'half'"),
        (
            {"fields": ["nof"], "probes": {"a": {"on": "left", "fields": ["x"]}}},
            "nof(.|\n)*read 'x",
        ),
    ],
)
def test_wrong_names_are_told_with_those_of_the_body(
    output: Any, message: str, folder: Path
) -> None:
    plate(folder / "part.vtu")
    tables = TABLES | {"mesh": {"file": "part.vtu", "degree": 1}, "output": output}
    case = Case.from_dict(tables, folder)
    with pytest.raises(InputError, match=message):
        check(case, case.read_body())
