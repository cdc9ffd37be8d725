"""Fields of other files as values of loads and supports: those of the formula that they follow."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from dolfinx import fem
from dolfinx.io import XDMFFile
from mpi4py import MPI

from dolfin_elastic import Body, Case, Statics
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.rest import read_case
from dolfin_elastic.case.toml import toml_text
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import box_body, read_body, rectangle_body
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.outputs import FORMATS

COMM = MPI.COMM_WORLD
UNITS = "1 + 2*x - 0.5*y"
"""Linear in the place: its values at the nodes of any mesh say all."""


def linear(x: np.ndarray) -> np.ndarray:
    return np.asarray(1 + 2 * x[:, 0] - 0.5 * x[:, 1])


def other_mesh(cells: int, dim: int = 2, size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of a square or cube on one rank."""
    made = box_body if dim == 3 else rectangle_body
    body = made(size=(size,) * dim, cells=(cells,) * dim, comm=MPI.COMM_SELF)
    return np.array(body.mesh.geometry.x), np.array(body.mesh.geometry.dofmap)


def written(path: Path, cells: int, scale: float = 1.0, dim: int = 2, size: float = 1.0) -> Path:
    """A file with T [degC], p [kPa], u and, in cells, q. Collective; the same path on all ranks."""

    def write() -> None:
        x, rows = other_mesh(cells, dim, size)
        t = linear(x)
        middles = linear(x[rows].mean(axis=1))
        kind = "tetra" if dim == 3 else "triangle"
        data = {"T": 20 + t, "p": 1e-3 * t, "u": np.stack([t, -t, 0 * t], axis=1)}
        meshio.Mesh(scale * x, [(kind, rows)], data, {"q": [middles]}).write(path)

    on_root(COMM, write)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(COMM.bcast(str(tmp_path)))


def case(folder: Path, key: str = "load", degree: int = 1, **row: Any) -> Case:
    tables: dict[str, Any] = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [3, 3]}, "degree": degree},
        "materials": {"one": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "expansion": 1e-5}},
        "support": [{"on": "left"}],
        "load": [{"kind": "pressure", "on": "right", "value": 1.0}],
    }
    tables[key] = [*tables["support"] * (key == "support"), row]
    return Case.from_dict(tables, folder)


def moved(made: Case) -> np.ndarray:
    problem = made.make_problem(made.read_body())
    *_, state = Statics(problem).steps()
    return np.array(state.u.x.array)


def same(found: np.ndarray, known: np.ndarray, rtol: float = 1e-11) -> None:
    size = COMM.allreduce(float(np.abs(known).max(initial=0.0)), op=MPI.MAX)
    assert size > 0.0
    np.testing.assert_allclose(found, known, rtol=0, atol=rtol * size)


T = {"field": "T", "unit": "degC", "reference": 20.0}
ROWS: dict[str, tuple[dict[str, Any], Any, Any]] = {
    "thermal": ({"kind": "thermal"}, T, UNITS),
    "pressure": ({"kind": "pressure", "on": "top"}, {"field": "p", "unit": "kPa"}, UNITS),
    "traction": (
        {"kind": "traction", "on": "top"},
        {"field": "u"},
        [UNITS, f"-({UNITS})"],
    ),
}


@pytest.mark.parametrize("kind", ROWS)
def test_a_field_of_another_mesh_is_the_formula(kind: str, folder: Path) -> None:
    """A linear field of a finer mesh whose nodes are none of the body's, to round-off."""
    written(folder / "fine.vtu", 7)
    row, field, formula = ROWS[kind]
    found = moved(case(folder, **row, value={**field, "file": "fine.vtu"}))
    same(found, moved(case(folder, **row, value=formula)))


def test_a_field_prescribes_displacements(folder: Path) -> None:
    written(folder / "fine.vtu", 5)
    field = {"field": "u", "file": "fine.vtu"}
    known = [UNITS, f"-({UNITS})"]
    row = {"on": "right", "curve": "1e-3*t"}
    found = moved(case(folder, "support", 2, **row, displacement=field))
    same(found, moved(case(folder, "support", 2, **row, displacement=known)))


def field(on: Body, folder: Path, **table: Any) -> np.ndarray:
    """Values of a field at the nodes or cells of a body."""
    from dolfin_elastic.case.field_files import add_fields

    add_fields(on, {"load": [{"value": table}]}, folder)
    *_, found = on.fields.values()
    return found.values[:, 0]


@pytest.mark.parametrize("dim", [2, 3])
def test_values_are_interpolated_exactly(dim: int, folder: Path) -> None:
    """To 1e-12, and on the same mesh the values of its cells; of a file in mm."""
    written(folder / "fine.vtu", 5, 1e3, dim)
    made = box_body if dim == 3 else rectangle_body
    body = made(size=(1,) * dim, cells=(3,) * dim)
    values = field(body, folder, field="T", file="fine.vtu", mesh_unit="mm")
    np.testing.assert_allclose(values, 20 + linear(body.mesh.geometry.x), rtol=1e-12)
    same_one = made(size=(1,) * dim, cells=(5,) * dim)
    values = field(same_one, folder, field="q", file="fine.vtu", mesh_unit="mm")
    mesh = same_one.mesh
    middles = linear(mesh.geometry.x[mesh.geometry.dofmap].mean(axis=1))
    np.testing.assert_allclose(values, middles, rtol=1e-12)


def test_beyond_a_mesh_the_nearest_place_counts(folder: Path) -> None:
    """The file has the square up to 1, the body up to 2; beyond it the value at its edge holds."""
    written(folder / "small.vtu", 4)
    body = rectangle_body(size=(2, 2), cells=(4, 4))
    values = field(body, folder, field="T", file="small.vtu", outside="nearest")
    inside = np.minimum(body.mesh.geometry.x, 1.0)
    np.testing.assert_allclose(values, 20 + linear(inside), rtol=1e-12)


def test_the_nearest_place_may_be_in_a_cell_that_is_not_around(folder: Path) -> None:
    """All of the body lies in the box around a large cell, and beside a small one."""

    def write() -> None:
        corners = [[0, 0], [10, 0], [0, 10], [10.2, 9.5], [11, 9.5], [11, 10.5]]
        x = np.column_stack([np.array(corners), np.zeros(6)])
        rows = np.arange(6).reshape(2, 3)
        meshio.Mesh(x, [("triangle", rows)], {"T": [0, 0, 0, 1, 1, 1]}).write(folder / "a.vtu")

    on_root(COMM, write)
    on = rectangle_body(size=(0.25, 0.25), cells=(2, 2), origin=(9.7, 9.7))
    values = field(on, folder, field="T", file="a.vtu", outside="nearest")
    np.testing.assert_allclose(values, 1.0, rtol=1e-12)


def test_parts_that_touch_have_the_values_of_their_own_side(folder: Path) -> None:
    """Nodes of both parts are at one place; temperatures differ across the joint."""

    def write() -> None:
        x, rows = other_mesh(4)
        both = np.concatenate([x, x + np.eye(3)[0]])
        t = np.repeat([1.0, 2.0], len(x))
        cells = [("triangle", np.concatenate([rows, rows + len(x)]))]
        meshio.Mesh(both, cells, {"T": t}).write(folder / "two.vtu")

    on_root(COMM, write)
    body = read_body(folder / "two.vtu")
    assert [*body.fields] == ["T"]
    values = field(body, folder, field="T", file="two.vtu")
    np.testing.assert_allclose(values, body.fields["T"].values[:, 0], rtol=1e-14)


def steps(path: Path) -> None:
    """T = 20 + linear at t = 0.5, 30 + linear at t = 2: of DOLFINx or Gmsh. Collective."""
    if path.suffix == ".xdmf":
        mesh = rectangle_body(size=(1, 1), cells=(4, 4)).mesh
        u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="T")
        with XDMFFile(COMM, path, "w") as file:
            file.write_mesh(mesh)
            for t, at in ((0.5, 20.0), (2.0, 30.0)):
                u.interpolate(lambda x, at=at: at + linear(x.T))
                file.write_function(u, t)
        return

    def write() -> None:
        x, rows = other_mesh(4)
        meshio.Mesh(x, [("triangle", rows)]).write(path, file_format="gmsh22", binary=False)
        with path.open("a") as file:
            for t, at in ((0.5, 20.0), (2.0, 30.0)):
                rows = [f"{i + 1} {v!r}\n" for i, v in enumerate((at + linear(x)).tolist())]
                head = f'$NodeData\n1\n"T"\n1\n{t}\n3\n0\n1\n{len(x)}\n'
                file.write(f"{head}{''.join(rows)}$EndNodeData\n")

    on_root(COMM, write)


@pytest.mark.parametrize("name", ["a.xdmf", "a.msh"])
def test_a_step_is_chosen_by_its_time(name: str, folder: Path) -> None:
    """The last one by default."""
    steps(folder / name)
    body = rectangle_body(size=(1, 1), cells=(3, 3))
    known = linear(body.mesh.geometry.x)
    for given, at in (({}, 30.0), ({"time": 0.5}, 20.0), ({"time": 2}, 30.0)):
        values = field(body, folder, field="T", file=name, **given)
        np.testing.assert_allclose(values, at + known, rtol=1e-12)
    with pytest.raises(InputError, match=r"no time step at 1; one of 2, such as 0.5, 2"):
        field(body, folder, field="T", file=name, time=1.0)


def test_results_of_a_run_are_fields(folder: Path) -> None:
    """Of the last step, in metres whatever the unit of the other mesh is."""
    made = case(folder, **ROWS["pressure"][0], value="2 kPa")
    problem = made.make_problem(made.read_body())
    writer = FORMATS["xdmf"](fields=["displacement"]).open(problem, folder)
    for step in (0, 1):
        u = fem.Function(problem.V)
        u.interpolate(lambda x, step=step: step * x[:2])
        writer.write(State(step, float(step), u, done=float(step)))
    writer.close()
    tables = {**made.to_dict(), "mesh": {**MM, "degree": 1}}
    tables["load"] = [{"kind": "traction", "on": "top", "value": RESULT}]
    body = Case.from_dict(tables, folder).read_body()
    values = body.fields["displacement of results.xdmf"].values
    np.testing.assert_allclose(values[:, :2], body.mesh.geometry.x[:, :2], atol=1e-14)


def test_fields_of_other_files_are_results(folder: Path) -> None:
    """By the name that the body gives them, also where something else is wrong."""
    written(folder / "fine.vtu", 7)
    made = case(folder, kind="thermal", value={**T, "file": "fine.vtu"})
    tables = {**made.to_dict(), "output": {"fields": ["T of fine.vtu"]}}
    made = Case.from_dict(tables, folder)
    body = made.read_body()
    check(made, body)
    problem = made.make_problem(body)
    writer = FORMATS["xdmf"](fields=["T of fine.vtu"]).open(problem, folder)
    writer.write(State(0, 0.0, problem.u, done=1.0))
    writer.close()
    again = read_body(folder / "results.xdmf")
    known = 20 + linear(again.mesh.geometry.x)
    found = again.fields["T of fine.vtu"].values[:, 0]
    np.testing.assert_allclose(found, known, rtol=1e-13)
    tables["support"] = [{"onn": "left"}]
    on_root(COMM, lambda: (folder / "case.toml").write_text(toml_text(tables)))
    with pytest.raises(InputError) as caught:
        read_case(folder / "case.toml")
    assert [error.where.partition(": ")[2] for error in caught.value.each] == ["support[0]"]


MM = {"rectangle": {"size": [1000, 500], "cells": [2, 2]}, "unit": "mm"}
RESULT = {"field": "displacement", "file": "results.xdmf", "unit": "MPa"}

BAD: list[tuple[dict[str, Any], str]] = [
    ({"field": "T", "file": "fin.vtu"}, r"there is no mesh file .*fine.vtu"),
    ({"field": "TT", "file": "fine.vtu"}, r"no field 'TT' in fine.vtu; did you mean 'T'"),
    (
        {"field": "u", "file": "fine.vtu"},
        "has 3 components; expected a scalar, with 1",
    ),
    ({"field": "T", "file": "fine.vtu", "unit": "MPa"}, r"'MPa' has the wrong unit"),
    ({"field": "T", "file": "fine.vtu", "time": 1.0}, "a .vtu file has one time step"),
    ({"field": "T", "file": "fine.vtu", "mesh_unit": "mm"}, r"lie outside of its mesh, the first"),
    ({"field": "T", "file": "fine.vtu", "mesh_unit": "kg"}, r"mesh_unit: '1 kg' has the wrong"),
    ({"field": "T", "file": "solid.vtu"}, "its mesh is of 3 dimensions, the body of 2"),
    ({"field": "T", "file": "a.step"}, "a CAD file has no fields"),
    ({"field": "T", "outside": "nearest"}, "outside: this is for a field of another file"),
    ({"field": "T", "file": "fine.vtu", "outside": "far"}, "known: error, nearest"),
    ({"field": "T", "file": "short.vtu"}, r"the array 'T': 15 numbers, 16 are needed"),
]


def cut_short(folder: Path) -> None:
    """A file of text whose T lacks its last number."""
    meshio.vtu.write(folder / "short.vtu", meshio.read(folder / "fine.vtu"), binary=False)
    text = (folder / "short.vtu").read_text()
    whole = re.search(r'Name="T"[^>]*>([^<]*)<', text)
    assert whole is not None
    (folder / "short.vtu").write_text(text.replace(whole[1], whole[1].strip().rpartition("\n")[0]))


@pytest.mark.parametrize(("value", "said"), BAD)
def test_what_does_not_fit_is_refused(value: dict[str, Any], said: str, folder: Path) -> None:
    """With the key and, of sizes, both; on all ranks."""
    written(folder / "fine.vtu", 3)
    written(folder / "solid.vtu", 2, dim=3)
    on_root(COMM, lambda: cut_short(folder))
    with pytest.raises(InputError, match=said) as caught:
        made = case(folder, "load", kind="thermal", value=value)
        check(made, made.read_body())
    assert "load[0].value" in str(caught.value)
