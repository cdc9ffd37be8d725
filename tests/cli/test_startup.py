"""What the commands import: their start is nothing but imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.processes import clean_environment

OTHERS = [
    *("scipy", "gmsh", "meshio", "pyvista", "matplotlib", "pint"),
    *("urllib.request", "http.client", "ssl", "xml.sax", "slepc4py.SLEPc"),
    "dolfin_elastic.mesh.formats.cad.faces",
    "dolfin_elastic.mesh.formats.raw",
    "dolfin_elastic.model.materials.laws.ogden",
    "dolfin_elastic.model.materials.user",
    "dolfin_elastic.solvers.dynamics.dynamics",
    "dolfin_elastic.solvers.dynamics.schemes",
    "dolfin_elastic.solvers.eigen.modal",
    "dolfin_elastic.solvers.statics.arc_length",
    "dolfin_elastic.solvers.diagnostics.diagnose",
    "dolfin_elastic.results.scene.pictures",
]
"""What no plain static case needs."""
SLOW = [*OTHERS, "h5py"]
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
[[load]]
kind = "traction"
on = "right"
value = [0, 0, "-13 kPa"]
"""
SWEEP = ["sweep", "case.toml", "--quiet", "--set", "materials.rubber.E=1 MPa,2 MPa"]
LIST = (
    "import sys; from dolfin_elastic.cli.app import guarded; code = guarded(); print(*sys.modules)"
)
BUILT = """
from dolfin_elastic.cli.app import guarded
code = guarded()
from dolfin_elastic.core.schema import Record
def below(kind):
    return {kind}.union(*map(below, kind.__subclasses__()))
print(*(kind.__name__ for kind in below(Record) if kind.__pydantic_complete__))
"""


@pytest.mark.parametrize(
    ("arguments", "unwanted"),
    [
        (["--help"], ["numpy", "mpi4py", "petsc4py", "dolfinx", "ufl", "pydantic", *SLOW]),
        (["check", "case.toml"], SLOW),
        (["run", "case.toml", "--quiet"], ["dolfin_elastic.case.check.report", *OTHERS]),
        (SWEEP, ["pint", "scipy.sparse", "scipy.stats", "pyvista"]),
    ],
)
@pytest.mark.usefixtures("serial_only")
def test_nothing_is_imported_that_is_not_needed(arguments, unwanted, tmp_path: Path):
    """Help needs no numerics, check, run and sweep of a plain static case what they are about.

    Typer imports rich by itself, which is left as it is.
    """
    if arguments[0] in (
        "run",
        "sweep",
    ):  # compiles forms first, for which setuptools imports what it likes
        listed(LIST, arguments, tmp_path)
    modules = listed(LIST, arguments, tmp_path)
    assert "dolfin_elastic" in modules
    assert sorted(modules & set(unwanted)) == []


@pytest.mark.usefixtures("serial_only")
def test_only_tables_that_are_given_have_schemas(tmp_path: Path):
    """Those of the others take longer than reading the case."""
    built = listed(BUILT, ["check", "case.toml"], tmp_path)
    assert {"Case", "Box", "NeoHookean", "Support"} <= built
    others = {"Output", "CheckpointSettings", "LinearSettings", "DynamicsSettings", "Periodic"}
    assert sorted(built & {*others, "ModalSettings", "LocalSize", "Rectangle", "Picture"}) == []


def listed(code: str, arguments: list[str], folder: Path) -> set[str]:
    """What code prints on its last line, in a process of its own.

    Args:
        code: Runs a command of the command line.
        arguments: Of this command.
        folder: Where it runs; holds the case.
    """
    (folder / "case.toml").write_text(CASE)
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.splitlines()[-1].split())
