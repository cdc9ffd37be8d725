"""Edges and points as parts of a body: read, selected and counted, on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx.io import XDMFFile
from dolfinx.mesh import meshtags
from helpers.bodies import drawing
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.core.units import METRE, LengthUnit
from dolfin_elastic.mesh import (
    Body,
    Cylinder,
    EdgeSelector,
    PointSelector,
    box_body,
    name_parts,
    read_body,
    rectangle_body,
)
from dolfin_elastic.mesh.distribute import build_body
from dolfin_elastic.mesh.formats.raw import Block, MeshFile, RawMesh, assemble
from dolfin_elastic.mesh.geometry.simplices import edge_nodes, prepare_facets
from dolfin_elastic.problem.terms.edges_points import extent

COMM = MPI.COMM_WORLD


def length(body: Body, name: str) -> float:
    """Length of an edge on all ranks, of straight mesh edges [m]."""
    ends = body.mesh.geometry.x[edge_nodes(body.mesh, body.owned_edges(name))]
    return float(total(COMM, float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())))


def places(body: Body, name: str) -> list[tuple[float, ...]]:
    """All nodes of a point, the same on every rank; each counts once."""
    own = body.mesh.geometry.x[body.owned_points(name), : body.dim].round(9) + 0.0
    rows = COMM.allgather([tuple(map(float, row)) for row in own])
    return sorted(place for some in rows for place in some)


def corner_tetrahedra() -> tuple[FloatArray, IntArray]:
    """A cube of six tetrahedra about its diagonal 0 to 6 (after Kuhn)."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        dtype=float,
    )
    rows = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
    return points, np.array(rows)


def cube(blocks: list[Block], **more: Any) -> Body:
    """The cube with further blocks."""
    points, cells = corner_tetrahedra()

    def read() -> RawMesh:
        return assemble(MeshFile(points, [Block("tetra", cells), *blocks], **more), source="cube")

    return build_body(read, comm=COMM, unit=LengthUnit.of(2.0), source="cube")


@pytest.mark.parametrize("dim", [2, 3])
def test_what_ranks_share_counts_once(dim: int) -> None:
    """Every node and facet, named on all ranks that have it, is owned by one of them.

    Facets are half of those of all cells and of the boundary: (3 32 + 16)/2 and (4 162 + 108)/2.
    """
    body = (
        box_body(size=(1, 1, 1), cells=(3, 3, 3))
        if dim == 3
        else rectangle_body(size=(1, 1), cells=(4, 4))
    )
    nodes = np.arange(len(body.mesh.geometry.x), dtype=np.int32)
    body = body.named(points={"all": nodes})
    assert len(places(body, "all")) == len(set(places(body, "all"))) == {2: 25, 3: 64}[dim]
    prepare_facets(body.mesh)
    facets = body.mesh.topology.index_map(dim - 1)
    every = np.arange(facets.size_local + facets.num_ghosts, dtype=np.int32)
    assert body.named(surfaces={"all": every}).count("all") == {2: 56, 3: 378}[dim]


# --- read ---


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("version", "binary"), [(4.1, False), (2.2, True)])
def test_physical_curves_and_points_of_gmsh(
    folder: Path, version: float, binary: bool, order: int
) -> None:
    def draw() -> None:
        with drawing() as gmsh:
            gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
            gmsh.model.occ.synchronize()
            curve = gmsh.model.getEntitiesInBoundingBox(-0.1, -0.1, 0.9, 2.1, 0.1, 1.1, 1)
            corner = gmsh.model.getEntitiesInBoundingBox(1.9, 0.9, 0.9, 2.1, 1.1, 1.1, 0)
            gmsh.model.addPhysicalGroup(3, [1], name="block")
            gmsh.model.addPhysicalGroup(1, [tag for _, tag in curve], name="seam")
            gmsh.model.addPhysicalGroup(0, [tag for _, tag in corner], name="corner")
            gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(order)
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(folder / "block.msh"))

    on_root(COMM, draw)
    body = read_body(folder / "block.msh", comm=COMM)
    assert body.notes == ()
    assert length(body, "seam") == pytest.approx(2.0, abs=1e-9)
    assert places(body, "corner") == [(2.0, 1.0, 1.0)]


GEO = """SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0, 0, 1, 2};
Physical Volume("disk") = {1};
Physical Curve("rim") = Curve In BoundingBox{-2.1, -2.1, 0.9, 2.1, 2.1, 1.1};
Physical Point("start") = Point In BoundingBox{1.9, -0.1, 0.9, 2.1, 0.1, 1.1};
Mesh.MeshSizeMax = 0.8;
"""


def test_curves_and_vertices_of_cad_follow_curved_cells(folder: Path) -> None:
    """The length of a circle to O(h^4) of curved cells, h^2/(24 R^2) = 7e-3 of straight ones.

    By the name of the file and by geometry it is the same edge.
    """
    on_root(COMM, lambda: (folder / "disk.geo").write_text(GEO))
    for curved, near in ((True, 1e-4), (False, 1e-2)):
        body = read_body(folder / "disk.geo", comm=COMM, curved=curved)
        around = Cylinder(axis="z", point=(0, 0, 0), radius=2)
        found = EdgeSelector(cylinder=around, plane="z", at="max")
        body = name_parts(body, edges={"found": found})
        for name in ("rim", "found"):
            assert extent(body, "edge", [name]) == pytest.approx(4 * np.pi, rel=near)
        assert np.array_equal(body.edges["rim"], body.edges["found"])
        assert places(body, "start") == [(2.0, 0.0, 1.0)]


def test_points_of_a_plane_mesh_are_read_and_its_curves_stay_surfaces() -> None:
    points = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    blocks = [
        Block("triangle", np.array([[0, 1, 2], [1, 3, 2]])),
        Block("line", np.array([[0, 1]]), {"below": np.array([0])}),
        Block("vertex", np.array([[3]]), {"tip": np.array([0])}),
    ]

    def read() -> RawMesh:
        return assemble(MeshFile(points, blocks), source="square")

    body = build_body(read, comm=COMM, unit=METRE, source="square")
    assert body.kinds("below") == ("surface",)
    assert not body.edges
    assert places(body, "tip") == [(1.0, 1.0)]


def test_a_set_of_nodes_keeps_the_single_node_that_no_facet_holds() -> None:
    body = cube([], point_sets={"foot": np.arange(5), "floor": np.arange(4)})
    assert body.kinds("foot") == ("surface", "point")
    assert body.uncovered == {"foot": 1}
    assert len(places(body, "foot")) == 5
    assert total(COMM, len(body.owned_facets("floor"))) == 2
    with pytest.raises(MeshError, match="'foot' is no surface: no facet of it holds 1 of its node"):
        body.surface("foot")


def test_midside_nodes_of_covered_facets_are_covered() -> None:
    points, cells = corner_tetrahedra()
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    ends = np.sort(cells[:, pairs].reshape(-1, 2), axis=1)
    unique, where = np.unique(ends, axis=0, return_inverse=True)
    midsides = len(points) + where.reshape(len(cells), 6)
    nodes = np.concatenate([points, points[unique].mean(axis=1)])
    blocks = [Block("tetra10", np.concatenate([cells, midsides], axis=1))]
    floor = np.flatnonzero(nodes[:, 2] == 0.0)
    top = np.flatnonzero((nodes == [0.5, 0.5, 1.0]).all(axis=1))
    sets = {"floor": floor, "more": np.append(floor, top), "top": top}
    raw = assemble(MeshFile(nodes, blocks, point_sets=sets), source="cube")
    assert raw.uncovered == {"more": 1}
    assert set(raw.surfaces) == {"floor", "more"}
    assert set(raw.nodes) == {"floor", "more", "top"}


def test_an_edge_that_is_not_whole_is_refused_where_it_is_used() -> None:
    lines = Block("line", np.array([[0, 1], [1, 7]]), {"seam": np.array([0, 1])})
    body = cube([lines])
    reason = "1 of its 2 edges are no edges of an element"
    assert body.notes == (f"incomplete named parts (left out): 'seam' ({reason})",)
    with pytest.raises(MeshError, match=f"'seam' of cube is incomplete: {reason}"):
        body.owned_edges("seam")


def test_unknown_names_and_names_of_another_kind() -> None:
    lines = Block("line", np.array([[0, 1]]), {"seam": np.array([0])})
    point = Block("vertex", np.array([[6]]), {"corner": np.array([0])})
    body = cube([lines, point])
    with pytest.raises(MeshError, match="'seam' is an edge, not a surface"):
        body.surface("seam")
    with pytest.raises(MeshError, match="'corner' is a point, not an edge"):
        body.edge("corner")
    with pytest.raises(MeshError, match=r"no surface 'corer' in cube.*did you mean 'corner'"):
        body.surface("corer")


# --- selected ---


def selected(body: Body, **keys: Any) -> Body:
    """The body, 20 x 10 x 10 mm, with the edge 'e' that these keys select."""
    return name_parts(body, edges={"e": EdgeSelector(**keys)}, scale=1e-3)


@pytest.mark.parametrize(
    ("keys", "millimetres"),
    [
        ({"between": ["left", "bottom"]}, 10),
        ({"plane": "z", "at": "min"}, 60),
        ({"plane": "z", "at": 5, "of": "right"}, 10),
        ({"all": True}, 160),
        ({"of": "top"}, 60),
        ({"line": {"start": [0, 0, 0], "end": ["20 mm", 0, 0]}}, 20),
        ({"plane": "x", "at": "max", "box": [[20, 0, 0], [20, 0, 10]]}, 10),
        ({"plane": "z", "at": "min", "of": "front"}, 20),
    ],
)
def test_edges_of_a_box(keys: dict[str, Any], millimetres: float) -> None:
    box = box_body(size=[20, 10, 10], cells=[4, 2, 2], scale=1e-3)
    assert length(selected(box, **keys), "e") == pytest.approx(1e-3 * millimetres, rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ({"nearest": [20, 10, 9]}, [(0.02, 0.01, 0.01)]),
        ({"nearest": [0, 0, 2.5]}, [(0.0, 0.0, 0.0)]),  # of two at the same distance the first
        ({"between": ["left", "front", "top"]}, [(0.0, 0.0, 0.01)]),
        ({"plane": "y", "at": 5, "of": "rim"}, [(0.0, 0.005, 0.0)]),
        ({"box": [[0, 0, 0], ["1 mm", 1, 1]]}, [(0.0, 0.0, 0.0)]),
        ({"nearest": [1, 1, 0], "of": "right"}, "is 19"),
    ],
)
def test_points_of_a_box(keys: dict[str, Any], found: Any) -> None:
    box = box_body(size=[20, 10, 10], cells=[4, 2, 2], scale=1e-3)
    edges = {"rim": EdgeSelector(between=["left", "bottom"])}
    points = {"p": PointSelector(**keys)}
    if isinstance(found, str):
        with pytest.raises(MeshError, match=rf"points\.p\.nearest: the nearest vertex .*{found}"):
            name_parts(box, edges=edges, points=points, scale=1e-3)
        return
    assert places(name_parts(box, edges=edges, points=points, scale=1e-3), "p") == found


def test_selectors_of_edges_and_points_that_fail() -> None:
    box = box_body(size=[20, 10, 10], cells=[4, 2, 2], scale=1e-3)
    with pytest.raises(MeshError, match=r"edges\.e: found 0 of .* edges .*would find it"):
        selected(box, plane="z", at="9.9 mm")
    with pytest.raises(MeshError, match=r"edges\.e: found 0 of 0 edges that belong to 'left' and"):
        selected(box, between=["left", "right"])
    with pytest.raises(MeshError, match="no surface 'lft' in box.*did you mean 'left'"):
        selected(box, between=["lft", "bottom"])
    with pytest.raises(MeshError, match=r"points\.left: the mesh has a surface 'left' already"):
        name_parts(box, points={"left": PointSelector(nearest=(0, 0, 0))})
    with pytest.raises(InputError, match="say where: between, line"):
        EdgeSelector()
    with pytest.raises(InputError, match="say where: nearest"):
        PointSelector()


def test_edges_of_a_plane_body_are_its_surfaces() -> None:
    square = rectangle_body(size=[1, 1], cells=[2, 2])
    with pytest.raises(MeshError, match=r"edges\.e: the edges of a plane body are its surfaces"):
        name_parts(square, edges={"e": EdgeSelector(plane="x", at="min")})
    named = name_parts(square, points={"p": PointSelector(between=["left", "top"])})
    assert places(named, "p") == [(0.0, 1.0)]


def test_xdmf_tags_of_edges_and_vertices(folder: Path) -> None:
    """As DOLFINx writes them: each value of the tags becomes a name."""
    box = box_body(size=[20, 10, 10], cells=[4, 2, 2], scale=1e-3)
    box = name_parts(
        box,
        edges={"e": EdgeSelector(between=["left", "bottom"])},
        points={"p": PointSelector(nearest=(20, 10, 10))},
        scale=1e-3,
    )
    mesh = box.mesh
    mesh.topology.create_connectivity(3, 0)
    corners = mesh.topology.connectivity(3, 0).array.reshape(-1, 4)
    inside = np.isin(mesh.geometry.dofmap[:, :4], box.points["p"])
    vertices = np.unique(corners[inside]).astype(np.int32)
    with XDMFFile(COMM, folder / "box.xdmf", "w") as file:
        file.write_mesh(mesh)
        for dim, name, found in ((1, "lines", box.edges["e"]), (0, "corners", vertices)):
            mesh.topology.create_connectivity(dim, 3)
            tags = meshtags(mesh, dim, found, np.full(len(found), 7, dtype=np.int32))
            tags.name = name
            file.write_meshtags(tags, mesh.geometry)
    body = read_body(folder / "box.xdmf", comm=COMM)
    assert length(body, "lines_7") == pytest.approx(0.01, rel=1e-12)
    assert places(body, "corners_7") == [(0.02, 0.01, 0.01)]
