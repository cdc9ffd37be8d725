"""What `check` and `run` say of bodies that touch, and of ties."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.decks import box, inp_text, made, shared_folder
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.look.look import look_at
from dolfin_elastic.case.run import check_problem, log_notes, run
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.state import State

TABLES: dict[str, Any] = {
    "mesh": {"file": "two.inp", "unit": "mm"},
    "surfaces": {
        "foot": {"of": "upper", "plane": "z", "at": 2},
        "table": {"of": "lower", "plane": "z", "at": 2},
        "bottom": {"plane": "z", "at": "min"},
        "top": {"plane": "z", "at": "max"},
    },
    "materials": {"steel": {"law": "linear-elastic", "E": "210 GPa", "nu": 0.3}},
    "support": [{"on": "bottom"}, {"on": "top", "displacement": [0, 0, "1 um"]}],
}


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """With a block of 3 x 3 mm on one of 4 x 4 mm, each of them 2 mm high."""
    with shared_folder() as path:
        lower, upper = box((4, 4, 2), (3, 3, 2)), box((3, 3, 2), (4, 3, 2))
        points = np.concatenate([lower[0], upper[0] + [0.5, 0.5, 2]])
        cells = np.concatenate([lower[1], upper[1] + len(lower[0])])
        count = len(lower[1])
        sets = f"*ELSET, ELSET=lower, GENERATE\n1, {count}\n*ELSET, ELSET=upper, GENERATE\n"
        text = inp_text(points, cells, f"{sets}{count + 1}, {len(cells)}\n")
        made(lambda: (path / "two.inp").write_text(text))
        yield path


def case(folder: Path, **tables: Any) -> Case:
    return Case.from_dict({**TABLES, **tables}, folder=folder)


def test_bodies_that_touch_are_named_by_their_surfaces(folder: Path) -> None:
    """With the remedy; nothing is said where they are tied."""
    notes = " | ".join(report(case(folder)).notes)
    assert "the surfaces 'foot' and 'table' of two bodies touch on 9 mm^2" in notes
    assert '[[tie]] with on = "foot" and to = "table" ties them' in notes
    tied = report(case(folder, tie=[{"on": "foot", "to": "table"}]))
    assert not any("of two bodies touch" in note for note in tied.notes)
    assert "tie 'tie_foot': 9 mm^2, gap at most 0 mm, which remains" in tied.information
    assert len(tied.bodies) == 1


BOXES = """\
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, 4, 4, 2};
Box(2) = {0, 0, 2, 4, 4, 2};
Physical Volume("lower") = {1};
Physical Volume("upper") = {2};
"""


@pytest.mark.long
def test_solids_of_cad_that_are_tied(folder: Path) -> None:
    """That meshes are not joined is said where no tie joins them, by `check`, `look` and `run`."""
    made(lambda: (folder / "boxes.geo").write_text(BOXES))
    mesh, told = {"file": "boxes.geo", "unit": "mm", "size": 2}, "meshes are not joined there"
    for tie, known in (([], True), ([{"on": "foot", "to": "table"}], False)):
        asked = case(folder, mesh=mesh, tie=tie)
        made(lambda asked=asked: (folder / "boxes.toml").write_text(asked.to_toml()))
        shown = look_at(folder / "boxes.toml", picture=None, trust=True).notes
        assert any(told in note for note in shown) == known
        assert any(told in note for note in report(asked).notes) == known
        body = asked.read_body(MPI.COMM_WORLD)
        notes = [*log_notes(asked, body), *check_problem(asked, asked.make_problem(body))[0]]
        assert any(told in note for note in notes) == known


def test_one_tie_between_three_solids(folder: Path) -> None:
    """Two touching ones that no tie joins are told of, those that one joins are not."""
    third = "Box(3) = {0, 0, 4, 4, 4, 2};\n"
    text = BOXES.replace("Phys", f'{third}Physical Volume("lid") = {{3}};\nPhys', 1)
    made(lambda: (folder / "three.geo").write_text(text))
    asked = case(
        folder,
        mesh={"file": "three.geo", "unit": "mm", "size": 2},
        tie=[{"on": "foot", "to": "table"}],
    )
    told = [note for note in report(asked).notes if "meshes are not joined there" in note]
    assert len(told) == 1
    assert "'lid' and 'upper' touch" in told[0]


def test_parts_that_lie_opposite_nothing_are_noted(folder: Path) -> None:
    """Of the larger face, tied to the smaller one, 7 of 16 mm^2."""
    notes = report(case(folder, tie=[{"on": "table", "to": "foot"}])).notes
    assert any("44 % of 'table' are not tied: nothing of 'foot' lies opposite" in n for n in notes)


def test_run_gives_the_force_of_a_tie(folder: Path) -> None:
    """All that holds the bottom goes through it, whichever side follows; the audit passes."""
    for on, to, sign in (("foot", "table", 1), ("table", "foot", -1)):
        asked = case(folder, tie=[{"on": on, "to": to, "name": "glue"}])
        states = [s for s in run(asked, output=folder / f"{on}_out") if isinstance(s, State)]
        forces = states[-1].reactions
        np.testing.assert_allclose(forces["glue"], sign * forces["bottom"], rtol=1e-9, atol=1e-6)
        assert states[-1].audit is not None
        assert states[-1].audit.verdict == "pass"


def test_wrong_ties_are_refused(folder: Path) -> None:
    """Names, keys, a surface that follows itself, and explicit schemes, each with its key."""
    for tie, text in (
        ({"on": "fot", "to": "table"}, r"tie\[0\]\.on: there is no surface 'fot'.*foot"),
        ({"on": "foot", "to": "upper"}, r"tie\[0\]\.to: 'upper' is a region"),
        ({"on": "foot"}, r"tie\[0\]\.to"),
        ({"on": "foot", "to": ["table", "foot"]}, r"tie\[0\]\.to: 'foot' is tied to itself"),
        ({"on": "foot", "to": "table", "toleranc": 1}, r"tie\[0\].*'tolerance'"),
        ({"on": "foot", "to": "bottom"}, r"tie\[0\]\.on: .* are 2 mm apart"),
    ):
        with pytest.raises(InputError, match=text):
            report(case(folder, tie=[tie]))
    with pytest.raises(InputError, match=r"tie\[0\]: explicit schemes"):
        report(
            case(
                folder,
                tie=[{"on": "foot", "to": "table"}],
                dynamics={"scheme": "central-differences", "end": 1e-6},
                materials={"steel": {**TABLES["materials"]["steel"], "density": 7850}},
            )
        )
