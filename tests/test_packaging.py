"""What is imported is what is declared: pyproject.toml and docker/packages.txt."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest
from mpi4py import MPI

ROOT = Path(__file__).parents[1]

SYSTEM = {"dolfinx", "petsc4py", "slepc4py", "mpi4py", "gmsh", "basix", "ffcx", "ufl"}
"""Modules whose packages on PyPI do not fit together with MPI; some of them are DOLFINx's own."""

BROUGHT = {
    "annotated_types": "pydantic",
    "pydantic_core": "pydantic",
    "click": "typer",
    "markupsafe": "jinja2",
    "PIL": "matplotlib",
    "vtkmodules": "pyvista",
}
"""Modules that come with another package and are of its version."""

OPTIONAL = {"lz4", "ipctk", "manifold3d", "nibabel", "pandas", "pydicom", "pytetwild", "pxr"}
"""Modules whose absence has a message: Debian has lz4, nibabel and pydicom, PyPI the others.
Without pandas the table of a sweep is a dictionary of columns."""

UNDER_OTHER_NAMES = {"python3-dev", "python3-h5py-mpi", "python3-imageio-ffmpeg"}
"""Packages that no module imports by name: compiled forms, h5py and imageio need them."""

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="reads files only")


def imported(folder: str) -> set[str]:
    """Top-level names of foreign modules that a folder imports."""
    found = set()
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                found.add(node.module.partition(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.importorskip":
                found.add(ast.literal_eval(node.args[0]).partition(".")[0])
    return found - sys.stdlib_module_names - {"dolfin_elastic"}


@pytest.mark.long
def test_dependencies_are_the_imports() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {re.split(r"[<>=~! \[]", line)[0] for line in project["dependencies"]}
    needed = {BROUGHT.get(name, name) for name in imported("dolfin_elastic") - SYSTEM - OPTIONAL}
    assert declared == needed


@pytest.mark.long
def test_packages_of_the_environment_are_used() -> None:
    text = (ROOT / "docker/packages.txt").read_text(encoding="utf-8")
    used, _, _ = text.partition("# --- installing and testing ---")
    packages = set(re.findall(r"^(python3-\S+)", used, re.MULTILINE))
    modules = imported("dolfin_elastic") | imported("tests")
    wanted = {f"python3-{BROUGHT.get(name, name)}" for name in modules}
    assert packages - wanted == UNDER_OTHER_NAMES
