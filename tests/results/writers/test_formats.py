"""Fields in VTU, VTKHDF, CSV and .msh, read back by the libraries that people use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import Case, NeoHookean, Problem, box_body, rectangle_body
from dolfin_elastic.core.errors import CaseError, InputError, RestartError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.outputs import FORMATS
from dolfin_elastic.results.writer import Writer

COMM = MPI.COMM_WORLD
H = np.array([[0.10, 0.20, -0.05], [0.03, -0.08, 0.04], [0.00, 0.06, 0.12]])
FIELDS = ("displacement", "jacobian", "green_strain", "material")
TIMES = [0.0, 0.25, 0.5, 1.0]
VOLUME = {2: 2.0, 3: 2.0}
Values = dict[str, Any]


def problem(dim: int, degree: int) -> Problem:
    make = (rectangle_body, box_body)[dim - 2]
    body = soft_and_hard(make(size=(2.0, 1.0, 1.0)[:dim], cells=(2, 1, 1)[:dim]), at=1.0)
    law = NeoHookean(E=200.0, nu=0.3)
    return Problem(body, {"soft": law, "hard": law}, degree=degree)


def state(made: Problem, step: int) -> State:
    """The state in which F = I + t H."""
    u, dim = fem.Function(made.V), made.body.dim
    u.interpolate(lambda x: TIMES[step] * (H[:dim, :dim] @ x[:dim]))
    return State(step, TIMES[step], u, done=TIMES[step])


def displacement(x: Any, t: float, dim: int) -> Any:
    """What a reader must find at the places x."""
    inside = np.outer(np.arange(3) < dim, np.arange(3) < dim)
    return t * x @ np.where(inside, H, 0.0).T


def gradient(t: float, dim: int) -> Any:
    inside = np.outer(np.arange(3) < dim, np.arange(3) < dim)
    return np.eye(3) + t * np.where(inside, H, 0.0)


def read_vtu(path: Path, t: float) -> Values:
    import pyvista

    reader = pyvista.get_reader(str(path))
    reader.set_active_time_value(t)
    grid = reader.read()[0]
    own = np.asarray(grid["vtkGhostType"]) == 0
    return {**_of_grid(grid, np.flatnonzero(own)), "times": list(reader.time_values)}


def read_vtkhdf(path: Path, t: float) -> Values:
    import pyvista
    import vtk

    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    reader.UpdateTimeStep(t)
    grid = pyvista.wrap(reader.GetOutputDataObject(0))
    return {**_of_grid(grid, np.arange(grid.n_points)), "times": list(times)}


def _of_grid(grid: Any, nodes: Any) -> Values:
    kinds = {5: 3, 22: 6, 10: 4, 24: 10}
    sizes = grid.compute_cell_sizes()
    volume = np.sum(sizes["Volume"]) or np.sum(sizes["Area"])
    return {
        "x": np.asarray(grid.points)[nodes],
        "displacement": np.asarray(grid["displacement"])[nodes],
        "jacobian": np.asarray(grid["jacobian"]),
        "green_strain": np.asarray(grid["green_strain"]),
        "material": np.asarray(grid["material"]),
        "middles": grid.cell_centers().points,
        "nodes": {kinds[kind] for kind in grid.celltypes},
        "volume": volume,
    }


def read_csv(path: Path, t: float) -> Values:
    index = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding=None)
    row = index[int(np.argmin(np.abs(index["t"] - t)))]
    nodes, cells = (
        np.genfromtxt(path.parent / row[name], delimiter=",", names=True)
        for name in ("nodes", "cells")
    )
    assert sorted(nodes["node"]) == list(range(len(nodes)))
    assert sorted(cells["cell"]) == list(range(len(cells)))
    tensor = [f"green_strain_{a}{b}" for a in "xyz" for b in "xyz"]
    return {
        "x": np.column_stack([nodes[a] for a in "xyz"]),
        "displacement": np.column_stack([nodes[f"displacement_{a}"] for a in "xyz"]),
        "jacobian": cells["jacobian"],
        "green_strain": np.column_stack([cells[name] for name in tensor]),
        "material": cells["material"],
        "middles": np.column_stack([cells[a] for a in "xyz"]),
        "times": list(index["t"]),
    }


def read_msh(path: Path, t: float) -> Values:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        found: Values = {}
        cell_tags: Any = []
        for tag in gmsh.view.getTags():
            index = gmsh.view.getIndex(tag)
            name = gmsh.option.getString(f"View[{index}].Name")
            count = int(gmsh.option.getNumber(f"View[{index}].NbTimeStep"))
            times = [gmsh.view.getModelData(tag, k)[3] for k in range(count)]
            _, tags, values, _, _ = gmsh.view.getModelData(tag, times.index(t))
            assert len(set(tags)) == len(tags)
            found |= {name: np.array(values), "times": times}
            if name == "material":
                cell_tags = tags
            if name == "displacement":
                found["x"] = np.array([gmsh.model.mesh.getNode(node)[0] for node in tags])
        dim = gmsh.model.getDimension()
        _, (tags,), (nodes,) = gmsh.model.mesh.getElements(dim)
        found["volume"] = np.sum(gmsh.model.mesh.getElementQualities(tags, "volume"))
        assert np.min(gmsh.model.mesh.getElementQualities(tags, "minDetJac")) > 0
        found["nodes"] = {len(nodes) // len(tags)}
        assert len(gmsh.model.getPhysicalGroups()) == 2
        corners = [gmsh.model.mesh.getElement(tag)[1][: dim + 1] for tag in cell_tags]
        found["middles"] = np.array(
            [np.mean([gmsh.model.mesh.getNode(n)[0] for n in cell], axis=0) for cell in corners]
        )
        return found
    finally:
        gmsh.finalize()


READERS: dict[str, Callable[[Path, float], Values]] = {
    "vtu": read_vtu,
    "vtkhdf": read_vtkhdf,
    "csv": read_csv,
    "msh": read_msh,
}


def write(made: Problem, folder: Path, steps: range) -> dict[str, Writer]:
    """All formats but XDMF, open, with these states."""
    writers = {name: FORMATS[name](fields=FIELDS).open(made, folder) for name in READERS}
    for step in steps:
        for writer in writers.values():
            writer.write(state(made, step))
    return writers


def check(folder: Path, name: str, made: Problem, steps: list[int]) -> None:
    """What a reader finds of these states agrees with them to the last digits."""
    dim, count = made.body.dim, made.V.dofmap.index_map.size_global
    nodes = made.V.dofmap.list.shape[1]

    def compare() -> None:
        for step in steps:
            t = TIMES[step]
            found = READERS[name](folder / FORMATS[name]().file, t)
            assert found["times"] == [TIMES[k] for k in steps]
            F = gradient(t, dim)
            assert len(found["x"]) == count
            values = np.reshape(found["displacement"], (-1, 3))
            np.testing.assert_allclose(values, displacement(found["x"], t, dim), atol=1e-14)
            np.testing.assert_allclose(np.ravel(found["jacobian"]), np.linalg.det(F), rtol=1e-13)
            green = np.tile(((F.T @ F - np.eye(3)) / 2).ravel(), (len(found["jacobian"]), 1))
            np.testing.assert_allclose(
                np.reshape(found["green_strain"], (-1, 9)), green, atol=1e-13
            )
            soft = found["middles"][:, 0] < 1.0
            assert np.array_equal(np.ravel(found["material"]), np.where(soft, 0, 1))
            if "volume" in found:  # of quadratic cells in the right order of nodes only
                assert found["nodes"] == {nodes}
                assert found["volume"] == pytest.approx(VOLUME[dim], rel=1e-12)

    on_root(COMM, compare)


@pytest.mark.sample(2)
@pytest.mark.parametrize(("dim", "degree"), [(3, 2), (2, 1), (3, 1), (2, 2)])
def test_readers_find_what_was_written(folder, dim, degree):
    """In PyVista, VTK, numpy and Gmsh: times, places, values, kinds of cells and their volume.

    The writers are not closed: all that was written is there when a run is killed.
    """
    made = problem(dim, degree)
    write(made, folder, range(4))
    for name in READERS:
        check(folder, name, made, [0, 1, 2, 3])


def test_meshio_reads_pieces_and_msh(folder):
    made = problem(3, 2)
    write(made, folder, range(2))

    def compare() -> None:
        import meshio

        pieces = [meshio.read(p) for p in sorted((folder / "results_vtu").glob("000001_*.vtu"))]
        assert len(pieces) == COMM.size
        cells = sum(len(block.data) for piece in pieces for block in piece.cells)
        assert cells == made.body.mesh.topology.index_map(3).size_global
        for mesh in (*pieces, meshio.read(folder / "results.msh")):
            assert [block.type for block in mesh.cells] == ["tetra10"]
            t = TIMES[1]
            expected = displacement(mesh.points, t, 3)
            np.testing.assert_allclose(mesh.point_data["displacement"], expected, atol=1e-14)

    on_root(COMM, compare)


@pytest.mark.parametrize("name", READERS)
def test_a_restart_goes_on_with_each_format(folder, name):
    """What came after the checkpoint is cut off; the rest is as if nothing had happened."""
    made = problem(3, 1)
    output = FORMATS[name](fields=FIELDS)
    first = output.open(made, folder)
    for step in (0, 1):
        first.write(state(made, step))
    saved = first.restart_state()
    first.write(state(made, 3))  # of a run that goes on and is killed
    again = output.open(made, folder, saved)
    for step in (2, 3):
        again.write(state(made, step))
    again.close()
    check(folder, name, made, [0, 1, 2, 3])


@pytest.mark.parametrize("name", READERS)
def test_a_restart_without_its_results_is_refused(folder, name):
    made = problem(2, 1)
    output = FORMATS[name](fields=FIELDS)
    writer = output.open(made, folder)
    writer.write(state(made, 0))
    saved = writer.restart_state()
    on_root(COMM, (folder / output.file).unlink)
    with pytest.raises(RestartError, match="steps that the checkpoint knows of are not there"):
        output.open(made, folder, saved)


def test_gmsh_passes_over_a_section_that_was_being_written(folder):
    """A kill leaves the lines of a section whose first letter is not there yet."""
    made = problem(3, 1)
    write(made, folder, range(2))

    def spoil() -> None:
        text = (folder / "results.msh").read_bytes()
        begun = text[text.rindex(b"$NodeData") :][:200]
        with (folder / "results.msh").open("ab") as file:
            file.write(b"\0" + begun[1:] + b"\0" * 100)

    on_root(COMM, spoil)
    check(folder, "msh", made, [0, 1])


def test_another_run_removes_formats_that_it_does_not_write(folder):
    made = problem(2, 1)
    for writer in write(made, folder, range(1)).values():
        writer.close()

    def remove() -> set[str]:
        (folder / "results_vtu" / "mine.txt").write_text("kept")
        for kind in FORMATS.values():
            kind().remove(folder)
        return {str(p.relative_to(folder)) for p in folder.rglob("*")}

    assert on_root(COMM, remove) == {"results_vtu", "results_vtu/mine.txt"}


def test_wrong_formats_are_refused():
    tables = {
        "mesh": {"rectangle": {"size": [1, 1], "cells": [1, 1]}},
        "materials": {"rubber": {"law": "neo-hookean", "E": 1.0, "nu": 0.3}},
        "support": [{"on": "left"}],
        "output": {"formats": ["vtk"]},
    }
    with pytest.raises((CaseError, InputError)) as caught:
        Case.from_dict(tables)
    assert "output.formats[0]" in str(caught.value)
    assert "unknown format 'vtk'" in str(caught.value)
    assert "vtu" in str(caught.value)
    with pytest.raises((CaseError, InputError), match="at the end of a run"):
        Case.from_dict({**tables, "output": {"formats": ["xdmf", "frd"]}})
    with pytest.raises((CaseError, InputError), match="no format is given"):
        Case.from_dict({**tables, "output": {"formats": []}})
