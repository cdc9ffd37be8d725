"""Parameters of long lists take turns."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from suite.selection import _spread
from suite.turns import commit, first_of


def group(count: int) -> list[Any]:
    """Items of a test whose parameters are all unlike."""
    return [
        SimpleNamespace(nodeid=f"a.py::test[{i}]", callspec=SimpleNamespace(params={"i": i}))
        for i in range(count)
    ]


def test_each_parameter_has_its_turn() -> None:
    """Over 60 commits each of 35 is among the ten several times; without one, the first ten are."""
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


HASH = "a" * 40


@pytest.mark.parametrize("kind", ["branch", "packed", "detached", "linked", "none"])
def test_the_commit_is_read_without_git(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / ".git"
    if kind == "linked":
        folder.write_text(f"gitdir: {tmp_path}/main/.git/worktrees/w\n")
        main = tmp_path / "main" / ".git"
        folder = main / "worktrees" / "w"
        (main / "refs" / "heads").mkdir(parents=True)
        (main / "refs" / "heads" / "b").write_text(f"{HASH}\n")
        folder.mkdir(parents=True)
        (folder / "commondir").write_text("../..\n")
    elif kind != "none":
        (folder / "refs" / "heads").mkdir(parents=True)
    if kind == "branch":
        (folder / "refs" / "heads" / "b").write_text(f"{HASH}\n")
    if kind == "packed":
        (folder / "packed-refs").write_text(f"# pack-refs\n{HASH} refs/heads/b\n")
    if kind != "none":
        (folder / "HEAD").write_text(f"{HASH}\n" if kind == "detached" else "ref: refs/heads/b\n")
    assert commit(tmp_path) == ("" if kind == "none" else HASH[:10])
