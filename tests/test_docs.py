"""The documentation is built without a warning, and can be searched without a network."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from conftest import ROOT
from mpi4py import MPI

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs one process")


@pytest.mark.long
def test_site(tmp_path: Path) -> None:
    """All pages are there; nothing in them comes from elsewhere."""
    done = subprocess.run(
        [ROOT / "docs/build", tmp_path], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "arruda" in (tmp_path / "searchindex.js").read_text()
    pages = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.html")}
    made = {"reference/case.html", "reference/messages.html", "reference/commands.html"}
    assert {"index.html", "search.html", "guide/mesh.html", "laws/yeoh.html", *made} <= pages
    for page in pages:
        text = (tmp_path / page).read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="https?:', text), page
    keys = (tmp_path / "reference/case.html").read_text(encoding="utf-8")
    assert "Mass per reference volume" in keys
