"""Runs notebooks in Jupyter, for docker/test-notebook: the tutorials, and one with a fault.

python3 docker/notebook_check.py FOLDER [NAME...], where FOLDER/notebooks has them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_notebook

FAULT = [
    """from dolfin_elastic import NeoHookean, Problem, Statics, Support, Traction, box_body
body = box_body(size=[0.1, 0.01, 0.01], cells=[8, 1, 1])
load = Traction(on="right", value=[0, 0, -200])
problem = Problem(body, NeoHookean(E=1e6, nu=0.3), supports=[Support(on="left")], loads=[load])
problem""",
    'Problem(body, NeoHookean(E=1e6, nu=0.3), supports=[Support(on="lft")])',
    "for state in Statics(problem, steps=4).steps():\n    raise KeyboardInterrupt",
    """*_, state = Statics(problem).steps()
assert state.load_factor == 1 and state.max_displacement > 0""",
    "body",
]


def run(name: str, notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """Runs all cells in an empty folder; the first one that fails raises, if none may."""
    folder.mkdir()
    print("==", name, flush=True)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=900, kernel_name="python3", resources=resources).execute()
    return notebook


def html_of(cell: nbformat.NotebookNode) -> str:
    """What a cell shows as HTML; empty where it is none."""
    data = [one.data for one in cell.outputs if one.output_type == "execute_result"]
    return "".join(one.get("text/html", "") for one in data)


def main() -> None:
    """See the module."""
    work, names = Path(sys.argv[1]), sys.argv[2:]
    cells = [new_code_cell(source) for source in FAULT]
    for cell in cells[1:3]:
        cell.metadata["tags"] = ["raises-exception"]
    done = run("a cell that fails", new_notebook(cells=cells), work / "fault").cells
    errors = [one.ename for cell in done for one in cell.outputs if one.output_type == "error"]
    assert errors == ["MeshError", "KeyboardInterrupt"], errors
    assert "<table>" in html_of(done[0])
    assert "data:image/png" in html_of(done[-1])
    for file in sorted((work / "notebooks").glob("*.ipynb")):
        if not names or file.stem in names:
            notebook = run(file.stem, nbformat.read(file, as_version=4), work / file.stem)
            shells = [c for c in notebook.cells if c.source.startswith("!dolfin-elastic")]
            texts = ["".join(o.get("text", "") for o in c.outputs) for c in shells]
            assert not [text for text in texts if "error:" in text], texts
            assert any("<iframe" in html_of(c) for c in notebook.cells if c.cell_type == "code")


if __name__ == "__main__":
    main()
