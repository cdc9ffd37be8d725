"""The tutorials as notebooks, made from their pages.

    docker/run python3 docs/_ext/notebooks.py [FOLDER]       (default: notebooks)
    docker/run jupyter lab FOLDER

Files, commands and checks of a page are cells in their order; what it shows of outputs is left to
the cells.
"""

from __future__ import annotations

import ast
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

from tutorials import BLOCK, PICTURE, ROOT, commands

TUTORIALS = ROOT / "docs/tutorials"
START = """from glob import glob

from IPython.display import Image

from dolfin_elastic import show_report"""
_LINK = re.compile(r"(?<!!)\[([^]]+)\]\((?!https?:)[^)]*\)")
"""A link to another page, which the notebook has not."""
_RUN = re.compile(r"dolfin-elastic run ([\w-]+)\.toml")
_COPY = re.compile(r"cp \$REPOSITORY/(\S+) \.")


def notebook(page: Path) -> dict[str, object]:
    """A page as a notebook, in the format of its file."""
    cells = [_cell(kind, text) for kind, text in _cells(page.read_text(encoding="utf-8"))]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {
        "cells": cells,
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 4,
    }


def _cell(kind: str, text: str) -> dict[str, object]:
    cell: dict[str, object] = {"cell_type": kind, "metadata": {}}
    cell["source"] = text.splitlines(keepends=True)
    return cell if kind == "markdown" else {**cell, "execution_count": None, "outputs": []}


def _cells(text: str) -> Iterator[tuple[str, str]]:
    """Kind and text of each cell."""
    title, _, text = text.partition("\n")
    yield "markdown", title
    yield "code", START
    place, shown = 0, False
    for block in BLOCK.finditer(text):
        name, language, content = block.groups()
        if not name and language != "console":
            continue  # stays in the text around it
        yield from _prose(text[place : block.start()])
        place = block.end()
        if name:
            yield "code", _file(name, content)
        for command, _ in commands(content) if language == "console" else ():
            yield "code", command_cell(command)
            if (run := _RUN.fullmatch(command)) and not shown:
                shown = True  # one viewer a notebook: each holds a megabyte
                yield "code", f'show_report("{run[1]}_results")'
    yield from _prose(text[place:])


def _prose(text: str) -> Iterator[tuple[str, str]]:
    """Text between blocks; a picture in it, which a command has drawn, is shown by a cell."""
    for n, part in enumerate(re.split(rf"^{PICTURE.pattern}$", text, flags=re.MULTILINE)):
        if n % 2:
            yield "code", f'Image(*glob("**/{part}", recursive=True))'
        elif part.strip():
            yield "markdown", _LINK.sub(r"\1", part.strip())


def _file(name: str, content: str) -> str:
    return f"%%writefile {name}\n{content}".rstrip("\n")


def command_cell(command: str) -> str:
    """A command of the shell; Python that it would start is the cell itself."""
    if copied := _COPY.fullmatch(command):
        path = ROOT / copied[1]
        return _file(path.name, path.read_text(encoding="utf-8"))
    if command.startswith("python3 -c "):
        code = shlex.split(command)[2].strip()
        return code if "\n" in code else ast.unparse(ast.parse(code))
    # IPython would put its own variables in place of $ and braces.
    return f"%%bash\n{command}" if re.search(r"[\n${}]", command) else f"!{command}"


def write(folder: Path) -> list[Path]:
    """Writes the notebooks of all tutorials into a folder, which is made if missing.

    Returns:
        Their files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for page in sorted(TUTORIALS.glob("*.md")):
        if page.stem != "index":
            files.append(folder / f"{page.stem}.ipynb")
            text = json.dumps(notebook(page), indent=1, ensure_ascii=False)
            files[-1].write_text(text + "\n", encoding="utf-8")
    return files


if __name__ == "__main__":
    print(*write(Path(*(sys.argv[1:] or ["notebooks"]))), sep="\n")
