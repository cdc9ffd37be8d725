"""What a fault ends a command with."""

from __future__ import annotations

import pytest

from dolfin_elastic.core import errors


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
