"""Names in a folder of results that stand for something elsewhere, and files opened as they are."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dolfin_elastic import read_case, run
from dolfin_elastic.cli.app import guarded
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.files.links import refuse_links
from dolfin_elastic.core.files.regular import fresh, irregular, open_regular, read_regular
from dolfin_elastic.results.files import replace_text

pytestmark = pytest.mark.usefixtures("serial_only")

CASE = """\
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
[surfaces]
left = {plane = "x", at = "min"}
right = {plane = "x", at = "max"}
[materials.a]
law = "linear-elastic"
E = 1e9
nu = 0.3
[[support]]
on = "left"
displacement = [0, 0, 0]
[[load]]
kind = "traction"
on = "right"
value = [1e3, 0, 0]
[statics]
[[output.pictures]]
file = "side.png"
[[output.pictures]]
file = "below/top.mp4"
"""
NAMES = [
    "history.csv",
    "summary.json",
    ".summary.json.part",
    "results.xdmf",
    ".results.xdmf.part",
    "results_data",
    "results_data/mesh.h5",
    "results_data/000000.h5",
    "results.vtkhdf",
    "results_vtu",
    ".lock",
    "checkpoints",
    "checkpoints/.part.h5",
    "checkpoints/case.toml",
    "checkpoints/.case.toml.part",
    "checkpoints/step_000001.json",
    "failed_state.xdmf",
    "modes.csv",
    "mode_01.xdmf",
    "side.png",
    ".side.png.part",
    "side_0001.png",
    ".side_frames",
    "below",
    "below/top.mp4",
    "below/.top.part.mp4",
    "report.html",
    ".plot_von_mises.png.part",
    "converge.csv",
]
KINDS: dict[str, Callable[[Path, Path], None]] = {
    "a link": lambda path, to: path.symlink_to(to),
    "a pipe": lambda path, to: os.mkfifo(path),
}


def plant(path: Path, kind: str, to: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    KINDS[kind](path, to)


def listing(folder: Path) -> dict[str, float]:
    return {str(p): p.lstat().st_mtime for p in folder.rglob("*")}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_refused_before_anything_is_touched(tmp_path: Path, name: str, kind: str) -> None:
    """A link was written through: ``history.csv -> ~/.bashrc``; a pipe was waited for."""
    (tmp_path / "case.toml").write_text(CASE)
    victim, results = tmp_path / "victim", tmp_path / "case_results"
    victim.write_text("mine")
    plant(results / name, kind, victim)
    before = listing(tmp_path)
    with pytest.raises(InputError, match=f"'{name}' in it is {kind}: results are written") as error:
        list(run(read_case(tmp_path / "case.toml"), output=results))
    assert error.value.exit_code == 2
    assert victim.read_text() == "mine" and listing(tmp_path) == before


@pytest.mark.parametrize("verb", ["run", "converge", "restart", "report", "plot"])
def test_commands(
    tmp_path: Path, verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One message and code 2 each time."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE)
    folder = tmp_path / ("case_converged" if verb == "converge" else "case_results")
    folder.mkdir()
    (folder / "history.csv").symlink_to(tmp_path / "victim")
    words = {
        "run": ["case.toml"],
        "converge": ["case.toml", "--until", "strain_energy", "5%"],
    }.get(verb, ["case_results"])
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", verb, *words])
    assert guarded() == 2
    assert "'history.csv' in it is a link" in capsys.readouterr().err
    assert not (tmp_path / "victim").exists()


def test_what_is_let_alone(tmp_path: Path) -> None:
    """The folder itself may be a link, and names that are not ours may be."""
    (tmp_path / "disk").mkdir()
    folder = tmp_path / "results"
    folder.symlink_to(tmp_path / "disk")
    for name in ("mesh.msh", "notes.txt", "resultsold", "model.png"):
        (folder / name).symlink_to("/dev/null")
    (folder / "results_data").mkdir()
    refuse_links(folder, ["side.png"])
    refuse_links(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"'model.png' in it is a link"):
        refuse_links(folder, ["model.png"])
    (folder / "summary.json").symlink_to("/dev/null")
    with pytest.raises(InputError, match=r"'summary.json' in it is a link"):
        refuse_links(folder)


def test_drafts_are_our_own(tmp_path: Path) -> None:
    """What a name stood for before is left as it was."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    for name in (".a.csv.part", "a.csv"):
        (tmp_path / name).symlink_to(victim)
    replace_text(tmp_path / "a.csv", "new")
    assert victim.read_text() == "mine" and (tmp_path / "a.csv").read_text() == "new"
    assert not irregular(tmp_path / "a.csv")


def test_files_are_opened_as_they_are(tmp_path: Path) -> None:
    plain, link, pipe = (tmp_path / name for name in ("plain", "link", "pipe"))
    plain.write_bytes(b"12345")
    link.symlink_to(plain)
    os.mkfifo(pipe)
    assert [irregular(p) for p in (plain, link, pipe, tmp_path, Path("/dev/null"))] == [
        "",
        "a link",
        "a pipe",
        "",
        "a device",
    ]
    for path, kind in ((link, "a link"), (pipe, "a pipe"), (Path("/dev/zero"), "a device")):
        for flags in (os.O_RDONLY, os.O_RDWR, os.O_WRONLY | os.O_CREAT):
            with pytest.raises(OSError, match=f"this is {kind}, not a file"):
                open_regular(path, flags)
    with pytest.raises(OSError, match="folder|directory"):
        open_regular(tmp_path, os.O_RDONLY)
    assert read_regular(plain, 5) == b"12345"
    with pytest.raises(OSError, match="it has 5 bytes, more than 4"):
        read_regular(plain, 4)
    fresh(link)
    assert plain.read_bytes() == b"12345" and link.read_bytes() == b""


@pytest.mark.parametrize("file", ["/tmp/a.png", "../a.png", "a/../../b.png", "a\n.png"])
def test_pictures_stay_in_their_folder(tmp_path: Path, file: str) -> None:
    (tmp_path / "case.toml").write_text(CASE.replace('"side.png"', f"'''{file}'''"))
    with pytest.raises(InputError, match="lies outside the folder|is no name of a file"):
        read_case(tmp_path / "case.toml")
