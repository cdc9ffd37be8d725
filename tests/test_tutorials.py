"""Tasks do what they say: their files are written and their commands run, in this order.

Tutorials run as notebooks, in `notebook/test_notebooks.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from conftest import ROOT
from helpers.processes import clean_environment
from mpi4py import MPI

sys.path.append(str(ROOT / "docs/_ext"))

from tutorials import BLOCK, commands, drawn, perform, pictures

TUTORIALS, TASKS = (
    sorted((ROOT / "docs" / folder).glob("*.md")) for folder in ("tutorials", "howto")
)
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs programs of its own")


@pytest.mark.long
@pytest.mark.parametrize("page", TASKS, ids=lambda page: page.stem)
def test_page(page: Path, tmp_path: Path) -> None:
    """Every command ends with code 0."""
    for ran in perform(page, tmp_path, clean_environment()):
        assert ran.code == 0, f"{ran.command}\n{ran.printed}\n{ran.errors}"
    for name in pictures(page):
        assert drawn(name, tmp_path), name


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_shows_what_it_does(page: Path) -> None:
    """The output of commands, and a picture that they draw."""
    if page.stem == "index":
        return
    blocks = [
        text for _, language, text in BLOCK.findall(page.read_text()) if language == "console"
    ]
    assert any(output for text in blocks for _, output in commands(text))
    assert pictures(page)
    assert all((page.parent / name).is_file() for name in pictures(page))


def test_every_page_is_listed() -> None:
    """In the index, by its link."""
    for page in [*TUTORIALS, *TASKS]:
        if page.stem != "index":
            assert f"({page.name})" in (page.parent / "index.md").read_text(encoding="utf-8")
