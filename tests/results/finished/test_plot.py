"""Pictures and curves of a finished run; only what needs no display is computed here."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import cli
from helpers.states import displacement, make_problem, make_state
from PIL import Image

import dolfin_elastic
from dolfin_elastic import Case
from dolfin_elastic.cli.tools.plot import _limits, plot
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.finished.curves import (
    Axis,
    Curves,
    _label,
    along,
    circle,
    draw_curves,
    history_curves,
    line,
    write_csv,
)
from dolfin_elastic.results.finished.draw import draw, film
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.outputs import History, Summary, Xdmf
from dolfin_elastic.results.scene import renderer
from dolfin_elastic.results.scene.appearance import Appearance
from dolfin_elastic.results.scene.clip import Clip
from dolfin_elastic.results.scene.colour_bar import prefixed
from dolfin_elastic.results.scene.scene import Picture, load


@pytest.fixture
def run(folder: Path) -> FinishedRun:
    """Two steps of a body with quadratic displacements, beside a plane."""
    problem = make_problem(3, 2, cells=2)
    contact = [{"on": "right", "plane": {"axis": "-x", "at": 2.5}, "motion": [-0.1, 0, 0]}]
    case = {"title": "A beam", "contact": contact}
    outputs = (Xdmf(fields=("displacement", "von_mises", "rank")), History(), Summary(case=case))
    writers = [output.open(problem, folder / "beam") for output in outputs]
    for step in (1, 2):
        state = make_state(
            problem, step, step / 2, numbers={"tip_x": 0.25 * step, "P11": 1e6}, done=step / 2
        )
        for writer in writers:
            writer.write(state)
    for writer in writers:
        writer.close()
    return FinishedRun(folder / "beam")


def check_displacement(run: FinishedRun, points: FloatArray, over: Axis) -> None:
    found = along(run, ["displacement", "rank"], points, over)
    assert [c.name for c in found.curves] == [*(f"displacement_{a}" for a in "xyz"), "rank"]
    expected = displacement(points.T)
    for i in range(3):
        # VTK finds places in quadratic cells by Newton's method, to 1e-4 of their size (0.5 m).
        assert np.abs(found.curves[i].values - expected[i]).max() < 5e-5


def test_a_field_along_a_line_and_a_circle(run: FinishedRun) -> None:
    """A quadratic field is met inside quadratic cells, on faces and on the surface."""
    points, distance = line([0, 0.1, 0.2], [2, 0.9, 0.7])
    assert distance[-1] == pytest.approx(np.sqrt(4 + 0.64 + 0.25))
    check_displacement(run, points, Axis("distance", distance, "m"))
    points, angle = circle([1, 0.5, 0.5], 0.3, [0, 0, 2])
    np.testing.assert_allclose(np.linalg.norm(points - [1, 0.5, 0.5], axis=1), 0.3)
    np.testing.assert_allclose(points[:, 2], 0.5)
    np.testing.assert_allclose(points[50], [1, 0.8, 0.5])  # a quarter, counter-clockwise
    check_displacement(run, points, Axis("angle", angle, "rad"))


QUARTER = """SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0, 0, 2, 2, Pi/2};
Cylinder(2) = {0, 0, 0, 0, 0, 2, 1, Pi/2};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
"""


@pytest.mark.long
def test_a_field_along_a_face_of_curved_elements(folder: Path) -> None:
    """Points on the plane of symmetry of a quarter of a ring are points of the body."""
    (folder / "quarter.geo").write_text(QUARTER)
    tables = {
        "mesh": {"file": "quarter.geo", "size": 0.8},
        "surfaces": {"foot": {"plane": "x", "at": 0}},
        "materials": {"one": {"law": "linear-elastic", "E": 1e6, "nu": 0.3}},
        "support": [{"on": "foot"}],
        "load": [{"kind": "body-force", "value": [0, 0, 1e3]}],
        "statics": {},
    }
    [*dolfin_elastic.run(Case.from_dict(tables, folder), output=folder / "ring")]
    points, distance = line([0, 1, 1], [0, 2, 1])
    over = Axis("distance", distance, "m")
    values = along(FinishedRun(folder / "ring"), ["von_mises"], points, over).curves[0].values
    assert np.isfinite(values).all()


def test_a_tensor_along_a_line_is_named_by_its_norm(folder: Path) -> None:
    """Of a bar under a uniform tension of 100 Pa, which is the norm of the stress, too."""
    tables = {
        "mesh": {
            "rectangle": {"size": [2, 1], "cells": [2, 1]},
            "geometry": "plane-stress",
            "thickness": 1,
        },
        "materials": {"one": {"law": "linear-elastic", "E": 1e6, "nu": 0.3}},
        "support": [{"kind": "symmetry", "on": side} for side in ("left", "bottom")],
        "load": [{"kind": "traction", "on": "right", "value": [100, 0]}],
        "output": {"fields": ["cauchy_stress"]},
    }
    [*dolfin_elastic.run(Case.from_dict(tables), output=folder / "bar")]
    points, distance = line([0, 0.5, 0], [2, 0.5, 0])
    over = Axis("distance", distance, "m")
    [curve] = along(FinishedRun(folder / "bar"), ["cauchy_stress"], points, over).curves
    assert curve.name == "cauchy_stress_norm"
    assert _label(curve.name, "Pa") == "norm of the Cauchy stress [Pa]"
    assert _label("gap_norm", "") == "gap norm"
    # The direct solver's round-off.
    np.testing.assert_allclose(curve.values, 100.0, rtol=1e-10)


def test_points_outside(run: FinishedRun) -> None:
    """They have no value; a line that misses the body is refused with the body's size."""
    points, distance = line([1, 0.5, 0.5], [3, 0.5, 0.5])
    over = Axis("distance", distance, "m")
    values = along(run, ["von_mises"], points, over).curves[0].values
    assert np.isfinite(values[distance <= 1]).all()
    assert np.isnan(values[distance > 1.01]).all()
    with pytest.raises(InputError, match=r"--line: all its points lie outside.*x from 0 to 2"):
        along(run, ["von_mises"], points + np.array([5.0, 0, 0]), over)


def test_curves_of_the_history_as_table(run: FinishedRun, folder: Path) -> None:
    """Names with SI units, numbers as they are; and a picture."""
    found = history_curves(run, "t", ["tip_x", "max_displacement"])
    write_csv(found, folder / "a.csv")
    with (folder / "a.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["load parameter", "tip_x [m]", "max_displacement [m]"]
    assert [float(row[1]) for row in rows[1:]] == [0.25, 0.5]
    draw_curves(found, folder / "a.png")
    assert len(set(Image.open(folder / "a.png").convert("RGB").getdata())) > 10
    with pytest.raises(InputError, match=r"has no column 'tip_xx'; did you mean 'tip_x'"):
        history_curves(run, "t", ["tip_xx"])


@pytest.mark.parametrize("name", ["history.png", "history.csv"])
def test_numbers_of_the_run_are_never_overwritten(run: FinishedRun, name: str) -> None:
    """Neither by a table nor by the table beside a picture."""
    before = (run.folder / "history.csv").read_bytes()
    with pytest.raises(InputError, match=r"--output: .*history\.csv is a file of the run"):
        plot(run.folder, curve="tip_x", output=run.folder / name)
    assert (run.folder / "history.csv").read_bytes() == before
    assert not (run.folder / "history.png").exists()


def test_at_most_two_units_in_a_picture(run: FinishedRun) -> None:
    """A third axis would lie on the second one; a table has room for all."""
    names = "t:tip_x,load_factor,P11"
    with pytest.raises(InputError, match="--curve: the curves have 3 units: 1, Pa, m"):
        plot(run.folder, curve=names, output=run.folder / "a.png")
    plot(run.folder, curve=names, output=run.folder / "a.csv")
    assert (run.folder / "a.csv").read_text().startswith("load parameter,tip_x [m],load_factor,")


def test_powers_of_units_are_raised() -> None:
    assert _label("volume", "cm^3") == "volume [cm\u00b3]"
    assert _label("a", "m/s^2") == "a [m/s\u00b2]"
    assert _label("a", "") == "a"


def test_names_with_dollars_are_no_formulas(folder: Path) -> None:
    """Two dollars begin and end a formula of matplotlib, which raises where it is none."""
    x = np.array([0.0, 1.0])
    curves = Curves(Axis("a$\\x$", x), [Axis("b$_$", x)], r"beam $\frac$")
    draw_curves(curves, folder / "a.svg")
    assert [path.name for path in folder.iterdir()] == ["a.svg"]


def test_small_areas_and_volumes() -> None:
    """Of a cavity in cubic centimetres, where m^3 would be drawn with a power of ten."""
    found = [prefixed(*one) for one in ((1.05e-6, "m^3"), (5e-9, "m^3"), (2.0, "m^3"))]
    assert [unit for _, unit in found] == ["cm^3", "mm^3", "m^3"]
    assert [factor for factor, _ in found] == pytest.approx([1e-6, 1e-9, 1.0])
    assert prefixed(3e-4, "m^2") == (pytest.approx(1e-4), "cm^2")


def test_no_film_of_modes_alone(folder: Path) -> None:
    """They have no steps."""
    (folder / "summary.json").write_text("{}")
    with pytest.raises(InputError, match="it holds no fields of steps"):
        film(FinishedRun(folder), ["displacement"], Appearance(), folder / "a.mp4", fps=30, speed=1)


def test_ranges_as_those_of_pictures() -> None:
    """Units and percentiles, as the guide says."""
    found = [_limits(text) for text in ("0:2e8", "0:200 MPa", "2%:98 %")]
    assert [(one.ends, one.share) for one in found] == [
        ((0.0, 2e8), False),
        ((0.0, 2e8), False),
        ((2.0, 98.0), True),
    ]
    with pytest.raises(InputError, match="--range: this is no range of colours"):
        _limits(":")


def test_what_a_picture_is_told(
    run: FinishedRun, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The surface that clip planes leave, with its section; the obstacle where it has moved to."""
    told: list[Picture] = []

    def drawing(user: object, data: Sequence[Path], file: Path) -> None:
        told.append(load(data[0]))
        file.touch()

    monkeypatch.setattr(renderer.RENDERER, "draw", drawing)
    for clips in ((), (Clip(0, 0.7),), (Clip(0, 0.7), Clip(2, 0.6, above=False))):
        draw(run, ["displacement"], Appearance(clips=clips), folder / "a.png")
    areas = [area(one) for one in told]
    # Of the box 2 x 1 x 1, what is left of 0.7 x 1 x 1, and of 0.7 x 1 x 0.4.
    np.testing.assert_allclose(areas, [10.0, 4.8, 2 * (0.7 + 0.28 + 0.4)], rtol=1e-5)
    points, values = told[1].scene.points, told[1].frame.values["displacement"]
    inside = np.linalg.norm(displacement(points.T), axis=0)
    # Faces are straight between the points of divided faces and sections.
    assert np.abs(values - inside).max() < 0.01
    (obstacle,) = told[0].scene.obstacles
    np.testing.assert_allclose((obstacle.points + obstacle.shift)[:, 0], 2.4)
    assert told[0].title == "A beam   |   load 100 %   |   deformation \u00d7 1"
    with pytest.raises(
        InputError, match="--clip: the plane x = -1 m misses the body; between 0 and 2 m"
    ):
        draw(run, ["displacement"], Appearance(clips=[Clip(0, -1.0)]), folder / "a.png")
    both = [Clip(0, 0.7, above=True), Clip(0, 0.8, above=False)]
    said = "--clip: nothing of the body is left; planes that leave a part of it, x = 0 to 2, y = 0"
    with pytest.raises(InputError, match=said):
        draw(run, ["displacement"], Appearance(clips=both), folder / "a.png")


def test_a_plain_picture_holds_nothing_but_the_body(run: FinishedRun, folder: Path) -> None:
    """No title above it, no axes beside it; else there are both."""
    for bare in (False, True, False):  # what one picture has beside the body is not in the next
        file = folder / f"{bare}.png"
        look = Appearance(marks=False, obstacles=False, bare=bare, view="-y")
        draw(run, ["displacement"], look, file)
        pixels = np.asarray(Image.open(file).convert("RGB")).astype(int)
        height, width = pixels.shape[:2]
        # The background is the same along each row.
        for rows, columns in (
            (slice(0, height // 10), slice(0, width)),
            (slice(9 * height // 10, height), slice(0, width // 7)),
        ):
            differs = np.ptp(pixels[rows, columns], axis=1).max() > 8
            assert differs == (not bare)
        coloured = np.flatnonzero((np.ptp(pixels, axis=2) > 60).any(axis=0))
        # As wide as the picture; else the body ends, and the bar begins, some way from its edge.
        assert (coloured[-1] > 0.95 * width) == bare


def area(one: Picture) -> float:
    corners = one.scene.points[one.scene.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--field", "von_mise"], "there is no field 'von_mise'; did you mean 'von_mises'?"),
        (["--field", "velocity"], "there is no field 'velocity'; known: displacement"),
        (["--step", "7"], "there is no step 7; 0 to 1, or -1 for the last"),
        (["--curve", "t:tip_y"], "history.csv has no column 'tip_y'; did you mean 'tip_x'?"),
        (["--clip", "w=1"], "--clip: 'w=1' is no plane; for example x=0.01"),
        (["--line", "0,0"], "--line: '0,0' is no line; for example 0,0,0:0.1,0,0"),
        (["--circle", "0,0,0"], "--circle: '0,0,0' is no circle; for example"),
        (["--view", "top"], "--view: there is no view 'top'"),
        (["--clip", "x=1 kg"], "--clip: 'x=1 kg' is no plane: '1 kg' has the wrong unit"),
        (["--clip", "x=900 cm"], "--clip: the plane x = 9 m misses the body"),
        (["--line", "0,0,0:0.1,0"], "--line: '0.1,0' is no point in 3 dimensions; for example"),
        (["--circle", "0,0:1:z"], "--circle: '0,0:1:z' is no circle; for example 0,0,0:0.005:z"),
        (["--range", "2:1"], "--range: the first end of a range of colours must be below"),
        (["--range", "a:1"], "--range: this is no range of colours; for example 0:2e8"),
        (["--scale", "-2"], "--scale: a finite number not below 0 is needed, not -2"),
        (["--scale", "nan"], "--scale: a finite number not below 0 is needed, not nan"),
        (["-o", "a.mp4", "--fps", "0"], "--fps: a finite number above 0 is needed, not 0"),
        (["-o", "a.mp4", "--speed", "-1"], "--speed: a finite number above 0 is needed, not -1"),
        (["-o", "a.gif", "--fps", "60"], "--fps: viewers show at most 50 frames a second"),
        (["-o", "a.jpg"], "--output: 'a.jpg' is neither picture nor film"),
        (["-o", "a.pdf"], "in .png, .mp4 or .gif; curves (--line, --circle, --curve) also in .csv"),
    ],
)
def test_what_cannot_be_plotted(run: FinishedRun, words: list[str], message: str) -> None:
    """One message with the nearest name, exit code 2."""
    code, out, err = cli("plot", "beam", *words, folder=run.folder.parent)
    assert (code, out) == (2, "")
    assert message in err


@pytest.mark.long
def test_a_curve_from_the_command_line(run: FinishedRun) -> None:
    """What there is, a curve and its table, from a second rank nothing."""
    code, out, err = cli("plot", "beam", "--list", folder=run.folder.parent)
    assert (code, err) == (0, "")
    assert "displacement, von_mises, rank" in out and "tip_x [m]" in out
    what = ["--curve", "tip_x:max_displacement", "-o", "a.png"]
    code, out, err = cli("plot", "beam", *what, folder=run.folder.parent, ranks=2)
    assert (code, out, err) == (0, "a.png written, the numbers in a.csv\n", "")
