"""Words that only the authors understand stay out of what the command line says."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import dolfin_elastic

ROOT = Path(dolfin_elastic.__file__).parent
PRIVATE = {
    r"\brims?\b": "boundary, edge",
    r"\bends in\b(?! \.)": "gives, leads to",  # but a name ends in .png
    r"\bat odds\b": "inconsistent",
    r"\bserves\b": "is suited",
    r"\b(is|are|was|were) (told|said)\b": "reported",
    r"\b(is|are) kept\b": "stored",
    r"\bDIVERGED_\w+": "the reason in words; PETSc's name is for -v",
    r"\bcells?\b(?= (,|\{))": "elements",
}
"""Pattern to the words of the field."""


def texts(path: Path) -> list[str]:
    """The strings of a module that may be shown: all but docstrings of what is no command."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and isinstance(node.body[0], ast.Expr)
        and "\b" not in str(getattr(node.body[0].value, "value", ""))
    }
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return [c.value for c in constants if isinstance(c.value, str) and id(c) not in inner]


@pytest.mark.parametrize("path", sorted((ROOT / "cli").rglob("*.py")), ids=lambda path: path.stem)
def test_the_command_line_speaks_the_words_of_the_field(path: Path) -> None:
    found = {word for text in texts(path) for word in PRIVATE if re.search(word, text)}
    assert not {word: PRIVATE[word] for word in found}
