"""Case files that would hang, or fill the memory, are refused at once, by file and key."""

from __future__ import annotations

import os
import re
import threading
import time
from pathlib import Path

import meshio
import pytest
from mpi4py import MPI

from dolfin_elastic import box_body, read_case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.files import memory

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="read on rank 0 alone")
MESH = "box = {size = [1, 1, 1], cells = [1, 1, 1]}\n"
CASE = """\
[mesh]
{mesh}
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [0, 0, "10 kPa"]
{load}
{rest}
"""
STATICS = "[statics]\nsteps = 2\n"


def case(mesh: str = MESH, load: str = "", rest: str = STATICS) -> str:
    return CASE.format(mesh=mesh, load=load, rest=rest)


HOSTILE = {
    "curve-pipe": (
        case(load='curve = {file = "pipe"}'),
        r"load\[0\].curve: pipe: this is a pipe, not a file",
    ),
    "curve-device": (
        case(load='curve = {file = "/dev/zero"}'),
        r"load\[0\].curve: /dev/zero: this is a device, not a file",
    ),
    "mesh-pipe": (case('file = "pipe.msh"'), r"mesh.file: .*this is a pipe, not a file"),
    "mesh-device": (case('file = "zero.msh"'), r"mesh.file: .*this is a device, not a file"),
    "mesh-nul": (case('file = "a\\u0000b.msh"'), r"mesh.file: a text with the character NUL"),
    "supports": (
        case() + '[[support]]\non = "right"\n' * 3000,
        r"support: 3001 tables are too many; at most",
    ),
    "folder-300": (
        case() + f'[output]\nfolder = "{"x" * 300}"\n',
        r"output.folder: .*name too long",
    ),
    "folder-nul": (case() + '[output]\nfolder = "a\\u0000"\n', r"output.folder: a text with .*NUL"),
    "end-statics": (case(rest="[statics]\nend = 1e308"), r"statics.end"),
    "end-dynamics": (
        case(rest='[dynamics]\nend = 1e308\nscheme = "central-differences"').replace(
            "nu = 0.3", 'nu = 0.3\ndensity = "1000 kg/m^3"'
        ),
        r"dynamics.end",
    ),
    "cells": (
        case("box = {size = [1, 1, 1], cells = [100000, 100000, 100000]}"),
        r"mesh.box.*6e\+15 elements are too many",
    ),
    "digits": (case() + f"[output]\ncheckpoint = 1{'0' * 400}\n", r"output.checkpoint: an integer"),
    "digits-list": (
        case(f"box = {{size = [1, 1, 1], cells = [1, 1, 1{'0' * 30}]}}\n"),
        r"cells\[2\]",
    ),
    "digits-many": (case() + f"x = 1{'0' * 5000}\n", r"an integer has too many digits"),
    "deep": (case() + "x = " + "[" * 5000 + "]" * 5000, r"nested more than 20 deep"),
    "deep-tables": (case() + ".".join(["a"] * 5000) + " = 1", r"nested more than 20 deep"),
    "name": (
        case().replace("materials.rubber", f"materials.{'r' * 5000}"),
        r"materials: a name of 5000 characters is too long, rrr",
    ),
    "probe": (
        case() + f"[output.probes]\n{'p' * 5000} = [0, 0, 0]\n",
        r"output.probes: a name of 5000 characters",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_refused_at_once(name: str, tmp_path: Path) -> None:
    """Within 5 s, and with a message that is not as long as what it is about."""
    text, message = HOSTILE[name]
    (tmp_path / "case.toml").write_text(text)
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "pipe.msh")
    (tmp_path / "zero.msh").symlink_to("/dev/zero")
    begin, found = time.monotonic(), []

    def look() -> None:
        try:
            report(read_case(tmp_path / "case.toml"))
        except InputError as error:
            found.append(str(error))

    # A thread of its own: a pipe that is waited for would hang the tests.
    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    thread.join(20.0)
    assert not thread.is_alive()
    assert time.monotonic() - begin < 5.0
    assert len(found) == 1
    assert re.search(message, found[0]), found[0][:500]
    assert len(found[0]) < 2000
    assert "case.toml" in found[0]


def test_a_case_that_is_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "case.toml")
    with pytest.raises(InputError, match=r"case.toml: this is a pipe, not a file"):
        read_case(tmp_path / "case.toml")
    with pytest.raises(InputError, match=r"/dev/zero: this is a device, not a file"):
        read_case("/dev/zero")


MEMORY = {
    "box": ("box = {size = [1, 1, 1], cells = [20, 20, 20]}", "mesh.box: 4.8e.04 elements need"),
    "rectangle": (
        "rectangle = {size = [1, 1], cells = [200, 200]}",
        "mesh.rectangle: 8e.04 elements need",
    ),
    "refine": (
        "box = {size = [1, 1, 1], cells = [5, 5, 5]}\nrefine = 2",
        "mesh.box: 4.8e.04 elements need",
    ),
    "local": (
        'box = {size = [1, 1, 1], cells = [4, 4, 4]}\nrefine = [{on = "all", size = 0.1}]',
        r"mesh.refine\[0\].size: .* elements need",
    ),
    "file": ('file = "box.vtu"', "mesh.file: .* elements need"),
}
"""Mesh of a case, and the message of a machine with little memory."""


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", MEMORY)
def test_refused_for_want_of_memory(
    kind: str, degree: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the kernel ends the program; the same case fits into more memory."""
    mesh, message = MEMORY[kind]
    if kind == "file":
        made = box_body(size=[1, 1, 1], cells=[12, 12, 12], comm=MPI.COMM_SELF).mesh.geometry
        cells = [("tetra", made.dofmap)]
        meshio.Mesh(made.x, cells).write(tmp_path / "box.vtu")
    regions = "[regions]\nall = {box = [[0, 0, 0], [1, 1, 1]]}\n" if kind == "local" else ""
    text = case(f"{mesh}\ndegree = {degree}", rest=regions + STATICS)
    (tmp_path / "case.toml").write_text(
        text.replace('[0, 0, "10 kPa"]', '[0, "10 kPa"]') if kind == "rectangle" else text
    )
    read = read_case(tmp_path / "case.toml")
    monkeypatch.setattr(memory, "free_memory", lambda: 1e12)
    body = read.read_body()
    assert body.num_cells > 1000
    monkeypatch.setattr(memory, "free_memory", lambda: 5e6)
    with pytest.raises(InputError, match=message) as caught:
        read.read_body()
    told = str(caught.value)
    assert told.startswith(f"{tmp_path / 'case.toml'}: mesh."), told
    assert "5 MB are free" in told
    if kind in ("box", "rectangle", "refine"):
        assert ("mesh.degree = 1" in told) == (degree == 2)
