"""What a check refuses: formulas without a value, steps without end, names of nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check import report
from dolfin_elastic.core.errors import InputError

MOTION = {"end": 0.1, "dt": 0.01}
LID = {"plane": {"axis": "-z", "at": 1.1}, "on": "top"}


def case(**tables: Any) -> Case:
    """A block of 2 x 1 x 1 m held at x = 0 and pulled at its other end."""
    defaults: dict[str, Any] = {
        "mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}, "degree": 1},
        "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3, "density": 1000}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [1e3, 0, 0]}],
    }
    return Case(**{**defaults, **tables})


def load(**keys: Any) -> dict[str, Any]:
    return {"load": [{"kind": "traction", "on": "right", "value": [1e3, 0, 0], **keys}]}


def held(**keys: Any) -> dict[str, Any]:
    return {"support": [{"on": "left"}, {"on": "right", **keys}]}


FORMULAS: dict[str, tuple[dict[str, Any], str]] = {
    "place": (
        {"support": [{"on": "left", "displacement": ["1/x", 0, 0]}]},
        r"support 'left': the prescribed displacement is not finite at \(0, 0, 0\) m",
    ),
    "plane inside": (
        {"support": [{"on": "left"}, {"on": "top", "displacement": ["1/(x - 1)", 0, 0]}]},
        r"support 'top': the prescribed displacement is not finite at \(1, 0, 1\) m",
    ),
    "curve of a load": (load(curve="1/t"), r"load\[0\]\.curve: '1/t' is infinite at t = 0"),
    "curve in motion": (
        {**load(curve="ln(t)"), "dynamics": MOTION},
        r"load\[0\]\.curve: 'ln\(t\)' is infinite at t = 0; .* from 0 to 0\.1",
    ),
    "curve that ends": (
        load(curve="sqrt(0.5 - t)"),
        r"load\[0\]\.curve: 'sqrt\(0\.5 - t\)' is not a real number at t = 0\.525",
    ),
    "curve of a support": (
        held(displacement=[0.01, 0, 0], curve="1/t"),
        r"support\[1\]\.curve: '1/t' is infinite at t = 0",
    ),
    "load within": (
        load(value=["1/(t - 0.5)", 0, 0]),
        r"load\[0\]\.value: the load is not finite somewhere at t = 0\.5",
    ),
    "obstacle": (
        {"contact": [{**LID, "motion": [0, 0, "-1/t"]}]},
        r"contact\[0\]\.motion: '-1/t' is infinite at t = 0",
    ),
    "curve of an obstacle": (
        {"contact": [{**LID, "motion": [0, 0, -1e-3], "curve": "1/t"}]},
        r"contact\[0\]\.curve: '1/t' is infinite at t = 0",
    ),
    "base of springs": (
        held(kind="spring", normal=1e6, displacement=["1/(x - 2)", 0, 0]),
        r"support\[1\]\.displacement: '1/\(x - 2\)' has no finite value somewhere",
    ),
    "springs": (
        held(kind="spring", stiffness=["1/(x - 2)", 1, 1]),
        r"support\[1\]\.stiffness: '1/\(x - 2\)' has no finite value somewhere",
    ),
    "growth": (
        {"load": [{"kind": "growth", "value": ["1/(t - 0.5)", 1, 1]}]},
        r"load\[0\]\.value: '1/\(t - 0\.5\)' has no finite value somewhere at t = 0\.5",
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_formulas_without_a_value(name: str) -> None:
    """`check` passed them, but those of a load at its end; `run` then blamed something else."""
    tables, text = FORMULAS[name]
    with pytest.raises(InputError, match=text):
        report(case(**tables))


def test_formulas_that_have_values() -> None:
    """At the rim of where they end, and where no load acts yet."""
    for tables in (
        {"support": [{"on": "left", "displacement": ["1e-3/(x + 1)", 0, 0]}]},
        load(curve="sqrt(1 - t)"),
        load(value=["1e3/t", 0, 0]),
    ):
        assert report(case(**tables)).notes is not None


NUMBERS: dict[str, tuple[dict[str, Any], str]] = {
    "dt": (
        {"dynamics": {"end": 0.1, "dt": 1e-300}},
        r"dynamics\.dt: 1e-300 s would be 1e\+299 steps up to dynamics\.end = 0\.1 s; at least",
    ),
    "first step": (
        {"dynamics": {"end": 0.1, "dt": 1e-20, "adaptive": True}},
        r"dynamics\.dt: .* at least 1e-13 s",
    ),
    "explicit dt": (
        {"dynamics": {"end": 1, "dt": 1e-12, "scheme": "central-differences"}},
        r"dynamics\.dt: .* at least 1e-09 s",
    ),
    "every": ({"dynamics": {**MOTION, "every": "1e-300 s"}}, r"dynamics\.every: 1e-300 s would be"),
    "steps": ({"statics": {"steps": 1e12}}, r"statics\.steps: .* at most 1e\+06"),
    "max_step": ({"statics": {"max_step": 1e-15}}, r"statics\.max_step: .* at least 1e-06"),
    "scale": (
        {"output": {"pictures": [{"scale": float("nan")}]}},
        r"output\.pictures\[0\]\.scale: NaN is wrong; expected a finite number",
    ),
    "endless": (
        {"output": {"pictures": [{"scale": float("inf")}]}},
        r"output\.pictures\[0\]\.scale: Infinity is wrong; expected a finite number",
    ),
    "probe": (
        {"output": {"probes": {"": [1, 0.5, 0.5]}}},
        r'output\.probes\."": "" is no name of a probe',
    ),
    "blank probe": (
        {"output": {"probes": {"a\nb": [1, 0.5, 0.5]}}},
        r'output\.probes\."a\\nb": "a\\nb" is no name of a probe',
    ),
    "unit": (
        {"mesh": {"box": {"size": [2, 1, 1], "cells": [2, 1, 1]}, "unit": ""}},
        r"mesh\.unit: '' is no unit of length",
    ),
    "picture above": (
        {"output": {"pictures": [{"file": "../a.png"}]}},
        r"output\.pictures\[0\]\.file: '\.\./a\.png' lies outside the folder of the results",
    ),
    "picture elsewhere": (
        {"output": {"pictures": [{"file": "/tmp/a.png"}]}},
        r"output\.pictures\[0\]\.file: '/tmp/a\.png' lies outside the folder of the results",
    ),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_what_nobody_means(name: str) -> None:
    """`check` passed them: runs without end, names of nothing, files anywhere."""
    tables, text = NUMBERS[name]
    with pytest.raises(InputError, match=text):
        case(**tables)


def test_pictures_in_folders_of_their_own() -> None:
    assert case(output={"pictures": [{"file": "views/a.png"}]}).output.pictures[0].file


@pytest.mark.parametrize(
    ("folder", "why"),
    [
        ("file/results", "file is a file"),
        ("file", "file is a file"),
        ("/proc/results", "no such file"),
        ("a\0b", "that is no name"),
        ("x" * 300, "file name too long"),
    ],
)
def test_folders_that_cannot_be_made(tmp_path: Path, folder: str, why: str) -> None:
    (tmp_path / "file").write_text("")
    made = Case.from_dict(case(output={"folder": folder}).to_dict(), tmp_path)
    with pytest.raises(InputError, match=rf"output\.folder: the folder of the results, .*{why}"):
        report(made)


def test_reactions_are_read_at_nodes() -> None:
    """Said before the run, in the words of the run."""
    probe = {"at": [0, 0.4, 0], "fields": ["reaction"]}
    with pytest.raises(InputError, match=r"output\.probes\.p: there is no node at \(0, 0\.4, 0\)"):
        report(case(output={"probes": {"p": probe}}))
    report(case(output={"probes": {"p": {**probe, "at": [0, 1, 0]}}}))


def test_a_check_leaves_nothing_behind(tmp_path: Path) -> None:
    """Folders that can be made are not."""
    made = Case.from_dict(case(output={"folder": "deep/results"}).to_dict(), tmp_path)
    report(made)
    assert list(tmp_path.iterdir()) == []
