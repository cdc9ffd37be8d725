"""Which commands Typer is told of: making one takes time."""

from __future__ import annotations

import sys

import pytest

from dolfin_elastic.cli import app


@pytest.mark.parametrize(
    ("words", "one"), [(["check", "a.toml"], "check"), (["run", "--help"], "run")]
)
def test_only_the_command_that_is_called_is_made(
    words: list[str], one: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", *words])
    every = list(app.app.registered_commands)
    with app._only_what_is_asked_for():
        assert [c.callback.__name__ for c in app.app.registered_commands if c.callback] == [one]
    assert app.app.registered_commands == every


@pytest.mark.parametrize("words", [[], ["rum"], ["--help"], ["--version"]])
def test_all_commands_are_made_for_who_asks_for_none(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", *words])
    every = list(app.app.registered_commands)
    with app._only_what_is_asked_for():
        assert app.app.registered_commands == every
    assert len(every) > 10
