"""The layout of the package: folders, circles, sizes, and what a plain problem visits of it."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from conftest import ROOT
from suite.capabilities import OWN, WALLS, above, rows

import dolfin_elastic
from dolfin_elastic import Case, NeoHookean, Problem, Statics, Support, Traction, box_body

PACKAGE = ROOT / "dolfin_elastic"
FILES = sorted(PACKAGE.rglob("*.py"))

ROOMS_ENTERED = 52
"""Modules of all folders; 45 are aimed at."""


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def trees() -> dict[str, ast.Module]:
    """Every module as it is parsed, once and by the first test that asks."""
    return {name_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in FILES}


def imported(module: str) -> Iterator[str]:
    """Modules of the package that a module imports, those for types and inside functions, too."""
    for node in ast.walk(trees()[module]):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [
                submodule
                if (submodule := f"{node.module}.{alias.name}") in trees()
                else node.module
                for alias in node.names
            ]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        yield from (name for name in names if name in trees() and name != module)


def test_no_circles():
    """A module that imports another one, directly or not, is not imported by that one."""
    # The package itself hands its public names out lazily: nobody inside may import them.
    left = {module: set(imported(module)) for module in trees() if module != "dolfin_elastic"}
    while free := [module for module, needs in left.items() if not needs & left.keys()]:
        for module in free:
            del left[module]
    assert not left, f"in circles, or above them: {sorted(left)}"


STARTS = "dolfin_elastic.core.startup"
STARTED = {"mpi4py", "petsc4py", "slepc4py", "dolfinx"}
"""Packages that start MPI or PETSc as they are imported."""
ALONE = {f"{STARTS}.libraries", f"{STARTS}.slepc"}


def starters(node: ast.AST) -> Iterator[str]:
    """Packages that a module imports as it is imported, without those for types."""
    for item in ast.iter_child_nodes(node):
        if isinstance(item, ast.Import):
            yield from (alias.name.split(".")[0] for alias in item.names)
        elif isinstance(item, ast.ImportFrom):
            yield (item.module or "").split(".")[0]
        elif not isinstance(item, ast.FunctionDef | ast.If):
            yield from starters(item)


def test_nothing_starts_in_the_current_folder():
    """Who imports what starts MPI or PETSc, or a package above it, has it started elsewhere first.

    The commands, which import it in functions, call `start` there: `hostile/test_current_folder.py`
    traces them.
    """
    starting = {
        module for module in trees() if f"{STARTS}.started" in set(imported(module)) - {module}
    }
    above = {module: {module.rsplit(".", n)[0] for n in range(5)} for module in trees()}
    unsafe = [
        module
        for module, tree in trees().items()
        if STARTED & set(starters(tree)) and not above[module] & starting and module not in ALONE
    ]
    assert len(starting) >= 10
    assert unsafe == []
    functions = [
        node
        for tree in trees().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    assert not [one.name for one in functions if "slepc4py" in set(starters(one))]


def test_nothing_is_far_too_large():
    """Beyond the walls nothing stands; what is large only, `.ci/lint` names.

    C in files has no wall: a file holds the loops of one idea.
    """
    assert sum(path.parent == PACKAGE for path in FILES if path.name != "__init__.py") <= 2
    large = {name: n for name, n in above(WALLS).items() if not name.endswith((".c", ".h"))}
    assert not large


def test_every_module_has_a_capability():
    """So that the lines of each capability are known."""
    known = rows()
    assert [str(path) for path in OWN if path not in known] == []


TELLS = re.compile(
    r'\[|\(|"|`|\d|shape|owned|ghost|local|global|collective|default|None|\b(?:see|where|if|whether|'
    r"unless|without|not|no|only|all|each|every|any|also|as|than|before|after|per|rank|ranks|sorted|"
    r"reference|deformed|current|unit|units|true|false|least|most|empty|else|may|must|same|relative|"
    r"absolute|ascending|file|root|inner|outer|by|from|between|up|until)\b",
    re.IGNORECASE,
)
"""Words with which an entry says a shape, a unit, a condition, an owner, a default."""


def entries(docstring: str) -> Iterator[tuple[str, str]]:
    """Names and texts under Args."""
    section = re.split(r"\n\n|\n(?=\w)", docstring.partition("Args:\n")[2])[0]
    for entry in re.split(r"\n(?= {4}\S)", "\n" + section):
        name, _, text = " ".join(entry.split()).partition(": ")
        if text:
            yield name, text


def test_entries_tell_more_than_name_and_type():
    """Arguments are explained where there is something to say, and only there."""
    told = [
        (module, name, text)
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        for name, text in entries(ast.get_docstring(node) or "")
    ]
    assert len(told) > 2000  # the list is that of the package
    assert [one for one in told if len(one[2].split()) <= 6 and not TELLS.search(one[2])] == []


def visited(compute: Callable[[], Sequence[int]]) -> list[str]:
    """Modules of which a computation executes a function: what a debugger shows to who follows it.

    The computation returns the numbers of its states, which must be 0, 1, ...
    """
    package = f"{Path(dolfin_elastic.__file__).parent}/"
    found: set[str] = set()

    def look(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(package) and code.co_name != "<module>":
            found.add(code.co_filename)

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        steps = compute()
    finally:
        sys.setprofile(before)
    assert [*steps] == [*range(len(steps))]
    return sorted(found)


def test_a_plain_problem_visits_few_modules():
    """A block held on one side and pulled on the other, from its problem to the first load step.

    None is of contact, cavities or periodic cells, which the block has not.
    """
    body = box_body(size=(2, 1, 1), cells=(4, 2, 2))
    law = NeoHookean(E=1e6, nu=0.3)
    support, load = Support(on="left"), Traction(on="right", value=[0, 0, -13e3])
    _ = Problem, Statics  # imported when they are asked for
    with ExitStack() as opened:

        def compute() -> list[int]:
            problem = Problem(body, law, supports=[support], loads=[load], degree=1)
            states = opened.enter_context(closing(Statics(problem, steps=2).steps()))
            return [next(states).step for _ in range(2)]

        counted = visited(compute)
    assert len(counted) <= ROOMS_ENTERED, ", ".join(counted)


def test_a_plain_case_visits_few_modules():
    """The same of a case: `make_problem`, the solver and the first state."""
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [2, 1, 1], "cells": [4, 2, 2]}, "degree": 1},
            "materials": {"rubber": {"law": "neo-hookean", "E": 1e6, "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": [0, 0, -13e3]}],
            "statics": {"steps": 2},
        }
    )
    body = case.read_body()
    _ = Problem, Statics
    with ExitStack() as opened:

        def compute() -> list[int]:
            solver = case.make_solver(case.make_problem(body))
            return [next(opened.enter_context(closing(solver.steps()))).step]

        counted = visited(compute)
    assert len(counted) <= ROOMS_ENTERED, ", ".join(counted)


@pytest.mark.parametrize(
    ("word", "most"), [(r"\bAny\b", 250), ("__getattr__", 2), ("type: ignore", 22)]
)
def test_types_are_known(word: str, most: int):
    """What escapes the check of types grows rare: once it was 610, 3 and 25 times."""
    found = sum(len(re.findall(word, path.read_text(encoding="utf-8"))) for path in FILES)
    assert found <= most, f"{found} times {word}, {most} are allowed: see Rules in CONTRIBUTING.md"


@pytest.mark.parametrize("folder", ["core", "mesh", "model", "problem", "solvers", "results"])
def test_folders_say_what_they_are(folder: str):
    """Each package has a line that says what it is."""
    for path in (PACKAGE / folder).rglob("__init__.py"):
        assert ast.get_docstring(trees()[name_of(path)]), path
