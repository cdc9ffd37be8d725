"""Memory that is free, before something is read or made that may not fit into it."""

from __future__ import annotations

from pathlib import Path

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import smallest

_CGROUPS = Path("/sys/fs/cgroup")
_OWN_GROUP = Path("/proc/self/cgroup")


def free_memory() -> float:
    """Memory [byte] that nobody uses on this machine, or in this container. Not collective."""
    with open("/proc/meminfo", encoding="ascii") as file:
        lines = dict(line.split(":", 1) for line in file)
    return min(1024.0 * int(lines["MemAvailable"].split()[0]), *_left_in_groups())


def _left_in_groups() -> list[float]:
    """What the control groups of this process leave it [byte], where they have limits.

    A batch system limits a job in a group below others; a container sees its own as the topmost.
    """
    try:
        own = _OWN_GROUP.read_text(encoding="utf-8").split("::/", 1)[1].strip()
    except (OSError, IndexError):
        own = ""
    folder = _CGROUPS / own
    rest = [float("inf")]
    for group in (folder, *folder.parents):
        if not group.is_relative_to(_CGROUPS):
            break
        try:
            most, used = (
                int((group / f"memory.{name}").read_text()) for name in ("max", "current")
            )
            rows = (group / "memory.stat").read_text().splitlines()
            # Pages of files that were read count as used, and are given up when memory is short.
            cache = dict(row.split() for row in rows).get("inactive_file", "0")
        except (OSError, ValueError):  # there are none, or the limit is "max"
            continue
        rest.append(float(max(most - used + int(cache), 0)))
    return rest


def free_together(comm: MPI.Comm) -> float:
    """Memory [byte] that is free for ranks of which each needs as much. Collective.

    Ranks on one machine share what is free there.
    """
    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    local = free_memory() / machine.size
    machine.Free()
    return comm.size * smallest(comm, local)


def check_memory(
    comm: MPI.Comm, elements: float, each: float, *, where: str, expected: str
) -> None:
    """Refuses a mesh before the kernel ends the program for want of memory. Collective.

    Args:
        elements: How many there are or would be, on all ranks.
        each: Memory that an element takes [byte].

    Raises:
        MeshError: They need more than is free, on every rank.
    """
    need, free = elements * each, free_together(comm)
    if need > free:
        raise MeshError(
            f"{elements:.3g} elements need about {in_words(need)} of memory, {in_words(free)} are "
            "free",
            where=where,
            expected=f"{expected}, or a machine with more memory",
        )


def in_words(size: float) -> str:
    """A number of bytes in words: "9.1 GB"."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            break
        size /= 1000
    return f"{size:.3g} {unit}"
