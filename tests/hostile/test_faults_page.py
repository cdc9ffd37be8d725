"""The table of faults names tests that exist, and each line has one."""

from __future__ import annotations

import re

from conftest import ROOT

LINES = [
    line
    for line in (ROOT / "docs/faults.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| fault")
]
TEST = re.compile(r"`([\w/]+\.py)::(\w+)`")


def test_each_line_is_held() -> None:
    """By a test of this name in this file."""
    assert len(LINES) > 35
    for line in LINES:
        named = TEST.findall(line.rsplit("|", 2)[1])
        assert named, line
        for file, name in named:
            text = (ROOT / "tests" / file).read_text(encoding="utf-8")
            assert f"\ndef {name}(" in text, f"{file}::{name}"
