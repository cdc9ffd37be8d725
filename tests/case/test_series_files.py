"""Branches of a material that relaxes, from a CSV file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from helpers.processes import cli

from dolfin_elastic import Case, LinearElastic
from dolfin_elastic.case.case import read_case, read_materials
from dolfin_elastic.core.errors import InputError

pytestmark = pytest.mark.usefixtures("serial_only")

BODY: dict[str, Any] = {
    "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
    "support": [{"on": "left"}],
}
TEXT = "# measured at 20 degC\nratio,time\n0.3,100 ms\n\n0.2,2.5\n"
TERMS = [(0.3, 0.1), (0.2, 2.5)]


def read(folder: Path, **keys: Any) -> Case:
    gel = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, **keys}
    return Case.from_dict({**BODY, "materials": {"gel": gel}}, folder, file="case.toml")


def terms(case: Case) -> list[tuple[float, float]]:
    return [(term.ratio, term.time) for term in case.materials["gel"].law.viscous]


@pytest.mark.parametrize(
    ("text", "source"),
    [
        (TEXT, "prony.csv"),
        (TEXT, {"file": "prony.csv"}),
        ("time;ratio\n1e-1;0.3\n2.5;0.2\n", {"file": "prony.csv"}),
        ("tau\tg\n100\t0.3\n2.5 s\t0.2\n", {"file": "prony.csv", "unit": "ms"}),
        ("i,a,b\n1,0.3,0.1\n2,0.2,2.5\n", {"file": "prony.csv", "ratio": "a", "time": "b"}),
    ],
)
def test_the_file_is_the_list(tmp_path: Path, text: str, source: Any) -> None:
    """Under both names of the key; written back, the case needs no file."""
    (tmp_path / "prony.csv").write_text(text)
    for key in ("viscous", "prony"):
        case = read(tmp_path, **{key: source})
        assert terms(case) == TERMS
        assert case.materials["gel"].law.lasting == (1.0 if key == "viscous" else 0.5)
        again = Case(**tomllib.loads(case.to_toml()))
        assert again.materials == case.materials
        assert again.to_toml() == case.to_toml()


def test_by_every_way_to_a_case(tmp_path: Path) -> None:
    """`read_case`, and `read_materials`, which the command `material` uses; beside a library."""
    (tmp_path / "prony.csv").write_text(TEXT)
    (tmp_path / "own.toml").write_text('[gel]\nE = "1 MPa"\nnu = 0.3\n')
    file = tmp_path / "case.toml"
    file.write_text(
        'library = "own.toml"\n[mesh]\nbox = {size = [1, 1, 1], cells = [1, 1, 1]}\n'
        '[materials.gel]\nmaterial = "gel"\nviscous = "prony.csv"\n[[support]]\non = "left"\n'
    )
    assert terms(read_case(file)) == TERMS
    assert [t.time for t in read_materials(file)["gel"].law.viscous] == [0.1, 2.5]


WRONG = [
    ("ratio,time\n0.3,1\n", {"viscous": "pronny.csv"}, "there is no such file; did you mean 'pro"),
    ("ratio,tme\n0.3,1\n", {}, "there is no column 'time'; did you mean 'tme'"),
    ("g_i,tau\n0.3,1\n", {}, "there is no column 'ratio'"),
    ("0.3,1\n", {}, "the file has no headings, so no column 'ratio'"),
    ("ratio,time\n", {}, "headings but no numbers"),
    ("", {}, "the table is empty"),
    ("ratio,time\n0.3,1\n0.2\n", {}, "line 3 ends too early: '0.2'"),
    ("ratio,time\n0.3,soon\n", {}, "'soon' is not a number, in line 2: '0.3,soon'"),
    ("# 1\nratio,time\nnan,1\n", {}, "'nan' is not a number, in line 3"),
    ("ratio;time\n0,3;1\n", {}, "'0,3' is not a number, in line 2: '0,3;1'; decimal points, not"),
    ("ratio,time\n0.3,1\n-0.2,1\n", {}, "line 3, column 'ratio': \"-0.2\" is wrong"),
    ("ratio,time\n0,1\n", {}, "line 2, column 'ratio': \"0\" is wrong; expected a number above 0"),
    ("g,tau\n0.3,0\n", {}, "line 2, column 'tau': \"0\" is wrong; expected a number above 0"),
    ("g,tau\n0.3,1 mm\n", {}, "line 2, column 'tau': '1 mm' has the wrong unit"),
    ("g,tau\n0.3,1\n", {"viscous": {"file": "prony.csv", "unit": "mm"}}, "'1 mm' has the wrong"),
    ("g,tau\n0.3,1\n", {"viscous": {"fil": "prony.csv"}}, "viscous: unknown key 'fil'"),
    ("g,tau\n0.3,1\n", {"viscous": {"ratio": "g"}}, "viscous.file: this key is missing"),
    ("g,tau\n0.6,1\n0.5,2\n", {"viscous_constants": "instantaneous"}, "up to line 3 the ratios s"),
    (
        "g,tau\n1,1\n",
        {"viscous_constants": "instantaneous"},
        "up to line 2 the ratios sum up",
    ),
]


@pytest.mark.parametrize(("text", "keys", "says"), WRONG)
def test_files_without_branches(tmp_path: Path, text: str, keys: Any, says: str) -> None:
    """With the file, the line, and the key that names the file."""
    (tmp_path / "prony.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read(tmp_path, **{"viscous": "prony.csv", **keys})
    assert str(caught.value).startswith("case.toml: materials.gel.viscous")
    assert says in str(caught.value)


def test_ratios_to_the_stress_that_stays_may_be_large(tmp_path: Path) -> None:
    """A glassy polymer is a hundred times as stiff at first."""
    (tmp_path / "prony.csv").write_text("ratio,time\n60,1 ms\n40,1 s\n")
    assert read(tmp_path, viscous="prony.csv").materials["gel"].law.sudden == 101


def test_errors_stand_together(tmp_path: Path) -> None:
    """Those of two files, and those of the other tables."""
    gel = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3}
    rows = {name: {**gel, "on": name, "viscous": f"{name}.csv"} for name in ("a", "b")}
    wrong = {**BODY, "materials": rows, "support": [{"on": 3}]}
    with pytest.raises(InputError) as caught:
        Case.from_dict(wrong, tmp_path)
    text = str(caught.value)
    assert all(key in text for key in ("materials.a.viscous", "materials.b.viscous", "support[0]"))


def test_in_python_branches_are_a_list() -> None:
    with pytest.raises(InputError, match="viscous: no branches: the file has not been read"):
        LinearElastic(E=1, nu=0.3, viscous="prony.csv")


@pytest.mark.parametrize(("command", "ranks"), [("check", 1), ("run", 2), ("material", 1)])
def test_a_command_ends_before_anything_is_compiled(
    tmp_path: Path, command: str, ranks: int
) -> None:
    (tmp_path / "case.toml").write_text(
        "[mesh]\nbox = {size = [1, 1, 1], cells = [1, 1, 1]}\n[materials.gel]\n"
        'law = "linear-elastic"\nE = 1\nnu = 0.3\nviscous = "prony.csv"\n[[support]]\non = "left"\n'
    )
    (tmp_path / "prony.csv").write_text("ratio,time\n0.3,-1\n")
    code, _, err = cli(command, "case.toml", folder=tmp_path, ranks=ranks)
    assert code == 2
    where = "error: case.toml: materials.gel.viscous: prony.csv: line 2, column 'time': "
    assert " ".join(err.split()).count(where) == 1
