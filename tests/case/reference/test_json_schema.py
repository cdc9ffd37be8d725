"""The JSON schema of case files takes what the program takes, and knows every key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from jsonschema import Draft7Validator

from dolfin_elastic.case.reference.json_schema import case_schema
from dolfin_elastic.cli.tools.files import Kind, template
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.supports.springs import SUPPORTS

DEMOS = sorted(
    path
    for path in (ROOT / "demos").glob("*/*.toml")
    if path.name != "law.toml"  # of `fit`
)
PAGES = [
    path
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if not {"_build", "generated", "messages"} & {*path.relative_to(ROOT).parts}
]
CASE = """
[mesh]
box = {size = [1, 1, "2 mm"], cells = [2, 2, 2]}
[materials.m]
law = "neo-hookean"
E = "1e6*(1 + x)"
nu = {field = "ratio", unit = "1"}
rho = 1000
[materials.own]
energy = "mu*(I1 - 3)"
parameters = {mu = "1 MPa"}
on = ["core", "shell"]
[surfaces]
foot = [{plane = "z", at = "min"}, {normal = [0, 0, 1]}]
[[support]]
on = "left"
[[load]]
kind = "pressure"
on = ["top"]
value = "10 kPa"
curve = [[0, 0], ["2 s", 1]]
[statics]
steps = 2
[output]
probes = {tip = [1, 2, "3 mm"], end = {on = "right", fields = ["displacement"]}}
checkpoint = false
"""


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return case_schema()


@pytest.fixture(scope="module")
def validator(schema: dict[str, Any]) -> Draft7Validator:
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


def faults(validator: Draft7Validator, table: dict[str, Any]) -> list[str]:
    """Places of what does not fit, but for whole tables that a part of a case lacks."""
    return [
        f"{error.json_path}: {error.message}"
        for error in validator.iter_errors(table)
        if error.json_path != "$" or error.validator != "required"
    ]


def test_demos_and_first_cases(validator: Draft7Validator) -> None:
    """Whole cases are valid."""
    texts = [path.read_text() for path in DEMOS]
    texts += [CASE, *(template(kind, Path("case.toml"))[Path("case.toml")] for kind in Kind)]
    for text in texts:
        validator.validate(tomllib.loads(text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_documentation(validator: Draft7Validator, page) -> None:
    """So are the cases, and parts of cases, of the documentation."""
    for text in re.findall(r"^```toml[\w-]*\n(.*?)^```$", page.read_text(), re.M | re.DOTALL):
        assert faults(validator, tomllib.loads(text)) == []


def test_examples_of_messages(validator: Draft7Validator) -> None:
    """So are those of the pages of messages, whose meanings are written in TOML."""
    for file in (ROOT / "docs/reference/meanings").glob("*.toml"):
        for name, page in tomllib.loads(file.read_text(encoding="utf-8")).items():
            example = page.get("example", "").strip()
            if not example.startswith("dolfin-elastic"):
                assert faults(validator, tomllib.loads(example)) == [], name


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('law = "neo-hookean"', 'law = "neo-hooke"'),
        ('E = "1e6*(1 + x)"', "Young = 1e6"),
        ("rho = 1000", "rho = -1"),
        ("rho = 1000", "rho = true"),
        ('kind = "pressure"', 'kind = "presure"'),
        ('value = "10 kPa"', 'force = "10 kPa"'),
        ('plane = "z"', 'plane = "w"'),
        ("cells = [2, 2, 2]", "cells = [2, 2]"),
        ("cells = [2, 2, 2]", 'cells = [2, "2", 2]'),
        ("steps = 2", "step = 2"),
        ("steps = 2", 'steps = "two"'),
        ("curve = [[0, 0]", "curve = [[0, 0, 0]"),
        ("checkpoint = false", "checkpoint = 3"),
        ("[statics]", "[static]"),
        ("[mesh]\n", "[mesh]\nfromage = true\n"),
    ],
)
def test_mistakes(validator: Draft7Validator, right: str, wrong: str) -> None:
    """What is misspelt, of the wrong kind or out of bounds is not."""
    assert CASE.count(right) == 1
    assert faults(validator, tomllib.loads(CASE)) == []
    assert faults(validator, tomllib.loads(CASE.replace(right, wrong))) != []


def test_every_key(schema: dict[str, Any]) -> None:
    """Every law, load and support has its keys there, with what they mean."""
    tables = schema["definitions"]
    for name, law in MATERIALS.items():
        keys = tables[f"law-{name}"]["properties"]
        assert {*law.model_fields, "on"} <= {*keys}
    for kinds in (LOADS, SUPPORTS):
        for name, kind in kinds.items():
            keys = tables[f"{kind.__name__}-{name}"]["properties"]
            assert {*kind.model_fields} == {*keys}
            assert keys["kind"] == {"const": name}
    described = tables["law-yeoh"]["properties"]
    assert described["c10"]["description"] == "First constant [Pa]."
    assert described["K"]["anyOf"][0]["exclusiveMinimum"] == 0
