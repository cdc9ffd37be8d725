"""Texts reach the terminal as text; nothing of the current folder is imported."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.processes import PROGRAM, clean_environment, cli

from dolfin_elastic.cli.pipes import printable
from dolfin_elastic.cli.terminal import Screen

pytestmark = pytest.mark.usefixtures("serial_only")

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\x08\x7f\u202egnp\u2066\u200f\r[red]x[/red]"
COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\u200e\u200f]")

CASE = f"""title = {json.dumps("A block " + EVIL + chr(10) + "second line")}
[mesh]
box = {{size = [1, 1, 1], cells = [1, 1, 1]}}
[surfaces]
{json.dumps("face" + EVIL)} = {{plane = "x", at = "max"}}
[materials.{json.dumps("steel" + EVIL)}]
law = "linear-elastic"
E = 1e6
nu = 0.3
density = 1000
[[support]]
on = "left"
name = {json.dumps("wall" + EVIL)}
[[load]]
kind = "traction"
on = {json.dumps("face" + EVIL)}
value = [1, 0, 0]
"""


def test_every_control_character_is_escaped() -> None:
    """C0 but tab and line feed, DEL, C1, and what turns the direction of text."""
    every = "".join(map(chr, range(0x20000)))
    left = set(printable(every)) & {chr(n) for n in (*range(32), *range(127, 160))}
    assert left == {"\n", "\t"}
    assert not COMMANDS.search(printable(every))
    assert printable("Größe µm ° “x” 中文 [bold]") == "Größe µm ° “x” 中文 [bold]"
    assert json.loads(printable(json.dumps([EVIL], ensure_ascii=False))) == [EVIL]


def test_markup_is_text() -> None:
    out = io.StringIO()
    Screen(out, 100, None).print("[red]x[/red] [link=http://x]y[/link] :smile: \x1b[1m")
    assert out.getvalue() == "[red]x[/red] [link=http://x]y[/link] :smile: \\u001b[1m\n"


def test_long_lines_break_between_words() -> None:
    """On a narrow terminal; a path stays whole. Files keep the line."""
    text = "warning: a long line about /a/rather/long/path/of/a/file.toml and more"
    broken = "warning: a long line\n    about\n    /a/rather/long/path/of/a/file.toml\n    and more"
    for terminal, shown in ((True, broken), (False, text)):
        out = io.StringIO()
        Screen(out, 24, terminal).tell(text)
        assert out.getvalue() == f"{shown}\n"


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "words", [["check"], ["check", "--json"], ["run", "--quiet"], ["run"]], ids=" ".join
)
def test_commands(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "case.toml").write_text(CASE)
    code, out, err = cli(words[0], "case.toml", *words[1:], folder=tmp_path)
    assert code == 0, out + err
    assert not COMMANDS.search(out + err)
    if words == ["check"]:
        assert "A block \\u001b]0;owned" in out
        assert "[red]x[/red] second line" in out
    if "--json" in words:
        assert EVIL in json.loads(out)["title"]


def test_errors(tmp_path: Path) -> None:
    (tmp_path / "case.toml").write_text(CASE.replace("[1, 0, 0]", json.dumps(EVIL)))
    code, out, err = cli("check", "case.toml", folder=tmp_path)
    assert code == 2, out + err
    assert "\\u001b" in err
    assert not COMMANDS.search(out + err)


def test_on_a_terminal(tmp_path: Path) -> None:
    """There rich moves and colours by itself; what the case says does neither."""
    (tmp_path / "case.toml").write_text(CASE)
    parent, child = pty.openpty()
    process = subprocess.Popen(
        [*PROGRAM, "check", "case.toml"],
        cwd=tmp_path,
        env={**clean_environment(), "TERM": "xterm-256color"},
        stdout=child,
        stderr=child,
        stdin=subprocess.DEVNULL,
    )
    os.close(child)
    seen = b""
    while True:
        try:
            part = os.read(parent, 65536)
        except OSError:  # the other end is closed
            break
        seen += part
    os.close(parent)
    assert process.wait() == 0
    text = seen.decode()
    assert "\x1b[1m" in text  # bold is the program's own
    left = COMMANDS.sub("", re.sub(r"\x1b\[[0-9;]*m|\r\n", "", text))
    assert left == re.sub(r"\x1b\[[0-9;]*m|\r\n", "", text)
    assert "\x1b[2J" not in text


SHADOWS = ("numpy", "random", "platform", "typer", "rich", "pydantic", "dolfinx", "gmsh", "h5py")


@pytest.mark.long
@pytest.mark.parametrize(
    "program",
    [PROGRAM, ["dolfin-elastic"], [sys.executable, "-P", "-m", "dolfin_elastic"]],
    ids=["-m", "command", "-P -m"],
)
def test_modules_of_the_current_folder(tmp_path: Path, program: list[str]) -> None:
    """They were imported, and with them whatever a stranger had put beside his case."""
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(f"open('trace-{name}', 'w')\nraise SystemExit(77)\n")
    (tmp_path / "part.geo").write_text('SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n')
    text = CASE.replace("box = {size = [1, 1, 1], cells = [1, 1, 1]}", 'file = "part.geo"')
    (tmp_path / "case.toml").write_text(
        text.replace('on = "left"', 'on = "foot"').replace(
            "[surfaces]", '[surfaces]\nfoot = {plane = "x", at = "min"}'
        )
    )
    ended = subprocess.run(
        [*program, "check", "case.toml"],
        cwd=tmp_path,
        env=clean_environment(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert not list(tmp_path.glob("trace*"))
