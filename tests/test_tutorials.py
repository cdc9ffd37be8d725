"""The tutorials do what they say: their files are written and their commands run, in this order."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import ROOT
from helpers.processes import clean_environment
from mpi4py import MPI

PAGES = [
    path
    for folder in ("tutorials", "howto")
    for path in sorted((ROOT / "docs" / folder).glob("*.md"))
]
BLOCK = re.compile(r"(?:^`([\w./]+)`:\n\n)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs programs of its own")


def commands(text: str) -> Iterator[str]:
    """Commands of a block, of one line or more."""
    return (part.strip() for part in re.split(r"^\$ ", text, flags=re.MULTILINE) if part.strip())


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page(page: Path, tmp_path: Path) -> None:
    """Every command ends with code 0."""
    path = f"{ROOT / 'docker/bin'}{os.pathsep}{os.environ['PATH']}"
    variables = {"PATH": path, "PYTHONPATH": str(ROOT), "REPOSITORY": str(ROOT)}
    for name, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
        for command in commands(text) if language == "console" else ():
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=tmp_path,
                env={**clean_environment(), **variables},
                capture_output=True,
                text=True,
                timeout=240,
                check=False,
            )
            assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"


def test_every_tutorial_is_listed() -> None:
    """In the index, by its link."""
    for folder in {page.parent for page in PAGES}:
        index = (folder / "index.md").read_text(encoding="utf-8")
        for page in PAGES:
            if page.parent == folder and page.stem != "index":
                assert f"({page.name})" in index
