"""What is imported first: the same modules, sooner, and nothing left changed behind."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.processes import started

from dolfin_elastic.cli import app, early

EARLY = "from dolfin_elastic.cli import early; early.import_early()\n"
LAUNCHER = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")
SIZES = ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_SIZE")


def told(program: str, folder: Path, ranks: int = 1) -> list[str]:
    """Lines that a program prints after the early imports."""
    with started([sys.executable, "-c", EARLY + program], folder, ranks) as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return out.splitlines()


@pytest.mark.usefixtures("serial_only")
@pytest.mark.skipif(find_spec("dolfinx.utils") is None, reason="newer DOLFINx has none")
def test_utilities_for_numba_are_there_for_who_asks(tmp_path: Path) -> None:
    program = """
import sys, dolfinx
print("dolfinx.utils" in sys.modules, hasattr(dolfinx, "utils"), sys.pycache_prefix)
import dolfinx.utils
print(dolfinx.utils.ctypes_utils is not None, dolfinx.utils.__file__ is not None)
"""
    assert told(program, tmp_path) == ["False False None", "True True"]


@pytest.mark.usefixtures("serial_only")
def test_byte_code_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of modules whose own folders have none, in a cache that the test has for itself."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "")
    for _ in range(2):
        assert told("print('as ever')", tmp_path) == ["as ever"]
    files = list((tmp_path / "cache/dolfin_elastic/python").rglob("dolfinx/mesh.*.pyc"))
    assert len(files) == 1


@pytest.mark.parametrize(
    ("above", "mode", "taken"),
    [(0o755, 0o755, True), (0o775, 0o700, False), (0o755, 0o775, False), (0o777, 0o700, False)],
)
def test_byte_code_that_others_could_write_is_not_taken(
    above: int, mode: int, taken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "dolfin_elastic" / "python"
    folder.mkdir(parents=True)
    folder.chmod(mode)
    folder.parent.chmod(above)
    assert early._byte_code() == (str(folder) if taken else None)


def test_byte_code_needs_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made for nobody else, whatever the user's mask; a link to another one is not taken."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    before = os.umask(0o002)
    try:
        assert early._byte_code() == str(tmp_path / "dolfin_elastic" / "python")
    finally:
        os.umask(before)
    (tmp_path / "dolfin_elastic" / "python").rename(tmp_path / "another")
    (tmp_path / "dolfin_elastic" / "python").symlink_to(tmp_path / "another")
    assert early._byte_code() is None
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert early._byte_code() is None


@pytest.mark.parametrize(
    ("given", "one"),
    [
        ({}, True),
        (dict(zip((*LAUNCHER[:1], *SIZES), "022", strict=True)), True),
        (dict(zip((*LAUNCHER[:1], *SIZES), "042", strict=True)), False),
        ({"SLURM_PROCID": "3"}, False),  # srun without mpirun says nothing of machines here
        ({"PMIX_RANK": "0"}, False),
    ],
)
def test_memory_events_stay_where_there_may_be_a_network(
    given: dict[str, str], one: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (*LAUNCHER, *SIZES):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert early._on_one_machine() == one


@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("ranks", [1, 2])
def test_nothing_waits_for_the_launcher(ranks: int, tmp_path: Path) -> None:
    """Its connection has no delay, and no descriptor is left open."""
    program = """
import os, socket, stat
from contextlib import suppress
def connections():
    for name in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):
            if stat.S_ISSOCK(os.fstat(name).st_mode):
                yield socket.socket(fileno=os.dup(name))
def tcp():
    return [one for one in connections() if one.family == socket.AF_INET]
before = len(os.listdir("/proc/self/fd"))
early._send_at_once()
print(len(os.listdir("/proc/self/fd")) - before,
      all(one.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) for one in tcp()),
      os.environ["UCX_MEM_EVENTS"])
"""
    assert told(program, tmp_path, ranks) == ["0 True n"] * ranks


@pytest.mark.usefixtures("serial_only")
def test_without_the_library_of_omni_path(tmp_path: Path) -> None:
    program = "early._SLEEPS = b'libnone.so.0'; early._import_beside_psm2(); print('as ever')"
    assert told(program, tmp_path) == ["as ever"]


@pytest.mark.usefixtures("serial_only")
def test_no_library_is_loaded_beside_that_of_omni_path(tmp_path: Path) -> None:
    """Its loader would wait; and MPI's must not come before all of the first modules are there.

    From 3.14 on Python's `secrets`, which pydantic may import, has a small one.
    """
    program = """
import importlib, sys
from dolfin_elastic.cli import early
def libraries():
    return {name for name, one in sys.modules.items()
            if str(getattr(one, "__file__", "")).endswith(".so")}
for name in early._FIRST:
    importlib.import_module(name)
before = libraries()
early._import_beside_psm2()
print(sorted(libraries() - before - {"_ctypes", "_hmac"}))
"""
    with started([sys.executable, "-c", program], tmp_path, 1) as process:
        out, err = process.communicate(timeout=60)
    assert (out, err) == ("[]\n", "")


@pytest.mark.usefixtures("serial_only")
def test_versions_are_those_of_the_metadata(tmp_path: Path) -> None:
    """Without the readers of mail; afterwards `importlib.metadata` is as it was."""
    program = """
import sys, ufl, ffcx
from dolfin_elastic.cli import early
print("email.message" in sys.modules)
import importlib.metadata as whole
found = [early._version(None, name) for name in ("fenics-ufl", "fenics-ffcx")]
print(ufl.__version__ == whole.version("fenics-ufl") == found[0],
      ffcx.__version__ == whole.version("fenics-ffcx") == found[1],
      whole.version.__module__ == "importlib.metadata")
try:
    early._version(whole.version, "no-such-package")
except whole.PackageNotFoundError as error:
    print(error.name)
"""
    mail, *rest = told(program, tmp_path)
    assert rest == ["True True True", "no-such-package"]
    assert mail == ("False" if version("fenics-basix").startswith("0.9.") else "True")


@pytest.mark.usefixtures("serial_only")
def test_elements_of_a_shape_share_a_cell(tmp_path: Path) -> None:
    program = """
import ufl
from basix.ufl import element
one, two = (element("P", "tetrahedron", degree).cell for degree in (1, 2))
print(one is two, one == ufl.Cell("tetrahedron"), element("P", "triangle", 1).cell.cellname)
"""
    assert told(program, tmp_path)[0].startswith("True True")


@pytest.mark.parametrize(
    ("words", "one"), [(["check", "a.toml"], "check"), (["run", "--help"], "run")]
)
def test_only_the_command_that_is_called_is_made(
    words: list[str], one: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", *words])
    every = list(app.app.registered_commands)
    with app._only_what_is_asked_for():
        assert [c.callback.__name__ for c in app.app.registered_commands if c.callback] == [one]
    assert app.app.registered_commands == every


@pytest.mark.parametrize("words", [[], ["rum"], ["--help"], ["--version"]])
def test_all_commands_are_made_for_who_asks_for_none(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["dolfin-elastic", *words])
    every = list(app.app.registered_commands)
    with app._only_what_is_asked_for():
        assert app.app.registered_commands == every
    assert len(every) > 10
