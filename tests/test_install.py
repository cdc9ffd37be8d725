"""`pip install --no-deps .` into a virtual environment of Debian, as the documentation says."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT
from helpers.processes import clean_environment
from mpi4py import MPI

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs one process")


def done(command: list[str | Path], folder: Path, **variables: str) -> str:
    """What a command prints; it must end well."""
    environment = {k: v for k, v in clean_environment().items() if k != "PYTHONPATH"}
    found = subprocess.run(
        command,
        cwd=folder,
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


@pytest.mark.long
def test_virtual_environment(tmp_path: Path) -> None:
    """A wheel is built, installed and used; nothing is fetched, all packages are Debian's."""
    offline = ["--no-index", "--no-deps", "--disable-pip-version-check", "-q"]
    source = tmp_path / "source"  # setuptools leaves a folder `build` beside what it builds
    done(["git", "-c", "safe.directory=*", "clone", "-q", ROOT, source], tmp_path)
    pip = [sys.executable, "-m", "pip"]
    done([*pip, "wheel", *offline, "--no-build-isolation", "-w", tmp_path, source], tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.stat().st_size < 2.5e6  # the code alone: 2.05 MB; a picture or a mesh is more
    names = zipfile.ZipFile(wheel).namelist()
    assert {f"dolfin_elastic/cli/tools/templates/bracket.{end}" for end in ("toml", "geo")} <= {
        *names
    }
    code = [
        file
        for file in (ROOT / "dolfin_elastic/core/native").iterdir()
        if file.suffix in (".c", ".h")
    ]
    assert code
    assert {str(file.relative_to(ROOT)) for file in code} <= set(names)
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]
    done([sys.executable, "-m", "venv", "--system-site-packages", tmp_path / "env"], tmp_path)
    done([tmp_path / "env/bin/pip", "install", *offline, wheel], tmp_path)
    program, work = tmp_path / "env/bin/dolfin-elastic", tmp_path / "work"
    work.mkdir()
    done([program, "new", "reed.toml", "--kind", "modal"], work)
    path = f"{tmp_path / 'env/bin'}{os.pathsep}{os.environ['PATH']}"
    done(["mpirun", "-n", "2", "dolfin-elastic", "run", "reed.toml"], work, PATH=path)
    assert (work / "reed_results/modes.csv").exists()
    where = "import dolfin_elastic; print(dolfin_elastic.__file__)"
    assert done([tmp_path / "env/bin/python", "-c", where], work).startswith(str(tmp_path))
