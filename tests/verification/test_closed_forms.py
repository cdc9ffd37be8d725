"""Over two hundred cases with closed forms, as a user types them, see `helpers.closed_forms`.

Each ends right within the error that its mesh or time step leaves, with an audit that passes, or
says what is wrong; none ends wrong with `pass`.
"""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from helpers.closed_forms import ROWS, Answers, Row
from helpers.further_closed_forms import FURTHER
from mpi4py import MPI

from dolfin_elastic import Case, run
from dolfin_elastic.core.parallel import on_root

EVERY = [*ROWS, *FURTHER]


def test_the_table() -> None:
    """At least two hundred rows, each with a name of its own."""
    assert len(EVERY) >= 200
    assert len({row.name for row in EVERY}) == len(EVERY)


@pytest.mark.sample(3)
@pytest.mark.parametrize("row", EVERY, ids=lambda row: row.name)
def test_closed_form(row: Row, folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The known numbers, or a word."""
    if row.geo:
        on_root(MPI.COMM_WORLD, lambda: (folder / "body.geo").write_text(row.geo) and None)
    output = {"fields": ["displacement"], **row.case.get("output", {})}
    if {"modal", "buckling"} & row.case.keys():
        output = {}
    case = Case.from_dict({**row.case, "output": output}, folder)
    answers = Answers()
    with caplog.at_level(logging.WARNING):
        for found in run(case, output=folder / "out"):
            answers.states.append(found)
    off = {key: answers.read(key) / value - 1 for key, value in row.numbers().items()}
    print(row.name, off)
    right = all(abs(error) <= row.within for error in off.values())
    assert right == (not row.says), off
    if row.says and MPI.COMM_WORLD.rank == 0:
        assert row.says in caplog.text
    audit = getattr(answers.states[-1], "audit", None)
    if audit is not None:
        assert audit.verdict_so_far == "pass", audit
