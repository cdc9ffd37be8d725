"""Exports of finished runs, read back by parsers of their own, meshio, VTK and USD.

The displacement is quadratic, u(X), so that nodes and points inside of quadratic cells have known
places.  Numbers of four bytes are right to half their last digit.
"""

from __future__ import annotations

import json
import shutil
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import matplotlib as mpl
import numpy as np
import pytest
from helpers.states import COMM, displacement, make_problem, make_state

from dolfin_elastic import Case
from dolfin_elastic.cli.tools.convert import convert
from dolfin_elastic.core.errors import InputError, MeshError, OutputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.results.exports import glb, moving, tables
from dolfin_elastic.results.exports.export import export
from dolfin_elastic.results.exports.output import Export
from dolfin_elastic.results.exports.settings import ExportSettings
from dolfin_elastic.results.exports.skin import _weights
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.outputs import History, Summary, Xdmf

EPS = 2.0**-23
TIMES = [0.25, 0.5, 1.0]
FIELDS = ("displacement", "von_mises", "cauchy_stress", "material")
UPRIGHT = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # x, z, -y: columns of row vectors


def written(folder: Path, dim: int, degree: int, exports: tuple[Export, ...] = ()) -> None:
    """Three states of a known displacement, and what is exported of them at the end. Collective."""
    problem = make_problem(dim, degree, cells=1)
    outputs = (Xdmf(fields=FIELDS), History(), Summary(case={"title": "A beam"}), *exports)
    writers = [output.open(problem, folder) for output in outputs]
    for step, t in enumerate(TIMES):
        state = make_state(problem, step + 1, t, done=t)
        for writer in writers:
            writer.write(state)
    for writer in writers:
        writer.close()


@pytest.fixture(scope="module")
def beam(folder_of_module: Path) -> Path:
    written(folder_of_module / "beam", 3, 2)
    return folder_of_module / "beam"


def rooted(check: Callable[..., None]) -> Callable[..., None]:
    """A test on one rank of what all have written."""

    def test(beam: Path, tmp_path: Path) -> None:
        on_root(COMM, lambda: check(beam, tmp_path))

    test.__doc__ = check.__doc__
    return test


def written_as(beam: Path, file: Path, **settings: Any) -> Any:
    return export(FinishedRun(beam), file, ExportSettings(**settings))


def colours_of(norms: list[Any]) -> list[Any]:
    """The colours of values: 256 shades of viridis from a fifth on, and what lies between them."""
    low, high = min(map(np.min, norms)), max(map(np.max, norms))
    shades = mpl.colormaps["viridis"](np.linspace(0.2, 1.0, 256))
    at = np.linspace(low, high, 256)
    return [np.stack([np.interp(n, at, shades[:, i]) for i in range(3)], axis=1) for n in norms]


def light(srgb: Any) -> Any:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


# --- glTF ---

SIZES = {"SCALAR": 1, "VEC3": 3}


class Glb:
    """A .glb as the specification wants it, every rule that applies asserted."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert (kind, size % 4) == (b"JSON", 0)
        self.json: dict[str, Any] = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert (kind, rest % 4) == (b"BIN\0", 0)
        self.bin = data[28 + size :]
        assert len(self.bin) == rest == self.json["buffers"][0]["byteLength"]
        used = 0
        for view in self.json["bufferViews"]:
            assert view["byteOffset"] == used
            assert view["byteOffset"] % 4 == 0
            used += view["byteLength"]
        assert used == rest

    def array(self, number: int) -> Any:
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        width = SIZES[accessor["type"]]
        assert view["byteLength"] == accessor["count"] * width * 4
        values = np.frombuffer(self.bin, kind, accessor["count"] * width, view["byteOffset"])
        values = values.reshape(-1, width)
        assert np.isfinite(values).all()
        if "min" in accessor:
            assert accessor["min"] == values.min(axis=0).tolist()
            assert accessor["max"] == values.max(axis=0).tolist()
        return values


@rooted
def test_glb(beam: Path, folder: Path) -> None:
    """Places, colours and times of all states; the z axis is up, as without weight."""
    written_as(beam, folder / "a.glb", field="displacement", scale=3.0, fps=10.0)
    file = Glb(folder / "a.glb")
    mesh = file.json["meshes"][0]
    primitive = mesh["primitives"][0]
    attributes = primitive["attributes"]
    rest = file.array(attributes["POSITION"])
    assert "min" in file.json["accessors"][attributes["POSITION"]]
    triangles = file.array(primitive["indices"]).reshape(-1, 3)
    assert triangles.max() == len(rest) - 1
    X = rest.astype(float) @ UPRIGHT.T
    # The surface of a box of two cubes, 6 cells each: closed, outwards, of 24 faces in four.
    assert len(triangles) == 4 * 20
    corners = X[triangles]
    volume = np.linalg.det(corners).sum() / 6
    assert volume == pytest.approx(2.0, rel=1e-6)
    u = [displacement(X.T, t).T for t in TIMES]
    colours = [light(c) for c in colours_of([np.linalg.norm(one, axis=1) for one in u])]
    assert np.abs(file.array(attributes["COLOR_0"]) - colours[0]).max() < EPS
    assert mesh["weights"] == [1.0, 0.0, 0.0]
    for k, target in enumerate(primitive["targets"]):
        moved = file.array(target["POSITION"]).astype(float) @ UPRIGHT.T
        assert np.abs(moved - 3.0 * u[k]).max() < 3 * EPS
        assert np.abs(file.array(attributes[f"_COLOUR_{k}"]) - colours[k]).max() < EPS
        assert np.abs(file.array(target["COLOR_0"]) - (colours[k] - colours[0])).max() < 2 * EPS
    (sampler,) = file.json["animations"][0]["samplers"]
    assert file.array(sampler["input"])[:, 0] == pytest.approx([0, 0.1, 0.2], rel=EPS)
    assert file.array(sampler["output"]).reshape(3, 3).tolist() == np.eye(3).tolist()
    assert not list(folder.glob(".*"))


@rooted
def test_glb_in_vtk(beam: Path, folder: Path) -> None:
    """VTK's reader, which is ParaView's; of one state alone it is the body itself."""
    import pyvista

    written_as(beam, folder / "a.glb", field="displacement", frames=1)
    assert "targets" not in Glb(folder / "a.glb").json["meshes"][0]["primitives"][0]
    found = pyvista.read(folder / "a.glb").combine()
    written_as(beam, folder / "a.ply", frames=1)
    other = pyvista.read(folder / "a.ply")
    assert np.abs(found.points @ UPRIGHT.T - other.points).max() < EPS
    assert found.n_cells == other.n_cells == 80


@rooted
def test_glb_too_large(beam: Path, folder: Path) -> None:
    """Its length has four bytes; nothing is left of the attempt."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(glb, "_MOST", 1000)
        with pytest.raises(InputError, match="3 states of 42 points have"):
            written_as(beam, folder / "a.glb")
    assert list(folder.iterdir()) == []


# --- series ---


@rooted
def test_ply_and_obj(beam: Path, folder: Path) -> None:
    """Read by meshio: places, colours as on a screen, and in PLY the field's values."""
    import meshio

    files = written_as(beam, folder / "a.ply", field="displacement").files
    assert [file.name for file in files] == ["a_0000.ply", "a_0001.ply", "a_0002.ply"]
    first = meshio.read(written_as(beam, folder / "b.ply", scale=0.0, frames=1).files[0])
    X = first.points.astype(float)
    u = [displacement(X.T, t).T for t in TIMES]
    norms = [np.linalg.norm(one, axis=1) for one in u]
    texts = written_as(beam, folder / "a.obj", field="displacement").files
    for k, colours in enumerate(colours_of(norms)):
        ply = meshio.read(files[k])
        assert np.abs(ply.points - (X + u[k])).max() < 3 * EPS
        assert np.abs(ply.point_data["displacement"] - norms[k]).max() < EPS
        for i, name in enumerate(("red", "green", "blue")):
            assert np.abs(ply.point_data[name] - colours[:, i]).max() < EPS
    again = meshio.read(texts[2])
    assert np.abs(again.points[:, :3] - (X + u[2])).max() < 3 * EPS
    assert (again.cells_dict["triangle"] == ply.cells_dict["triangle"]).all()
    rows = [line.split() for line in texts[2].read_text().splitlines() if line.startswith("v ")]
    assert np.abs(np.array(rows)[:, 4:].astype(float) - colours).max() < EPS


# --- USD ---


@rooted
def test_usd(beam: Path, folder: Path) -> None:
    """Points, colours and box of each state, by USD itself, whose validators are content.

    Without a time, as previews ask, it is the first state: there was nothing.
    """
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdValidation

    written_as(beam, folder / "a.usdc", field="displacement", fps=12.0)
    stage = Usd.Stage.Open(str(folder / "a.usdc"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    assert UsdValidation.ValidationContext(validators).Validate(stage) == []
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
    points = mesh.GetPointsAttr()
    assert points.GetTimeSamples() == pytest.approx([0.0, 2.0, 4.0])  # 24 a second
    written_as(beam, folder / "b.usda", scale=0.0, frames=1)
    rest = Usd.Stage.Open(str(folder / "b.usda"))
    X = np.array(rest.GetDefaultPrim().GetAttribute("points").Get(0.0), dtype=float)
    u = [displacement(X.T, t).T for t in TIMES]
    shades = colours_of([np.linalg.norm(one, axis=1) for one in u])
    for k, at in ((0, Usd.TimeCode.Default()), *enumerate(points.GetTimeSamples())):
        assert np.abs(np.array(points.Get(at)) - (X + u[k])).max() < 3 * EPS
        colours = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor").Get(at)
        assert np.abs(np.array(colours) - light(shades[k])).max() < EPS
        box = np.array(mesh.GetExtentAttr().Get(at))
        assert (box == [np.min(points.Get(at), axis=0), np.max(points.Get(at), axis=0)]).all()
    assert not list(folder.glob(".*"))


@rooted
def test_without_usd(beam: Path, folder: Path) -> None:
    """The message has the command that brings it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "pxr", None)
        with pytest.raises(InputError, match=r"a\.usdc.*usd-core.*pip install usd-core==26\.11"):
            written_as(beam, folder / "a.usdc")
    assert list(folder.iterdir()) == []


# --- tables ---


def read_frd(path: Path) -> tuple[Any, Any, list[tuple[float, str, Any]]]:
    """Nodes, cells and blocks of a .frd by the columns of its long format."""
    lines = iter(path.read_text(encoding="ascii").splitlines())
    nodes, cells, blocks = [], [], []
    for line in lines:
        if line.startswith("    2C"):
            count = int(line[24:36])
            assert line[73] == "1"
            nodes = [columns(next(lines), 3) for _ in range(count)]
            assert next(lines) == " -3"
        elif line.startswith("    3C"):
            for number in range(int(line[24:36])):
                head, row = next(lines), next(lines)
                assert head[:13] == f" -1{number + 1:10d}"
                assert (int(head[13:18]), row[:3]) == (6, " -2")
                cells.append([int(row[3 + 10 * i : 13 + 10 * i]) for i in range(10)])
            assert next(lines) == " -3"
        elif line.startswith("  100C"):
            t, count, kind = float(line[12:24]), int(line[24:36]), line[73:75]
            assert kind == " 1"
            head = next(lines)
            parts = [next(lines) for _ in range(int(head[13:18]))]
            width = sum(not part.endswith("ALL") for part in parts)
            blocks.append(
                (t, head[5:13].strip(), [columns(next(lines), width) for _ in range(count)])
            )
            assert next(lines) == " -3"
    assert line == " 9999"
    return np.array(nodes), np.array(cells), [(t, n, np.array(rows)) for t, n, rows in blocks]


def columns(line: str, width: int) -> list[float]:
    assert line[:3] == " -1"
    assert len(line) == 13 + 12 * width
    return [int(line[3:13]), *(float(line[13 + 12 * i : 25 + 12 * i]) for i in range(width))]


@rooted
def test_frd(beam: Path, folder: Path) -> None:
    """In mm and MPa, seven digits of each number; nodes of cells as in the manual.

    With the six digits of other writers the first assertion fails at 4e-6.
    """
    notes = written_as(beam, folder / "a.frd").notes
    assert notes == ("fields of elements are left out: material",)
    nodes, cells, blocks = read_frd(folder / "a.frd")
    grid = FinishedRun(beam).grid()
    assert nodes[:, 1:] == pytest.approx(1e3 * grid.points, rel=5.1e-7)
    middles = nodes[cells - 1][:, :, 1:]
    ends = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]  # nodes 5 to 10, as in the manual
    for i, (a, b) in enumerate(ends):
        assert np.abs(middles[:, 4 + i] - (middles[:, a] + middles[:, b]) / 2).max() < 0.02
    names = [(t, name) for t, name, _ in blocks]
    assert names == [(t, name) for t in TIMES for name in ("DISP", "VON_MISE", "STRESS")]
    u = displacement(grid.points.T).T
    assert blocks[-3][2][:, 1:] == pytest.approx(1e3 * u, rel=5.1e-7, abs=1e-12)
    stress = grid.point_data["cauchy_stress"].reshape(-1, 3, 3)
    six = np.stack(
        [stress[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))], 1
    )
    assert blocks[-1][2][:, 1:] == pytest.approx(1e-6 * six, rel=5.1e-7, abs=1e-12)
    assert blocks[-2][2][:, 1] == pytest.approx(1e-6 * grid.point_data["von_mises"], rel=5.1e-7)


@pytest.mark.parametrize("number", [1.0, -9.9999999996, 0.01, 1 / 3e5, 7.7777777e-12, 123456789.4])
def test_numbers_of_twelve_characters(number: float) -> None:
    """Columns have no blanks between them; one digit is lost where exponents have two."""
    for sign in (1, -1):
        text = tables._twelve(sign * number)
        assert len(text) == 12
        assert float(text) == pytest.approx(sign * number, rel=5.1e-7 if number > 1e-9 else 5.1e-6)


@rooted
def test_times_of_frd(beam: Path, folder: Path) -> None:
    """FreeCAD takes states whose times grow from above 0; others were mixed up or had no time."""
    run = FinishedRun(beam)
    for given, wanted, noted in (
        ((0.0, 0.5, 1.0), [1e-99, 0.5, 1.0], False),
        ((0.5, 1.0, 0.75), [1.0, 2.0, 3.0], True),
    ):
        run.frames = [replace(one, t=t) for one, t in zip(run.frames, given, strict=True)]
        notes = export(run, folder / "a.frd", ExportSettings()).notes
        assert [t for t, _, _ in read_frd(folder / "a.frd")[2]][::3] == wanted
        assert any("t does not grow from state to state" in note for note in notes) == noted


def test_names_of_frd() -> None:
    """Eight characters of two fields are often the same, so that programs showed one of them."""
    titles: list[str] = []
    for name in ("von_mises", "von_mises_nodal", "principal_stresses", "displacement"):
        titles.append(tables._title(name, titles))
    assert titles == ["VON_MISE", "VON_MIS2", "PRINCIPA", "DISP"]
    assert tables._title("von_mises_of_us", titles) == "VON_MIS3"


@rooted
def test_vtkhdf(beam: Path, folder: Path) -> None:
    """One file, without the results: times, mesh and all fields of VTK's reader."""
    import pyvista
    import vtk

    written_as(beam, folder / "a.vtkhdf")
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(folder / "a.vtkhdf"))
    reader.UpdateInformation()
    pipeline = vtk.vtkStreamingDemandDrivenPipeline
    assert list(reader.GetOutputInformation(0).Get(pipeline.TIME_STEPS())) == TIMES
    run = FinishedRun(beam)
    for step, t in enumerate(TIMES):
        reader.UpdateTimeStep(t)
        found, want = pyvista.wrap(reader.GetOutputDataObject(0)), run.grid(step)
        assert (found.points == want.points).all()
        assert (found.cells == want.cells).all()
        assert (found.celltypes == want.celltypes).all()
        for data, right in ((found.point_data, want.point_data), (found.cell_data, want.cell_data)):
            assert len(right.keys()) > 0
            assert all((data[name] == right[name]).all() for name in right)
    with h5py.File(folder / "a.vtkhdf") as file:  # what does not change is there once
        assert len(file["VTKHDF/CellData/material"]) == found.n_cells
        assert len(file["VTKHDF/Points"]) == found.n_points


@rooted
def test_vtkhdf_of_two_meshes(beam: Path, folder: Path) -> None:
    """After a restart on other ranks the mesh has other numbers: both are there."""
    shutil.copytree(beam, folder / "results")
    run = FinishedRun(folder / "results")
    points = run.frames[1].points
    shutil.copy(run.folder / points.file, run.folder / "results_data/other.h5")
    other = replace(points, file="results_data/other.h5")
    run.frames[1] = replace(run.frames[1], points=other)
    export(run, folder / "a.vtkhdf", ExportSettings())
    with h5py.File(folder / "a.vtkhdf") as file:
        assert file["VTKHDF/Steps/PartOffsets"][:].tolist() == [0, 1, 0]
        count = run.frames[0].points.shape[0]
        assert file["VTKHDF/Steps/PointOffsets"][:].tolist() == [0, count, 0]
        assert len(file["VTKHDF/Points"]) == 2 * count


@rooted
def test_csv(beam: Path, folder: Path) -> None:
    """All digits; a row for each node and state."""
    written_as(beam, folder / "a.csv", frames=2)
    table = np.genfromtxt(folder / "a.csv", delimiter=",", names=True)
    grid = FinishedRun(beam).grid()
    last = table[table["t"] == 1.0]
    assert set(table["t"]) == {0.25, 1.0}
    assert last["node"].tolist() == list(range(grid.n_points))
    u = np.column_stack([last[f"displacement_{a}"] for a in "xyz"])
    assert (u == grid.point_data["displacement"]).all()
    assert (last["cauchy_stress_xy"] == grid.point_data["cauchy_stress"][:, 1]).all()


# --- skins ---


@rooted
def test_skin(beam: Path, folder: Path) -> None:
    """Inside it moves as the body does, exactly; what lies outside is counted, and follows."""
    import meshio

    rng = np.random.default_rng(1)
    points = rng.uniform([0.02, 0.02, 0.02], [1.98, 0.98, 0.98], (40, 3))
    points[-1] = [2.0, 0.5, 1.25]
    faces = "".join(f"f {k} {k + 1} {k + 2}\n" for k in range(1, 39))
    text = "".join(f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in points)
    (folder / "skin.obj").write_text(text + faces)
    skin = folder / "skin.obj"
    done = written_as(beam, folder / "a.ply", field="displacement", skin=skin)
    assert done.notes == (
        "1 of 40 points of skin.obj lie outside of the body, at most 0.25 m; "
        "they follow its nearest elements",
    )
    for k, t in enumerate(TIMES):
        found = meshio.read(done.files[k])
        u = displacement(points.T, t).T
        assert np.abs(found.points - (points + u))[:-1].max() < 3 * EPS
        norms = np.linalg.norm(u, axis=1)
        assert np.abs(found.point_data["displacement"] - norms)[:-1].max() < EPS
    # Beyond the face, with the gradient there: u is bilinear, and linear along z.
    assert np.abs(found.points[-1] - (points + u)[-1]).max() < 3 * EPS
    (folder / "lines.obj").write_text(text)
    with pytest.raises(MeshError):
        written_as(beam, folder / "b.ply", skin=folder / "lines.obj")
    assert not (folder / "b.ply").exists()


@pytest.mark.parametrize("width", [4, 10])
def test_affine_motions_are_exact(width: int) -> None:
    """Also far outside, in straight and in curved cells: round-off of a Newton step."""
    rng = np.random.default_rng(2)
    corners = rng.normal(size=(20, 4, 3))
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = np.stack([(corners[:, a] + corners[:, b]) / 2 for a, b in pairs], axis=1)
    size = np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).min(axis=1)[:, None, None]
    middles = middles + 0.01 * size * rng.normal(size=middles.shape)
    nodes = np.concatenate([corners, middles], axis=1)[:, :width]
    points = 3 * rng.normal(size=(20, 3))
    weights, smooth, _ = _weights(nodes, points, corners.mean(axis=1))
    H, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    found = np.einsum("nk,nkj->nj", weights, nodes @ H + shift)
    assert np.abs(found - (points @ H + shift)).max() < 1e-10
    assert np.abs(smooth.sum(axis=1) - 1).max() < 1e-12


# --- runs and commands ---


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (3, 2)])
def test_at_the_end_of_a_run(folder: Path, dim: int, degree: int) -> None:
    """On any number of ranks; of older and longer series nothing is left."""
    old = folder / "a_0007.ply"
    on_root(COMM, lambda: old.write_text("old") and None)
    exports = (Export(file="a.ply", frames=2), Export(file="b.glb"))
    written(folder, dim, degree, exports)
    listed = [name for one in exports for name in one.listing(folder)]
    assert listed == ["a_0000.ply ... a_0001.ply (2 files)", "b.glb"]
    COMM.barrier()

    def check() -> None:
        assert not old.exists()
        file = Glb(folder / "b.glb")
        primitive = file.json["meshes"][0]["primitives"][0]
        turn = UPRIGHT if dim == 3 else np.eye(3)  # a plane stands upright
        X = file.array(primitive["attributes"]["POSITION"]) @ turn.T
        u = file.array(primitive["targets"][2]["POSITION"]) @ turn.T
        want = displacement(X.T.astype(float)).T
        want[:, dim:] = 0
        assert np.abs(u - want).max() < 3 * EPS

    on_root(COMM, check)


def test_of_a_run_without_states(folder: Path) -> None:
    """A run that fails at once has nothing to export; its own error is what is said."""
    problem = make_problem(2, 1, cells=1)
    outputs = (Xdmf(), Summary(), Export(file="a.glb"))
    writers = [output.open(problem, folder) for output in outputs]
    for writer in writers:
        writer.close("failed", "x")
    assert outputs[-1].listing(folder) == []


TABLES = {
    "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
    "materials": {"rubber": {"law": "neo-hookean", "E": 1.0, "nu": 0.3}},
    "support": [{"on": "left"}],
}


@pytest.mark.parametrize(
    ("output", "what"),
    [
        ({"exports": [{"file": "a.abc"}]}, r"exports\[0\].file.*does not end with .glb"),
        ({"exports": [{"file": "a.glb", "field": "tresca"}]}, "'tresca' is not written"),
        ({"exports": [{"file": "a.glb"}], "formats": ["vtu"]}, "are made from results.xdmf"),
        ({"exports": [{"file": "a.glb"}, {"file": "a.glb"}]}, r"\[1\].file.*an output above"),
        (
            {"exports": [{"file": "results.vtkhdf"}], "formats": ["xdmf", "vtkhdf"]},
            r"\[0\].file.*an output above",
        ),
        ({"exports": [{"file": "a.glb", "range": ["2 %", "98 %"]}]}, "percentiles are for"),
        ({"formats": ["xdmf", "frd"]}, r"'frd' is written at the end.*results\.frd"),
    ],
)
def test_what_a_case_cannot_export(output: dict[str, Any], what: str) -> None:
    """With the key, and what to write."""
    with pytest.raises(InputError, match=what):
        Case.from_dict({**TABLES, "output": output})


def test_surfaces_of_cases(folder: Path) -> None:
    """A surface that is missing is found before the run."""
    output = Export(file="a.glb", of="character.obj")
    with pytest.raises(InputError, match=r"^of: character\.obj: there is no"):
        output.check(folder)
    with pytest.raises(InputError, match=r"^file: 'a\.frd' holds all nodes.*`skin`"):
        Export(file="a.frd", of="character.obj").check(folder)


@rooted
def test_faults(beam: Path, folder: Path) -> None:
    """What is not there, is said; a name that exists is not written over."""
    with pytest.raises(InputError, match="no field 'tresca'"):
        written_as(beam, folder / "a.glb", field="tresca")
    with pytest.raises(InputError, match=r"a\.abc.*of no format"):
        written_as(beam, folder / "a.abc")
    with pytest.raises(InputError, match=r"holds all nodes and fields, `field` is of surfaces"):
        written_as(beam, folder / "a.csv", field="von_mises")
    with pytest.raises(InputError, match=r"holds all nodes and fields, `scale` is of surfaces"):
        written_as(beam, folder / "a.csv", scale=2.0)
    (folder / "file").write_text("")
    with pytest.raises(OutputError):
        written_as(beam, folder / "file" / "a.glb")
    plane = ExportSettings(skin=folder / "a.obj")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FinishedRun, "dim", 2)
        with pytest.raises(InputError, match="follows solids only"):
            export(FinishedRun(beam), folder / "a.glb", plane)


@rooted
def test_nodes_with_other_numbers(beam: Path, folder: Path) -> None:
    """A restart on other ranks numbers nodes anew: they are found by their places, or refused."""
    run = FinishedRun(beam)
    points = moving.mesh_of(run)[0]
    order = np.random.default_rng(3).permutation(len(points))
    for places, right in ((points[order], True), (points[order[:1].repeat(len(order))], False)):
        found = iter([points, places])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(moving, "read_array", lambda *_, found=found: next(found))
            if right:
                assert (order[moving._numbers_in(run, run.frame())] == range(len(order))).all()
            else:
                with pytest.raises(InputError, match="have other numbers than those"):
                    moving._numbers_in(run, run.frame())


def test_command(
    beam: Path, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One command for both: it sees what it is given."""
    monkeypatch.delenv("DOLFIN_ELASTIC_SHOWN", raising=False)
    target = folder / "a.glb"
    convert(beam, target, field="displacement", frames=2, scale=2.0, ends="0:0.5")
    if COMM.rank == 0:
        said = "2 states, 42 points, 80 triangles, colours: displacement from 0 to 500 mm"
        assert capsys.readouterr().out == f"{target} written: {said}\n"
    with pytest.raises(InputError, match="exists already.*--force"):
        convert(beam, target)
    convert(beam, target, force=True)
    with pytest.raises(InputError, match=r"^--field: .*is no folder of results"):
        convert(folder / "wing.msh", folder / "wing.xdmf", field="von_mises")
    with pytest.raises(InputError, match=r"^--range: percentiles"):
        convert(beam, target, ends="2%:98%")
    with pytest.raises(InputError, match=r"^--fps: "):
        convert(beam, target, fps=-1.0)
