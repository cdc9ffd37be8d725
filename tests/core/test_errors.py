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
