"""The layout of the package: folders, circles, sizes, and what a plain problem visits of it."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from conftest import ROOT

import dolfin_elastic
from dolfin_elastic import Case, NeoHookean, Problem, Statics, Support, Traction, box_body

PACKAGE = ROOT / "dolfin_elastic"
FILES = sorted(PACKAGE.rglob("*.py"))

MODULES_A_FOLDER = 12
METHODS_A_CLASS = 20
MODULES_VISITED = 30


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


TREES = {name_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in FILES}


def imported(module: str) -> Iterator[str]:
    """Modules of the package that a module imports, those for types and inside functions, too."""
    for node in ast.walk(TREES[module]):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [
                submodule if (submodule := f"{node.module}.{alias.name}") in TREES else node.module
                for alias in node.names
            ]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        yield from (name for name in names if name in TREES and name != module)


def test_no_circles():
    """A module that imports another one, directly or not, is not imported by that one."""
    # The package itself hands its public names out lazily: nobody inside may import them.
    left = {module: set(imported(module)) for module in TREES if module != "dolfin_elastic"}
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
        module for module in TREES if f"{STARTS}.started" in set(imported(module)) - {module}
    }
    above = {module: {module.rsplit(".", n)[0] for n in range(5)} for module in TREES}
    unsafe = [
        module
        for module, tree in TREES.items()
        if STARTED & set(starters(tree)) and not above[module] & starting and module not in ALONE
    ]
    assert len(starting) >= 10
    assert unsafe == []
    functions = [
        node
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    assert not [one.name for one in functions if "slepc4py" in set(starters(one))]


def test_folders():
    """At most twelve modules a folder, laws apart, and two in the root."""
    counts = Counter(path.parent for path in FILES if path.name != "__init__.py")
    assert counts.pop(PACKAGE) <= 2
    del counts[PACKAGE / "model" / "materials" / "laws"]
    large = {str(folder): n for folder, n in counts.items() if n > MODULES_A_FOLDER}
    assert not large


def test_classes():
    """No class has more than twenty methods."""
    large = {
        f"{module}.{node.name}": methods
        for module, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        and (methods := sum(isinstance(item, ast.FunctionDef) for item in node.body))
        > METHODS_A_CLASS
    }
    assert not large


def public_functions(
    node: ast.Module | ast.ClassDef, path: str
) -> Iterator[tuple[str, list[str], str]]:
    """Public functions and methods: name, arguments without self and cls, docstring."""
    for item in node.body:
        if not isinstance(item, ast.ClassDef | ast.FunctionDef) or item.name.startswith("_"):
            continue
        name = f"{path}.{item.name}"
        if isinstance(item, ast.ClassDef):
            yield from public_functions(item, name)
            continue
        every = item.args
        arguments = [a.arg for a in (*every.posonlyargs, *every.args, *every.kwonlyargs)]
        arguments += [a.arg for a in (every.vararg, every.kwarg) if a is not None]
        bound = isinstance(node, ast.ClassDef) and arguments[:1] in (["self"], ["cls"])
        yield name, arguments[bound:], ast.get_docstring(item) or ""


def test_arguments_are_documented():
    """Public functions of two or more arguments name each of them under Args.

    Left out are overriding methods that refer to the one where the arguments stand ("See `Base`").
    """
    several = [
        function
        for module, tree in TREES.items()
        for function in public_functions(tree, module)
        if len(function[1]) >= 2
    ]
    assert len(several) > 400  # the list is that of the package
    missing = []
    for name, arguments, text in several:
        documented = text.partition("Args:\n")[2]
        lines = [line.split(": ")[0] for line in documented.splitlines()]
        named = {word.strip(" *") for line in lines for word in line.split(",")}
        if "See `" not in text:
            missing += [f"{name}({argument})" for argument in arguments if argument not in named]
    assert not missing


def visited(compute: Callable[[], Sequence[int]]) -> list[str]:
    """Modules of which a computation executes a function, but for those of `core` and `model`.

    These have no control over anything: counted is what somebody reads who follows a computation in
    a debugger.  The computation returns the numbers of its states, which must be 0, 1, ...
    """
    package = str(Path(dolfin_elastic.__file__).parent)
    found: set[str] = set()

    def look(frame: FrameType, event: str, argument: Any) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(package) and frame.f_code.co_name != "<module>":
            found.add(path.relative_to(package).as_posix())

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        steps = compute()
    finally:
        sys.setprofile(before)
    assert [*steps] == [*range(len(steps))]
    return sorted(path for path in found if not path.startswith(("core/", "model/")))


def test_a_plain_problem_visits_few_modules():
    """A block held on one side and pulled on the other, from its problem to the first load step.

    Before this was counted it was 44, among them contact, cavities and periodic cells, which the
    block has not.
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
    assert len(counted) <= MODULES_VISITED, ", ".join(counted)


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
    assert len(counted) <= MODULES_VISITED, ", ".join(counted)


@pytest.mark.parametrize(
    ("word", "most"), [(r"\bAny\b", 250), ("__getattr__", 2), ("type: ignore", 22)]
)
def test_types_are_known(word: str, most: int):
    """What escapes the check of types grows rare: once it was 610, 3 and 25 times."""
    found = sum(len(re.findall(word, path.read_text(encoding="utf-8"))) for path in FILES)
    assert found <= most


@pytest.mark.parametrize("folder", ["core", "mesh", "model", "problem", "solvers", "results"])
def test_folders_say_what_they_are(folder: str):
    """Each package has a line that says what it is."""
    for path in (PACKAGE / folder).rglob("__init__.py"):
        assert ast.get_docstring(TREES[name_of(path)]), path
