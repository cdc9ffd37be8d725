"""Reading meshes of every format: volumes, names and faults, on any number of ranks."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from helpers.bodies import ball, drawing
from helpers.decks import box, inp_text, numbers, quadratic
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import (
    Body,
    box_body,
    mesh_statistics,
    read_body,
    rectangle_body,
)
from dolfin_elastic.mesh.formats.raw import Block

COMM = MPI.COMM_WORLD
SHARED = ROOT.parent / "shared" / "meshes"


def made(action: Callable[[], object]) -> None:
    """Makes a file on rank 0 while the others wait."""
    on_root(COMM, lambda: action() and None)


def cells_of(body: Body, name: str) -> int:
    """Number of cells of a region on all ranks."""
    return int(COMM.allreduce(len(body.owned_cells(name))))


def gmsh_cube(
    path: Path, *, version: float = 4.1, binary: bool = False, order: int = 1, overlap: bool = False
) -> None:
    """Two boxes side by side, 2 x 1 x 1, that share the face 'joint'."""
    with drawing() as gmsh:
        _gmsh_cube(gmsh, path, version, binary, order, overlap)


def _gmsh_cube(
    gmsh: Any, path: Path, version: float, binary: bool, order: int, overlap: bool
) -> None:
    occ = gmsh.model.occ
    one, two = occ.addBox(0, 0, 0, 1, 1, 1), occ.addBox(1, 0, 0, 1, 1, 1)
    occ.fragment([(3, one)], [(3, two)])
    occ.synchronize()

    def face(x: float) -> list[int]:
        near = gmsh.model.getEntitiesInBoundingBox(x - 0.01, -1, -1, x + 0.01, 2, 2, 2)
        return [tag for _, tag in near]

    gmsh.model.addPhysicalGroup(3, [one], 7, "soft part")
    gmsh.model.addPhysicalGroup(3, [two], 8, "hard")
    for tag, (name, x) in enumerate({"left": 0, "joint": 1, "right": 2}.items(), start=20):
        gmsh.model.addPhysicalGroup(2, face(x), tag, name)
    gmsh.model.addPhysicalGroup(2, face(0), 30)
    if overlap:
        gmsh.model.addPhysicalGroup(3, [one, two], 9, "all")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("version", "binary"), [(2.2, False), (2.2, True), (4.0, False), (4.1, False), (4.1, True)]
)
@pytest.mark.sample(4)
def test_gmsh_files_keep_volume_and_names(
    folder: Path, version: float, binary: bool, order: int
) -> None:
    path = folder / "two.msh"
    made(lambda: gmsh_cube(path, version=version, binary=binary, order=order))
    body = read_body(path, scale=1e-3)
    size = mesh_statistics(body)
    assert body.dim == 3 and body.mesh.geometry.cmap.degree == order
    assert size.volume == pytest.approx(2e-9, rel=1e-12)
    assert size.boundary == pytest.approx(10e-6, rel=1e-12)
    assert size.regions == pytest.approx({"soft part": 1e-9, "hard": 1e-9})
    # A group without a name goes by its number; 'joint' lies inside the body.
    assert size.surfaces == pytest.approx(dict.fromkeys(["left", "joint", "right", "30"], 1e-6))
    assert cells_of(body, "soft part") + cells_of(body, "hard") == body.num_cells


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_entities_in_two_groups(folder: Path, version: float) -> None:
    path = folder / "overlap.msh"
    made(lambda: gmsh_cube(path, version=version, overlap=True))
    size = mesh_statistics(body := read_body(path))
    assert size.regions == pytest.approx({"soft part": 1, "hard": 1, "all": 2})
    assert size.volume == pytest.approx(2)
    assert cells_of(body, "all") == body.num_cells


@pytest.mark.parametrize("suffix", [".msh", ".vtu", ".vtk", ".med", ".xdmf", ".inp"])
def test_curved_cells_keep_their_shape(folder: Path, suffix: str) -> None:
    import meshio

    made(lambda: ball(folder / "ball.msh"))
    path = folder / f"ball{suffix}"
    if suffix not in (".msh", ".inp"):

        def convert() -> None:
            mesh = meshio.read(folder / "ball.msh")
            meshio.Mesh(mesh.points, {"tetra10": mesh.cells_dict["tetra10"]}).write(path)

        made(convert)
    size = mesh_statistics(read_body(path))
    # Straight elements of this size lose 3 % of the volume.
    assert size.volume == pytest.approx(np.pi / 6, rel=2e-3)
    assert size.boundary == pytest.approx(np.pi / 2 + 3 * np.pi / 4, rel=2e-3)


POINTS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
CUBE = np.array(
    [[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]]
)
BOTTOM = np.array([[0, 1, 3], [0, 2, 3]])


@pytest.mark.parametrize("suffix", [".vtu", ".mesh", ".med", ".bdf", ".vtk"])
def test_numbered_parts_of_other_formats(folder: Path, suffix: str) -> None:
    import meshio

    key = {".mesh": "medit:ref", ".bdf": "nastran:ref", ".med": "cell_tags"}.get(suffix, "part")
    mesh = meshio.Mesh(
        POINTS,
        [("tetra", CUBE), ("triangle", BOTTOM)],
        cell_data={key: [np.array([1, 1, 1, 2, 2, 2]), np.array([5, 5])]},
    )
    if suffix == ".med":
        mesh.cell_tags = {1: ["core", "body"], 2: ["body"], 5: ["foot"]}
    path = folder / f"cube{suffix}"
    made(lambda: mesh.write(path))
    size = mesh_statistics(read_body(path))
    names = {"core": 0.5, "body": 1.0}, {"foot": 1.0}
    if suffix in (".mesh", ".bdf"):
        names = {"1": 0.5, "2": 0.5}, {"5": 1.0}
    elif suffix != ".med":
        names = {"part_1": 0.5, "part_2": 0.5}, {"part_5": 1.0}
    assert size.volume == pytest.approx(1)
    assert size.regions == pytest.approx(names[0])
    assert size.surfaces == pytest.approx(names[1])


INP = """*HEADING
a unit cube
*Part, name=Part-1
*NODE, NSET=everything
{nodes}
*Element, type=C3D4H, elset=Soft
1, 1, 2, 4, 8
2, 1, 2, 6, 8
*ELEMENT, TYPE=C3D4, ELSET=hard
** a comment
13, 1, 3, 4, 8
14, 1, 3, 7, 8
*ELEMENT, TYPE=C3D4, ELSET=SOFT
15, 1, 5, 6, 8
16, 1, 5, 7, 8
*ELSET, ELSET=pair, GENERATE
13, 16, 3
*ELSET, ELSET=joined
soft, hard
*NSET, NSET=foot
1, 2, 3,
4
*SURFACE, NAME=under, TYPE=ELEMENT
1, S1
13, S1
*SURFACE, NAME=skin
Part-1.Soft,
*SURFACE, NAME=foot-again, TYPE=NODE
foot
*END PART
*Assembly, name=a
*INSTANCE, NAME=i, PART=Part-1
*END INSTANCE
*END ASSEMBLY
*STEP
*STATIC
"""


def write_inp(path: Path, text: str = INP) -> None:
    nodes = "\n".join(f"{i}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(POINTS, start=1))
    path.write_text(text.format(nodes=nodes))


def test_abaqus_sets_and_surfaces(folder: Path) -> None:
    made(lambda: write_inp(folder / "cube.inp"))
    body = read_body(folder / "cube.inp")
    size = mesh_statistics(body)
    sixth = 1 / 6
    assert size.regions == pytest.approx(
        {"Soft": 4 * sixth, "hard": 2 * sixth, "pair": 2 * sixth, "joined": 1.0}
    )
    assert size.surfaces["foot"] == size.surfaces["under"] == pytest.approx(1)
    assert size.surfaces["foot-again"] == pytest.approx(1)
    assert size.surfaces["everything"] == pytest.approx(6)
    # The free faces of four cells: three lie between them, two between them and the others.
    assert body.count("skin") == 4 * 4 - 2 * 3 - 2


def test_a_body_is_parted_the_same_way_each_time() -> None:
    """With more threads than one, two of 400 such boxes were parted otherwise on two ranks."""
    ways = set()
    for _ in range(100):
        mesh = box_body(size=(4, 1, 1), cells=(8, 2, 2)).mesh
        ways.add(mesh.geometry.x.tobytes() + mesh.topology.original_cell_index.tobytes())
    assert COMM.allreduce(len(ways), op=MPI.MAX) == 1
    assert os.environ["SCOTCH_PTHREAD_NUMBER"] == "1"


@pytest.mark.parametrize("order", [1, 2])
def test_plane_mesh(folder: Path, order: int) -> None:
    def plate() -> None:
        with drawing() as gmsh:
            gmsh.model.occ.addDisk(0, 0, 2.0, 1, 1)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(1, [1], name="rim")
            gmsh.model.addPhysicalGroup(2, [1], name="disk")
            gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
            gmsh.model.mesh.generate(2)
            gmsh.model.mesh.setOrder(order)
            gmsh.write(str(folder / "disk.msh"))

    made(plate)
    size = mesh_statistics(body := read_body(folder / "disk.msh"))
    assert body.dim == 2
    near = 1e-4 if order == 2 else 2e-2
    assert size.regions == {"disk": pytest.approx(np.pi, rel=near)}
    assert size.surfaces == {"rim": pytest.approx(2 * np.pi, rel=near)}
    assert size.boundary == pytest.approx(size.surfaces["rim"])


@pytest.mark.parametrize("suffix", [".step", ".brep", ".geo"])
def test_cad_is_meshed_with_a_size(folder: Path, suffix: str) -> None:
    def draw() -> None:
        if suffix == ".geo":
            (folder / "box.geo").write_text(
                'SetFactory("OpenCASCADE"); Box(1) = {0, 0, 0, 1, 2, 3};\n'
                'Physical Volume("body") = {1}; Physical Surface("foot") = {5};\n'
            )
            return
        with drawing() as gmsh:
            gmsh.model.occ.addBox(0, 0, 0, 1, 2, 3)
            gmsh.model.occ.synchronize()
            gmsh.write(str(folder / f"box{suffix}"))

    made(draw)
    coarse, fine = (
        mesh_statistics(read_body(folder / f"box{suffix}", size=s, scale=1e-3)) for s in (2.0, 0.6)
    )
    assert coarse.volume == pytest.approx(6e-9) and fine.volume == pytest.approx(6e-9)
    assert coarse.cells < fine.cells and fine.longest < 1.2e-3
    if suffix == ".geo":
        assert fine.regions == pytest.approx({"body": 6e-9})
        assert fine.surfaces == pytest.approx({"foot": 2e-6})


@pytest.mark.parametrize("suffix", [".step", ".geo"])
def test_cad_with_curved_cells(folder: Path, suffix: str) -> None:
    """The volume of a ball of some four cells through: straight ones leave 8 % of it out."""

    def draw() -> None:
        if suffix == ".geo":
            text = 'SetFactory("OpenCASCADE"); Sphere(1) = {0, 0, 0, 1};\n'
            (folder / "ball.geo").write_text(text)
            return
        with drawing() as gmsh:
            gmsh.model.occ.addSphere(0, 0, 0, 1)
            gmsh.model.occ.synchronize()
            gmsh.write(str(folder / f"ball{suffix}"))

    made(draw)
    straight, curved = (
        mesh_statistics(read_body(folder / f"ball{suffix}", size=0.5, curved=c))
        for c in (False, True)
    )
    exact = 4 / 3 * np.pi * (1e-9 if suffix == ".step" else 1.0)  # STEP files hold their unit, mm
    assert straight.cells == curved.cells
    assert straight.volume == pytest.approx(exact, rel=0.1)
    assert straight.volume < 0.94 * exact
    assert curved.volume == pytest.approx(exact, rel=1e-3)


def test_curved_cells_of_a_thin_wall_do_not_fold(folder: Path) -> None:
    """Cells five times as long as the wall is thick: their middles are moved out of the way."""

    def draw() -> None:
        (folder / "shell.geo").write_text(
            'SetFactory("OpenCASCADE"); Sphere(1) = {0, 0, 0, 1}; Sphere(2) = {0, 0, 0, 0.9};\n'
            "BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };\n"
        )

    made(draw)
    body = read_body(folder / "shell.geo", size=0.5, curved=True)
    assert mesh_statistics(body).volume == pytest.approx(4 / 3 * np.pi * (1 - 0.9**3), rel=0.05)


def test_xdmf_of_dolfinx_with_tags(folder: Path) -> None:
    from dolfinx.io import XDMFFile
    from dolfinx.mesh import meshtags

    box = box_body(size=(1, 1, 1), cells=(3, 3, 3))
    foot = box.owned_facets("bottom")
    tags = meshtags(box.mesh, 2, foot, np.full(len(foot), 4, dtype=np.int32))
    tags.name = "facets"
    cells = box.owned_cells()
    half = meshtags(box.mesh, 3, cells, (cells % 2).astype(np.int32))
    half.name = "cells"
    with XDMFFile(COMM, str(folder / "box.xdmf"), "w") as file:
        file.write_mesh(box.mesh)
        file.write_meshtags(tags, box.mesh.geometry)
        file.write_meshtags(half, box.mesh.geometry)
    COMM.barrier()
    body = read_body(folder / "box.xdmf", scale=2.0)
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(8)
    assert body.count("facets_4") == 18 and size.surfaces == pytest.approx({"facets_4": 4})
    assert sum(cells_of(body, f"cells_{i}") for i in (0, 1)) == body.num_cells == 162


@pytest.mark.parametrize("keep", ["HDF", "XML", "Binary"])
def test_xdmf_of_meshio(folder: Path, keep: str) -> None:
    import meshio

    mesh = meshio.Mesh(POINTS, [("tetra", CUBE)], cell_data={"part": [np.array([1] * 3 + [2] * 3)]})
    made(lambda: meshio.xdmf.write(folder / "cube.xdmf", mesh, data_format=keep))
    size = mesh_statistics(read_body(folder / "cube.xdmf"))
    assert size.regions == pytest.approx({"part_1": 0.5, "part_2": 0.5})


def test_mixed_xdmf_of_meshio_gives_both_kinds_of_parts(folder: Path) -> None:
    import meshio

    mesh = meshio.Mesh(
        POINTS,
        [("tetra", CUBE), ("triangle", BOTTOM)],
        cell_data={"part": [np.ones(6, dtype=int), np.array([5, 5])]},
    )
    made(lambda: mesh.write(folder / "cube.xdmf"))
    size = mesh_statistics(read_body(folder / "cube.xdmf"))
    assert size.regions == pytest.approx({"part_1": 1})
    assert size.surfaces == pytest.approx({"part_5": 1})


def test_box_and_rectangle() -> None:
    body = box_body(size=(1, 2, 3), cells=(2, 3, 4), origin=(-1, 0, 0), scale=1e-2)
    size = mesh_statistics(body)
    assert size.volume == pytest.approx(6e-6) and size.low == pytest.approx((-0.01, 0, 0))
    assert {name: body.count(name) for name in body.surfaces} == {
        "left": 24,
        "right": 24,
        "front": 16,
        "back": 16,
        "bottom": 12,
        "top": 12,
    }
    assert size.surfaces["left"] == pytest.approx(6e-4)
    plate = rectangle_body(size=(2, 1), cells=(4, 3))
    assert {n: plate.count(n) for n in plate.surfaces} == {
        "left": 3,
        "right": 3,
        "bottom": 4,
        "top": 4,
    }
    assert mesh_statistics(plate).volume == pytest.approx(2)


@pytest.mark.parametrize("cells", [(60, 10, 10), (180, 40)])
def test_boxes_are_shared_in_layers(cells: tuple[int, ...]) -> None:
    """The longest edge can be cut in up to six parts: equal shares, with one layer between two."""
    dim = len(cells)
    topology = box_body(size=[1.0] * dim, cells=cells).mesh.topology
    ranks = MPI.COMM_WORLD.size
    own = [topology.index_map(i).size_local for i in (dim, 0)]
    count = MPI.COMM_WORLD.allgather(own)
    assert [n for n, _ in count] == [math.factorial(dim) * math.prod(cells) // ranks] * ranks
    assert sum(n for _, n in count) == math.prod(n + 1 for n in cells)
    shared = MPI.COMM_WORLD.allreduce(topology.index_map(0).num_ghosts)
    assert shared == (ranks - 1) * math.prod(n + 1 for n in cells[1:])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"size": (1, 0, 1)}, "sizes must be positive"),
        ({"cells": (1, 1)}, "3 sizes"),
        ({"cells": (1, 1, 0)}, "whole and positive"),
        ({"size": (1,)}, "three sizes"),
        ({"origin": (0,)}, "origin"),
    ],
)
def test_impossible_boxes(change: dict[str, tuple[float, ...]], said: str) -> None:
    with pytest.raises(MeshError, match=said):
        box_body(**{"size": (1, 1, 1), "cells": (1, 1, 1), **change})  # type: ignore[arg-type]


def write_cube(
    path: Path,
    points: AnyArray = POINTS,
    cells: AnyArray = CUBE,
    others: list[tuple[str, AnyArray]] | None = None,
) -> None:
    import meshio

    meshio.Mesh(points, [("tetra", cells), *(others or [])]).write(path)


def test_unused_points_duplicates_and_reversed_cells_are_noted(folder: Path) -> None:
    points = np.vstack([[9, 9, np.nan], POINTS])
    cells = np.vstack([CUBE, CUBE[:1, [1, 2, 0, 3]]]) + 1
    made(lambda: write_cube(folder / "cube.vtu", points, cells))
    body = read_body(folder / "cube.vtu", scale=0.5)
    assert mesh_statistics(body).volume == pytest.approx(1 / 8)
    assert body.notes == ("1 duplicate elements (removed) near (0.75, 0.5, 0.25) x 0.5 m",)
    information = " | ".join(body.information)
    assert "1 of 9 points belong to no element" in information
    assert "3 of 6 elements list their points the other way round (harmless" in information


def test_pieces_that_touch_are_noted_with_the_place(folder: Path) -> None:
    """Two cubes side by side with nodes of their own: they part without a word."""
    points = np.vstack([POINTS, POINTS + np.array([1, 0, 0])])
    made(lambda: write_cube(folder / "two.vtu", points, np.vstack([CUBE, CUBE + len(POINTS)])))
    pieces, same = read_body(folder / "two.vtu", scale=1e-3).notes
    assert "2 unconnected pieces of 6, 6 elements" in pieces
    assert "4 nodes of different pieces have the same coordinates, near (1, " in same
    assert ") mm: the pieces touch there and are not joined" in same
    points[8:] += [0.5, 0, 0]
    made(lambda: write_cube(folder / "two.vtu", points, np.vstack([CUBE, CUBE + len(POINTS)])))
    assert len(read_body(folder / "two.vtu").notes) == 1


FAULTS: dict[str, tuple[Callable[[], dict[str, object]], str]] = {
    "flat": (
        lambda: {
            "points": np.vstack([POINTS, [0.5, 0.5, 0]]),
            "cells": np.vstack([CUBE, [0, 1, 3, 8]]),
        },
        r"1 of 7 elements have no volume, near \(0\.625, 0\.375, 0\)",
    ),
    "nan": (lambda: {"points": np.where(POINTS == [1, 1, 1], np.nan, POINTS)}, "not numbers"),
    "range": (lambda: {"cells": np.vstack([CUBE, [0, 1, 3, 99]])}, "point 99"),
    "twice": (lambda: {"cells": np.vstack([CUBE, [0, 1, 3, 3]])}, "same point twice"),
    "overlap": (
        lambda: {
            "points": np.vstack([POINTS, [2, 0.4, 0.3]]),
            "cells": np.vstack([CUBE, [0, 1, 7, 8]]),
        },
        "three or more elements",
    ),
    "inside out": (
        lambda: {
            "points": np.where((POINTS == 1).all(axis=1)[:, None], [[0.5, 0.4, -0.3]], POINTS)
        },
        "inside out",
    ),
    "hexahedra": (
        lambda: {"others": [("hexahedron", np.array([[0, 1, 3, 2, 4, 5, 7, 6]]))]},
        "6 tetrahedra, 1 hexahedra; 4- or 10-node tetrahedra are needed",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_errors_on_all_ranks(folder: Path, fault: str) -> None:
    make, said = FAULTS[fault]
    made(lambda: write_cube(folder / "cube.vtu", **make()))  # type: ignore[arg-type]
    with pytest.raises(MeshError, match=said) as caught:
        read_body(folder / "cube.vtu")
    assert str(caught.value).startswith("cube.vtu: ")


XDMF_FAULTS = {
    "nan": "not numbers",
    "range": "point 99, but there are 8",
    "twice": "point twice",
    "duplicate": "1 duplicate elements",
    "overlap": "three or more elements",
    "flat": "no volume",
    "inside out": "inside out",
}


@pytest.mark.parametrize("fault", XDMF_FAULTS)
def test_faults_of_files_read_in_shares(folder: Path, fault: str) -> None:
    """XDMF never stands on one rank as a whole."""
    faults = {name: make for name, (make, _) in FAULTS.items()}
    faults["duplicate"] = lambda: {"cells": np.vstack([CUBE, CUBE[:1]])}
    made(lambda: write_cube(folder / "cube.xdmf", **faults[fault]()))  # type: ignore[arg-type]
    with pytest.raises(MeshError, match=XDMF_FAULTS[fault]) as caught:
        read_body(folder / "cube.xdmf")
    assert str(caught.value).startswith("cube.xdmf: ")


def test_one_cell_on_any_number_of_ranks(folder: Path) -> None:
    made(lambda: write_cube(folder / "one.vtu", cells=CUBE[:1]))
    size = mesh_statistics(body := read_body(folder / "one.vtu"))
    assert body.num_cells == 1 and size.volume == pytest.approx(1 / 6)
    assert "4 of 8 points belong to no element" in " ".join(body.information)
    assert not body.notes


def test_a_surface_in_space_is_refused(folder: Path) -> None:
    import meshio

    made(lambda: meshio.Mesh(POINTS, [("triangle", CUBE[:, :3])]).write(folder / "shell.vtu"))
    with pytest.raises(MeshError, match="shells are not supported"):
        read_body(folder / "shell.vtu")


@pytest.mark.parametrize("cells", [6, 1])
def test_pieces_are_counted(folder: Path, cells: int) -> None:
    points = np.vstack([POINTS, POINTS + 3])
    made(lambda: write_cube(folder / "two.vtu", points, np.vstack([CUBE, CUBE[:cells] + 8])))
    said = " ".join(read_body(folder / "two.vtu").notes)
    assert f"2 unconnected pieces of 6, {cells} elements" in said


def test_only_facets_named_and_names_without_elements(folder: Path) -> None:
    text = (
        '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 3 "foot"\n3 9 "none"\n'
        "$EndPhysicalNames\n$Nodes\n8\n"
        + "".join(f"{i * 10} {x} {y} {z}\n" for i, (x, y, z) in enumerate(POINTS, start=1))
        + "$EndNodes\n$Elements\n8\n"
        + "".join(
            f"{i} 2 2 3 1 {a}0 {b}0 {c}0\n" for i, (a, b, c) in enumerate(BOTTOM + 1, start=1)
        )
        + "".join(
            f"{i} 4 2 0 1 {a}0 {b}0 {c}0 {d}0\n" for i, (a, b, c, d) in enumerate(CUBE + 1, start=3)
        )
        + "$EndElements\n"
    )
    made(lambda: (folder / "cube.msh").write_text(text))
    body = read_body(folder / "cube.msh")
    assert body.count("foot") == 2 and not body.regions
    assert any("no elements carry the name none" in note for note in body.notes)
    with pytest.raises(MeshError, match="did you mean 'foot'"):
        body.surface("foto")


def test_a_surface_with_a_facet_outside_the_body_is_no_surface(folder: Path) -> None:
    import meshio

    mesh = meshio.Mesh(
        POINTS,
        [("tetra", CUBE), ("triangle", np.array([[0, 1, 3], [1, 2, 4]]))],
        cell_data={"part": [np.zeros(6, dtype=int), np.array([5, 5])]},
    )
    made(lambda: mesh.write(folder / "cube.vtu"))
    body = read_body(folder / "cube.vtu")
    reason = "1 of its 2 facets are no facets of an element"
    assert any(f"left out): 'part_5' ({reason})" in note for note in body.notes)
    with pytest.raises(MeshError, match=f"'part_5' of cube.vtu is incomplete: {reason}"):
        body.surface("part_5")
    assert list(body.regions) == ["part_0"]


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [False, True])
def test_damaged_gmsh_files_are_errors(folder: Path, version: float, binary: bool) -> None:
    """Cut at many places, and with bytes changed: read, or a MeshError, never anything else."""
    from dolfin_elastic.mesh.formats.msh import OtherVersionError, read_msh
    from dolfin_elastic.mesh.formats.raw import assemble

    def attempt() -> int:
        gmsh_cube(folder / "two.msh", version=version, binary=binary)
        whole = (folder / "two.msh").read_bytes()
        random, refused = np.random.default_rng(1), 0
        bad = folder / "bad.msh"
        for i in range(120):
            data = bytearray(whole)
            if i % 2:
                data = data[: len(whole) * i // 120]
            else:
                at = int(random.integers(len(data) - 8))
                data[at : at + 8] = random.bytes(8)
            bad.write_bytes(bytes(data))
            try:
                assemble(read_msh(bad), source="bad.msh")
            except (MeshError, OtherVersionError):
                refused += 1
        return refused

    assert on_root(COMM, attempt) >= 60


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.msh", "", "the file is empty"),
        ("a.msh", "hello", "not a Gmsh mesh"),
        ("a.msh", "MESH dimension 3 ElemType Tetrahedra Nnode 4\n", "this is a mesh of GiD, not"),
        ("a.msh", '(0 "a grid")\n(2 3)\n', "this is a mesh of Fluent, not"),
        ("a.vtu", "hello", "this is no XML file"),
        ("a.mesh", "hello", "meshio cannot read it"),
        ("a.med", "hello", "meshio cannot read it"),
        ("a.inp", "hello", r"no \*NODE"),
        ("a.xyz", "hello", "unknown suffix '.xyz'"),
        ("a.xdmf", "hello", "no XML"),
        ("a.xdmf", "<Xdmf/>", "no mesh"),
        ("a.geo", "Box(1) = {", "Gmsh cannot read"),
        ("a.geo", "Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0};", "no line break"),
        ("a.step", "hello", "Gmsh cannot read|neither volumes"),
        ("a.geo", "x = 1;", "neither volumes"),
        ("a.msh", "$MeshFormat\n1.0 0 8\n$EndMeshFormat\n", ""),
    ],
)
def test_files_that_are_no_meshes(folder: Path, name: str, text: str, said: str) -> None:
    made(lambda: (folder / name).write_text(text))
    with pytest.raises(MeshError, match=said):
        read_body(folder / name)


def test_missing_files_and_sizes_out_of_place(folder: Path) -> None:
    made(lambda: write_cube(folder / "bracket.vtu"))
    with pytest.raises(MeshError, match=r"did you mean 'bracket\.vtu'"):
        read_body(folder / "braket.vtu")
    with pytest.raises(MeshError, match="finished mesh"):
        read_body(folder / "bracket.vtu", size=1.0)
    with pytest.raises(MeshError, match="finished mesh"):
        read_body(folder / "bracket.vtu", curved=True)
    with pytest.raises(MeshError, match="folder"):
        read_body(folder)


shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the folder ../shared/meshes is absent")


@shared
def test_real_meshes() -> None:
    bunny = mesh_statistics(read_body(SHARED / "bunny.msh"))
    assert bunny.cells == 19379 and bunny.volume == pytest.approx(6.01039822, rel=1e-8)
    body = read_body(SHARED / "two_regions_named_v41.msh")
    assert {n: body.count(n) for n in body.surfaces} == {"side_a": 1, "side_b": 1, "interface": 1}
    assert {n: cells_of(body, n) for n in body.regions} == {"upper": 1, "lower": 1}


@shared
def test_inside_out_cells_are_told_from_reversed_ones() -> None:
    body = read_body(SHARED / "microstructure.msh")
    notes, information = body.notes, body.information
    said = [note for note in notes if "8 of 6414 elements are inside out" in note]
    assert len(said) == 1 and "(0.5537, 0.7854, 0.5163)" in said[0]
    assert not any("other way round" in text for text in (*notes, *information))


def folded(path: Path) -> None:
    """A cube of quadratic cells, one midside node of which lies near the opposite edge."""
    points, cells = quadratic(*box((1, 1, 1), (1, 1, 1)))
    low = points[:, 2] == 0
    sets = {"foot": np.flatnonzero(low), "edge": np.flatnonzero(low & (points[:, 1] == 0))}
    points[(points == [0.5, 0, 0]).all(axis=1)] += [0, 0.9, 0.9]
    text = "".join(f"*NSET, NSET={name}\n{numbers(rows)}\n" for name, rows in sets.items())
    path.write_text(inp_text(points, cells, text))


def test_folded_cells_are_read_as_straight_ones(folder: Path) -> None:
    """They were refused without a way out."""
    made(lambda: folded(folder / "cube.inp"))
    with pytest.raises(MeshError, match=r"fold over themselves, .*: mesh\.curved = false"):
        read_body(folder / "cube.inp")
    body = read_body(folder / "cube.inp", curved=False)
    size = mesh_statistics(body)
    assert body.mesh.geometry.cmap.degree == 1
    assert size.volume == pytest.approx(1) and size.surfaces == pytest.approx({"foot": 1})
    assert body.kinds("foot") == ("surface", "point")
    assert any("straight ones, without 19 midside nodes" in told for told in body.information)
    with pytest.raises(MeshError, match=r"1 of its 3 nodes are midside nodes"):
        body.point("edge")


def test_straight_cells_of_a_case(folder: Path) -> None:
    """A linear displacement does not ask for them: only the key does."""
    made(lambda: folded(folder / "cube.inp"))
    tables = {"materials": {"a": {"law": "linear-elastic", "E": 1e9, "nu": 0.3}}}
    mesh = {"file": "cube.inp", "degree": 1}
    with pytest.raises(
        MeshError, match="mesh.file: cube.inp: 1 of 6|2 of 6 quadratic elements fold"
    ):
        Case.from_dict({"mesh": mesh, **tables}, folder).read_body()
    body = Case.from_dict({"mesh": {**mesh, "curved": False}, **tables}, folder).read_body()
    assert mesh_statistics(body).volume == pytest.approx(1)


def test_straight_cells_of_xdmf(folder: Path) -> None:
    """They were refused; those of files that only DOLFINx reads still are."""
    import meshio
    from dolfinx.io import XDMFFile

    points, cells = quadratic(*box((1, 1, 1), (1, 1, 1)))
    made(lambda: meshio.Mesh(points, [("tetra10", cells)]).write(folder / "whole.vtu"))
    points[(points == [0.5, 0, 0]).all(axis=1)] += [0, 0.9, 0.9]
    part = np.array([1, 1, 1, 2, 2, 2])
    mesh = meshio.Mesh(points, [("tetra10", cells)], cell_data={"part": [part]})
    made(lambda: write_cube(folder / "cube.xdmf"))
    made(lambda: mesh.write(folder / "quadratic.xdmf"))
    assert read_body(folder / "cube.xdmf", curved=False).num_cells == 6
    with pytest.raises(MeshError, match="fold over themselves"):
        read_body(folder / "quadratic.xdmf")
    body = read_body(folder / "quadratic.xdmf", curved=False)
    size = mesh_statistics(body)
    assert body.mesh.geometry.cmap.degree == 1
    assert size.volume == pytest.approx(1)
    assert size.regions == pytest.approx({"part_1": 0.5, "part_2": 0.5})
    bent = read_body(folder / "whole.vtu").mesh
    with XDMFFile(COMM, str(folder / "series.xdmf"), "w") as file:
        file.write_mesh(bent)
        bent.name = "again"
        file.write_mesh(bent)
    assert read_body(folder / "series.xdmf").mesh.geometry.cmap.degree == 2
    with pytest.raises(MeshError, match=r"series.xdmf: its quadratic .*; save the mesh as \.vtu"):
        read_body(folder / "series.xdmf", curved=False)


@pytest.mark.parametrize("suffix", [".pvtu", ".pvd", ".vtm"])
def test_files_of_pieces_are_told_apart(folder: Path, suffix: str) -> None:
    """They were of an "unknown suffix"."""
    made(lambda: (folder / f"body{suffix}").write_text("<VTKFile/>"))
    with pytest.raises(MeshError, match=r"only names the files of its pieces; .* one \.vtu file"):
        read_body(folder / f"body{suffix}")


@pytest.mark.parametrize("shift", [(1, 1, 0), (1, 1, 1)])
def test_pieces_that_share_an_edge_or_a_node_only(
    folder: Path, shift: tuple[int, int, int]
) -> None:
    """A run ended without a word of the hinge; it counts as one body, for its nodes are shared."""
    points, cells = box((1, 1, 1), (1, 1, 1))
    both = np.concatenate([points, points + shift])
    unique, rows = np.unique(both, axis=0, return_inverse=True)
    every = np.concatenate([cells, cells + len(points)])
    made(lambda: (folder / "two.inp").write_text(inp_text(unique, rows.ravel()[every])))
    (note,) = read_body(folder / "two.inp").notes
    count = 2 if shift[2] == 0 else 1
    assert f"pieces of the mesh share {count} nodes but no facet, near (1, 1, 1) m" in note or (
        f"share {count} nodes but no facet, near (1, 1, 0), (1, 1, 1) m" in note
    )


def test_errors_of_a_check_come_with_the_notes_of_the_mesh(folder: Path) -> None:
    """That pieces touch and are not joined is why one of them is free."""
    points, cells = box((1, 1, 1), (1, 1, 1))
    both = np.concatenate([points, points + np.array([1, 0, 0])])
    every = np.concatenate([cells, cells + len(points)])
    made(lambda: (folder / "two.inp").write_text(inp_text(both, every)))
    tables = {
        "mesh": {"file": "two.inp"},
        "materials": {"a": {"law": "linear-elastic", "E": 1e9, "nu": 0.3, "density": 1}},
        "surfaces": {"wall": {"plane": "x", "at": "min"}},
        "support": [{"on": "wall"}],
        "load": [{"kind": "gravity"}],
    }
    with pytest.raises(InputError, match="bodies that share no nodes") as caught:
        report(Case.from_dict(tables, folder))
    assert any("the pieces touch there and are not joined" in n for n in caught.value.__notes__)


@pytest.mark.parametrize(
    ("kind", "dim"),
    [
        *(("vertex", 0), ("line", 1), ("line3", 1)),
        *(("triangle6", 2), ("quad8", 2), ("polygon", 2)),
        *(("tetra10", 3), ("wedge15", 3), ("hexahedron20", 3), ("pyramid", 3), ("vtk80", 3)),
    ],
)
def test_dimension_of_elements(kind: str, dim: int) -> None:
    """Unknown ones count as solid: they are refused, and not taken for a part of the surface."""
    assert Block(kind, np.empty((0, 1), dtype=np.int64)).dim == dim


@pytest.mark.parametrize(("kind", "count", "order"), [(29, 20, 3), (30, 35, 4), (21, 10, 3)])
def test_elements_of_high_order_are_refused_by_their_order(
    folder: Path, kind: int, count: int, order: int
) -> None:
    points = "".join(f"{i} {i} {i * i} {i % 3}\n" for i in range(1, count + 1))
    text = f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{count}\n{points}$EndNodes\n"
    row = " ".join(map(str, range(1, count + 1)))
    text += f"$Elements\n1\n1 {kind} 2 1 1 {row}\n$EndElements\n"
    on_root(MPI.COMM_WORLD, lambda: (folder / "a.msh").write_text(text) and None)
    with pytest.raises(
        MeshError, match=rf"of order {order}: found 1 {count}-node t.*Mesh\.ElementOrder = 2"
    ):
        read_body(folder / "a.msh")
