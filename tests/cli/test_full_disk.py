"""A disk that fills up amid a run: code 4, whole files, and `restart` once there is room."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import pytest
from helpers.processes import clean_environment
from helpers.runs import case, check_same, history
from mpi4py import MPI

from dolfin_elastic import run

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
INSIDE = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
SCRIPT = """\
mount -t tmpfs -o {full} none disk || exit 77
{program} run case.toml -q --output disk/out 2>err; echo $? >code
cp -r disk/out failed
mount -o remount,{room} disk
{program} restart disk/out -q 2>err2; echo $? >code2
cp -r disk/out completed
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("full", "room"), [("size=1200k", "size=99m"), ("size=99m,nr_inodes=14", "nr_inodes=9999")]
)
def test_full_disk(full: str, room: str, tmp_path: Path) -> None:
    """Of bytes and of inodes, in a small file system of its own."""
    whole = case(statics={"steps": 30}, output={"checkpoint": {"every": 1}})
    (tmp_path / "case.toml").write_text(whole.to_toml())
    (tmp_path / "disk").mkdir()
    program = f"{sys.executable} -m dolfin_elastic"
    script = SCRIPT.format(full=full, room=room, program=program)
    ended = subprocess.run(
        [*INSIDE, script],
        cwd=tmp_path,
        env=clean_environment(),
        check=False,
        capture_output=True,
        timeout=200,
    )
    if not (tmp_path / "code").exists():
        pytest.skip(f"no file system can be mounted here: {ended.stderr.decode().strip()}")
    failed = tmp_path / "failed"
    error = (tmp_path / "err").read_text()
    assert (tmp_path / "code").read_text() == "4\n", error
    assert "no space left on device" in error
    assert "Traceback" not in error
    assert json.loads((failed / "summary.json").read_text())
    for file in failed.rglob("*.xdmf"):
        ET.parse(file)
    for file in failed.rglob("*.h5"):
        if not file.name.startswith("."):
            with h5py.File(file) as h5:
                assert [*h5]
    rows = (failed / "history.csv").read_text()
    assert rows.endswith("\n")
    assert len({line.count(",") for line in rows.splitlines()}) == 1
    assert (tmp_path / "code2").read_text() == "0\n", (tmp_path / "err2").read_text()
    for _ in run(whole, output=tmp_path / "whole"):
        pass
    check_same(history(tmp_path / "completed"), history(tmp_path / "whole"), near=1e-7)
