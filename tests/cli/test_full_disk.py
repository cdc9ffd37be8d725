"""A disk or quota that is used up amid a run: code 4, whole files, `restart` once there is room."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import h5py
import pytest
from helpers.processes import PROGRAM, clean_environment, cli, started
from helpers.runs import case, check_same, history
from mpi4py import MPI

from dolfin_elastic import run

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")
INSIDE = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
SCRIPT = """\
mount -t tmpfs -o {full} none disk || exit 77
{program} run case.toml -q --output disk/out 2>err; echo $? >code
cp -r disk/out failed
mount -o remount,{room} disk
{program} restart disk/out -q 2>err2; echo $? >code2
cp -r disk/out completed
"""


WHOLE = case(statics={"steps": 30}, output={"checkpoint": {"every": 1}})


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """History of the case on a disk with room."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    for _ in run(WHOLE, output=folder):
        pass
    return history(folder)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the functions below."""
    folder = tmp_path_factory.mktemp("quota")
    (folder / "quota.c").write_text(QUOTA)
    command = ["gcc", "-shared", "-fPIC", "-o", "quota.so", "quota.c", "-ldl"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "quota.so"


@pytest.mark.long
@pytest.mark.parametrize(
    ("full", "room"), [("size=1200k", "size=99m"), ("size=99m,nr_inodes=14", "nr_inodes=9999")]
)
def test_full_disk(full: str, room: str, tmp_path: Path, known: list[dict[str, Any]]) -> None:
    """Of bytes and of inodes, in a small file system of its own."""
    (tmp_path / "case.toml").write_text(WHOLE.to_toml())
    (tmp_path / "disk").mkdir()
    program = f"{sys.executable} -m dolfin_elastic"
    script = SCRIPT.format(full=full, room=room, program=program)
    ended = subprocess.run(
        [*INSIDE, script],
        cwd=tmp_path,
        env=clean_environment(),
        check=False,
        capture_output=True,
        timeout=200,
    )
    if not (tmp_path / "code").exists():
        pytest.skip(f"no file system can be mounted here: {ended.stderr.decode().strip()}")
    failed = tmp_path / "failed"
    error = (tmp_path / "err").read_text()
    assert (tmp_path / "code").read_text() == "4\n", error
    assert "no space left on device" in error
    assert "Traceback" not in error
    check_whole(failed)
    assert (tmp_path / "code2").read_text() == "0\n", (tmp_path / "err2").read_text()
    check_same(history(tmp_path / "completed"), known, near=1e-7)


QUOTA = """\
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>
#include <unistd.h>
static long used;
static int beyond(int fd, long size)
{
    char name[64], path[4096];
    snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    long n = readlink(name, path, sizeof path - 1);
    if (n < 0)
        return 0;
    path[n] = 0;
    if (!strstr(path, "/case_results/"))
        return 0;
    if (used + size > atol(getenv("QUOTA"))) {
        errno = EDQUOT;
        return 1;
    }
    used += size;
    return 0;
}
static long total(const struct iovec *v, int n)
{
    long sum = 0;
    for (int i = 0; i < n; ++i)
        sum += v[i].iov_len;
    return sum;
}
#define WRAP(name, size, parameters, ...)                              \\
    ssize_t name parameters                                            \\
    {                                                                  \\
        ssize_t (*next) parameters = dlsym(RTLD_NEXT, #name);          \\
        return beyond(fd, size) ? -1 : next(__VA_ARGS__);              \\
    }
WRAP(write, n, (int fd, const void *p, size_t n), fd, p, n)
WRAP(pwrite, n, (int fd, const void *p, size_t n, off_t o), fd, p, n, o)
WRAP(pwrite64, n, (int fd, const void *p, size_t n, off64_t o), fd, p, n, o)
WRAP(writev, total(v, n), (int fd, const struct iovec *v, int n), fd, v, n)
WRAP(pwritev, total(v, n), (int fd, const struct iovec *v, int n, off_t o), fd, v, n, o)
WRAP(pwritev64, total(v, n), (int fd, const struct iovec *v, int n, off64_t o), fd, v, n, o)
"""
"""Functions of the C library that answer as a file system does whose quota is used up.

Free space, unlike on a full disk, is there: only the call that writes fails, whoever makes it:
Python, HDF5 or MPI-IO.
"""


@pytest.mark.long
@pytest.mark.parametrize("quota", [60_000, 150_000, 151_000, 153_000, 300_000])
@pytest.mark.parametrize("ranks", [1, 2])
def test_quota(
    quota: int, ranks: int, tmp_path: Path, library: Path, known: list[dict[str, Any]]
) -> None:
    """Code 4 with the reason wherever the quota ends, whole files, and a restart that goes on."""
    (tmp_path / "case.toml").write_text(WHOLE.to_toml())
    command = ["env", f"LD_PRELOAD={library}", f"QUOTA={quota}", *PROGRAM, "run", "case.toml", "-q"]
    with started(command, tmp_path, ranks) as process:
        _, err = process.communicate(timeout=200)
    assert process.returncode == 4, err
    assert "disk quota exceeded; your quota is used up" in err
    assert "Traceback" not in err
    check_goes_on(tmp_path, known)


@pytest.mark.long
def test_a_file_that_may_not_grow(tmp_path: Path, known: list[dict[str, Any]]) -> None:
    """A limit of `ulimit -f` ends a run as a full disk does, not by the signal SIGXFSZ."""
    (tmp_path / "case.toml").write_text(WHOLE.to_toml())
    limit = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (14000, 14000)); "
    limit += "sys.argv[1:] = ['run', 'case.toml', '-q']; from dolfin_elastic.cli.app import main; "
    with started([sys.executable, "-c", f"{limit}main()"], tmp_path, 1) as process:
        _, err = process.communicate(timeout=200)
    assert process.returncode == 4, err
    assert "file too large" in err
    assert "Traceback" not in err
    check_goes_on(tmp_path, known)


def check_goes_on(folder: Path, known: list[dict[str, Any]]) -> None:
    """Files are whole, and the restart ends as a run that nothing has happened to."""
    check_whole(folder / "case_results")
    code, _, err = cli("restart", "case_results", "-q", folder=folder)
    assert code == 0, err
    check_same(history(folder / "case_results"), known, near=1e-7)


def check_whole(folder: Path) -> None:
    """Whether every file that a reader would open can be read to its end."""
    assert json.loads((folder / "summary.json").read_text())
    for file in folder.rglob("*.xdmf"):
        for item in ET.parse(file).iter("DataItem"):
            name, _, array = str(item.text).partition(":")
            with h5py.File(folder / name.strip()) as h5:
                assert h5[array.strip()][:].size
    rows = (folder / "history.csv").read_text()
    assert rows.endswith("\n")
    assert len({line.count(",") for line in rows.splitlines()}) == 1
