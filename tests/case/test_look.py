"""`dolfin-elastic look`: lists of faces and parts against closed forms, and pictures."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.cad import angle, write
from mpi4py import MPI

from dolfin_elastic.case.look.listing import Look
from dolfin_elastic.case.look.look import look_at
from dolfin_elastic.cli import console
from dolfin_elastic.cli.look.show import show_look
from dolfin_elastic.core.errors import DrawingError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.results.scene import series
from dolfin_elastic.results.scene.scene import Picture

COMM = MPI.COMM_WORLD
MM = 1e-3
CASE = """
[mesh]
file = "angle.step"
size = 1.1
[surfaces]
hole = {kind = "hole"}
fillet = {cylinder = {radius = "4 mm"}}
wall = {plane = "z", at = "max"}
[materials.steel]
law = "linear-elastic"
E = "210 GPa"
nu = 0.3
density = "7850 kg/m^3"
[[support]]
on = "wall"
[[load]]
kind = "pressure"
on = "hole"
value = "2 MPa"
[[load]]
kind = "gravity"
[[contact]]
on = "fillet"
sphere = {center = [0.05, 0, 0.05], radius = 0.01}
"""


def case(folder: Path, text: str = CASE) -> Path:
    write(folder / "angle.step", angle)
    on_root(COMM, lambda: (folder / "angle.toml").write_text(text) and None)
    return folder / "angle.toml"


def faults(found: Look) -> list[str]:
    """Notes, but for that on the large cells of these tests."""
    return [note for note in found.notes if not note.startswith("a cell turns")]


def by_name(found: Look, kind: str = "surfaces") -> dict[str, float]:
    return {row.name: row.measure for row in getattr(found, kind)}


def test_lists_of_a_cad_file(folder: Path) -> None:
    """Areas, centroids and normals of the angle, by construction."""
    write(folder / "angle.step", angle)
    found = look_at(folder / "angle.step", picture=None)
    assert (found.unit, found.dim, found.picture) == ("mm", 3, "")
    assert found.extent == pytest.approx((20 * MM, 6 * MM, 16 * MM))
    faces = {f.description: f for f in found.faces if f.kind == "cylinder"}
    hole, fillet = faces["cylinder r 1.5 mm, hole"], faces["cylinder r 4 mm, fillet"]
    assert hole.area == pytest.approx(9 * np.pi * MM**2, rel=1e-9)
    assert (hole.normal, hole.axis) == ((), (0.0, 0.0, 1.0))
    assert hole.centroid == pytest.approx((14 * MM, 3 * MM, 1.5 * MM), rel=1e-6)
    # Of a concave fillet between +x and +z the mean normal is at 45 degrees.
    assert fillet.normal == pytest.approx((0.5**0.5, 0, 0.5**0.5), abs=1e-3)
    (bottom,) = [f for f in found.faces if f.normal and f.normal[2] < -0.9]
    assert bottom.area == pytest.approx((120 - 2.25 * np.pi) * MM**2, rel=1e-9)
    # Legs, and the corner that the fillet fills; less the hole.
    volume = 20 * 6 * 3 + 13 * 6 * 3 + 6 * (16 - 4 * np.pi) - 2.25 * np.pi * 3
    assert by_name(found, "regions") == pytest.approx({"(whole body)": volume * MM**3}, rel=1e-3)


def test_lists_of_a_case(folder: Path) -> None:
    """Names, their faces and what uses them; the same on any number of ranks."""
    found = look_at(case(folder), picture=None)
    rows = {row.name: row for row in found.surfaces}
    assert {name: row.use for name, row in rows.items()} == {
        "fillet": "contact",
        "hole": "pressure",
        "wall": "support",
    }
    assert [len(row.faces) for row in rows.values()] == [1, 1, 1]
    assert rows["wall"].measure == pytest.approx(18 * MM**2, rel=1e-9)
    assert rows["wall"].normal == pytest.approx((0, 0, 1), abs=1e-9)
    named = {name: face.number for face in found.faces for name in face.names}
    assert {name: row.faces[0] for name, row in rows.items()} == named


@pytest.mark.usefixtures("serial_only")
def test_the_list_fits_into_eighty_columns(folder: Path, capsys, monkeypatch) -> None:
    """Lengths in the file's unit, directions along axes by their names."""
    monkeypatch.setattr(console, "WIDTH", 80)
    show_look(look_at(case(folder), picture=None))
    lines = [line for line in capsys.readouterr().out.splitlines() if "angle.step" not in line]
    text = "\n".join(lines)
    assert all(part in text for part in ("cylinder r 1.5", "hole", "axis +z", "(14, 3, 1.5)"))
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("wrong", "note"),
    [
        (
            'hole = {kind = "hole"}|hole = {faces = [99]}',
            r"surfaces\.hole\.faces: there is no face 99",
        ),
        (
            'on = "wall"|on = "wal"',
            r"no surface 'wal' .*did you mean 'wall'\?; faces of the CAD file",
        ),
    ],
    ids=["face", "name"],
)
def test_a_case_with_a_fault_is_shown_all_the_same(folder: Path, wrong, note) -> None:
    """Who has named a face wrongly looks for its number."""
    import re

    text = CASE.replace(*wrong.split("|"))
    found = look_at(case(folder, text), picture=None)
    assert len(found.faces) == 10
    assert any(re.search(note, one) for one in found.notes)


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("Xvfb"), reason="pictures need Xvfb")
def test_picture_of_a_case(folder: Path) -> None:
    """Two views side by side; supports green, loads red and the obstacle's violet are in both."""
    file = folder / "look.png"
    found = look_at(case(folder), picture=file)
    assert found.picture == str(file) and not faults(found)

    def counts() -> tuple[tuple[int, ...], list[int]]:
        from matplotlib.image import imread

        image = imread(file)[..., :3]
        red, green, blue = (image[..., i] for i in range(3))
        supports = (green > red + 0.15) & (green > blue + 0.08) & (green < 0.6)
        loads = (red > green + 0.35) & (red > blue + 0.35)
        contact = (blue > green + 0.03) & (red > green + 0.015) & (blue > 0.8)
        half = image.shape[1] // 2
        masks = [supports, loads, contact]
        return image.shape, [
            int(m[:, s].sum()) for m in masks for s in (slice(half), slice(half, None))
        ]

    shape, pixels = on_root(COMM, counts)
    assert shape[1] == 3000 and shape[0] > 1000
    assert all(count > 150 for count in pixels)


def test_without_a_picture_the_list_still_comes(folder: Path, monkeypatch) -> None:
    def fail(*_: object) -> None:
        raise DrawingError("cannot draw a picture: no display; pyvista and Xvfb are needed")

    monkeypatch.setattr(series, "draw_pictures", fail)
    found = look_at(case(folder), picture=folder / "look.png")
    text = "no picture: cannot draw a picture: no display; pyvista and Xvfb are needed"
    assert faults(found) == [text]
    assert len(found.surfaces) == 3 and not found.picture


@pytest.mark.parametrize(("value", "up"), [("", "z"), ("value = [0, -9.81, 0]\n", "y")])
def test_up_is_against_the_weight(folder: Path, monkeypatch, value: str, up: str) -> None:
    """As in the pictures of the case's results."""
    drawn: list[list[Picture]] = []
    monkeypatch.setattr(series, "draw_pictures", lambda user, sides, file: drawn.append(sides))
    text = CASE.replace('kind = "gravity"\n', f'kind = "gravity"\n{value}')
    look_at(case(folder, text), picture=folder / "look.png")
    assert [[one.up for one in sides] for sides in drawn] == [[up] * 2] * (COMM.rank == 0)


def test_lists_of_a_finished_mesh(folder: Path) -> None:
    """A plane mesh: its named lines with their lengths, and the region."""
    text = 'SetFactory("OpenCASCADE");\nRectangle(1) = {0, 0, 0, 3, 2};\n'
    text += 'Physical Surface("plate") = {1};\nPhysical Curve("left") = {4};\n'
    on_root(COMM, lambda: (folder / "plate.geo").write_text(text) and None)
    found = look_at(folder / "plate.geo", picture=None)
    assert by_name(found) == pytest.approx({"left": 2.0})
    assert by_name(found, "regions") == pytest.approx({"(whole body)": 6.0, "plate": 6.0})
    assert found.surfaces[0].normal == pytest.approx((-1.0, 0.0))
    assert {face.description for face in found.faces} == {"line"}
    assert json.dumps([row.area for row in found.faces]).count("3.0") == 2
