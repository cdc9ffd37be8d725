"""Pages of runs of every kind: what they hold, that it is what the summary says, and that they run
nothing of a stranger's.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import shutil
from dataclasses import replace
from functools import cache
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import Case, run
from dolfin_elastic.case.described import described_tables
from dolfin_elastic.cli.tools.report import _write
from dolfin_elastic.core.errors import DrawingError, InputError, OutputError, SolveError
from dolfin_elastic.core.si_text import quantity
from dolfin_elastic.model.describe import Setting
from dolfin_elastic.notebook.report_view import show_report
from dolfin_elastic.report import pdf, still
from dolfin_elastic.report.balance import balance_of, loads_of, supports_of
from dolfin_elastic.report.charts import Axis, Line, line_chart
from dolfin_elastic.report.contents import audit_of, history_charts, last_values, residual_chart
from dolfin_elastic.report.drawn import drawn_frames, scene_of
from dolfin_elastic.report.laws import _constants
from dolfin_elastic.report.page import json_text
from dolfin_elastic.report.report import (
    LARGEST,
    _command,
    _own_pictures,
    _palette,
    _room,
    write_report,
)
from dolfin_elastic.report.scene import (
    MOST_TRIANGLES,
    Viewed,
    chosen_frames,
    node_values,
    packed,
)
from dolfin_elastic.report.several import rows_of_cases, write_pages
from dolfin_elastic.report.words import small_strains
from dolfin_elastic.results.finished.findings import mesh_badge
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.colour_bar import colour_map
from dolfin_elastic.results.scene.scene import Frame, Glyphs, Picture, Reliable, Scene

EVIL = "</script><script>alert(1)</script><img src=x onerror='alert(2)'>&amp;\"`"
BOX = {"box": {"size": [4, 1, 1], "cells": [4, 1, 1]}}
STEEL = {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": 1000}
HELD = [{"on": "left"}]
DOWN = [{"kind": "traction", "on": "right", "value": [0, 0, "-100 Pa"]}]
CASES: dict[str, dict[str, Any]] = {
    "statics": {"statics": {"steps": 3}, "load": DOWN},
    "dynamics": {"dynamics": {"end": "0.2 s", "dt": "0.05 s"}, "load": DOWN},
    "modal": {"modal": {"count": 2}},
    "buckling": {
        "buckling": {"count": 1},
        "load": [{"kind": "force", "on": "right", "value": [-1, 0, 0]}],
    },
    "plane": {
        "title": EVIL,
        "mesh": {"rectangle": {"size": [4, 1], "cells": [4, 1]}},
        "materials": {EVIL: STEEL},
        "support": [{"on": "left", "name": EVIL}],
        "load": [{"kind": "pressure", "on": "right", "value": "2 kPa"}],
        "statics": {"steps": 3},
        "output": {"probes": {"x<script>": [4, 0.5]}},
    },
    "failed": {
        "materials": {"block": {**STEEL, "law": "st-venant-kirchhoff"}},
        "load": [{"kind": "pressure", "on": "right", "value": "5 MPa"}],
        "statics": {"steps": 4, "min_step": 0.1},
    },
}
SECTIONS = [
    "What was computed",
    "Pictures",
    "Supports and loads",
    "Results",
    "Audit",
    "Steps and convergence",
    "Body and mesh",
    "Materials",
    "The case",
    "To repeat it",
]
VOID = {"meta", "img", "input", "br"}


class Page(HTMLParser):
    """A page that is read as browsers do: elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.heads: list[str] = []
        self.values: list[float] = []
        self.text = ""
        self.inside: dict[str, list[str]] = {"script": [], "style": []}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag == "data":
            self.values.append(float(str(found["value"])))
        if tag in self.inside:
            self.inside[tag].append("")
        if tag == "h2":
            self.heads.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))  # of SVG

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in self.inside:
            self.inside[self.open[-1]][-1] += data
            return
        self.text += data
        if "h2" in self.open:
            self.heads[-1] += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [found for name, found in self.tags if name == tag]


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Kind to the folder of its run, which is computed when it is first asked for."""

    @cache
    def finished(kind: str) -> Path:
        folder = tmp_path_factory.mktemp(kind) / "results"
        tables = {"title": kind, "mesh": BOX, "materials": {"block": STEEL}, "support": HELD}
        case = Case(**{**tables, **CASES[kind]})
        try:
            for _ in run(case, output=folder):
                pass
        except SolveError:
            assert kind == "failed"
        return folder

    return finished


def page_of(folder: Path, output: Path) -> tuple[Page, dict[str, Any]]:
    write_report(folder, output)
    text = output.read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST / 4
    return Page(text), json.loads((folder / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.long
def test_in_a_notebook(folders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same page in a frame, as text: whatever the case has written ends nowhere outside."""
    monkeypatch.setattr(still, "draw_pictures", lambda _user, _pictures, file: file.touch())
    shown = show_report(folders("plane"), height=500)._repr_html_()
    outer = Page(shown)
    ((tag, attributes),) = outer.tags
    assert tag == "iframe" and attributes["sandbox"] == "allow-scripts"
    assert attributes["height"] == "500" and not outer.text.strip()
    write_report(folders("plane"), tmp_path / "page.html")
    assert len(attributes["srcdoc"] or "") == len((tmp_path / "page.html").read_text("utf-8"))


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("kind", ["statics", "failed", "plane", "dynamics", "modal", "buckling"])
def test_page(folders: Any, kind: str, tmp_path: Path) -> None:
    """All sections, the numbers of the summary, and nothing that runs but the page's own."""
    page, summary = page_of(folders(kind), tmp_path / "page.html")
    heads = [head for head in page.heads if head != "History"]
    assert heads == SECTIONS
    assert ("History" in page.heads) == (kind in ("statics", "plane", "dynamics"))
    expected = [row["value"] for row in summary["extremes"].values() if summary["steps"]]
    expected += [
        row[k] for row in summary.get("modes", []) for k in ("frequency", "load_factor") if k in row
    ]
    error = summary.get("error") or {}
    expected += [row["value"] for row in (error.get("elsewhere"),) if row and summary["steps"]]
    assert expected or kind == "failed"
    missing = [value for value in expected if value not in page.values]
    assert missing == []
    check_policy(page)
    check_words(page, summary, kind)


def check_words(page: Page, summary: dict[str, Any], kind: str) -> None:
    state = {"failed": "Failed: no solution was found"}.get(kind, "Completed")
    assert state in page.text
    if kind == "failed":
        assert summary["status"] == "failed"
        assert summary["reason"] in page.text
        assert "the state that failed" in page.text
        assert "Nothing was audited" in page.text  # that the body at rest passes says nothing
    if kind == "statics":
        assert "‘left’ (fixed: no displacement)" in page.text
        assert "(0, 0, −100) N" in page.text  # 100 Pa on an area of 1 m^2
        assert "(0, 0, 100) N" in page.text  # the reaction
        assert "area 1 m²" in page.text
        assert "volume4 m³" in "".join(page.text.split("\n"))
        assert "dolfin-elastic run case.toml" in page.text
    assert ("known to" in page.text) == (kind in ("statics", "plane"))  # no empty columns
    assert ("force and moment on the body" in page.text) == ("modes" not in summary)
    titles = [field["title"] for field in json.loads(page.inside["script"][0])["fields"]]
    assert ("displacement (scaled to 1)" in titles) == ("modes" in summary)
    if kind == "buckling":
        assert "factors on all loads at which it buckles" in page.text


@pytest.mark.long
def test_several_runs_on_one_page(
    folders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """First a table, a column a run, with the numbers of each summary; then a section each."""
    monkeypatch.setattr(still, "draw_pictures", lambda _user, _pictures, file: file.touch())
    kinds = ["statics", "modal", "buckling", "plane"]
    page = Page(write_pages([folders(k) for k in kinds], tmp_path / "a.html").read_text("utf-8"))
    assert not page.all("script")
    check_policy(page)
    table = page.text[page.text.index("verdict") : page.text.index("“±” is")]
    for kind in kinds:
        found = json.loads((folders(kind) / "summary.json").read_text(encoding="utf-8"))
        assert found["verdict"]["text"][1:] in table
        expected = [row["frequency"] for row in found.get("modes", []) if "frequency" in row]
        expected += [row["load_factor"] for row in found.get("modes", []) if "load_factor" in row]
        expected += [(found.get("error") or {}).get("elsewhere", {}).get("value")]
        assert {x for x in expected if x is not None} <= {*page.values}
    for text in ("frequency, first modes", "What differs in the cases", "modal.count", "memory"):
        assert text in table
    assert len(page.heads) == 1 + len(kinds)  # the table has one, too
    assert {f"#run-{k}" for k in range(1, 5)} == {str(row["href"]) for row in page.all("a")}


def test_what_differs_in_cases() -> None:
    """Values that not all cases have, after their keys; titles and outputs change no number."""
    one = {"title": "a", "load": [{"on": "x", "value": [1, 0]}], "statics": {}, "output": {"a": 1}}
    two = {"title": "b", "load": [{"on": "x", "value": [2, 0]}, {"on": "y"}]}
    rows = rows_of_cases([one, one, two])
    text = {key: [[line.value for line in cell] for cell in row] for key, row in rows.items()}
    assert text == {
        "load[0].value": [["(1, 0)"], ["(1, 0)"], ["(2, 0)"]],
        "statics": [["yes"], ["yes"], []],
        "load[1].on": [[], [], ["y"]],
    }
    assert rows_of_cases([one, {**one, "title": "c"}]) == {}


def test_no_folders_and_no_false_yes_in_what_differs() -> None:
    """Of a file its name alone, for pages are mailed; an empty list is not called a "yes"."""
    one = {"mesh": {"file": "/home/me/a.msh"}, "tie": [], "part_of": ""}
    two = {"mesh": {"file": "/home/me/b.msh"}, "tie": [1], "part_of": "x"}
    rows = rows_of_cases([one, two])
    text = {key: [line.value for cell in row for line in cell] for key, row in rows.items()}
    assert text == {
        "mesh.file": ["a.msh", "b.msh"],
        "tie": ["empty", "(1)"],
        "part_of": ["empty", "x"],
    }


def check_policy(page: Page) -> None:
    """The hashes are those of the content, and there is nothing else to run or load."""
    (policy,) = [
        str(row["content"])
        for row in page.all("meta")
        if row.get("http-equiv") == "Content-Security-Policy"
    ]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    data, *scripts = page.inside["script"] or ["{}"]
    json.loads(data)
    for text in (*scripts, *page.inside["style"]):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    types = [row.get("type") for row in page.all("script")]
    assert types == ["application/json", None][: len(types)]
    for tag, row in page.tags:
        assert not [key for key in row if key.startswith("on") or key in ("style", "srcdoc")], tag
        assert tag not in ("iframe", "object", "embed", "link", "base", "form")
        for key in ("src", "href", "xlink:href"):
            assert str(row.get(key, "#")).startswith(("#", "data:image/png;base64,")), (tag, row)


@pytest.mark.long
def test_strangers_names_are_text(folders: Any, tmp_path: Path) -> None:
    """Names of the case with scripts in them are shown as they are; no element comes of them."""
    page, _ = page_of(folders("plane"), tmp_path / "page.html")
    assert page.text.count(EVIL) >= 4  # title, sentence, support, material, case
    assert "x<script>" in page.text
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert "<img src=x" not in text


@pytest.mark.long
def test_strangers_summary(folders: Any, tmp_path: Path) -> None:
    """What a run would never write into its summary is text, too, or is refused in one message."""
    folder = folders("statics")
    known = (folder / "summary.json").read_text(encoding="utf-8")
    found = json.loads(known)
    found["reason"] = found["status"] = EVIL
    found["versions"] = {EVIL: EVIL}
    found["audit"] |= {"reasons": [EVIL], "notes": [EVIL], "verdict": EVIL}
    found["extremes"]["von_mises"]["part"] = EVIL
    found["model"] |= {"warnings": [EVIL], "file": EVIL}
    try:
        (folder / "summary.json").write_text(json.dumps(found), encoding="utf-8")
        write_report(folder, tmp_path / "page.html")
    finally:
        (folder / "summary.json").write_text(known, encoding="utf-8")
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    check_policy(page)
    assert page.text.count(EVIL) >= 7


def test_the_first_line_is_the_verdict(folders: Any, tmp_path: Path) -> None:
    """It stands above all else, with part, author and conclusion; the reliable number is large."""
    folder = shutil.copytree(folders("statics"), tmp_path / "copy")
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    found["case"] |= {
        "part": "4711-03",
        "author": "Stress group",
        "conclusion": "It may be built.",
    }
    (folder / "summary.json").write_text(json.dumps(found), encoding="utf-8")
    text = write_report(folder, tmp_path / "page.html").read_text(encoding="utf-8")
    head = unescape(text[: text.index("<main>")])
    order = [
        "</h1>",
        found["verdict"]["text"][1:],
        "It may be built.",
        "Part 4711-03, Stress group",
    ]
    order += ["Completed", "Audit: pass", "Mesh: largest stress"]
    assert [one for one in order if one not in head] == []
    assert [head.index(one) for one in order] == sorted(head.index(one) for one in order)
    peaks = [found["error"][key]["value"] for key in ("elsewhere", "von_mises")]
    assert f'class="value"><data value="{peaks[0]!r}"' in head
    assert f"{quantity(peaks[1], 'Pa')} at" in head[head.index('class="small soft"') :]
    assert "Whether the part buckles was not looked at" not in text


@pytest.mark.parametrize(
    ("error", "badge"),
    [
        (None, ("Mesh: error not estimated", "warn")),
        ({"von_mises": {"value": 1.0, "error": 0.05}}, ("Mesh: largest stress ± 5 %", "good")),
        ({"von_mises": {"value": 1.0, "error": 0.2}}, ("Mesh: largest stress ± 20 %", "warn")),
        ({"von_mises": {"value": 1.0, "error": None}}, ("Mesh: largest stress not known", "bad")),
    ],
)
def test_badge_of_the_mesh(error: Any, badge: tuple[str, str]) -> None:
    assert mesh_badge({"error": error}) == badge


def test_no_curves_of_round_off(tmp_path: Path) -> None:
    """Nor of a linear problem, whose one iteration falls to round-off at once."""
    names = "step,t,load_factor,newton,max_displacement,reaction_base_x,reaction_base_z"
    rows = [f"{k},{k},{k / 4},1,{k}e-3,{k}e-14,{k}00" for k in range(5)]
    (tmp_path / "history.csv").write_text("\n".join([names, *rows, ""]), encoding="utf-8")
    (tmp_path / "summary.json").write_text('{"steps": 4}', encoding="utf-8")
    charts = dict(history_charts(FinishedRun(tmp_path)))
    assert list(charts) == ["Largest displacement", "Reaction of base"]
    assert 'class="line line-0"' in charts["Reaction of base"]
    assert "line-1" not in charts["Reaction of base"]
    residuals = {"last": {"step": 1, "residuals": [80.0, 1e-12]}}
    assert residual_chart({"convergence": residuals}) is None
    residuals["last"]["residuals"] = [80.0, 2.0, 1e-2, 1e-7]
    assert residual_chart({"convergence": residuals}) is not None


def test_friction_is_told_beside_the_work(tmp_path: Path) -> None:
    """A block that is pulled 10 mm against 6 N: work on it is 60 mJ less what friction takes."""
    audit = {"verdict": "pass", "external_work": 1.25e-4, "stored_energy": 1.25e-4}
    summary = {"steps": 1, "audit": audit, "numbers": {"friction_dissipation_floor": 0.06}}
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    (line,) = [one for one in audit_of(FinishedRun(tmp_path)).lines if one.startswith("Work")]
    assert line == (
        "Work of all forces on the body, those of springs and contact among them: 125 µJ, after "
        "friction has taken 60 mJ; energy in the body: 125 µJ."
    )


def test_loads_that_do_not_act(tmp_path: Path) -> None:
    """Natural frequencies are those of the unloaded part, unless it is preloaded."""
    case: dict[str, Any] = {"load": [{"kind": "gravity"}], "modal": {"count": 1}}
    for preload in (False, True):
        case["modal"]["preload"] = preload
        text = json.dumps({"case": case})
        (tmp_path / "summary.json").write_text(text, encoding="utf-8")
        assert len(loads_of(FinishedRun(tmp_path))) == preload


def test_no_results(tmp_path: Path) -> None:
    """A folder that is none is refused before anything is written."""
    with pytest.raises(InputError, match=r"summary\.json"):
        write_report(tmp_path, tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def test_without_chromium(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page stays, and the message says what to do."""
    page = tmp_path / "page.html"
    page.write_text("<p>")
    monkeypatch.setattr(pdf, "BROWSERS", ("no-such-browser",))
    with pytest.raises(OutputError, match="there is no Chromium here"):
        _write(page, pdf=True)
    assert "page.html written" in capsys.readouterr().out


@pytest.mark.long
def test_large_surface() -> None:
    """The data of the largest surface with the most steps leave room for the rest of a page."""
    count = MOST_TRIANGLES // 2
    points = np.random.default_rng(0).random((count, 3))
    triangles = np.arange(3 * MOST_TRIANGLES).reshape(-1, 3) % count
    kept = chosen_frames(500, count)
    assert kept[-1] == 499
    values = {"von_mises": points[:, 0] * 1e6, "displacement": points[:, 1]}
    frames = tuple(Frame(f"{k}", points * 0.1, values) for k in kept)
    scene = Scene(points, triangles, triangles[:, :2], frames)
    text = json_text(packed(Viewed(scene), {}))
    assert len(text) < 0.75 * LARGEST


def test_scene_keeps_its_numbers() -> None:
    """What the viewer unpacks is within 16 bits of what was packed; small motion is scaled up."""
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0]])
    u = np.array([[0.0, 0, 0], [0, 0, 1e-4], [0, 0, -3e-5]])
    one = Frame("1", u, {"von_mises": np.array([1e6, 3e6, np.nan])})
    viewed = Viewed(Scene(points, np.array([[0, 1, 2]]), np.array([[0, 1]]), (one,)))
    assert viewed.scale == 1000  # 0.1 of 2
    found = packed(viewed, {})
    (frame,) = found["frames"]  # type: ignore[misc]
    back = np.frombuffer(base64.b64decode(frame["u"]), "<i2").reshape(-1, 3) / 32767 * 1e-4
    assert back == pytest.approx(u, abs=1e-4 / 32767)
    (shown,) = viewed.fields
    assert (shown.low, shown.high, shown.unit) == (0.0, 3e6, "MPa")
    raw = np.frombuffer(base64.b64decode(frame["values"]["von_mises"]), "<u2")
    assert raw[:2] / 65534 == pytest.approx([1 / 3, 1], abs=1e-5)
    assert raw[2] == 65535  # no value


def test_nodes_without_a_value_are_no_zeros() -> None:
    """A material without an allowable stress has no safety factor, and is grey."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    values = {"safety_factor": np.array([np.nan, 2.0, 5.0, 1.0])}
    frame = Frame("end", np.zeros((4, 3)), values)
    triangles = np.array([[0, 1, 2], [1, 3, 2]])
    scene = Scene(points, triangles, triangles[:, :2], (frame,), plane=True)
    data: Any = packed(Viewed(scene), {})
    assert data["fields"][0]["least"]
    raw = np.frombuffer(base64.b64decode(data["frames"][0]["values"]["safety_factor"]), "<u2")
    assert raw[0] == 65535
    assert raw[1:] / 65534 == pytest.approx([0.4, 1.0, 0.2], abs=1e-4)


def test_colours_of_a_run() -> None:
    """Those of the pictures that `run` draws; small safety factors and large stresses bright."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    frame = Frame("", np.zeros((3, 3)), {"von_mises": points[:, 0]})
    data: Any = packed(Viewed(Scene(points, np.array([[0, 1, 2]]), frames=(frame,))), {})
    table = np.frombuffer(base64.b64decode(data["colours"]), np.uint8).reshape(256, 4)
    assert np.array_equal(table, np.rint(255 * colour_map()(np.arange(256))))
    for turned in (False, True):
        red = colour_map(warm_first=turned)(np.array([0, 255]))[:, 0]
        assert red[int(not turned)] > 0.7 > 0.4 > red[int(turned)]


def test_glyphs_stand_where_they_act() -> None:
    """At the nearest nodes, with which they move; those of the whole body in its middle."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    frame = Frame("", np.zeros((3, 3)), {"displacement": points[:, 0]})
    along, tails = np.array([[0.0, 0, 1]]), np.array([True])
    glyphs = Glyphs("load 0", "", True, points[1:2] + 0.1, along, tails)
    every = (glyphs, replace(glyphs, key="load 1", inside=True))
    scene = Scene(points, np.array([[0, 1, 2]]), frames=(frame,), glyphs=every)
    data: Any = packed(Viewed(scene), {"load 0": "red", "load 1": "blue"})
    assert [(one["at"], one["colour"]) for one in data["glyphs"]] == [([1], "red"), ([-1], "blue")]
    again = Glyphs.of(json.loads(json.dumps(glyphs.plain())))
    np.testing.assert_allclose(again.places, glyphs.places, rtol=1e-6)
    assert again.ends(1.0)[0].tolist() == pytest.approx(
        np.array([[1.1, 0.1, 0.1], [1.1, 0.1, 0.21]])
    )


def test_without_pictures_the_viewer_stays(
    folders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no display can be started the page says so."""

    def fail(*_: object) -> None:
        raise DrawingError("cannot draw a picture: no display")

    monkeypatch.setattr(still, "draw_pictures", fail)
    page, _ = page_of(folders("statics"), tmp_path / "page.html")
    assert "There are no fixed pictures: cannot draw a picture: no display." in page.text
    assert not page.all("img")
    assert json.loads(page.inside["script"][0])["frames"]
    check_policy(page)


def test_fixed_pictures_show_obstacles(folders: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are as far from the magnified body as from the body; undeformed, where they began."""
    drawn: list[Picture] = []

    def draw(_user: object, pictures: list[Picture], file: Path) -> None:
        drawn.extend(pictures)
        file.touch()

    monkeypatch.setattr(still, "draw_pictures", draw)
    run = FinishedRun(folders("statics"))
    floor = {"on": "bottom", "plane": {"axis": "z", "at": -1}, "motion": [0, 0, "0.5*t"]}
    run.case = {**run.case, "contact": [floor]}
    viewed = scene_of(run, drawn_frames(run))
    assert viewed is not None
    assert viewed.scale > 1
    still.stills(viewed, _palette(viewed))
    lowest = (viewed.scene.points + viewed.frame.u)[:, 2].min()
    data: Any = packed(viewed, _palette(viewed))
    (seen,) = data["obstacles"]
    z = np.frombuffer(base64.b64decode(seen["points"]), "<f4").reshape(-1, 3)[:, 2].max()
    for frame, (shift, near) in zip(viewed.scene.frames, seen["ways"], strict=True):
        for scale in (0.0, 1.0, viewed.scale):
            least = (viewed.scene.points + scale * frame.u)[:, 2].min()
            away = least - (z + shift[2] + (scale - 1) * near[2])
            gap = (viewed.scene.points + frame.u)[:, 2].min() - (shift[2] - 1)
            assert away == pytest.approx(gap, abs=1e-6)
    for picture in drawn:
        (one,) = picture.scene.obstacles
        away = picture.moved[:, 2].min() - (one.points + one.shift)[:, 2].max()
        assert away == pytest.approx(1.0 if picture is drawn[-1] else lowest + 0.5)


def test_fields_that_are_offered() -> None:
    """What a reader wants first, then what the run has written; nothing that is everywhere the
    same; the von Mises stress and the safety factor also where they only follow."""
    pv = pytest.importorskip("pyvista")
    cells = np.array([[4, 0, 1, 2, 3]])
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    grid = pv.UnstructuredGrid(cells.ravel(), [pv.CellType.TETRA], points)
    tension = np.zeros((4, 9))
    tension[:, 0] = [1e6, 2e6, 3e6, 4e6]
    grid.point_data["cauchy_stress"] = tension
    grid.point_data["displacement"] = points * 1e-3
    grid.point_data["max_principal_stress"] = tension[:, 0]
    grid.cell_data["jacobian"] = np.array([1.0])  # everywhere the same
    grid.point_data["of_body"] = np.arange(4.0)
    grid.point_data["normal"] = points  # a direction has no size
    values = node_values(grid, 8e6)
    np.testing.assert_allclose(values["von_mises"], tension[:, 0], rtol=1e-12)
    np.testing.assert_allclose(values["safety_factor"], [8, 4, 8 / 3, 2], rtol=1e-12)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    frame = Frame("", 0 * points, values)
    scene = Viewed(Scene(points, triangles, triangles[:, :2], (frame,)))
    assert [shown.name for shown in scene.fields] == [
        *("von_mises", "displacement", "safety_factor"),
        *("cauchy_stress", "max_principal_stress", "of_body"),
    ]
    assert [shown.title for shown in scene.fields][-3:] == [
        "Cauchy stress (norm)",
        "max principal stress",
        "of body",
    ]
    assert scene.left_out == ()
    assert "safety_factor" not in node_values(grid)


def test_fields_without_room_are_named() -> None:
    """A page of a large body offers the first fields only, and says which it lacks."""
    count = MOST_TRIANGLES // 2
    points = np.random.default_rng(0).random((count, 3))
    triangles = np.arange(3 * MOST_TRIANGLES).reshape(-1, 3) % count
    names = ["tresca", "pressure", "jacobian", "von_mises", "displacement"]
    values = {name: points[:, 0] * (1 + k) for k, name in enumerate(names)}
    frames = tuple(Frame(f"{k}", points * 0.1, values) for k in chosen_frames(500, count))
    scene = Viewed(Scene(points, triangles, triangles[:, :2], frames))
    assert [shown.name for shown in scene.fields] == ["von_mises", "displacement"]
    assert scene.left_out == ("tresca", "pressure", "det F")
    text = json_text(packed(scene, {}))
    assert len(text) < 0.75 * LARGEST
    one = Viewed(Scene(points, triangles, triangles[:, :2], frames[:1]))
    assert len(one.fields) == 5  # there is room with one state


def test_a_large_body_leaves_less_room_for_pictures_of_the_run(tmp_path: Path) -> None:
    """They are what a page does without: it stays below the size that can be mailed."""
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(1_000_000))
    small = {"scene": None, "stills": [], "held": ""}
    assert _room(small) == 1_500_000
    assert [name for name, _ in _own_pictures(tmp_path, _room(small))] == ["a.png"]
    large = {"scene": "x" * 6_900_000, "stills": [("", "y" * 300_000)], "held": "z" * 200_000}
    # 10 MB less 1.5 MB of the rest, 6.9, twice 0.3 and 0.2 MB leave 0.8 MB of text.
    assert _room(large) == pytest.approx(600_000, abs=10)
    assert list(_own_pictures(tmp_path, _room(large))) == []
    assert _room({**large, "scene": "x" * 9_000_000}) == 0


def test_values_of_a_single_step(tmp_path: Path) -> None:
    """Probes, moments and a cavity's volume are told where there are no curves, with units."""
    names = "step,t,load_factor,newton,max_displacement,strain_energy,reaction_base_z"
    names += ",tip_x,tip_y,tip_z,moment_base_bolt_1_x,moment_base_bolt_1_y,moment_base_bolt_1_z"
    names += ",end_von_mises,volume_room,pressure_room"
    row = "1,1,1,2,1e-3,3,100,0,1e-20,-2e-3,0,1500,0,3e6,2e-6,5e3"
    start = ",".join("0" for _ in names.split(","))
    (tmp_path / "history.csv").write_text("\n".join([names, start, row, ""]), encoding="utf-8")
    case = {"output": {"probes": {"tip": [1, 0, 0]}}}
    (tmp_path / "summary.json").write_text(json.dumps({"steps": 1, "case": case}), encoding="utf-8")
    run = FinishedRun(tmp_path)
    assert history_charts(run) == []
    found = {
        name: [(part, value.text) for part, value in values] for name, values in last_values(run)
    }
    assert found == {
        "Tip: displacement": [("x", "0 mm"), ("y", "0 mm"), ("z", "−2 mm")],
        "Moment base bolt 1": [("x", "0 kN m"), ("y", "1.5 kN m"), ("z", "0 kN m")],
        "End von mises": [("", "3 MPa")],
        "Volume room": [("", "2 cm³")],
        "Pressure room": [("", "5 kPa")],
    }


def test_constants_have_units() -> None:
    """Those in which the law reads bare numbers, of lists and of any law."""
    heart = {"law": "guccione", "C": 2000.0, "bf": 8.0, "K": 2e5, "density": 1060.0}
    rubber = {"law": "ogden", "mu": [6e5, -1e4], "alpha": [1.3, -2.0], "nu": 0.4}
    varied = {"law": "linear-elastic", "E": {"field": "E_cell"}, "nu": 0.3, "viscosity": 5.0}
    own = {"energy": "C*(I1 - 3)", "parameters": {"C": 2000.0, "b": "3 MPa"}, "K": 1e6}
    assert dict(_constants(heart, "guccione")) == {
        **{"C": "2 kPa", "bf": "8", "K": "200 kPa", "density": "1060 kg/m³"}
    }
    assert dict(_constants(rubber, "ogden")) == {
        **{"mu": "(600, −10) kPa", "alpha": "(1.3, −2)", "nu": "0.4"}
    }
    assert dict(_constants(varied, "linear-elastic")) == {
        **{"E": "field E_cell [Pa]", "nu": "0.3", "viscosity": "5 Pa s"}
    }
    assert dict(_constants(own, "energy"))["parameters"] == (
        "C 2000, b 3 MPa (bare numbers: SI units)"
    )
    assert dict(_constants(own, "energy"))["K"] == "1 MPa"


BALANCED: dict[str, dict[str, Any]] = {
    "solid": {},
    "failed": {"status": "failed"},
    "ring": {"mesh": {"geometry": "axisymmetric"}},
    "tied": {"tie": [{"on": "a", "to": "b"}]},
    "plate": {"support": [{"on": "end", "kind": "rigid", "force": [-5, 0]}]},
}


@pytest.mark.parametrize("kind", BALANCED)
def test_loads_against_reactions(kind: str, tmp_path: Path) -> None:
    """What need not balance is not shown as if it should."""
    given = BALANCED[kind]
    summary = {
        "status": given.get("status", "completed"),
        "steps": 2,
        "case": {"load": [{"on": "top"}], **given},
        "model": {"loads": [{"load": "load[0] (traction)", "force": [5.0, -3.0]}]},
        "reactions": {"left": [0.0 if kind == "ring" else -5.0, 3.0]},
    }
    if kind == "plate":  # its reaction holds what acts on it
        summary["model"]["loads"] += [
            {"load": "support[0] (rigid)", "force": [-5.0, 0.0]},
            {"load": "all loads", "force": [0.0, -3.0]},
        ]
        summary["reactions"] |= {"left": [0.0, 3.0], "end": [-5.0, 0.0]}
    if kind == "tied":
        summary["reactions"] |= {"tie_a": [7.0, 7.0]}
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    found = balance_of(FinishedRun(tmp_path))
    assert found is not None
    rows = dict(found.rows)
    if kind == "failed":
        assert list(rows) == [
            "all loads at their full values, on the undeformed body",
            "all reactions",
        ]
    elif kind == "ring":
        assert rows["loads and reactions together, along the axis"] == "(0) N"
    else:
        assert rows["loads and reactions together"] == "(0, 0) N"
    if kind == "plate":  # as `check` sums them up
        assert rows["all loads, on the undeformed body"] == "(0, −3) N"
        assert rows["of these on rigid plates, part of their reactions"] == "(−5, 0) N"


def test_moments_of_supports(tmp_path: Path) -> None:
    """With their point; what is round-off beside the largest force times the body's length is 0."""
    moments = {
        "left": {"moment": [1e-13, -900.0, 0.0], "about": [0.0, 0.1, 0.05]},
        "ball": {"moment": [1e-13, 0.0, 1e-13], "about": [1.0, 0.1, 0.1]},
    }
    summary = {
        "case": {
            "support": [{"on": "left"}],
            "contact": [{"on": "top", "name": "ball", "plane": {"axis": "z", "at": 1}}],
        },
        "model": {"mesh": {"extent": [1.0, 0.2, 0.1]}},
        "reactions": {"left": [0, 0, 1e3], "ball": [0, 0, -1e3]},
        "moments": moments,
    }
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    assert [row.moment for row in supports_of(FinishedRun(tmp_path))] == [
        "(0, −900, 0) N m about (0, 100, 50) mm",
        "(0, 0, 0) kN m about (1, 0.1, 0.1) m",
    ]


def test_the_command_can_be_typed(tmp_path: Path) -> None:
    """Names with blanks, options with values, and what `converge` was asked for."""
    model = {"file": "my case.toml", "petsc": {"log_view": ":a b.txt", "ksp_view": None}}
    summary = {"ranks": "2; rm x", "model": model}
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    with pytest.raises(InputError, match="ranks: this is a text; expected a number"):
        FinishedRun(tmp_path)
    summary["ranks"] = 1
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    text = "dolfin-elastic run 'my case.toml' -- -log_view ':a b.txt' -ksp_view"
    assert _command(FinishedRun(tmp_path)) == text
    goal = {"quantity": "von_mises on fillet", "tolerance": 0.03}
    (tmp_path / "converge.json").write_text(json.dumps(goal), encoding="utf-8")
    (tmp_path / "summary.json").write_text(json.dumps({"ranks": 2}), encoding="utf-8")
    assert _command(FinishedRun(tmp_path)) == (
        "mpirun -n 2 dolfin-elastic converge case.toml --until 'von_mises on fillet' 3%"
    )


def said(key: str, table: dict[str, Any], **setting: Any) -> str:
    """What one table says."""
    (row,) = described_tables({key: [table]}, Setting(**setting))
    return row.text


def test_words() -> None:
    """Supports and loads as an engineer would say them, with the units that were written."""
    assert said("support", {"on": "a"}) == "fixed: no displacement"
    assert said("support", {"on": "a", "displacement": [0, "free", "2 mm"]}) == (
        "moved along z by 2 mm; no displacement along x; free along y"
    )
    spring = {"on": "a", "kind": "spring", "stiffness": [0, 0, 5]}
    assert said("support", spring) == "on springs: stiffness (0, 0, 5) N/m³"
    assert said("load", {"kind": "force", "on": "a", "value": [0, 0, "-2 kN"]}) == (
        "total force of (0, 0, −2 kN), spread evenly"
    )
    pressure = {"on": "a", "kind": "pressure", "value": 2e5}
    assert said("load", {**pressure, "curve": "ramp"}) == (
        "pressure of 200 kPa, which follows the deformed surface; curve ramp"
    )
    assert said("load", pressure, linear=True) == "pressure of 200 kPa"
    linear, rubber = {"law": "linear-elastic"}, {"law": "neo-hookean"}
    assert small_strains({"materials": {"a": linear, "b": {"law": "orthotropic"}}})
    for others in ({"b": rubber}, {"b": {"energy": "I1"}}, {"b": {"law": "no law"}}):
        assert not small_strains({"materials": {"a": linear, **others}})
    assert not small_strains({})
    assert said("load", {"kind": "gravity"}) == (
        "weight, with the acceleration of gravity 9.81 m/s² against the last axis"
    )
    assert "(0, −5) m/s²" in said("load", {"kind": "gravity", "value": [0, -5]})
    varying = {"kind": "body-force", "value": [0, 2, "5*x"]}
    assert said("load", varying) == "force per volume of (0, 2, 5*x) N/m³"
    cavity = {"kind": "cavity", "on": "a", "pressure": "1 kPa"}
    assert said("load", cavity) == "closed cavity with pressure 1 kPa"
    for kind, unit in (("edge", "N/m²"), ("point", "N/m")):
        text = said("support", spring, kinds={"a": kind})
        assert text == f"on springs: stiffness (0, 0, 5) {unit}"
    edge = {"kind": "line-force", "on": "a", "value": [0, 0, 5]}
    assert said("load", edge) == "force of (0, 0, 5) N/m along a line"
    assert said("support", {"on": "a", "kind": "fixed"}) == "fixed: no displacement"
    ball = {"on": "a", "sphere": {"center": [0, 0, 0.5], "radius": 0.02}, "motion": [0, 0, -0.1]}
    assert said("contact", ball) == (
        "may touch a rigid sphere (center (0, 0, 500) mm, radius 20 mm); motion (0, 0, −100) mm"
    )
    assert "center (0, 0, 500) µm, radius 20 µm" in said("contact", ball, metres=1e-3)
    tie = {"on": "a", "to": ["b", "c"], "tolerance": "1 mm"}
    assert said("tie", tie) == "moves with b and c; tolerance 1 mm"


def test_tables_that_cannot_be_read() -> None:
    """A stranger's have their kind, or the name of their list."""
    rows = [{"kind": "no kind", "on": 3}, {"on": ["a", "b"], "name": "n"}, "no table"]
    found = described_tables({"load": rows, "support": {"on": "a"}}, Setting())
    assert [(row.key, row.label, row.on, row.text) for row in found] == [
        ("load[0]", "3", ("3",), "no kind"),
        ("load[1]", "n", ("a", "b"), "load"),
        ("load[2]", "", (), "load"),
    ]


def test_chart_keeps_extremes() -> None:
    """A long curve is thinned out, but its only peak is still there."""
    y = np.zeros(100_000)
    y[54_321] = 7.0
    text = line_chart([Line("<b>", np.arange(100_000.0), y)], Axis("t"), Axis("u"), title="<i>")
    assert len(text) < 20_000
    assert "<b>" not in text
    assert "<i>" not in text
    (path,) = re.findall(r'class="line line-0" d="(M[^"]*L[^"]*)"', text)
    heights = [float(point.split(" ")[1]) for point in path[1:].split("L")]
    # 7 between the ticks 0 at 232 and 8 at 34, above which the legend stands
    assert math.isclose(min(heights), 232 - (232 - 34) * 7 / 8, abs_tol=0.06)
    assert heights.count(min(heights)) == 1


@pytest.mark.long
def test_older_run(folders: Any, tmp_path: Path) -> None:
    """A folder without what runs note today gives a page that leaves it out."""
    folder = folders("statics")
    known = (folder / "summary.json").read_text(encoding="utf-8")
    found = json.loads(known)
    for key in ("case", "model", "convergence", "finished"):  # the last of one that was killed
        del found[key]
    try:
        (folder / "summary.json").write_text(json.dumps(found), encoding="utf-8")
        write_report(folder, tmp_path / "page.html")
    finally:
        (folder / "summary.json").write_text(known, encoding="utf-8")
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert [head for head in page.heads if head != "History"] == SECTIONS
    assert FinishedRun(folder).summary["model"]["parts"]["left"]["area"] == pytest.approx(1.0)


def test_pictures_that_are_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A pipe was waited for, /dev/zero filled the memory, a link shows bytes from elsewhere."""
    os.mkfifo(tmp_path / "a.png")
    (tmp_path / "b.png").symlink_to("/dev/zero")
    (tmp_path / "secret").write_bytes(b"\x89PNG\r\n\x1a\n" + b"secret")
    (tmp_path / "c.png").symlink_to(tmp_path / "secret")
    (tmp_path / "d.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert [name for name, _ in _own_pictures(tmp_path, 1000)] == ["d.png"]
    kinds = {"a": "a pipe", "b": "a link", "c": "a link"}
    for name, kind in kinds.items():
        assert f"{name}.png is left out: this is {kind}, not a file" in caplog.text


def test_singular_peaks_and_the_allowable_stress_are_marked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Colours end at the value to judge by, in the viewer, whose numbers go on, and on paper."""
    drawn: list[Picture] = []

    def draw(_user: object, pictures: list[Picture], file: Path) -> None:
        drawn.extend(pictures)
        file.touch()

    monkeypatch.setattr(still, "draw_pictures", draw)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    frame = Frame("", np.zeros((3, 3)), {"von_mises": np.array([4e6, 1e6, 2e6])})
    scene = Scene(points, np.array([[0, 1, 2]]), frames=(frame,))
    known = Reliable(2e6, points[2], "± 5 %")
    viewed = Viewed(scene, allowable=1.5e6, reliable={"von_mises": known})
    (shown,), (row,) = viewed.fields, packed(viewed, {})["fields"]  # type: ignore[misc]
    assert (shown.high, shown.most, shown.limit) == (2e6, 4e6, 1.5e6)
    assert row["judge"] == {"at": 2, "text": "2 MPa ± 5 %"}
    nowhere = replace(viewed, reliable={"von_mises": Reliable(math.nan, points[2])})
    assert nowhere.fields[0].high == 4e6
    assert packed(nowhere, {})["fields"][0]["judge"] == {"at": -1, "text": ""}  # type: ignore[index]
    still.stills(viewed, {})
    assert [mark.text for mark in drawn[0].marks] == ["max 4 MPa: singular", "2 MPa ± 5 %"]
    assert drawn[0].bar is not None
    assert drawn[0].bar.ticks[-1] == 2
    assert drawn[0].bar.limit == 1.5
