"""No mesh, CAD or case file runs a command or writes a file, and none takes Gmsh for ever."""

from __future__ import annotations

import gzip
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.cad import block, write
from helpers.processes import cli
from helpers.surfaces import cube, write_stl
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh import read_body
from dolfin_elastic.mesh.formats.cad import landlock, process
from dolfin_elastic.mesh.formats.cad.process import Permission, gmsh_process
from dolfin_elastic.mesh.formats.cad.read import mesh_cad

pytestmark = pytest.mark.usefixtures("serial_only")

BOX = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n'
ATTACK = 'SystemCall "touch trace";\nPrintf("x") > "trace-2";\nPrint "trace-3.stl";\n'
"""What only a script does: where this leaves traces, Gmsh took a file for one."""
MESH2 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
$EndNodes
$Elements
1
1 4 2 1 1 1 2 3 4
$EndElements
"""
MESH1 = (
    "$NOD\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$ENDNOD\n$ELM\n1\n1 4 1 1 4 1 2 3 4\n$ENDELM\n"
)
CASE = """[mesh]
file = "NAME"
TIME
[surfaces]
low = {plane = "x", at = "min"}
high = {plane = "x", at = "max"}
[materials.m]
law = "linear-elastic"
E = 1e6
nu = 0.3
[[support]]
on = "low"
[[load]]
kind = "pressure"
on = "high"
value = 1
"""


def write_case(folder: Path, name: str, time_limit: str = "") -> None:
    limit = f"time_limit = {json.dumps(time_limit)}" if time_limit else ""
    (folder / "case.toml").write_text(CASE.replace("NAME", name).replace("TIME", limit))


def traces(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("trace*"))


# --- files that were taken for scripts ---

CONTENTS = {
    "old in a comment": ("a.msh", f"$Comments\n$MeshFormat 3.0 0 8\n$EndComments\n{ATTACK}", None),
    "old in a comment, then a mesh": (
        "a.msh",
        f"$Comments\n$MeshFormat 3.0 0 8\n{ATTACK}$EndComments\n{MESH2}",
        4,
    ),
    "comment first": ("a.msh", f"{ATTACK}/*\n$MeshFormat\n3.0 0 8\n$EndMeshFormat\n*/\n", None),
    "blanks first": ("a.msh", f" \n{ATTACK}$MeshFormat\n3 0 8\n$EndMeshFormat\n", None),
    "like a header": ("a.msh", f"$MeshFormatX\n3 0 8\n{ATTACK}", None),
    "old": ("a.msh", f"$MeshFormat\n3.0 0 8\n$EndMeshFormat\n{ATTACK}", None),
    "oldest": ("a.msh", f"{MESH1}{ATTACK}", 4),
    "like the oldest": ("a.msh", f"$NODX\n{ATTACK}", None),
    "step": ("a.step", ATTACK, None),
    "brep": ("a.brep", ATTACK, None),
    "iges": ("a.iges", ATTACK, None),
    "stl": ("a.stl", ATTACK, None),
    "unrolled": ("a.geo_unrolled", BOX + ATTACK, None),
    "post-processing": ("a.geo", f"$PostFormat\n1.4 0 8\n$EndPostFormat\n{ATTACK}", None),
}
"""Kind to the name of a file, its content, and its number of nodes if it is good."""


@pytest.mark.parametrize("kind", CONTENTS)
def test_what_a_file_is_taken_for(tmp_path: Path, monkeypatch, kind: str) -> None:
    monkeypatch.chdir(tmp_path)
    name, text, nodes = CONTENTS[kind]
    (tmp_path / name).write_text(text)
    if nodes is None:
        with pytest.raises(MeshError):
            read_body(tmp_path / name)
    else:
        assert read_body(tmp_path / name).mesh.geometry.index_map().size_global == nodes
    assert traces(tmp_path) == []


@pytest.mark.parametrize("name", ["part.step", "part.brep", "part.geo", "part.msh"])
def test_options_beside_a_good_file(tmp_path: Path, monkeypatch, name: str) -> None:
    """Gmsh carries out `part.step.opt` when it opens `part.step`."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    if name.endswith(".geo"):
        path.write_text(BOX)
    elif name.endswith(".msh"):
        path.write_text(MESH1)
    else:
        write(path, block)
    for other in (f"{name}.opt", ".gmshrc", ".gmsh-options", "gmshrc"):
        (tmp_path / other).write_text(ATTACK)
    assert read_body(path).num_cells > 0
    assert traces(tmp_path) == []


INCLUDED = {
    "a mesh that is none": ("b.msh", f"$x\n{ATTACK}"),
    "a view that is none": ("b.pos", f"$View\n{ATTACK}"),
    "options": ("b.opt", ATTACK),
    "without a suffix": ("b", ATTACK),
    "compressed": ("b.gz", ATTACK),
}


@pytest.mark.parametrize("kind", INCLUDED)
@pytest.mark.parametrize("word", ["Merge", "Include"])
def test_what_a_script_reads(tmp_path: Path, monkeypatch, word: str, kind: str) -> None:
    monkeypatch.chdir(tmp_path)
    name, text = INCLUDED[kind]
    data = gzip.compress(text.encode()) if name.endswith(".gz") else text.encode()
    (tmp_path / name).write_bytes(data)
    (tmp_path / "a.geo").write_text(f'{BOX}{word} "{name}";\n')
    with pytest.raises(MeshError):
        read_body(tmp_path / "a.geo")
    assert traces(tmp_path) == []


@pytest.mark.parametrize("how", ["../b.geo", "/etc/hostname", "link.geo", "deep/../../b.geo"])
def test_files_outside_of_the_folder(tmp_path: Path, how: str) -> None:
    """They are named by line; a link to one is one."""
    folder = tmp_path / "mine"
    (folder / "deep").mkdir(parents=True)
    (tmp_path / "b.geo").write_text("h = 1;\n")
    (folder / "link.geo").symlink_to("../b.geo")
    (folder / "a.geo").write_text(f'{BOX}Include "{how}";\n')
    with pytest.raises(MeshError, match=r"a\.geo: .*(folder|kind)"):
        read_body(folder / "a.geo")


def test_texts_that_are_no_utf8(tmp_path: Path) -> None:
    """In a comment they do no harm; the Python module of Gmsh cannot hand its message on."""
    (tmp_path / "a.geo").write_bytes(b"// Gr\xf6\xdfe\n" + BOX.encode())
    assert read_body(tmp_path / "a.geo").num_cells > 0
    (tmp_path / "a.geo").write_bytes(BOX.encode().replace(b"CAS", b"C\xa4S"))
    with pytest.raises(MeshError, match=r"a\.geo: Gmsh cannot read .* UTF-8"):
        read_body(tmp_path / "a.geo")


def test_scripts_in_folders_below(tmp_path: Path) -> None:
    """Names are relative to the script that holds them."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/b.geo").write_text('Include "c.geo";\n')
    (tmp_path / "sub/c.geo").write_text("h = 2;\n")
    (tmp_path / "a.geo").write_text(
        'SetFactory("OpenCASCADE");\nInclude "sub/b.geo";\nBox(1) = {0, 0, 0, h, 1, 1};\n'
    )
    assert read_body(tmp_path / "a.geo").mesh.geometry.x[:, 0].max() == 2.0


# --- the process ---


@pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")
def test_a_confined_process_can_do_nothing_else(tmp_path: Path) -> None:
    """As if a script had come past the scanner: what it may not do, it cannot."""
    secret = tmp_path / "secret.geo"
    secret.write_text("Error('seen');\n")
    victim = tmp_path / "victim"
    victim.write_text("mine")
    script = f"""{BOX}
SystemCall "touch {tmp_path}/trace";
Printf("x") > "{tmp_path}/trace-2";
Printf("x") >> "{victim}";
Save "{tmp_path}/trace-3.brep";
Print "{tmp_path}/trace-4.stl";
CreateDir "{tmp_path}/trace-5";
Merge "{secret}";
"""
    with gmsh_process(Path("a.geo"), {Path("a.geo"): script.encode()}, Permission()) as (gmsh, _):
        with pytest.raises(MeshError) as caught:
            gmsh.ask("load")
        assert "seen" not in str(caught.value)
    assert traces(tmp_path) == []
    assert victim.read_text() == "mine"


@pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")
def test_landlock(tmp_path: Path) -> None:
    """Each right is lost, in the process and in its threads; the folder that is left works."""
    (tmp_path / "read").mkdir()
    (tmp_path / "write").mkdir()
    (tmp_path / "read/a").write_text("a")
    code = """
import os, socket, subprocess, sys, threading
from pathlib import Path
from dolfin_elastic.mesh.formats.cad import landlock
read, write, other = Path("read").resolve(), Path("write").resolve(), Path().resolve()
landlock.confine([read, Path("/nowhere")], write)
def lost(action):
    try:
        action()
    except OSError as error:
        return error.errno in (1, 13)
    return False
def check():
    assert (read / "a").read_text() == "a"
    (write / "b").write_text("b"); (write / "c").mkdir(); (write / "c").rmdir()
    assert lost(lambda: (read / "a").write_text("x"))
    assert lost(lambda: (read / "b").write_text("x"))
    assert lost(lambda: (other / "x").write_text("x"))
    assert lost(lambda: (other / "x").mkdir())
    assert lost(lambda: os.unlink(read / "a"))
    assert lost(lambda: os.truncate(read / "a", 0)) or landlock.version() < 3
    assert lost(lambda: os.rename(write / "b", other / "b"))
    assert lost(lambda: os.symlink("/etc", write / "d"))
    assert lost(lambda: Path("/etc/hostname").read_text())
    assert lost(lambda: subprocess.run(["/bin/true"]))
    assert lost(lambda: socket.create_connection(("127.0.0.1", 9), 1)) or landlock.version() < 4
    passed.append(1)
passed = []
check()
thread = threading.Thread(target=check)
thread.start(); thread.join()
print(len(passed))
"""
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.stdout == "2\n", ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["read", "write"]


def test_the_process_knows_nothing_of_mpi(monkeypatch) -> None:
    """A child with the variables of a rank would wait for the others, or end them."""
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "0")
    monkeypatch.setenv("PMIX_RANK", "0")
    monkeypatch.setenv("SLURM_PROCID", "0")
    monkeypatch.setenv("PYTHONPATH", ".")
    with gmsh_process(Path("a.geo"), {Path("a.geo"): BOX.encode()}, Permission()) as (gmsh, _):
        gmsh.ask("load")
        environment = Path(f"/proc/{gmsh.pid}/environ").read_bytes().decode()
    names = {line.partition("=")[0] for line in environment.split("\0") if line}
    assert names <= {*process._ENVIRONMENT, "TMPDIR", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"}
    assert not Path(f"/proc/{gmsh.pid}").exists()


def test_errors_are_those_of_the_question() -> None:
    """What failed before, and was borne, is not told again."""
    with gmsh_process(Path("a.geo"), {Path("a.geo"): BOX.encode()}, Permission()) as (gmsh, _):
        gmsh.ask("load")
        for number in (77, 99):
            with pytest.raises(MeshError) as error:
                gmsh.ask("ask", name="getType", arguments=[2, number])
            assert str(number) in str(error.value)
    assert "77" not in str(error.value)


def test_the_start_is_quick() -> None:
    """0.21 s on a machine with nothing else to do; the best of three, lest another job decide."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        with gmsh_process(Path("a.geo"), {Path("a.geo"): BOX.encode()}, Permission()) as (gmsh, _):
            gmsh.ask("load")
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.6


def test_the_process_imports_nothing_large() -> None:
    """Of these, UFL alone took as long to import as all that the process needs beside Gmsh."""
    code = """
import sys
from dolfin_elastic.core.startup.libraries import stay_without
stay_without()
import dolfin_elastic.mesh.formats.cad.worker
print({"dolfinx", "mpi4py", "petsc4py", "scipy", "ufl"} & set(sys.modules))
"""
    folder = str(Path(process.__file__).parents[4])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": folder},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "set()\n", done.stdout + done.stderr


# --- limits ---


@pytest.mark.long
def test_an_endless_loop_is_ended(tmp_path: Path) -> None:
    (tmp_path / "a.geo").write_text(f"{BOX}For i In {{1:1e18}}\n x = i;\nEndFor\n")
    for command in ("check", "run"):
        write_case(tmp_path, "a.geo", "2 s")
        begin = time.monotonic()
        code, out, err = cli(command, "case.toml", folder=tmp_path)
        assert code == 2, out + err
        assert "Gmsh was stopped after 2 s" in err
        assert "mesh.time_limit" in err
        assert err.count("\n") <= 2
        assert time.monotonic() - begin < 20


@pytest.mark.long
def test_cells_without_end(tmp_path: Path) -> None:
    """A thousand million cells: neither all memory nor all time."""
    (tmp_path / "a.geo").write_text(f"{BOX}Mesh.MeshSizeMax = 1e-3;\nMesh.MeshSizeMin = 1e-3;\n")
    write_case(tmp_path, "a.geo", "4 s")
    code, out, err = cli("check", "case.toml", folder=tmp_path)
    assert code == 2, out + err
    assert "Gmsh was stopped after 4 s" in err


@pytest.mark.long
def test_memory_is_limited(tmp_path: Path, monkeypatch) -> None:
    """The process gets no more than what is free; a script of texts that double wants all of it."""
    monkeypatch.setattr(process, "_free_memory", lambda: 1e8)
    path = tmp_path / "a.geo"
    path.write_text(f"{BOX}l() = {{0:1e9}};\n")
    with pytest.raises(MeshError, match=r"a\.geo: Gmsh (needs|cannot|has crashed)"):
        mesh_cad(path, size=None, curved=None, dim=None, permission=Permission(seconds=60))
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    assert used < 8e9


LIMITED = """
import pathlib
from dolfin_elastic.mesh.formats.cad import process
from dolfin_elastic.mesh.formats.cad.read import mesh_cad
process._free_memory = lambda: 1e12
path = pathlib.Path("a.geo")
how = process.Permission()
print(len(mesh_cad(path, size=None, curved=None, dim=None, permission=how).points))
"""


CRASHED = """
import sys
from dolfin_elastic.cli.app import main
from dolfin_elastic.mesh.formats.cad import process
process._PROGRAM = "import os; os.kill(os.getpid(), SIGNAL)"
sys.argv = ["dolfin-elastic", "check", "case.toml"]
main()
"""


@pytest.mark.parametrize(("name", "way"), [("part.stl", "SIGABRT"), ("a.geo", "SIGSEGV")])
def test_a_crash_of_gmsh_is_one_message(tmp_path: Path, name: str, way: str) -> None:
    """Also of a surface, which is tried in several ways: no hang, and no end of the run by it."""
    if name.endswith(".stl"):
        write_stl(tmp_path / name, cube())
    else:
        (tmp_path / name).write_text(BOX)
    write_case(tmp_path, name)
    case = (tmp_path / "case.toml").read_text()
    (tmp_path / "case.toml").write_text(case.replace("[mesh]", '[mesh]\nunit = "mm"'))
    done = subprocess.run(
        [sys.executable, "-c", CRASHED.replace("SIGNAL", str(int(signal.Signals[way])))],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(process.__file__).parents[4])},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stderr.count(way) == 1, done.stderr
    assert "Traceback" not in done.stderr


def test_a_limit_of_the_users_own(tmp_path: Path) -> None:
    """Below `ulimit -v`, as clusters set it, a process may go, but not above it."""
    (tmp_path / "a.geo").write_text(BOX)
    most = 12 << 30
    done = subprocess.run(
        [sys.executable, "-c", LIMITED],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(process.__file__).parents[4])},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 8


def test_the_disk_is_not_filled(tmp_path: Path, monkeypatch) -> None:
    """A file of Gmsh ends at the limit, here less than its mesh, and nothing of it is left."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(process, "_largest_file", lambda folder: 4096)
    path = tmp_path / "a.geo"
    path.write_text(f"{BOX}Mesh.MeshSizeMax = 0.2;\n")
    with pytest.raises(MeshError, match=r"a\.geo: Gmsh needs more room on the disk.*TMPDIR"):
        mesh_cad(path, size=None, curved=None, dim=None, permission=Permission(seconds=60))
    assert [p.name for p in tmp_path.iterdir()] == ["a.geo"]


def test_without_landlock(tmp_path: Path, monkeypatch) -> None:
    """It is said once what is not protected then, and nothing where nothing would be; no script."""
    write(tmp_path / "part.step", block)
    (tmp_path / "a.geo").write_text(BOX)
    (tmp_path / "old.msh").write_text(MESH1)
    told = "is not confined, because this kernel has no Landlock"
    if landlock.version() > 0:
        assert told not in " ".join(read_body(tmp_path / "a.geo").notes)
    monkeypatch.setattr(landlock, "version", lambda: 0)
    assert " ".join(read_body(tmp_path / "part.step").notes).count(told) == 1
    with pytest.raises(MeshError, match=r"a\.geo: .* is a program, .*Landlock.*--trust"):
        read_body(tmp_path / "a.geo")
    assert told not in " ".join(read_body(tmp_path / "a.geo", trust=True).notes)
    assert " ".join(read_body(tmp_path / "old.msh").notes).count(told) == 1


# --- scripts of one's own ---


@pytest.mark.long
def test_trust(tmp_path: Path) -> None:
    """Only what the user says on the command line lets a script do what it wants."""
    (tmp_path / "common").mkdir()
    (tmp_path / "common/size.geo").write_text("h = 1;\n")
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "a.geo").write_text(
        f'Include "../common/size.geo";\n{BOX}SystemCall "touch trace";\nPrintf("x") > "trace-2";\n'
    )
    write_case(folder, "a.geo")
    code, out, err = cli("check", "case.toml", folder=folder)
    assert code == 2, out + err
    assert "--trust" in err
    assert traces(tmp_path) == []
    code, out, err = cli("check", "case.toml", "--trust", folder=folder)
    assert code == 0, out + err
    assert traces(tmp_path) == ["trace", "trace-2"]
    text = (folder / "case.toml").read_text().replace("[mesh]", "[mesh]\ntrust = true")
    (folder / "case.toml").write_text(text)
    code, out, err = cli("check", "case.toml", folder=folder)
    assert code == 2, out + err
    assert "unknown key 'trust'" in err


@pytest.mark.long
@pytest.mark.parametrize("ranks", [3, 1])
def test_several_ranks(tmp_path: Path, ranks: int) -> None:
    """A refusal is one message, and no rank waits; a good file has the same cells as on one."""
    (tmp_path / "a.geo").write_text(BOX + ATTACK)
    write_case(tmp_path, "a.geo")
    code, out, err = cli("check", "case.toml", folder=tmp_path, ranks=ranks)
    assert code == 2, out + err
    assert err.count("SystemCall") == 1
    (tmp_path / "a.geo").write_text(BOX)
    code, out, err = cli("check", "case.toml", "--json", folder=tmp_path, ranks=ranks)
    assert code == 0, out + err
    assert json.loads(out)["cells"] == read_body(tmp_path / "a.geo").num_cells
    assert traces(tmp_path) == []


def test_nothing_is_left(tmp_path: Path, monkeypatch) -> None:
    """Neither processes nor folders, also where the file is refused."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "a.geo").write_text(BOX)
    read_body(tmp_path / "a.geo")
    (tmp_path / "a.geo").write_text("nonsense;\n")
    with pytest.raises(MeshError):
        read_body(tmp_path / "a.geo")
    assert [p.name for p in tmp_path.iterdir()] == ["a.geo"]
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    names = [Path(f"/proc/{child}/cmdline").read_bytes() for child in children]
    assert not any(b"formats.cad.worker" in name for name in names)
    assert MPI.COMM_WORLD.size == 1
