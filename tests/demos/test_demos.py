"""Every demo runs as its reader would run it and asserts its number, on one rank or two."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

from dolfin_elastic.problem.terms.bodies.barrier import runs_here

DEMOS = ROOT / "demos"
SCRIPTS = sorted(DEMOS.glob("*/*.py"))
CASES = sorted(path for path in DEMOS.glob("*/*.toml") if path.stem != "law")
# They take longest: the other demos run the same paths in the quick set.
LONG = {
    "bounce",
    "bracket_sweep",
    "brain",
    "bridge",
    "bunnies",
    "duck",
    "femur",
    "incline",
    "inclusion",
    "inverted",
    "o_ring",
    "paperclip",
    "print_up",
    "snap_fit",
    "tipping",
    "tower",
    "turek_hron",
}


def needs(path: Path) -> tuple[pytest.MarkDecorator, ...]:
    """The bunnies need a package that is optional, and compiled for some processors only."""
    missing = path.parent.name == "bunnies" and (find_spec("ipctk") is None or not runs_here())
    return (pytest.mark.skip(reason="no ipctk for this processor"),) if missing else ()


def runs() -> Iterator[Any]:
    """Demos and numbers of ranks, of which CI takes turns; the README has the duck on two."""
    for turn, path in enumerate(SCRIPTS):
        for ranks in (1,) if path.stem == "duck" else (1, 2):
            marks = [*needs(path), *([pytest.mark.long] if path.stem in LONG else [])]
            marks += [pytest.mark.spare] if path.stem != "duck" and ranks != turn % 2 + 1 else []
            yield pytest.param(path, ranks, marks=marks, id=f"{path.stem}-{ranks}")


CHECKED = {  # what a script says last about its number
    "inclusion": r"elements told wrongly beyond one from the edge: 0 of 1046",
    "bracket_sweep": r"the deviations of the samples are those of the scatter",
    "tetrahedron": r"largest relative difference: \d\.\de-1\d",
    "duck": r"largest stress 21\d kPa \+- \d %",
    "tipping": r"height 93 mm -> 83\.0\d mm",
    "bridge": r"imbalance over weight: \d\.\de-(09|1\d)",
    "cantilever": r"largest difference: \d\.\de-0[4-9]",
    "rubber": r"P2/P1 torque off by \d\.\de-0[4-9]",
    "own_energy": r"block against material point: \d\.\de-(0[89]|1\d)",
    "femur": r"factor on the load until 5 % of the neck yield: 4\.3",
    "printed_part": r"difference from beam theory: \d\.\de-0[3-9]",
    "print_up": r"largest difference from beam theory: \d\.\de-0[2-9]",
    "duck_plane": r"resultant \d\.\de-1\d, moment \d\.\de-1\d",
    "brain": r"small angles off the theory by \d\.\de-0[3-9] in the angle, \d\.\de-0[3-9] in",
    "bounce": r"energy out of balance: \d\.\de-0[4-9]",
    "tower": r"off the beam by (1\.\de-02|\d\.\de-03)",
    "turek_hron": r"largest difference over the amplitude: \d\.\de-(0[3-9])",
    "tuning_fork": r"tone 440\.\d+ Hz, off by \d\.\de-0[4-9]",
    "inverted": r"left of the displacement over the size: \d\.\de-(0[4-9]|1\d)",
    "incline": r"of the block off by \d\.\de-0[5-9], of the ball by \d\.\de-0[3-9]",
    "snap_fit": r"out: .*: P off by \d\.\de-0[2-9], W/P by \d\.\de-(0[6-9]|1\d)",
    "o_ring": r"squeezed 3\.6\d MPa; at the end off the rule by \d\.\de-0[2-9]",
    "treloar": r"ogden: largest r\.m\.s\. error 1\.\d % of the largest stress",
    "paperclip": r"springback off the beam by (1\.\de-02|\d\.\de-0[3-9])",
    "bunnies": r"largest gain of energy in a step: -?\d\.\de-(0[4-9]|1\d)",
    "jelly": r"difference of the periods: \d\.\de-0[3-9]",
}
LIMIT = 570
"""Seconds, within the 600 of a test: ranks share the cores with the other tests."""
pytestmark = pytest.mark.usefixtures("serial_only")


def launched(command: list[str], folder: Path, ranks: int, *, logs: bool = False) -> str:
    """Runs a Python program in a folder; returns what it printed, and logged if asked for."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    clean = {
        key: value
        for key, value in os.environ.items()
        if not re.match(r"PMIX|PRTE_(?!MCA)|OMPI_(?!MCA|ALLOW)", key)
    }
    found = [str(DEMOS.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    try:
        done = subprocess.run(
            [*launcher, sys.executable, *command],
            cwd=folder,
            text=True,
            capture_output=True,
            timeout=LIMIT,
            check=False,
            env={**clean, "PYTHONPATH": os.pathsep.join(found)},
        )
    except subprocess.TimeoutExpired as late:
        pytest.fail(f"no end after {LIMIT} s:\n{late.stdout!r}\n{late.stderr!r}")
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + (done.stderr if logs else "")


def test_all_there() -> None:
    """All demos, each with a script whose number is known here."""
    assert {path.stem for path in SCRIPTS} == set(CHECKED)


@pytest.mark.sample(2)
@pytest.mark.parametrize(("script", "ranks"), runs())
def test_script(script: Path, ranks: int, tmp_path: Path) -> None:
    """It ends well, says its number, and leaves nothing beside the demo."""
    before = sorted(DEMOS.rglob("*.*"))
    out = launched([str(script)], tmp_path, ranks)
    assert len(re.findall(CHECKED[script.stem], out)) == 1, out
    assert sorted(path for path in DEMOS.rglob("*.*") if "__pycache__" not in path.parts) == [
        path for path in before if "__pycache__" not in path.parts
    ]


@pytest.mark.long
def test_tetrahedron_on_three_ranks(tmp_path: Path) -> None:
    """Two ranks without a cell."""
    out = launched([str(DEMOS / "tetrahedron/tetrahedron.py")], tmp_path, 3)
    assert re.search(CHECKED["tetrahedron"], out)


@pytest.mark.parametrize(
    "case",
    [pytest.param(path, marks=needs(path), id=f"{path.parent.name}/{path.stem}") for path in CASES],
)
def test_case(case: Path, tmp_path: Path) -> None:
    """What the command line says of it."""
    out = launched(["-m", "dolfin_elastic", "check", str(case), "--json"], tmp_path, 1)
    assert json.loads(out)["unknowns"] > 100


@pytest.mark.long
def test_treloar_on_the_command_line(tmp_path: Path) -> None:
    """The command at the head of the law's file; what it writes is a material."""
    folder = DEMOS / "treloar"
    tests = [part for k in ("uniaxial", "planar") for part in (f"--{k}", str(folder / f"{k}.csv"))]
    command = ["-m", "dolfin_elastic", "fit", str(folder / "law.toml"), *tests, "--starts", "3"]
    out = launched(command, tmp_path, 1)
    assert "[materials.rubber]" in out
    written = "law_fitted/rubber.toml"
    out = launched(["-m", "dolfin_elastic", "material", written, "--json"], tmp_path, 1)
    assert json.loads(out)["rubber"]["passed"]


@pytest.mark.long
def test_duck_on_the_command_line(tmp_path: Path) -> None:
    """The command of the README: fields, numbers and a picture, and nothing to be warned of."""
    command = ["-m", "dolfin_elastic", "run", str(DEMOS / "duck/case.toml")]
    out = launched(command, tmp_path, 2, logs=True)
    assert not re.search("warning|buckles|not known", out), out
    assert re.search(r"done: \d+ steps", out)
    files = {path.name for path in (tmp_path / "case_results").iterdir()}
    assert files >= {"duck.png", "history.csv", "results.xdmf", "summary.json"}
    summary = json.loads((tmp_path / "case_results/summary.json").read_text())
    assert summary["ranks"] == 2
    assert summary["error"]["von_mises"]["error"] < 0.1
