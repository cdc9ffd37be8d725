"""Several meshes in one case, each turned and moved: as one file, exact, and wrong ones refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from helpers.stacked import grid
from mpi4py import MPI

from dolfin_elastic import Body, Case, Placed, Statics, Turn, box_body, parts_body, restart, run
from dolfin_elastic.case.check.initial_state import touching_notes
from dolfin_elastic.case.restart import written_tables
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh.formats.convert import convert_mesh
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.results.checkpoint.checksums import fingerprint

COMM = MPI.COMM_WORLD
STEEL = {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3, "density": 7800}
RECTANGLE = {"rectangle": {"size": [1, 1], "cells": [2, 2]}}
LOWER, UPPER = grid((2.0, 1.0, 1.0), (3, 2, 1)), grid((2.0, 1.0, 1.0), (2, 3, 1))


def write(path: Path, points: np.ndarray, cells: np.ndarray, **data: Any) -> None:
    on_root(COMM, lambda: meshio.Mesh(points, [("tetra", cells)], **data).write(path))


def volumes(body: Body) -> dict[str, float]:
    own = cell_volumes(body.mesh)
    return {n: COMM.allreduce(float(own[body.owned_cells(n)].sum())) for n in body.regions}


def tables(mesh: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "mesh": mesh,
        "materials": {"steel": STEEL},
        "surfaces": {
            "foot": {"of": "lower", "plane": "z", "at": "min"},
            "below": {"of": "lower", "normal": "z"},
            "above": {"of": "upper", "normal": "-z"},
            "head": {"of": "upper", "plane": "z", "at": "max"},
        },
        "statics": {},
        **more,
    }


def displacements(case: Case) -> np.ndarray:
    """Sorted components at all nodes of all ranks [m], shape (3, nodes)."""
    problem = case.make_problem(case.read_body(COMM))
    *_, _ = case.make_solver(problem).steps()
    own = problem.V.dofmap.index_map.size_local
    u = problem.u.x.array.reshape(-1, 3)[:own]
    return np.sort(np.concatenate(COMM.allgather(u)), axis=0).T


@pytest.mark.parametrize("joint", ["tie", "contact"])
def test_parts_are_as_one_file(joint: str, folder: Path) -> None:
    """Files in mm and m, one turned: displacements of one file, to round-off and contact's."""
    write(folder / "lower.vtu", LOWER[0] * 1e3, LOWER[1])
    turned = np.stack([UPPER[0][:, 0], UPPER[0][:, 2], -UPPER[0][:, 1]], axis=1)  # by -90 about x
    write(folder / "bare.vtu", turned, UPPER[1])
    convert_mesh(folder / "bare.vtu", folder / "upper.xdmf")
    over = UPPER[0] + [0, 0, 1]
    both = np.concatenate([LOWER[0], over]), np.concatenate([LOWER[1], UPPER[1] + len(LOWER[0])])
    write(folder / "both.vtu", *both)
    halves = {n: {"box": [[-1, -1, z], [9, 9, z + 1]]} for n, z in (("lower", 0), ("upper", 1))}
    tie = {"tie": [{"on": "above", "to": "below"}]}
    rest: dict[str, Any] = {
        "support": [{"on": "foot"}, {"on": "head", "displacement": [0, 0, "-1 mm"]}],
        **(tie if joint == "tie" else {"contact": [{"between": ["above", "below"]}]}),
    }
    one = tables({"file": "both.vtu", "degree": 1}, regions=halves, **rest)
    turn = {"axis": "x", "angle": 90}
    parts = {
        "lower": {"file": "lower.vtu", "unit": "mm"},
        "upper": {"file": "upper.xdmf", "turn": turn, "move": [0, 0, "1000 mm"]},
    }
    known = displacements(Case.from_dict(one, folder))
    found = displacements(Case.from_dict(tables({"parts": parts, "degree": 1}, **rest), folder))
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-3 * (1e-9 if joint == "tie" else 1e-7))


def test_one_file_twice(folder: Path) -> None:
    """Exact volumes and reactions of both, and vectors of the file that turn with a part."""
    points, cells = LOWER
    along = np.tile([1.0, 0.0, 0.0], (len(cells), 1))
    data = {"cell_data": {"fibre": [along]}, "point_data": {"height": points[:, 2]}}
    write(folder / "block.vtu", points, cells, **data)
    file = {"file": "block.vtu", "unit": "mm"}
    parts = {"a": file, "b": {**file, "turn": {"axis": "z", "angle": 90}, "move": [0, 0, "1 cm"]}}
    surfaces = {f"{n}_foot": {"of": n, "plane": "z", "at": z} for n, z in (("a", "min"), ("b", 10))}
    more = {
        "surfaces": surfaces,
        "support": [{"on": name, "name": name} for name in surfaces],
        "load": [{"kind": "gravity"}],
    }
    case = Case.from_dict(tables({"parts": parts}, **more), folder)
    body = case.read_body(COMM)
    assert body.unit.name == "mm"
    assert volumes(body) == pytest.approx({"a": 2e-9, "b": 2e-9}, rel=1e-12)
    cells_of_b = body.owned_cells("b")
    turned = np.tile([0.0, 1.0, 0.0], (len(cells_of_b), 1))
    np.testing.assert_allclose(body.fields["b.fibre"].values[cells_of_b], turned, atol=1e-15)
    nodes = np.unique(body.mesh.geometry.dofmap[cells_of_b])
    height = (body.mesh.geometry.x[nodes, 2] - 0.01) * 1e3
    np.testing.assert_allclose(body.fields["b.height"].values[nodes, 0], height, atol=1e-12)
    assert np.isnan(body.fields["a.fibre"].values[cells_of_b]).all()
    *_, state = case.make_solver(case.make_problem(body)).steps()
    weight = 7800 * 9.81 * 2e-9
    for name in surfaces:
        np.testing.assert_allclose(state.reactions[name], [0, 0, weight], atol=1e-12 * weight)


def test_numbers_do_not_depend_on_ranks() -> None:
    """A checkpoint of one rank knows the mesh on others: elements are numbered part after part."""
    turn, cells = Turn(axis=[1, 2, 3], angle="0.3 rad"), [3, 2, 2]

    def made(comm: MPI.Comm) -> Body:
        box = box_body(size=[2, 1, 1], cells=cells, comm=comm)
        return parts_body({"a": Placed(box, [0, 0, 1], turn), "b": box})

    assert fingerprint(made(COMM)) == fingerprint(made(MPI.COMM_SELF))


def test_straight_elements_beside_quadratic_ones(folder: Path) -> None:
    """They become quadratic, with their names and volume; refined, parts stay what they are."""
    points, cells = grid((1.0, 1.0), (2, 2))
    ends = cells[:, [[0, 1], [1, 2], [0, 2]]]
    middles, rows = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    quadratic = np.hstack([cells, len(points) + rows.reshape(-1, 3)])
    nodes = np.concatenate([points, points[middles].mean(axis=1)])
    nodes[:, 1] += 0.1 * nodes[:, 0] * (1 - nodes[:, 0])  # as x^2 can be: exact area
    mesh = meshio.Mesh(np.pad(nodes, ((0, 0), (0, 1))), [("triangle6", quadratic)])
    on_root(COMM, lambda: mesh.write(folder / "bent.vtu"))
    parts = {"bent": {"file": "bent.vtu"}, "flat": {**RECTANGLE, "move": [0, 1], "unit": "cm"}}
    given = {"mesh": {"parts": parts, "refine": 1, "unit": "m"}, "materials": {"any": STEEL}}
    body = Case.from_dict({**given, "support": [{"on": "flat.left"}], "statics": {}}, folder)
    refined = body.read_body(COMM)
    assert refined.unit.name == "m" and refined.mesh.geometry.cmap.degree == 2
    assert volumes(refined) == pytest.approx({"bent": 1.0, "flat": 1e-4}, rel=1e-12)
    assert refined.count("flat.left") == 4 and refined.count("flat") == refined.count("bent") == 16
    assert "part 'flat': its elements are made quadratic, as others are" in "".join(
        Case.from_dict({**given, "mesh": {"parts": parts}, "statics": {}}, folder)
        .read_mesh(COMM)
        .information
    )


def test_restart(folder: Path) -> None:
    """A run goes on with the files wherever it was started, and its results do not say where."""
    write(folder / "block.vtu", *LOWER)
    parts = {"lower": {"file": "block.vtu"}, "upper": {"file": "block.vtu", "move": [0, 0, 1]}}
    more = {
        "support": [{"on": "foot"}],
        "tie": [{"on": "above", "to": "below"}],
        "load": [{"kind": "gravity"}],
        "statics": {"steps": 2},
        "output": {"formats": ["csv"]},
    }
    case = Case.from_dict(tables({"parts": parts}, **more), folder)
    states = run(case, output=folder / "results")
    next(states)
    next(states)
    states.close()
    *_, last = restart(folder / "results")
    body = case.read_body(COMM)
    problem = case.make_problem(body)
    *_, known = Statics(problem, steps=2).steps()
    assert last.max_displacement == pytest.approx(known.max_displacement, rel=1e-9)
    names = [part["file"] for part in written_tables(case)["mesh"]["parts"].values()]
    assert names == ["block.vtu", "block.vtu"]


def test_parts_that_overlap() -> None:
    """A note names them, not those that touch."""
    box = box_body(size=[1, 1, 1], cells=[2, 2, 2])
    body = parts_body({"a": box, "b": Placed(box, [0.4, 0, 0]), "on_a": Placed(box, [0, 0, 1])})
    assert body.notes == ("the parts 'a' and 'b' overlap: is that meant?",)


def test_touching_surfaces() -> None:
    """Two parts that touch: a note on the smallest surfaces, none with contact."""
    box = {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}}
    mesh = {"parts": {"a": box, "b": {**box, "move": [0, 0, 1]}}, "degree": 1}
    rest = {"materials": {"any": STEEL}, "support": [{"on": "a.bottom"}], "statics": {}}

    def notes(**more: Any) -> list[str]:
        case = Case.from_dict({"mesh": mesh, **rest, **more})
        return [*touching_notes(case.make_problem(case.read_body(COMM)))]

    (note,) = notes()
    assert "'a.top' and 'b.bottom' of two bodies touch on 1 m^2" in note
    assert notes(contact=[{"between": ["a", "b"]}]) == []


PIN = {"pin": RECTANGLE}


@pytest.mark.parametrize(
    ("mesh", "text"),
    [
        ({"parts": {}}, "mesh.parts: there is no part"),
        ({"parts": {"pin": {}}}, "mesh.parts.pin: no mesh is given"),
        ({"parts": {"pin": {"file": "blok.vtu"}}}, "mesh.parts.pin.file: .*mean 'block.vtu'"),
        ({"parts": {"pin": {"file": "wires.vtu"}}}, "mesh.parts.pin.file: .* no tetrahedra and"),
        ({"parts": {"pin": {**RECTANGLE, "mov": 1}}}, "mesh.parts.pin: .*'mov'; did you.* 'move'"),
        ({"parts": {"pin": {**RECTANGLE, "degree": 1}}}, "'degree'; this is a key of .mesh., for"),
        ({"parts": {"pin": {**RECTANGLE, "move": [1, 2, 3]}}}, "mesh.parts.pin.move: 3 components"),
        ({"parts": {"pin": {**RECTANGLE, "turn": {"axis": "x", "angle": 1}}}}, "pin.turn.axis: a"),
        ({"parts": {"block": {"file": "block.vtu", "turn": {"angle": 1}}}}, "turn.axis: the axis"),
        ({"parts": {"pin": {**RECTANGLE, "turn": {"angle": "2 m"}}}}, "angle: .* in degrees"),
        ({"parts": {"p.in": RECTANGLE}}, "mesh.parts: 'p.in' is no name of a part"),
        ({"parts": {**PIN, "block": {"file": "block.vtu"}}}, "mesh.parts.block: .*3-dim"),
        ({"parts": PIN, "size": 1}, "mesh.size: each part has a key of its own"),
        ({"parts": PIN, "file": "block.vtu"}, "mesh: file and parts given together"),
        (
            {"parts": {"pin": {"rectangle": {"size": [1, 1], "cells": [10**5, 10**5]}}}},
            "pin.rectangle.cells: ",
        ),
    ],
)
def test_wrong_parts(mesh: dict[str, Any], text: str, folder: Path) -> None:
    """The message has the dotted key, and what is right."""
    write(folder / "block.vtu", *LOWER)
    wires = meshio.Mesh(np.eye(3), [("line", np.array([[0, 1]]))])
    on_root(COMM, lambda: wires.write(folder / "wires.vtu"))
    with pytest.raises(InputError, match=text):
        Case.from_dict(
            {"mesh": mesh, "materials": {"any": STEEL}, "statics": {}}, folder, file="case.toml"
        ).read_body(COMM)
