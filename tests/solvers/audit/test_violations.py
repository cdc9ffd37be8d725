"""What a run's audit tells in the end: of each check the worst, with its time."""

from __future__ import annotations

import json
import logging

import pytest
from mpi4py import MPI

from dolfin_elastic.solvers.audit.violations import Violation, WorstViolations


def test_the_worst_of_each_check_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """The first one was; a failure is worse than any size, and told first."""
    run = WorstViolations()
    with caplog.at_level(logging.WARNING, logger="dolfin_elastic"):
        run.add({"force": Violation("2 % left", 0.02)}, "t = 1 s")
        assert run.texts() == ("2 % left (t = 1 s)",)
        run.add(
            {"force": Violation("1 % left", 0.01), "energy": Violation("lost 90 %", 0.9)}, "t = 2 s"
        )
        assert run.verdict() == "warn"
        run.add({"energy": Violation("25 % new", 0.25, fails=True)}, "t = 3 s")
        run.add({"force": Violation("9 % left", 0.09)}, "t = 4 s")
        run.add({"energy": Violation("lost 95 %", 0.95)}, "t = 5 s")
    told = (
        "25 % new (worst at t = 3 s, since t = 2 s)",
        "9 % left (worst at t = 4 s, since t = 1 s)",
    )
    assert (run.texts(), run.verdict()) == (told, "fail")
    if MPI.COMM_WORLD.rank == 0:  # each once, and the failure
        assert [record.getMessage() for record in caplog.records] == [
            "audit: 2 % left (t = 1 s)",
            "audit: lost 90 % (t = 2 s)",
            "audit: 25 % new (worst at t = 3 s, since t = 2 s)",
        ]
    again = WorstViolations()
    again.restore(json.loads(json.dumps(run.restart_state())))
    assert (again.texts(), again.verdict()) == (told, "fail")


def test_checkpoints_of_before() -> None:
    """They hold the first violations as texts."""
    run = WorstViolations()
    assert (run.texts(), run.verdict()) == ((), "pass")
    run.restore({"force": "2 % left (load factor 0.5)"})
    assert (run.texts(), run.verdict()) == (("2 % left (load factor 0.5)",), "warn")
