"""What the commands import: their start is nothing but imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.processes import clean_environment

SLOW = [
    *("scipy", "h5py", "gmsh", "meshio", "pyvista", "matplotlib", "pint"),
    "dolfin_elastic.solvers.dynamics.dynamics",
    "dolfin_elastic.solvers.eigen.modal",
]
CASE = """
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.45
[[support]]
on = "left"
displacement = [0, 0, 0]
"""
LIST = (
    "import sys; from dolfin_elastic.cli.app import guarded; code = guarded(); print(*sys.modules)"
)


@pytest.mark.parametrize(
    ("arguments", "unwanted"),
    [
        (["--help"], ["numpy", "mpi4py", "petsc4py", "dolfinx", "ufl", "pydantic", "rich", *SLOW]),
        (["check", "case.toml"], ["markdown_it", *SLOW]),
    ],
)
@pytest.mark.usefixtures("serial_only")
def test_nothing_is_imported_that_is_not_needed(arguments, unwanted, tmp_path: Path):
    """Help needs no numerics, and the check of a plain static case what it is about."""
    (tmp_path / "case.toml").write_text(CASE)
    command = [sys.executable, "-c", LIST, *arguments]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    modules = set(done.stdout.splitlines()[-1].split())
    assert "dolfin_elastic" in modules
    assert sorted(modules & set(unwanted)) == []
