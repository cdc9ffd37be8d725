"""The current folder decides nothing: no file is looked at there but the case and what it names.

Files such as .petscrc or ffcx_options.json come with any folder from elsewhere.  They loaded native
code, overwrote files, hung the program, or changed the compiled forms, and with them the results.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from helpers.cube import cube
from helpers.processes import PROGRAM, cli, started
from helpers.traced import traced

pytestmark = pytest.mark.usefixtures("serial_only")

CASE = cube()
MODES = """\
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
[materials.m]
law = "linear-elastic"
E = 1e6
nu = 0.3
density = 1000
[[support]]
on = "left"
[modal]
count = 1
"""
SCRIPT = """\
from dolfin_elastic import LinearElastic, Problem, Statics, Support, Traction, box_body

body = box_body(size=[1, 1, 1], cells=[1, 1, 1])
law, held = LinearElastic(E=1e6, nu=0.3), [Support(on="left")]
problem = Problem(body, law, supports=held, loads=[Traction(on="right", value=[1, 0, 0])])
*_, state = Statics(problem, steps=1).steps()
print(state.energies["strain"])
"""
GEO = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n'
NODES = {1: (0, 0, 0), 2: (1, 0, 0), 3: (0, 1, 0), 4: (0, 0, 1)}
MESH = "*NODE\n" + "".join(f"{i}, {x}, {y}, {z}\n" for i, (x, y, z) in NODES.items())
MESH += "*ELEMENT, TYPE=C3D4, ELSET=ALL\n1, 1, 2, 3, 4\n"
LOOSE = {"table_atol": 0.6, "table_rtol": 0.6}
"""Options of FFCx with which the box has neither a reaction nor an energy."""
ENERGY = 0.5e-6
"""Strain energy [J] of a free bar under this load, F^2 L / (2 E A); at a held end it has less."""
NAMES = (
    *(".petscrc", "petscrc", "petsc.cfg", "slepc.cfg", "ucx.conf", "matplotlibrc"),
    *("ffcx_options.json", "dolfinx_jit_options.json", "pybuilddir.txt", "setup.cfg"),
)
"""Files of settings that libraries look for in the current folder."""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A current folder with a case, a script and meshes."""
    folder = tmp_path / "here"
    folder.mkdir()
    texts = {"case.toml": CASE, "modes.toml": MODES, "script.py": SCRIPT, "part.geo": GEO}
    for name, text in (texts | {"mesh.inp": MESH}).items():
        (folder / name).write_text(text)
    return folder


ALLOWED: dict[str, tuple[list[str], set[str]]] = {
    "check": ([*PROGRAM, "check", "case.toml"], {"case.toml", "case_results"}),
    "run": ([*PROGRAM, "run", "case.toml"], {"case.toml", "case_results"}),
    "ranks": (["mpirun", "-n", "2", *PROGRAM, "run", "case.toml"], {"case.toml", "case_results"}),
    "modes": ([*PROGRAM, "run", "modes.toml"], {"modes.toml", "modes_results"}),
    "plot": (
        [*PROGRAM, "plot", "done", "--field", "von_mises", "-o", "p.png"],
        {"done", "p.png", ".p.png.part"},
    ),
    "curve": (
        [*PROGRAM, "plot", "done", "--curve", "step:strain_energy", "-o", "c.png"],
        {"done", "c.png", ".c.png.part", "c.csv", ".c.csv.part"},
    ),
    "report": ([*PROGRAM, "report", "done"], {"done"}),
    "material": ([*PROGRAM, "material", "case.toml", "-o", "curves"], {"case.toml", "curves"}),
    "look": (
        [*PROGRAM, "look", "part.geo", "-o", "look.png"],
        {"part.geo", "look.png", ".look.png.part"},
    ),
    "convert": (
        [*PROGRAM, "convert", "mesh.inp", "m.xdmf"],
        {"mesh.inp", *("m.xdmf", "m.h5", ".m.xdmf.part", ".m.h5.part")},
    ),
    "script": ([sys.executable, "script.py"], {"script.py"}),
}
"""Commands, and what they may look at in the current folder."""
EVERY = ("__pycache__", "__main__.py")


@pytest.mark.long
@pytest.mark.parametrize("name", ALLOWED)
def test_nothing_else_is_looked_at(name: str, files: Path, tmp_path: Path) -> None:
    """Under strace, with all processes that are started, and forms that are compiled anew."""
    assert shutil.which("strace"), "strace is missing: docker/packages.txt has it"
    home = tmp_path / "home"
    home.mkdir()
    variables = {"HOME": str(home), "XDG_CONFIG_HOME": str(home / "config")}
    if name in ("run", "script"):
        variables["XDG_CACHE_HOME"] = str(tmp_path / "cache")
    if name in ("plot", "curve", "report"):
        assert cli("run", "case.toml", "-o", "done", folder=files)[0] == 0
    command, allowed = ALLOWED[name]
    if command[: len(PROGRAM)] == PROGRAM:  # else Python looks for the program here, too
        command = [sys.executable, "-P", *command[1:]]
    command = [word for one in command for word in (["-P", one] if one == "-m" else [one])]
    code, said, paths = traced(command, files, variables)
    assert code == 0, said
    below = {str(path.relative_to(files)) for path in paths if path.is_relative_to(files)}
    assert {one for one in allowed if "part" not in one} & below  # the log is that of the command
    probed = {one for one in below if one.startswith(".dolfin-elastic-")}  # whether it can write
    strange = {one for one in below - probed - {"."} if one.split(os.sep)[0] not in allowed}
    assert strange == set()
    for settings in ("config/ffcx", "config/dolfinx", ".config/ffcx", ".config/dolfinx"):
        assert not [path for path in paths if path.is_relative_to(home / settings)]
    assert home / ".petscrc" not in paths


def poison(folder: Path, *, pipes: bool) -> None:
    """Puts files of settings into a folder: pipes, or what changes results and overwrites files."""
    texts = dict.fromkeys(NAMES, "PETSC_ARCH = /nowhere\n")
    texts |= dict.fromkeys((".petscrc", "petscrc"), "-log_view :victim.txt\n-dll_prepend ./no.so\n")
    texts |= {"ucx.conf": "UCX_LOG_FILE=victim.txt\nUCX_LOG_LEVEL=debug\n"}
    texts |= dict.fromkeys(("ffcx_options.json", "dolfinx_jit_options.json"), json.dumps(LOOSE))
    texts |= {"matplotlibrc": "text.usetex: True\n"}
    for name, text in texts.items():
        if pipes:
            os.mkfifo(folder / name)
        else:
            (folder / name).write_text(text)


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("pipes", [False, True])
def test_settings_of_a_stranger(
    pipes: bool, ranks: int, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results are those without them, nothing is overwritten, and no pipe is waited for."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    home = tmp_path / "config"
    for package, name in (("ffcx", "ffcx_options"), ("dolfinx", "dolfinx_jit_options")):
        (home / package).mkdir(parents=True)
        (home / package / f"{name}.json").write_text(json.dumps(LOOSE))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home))
    poison(files, pipes=pipes)
    (files / "victim.txt").write_text("mine")
    code, out, err = cli("run", "case.toml", folder=files, ranks=ranks)
    assert code == 0, out + err
    with (files / "case_results/history.csv").open() as file:
        *_, last = csv.DictReader(file)
    assert 0.4e-6 < float(last["strain_energy"]) < ENERGY
    with started([sys.executable, "script.py"], files, ranks) as process:
        told = process.communicate(timeout=240)
    assert process.returncode == 0, told[1]
    assert 0.4e-6 < float(told[0].split()[0]) < ENERGY
    assert (files / "victim.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "words",
    [
        ["check", "case.toml"],
        ["material", "case.toml", "-o", "curves"],
        ["look", "part.geo", "-o", "look.png"],
        ["run", "modes.toml"],
        ["info"],
    ],
)
def test_pipes_are_not_waited_for(words: list[str], files: Path) -> None:
    poison(files, pipes=True)
    code, out, err = cli(*words, folder=files)
    assert code == 0, out + err


SUBMODULES = ("core.parallel", "core.compat", "core.jit", "mesh.read", "problem.problem")


@pytest.mark.parametrize(
    "first",
    [
        *(f"import dolfin_elastic.{one}" for one in SUBMODULES),
        "from dolfin_elastic import read_case",
        "import dolfin_elastic; dolfin_elastic.read_case",
        "import mpi4py.MPI; from dolfin_elastic import read_case",
        "import petsc4py; from dolfin_elastic import read_case",
    ],
)
def test_whatever_python_imports_first(first: str, files: Path) -> None:
    """MPI and PETSc have been started without a look at the pipes; then all of it is there."""
    pipes = [name for name in NAMES if not (name == "ucx.conf" and "mpi4py" in first)]
    for name in pipes:
        os.mkfifo(files / name)
    program = f"import os\n{first}\nimport dolfinx, dolfin_elastic.core.jit, petsc4py.PETSc\n"
    program += "from dolfin_elastic.core.startup.slepc import SLEPc\nprint(os.getcwd())"
    with started([sys.executable, "-c", program], files, 1) as process:
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out.strip()) == (0, str(files)), err


def test_options_of_forms_are_overruled(files: Path) -> None:
    """Of who has used FFCx before: his files of options are his own forms' alone."""
    (files / "ffcx_options.json").write_text(json.dumps(LOOSE))
    program = "import ffcx; assert ffcx.get_options()['table_atol'] == 0.6\n" + SCRIPT
    with started([sys.executable, "-c", program], files, 1) as process:
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert 0.4e-6 < float(out.split()[0]) < ENERGY
