"""XDMF: the files that its text names, and what is refused in them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
from dolfinx.io import XDMFFile
from dolfinx.mesh import create_unit_cube, locate_entities, meshtags
from helpers.decks import box
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import Body, mesh_statistics, read_body
from dolfin_elastic.mesh.geometry.simplices import cell_corners, facet_corners, prepare_facets

COMM = MPI.COMM_WORLD
POINTS, CUBE = box((1, 1, 1), (1, 1, 1))


def made(action: Callable[[], object]) -> None:
    """Makes files on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def write_cube(path: Path) -> None:
    meshio.Mesh(POINTS, [("tetra", CUBE)]).write(path)


def with_values(path: Path, data: Path, length: float) -> None:
    """A mesh whose text names another HDF5 file than that of its own name."""
    write_cube(path.with_name("made.xdmf"))
    text = path.with_name("made.xdmf").read_text()
    path.write_text(text.replace("made.h5:", f"{data.name}:"))
    path.with_name("made.h5").rename(data)
    with h5py.File(data, "r+") as file:
        name = next(n for n in file if file[n].shape == (8, 3))
        file[name][:] *= length


def test_the_text_says_which_file(folder: Path) -> None:
    """`p.h5` was read, the arrays of DOLFINx's name."""
    made(lambda: with_values(folder / "p.xdmf", folder / "p.h5", 3.0))
    made(lambda: with_values(folder / "p.xdmf", folder / "o.h5", 2.0))
    assert mesh_statistics(read_body(folder / "p.xdmf")).volume == pytest.approx(8)


def test_a_field_in_another_file(folder: Path) -> None:
    """Mesh and fields from two files; one in a folder below."""

    def write() -> None:
        with_values(folder / "p.xdmf", folder / "o.h5", 1.0)
        (folder / "below").mkdir()
        for name, value in (("p.h5", 5.0), ("below/q.h5", 7.0)):
            with h5py.File(folder / name, "w") as file:
                file["heat"] = np.full(8, value)
        text = (folder / "p.xdmf").read_text()
        kind = 'Dimensions="8" NumberType="Float" Format="HDF"'
        item = f"<DataItem {kind}>below/q.h5:/heat</DataItem>"
        field = f'<Attribute Name="heat" Center="Node">{item}</Attribute></Grid>'
        (folder / "p.xdmf").write_text(text.replace("</Grid>", field, 1))

    made(write)
    values = read_body(folder / "p.xdmf").fields["heat"].values
    assert values.shape[1] == 1 and np.all(values == 7.0)


def rows_of(file: Path, change: Callable[[h5py.File, str], None]) -> None:
    with h5py.File(file, "r+") as data:
        change(data, next(n for n in data if data[n].shape == (8, 3)))


def replaced(data: h5py.File, name: str, **how: object) -> None:
    del data[name]
    data.create_dataset(name, (8, 3), "f8", **how)  # type: ignore[arg-type]


def giant(data: h5py.File, name: str) -> None:
    data.create_dataset("giant", (1 << 31,), "f8", chunks=(1 << 20,), compression="gzip")


def to_another_file(data: h5py.File, name: str) -> None:
    del data[name]
    data[name] = h5py.ExternalLink("other.h5", "/points")


def not_a_number(data: h5py.File, name: str) -> None:
    data[name][3, 1] = np.nan


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (giant, "its data file 'o.h5' cannot be read: '/giant' states 17.2 GB"),
        (to_another_file, "'o.h5' cannot be read: '/.*' is a link to another file"),
        (
            lambda data, name: replaced(data, name, external=[("/etc/passwd", 0, 192)]),
            "'o.h5' cannot be read: '/.*' is stored in another file",
        ),
        (not_a_number, "1 points have coordinates that are not numbers"),
    ],
)
def test_unsafe_data_of_xdmf(
    folder: Path,
    change: Callable[[h5py.File, str], None],
    said: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """One message, and nothing of HDF5's own before it."""
    made(lambda: with_values(folder / "p.xdmf", folder / "o.h5", 1.0))
    made(lambda: rows_of(folder / "o.h5", change))
    with pytest.raises(MeshError, match=said):
        read_body(folder / "p.xdmf")
    assert "HDF5" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("o.h5:/", "/etc/o.h5:/", "its data file '/etc/o.h5:/data0' is not beside it"),
        ("o.h5:/", "../o.h5:/", r"its data file '\.\./o.h5:/data0' is not beside it"),
        ("o.h5:/data0", "o.h5:/data7", "it has no array '/data7'"),
        ("o.h5:/data0", "nowhere.h5:/data0", "its data file 'nowhere.h5' is not beside it"),
        ('Dimensions="8 3"', 'Dimensions="9 3"', r"has the shape \(8, 3\), the text says \(9, 3\)"),
        ('Dimensions="6 4"', 'Dimensions="4 6"', "of the kind tetrahedron have 4 nodes, not 6"),
        ("<Xdmf", '<!DOCTYPE x [<!ENTITY a "b">]><Xdmf', "definitions of entities"),
    ],
)
def test_texts_of_xdmf(folder: Path, old: str, new: str, said: str) -> None:
    made(lambda: with_values(folder / "p.xdmf", folder / "o.h5", 1.0))

    def change() -> None:
        text = (folder / "p.xdmf").read_text()
        assert old in text
        (folder / "p.xdmf").write_text(text.replace(old, new))

    made(change)
    with pytest.raises(MeshError, match=said):
        read_body(folder / "p.xdmf")


def test_blocks_of_xdmf(folder: Path) -> None:
    """The second half of a body was left out without a word."""

    def write() -> None:
        with_values(folder / "p.xdmf", folder / "o.h5", 1.0)
        text = (folder / "p.xdmf").read_text()
        start, end = text.index("<Grid"), text.index("</Grid>") + len("</Grid>")
        both = text[start:end] + text[start:end].replace("data1", "data9")
        blocks = f'<Grid GridType="Collection" CollectionType="Spatial">{both}</Grid>'
        (folder / "p.xdmf").write_text(text[:start] + blocks + text[end:])

    made(write)
    with pytest.raises(MeshError, match="the cells of the grid .* are beside those of"):
        read_body(folder / "p.xdmf")


PLANE = """<Xdmf><Domain>
<Grid Name="plane"><Topology TopologyType="Triangle">{cells}</Topology>{points}
<Attribute Name="kind" Center="Cell">{kinds}</Attribute></Grid>
<Grid Name="solid"><Topology TopologyType="Tetrahedron">{solid}</Topology>{points}
<Attribute Name="kind" Center="Cell">{one}</Attribute></Grid></Domain></Xdmf>"""


def write_plane(folder: Path, text: str) -> Path:
    """A square of two triangles, of which one has no kind."""
    arrays = {
        "cells": np.array([[0, 1, 2], [1, 2, 3]]),
        "solid": np.array([[0, 1, 2, 3]]),
        "points": np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]]),
        "kinds": np.array([[2.0], [np.nan]]),
        "one": np.array([[1]]),
    }

    def item(name: str) -> str:
        shape = " ".join(map(str, arrays[name].shape))
        return f'<DataItem Dimensions="{shape}" Format="HDF">a.h5:/{name}</DataItem>'

    def write() -> None:
        with h5py.File(folder / "a.h5", "w") as file:
            for name, values in arrays.items():
                file[name] = values
        items = {name: item(name) for name in arrays}
        items["points"] = f'<Geometry GeometryType="XY">{items["points"]}</Geometry>'
        (folder / "a.xdmf").write_text(text.format(**items))

    made(write)
    return folder / "a.xdmf"


def test_tags_of_larger_cells(folder: Path) -> None:
    """Of tetrahedra in a mesh of triangles: looking for them there ended the process."""
    with pytest.raises(MeshError, match="the cells of the grid 'solid' are beside those of"):
        read_body(write_plane(folder, PLANE))


def test_tags_that_are_no_numbers(folder: Path) -> None:
    end = PLANE.index('<Grid Name="solid">')
    body = read_body(write_plane(folder, PLANE[:end] + "</Domain></Xdmf>"))
    assert list(body.regions) == ["kind_2"]


def test_a_raw_file_of_xdmf_elsewhere(folder: Path) -> None:
    """It was looked for in the current folder, and read whatever it is."""

    def write() -> None:
        mesh = meshio.Mesh(POINTS, [("tetra", CUBE)])
        meshio.xdmf.write(folder / "cube.xdmf", mesh, data_format="Binary")
        text = (folder / "cube.xdmf").read_text()
        (folder / "cube.xdmf").write_text(re.sub(r">[^<>]*1\.bin", ">/dev/zero", text))

    made(write)
    with pytest.raises(MeshError, match="its data file '/dev/zero' is not beside it"):
        read_body(folder / "cube.xdmf")


def test_points_that_no_cell_uses(folder: Path) -> None:
    """They are dropped with a note; tags and fields are those of the same mesh without them.

    The first, one in the midst and the last, of which one has no place and one is in a tag.
    """
    extra = [0, 5, 10]
    rows = np.setdiff1d(np.arange(11), extra)
    x = np.full((11, 3), 7.0)
    x[rows], x[5] = POINTS, np.nan
    facets = np.unique(np.sort(np.concatenate([CUBE[:, [0, 1, 2]], CUBE[:, [1, 2, 3]]])), axis=0)
    marks = 1 + np.arange(len(facets)) % 2

    def write(name: str, points: np.ndarray, number: Any, more: list[list[int]]) -> None:
        heat = np.full(len(points), -1.0)
        heat[number(np.arange(8))] = np.arange(8.0)
        mesh = meshio.Mesh(
            points,
            [("tetra", number(CUBE))],
            point_data={"heat": heat},
            cell_data={"region": [np.arange(len(CUBE)) % 2 + 1]},
        )
        mesh.write(folder / f"{name}.xdmf")
        tags = np.concatenate([number(facets), np.array(more, dtype=int).reshape(-1, 3)])
        values = np.concatenate([marks, np.full(len(more), 3)])
        add_facets(folder / f"{name}.xdmf", tags, values)

    made(lambda: write("plain", POINTS, lambda i: i, []))
    made(lambda: write("more", x, lambda i: rows[i], [[0, 1, 2]]))
    plain, more = (read_body(folder / f"{name}.xdmf") for name in ("plain", "more"))
    assert "3 of 11 points belong to no element (dropped)" in more.information
    assert not any("belong to no element" in said for said in plain.information)
    assert more.incomplete == {"facets_3": "1 of its 1 members belong to no element"}
    assert mesh_statistics(more).volume == pytest.approx(1.0)
    found = [contents(body) for body in (plain, more)]
    assert found[0] == found[1]
    assert set(more.surfaces) == {"facets_1", "facets_2"}
    assert set(more.regions) == {"region_1", "region_2"}


def add_facets(path: Path, facets: np.ndarray, values: np.ndarray) -> None:
    """Tags of facets, as DOLFINx puts them beside a mesh."""
    with h5py.File(path.with_suffix(".h5"), "a") as file:
        file["facets"], file["marks"] = facets, values
    count, name = len(facets), path.with_suffix(".h5").name
    grid = (
        f'<Grid Name="facets" GridType="Uniform"><Topology TopologyType="Triangle">'
        f'<DataItem Dimensions="{count} 3" NumberType="Int" Format="HDF">{name}:/facets</DataItem>'
        f'</Topology><Attribute Name="facets" Center="Cell">'
        f'<DataItem Dimensions="{count}" NumberType="Int" Format="HDF">{name}:/marks</DataItem>'
        "</Attribute></Grid></Domain>"
    )
    path.write_text(path.read_text().replace("</Domain>", grid))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("grid", ["Grid[@Name='two']", "Grid"])
def test_tags_of_a_second_mesh(folder: Path, grid: str, dim: int) -> None:
    """They were those of the first, as far as it has such; names of grids tell them apart."""
    one, two = (create_unit_cube(COMM, *cells) for cells in ((2, 2, 2), (3, 2, 1)))
    one.name, two.name = "one", "two"
    two.topology.create_connectivity(dim, 3)
    found = locate_entities(two, dim, lambda x: x[0] > 1 - 1e-9 if dim == 2 else x[0] > -1.0)
    tags = meshtags(two, dim, found, np.full(len(found), 7, dtype=np.int32))
    tags.name = "marks"
    with XDMFFile(COMM, folder / "two.xdmf", "w") as file:
        file.write_mesh(one)
        file.write_mesh(two)
        file.write_meshtags(tags, two.geometry, f"/Xdmf/Domain/{grid}/Geometry")
    if "two" in grid:
        said = "two.xdmf: the tags 'marks' are those of another mesh than 'one', which is read; a"
        with pytest.raises(MeshError, match=said):
            read_body(folder / "two.xdmf")
        return
    body = read_body(folder / "two.xdmf")
    assert not any(body.parts.values())
    left = {2: "of its 4 facets are no facets of an element", 3: "of its 36 cells are no cells of"}
    assert left[dim] in body.incomplete["marks_7"]


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_tags_with_points_of_their_own(folder: Path, factor: float) -> None:
    """Those of the mesh, as older programs write them, one twice and in two parts; or others."""

    def write() -> None:
        write_cube(folder / "a.xdmf")
        facets = CUBE[[0, 0, 1, 1]][:, [0, 1, 2]]
        add_facets(folder / "a.xdmf", facets, np.array([1, 1, 1, 2]))
        with h5py.File(folder / "a.h5", "a") as file:
            file["points"] = factor * POINTS
        own = '<Geometry><DataItem Dimensions="8 3" Format="HDF">a.h5:/points</DataItem></Geometry>'
        text = (folder / "a.xdmf").read_text()
        (folder / "a.xdmf").write_text(text.replace("</Topology><At", f"</Topology>{own}<At"))

    made(write)
    if factor == 1.0:
        body = read_body(folder / "a.xdmf")
        assert COMM.allreduce(len(body.owned_facets("facets_1"))) == 2
        assert COMM.allreduce(len(body.owned_facets("facets_2"))) == 1
        return
    with pytest.raises(MeshError, match="the tags 'facets' are those of another mesh than"):
        read_body(folder / "a.xdmf")


def contents(body: Body) -> list[Any]:
    """Places of all parts and values of a field, in an order of their own; of all ranks."""
    mesh = body.mesh
    prepare_facets(mesh)
    x, dofs = mesh.geometry.x, mesh.geometry.dofmap
    found: list[Any] = []
    for parts, dim in ((body.regions, 3), (body.surfaces, 2)):
        for name, rows in sorted(parts.items()):
            own = rows[rows < mesh.topology.index_map(dim).size_local]
            at = cell_corners(mesh, own) if dim == 3 else facet_corners(mesh, own)
            found += [(name, *place) for place in at.mean(axis=1).round(9).tolist()]
    heat = body.fields["heat"].values[:, 0]
    found += [("heat", *x[i].round(9).tolist(), heat[i]) for i in np.unique(dofs)]
    return sorted(set().union(*COMM.allgather(set(found))))
