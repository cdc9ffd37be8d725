"""Folders that docker/run does not show: what a message says, and what is refused before a run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dolfin_elastic.core.errors import SHOWN, CaseError, check_kept, not_shown, why_no_file


def test_results_that_would_be_thrown_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In a folder that is there inside only; whoever works in such a folder may write there."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.delenv(SHOWN, raising=False)
    check_kept(Path("/tmp/x"), "--output")
    monkeypatch.setenv(SHOWN, str(here))
    check_kept(Path("results"), "output.folder")
    for name in ("/tmp/x", "/var/tmp/x", "/dev/shm/x", "/run/x", "../x"):
        with pytest.raises(CaseError, match=r"--output: docker/run would not keep .*/x: .*BIND=/"):
            check_kept(Path(name), "--output")
    (here / "link").symlink_to("/tmp")
    with pytest.raises(CaseError, match="would not keep /tmp/x"):
        check_kept(Path("link/x"), "--output")
    monkeypatch.chdir(tmp_path)
    check_kept(Path("/tmp/x"), "--output")


def test_a_file_outside_names_what_is_visible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Also of a relative path, which says nothing of where it leads."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv(SHOWN, f"{here}:/repository")
    hint = not_shown("../../F8/ring.geo")
    assert f"only {here}, /repository" in hint
    assert f"DOLFIN_ELASTIC_BIND={tmp_path.parent / 'F8'} in front" in hint
    assert not_shown("ring.geo") == ""


def test_what_is_no_file(tmp_path: Path):
    """Pipes and devices have no end."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"12345")
    found = {name: why_no_file(tmp_path / name, 4) for name in ("pipe", "file", "none", "x" * 300)}
    assert found["pipe"] == "this is a pipe, not a file"
    assert found["file"] == "it has 5 bytes, more than 4"
    assert found["none"] == ""
    assert "name too long" in found["x" * 300]
    assert why_no_file(tmp_path / "file", 5) == ""
    assert why_no_file("/dev/zero", 4) == "this is a device, not a file"
    assert why_no_file(tmp_path, 4) == "this is a folder, not a file"
    assert "NUL" in why_no_file("a\0b", 4)
