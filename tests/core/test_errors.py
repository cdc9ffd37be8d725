"""What a fault ends a command with."""

from __future__ import annotations

import pickle

import pytest

from dolfin_elastic.case.reference.json_schema import case_schema
from dolfin_elastic.core import errors, synonyms
from dolfin_elastic.core.units import MESH_UNITS
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.supports.springs import SUPPORTS
from dolfin_elastic.results.fields import FIELDS


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("ElasticError", 1),
        ("InputError", 2),
        ("MeshError", 2),
        ("UnitError", 2),
        ("FormulaError", 2),
        ("SolveError", 3),
        ("ConvergenceError", 3),
        ("StabilityError", 3),
        ("OutputError", 4),
        ("StoppedError", 130),  # 128 + SIGINT, as of a shell (POSIX)
    ],
)
def test_exit_codes(kind: str, code: int) -> None:
    """Scripts tell by the code whether the case, the mechanics or the disk is at fault."""
    assert getattr(errors, kind).exit_code == code


@pytest.mark.parametrize(
    ("name", "known", "hint"),
    [
        ("a/cas.toml", ["a/case.toml", "a/b.toml"], "did you mean 'a/case.toml'?"),
        ("beam", ["beam.toml"], "did you mean 'beam.toml'?"),
        ("Beam.toml", ["beam.toml"], "did you mean 'beam.toml'?"),
        ("tow.msh", ["two.msh", "one.msh"], "did you mean 'two.msh'?"),
        # What all have in common makes no name alike.
        ("long/way/bar.toml", ["long/way/foo.toml"], "known: long/way/foo.toml"),
        ("plate_results", ["beam_results"], "known: beam_results"),
        ("tyre.toml", ["bridge.toml", "plate.toml"], "known: bridge.toml, plate.toml"),
        (
            "x",
            [f"{i}.toml" for i in range(10)],
            "known: " + ", ".join(f"{i}.toml" for i in range(8)) + " and 2 more",
        ),
    ],
)
def test_nearest_file(name: str, known: list[str], hint: str) -> None:
    """A file of another name is not proposed for the one that is missing."""
    assert errors.nearest_file(name, known) == hint


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("plain", "did you mean 'plane'?"),
        ("Plane", "did you mean 'plane'?"),
        ("phere", "did you mean 'sphere'?"),
        ("spehre", "did you mean 'sphere'?"),
        # Two letters of three in common with another name, but no slip of the hand.
        ("where", "known: box, cylinder, plane, sphere"),
        ("x", "known: box, cylinder, plane, sphere"),
    ],
)
def test_nearest_names(name: str, hint: str) -> None:
    """A name that is far from all of them gets the list, and no wrong guess."""
    known = ["sphere", "plane", "cylinder", "box"]
    assert errors.nearest(name, known) == hint
    guess = hint if hint.startswith("did") else ""
    assert errors.nearest_first(name, known).startswith(guess or "known: sphere, plane")


@pytest.mark.parametrize(
    ("word", "known", "name"),
    [
        ("yield", ["E", "yeoh", "allowable", "density"], "allowable"),
        ("Yield_strength", ["E", "nu", "allowable"], "allowable"),
        ("Young's modulus", ["E", "nu"], "E"),
        ("elastic_modulus", ["E", "nu", "K"], "E"),
        ("poisson", ["on", "nu"], "nu"),
        ("rho", ["nu", "density"], "density"),
        ("clamp", ["fixed", "roller"], "fixed"),
        ("ENCASTRE", ["fixed", "roller"], "fixed"),
        ("load", ["traction", "force"], "force"),
        ("type", ["kind", "on"], "kind"),
        ("type", ["law", "on"], "law"),
        ("stress", ["von_mises", "strain"], "von_mises"),
        ("factor of safety", ["von_mises", "safety_factor"], "safety_factor"),
        ("safety factor", ["von_mises", "safety_factor"], "safety_factor"),
    ],
)
def test_words_by_their_meaning(word: str, known: list[str], name: str) -> None:
    """What the word means stands before what only looks like it."""
    assert errors.nearest(word, known) == f"did you mean '{name}'?"
    assert errors.nearest_first(word, known).startswith(f"did you mean '{name}'? known: {name}, ")


def test_errors_together() -> None:
    """Each text once, with its own place, in the order in which they come; no end of them."""
    with (
        pytest.raises(errors.InputError) as caught,
        errors.keyed("load[0]"),
        errors.all_errors() as attempt,
    ):
        for number in range(100):
            with attempt(), errors.keyed(f"value[{number // 2}]"):
                raise errors.UnitError("wrong", expected="right")
    assert len(caught.value.each) == 25
    assert isinstance(caught.value, errors.UnitError)
    sent = pickle.loads(pickle.dumps(caught.value))
    assert str(sent).splitlines()[:2] == [
        "load[0].value[0]: wrong; right",
        "load[0].value[1]: wrong; right",
    ]


def test_errors_in_another_order() -> None:
    """Each error is alone, so that what sorts or replaces one does not meet the others again."""
    both = errors.joined([errors.InputError("b"), errors.InputError("a")])
    assert str(errors.joined(sorted(both.each, key=str))) == "a\nb"
    assert [str(one) for one in both.each] == ["b", "a"]


def test_synonyms_are_of_names_that_exist() -> None:
    """And none is a name itself, but in another table."""
    tables = case_schema()["definitions"].values()
    keys = {*case_schema()["properties"], *(k for t in tables for k in t.get("properties", ()))}
    assert synonyms._WORDS.keys() <= {*keys, *LOADS, *SUPPORTS, *MATERIALS, *FIELDS, *MESH_UNITS}


@pytest.mark.parametrize(
    ("word", "known", "name"),
    [
        ("yield", FIELDS, "safety_factor"),
        ("stress_xx", FIELDS, "cauchy_stress"),
        ("stress_xx", ["cauchy_stress_xx", "pk1_stress_xx"], "cauchy_stress_xx"),
        ("Re", ["allowable", "E"], "allowable"),
        ("clamps", SUPPORTS, "fixed"),
        ("millimeter", MESH_UNITS, "mm"),
        ("MM", MESH_UNITS, "mm"),
        ("frequency", ["mesh", "modal"], "modal"),
        ("geometry", ["mesh", "modal"], "mesh"),
    ],
)
def test_words_of_the_trade_are_understood(word: str, known: list[str], name: str) -> None:
    assert errors.nearest(word, known) == f"did you mean '{name}'?"
