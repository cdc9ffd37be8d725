"""First runs of people who have read the README alone: from a file of their own to a picture.

A folder each: the case, and the commands in their order.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from helpers.bodies import drawing
from helpers.cad import angle, write
from helpers.processes import clean_environment
from matplotlib.image import imread
from mpi4py import MPI

STRANGERS = sorted(path.parent for path in Path(__file__).parent.glob("*/case.toml"))
MOST_COMMANDS, MOST_LINES = 10, 25
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="runs programs of its own")


def figure(path: Path) -> None:
    """A mesh of a figure of 30 cm: a body and a head of two balls, on a flat bottom."""
    with drawing() as gmsh:
        occ = gmsh.model.occ
        body, head = occ.addSphere(0, 0, 8, 10), occ.addSphere(0, 0, 22, 7)
        both, _ = occ.fuse([(3, body)], [(3, head)])
        occ.intersect(both, [(3, occ.addBox(-20, -20, 0, 40, 40, 40))])
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 3.0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 4.0)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


FILES: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "animator": ("figure.msh", figure),
    "engineer": ("bracket.step", lambda path: write(path, angle)),
}
"""Own file of each, and what makes it; a box needs none."""


@pytest.mark.long
@pytest.mark.parametrize("stranger", STRANGERS, ids=lambda path: path.name)
def test_from_the_file_to_the_picture(stranger: Path, tmp_path: Path) -> None:
    """Few lines and commands, all of which end well and warn of nothing; the picture shows it."""
    folder = tmp_path / stranger.name
    copytree(stranger, folder)
    if stranger.name in FILES:
        name, make = FILES[stranger.name]
        make(folder / name)
    lines = [line for line in (folder / "case.toml").read_text().splitlines() if line.strip()]
    commands = (folder / "commands").read_text().splitlines()
    assert len(lines) <= MOST_LINES
    assert len(commands) <= MOST_COMMANDS
    path = f"{ROOT / 'docker/bin'}{os.pathsep}{os.environ['PATH']}"
    for command in commands:
        done = subprocess.run(
            command.split(),
            cwd=folder,
            env={**clean_environment(), "PATH": path, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        told = f"{command}\n{done.stdout}\n{done.stderr}"
        assert done.returncode == 0, told
        assert not re.search(r"warning|error:|not known", done.stdout + done.stderr), told
    picture = imread(folder / "picture.png")[..., :3]
    assert np.ptp(picture, axis=(0, 1)).max() > 0.5, "it is blank"
    # The colours of the stress or displacement, not grey lines alone.
    assert (np.ptp(picture, axis=2) > 0.3).mean() > 0.02, "the body is not on it"
