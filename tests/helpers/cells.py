"""Runs the cells of a notebook in their order, in one process without Jupyter.

    python3 tests/helpers/cells.py NOTEBOOK

Commands and files stand in cells as the notebooks of the tutorials have them: `!command`, `%%bash`
and `%%writefile NAME`.  The first cell that fails ends it.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType


def run_cell(source: str, names: dict[str, object]) -> None:
    """Runs a cell of code.

    Args:
        names: Of the session.
    """
    first, _, rest = source.partition("\n")
    if first.startswith("%%writefile "):
        Path(first.split(" ", 1)[1]).write_text(f"{rest}\n", encoding="utf-8")  # as IPython
    elif first == "%%bash":
        subprocess.run(["bash", "-ec", rest], check=True)
    elif first.startswith("!"):
        subprocess.run(["bash", "-ec", source[1:]], check=True)
    else:
        _run_python(source, names)


def _run_python(source: str, names: dict[str, object]) -> None:
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), names)
    if isinstance(last, ast.Expr):
        value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)
        if hasattr(value, "_repr_html_"):
            assert value._repr_html_()


def run_notebook(notebook: Mapping[str, list[Mapping[str, object]]]) -> None:
    """Runs all cells of code."""
    names: dict[str, object] = {"__name__": "__main__"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            run_cell("".join(cell["source"]), names)


if __name__ == "__main__":
    # Of IPython the tutorials use this alone.
    display = ModuleType("IPython.display")
    display.Image = lambda file: Path(file).read_bytes()
    sys.modules |= {"IPython": ModuleType("IPython"), "IPython.display": display}
    run_notebook(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
