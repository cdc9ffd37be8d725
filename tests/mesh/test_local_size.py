"""Smaller cells in places: of CAD files by Gmsh, of finished meshes by division."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cad import angle, write
from mpi4py import MPI

from dolfin_elastic import Case
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.mesh import Body, Selector, Sphere, mesh_statistics
from dolfin_elastic.mesh.faces import CadFaces
from dolfin_elastic.mesh.formats.cad.faces import CadFace
from dolfin_elastic.mesh.geometry.simplices import cell_corners
from dolfin_elastic.mesh.local_size import CadSizes, LocalSize

COMM = MPI.COMM_WORLD
MM = 1e-3
STEEL = {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}}


def body_of(folder: Path, mesh: dict[str, Any], **tables: Any) -> Body:
    tables = {"mesh": mesh, "materials": STEEL, **tables}
    return Case.from_dict(tables, folder, file="c.toml").read_body(COMM)


def sizes(body: Body, center: list[float], low: float, high: float) -> tuple[float, float, float]:
    """Smallest, mean and largest mean edge [mm] of cells so far from a place [mm]."""
    corners = cell_corners(body.mesh, body.owned_cells()) / MM
    middle = corners.mean(axis=1)
    pairs = [(i, j) for i in range(body.dim + 1) for j in range(i)]
    edges = np.mean(
        [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in pairs], axis=0
    )
    away = np.linalg.norm(middle - np.array(center), axis=1)
    edges = edges[(away >= low) & (away <= high)]
    mean = float(total(COMM, edges.sum())) / max(int(total(COMM, len(edges))), 1)
    least = smallest(COMM, float(edges.min(initial=np.inf)))
    return least, mean, largest(COMM, float(edges.max(initial=0.0)))


@pytest.mark.parametrize(
    "surfaces",
    [
        {"fillet": {"cylinder": {"radius": "4 mm"}}},
        {"fillet": {"cylinder": {"point": [7, 0, 7], "axis": "y", "radius": 4}}},
    ],
    ids=["kind", "place"],
)
def test_cells_at_a_fillet_have_the_size(folder: Path, surfaces) -> None:
    """Gmsh's triangles have edges of the size, its tetrahedra of about 1.3 times of it in the mean;
    away from the fillet they grow to the size of the whole."""
    write(folder / "angle.step", angle)
    mesh = {"file": "angle.step", "size": 3, "refine": [{"on": "fillet", "size": "0.6 mm"}]}
    body = body_of(folder, mesh, surfaces=surfaces)
    # The middle of the fillet is at 7 - 4/sqrt(2).
    _, near, _ = sizes(body, [4.17, 3, 4.17], 0, 1.0)
    _, far, _ = sizes(body, [4.17, 3, 4.17], 10, 99)
    assert 0.5 < near < 0.85
    assert 1.8 < far < 3.5
    assert "smaller elements: 0.6 mm at 'fillet'" in body.information
    triangle = np.sqrt(3) / 4 * 0.6**2
    assert body.count("fillet") == pytest.approx(12 * np.pi / triangle, rel=0.2)


@pytest.mark.parametrize(
    "place",
    [
        {"sphere": {"center": [1.5, 3, 16], "radius": 2}},
        {"box": [[0, 0, 14], [3, 6, 16]]},
    ],
    ids=["sphere", "box"],
)
def test_cells_of_a_cad_file_in_places(folder: Path, place) -> None:
    write(folder / "angle.step", angle)
    mesh = {"file": "angle.step", "size": 3, "refine": [{**place, "size": "0.7 mm"}]}
    body = body_of(folder, mesh)
    _, near, _ = sizes(body, [1.5, 3, 16], 0, 1.5)
    _, far, _ = sizes(body, [1.5, 3, 16], 10, 99)
    assert near == pytest.approx(0.7, rel=0.3)
    assert far > 1.6


@pytest.mark.parametrize("file", [True, False], ids=["cad", "box"])
def test_uniform_refinement_keeps_names(folder: Path, file: bool) -> None:
    """Eight cells of each, four facets of each; the volume stays, or comes nearer the true one."""
    write(folder / "angle.step", angle)
    mesh = {"file": "angle.step", "size": 4, "curved": False, "unit": "mm"}
    surfaces = {"s": {"kind": "fillet"}}
    if not file:
        mesh = {"box": {"size": [4, 4, 4], "cells": [2, 2, 2]}, "unit": "mm"}
        surfaces = {"s": {"plane": "x", "at": "max"}}
    regions = {"r": {"box": [[0, 0, 0], [9, 9, 2]]}}
    tables = {"surfaces": surfaces, "regions": regions}
    coarse, fine = (body_of(folder, {**mesh, "refine": n}, **tables) for n in (0, 1))
    assert fine.num_cells == 8 * coarse.num_cells
    assert fine.count("s") == 4 * coarse.count("s")
    volumes = [mesh_statistics(body).regions["r"] for body in (coarse, fine)]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-2 if file else 1e-12)
    assert f"refined uniformly 1 time: {coarse.num_cells} elements before" in fine.information


@pytest.mark.parametrize(
    "place",
    [
        {"on": "corner"},
        {"on": "core"},
        {"sphere": {"center": [0, 0, 0], "radius": 1}},
        {"box": [[0, 0, 0], [1, 1, 1]]},
    ],
    ids=["surface", "region", "sphere", "box"],
)
@pytest.mark.sample(2)
def test_finished_meshes_are_divided_there(folder: Path, place) -> None:
    """The mean edge there is at most the size, far away it is that of before."""
    mesh = {"box": {"size": [8, 8, 8], "cells": [4, 4, 4]}, "unit": "mm"}
    tables = {
        "surfaces": {"corner": {"box": [[0, 0, 0], [2, 2, 0]], "normal": [0, 0, -1]}},
        "regions": {"core": {"box": [[0, 0, 0], [2, 2, 2]]}},
    }
    before = body_of(folder, mesh, **tables)
    body = body_of(folder, {**mesh, "refine": [{**place, "size": 1}]}, **tables)
    assert sizes(body, [0.5, 0.5, 0.5], 0, 0.8)[2] <= 1.0
    assert sizes(body, [8, 8, 8], 0, 3)[2] == pytest.approx(sizes(before, [8, 8, 8], 0, 3)[2])
    a, b = mesh_statistics(before), mesh_statistics(body)
    assert b.volume == pytest.approx(a.volume, rel=1e-12)
    assert b.regions["core"] == pytest.approx(a.regions["core"], rel=1e-12)
    assert b.surfaces["corner"] == pytest.approx(a.surfaces["corner"], rel=1e-12)
    assert any(text.startswith("refined to 1 mm at ") for text in body.information)


@pytest.mark.parametrize("center", [[0, 0, 0], [3.1, 1.7, 2.3]], ids=["corner", "inside"])
def test_places_much_smaller_than_a_cell(folder: Path, center) -> None:
    """Of six cells those at the place are divided: no refusal, whether it holds a vertex or not."""
    mesh = {"box": {"size": [8, 8, 8], "cells": [1, 1, 1]}, "unit": "mm"}
    refine = [{"sphere": {"center": center, "radius": 0.05}, "size": 0.03}]
    body = body_of(folder, {**mesh, "refine": refine})
    least, _, most = sizes(body, center, 0, 0.04)
    assert 0.03 / 4 < least <= most <= 0.03
    assert body.num_cells < 20_000
    outside = [{"sphere": {"center": [9, 9, 9], "radius": 0.05}, "size": 0.03}]
    with pytest.raises(InputError, match=r"refine\[0\]: there is no element in the sphere"):
        body_of(folder, {**mesh, "refine": outside})


@pytest.mark.parametrize(
    ("refine", "message"),
    [
        (
            [{"on": "tip", "size": 1}],
            r"mesh\.refine\[0\]\.on: there is no surface or region 'tip'; ",
        ),
        (
            [{"on": "top", "size": "1 nm"}],
            r"mesh\.refine\[0\]\.size: .* would have about .* elements",
        ),
        (9, r"mesh\.refine: refined like this .* at most 5e\+07"),
        (
            [{"size": 1}],
            r"mesh\.refine\[0\]: no position is given; expected exactly one of",
        ),
        ([{"on": "top", "siz": 1}], r"mesh\.refine\[0\]: unknown key 'siz'; did you mean 'size'"),
        ([{"sphere": {"radius": 1}, "size": 1}], r"refine\[0\]\.sphere\.center: this key is mis"),
    ],
    ids=["name", "small", "often", "nowhere", "key", "centre"],
)
def test_messages(folder: Path, refine, message) -> None:
    mesh = {"box": {"size": [4, 4, 4], "cells": [2, 2, 2]}, "unit": "mm", "refine": refine}
    with pytest.raises(InputError, match=message):
        body_of(folder, mesh)


@pytest.mark.long
def test_messages_of_cad_files(folder: Path) -> None:
    """A name that does not exist is answered by the faces that it may mean."""
    write(folder / "angle.step", angle)
    mesh = {"file": "angle.step", "refine": [{"on": "fillet", "size": 1}]}
    with pytest.raises(
        InputError, match=r"c\.toml: mesh\.refine\[0\]\.on: .* 'fillet'; .* r 4 mm, f"
    ):
        body_of(folder, mesh)
    small = {**mesh, "refine": [{"on": "fillet", "size": "1 nm"}]}
    fillet = {"fillet": {"kind": "fillet"}}
    many = r"refine\[0\]\.size: there would be about .* at most "
    with pytest.raises(InputError, match=many + r"1\.2e\+07, for which Gmsh has 600 s \(mesh\."):
        body_of(folder, small, surfaces=fillet)
    with pytest.raises(InputError, match=many + r"5e\+07; lengths without a unit are in mm"):
        body_of(folder, {**small, "time_limit": "1 h"}, surfaces=fillet)
    half = {"fillet": {"box": [[0, 0, 0], [9, 3, 9]]}}
    with pytest.raises(InputError, match=r"refine\[0\]\.on: .* is not a complete face"):
        body_of(folder, mesh, surfaces=half)
    for name in ("fillet", "later"):
        own = {"fillet": {"of": name, "plane": "z", "at": "min"}, "later": {"kind": "plane"}}
        with pytest.raises(InputError, match=rf"\.on: .* is of '{name}', but no surface of th"):
            body_of(folder, mesh, surfaces=own)


def test_faces_without_samples_are_those_of_their_numbers() -> None:
    """Nobody knows where they lie: a place does not pick them."""
    face = CadFace(1, "surface", "", None, (), None, None, None, (), (), (), ())
    faces, size = CadFaces({1: face}, 3), LocalSize(on="s", size=0.1)
    for one, found in (({"faces": (1,)}, True), ({"plane": "z", "at": "min"}, False)):
        sizes_ = CadSizes([size], {"s": [Selector(**one)]})
        if found:
            assert sizes_.for_gmsh(faces, {}, 1.0) == [{"faces": [1], "size": 0.1}]
        else:
            with pytest.raises(MeshError, match="not a complete face of the CAD file"):
                sizes_.for_gmsh(faces, {}, 1.0)
    ball = LocalSize(sphere=Sphere(center=(0, 0, 0), radius=1), size=0.1)
    assert len(CadSizes([ball]).for_gmsh(faces, {}, 1.0)) == 1


@pytest.mark.long
def test_the_peak_at_a_fillet_is_that_of_a_mesh_that_is_fine_everywhere(folder: Path) -> None:
    """Same cells at the fillet: the same peak within the error of both, with half the unknowns."""
    from dolfin_elastic.results.recovery.error import ErrorEstimator
    from dolfin_elastic.results.recovery.peaks import find_peaks

    write(folder / "angle.step", lambda occ: angle(occ, 4.0))
    peaks, unknowns = [], []
    local = {"size": 3, "refine": [{"on": "fillet", "size": "0.7 mm"}]}
    for sizes_ in ({"size": 0.7}, local):
        case = Case.from_dict(
            {
                "mesh": {"file": "angle.step", **sizes_},
                "surfaces": {
                    "fillet": {"kind": "fillet"},
                    "hole": {"kind": "hole"},
                    "wall": {"plane": "z", "at": "max"},
                },
                "materials": STEEL,
                "support": [{"on": "wall"}],
                "load": [{"kind": "traction", "on": "hole", "value": [0, 0, "1 MPa"]}],
            },
            folder,
        )
        problem = case.make_problem(case.read_body(COMM))
        *_, state = case.make_solver(problem).steps()
        found = find_peaks(problem, ErrorEstimator(problem)(state))
        peaks.append(found.regular.value)
        unknowns.append(problem.num_dofs)
    assert peaks[1] == pytest.approx(peaks[0], rel=0.02)
    assert unknowns[1] < 0.6 * unknowns[0]


@pytest.mark.long
def test_the_number_of_cells_is_known_before(folder: Path) -> None:
    """Of what is refused it need only be right to a factor, 2 here; a slip in the unit is 1000."""
    write(folder / "angle.step", angle)
    mesh = {"file": "angle.step", "size": 4, "refine": [{"on": "fillet", "size": 0.5}]}
    fillet = {"fillet": {"kind": "fillet"}}
    without = body_of(folder, {**mesh, "refine": []}, surfaces=fillet).num_cells
    more = body_of(folder, mesh, surfaces=fillet).num_cells - without
    limit = {**mesh, "time_limit": "1 s", "refine": [{"on": "fillet", "size": 0.02}]}
    with pytest.raises(InputError, match=r"at most 2e\+04, for which Gmsh has 1 s") as caught:
        body_of(folder, limit, surfaces=fillet)
    told = float(re.search(r"about (\S+) elements", str(caught.value))[1])
    assert 1 / 2 < more * (0.5 / 0.02) ** 2 / told < 2
