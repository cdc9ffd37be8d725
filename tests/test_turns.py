"""Parameters of long lists take turns."""

from __future__ import annotations

from datetime import date
from types import SimpleNamespace
from typing import Any, cast

from suite.selection import _spread
from suite.turns import first_of, week


def group(count: int) -> list[Any]:
    """Items of a test whose parameters are all unlike."""
    return [
        SimpleNamespace(nodeid=f"a.py::test[{i}]", callspec=SimpleNamespace(params={"i": i}))
        for i in range(count)
    ]


def test_each_parameter_has_its_turn() -> None:
    """Over 60 turns each of 35 is among the ten several times; without one, the first ten are."""
    items = group(35)
    seen = dict.fromkeys(range(35), 0)
    for turn in range(60):
        chosen = _spread(items, 10, f"{turn:x}")
        assert len(chosen) == 10
        assert [one.nodeid for one in chosen] == [
            one.nodeid for one in _spread(items, 10, f"{turn:x}")
        ]
        for one in chosen:
            seen[cast("Any", one).callspec.params["i"]] += 1
    assert min(seen.values()) >= 3
    assert _spread(items, 10) == items[:10]
    assert _spread(items[:7], 10, "a") == items[:7]


def test_the_choice_is_that_of_any_process() -> None:
    """No hash of Python's own, which each process seeds anew."""
    assert first_of("0123456789", "a.py::test", 35) == 20
    assert first_of("", "a.py::test", 35) == 0


def test_the_turn_is_that_of_the_week() -> None:
    assert week(date(2026, 11, 30)) == week(date(2026, 12, 6)) == "2026-W49"
    assert week(date(2026, 12, 7)) == "2026-W50"
