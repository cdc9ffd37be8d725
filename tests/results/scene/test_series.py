"""Series and films: one range, one camera, even time; obstacles; a display that fails."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.states import make_problem, make_state
from PIL import Image

from dolfin_elastic.core.errors import InputError, OutputError, RestartError
from dolfin_elastic.core.shapes.shapes import CylinderObstacle, Plane, Shape, SphereObstacle
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.results.outputs import Picture, limits_of
from dolfin_elastic.results.scene import renderer, series
from dolfin_elastic.results.scene.colour_bar import ColourBar, colour_map
from dolfin_elastic.results.scene.obstacles import Reach, obstacles_beside
from dolfin_elastic.results.scene.scene import (
    Frame,
    Patch,
    Reliable,
    Scene,
    axes_of,
    bar_of,
    load,
    up_against,
)
from dolfin_elastic.results.scene.scene import Picture as Panel
from dolfin_elastic.results.scene.series import Limits, Series, encode, film_times, frames_at


def scene_of(values: Sequence[float], shift: float = 0.0, nodes: BoolArray | None = None) -> Panel:
    """One triangle with these stresses at its corners."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    frame = Frame("", np.full((3, 3), shift), {"von_mises": np.array(values, dtype=float)})
    scene = Scene(points, np.array([[0, 1, 2]]), frames=(frame,), plane=True, nodes=nodes)
    return Panel(scene, "z", field="von_mises", unit="Pa")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Panel]:
    """What the drawing process would be told, in the order of the pictures."""
    told: list[Panel] = []

    def draw(user: object, data: Sequence[Path], file: Path) -> None:
        told.append(load(data[0]))
        Image.new("RGB", (64, 48), (len(told), 0, 0)).save(file)

    monkeypatch.setattr(renderer.RENDERER, "draw", draw)
    return told


def bar_in(picture: Panel) -> ColourBar:
    assert picture.bar is not None
    return picture.bar


def test_one_range_and_one_camera_over_a_series(folder: Path, drawn: list[Panel]) -> None:
    """The first picture is drawn again when a later one needs more; the last one is not."""
    pictures = Series(Limits(), marks=True, folder=folder / ".frames")
    for number, (values, shift) in enumerate((([0, 1e6, 2e6], 0.0), ([0, 1e6, 8e6], 0.5))):
        panel = scene_of(values, shift)
        pictures.add(number, [panel])
        pictures.draw(number, [panel], folder / f"{number}.png")
    pictures.redraw()
    pictures.close()
    ticks = [list(bar_in(one).ticks) for one in drawn]
    assert ticks == [[0, 0.5, 1, 1.5, 2], *[[0, 2, 4, 6, 8]] * 2]
    assert np.array_equal(drawn[2].seen, drawn[1].seen)
    assert not np.array_equal(drawn[0].seen, drawn[1].seen)
    assert drawn[2].marks[0].text == "max 2 MPa"
    np.testing.assert_allclose(drawn[1].marks[0].place, (0.5, 1.5, 0.5))
    assert not (folder / ".frames").exists()


def test_series_of_a_run_that_is_restarted(folder: Path, drawn: list[Panel]) -> None:
    """Scenes before the checkpoint count for range and film, later ones are gone."""
    before = Series(Limits(), marks=False, folder=folder / ".frames")
    for number in (1, 2, 3):
        before.add(number, [scene_of([0, 1e6, number * 1e6])])
    before.close(keep=True)
    after = Series(Limits(), marks=False, folder=folder / ".frames")
    after.forget_after(2)
    assert after.numbers() == [1, 2]
    after.draw(2, [scene_of([0, 0, 1e6])], folder / "a.png")
    assert bar_in(drawn[0]).ticks[-1] == 2


@pytest.mark.parametrize("fault", ["class", "field", "words", "cut"])
def test_scenes_of_another_version_are_refused(folder: Path, fault: str) -> None:
    """By the name of the file, and what to do; without them the series goes on."""
    before = Series(Limits(), marks=False, folder=folder / ".frames")
    before.add(1, [scene_of([0, 1e6, 2e6])])
    file = folder / ".frames/00000001_0.npz"
    arrays = dict(np.load(file))
    words = arrays["words"].tobytes()
    if fault == "class":
        words = words.replace(b'"Frame"', b'"Instant"')
    elif fault == "field":
        words = words.replace(b'"shift"', b'"offset"').replace(b'"plane"', b'"is_plane"')
    arrays["words" if fault != "words" else "text"] = np.frombuffer(words, dtype=np.uint8)
    if fault == "words":
        del arrays["words"]
    np.savez(file, **arrays)
    if fault == "cut":
        file.write_bytes(file.read_bytes()[:-100])
    after = Series(Limits(), marks=False, folder=folder / ".frames")
    with pytest.raises(RestartError, match=r"00000001_0.npz: this is no scene .* or remove \S+"):
        after.forget_after(2)
    shutil.rmtree(folder / ".frames")
    after.forget_after(2)
    assert after.numbers() == []


@pytest.mark.parametrize(
    ("ends", "found", "share"),
    [
        ([0, "200 MPa"], (0.0, 2e8), False),
        (["2 %", "98%"], (2.0, 98.0), True),
        ([-1.5, 1], (-1.5, 1.0), False),
    ],
)
def test_ranges(ends: list[float | str], found: tuple[float, float], share: bool) -> None:
    limits = limits_of(ends)
    assert (limits.ends, limits.share) == (found, share)


@pytest.mark.parametrize("ends", [[1, 0], [1], ["2 %", "200 %"], ["a", "b"], ["1 XPa", "2 XPa"]])
def test_what_is_no_range(ends: list[float | str]) -> None:
    said = "this is no range of colours"
    if ends == [1, 0]:
        said = "the first end of a range of colours must be below the second"
    with pytest.raises(InputError, match=f"range: {said}; for example"):
        Picture(range=ends)


def test_films_are_told_from_pictures() -> None:
    """A suffix decides; what belongs to films only is refused elsewhere."""
    assert Picture(file="fall.mp4", fps=60).fps == 60
    with pytest.raises(InputError, match=r"fps: 'a.png' is no film; file = \"film.mp4\""):
        Picture(file="a.png", fps=60)
    with pytest.raises(InputError, match=r"at most 50 frames a second of a .gif"):
        Picture(file="a.gif", fps=60)
    with pytest.raises(InputError, match=r"'a.avi' does not end with .png, .mp4 or .gif; for"):
        Picture(file="a.avi")


def test_frames_at_uneven_states() -> None:
    """Each frame shows the state that is nearest in time: steps of 0.1 s and of 0.4 s at 10 fps."""
    assert frames_at([0.0, 0.1, 0.2, 0.6, 1.0], 10) == [0, 1, 2, 2, 2, 3, 3, 3, 3, 4, 4]
    assert frames_at([3.0], 10) == [0]
    assert film_times([0.1, 0.6, 0.4], 0.5) == pytest.approx([0.0, 1.0, 1.4])  # a load that falls


def probe(file: Path) -> dict[str, Any]:
    """Frames, frames a second and duration, as ffprobe counts them."""
    entries = "stream=nb_read_frames,r_frame_rate,duration,width,height"
    command = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", entries, "-of", "json"]
    done = subprocess.run([*command, str(file)], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)["streams"][0]
    return found


needs_ffmpeg = pytest.mark.skipif(shutil.which("ffprobe") is None, reason="needs ffmpeg")


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_what_is_up_is_up(up: str) -> None:
    """In every view that does not look along it; right, up and camera are right-handed."""
    for view in ("isometric", "x", "-x", "y", "-y", "z", "-z"):
        back, right, top = axes_of(view, up)
        np.testing.assert_allclose(np.cross(right, top), back, atol=1e-15)
        if view[-1] != up:
            assert top["xyz".index(up)] > 0.7
    assert up_against([(0.0, "sin(t)"), (0.0, -9.81, 0.0)]) == "y"
    assert up_against([(0.0, 0.0, 9.81), (1.0, -9.81, 0.0)]) == "z"


@pytest.mark.parametrize(
    ("clip", "message"),
    [
        ({"plane": "x", "at": 2}, r"clip.at: the plane x = 2 m misses the body; between 0 and 2 m"),
        ([{"plane": "z"}], r"clip\[0\].plane: the body is plane, it has no z; x or y"),
    ],
)
def test_planes_that_cut_nothing(clip: Any, message: str) -> None:
    """Before the run: the picture would show nothing, or all."""
    with pytest.raises(InputError, match=message):
        Picture(clip=clip).clips(make_problem(2, cells=1).body)


def test_the_floor_of_a_series_stays(folder: Path, drawn: list[Panel]) -> None:
    """As large as the whole way of the body needs, in every picture, and where its obstacle is."""
    reach, pictures = Reach(), Series(Limits(), marks=False, folder=folder / ".frames")
    for number, shift in enumerate((0.0, 3.0)):
        panel = scene_of([0, 1, 2], shift)
        reach.take(panel.moved)
        floor = ("", Plane(axis="z", at=-1.0), np.array([0, 0, shift]))
        beside = obstacles_beside([floor], reach, 3)
        panel = replace(panel, scene=replace(panel.scene, obstacles=beside))
        pictures.add(number, [panel])
        pictures.draw(number, [panel], folder / f"{number}.png")
    pictures.redraw()
    (first,), (last,) = ([o.points + o.shift for o in drawn[i].scene.obstacles] for i in (2, 1))
    np.testing.assert_allclose(last - first, np.tile([0, 0, 3.0], (4, 1)))
    np.testing.assert_allclose(first[:, 2], -1.0)


def test_marks_stand_at_nodes(folder: Path, drawn: list[Panel]) -> None:
    """Between nodes a quadratic field overshoots what the run has found; films have no marks."""
    pictures = Series(Limits(), marks=True)
    panel = scene_of([1e6, 9e6, 2e6], nodes=np.array([True, False, True]))
    pictures.add(0, [panel])
    pictures.draw(0, [panel], folder / "a.png")
    assert drawn[0].marks[0].text == "max 2 MPa"
    body = make_problem(2, cells=1).body
    assert [Picture(file=f).appearance(body).marks for f in ("a.png", "a.mp4")] == [True, False]


@needs_ffmpeg
@pytest.mark.parametrize(("name", "fps"), [("a.mp4", 60.0), ("a.gif", 20.0)])
def test_a_film_is_read_back(folder: Path, name: str, fps: float) -> None:
    """Frames, frames a second, duration, and sides that every player takes."""
    for i in range(12):
        Image.new("RGB", (65, 49), (20 * i, 0, 0)).save(folder / f"{i:03d}.png")
    encode(folder / "%03d.png", folder / name, fps)
    found = probe(folder / name)
    assert int(found["nb_read_frames"]) == 12
    assert found["r_frame_rate"] == f"{fps:g}/1"
    assert float(found["duration"]) == pytest.approx(12 / fps, abs=0.02)
    assert name.endswith("gif") or found["width"] % 2 == found["height"] % 2 == 0


@needs_ffmpeg
def test_a_film_of_a_run_in_even_time(folder: Path, drawn: list[Panel]) -> None:
    """Of uneven states; those that come faster than frames are not all drawn."""
    problem = make_problem(2, cells=1)
    writer = Picture(file="fall.mp4", field="displacement", fps=10, speed=0.5).open(problem, folder)
    times = [0.0, 0.001, 0.002, 0.05, 0.1, 0.3, 0.5]
    for step, t in enumerate(times):
        writer.write(make_state(problem, step, t, v=problem.u))
    writer.close()
    found = probe(folder / "fall.mp4")
    assert int(found["nb_read_frames"]) == 11  # 0.5 s at half the speed, both ends shown
    assert [path.name for path in folder.iterdir()] == ["fall.mp4"]
    shown = {one.title.split("   |   ")[0] for one in drawn}
    assert shown == {f"t = {t:g} s" for t in (0.0, 0.05, 0.1, 0.3, 0.5)}


def test_without_ffmpeg_or_with_a_fault(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence that says what is missing."""
    monkeypatch.setattr(series.shutil, "which", lambda name: None)
    with pytest.raises(OutputError, match="cannot make a film: ffmpeg is not installed"):
        encode(folder / "%03d.png", folder / "a.mp4", 30)


def test_films_that_cannot_be_made_are_output_errors(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run warns of those, and of nothing else: its summary is closed all the same."""
    monkeypatch.setattr(series.shutil, "which", lambda name: "sleep")

    def late(command: Sequence[str], **settings: Any) -> None:
        raise subprocess.TimeoutExpired(command, settings["timeout"])

    monkeypatch.setattr(series.subprocess, "run", late)
    with pytest.raises(OutputError, match="ffmpeg has not ended within 600 s"):
        encode(folder / "%03d.png", folder / "a.mp4", 30)
    film = Series(Limits(), marks=False, folder=folder / "frames").film
    with pytest.raises(OutputError, match="no state of it is left"):
        film(folder / "a.mp4", [], [], 30)

    def full(**settings: Any) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(series.tempfile, "TemporaryDirectory", full)
    with pytest.raises(OutputError, match="make room"):
        film(folder / "a.mp4", [0.0], [0], 30)


@pytest.mark.long
@pytest.mark.parametrize(
    ("script", "why"), [("exit 1", "Xvfb has ended"), ("exec sleep 60", "no display after")]
)
@pytest.mark.usefixtures("own_renderer")
def test_a_display_that_does_not_come_up(
    folder: Path, script: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run warns once and goes on; a server that hangs is not waited for without an end."""
    (folder / "bin").mkdir()
    (folder / "bin/Xvfb").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "bin/Xvfb").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(renderer, "_START", 0.3)
    monkeypatch.setattr(renderer, "_window_in_memory", lambda: "")
    messages: list[str] = []
    monkeypatch.setattr(
        "dolfin_elastic.results.scene.pictures.log.log",
        lambda level, text, *args: messages.append(text % args),
    )
    problem = make_problem(2, cells=1)
    writer = Picture(every=1, field="displacement").open(problem, folder / "out")
    for step in range(2):
        writer.write(make_state(problem, step))
    writer.close()
    assert why in messages[0]
    assert messages[0].endswith("; the run goes on")
    assert not list((folder / "out").glob("*.png"))


@pytest.mark.parametrize(
    "obstacle",
    [
        Plane(axis="-z", at=2.0),
        SphereObstacle(center=[0, 0, 3], radius=0.5),
        SphereObstacle(center=[0, 0, 0], radius=4, inside=True),
        CylinderObstacle(axis="y", point=[0, 0, 3], radius=0.5),
        CylinderObstacle(axis=[1, 1, 0], point=[0, 0, 0], radius=3, inside=True),
    ],
)
def test_obstacles_are_drawn_where_the_gap_is_zero(obstacle: Shape) -> None:
    """By the formula of the contact, and counter-clockwise seen from the free side."""
    shift = np.array([0.1, -0.2, 0.3])
    reach = Reach()
    reach.take(np.array([-np.ones(3), np.ones(3)]))
    (beside,) = obstacles_beside([("", obstacle, shift)], reach, 3)
    x, triangles = beside.points + beside.shift, beside.triangles
    gap, normal = obstacle.gaps(x - shift)
    assert np.abs(gap).max() < 1e-12
    corners = x[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    large = np.linalg.norm(across, axis=1) > 1e-9
    outward: FloatArray = normal[triangles].mean(axis=1)
    assert large.any()
    assert (np.sum(across * outward, axis=1)[large] > 0).all()


def test_a_frame_of_a_film_is_wide_and_its_floor_has_no_end(folder: Path) -> None:
    """16 to 9; the floor fills the lower corners, and the shadow on it is darker with contact."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    reach = Reach()
    reach.take(points)
    darkest = []
    for height in (0.0, 0.5):
        floor = obstacles_beside([("", Plane(axis="z", at=-height), np.zeros(3))], reach, 3)
        scene = Scene(points, triangles, frames=(Frame("", 0 * points),), obstacles=floor)
        red = Patch(("a",), colour="#ff0000")
        scene = replace(scene, patch=np.zeros(4, dtype=int), patches=(red,))
        series.draw_pictures(folder, [Panel(scene, bare=True, film=True)], folder / "a.png")
        with Image.open(folder / "a.png") as image:
            assert image.size == (1280, 720)
            colours = np.asarray(image.convert("RGB")).astype(int)
        grey = np.ptp(colours, axis=2) < 4  # the body is red
        pixels = colours[..., 0]
        corners = pixels[-2, [1, -2]]
        assert np.ptp(corners) <= 3
        assert corners.max() < 230
        darkest.append(np.percentile(pixels[grey & (pixels > 100) & (pixels < 210)], 10))
    renderer.RENDERER.release(folder)
    assert darkest[0] < darkest[1]


def test_obstacles_stay_clear_of_the_colour_bar(folder: Path) -> None:
    """A plane one is grey above the body, but not beside it, nor under the headline."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    lid, reach = Contact(on="top", plane={"axis": "-y", "at": 1.0}).obstacle, Reach()
    reach.take(30 * points)  # so large is the lid
    above = obstacles_beside([("", lid, np.zeros(3))], reach, 2)
    frame = Frame("", 0 * points, {"von_mises": np.arange(4.0)})
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    scene = Scene(points, triangles, frames=(frame,), plane=True, obstacles=above)
    panel = Panel(scene, "z", field="von_mises", unit="Pa")
    panel = series.finished(panel, (0.0, 3.0), Limits(), panel.seen, marks=False)
    series.draw_pictures(folder, [panel], folder / "a.png")
    renderer.RENDERER.release(folder)
    with Image.open(folder / "a.png") as image:
        pixels = np.asarray(image.convert("L")).astype(int)
    high, wide = pixels.shape
    # Rows of the lid, the headline, the bar's title: of the background only.
    assert pixels[int(0.12 * high), int(0.4 * wide)] < 225
    assert pixels[int(0.03 * high), int(0.4 * wide)] > 245
    assert pixels[int(0.12 * high), int(0.9 * wide)] > 245


def test_colours_grow_lighter() -> None:
    """Evenly, so that the colour-blind and a grey print show the same order."""
    light = colour_map()(np.linspace(0, 1, 21))[:, :3] @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(light) > 0)


@pytest.mark.parametrize(("field", "values"), [("safety_factor", 1.0), ("von_mises", 2e6)])
@pytest.mark.parametrize("reached", [True, False])
def test_a_line_where_the_allowable_stress_is_reached(
    folder: Path, field: str, values: float, reached: bool
) -> None:
    """Red on pictures, where the safety factor is 1 or the stress the allowable one; nothing else
    is, but a line across the bar, which has room for it.
    """
    small = field == "safety_factor"
    other = 3.0 if small else 1e6
    end = values * (0.5 if small == reached else 1.5)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    frame = Frame("", 0 * points, {field: np.array([end, other, other])})
    scene = Scene(points, np.array([[0, 1, 2]]), frames=(frame,), plane=True)
    panel = Panel(scene, "z", field=field, unit="" if small else "Pa", allowable=values)
    ends = min(end, other), max(end, other)
    panel = series.finished(panel, ends, Limits(), panel.seen, marks=False)
    bar = bar_in(panel)
    assert (bar.limit is not None) == (small or reached)
    unmarked = bar_of(np.array([-1.0, 1.0]), np.array([-1.0, 1.0]), "cauchy_stress_xx", "Pa")
    assert unmarked.limit is None  # a stress of 0 is no allowable one
    if not small:
        assert bar.label.endswith("red: allowable 2" if reached else "\nallowable 2")
    counts = []
    for bare in (True, False):
        series.draw_pictures(folder, [replace(panel, bare=bare)], folder / "a.png")
        with Image.open(folder / "a.png") as image:
            colours = np.asarray(image.convert("RGB")).astype(int)
        red = (colours[..., 0] > 180) & (colours[..., 1] < 90) & (colours[..., 2] < 90)
        counts.append(np.count_nonzero(red[:, :1250] if bare else red[:, 1250:]))
    renderer.RENDERER.release(folder)
    assert (counts[0] > 200) == reached
    assert (100 < counts[1] < 1000) == (bar.limit is not None)


RIM = {"value": 8e6, "singular": "the rim of the support 'left'", "place": [1, 0], "error": None}
FILLET = {"value": 3e6, "place": [0, 1], "error": 0.06}


def test_what_is_singular_is_told(drawn: list[Panel], folder: Path) -> None:
    """The colours end at the largest reliable stress, which is marked beside the singular one."""
    panel = replace(scene_of([0, 8e6, 3e6]), reliable=Reliable.of(RIM, FILLET))
    pictures = Series(Limits(), marks=True)
    pictures.add(0, [panel])
    pictures.draw(0, [panel], folder / "a.png")
    (told,) = drawn
    assert [mark.text for mark in told.marks] == ["max 8 MPa: singular", "3 MPa ± 6 %"]
    np.testing.assert_allclose([mark.place for mark in told.marks], [[1, 0, 0], [0, 1, 0]])
    assert bar_in(told).ticks[-1] == 3
    assert bar_in(told).label == "von Mises stress\n[MPa]\nmore where singular"
    assert Reliable.of({**RIM, "singular": ""}, FILLET) is None
    alone = replace(panel, reliable=Reliable.of(RIM, None))
    alone = series.finished(alone, (0, 8e6), Limits(), panel.seen, marks=True)
    assert [mark.text for mark in alone.marks] == ["max 8 MPa: singular"]
    cut = replace(scene_of([0, 2e6, 1e6]), reliable=Reliable.of(RIM, FILLET))
    cut = series.finished(cut, (0, 2e6), Limits(), panel.seen, marks=True)
    assert [mark.text for mark in cut.marks] == ["max 2 MPa"]  # a plane has left the rest
    round_off = replace(panel, noise=1e7)
    assert not series.finished(round_off, (0, 8e6), Limits(), panel.seen, marks=True).marks


def test_a_mode_has_no_size(drawn: list[Panel], folder: Path) -> None:
    panel = replace(scene_of([0, 0.5, 1.0002]), field="von_mises", unit="", scaled=True)
    pictures = Series(Limits(), marks=True)
    pictures.add(0, [panel])
    pictures.draw(0, [panel], folder / "a.png")
    assert bar_in(drawn[0]).ticks[-1] == 1
    assert bar_in(drawn[0]).label.endswith("\nscaled to 1")
