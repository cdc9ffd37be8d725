"""Words that only the authors understand stay out of what a person reads."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

import dolfin_elastic
from dolfin_elastic.case.reference.json_schema import case_schema

ROOT = Path(dolfin_elastic.__file__).parent
DOCS = ROOT.parent / "docs"
PRIVATE = {
    r"\brims?\b": "boundary, edge",
    r"\bends? in\b(?! (\.|`|planes|'|…)|\Z)": "gives, leads to",  # but a name ends in .png
    r"\bat odds\b": "inconsistent",
    r"\bserves?\b|\bserved\b": "is suited",
    r"\b(is|are|was|were|be|been) (told|said)\b|\btold apart\b": "reported, distinguished",
    r"\b(is|are|be|cannot be) (never )?kept\b": "stored, preserved",
    r"\b(is|are|nodes|at one end) (not )?held\b|\bheld (all|at|in|by|against|nowhere|along)\b": (
        "supported, fixed, constrained"
    ),
    r"\b(is|are|mean|as) (not )?taken\b": "used, in use",
    r"\b(is|are) (not )?whole\b|\b(it|them) whole\b|\bno whole (face|edge|part)\b": "complete",
    r"\bin shares\b|\bshares (g|whose)\b|\b(a|the|no) share\b|^share$": "fraction",
    r"\blevel of the pressure\b": "hydrostatic constant",
    r"\bcompiled forms?\b|\b[Ff]orms (cannot|are)\b|\b(same|in no|this) form\b": "compiled code",
    r"\bwhat was found\b|\bthe found\b": "result, or the thing's own name",
    r"\b(a|no|one|every|each|another|that|this|the|singular|different|same|all|these) places?\b"
    r"(?! of the load\b)": "position, coordinates, point",
    r"^(#+ |title = \")What (is|are) ": "the noun itself",
    r"(?<=\s)DIVERGED_\w+|\bDIVERGED_\w+(?=\s)": "the reason in words; PETSc's name is for -v",
    r"\bcells?\b(?= (,|\{))": "elements",
}
"""Pattern of a word in its private sense to the words of the field."""

UNREAD = ("mutants", "performance", "changes", "generated", "messages")
"""Pages for developers, and what `docs/build` makes."""

PAGES = [
    ROOT.parent / "README.md",
    *(page for page in DOCS.rglob("*.md") if not {page.stem, page.parent.name} & {*UNREAD}),
    *(DOCS / "reference" / "meanings").glob("*.toml"),
    *(ROOT / "study" / "verify" / "cases").glob("*.toml"),
]
MODULES = sorted(ROOT.rglob("*.py"))
PUBLIC = sorted(name for name in dir(dolfin_elastic) if name[0].isupper())


def texts(path: Path) -> list[str]:
    """The strings of a module that may be shown: its docstrings are not, but those of commands."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    alone = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    comments = {id(node) for node in alone if "\b" not in str(getattr(node, "value", ""))}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return [c.value for c in constants if isinstance(c.value, str) and id(c) not in comments]


def check(found: Iterable[str]) -> None:
    """No text has a word of the list."""
    wrong = [
        f"{' '.join(text.split())[:200]!r}: {better}"
        for text in found
        for word, better in PRIVATE.items()
        if re.search(word, text, re.MULTILINE)
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.long
def test_console_log_and_errors_speak_the_words_of_the_field() -> None:
    check(text for path in MODULES for text in texts(path))


def test_pages_speak_the_words_of_the_field() -> None:
    check(line for page in PAGES for line in page.read_text(encoding="utf-8").splitlines())


def test_help_speaks_the_words_of_the_field() -> None:
    public = [inspect.getdoc(getattr(dolfin_elastic, name)) or "" for name in PUBLIC]
    check(line for one in public for line in one.splitlines())
    check(re.findall(r'"description": "(.*)"', json.dumps(case_schema(), indent=0)))
