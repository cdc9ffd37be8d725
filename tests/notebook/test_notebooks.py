"""The tutorials as notebooks: made from their pages, and run cell by cell."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT
from helpers.processes import clean_environment
from mpi4py import MPI

sys.path.append(str(ROOT / "docs/_ext"))

from notebooks import TUTORIALS, command_cell, notebook, write
from tutorials import BLOCK, commands, pictures, shown, words

PAGES = sorted(page for page in TUTORIALS.glob("*.md") if page.stem != "index")
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs programs of its own")


def sources(page: Path, kind: str = "code") -> list[str]:
    made = notebook(page)
    return ["".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == kind]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_it_has_all_of_its_page(page: Path):
    """Each file and command in its order, a viewer of the first run, and each picture."""
    cells, expected = sources(page), 1
    for name, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if name:
            assert f"%%writefile {name}\n{text}".rstrip() in cells
            expected += 1
        if language == "console":
            expected += len(list(commands(text)))
    shells = [c[1:] for c in cells if c.startswith("!")]
    given = [c for _, language, text in BLOCK.findall(page.read_text()) for c, _ in commands(text)]
    assert shells == [c for c in given if c in shells]
    assert all(c in shells for c in given if c.startswith("dolfin-elastic"))
    ran = any(c.startswith("dolfin-elastic run") for c in given)
    assert len(cells) == expected + ran + len(pictures(page))
    prose = "".join(sources(page, "markdown"))
    assert "```console" not in prose
    assert ".md)" not in prose


def test_its_cells_are_valid(tmp_path: Path):
    """The files are notebooks of format 4; cells of Python are Python."""
    for file in write(tmp_path):
        made = json.loads(file.read_text(encoding="utf-8"))
        assert made["nbformat"] == 4 and made["metadata"]["kernelspec"]["name"] == "python3"
        for cell in made["cells"]:
            text = "".join(cell["source"])
            if cell["cell_type"] == "code" and not text.startswith(("!", "%%")):
                compile(text, file.name, "exec")


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_its_cells_run(page: Path, tmp_path: Path):
    """In their order: files, commands, viewer, pictures and the number at the end.

    Every command ends with code 0 and prints what the page shows, numbers aside;
    `docs/_ext/tutorials.py` writes what it prints now.  A process for each notebook stands for its
    kernel; docker/test-notebook runs them in Jupyter itself, which the packages of the program do
    not contain.
    """
    file = tmp_path / "page.ipynb"
    file.write_text(json.dumps(notebook(page)), encoding="utf-8")
    path = f"{ROOT / 'docker/bin'}:{clean_environment()['PATH']}"
    done = subprocess.run(
        [sys.executable, ROOT / "tests/helpers/cells.py", file.name],
        cwd=tmp_path,
        env={**clean_environment(), "PATH": path, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    cells = iter(json.loads(file.read_text(encoding="utf-8"))["cells"])
    for _, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        for command, recorded in commands(text) if language == "console" else ():
            cell = next(one for one in cells if "".join(one["source"]) == command_cell(command))
            printed = "".join(output["text"] for output in cell["outputs"])
            assert words(shown(printed)) == words(recorded), command
