"""The documentation is built without a warning, and can be searched without a network."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from click.exceptions import ClickException
from conftest import ROOT
from mpi4py import MPI

from dolfin_elastic.cli.app import app
from dolfin_elastic.core.errors import Diagnosis

sys.path.append(str(ROOT / "docs/_ext"))

import messages
import said

MAIN = '<div class="main">'
"""Where the sidebar of a page ends."""
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs one process")


@pytest.mark.long
def test_site(tmp_path: Path) -> None:
    """All pages are there; nothing in them comes from elsewhere."""
    done = subprocess.run(
        [ROOT / "docs/build", tmp_path], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "arruda" in (tmp_path / "searchindex.js").read_text()
    pages = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.html")}
    made = {"reference/case.html", "reference/messages.html", "reference/commands.html"}
    assert {"index.html", "search.html", "guide/mesh.html", "laws/yeoh.html", *made} <= pages
    for page in pages:
        text = (tmp_path / page).read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="https?:', text), page
    keys = (tmp_path / "reference/case.html").read_text(encoding="utf-8")
    assert "Mass per reference volume" in keys
    assert not re.findall(r">(?:None: |`?[A-Z][a-z]+[A-Z]\w+(?:Settings|Table|Selector))", keys)
    sidebar = (tmp_path / "index.html").read_text(encoding="utf-8").partition("sidebar-tree")[2]
    links = re.findall(
        r'<a class="reference internal" href="([\w/.-]+)">', sidebar.partition(MAIN)[0]
    )
    assert len(links) > 50
    assert [one for one, times in Counter(links).items() if times > 1] == []
    page = (tmp_path / "reference/messages/free-body.html").read_text(encoding="utf-8")
    assert "the supports leave the body free" in page
    assert "What to do" in page


def test_every_message_has_its_meaning() -> None:
    """A new message cannot be forgotten, nor a page outlive its message."""
    known, pages = said.messages(), messages.pages()
    assert len(known) > 500
    written = Counter(text for page in pages for text in page.messages)
    missing = sorted({one.text for one in known} - set(written))
    assert not missing, (
        "these messages have no meaning: into docs/reference/meanings/*.toml write a table with "
        "messages = [...], means = what is checked and why the program cannot go on, do = what "
        f"to do, guide = the page to read on; or add them to the table of alike ones: {missing}"
    )
    gone = messages.unknown(known)
    assert not gone, f"docs/reference/meanings has messages that the program does not say: {gone}"
    assert [text for text, times in written.items() if times > 1] == []
    advised = {one.text for one in known if len(one.advice) > 1}
    for page in pages:
        assert re.fullmatch(r"[a-z0-9-]+", page.name), page.name
        assert page.means.endswith("."), page.name
        assert page.do or advised & set(page.messages), f"{page.name}: say what to do"
        assert (ROOT / f"docs/{page.guide}.md").is_file(), f"{page.name}: {page.guide}"
    causes = re.findall(r'"([\w-]+)"', str(Diagnosis.__doc__).partition("text:")[0])
    assert {page.cause for page in pages if page.cause} == set(causes)


def test_scripts_of_pictures_find_what_they_import() -> None:
    """They are run by hand, when pictures are drawn anew: until then nobody sees a name go."""
    for script in (ROOT / "docs").glob("*_picture.py"):
        for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("dolfin_elastic"):
                module = importlib.import_module(str(node.module))
                assert all(hasattr(module, one.name) for one in node.names), script.name


@pytest.mark.parametrize(
    "words",
    [
        "run",
        "converge beam.toml",
        "run beam.toml --colour",
        "info more",
        "check a.toml b.toml c.toml",
        "plot results --step",
        "plot results --step two",
        "plot results --scale large",
        "plot results --list=yes",
        "converge beam.toml --until tip",
        "rnu beam.toml",
    ],
)
def test_usage_errors_have_their_meaning(words: str) -> None:
    """What click says of a command line is one of the messages, whatever its version says."""
    with pytest.raises(ClickException) as caught:
        app(words.split(), prog_name="dolfin-elastic", standalone_mode=False)
    said_now = caught.value.format_message()
    pages = [page for page in messages.pages() if page.name.startswith("usage-")]
    texts = [text.split(said.HOLE) for page in pages for text in page.messages]
    patterns = [".*".join(map(re.escape, pieces)) for pieces in texts]
    fits = [one for one in patterns if re.match(one, said_now)]
    assert fits and caught.value.exit_code == 2, said_now


def test_notes_are_found() -> None:
    """Notes of `check` wherever they are made: yielded, returned, appended or given a name."""
    found = {one.text: one.code for one in said.messages()}
    for start in (
        "the body is … m long, and no mesh.unit is given",
        "linear elements bend too stiffly",
        "linear elements lock at nu = …",
        "the file says that its lengths are in …",
        "… of … elements are very thin",
    ):
        assert [code for text, code in found.items() if text.startswith(start)] == ["0"], start
