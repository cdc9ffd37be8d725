"""Runs the cells of a notebook in their order, in one process without Jupyter.

    python3 tests/helpers/cells.py NOTEBOOK

Commands and files stand in cells as the notebooks of the tutorials have them: `!command`, `%%bash`
and `%%writefile NAME`.  Each cell gets its output, as from Jupyter, and the file is written anew.
The first cell that fails ends it.
"""

from __future__ import annotations

import ast
import io
import json
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any


def run_cell(source: str, names: dict[str, object]) -> str:
    """Runs a cell of code.

    Args:
        names: Of the session.

    Returns:
        What it has printed.
    """
    first, _, rest = source.partition("\n")
    if first.startswith("%%writefile "):
        Path(first.split(" ", 1)[1]).write_text(f"{rest}\n", encoding="utf-8")  # as IPython
        return ""
    if first == "%%bash":
        return _run_shell(rest)
    if first.startswith("!"):
        return _run_shell(source[1:])
    with redirect_stdout(io.StringIO()) as printed:
        _run_python(source, names)
    return printed.getvalue()


def _run_shell(command: str) -> str:
    return subprocess.run(
        ["bash", "-ec", command], stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def _run_python(source: str, names: dict[str, object]) -> None:
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), names)
    if isinstance(last, ast.Expr):
        value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)
        if hasattr(value, "_repr_html_"):
            assert value._repr_html_()


def run_notebook(notebook: dict[str, Any]) -> None:
    """Runs all cells of code, and puts what they print into their outputs."""
    names: dict[str, object] = {"__name__": "__main__"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            text = run_cell("".join(cell["source"]), names)
            stream = {"output_type": "stream", "name": "stdout", "text": text}
            cell["outputs"] = [stream] if text else []


if __name__ == "__main__":
    # Of IPython the tutorials use this alone.
    display = ModuleType("IPython.display")
    display.Image = lambda file: Path(file).read_bytes()
    sys.modules |= {"IPython": ModuleType("IPython"), "IPython.display": display}
    file = Path(sys.argv[1])
    made = json.loads(file.read_text(encoding="utf-8"))
    run_notebook(made)
    file.write_text(json.dumps(made), encoding="utf-8")
