"""Compiled forms and expressions: one compilation serves every problem of the same kind."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path

import dolfinx
import numpy as np
import pytest
import ufl
from cffi import VerificationError
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import box_body
from dolfin_elastic.core import jit, lease, signals
from dolfin_elastic.core.errors import OutputError, StoppedError
from dolfin_elastic.core.jit import cache
from dolfin_elastic.core.jit import compile as compile_module
from dolfin_elastic.core.jit.cache import find_or_compile, private_folders, why_foreign
from dolfin_elastic.core.lease import Lease
from dolfin_elastic.core.parallel import on_root


def test_an_expression_is_compiled_once(comm: MPI.Comm, folder, monkeypatch: pytest.MonkeyPatch):
    """Also where the variables it is differentiated by are the process's second ones."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm)
    points = np.array([[0.25, 0.25, 0.25]])
    values = []
    for factor in (1.0, 2.0):
        u = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,))))
        u.interpolate(lambda x, factor=factor: factor * x)
        F = ufl.variable(ufl.grad(u))
        stress = ufl.diff(ufl.inner(F, F) / 2, F)
        expression = jit.compile_expression(comm, stress[0, 0], points, jit.options(comm))
        values.append(expression.eval(body.mesh, np.array([0], dtype=np.int32)).flat[0])
    assert values == pytest.approx([1.0, 2.0])
    assert on_root(comm, lambda: len([*folder.rglob("*.c")])) == 1


def compiled(comm: MPI.Comm) -> float:
    """A small expression, compiled or found, at a point where it is 3."""
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1), comm=comm)
    u = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: x)
    points = np.array([[0.25, 0.25, 0.25]])
    expression = jit.compile_expression(comm, ufl.div(u), points, jit.options(comm))
    return float(expression.eval(body.mesh, np.array([0], dtype=np.int32)).flat[0])


def cut(folder: Path) -> None:
    so = next(folder.glob("*.so"))
    whole = so.read_bytes()
    so.unlink()  # another file: the first is in use
    so.write_bytes(whole[: len(whole) // 2])


def emptied(folder: Path) -> None:
    so = next(folder.glob("*.so"))
    so.unlink()
    so.touch()


def missing(folder: Path) -> None:
    next(folder.glob("*.so")).unlink()


def left_over(folder: Path) -> None:
    for file in folder.iterdir():
        if file.suffix != ".cached":
            file.unlink()


@pytest.mark.parametrize("damage", [cut, emptied, missing, left_over])
def test_a_damaged_form_is_compiled_again(
    damage: Callable[[Path], None], comm: MPI.Comm, folder, monkeypatch, caplog
):
    """With one warning; loading a cut library would be a bus error, not an exception."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    monkeypatch.setattr(cache, "_told", set())
    assert compiled(comm) == pytest.approx(3.0)
    on_root(comm, lambda: damage(next(folder.rglob("*.c.cached")).parent))
    assert compiled(comm) == pytest.approx(3.0)
    told = [r.message for r in caplog.records if "damaged" in r.message]
    assert len(comm.allreduce(told)) == 1
    assert on_root(comm, lambda: len([*folder.rglob("*.so")])) == 1
    assert not on_root(comm, lambda: [*folder.rglob("*.claim"), *folder.rglob("*.part-*")])
    assert compiled(comm) == pytest.approx(3.0)
    assert len([r for r in caplog.records if "damaged" in r.message]) == len(told)


def test_where_the_cache_cannot_be_written(comm: MPI.Comm, monkeypatch, caplog):
    """A home that is for reading only: forms are compiled elsewhere, with one warning."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc")
    monkeypatch.setattr(cache, "_told", set())
    assert compiled(comm) == pytest.approx(3.0)
    assert compiled(comm) == pytest.approx(3.0)
    told = [r.message for r in caplog.records if "cannot be stored" in r.message]
    assert len(comm.allreduce(told)) == 1


@pytest.mark.parametrize("slow", [True, False])
def test_compiling_that_lasts_is_announced(slow: bool, comm: MPI.Comm, folder, monkeypatch):
    """Once, while FFCx is at work in Python and not only with the C compiler; else nothing.

    Once of forms one after the other, too.  Other ranks than 0 log nothing.
    """
    said: list[str] = []
    told = threading.Event()

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())
            told.set()

    def ffcx(*args: object, **options: object) -> object:
        end = time.monotonic() + (60.0 if slow else 0.0)
        while comm.rank == 0 and not told.is_set() and time.monotonic() < end:
            sum(range(1000))
        return build(*args, **options)

    build = dolfinx.jit.ffcx_jit
    monkeypatch.setattr(dolfinx.jit, "ffcx_jit", ffcx)
    monkeypatch.setattr(compile_module, "SLOW", 0.05 if slow else 1000.0)
    monkeypatch.setattr(compile_module, "_silence", silence := compile_module._Silence())
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    log, handler = logging.getLogger("dolfin_elastic"), Handler()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        assert compiled(comm) == pytest.approx(3.0)
        for _ in range(2 if slow else 0):
            with silence.broken_after(0.0):
                time.sleep(0.1)
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
    first = ["compiling ... (only in the first run)"]
    assert said == (first if slow and comm.rank == 0 else [])


# --- the cache alone, with a compiler that writes a file ---

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="no rank is waited for in here")


def write(text: str) -> Callable[[Path], object]:
    return lambda into: (into / "code").write_text(text)


def refuse(into: Path) -> None:
    raise AssertionError("compiled")


@contextmanager
def holder(root: Path, key: str, **keys: object) -> Iterator[Path]:
    """The lease of a form, of this process or of one with another number or host."""
    root.mkdir(exist_ok=True)
    file = root / f".{key}.claim"
    with closing(Lease(file)) as held:
        assert held.acquire(0.0)
        file.write_text(json.dumps({**json.loads(file.read_text()), **keys}))
        yield file


@serial
def test_a_finished_form_is_taken_without_a_lock(tmp_path: Path):
    """Whoever holds it, also from a folder in which nothing may be written."""
    found = find_or_compile([tmp_path / "a"], "f", write("1"))
    with holder(tmp_path / "a", "f"):
        assert find_or_compile([tmp_path / "b", tmp_path / "a"], "f", refuse) == found
    assert not (tmp_path / "b").exists()


@serial
def test_different_forms_are_compiled_side_by_side(tmp_path: Path, caplog):
    """The other one has not ended when this one has; the same form is waited for."""
    begun, end = threading.Event(), threading.Event()

    def slow(into: Path) -> None:
        begun.set()
        assert end.wait(30)
        write("slow")(into)

    first = threading.Thread(target=find_or_compile, args=([tmp_path], "slow", slow))
    first.start()
    assert begun.wait(10)
    find_or_compile([tmp_path], "other", write("2"))
    assert first.is_alive()
    second = threading.Thread(target=find_or_compile, args=([tmp_path], "slow", refuse))
    second.start()
    time.sleep(0.5)
    assert second.is_alive()
    end.set()
    first.join(5)
    second.join(5)
    assert not first.is_alive() and not second.is_alive()
    assert {file.name for file in tmp_path.iterdir()} == {"slow", "other"}


@serial
def test_waiting_says_for_whom(tmp_path: Path, monkeypatch, caplog):
    """After 5 s, in the test 0.3; the holder may be on another machine."""
    monkeypatch.setattr(lease, "QUIET", 0.3)

    def end() -> None:
        (tmp_path / "f").mkdir()
        (tmp_path / "f/whole.json").write_text(json.dumps({"code": cache._checksum(file)}))
        shutil.copy(file, tmp_path / "f/code")

    with holder(tmp_path, "f", host="node7", pid=4711) as file:
        other = threading.Timer(2.0, end)
        other.start()
        find_or_compile([tmp_path], "f", refuse)
        other.join()
    assert [r.message for r in caplog.records] == [
        "waiting for process 4711 on node7, which compiles the same code"
    ]


@serial
def test_a_dead_holder_is_noticed(tmp_path: Path):
    """At once, on whatever machine it was, and whoever has its number now."""
    code = "from pathlib import Path; from dolfin_elastic.core.lease import Lease; import os, sys;"
    code += "assert Lease(Path(sys.argv[1])).acquire(0.0); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code, tmp_path / ".f.claim"], check=False)
    assert "pid" in (tmp_path / ".f.claim").read_text()
    (tmp_path / ".g.claim").write_text(json.dumps({"pid": os.getpid(), "host": "elsewhere"}))
    (tmp_path / ".h.claim").write_text("")
    for key in "fgh":
        begin = time.monotonic()
        find_or_compile([tmp_path], key, write("1"))
        assert time.monotonic() - begin < 2.0
    assert not [*tmp_path.glob(".*")]


@serial
def test_an_hour_asleep_is_no_hour_of_silence(tmp_path: Path, monkeypatch):
    """A machine that was suspended between two looks, its waiting process and the holder with it.

    The clock on the wall and the name of the host do not matter at all.
    """
    clock, looks = [0.0], []

    def done() -> bool:
        clock[0] += 3600.0
        looks.append(clock[0])
        return len(looks) == 5

    with holder(tmp_path, "f") as file:
        monkeypatch.setattr(lease.time, "monotonic", lambda: clock[0])
        monkeypatch.setattr(lease.time, "time", lambda: -clock[0])
        monkeypatch.setattr(lease.socket, "gethostname", lambda: "renamed")
        assert not Lease(file).acquire(60.0, done=done)
    assert len(looks) == 5


@serial
def test_a_holder_that_stands_still(tmp_path: Path, monkeypatch):
    """One that was stopped, say: its form is compiled here, too, and what it has begun stays."""
    monkeypatch.setattr(cache, "PATIENCE", 0.3)
    with holder(tmp_path, "f"):
        begun = tmp_path / ".f.part-0"
        begun.mkdir()
        find_or_compile([tmp_path], "f", write("1"))
        assert begun.exists()
        assert (tmp_path / ".f.claim").exists()
    assert (tmp_path / "f/code").read_text() == "1"


@serial
def test_a_cache_on_a_file_system_without_locks(tmp_path: Path, monkeypatch, caplog):
    """Each process compiles for itself: nothing is lost but time."""

    def flock(descriptor: int, how: int) -> None:
        raise OSError(errno.ENOSYS, "not implemented")

    monkeypatch.setattr(fcntl, "flock", flock)
    assert find_or_compile([tmp_path], "f", write("1")) == tmp_path / "f"
    assert {file.name for file in tmp_path.iterdir()} == {"f"}
    assert not caplog.records


@serial
def test_a_sleeper_that_was_taken_for_dead(tmp_path: Path):
    """It wakes when another process has compiled the form: nothing is lost, nobody fails."""

    def asleep(into: Path) -> None:
        (tmp_path / ".f.claim").unlink()
        find_or_compile([tmp_path], "f", write("the other"))
        raise FileNotFoundError(into)  # which the other one has removed

    assert find_or_compile([tmp_path], "f", asleep) == tmp_path / "f"
    assert (tmp_path / "f/code").read_text() == "the other"


@serial
@pytest.mark.parametrize("waiting", [True, False])
def test_a_signal_is_heard(waiting: bool, tmp_path: Path, monkeypatch, capfd):
    """While another process is waited for, and while this one compiles."""
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    before[signal.SIGUSR2] = signal.getsignal(signal.SIGUSR2)
    monkeypatch.setattr(signals, "_current", [])
    try:
        signals.Stop(tmp_path)
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGTERM)).start()
        begin = time.monotonic()
        held = holder(tmp_path, "f") if waiting else nullcontext()
        with held, pytest.raises(StoppedError), signals.interruptible():
            find_or_compile([tmp_path], "f", lambda into: time.sleep(30))
        assert time.monotonic() - begin < 2.0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "stopping with a checkpoint" in capfd.readouterr().err
    assert not [*tmp_path.glob(".*part-*")]


@serial
def test_a_full_disk(tmp_path: Path, monkeypatch, caplog):
    """The next folder is taken; where there is none, the message has the cause of each."""
    monkeypatch.setattr(cache, "_told", set())
    monkeypatch.setattr(cache.shutil, "disk_usage", free := Free())
    spare = private_folders("test")[0].with_name(tmp_path.parent.name + "spare")
    free.folders = {tmp_path: 1 << 20, spare: 1 << 40}
    found = find_or_compile([tmp_path, spare], "f", write("1"))
    assert found == spare / "f"
    assert spare.stat().st_mode & 0o077 == 0
    assert f"compiled code cannot be stored ({tmp_path}: no space left on device)" in caplog.text
    free.folders[spare] = 0
    with pytest.raises(OutputError, match=r"no space left on device; .*no space left on device"):
        find_or_compile([tmp_path, spare], "g", refuse)
    shutil.rmtree(spare)


@serial
def test_a_sleeper_whose_folder_was_removed(tmp_path: Path):
    """It waits for the process that compiles the form now, and does not go elsewhere."""
    cache_root, spare = tmp_path / "cache", tmp_path / "spare"
    at_work = threading.Event()

    def slow(into: Path) -> None:
        at_work.set()
        time.sleep(0.5)
        (into / "code").write_text("the other")

    other = threading.Thread(target=find_or_compile, args=([cache_root], "f", slow))

    def asleep(into: Path) -> None:
        (cache_root / ".f.claim").unlink()
        other.start()
        at_work.wait(10)
        assert not into.exists()
        raise VerificationError("no such folder")

    assert find_or_compile([cache_root, spare], "f", asleep) == cache_root / "f"
    other.join()
    assert (cache_root / "f/code").read_text() == "the other"
    assert not spare.exists()


@serial
def test_a_claim_that_cannot_be_written(tmp_path: Path, monkeypatch):
    """An empty one would be waited for, by this user's next run and by others."""
    monkeypatch.setattr(lease, "_this_process", full)
    with pytest.raises(OutputError, match="no space left on device"):
        find_or_compile([tmp_path], "f", refuse)
    assert not [*tmp_path.iterdir()]


def full(*_: object) -> str:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@serial
@pytest.mark.parametrize(
    ("number", "mode"), [(0, 0o777), (1, 0o777), (1, 0o775)], ids=["cache", "spare", "group"]
)
def test_code_that_another_user_may_have_left(number: int, mode: int, tmp_path: Path):
    """A folder in /tmp or /dev/shm under a name that was seen in the other one; a home in /tmp."""
    roots = [tmp_path / "cache", tmp_path / "spare"]
    find_or_compile([roots[number]], "f", write("planted"))
    roots[number].chmod(mode)
    found = find_or_compile(roots, "f", write("own"))
    assert found == roots[1 - number] / "f"
    assert (found / "code").read_text() == "own"


@serial
@pytest.mark.parametrize("mask", [0o002, 0o000])
def test_nobody_else_may_write_where_code_lies(mask: int, tmp_path: Path, monkeypatch):
    """Whatever the user's mask: with 002, the default of many systems, the group could."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    before = os.umask(mask)
    try:
        compiled(MPI.COMM_SELF)
    finally:
        os.umask(before)
    every = [tmp_path / "new", *(tmp_path / "new").rglob("*")]
    assert any(one.suffix == ".so" for one in every)
    assert [str(one) for one in every if one.stat().st_mode & 0o022] == []
    folders = [tmp_path / "new", *(tmp_path / "new").glob("dolfin_elastic/**/forms/*")]
    assert {stat.S_IMODE(one.stat().st_mode) for one in folders} == {0o700}


@serial
@pytest.mark.parametrize("which", [".", "..", "../..", "f", "f/code", "f/whole.json"])
def test_code_that_a_group_may_write_is_not_run(which: str, tmp_path: Path):
    """Wherever it lies: the folder of forms, those above, that of the form and its files."""
    root, spare = tmp_path / "dolfin_elastic/forms/cpu", tmp_path / "spare"
    find_or_compile([root], "f", write("first"))
    place = root / which
    place.chmod(place.stat().st_mode | 0o020)
    assert cache.find([root], "f") is None
    found = find_or_compile([root, spare], "f", write("own"))
    assert (found / "code").read_text() == "own"
    assert cache.find([root, spare], "f") == found


@serial
def test_code_of_another_user_is_not_run(tmp_path: Path, monkeypatch):
    root = tmp_path / "dolfin_elastic/forms/cpu"
    find_or_compile([root], "f", write("first"))
    user = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    assert (cache.find([root], "f") is None) == (user != 0)  # an administrator's is
    assert why_foreign(root, own=True).endswith("belongs to another user")


@serial
def test_links_to_code(tmp_path: Path):
    """A cache may be a link of the user's own; a form's library may not, nor a place in /tmp."""
    root, real = tmp_path / "dolfin_elastic/forms/cpu", tmp_path / "real"
    find_or_compile([real], "f", write("first"))
    root.parent.mkdir(parents=True)
    root.symlink_to(real)
    assert cache.find([root], "f") == root / "f"
    assert why_foreign(root, own=True) == f"{root} is no folder"
    real.chmod(0o775)
    assert cache.find([root], "f") is None
    real.chmod(0o755)
    tmp_path.chmod(0o777)
    assert cache.find([root], "f") is None
    tmp_path.chmod(0o700)
    (real / "f/code").rename(tmp_path / "code")
    (real / "f/code").symlink_to(tmp_path / "code")
    assert cache.find([root], "f") is None


class Free:
    """Free space by folder, in place of the disk's."""

    def __init__(self) -> None:
        self.folders: dict[Path, int] = {}

    def __call__(self, folder: Path) -> Free:
        self.free = self.folders[folder]
        return self
