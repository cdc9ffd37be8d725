"""Free memory of a machine and of control groups that limit it; the same answer on all ranks."""

from __future__ import annotations

from pathlib import Path

import pytest
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.files import memory

COMM = MPI.COMM_WORLD


def test_free_memory_is_within_that_of_the_machine() -> None:
    with open("/proc/meminfo", encoding="ascii") as file:
        most = 1024.0 * int(file.readline().split()[1])
    assert 1e6 < memory.free_memory() < most


def test_the_tightest_control_group_counts(tmp_path: Path, monkeypatch) -> None:
    """Limits of an outer group hold inside; what files have left in memory can be given up."""
    job = tmp_path / "system.slice" / "job"
    job.mkdir(parents=True)

    def limit(folder: Path, most: str, used: int, cache: int) -> None:
        (folder / "memory.max").write_text(f"{most}\n")
        (folder / "memory.current").write_text(f"{used}\n")
        (folder / "memory.stat").write_text(f"anon 5\ninactive_file {cache}\nactive_file 7\n")

    own = tmp_path / "cgroup"
    own.write_text("4:memory:/elsewhere\n0::/system.slice/job\n")
    monkeypatch.setattr(memory, "_CGROUPS", tmp_path)
    monkeypatch.setattr(memory, "_OWN_GROUP", own)
    assert memory.free_memory() > 1e6
    limit(job, "5000000", 3000000, 600000)
    assert memory.free_memory() == 2600000
    limit(job.parent, "4000000", 3500000, 0)
    assert memory.free_memory() == 500000
    limit(job.parent, "max", 3500000, 0)
    assert memory.free_memory() == 2600000
    limit(job, "5000000", 6000000, 0)
    assert memory.free_memory() == 0


def test_ranks_share_a_machine(monkeypatch) -> None:
    """Of all ranks that with the least counts, on all of them."""
    monkeypatch.setattr(memory, "free_memory", lambda: 6e6 + COMM.rank)
    assert memory.free_together(COMM) == pytest.approx(6e6)
    assert memory.free_together(MPI.COMM_SELF) == 6e6 + COMM.rank
    last = COMM.rank == COMM.size - 1
    monkeypatch.setattr(memory, "free_memory", lambda: 1e6 if last else 1e12)
    memory.check_memory(COMM, 1000, 999.0, where="cells", expected="fewer elements")
    with pytest.raises(MeshError) as caught:
        memory.check_memory(COMM, 1000, 1001.0, where="cells", expected="fewer elements")
    assert str(caught.value) == (
        "cells: 1e+03 elements need about 1 MB of memory, 1 MB are free; fewer elements, or a "
        "machine with more memory"
    )
