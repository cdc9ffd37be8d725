"""Meshes converted to XDMF: the same names, fields, unit and answers, read in shares."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.bodies import drawing
from helpers.decks import COMM, box, made, quadratic

from dolfin_elastic.case.case import Case
from dolfin_elastic.core.errors import MeshError, OutputError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.types import AnyArray
from dolfin_elastic.mesh import Body, mesh_statistics, read_body
from dolfin_elastic.mesh.formats.convert import convert_mesh
from dolfin_elastic.mesh.formats.raw import Block, MeshFile


def two_boxes(path: Path, order: int) -> None:
    """Two boxes side by side; regions overlap, one name is a surface and an edge."""
    with drawing() as gmsh:
        occ, model = gmsh.model.occ, gmsh.model
        one, two = occ.addBox(0, 0, 0, 1, 1, 1), occ.addBox(1, 0, 0, 1, 1, 1)
        occ.fragment([(3, one)], [(3, two)])
        occ.synchronize()

        def at(dim: int, *high: float) -> list[int]:
            near = model.getEntitiesInBoundingBox(-0.01, -0.01, -0.01, *high, dim)
            return [tag for _, tag in near]

        for number, (name, bodies) in enumerate(
            {"soft part": [one], "hard": [two], "all": [one, two]}.items(), start=1
        ):
            model.addPhysicalGroup(3, bodies, number, name)
        model.addPhysicalGroup(2, at(2, 0.01, 1.01, 1.01), 4, "left")
        model.addPhysicalGroup(2, at(2, 2.01, 1.01, 0.01), 5, '<bottom> & "rim"')
        model.addPhysicalGroup(1, at(1, 0.01, 1.01, 0.01), 6, "left")
        model.addPhysicalGroup(0, at(0, 0.01, 0.01, 0.01), 7, "tip")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        model.mesh.generate(3)
        model.mesh.setOrder(order)
        gmsh.write(str(path))


def contents(body: Body) -> dict[str, object]:
    """All that two ways of reading one mesh must agree on. Collective."""
    kept = [name for name in body.surfaces if name not in body.uncovered]  # in one order
    size = mesh_statistics(replace(body, surfaces={n: body.surfaces[n] for n in kept}))
    owned = {"edge": body.owned_edges, "point": body.owned_points}
    counts = {
        (kind, name): int(total(COMM, len(owned[kind](name))))
        for kind in owned
        for name in body.parts[kind]
    }
    return {
        "numbers": [size.cells, size.points, size.volume, size.boundary],
        "regions": dict(size.regions),
        "surfaces": dict(size.surfaces),
        "counts": counts,
        "facets": {name: body.count(name) for name in body.surfaces},
        "uncovered": dict(body.uncovered),
        "incomplete": dict(body.incomplete),
        "fields": {name: field.describe(COMM) for name, field in body.fields.items()},
        "unit": [body.unit.name, body.unit.stated],
    }


def same(one: Body, other: Body) -> None:
    first, second = contents(one), contents(other)
    for key in ("numbers", "regions", "surfaces"):  # sums in another order
        assert second.pop(key) == pytest.approx(first.pop(key), rel=1e-12)
    assert second == first


@pytest.mark.parametrize("order", [1, 2])
def test_names_and_answer_stay(folder: Path, order: int) -> None:
    """One rank has read the first mesh, all ranks share in reading the second one."""
    made(lambda: two_boxes(folder / "two.msh", order))
    found = convert_mesh(folder / "two.msh", folder / "two.xdmf")
    assert found.parts["edge"] == ["left"] and found.parts["point"] == ["tip"]
    bodies = [read_body(folder / name) for name in ("two.msh", "two.xdmf")]
    same(*bodies)
    assert list(bodies[1].surfaces) == list(bodies[0].surfaces)
    hints = [[text for text in body.information if "convert" in text] for body in bodies]
    assert [len(texts) for texts in hints] == [int(COMM.size > 1), 0]
    case = Case(
        mesh={"file": str(folder / "two.xdmf"), "degree": 1},
        materials={"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
        support=[{"on": "left", "displacement": [0, 0, 0]}],
        load=[{"kind": "traction", "on": '<bottom> & "rim"', "value": [0, 0, "1 MPa"]}],
    )
    energies = []
    for body in bodies:
        (*_, last) = case.make_solver(case.make_problem(body)).steps()
        energies.append(last.energies["strain"])
    assert energies[1] == pytest.approx(energies[0], rel=1e-8)


def marked(points: AnyArray, cells: AnyArray) -> MeshFile:
    """Quadratic cells with fields and sets of nodes, of which some are not whole."""
    bottom = np.flatnonzero(points[:, 2] == 0)
    corner = np.flatnonzero((points == 0).all(axis=1))
    top = int(np.flatnonzero((points == 1).all(axis=1))[0])
    extra = np.vstack([points, [[9.0, 9.0, 9.0]]])
    kind = "tetra10" if cells.shape[1] == 10 else "tetra"
    column = np.arange(len(cells), dtype=float)[:, None]
    return MeshFile(
        extra,
        [Block(kind, cells, {"core": np.arange(3)}, {"E": column})],
        point_sets={
            "bottom": bottom,
            "loose": np.append(bottom, top),
            "corner": corner,
            "lost": np.append(corner, len(points)),
        },
        point_data={"T": extra[:, :1], "fibre": extra},
    )


def test_sets_of_nodes_fields_and_faults_stay(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Midside nodes in sets; a set that facets do not cover, one that has lost a node."""
    from dolfin_elastic.mesh import read

    points, cells = quadratic(*box((1, 1, 1), (1, 1, 1)))
    file = marked(points, cells)
    made(lambda: (folder / "cube.vtu").write_text("<VTKFile/>"))
    monkeypatch.setattr(read, "_other_reader", lambda suffix: lambda path: file)
    found = convert_mesh(folder / "cube.vtu", folder / "cube.xdmf")
    assert any("1 of 28 points belong to no element (dropped)" in note for note in found.notes)
    one, other = (read_body(folder / name) for name in ("cube.vtu", "cube.xdmf"))
    same(one, other)
    assert dict(other.uncovered) == {"loose": 1} and list(other.incomplete) == ["lost"]
    assert total(COMM, len(other.owned_points("bottom"))) == 9
    assert not any("belong to no element" in note for note in other.information)
    # A field is where it was: its values are coordinates.
    for body in (one, other):
        fibre = body.fields["fibre"].values
        assert np.allclose(fibre, body.mesh.geometry.x, atol=1e-15)


def test_a_set_without_members_is_left_out(folder: Path) -> None:
    """As it is when the old file is read."""
    nodes = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n"
    deck = f"{nodes}*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n*NSET, NSET=none\n*NSET, NSET=tip\n1\n"
    made(lambda: (folder / "a.inp").write_text(deck))
    convert_mesh(folder / "a.inp", folder / "a.xdmf")
    same(*(read_body(folder / name) for name in ("a.inp", "a.xdmf")))


def test_the_unit_stays(folder: Path) -> None:
    from test_unv import cube, dataset

    numbers = f"{1e3:25.16E}{1:25.16E}{1:25.16E}".replace("E", "D")
    text = dataset(164, ["         5mm (newton)                  2", numbers, "0.D+0"]) + cube()
    made(lambda: (folder / "cube.unv").write_text(text))
    assert convert_mesh(folder / "cube.unv", folder / "cube.xdmf").unit == "mm"
    body = read_body(folder / "cube.xdmf")
    assert mesh_statistics(body).volume == pytest.approx(1e-9)
    same(read_body(folder / "cube.unv"), body)
    text = on_root(COMM, (folder / "cube.xdmf").read_text)  # before it is overwritten
    for value in ("mm", "0.0", "nan", "-0.001"):
        made(partial((folder / "cube.xdmf").write_text, text.replace('"0.001"', f'"{value}"')))
        with pytest.raises(MeshError, match=f"cube.xdmf: the unit of length has '{value}' metres"):
            read_body(folder / "cube.xdmf")


def test_what_is_refused(folder: Path) -> None:
    made(lambda: two_boxes(folder / "two.msh", 1))
    two, new = folder / "two.msh", folder / "two.xdmf"
    convert_mesh(two, new)
    for source, target, said in (
        (two, new, "two.xdmf: this file exists already; .*--force"),
        (two, folder / "two.vtu", "'.*two.vtu' is no .xdmf file; for example 'two.xdmf'"),
        (new, folder / "new.xdmf", "two.xdmf: all ranks already read this file in parallel"),
        (folder / "tow.msh", new, "no mesh file .*tow.msh'; did you mean 'two.msh'"),
        (two, folder / "nowhere" / "two.xdmf", "there is no folder '.*nowhere'"),
    ):
        with pytest.raises(MeshError, match=said):
            convert_mesh(source, target)
    made(lambda: (folder / "part.step").write_text("ISO-10303-21;"))
    with pytest.raises(MeshError, match=r"no mesh yet; mesh it first, .*gmsh -3 part.step"):
        convert_mesh(folder / "part.step", new)
    convert_mesh(two, new, force=True)
    made(lambda: (folder / "two.h5").unlink() or (folder / "two.h5").mkdir())
    with pytest.raises(OutputError, match=r"cannot write .*two.xdmf: is a directory"):
        convert_mesh(two, new, force=True)
    assert not [one for one in folder.iterdir() if one.name.endswith(".part")]


MANY = '<Information Name="uncovered" Value="rim">many</Information>'
DAMAGES = (
    ('Value="point"', 'Value="place"', "'tip' is a part of kind 'place'; region, surface, "),
    ('Dimensions="1 1"', 'Dimensions="x"', "an array has the Dimensions 'x'"),
    ('Dimensions="1 1"', 'Dimensions="2 1"', r"point_0' has the shape \(1, 1\), .*\(2, 1\)"),
    ("/point_0<", "/points<", r"'two.h5:/points' has the shape .*\(1, 1\)"),
    ("/point_0<", "/half<", "the cells in 'two.h5:/half' are no whole numbers"),
    ("/point_0<", "/point_7<", "its data file 'two.h5' cannot be read: it has no array '/point_7'"),
    ("/point_0<", "/far<", "the cells of 'tip' have points that do not exist; .* numbered from 0"),
    ("/region_0<", "/folder<", "its data file 'two.h5' cannot be read: "),
    ("/region_0<", "/far<", r"the array 'two.h5:/far' has the shape \(1, 1\), the text says"),
    ("<Topology", MANY + "<Topology", "facets do not cover 'many' nodes of 'rim'; a whole number"),
)
"""What is changed in the file, and what is said of it."""


def test_damaged_files_say_where(folder: Path) -> None:
    made(lambda: two_boxes(folder / "two.msh", 1))
    convert_mesh(folder / "two.msh", folder / "two.xdmf")
    text = on_root(COMM, (folder / "two.xdmf").read_text)  # before it is overwritten

    def add_far_points() -> None:
        with h5py.File(folder / "two.h5", "a") as file:
            file["far"], file["half"] = np.array([[999]]), np.array([[0.5]])
            file.create_group("folder")

    made(add_far_points)
    for old, new, said in DAMAGES:
        assert old in text
        made(partial((folder / "two.xdmf").write_text, text.replace(old, new)))
        with pytest.raises(MeshError, match=said):
            read_body(folder / "two.xdmf")


def test_facets_of_no_cell_are_missed(folder: Path) -> None:
    """The surface is named as one that is not whole, whatever rank reads which of its facets."""
    made(lambda: two_boxes(folder / "two.msh", 1))
    convert_mesh(folder / "two.msh", folder / "two.xdmf")
    surfaces = read_body(folder / "two.xdmf").surfaces

    def change() -> int:
        with h5py.File(folder / "two.h5", "a") as file:
            rows, x = file["surface_0"], file["points"][:]
            rows[0] = np.argsort(x @ [1.0, 2.0, 3.0])[[0, len(x) // 2, -1]]
            return len(rows)

    count = on_root(COMM, change)
    body = read_body(folder / "two.xdmf")
    (lost,) = set(surfaces) - set(body.surfaces)
    assert body.incomplete == {lost: f"1 of its {count} facets are no facets of an element"}
    assert any(
        f"incomplete named parts (left out): '{lost}' (1 of its" in note for note in body.notes
    )
