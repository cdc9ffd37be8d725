"""Memory that is free, before something is read whose size a file only states."""

from __future__ import annotations

from pathlib import Path


def free_memory() -> float:
    """Memory [byte] that nobody uses on this machine, or in this container. Not collective."""
    with open("/proc/meminfo", encoding="ascii") as file:
        lines = dict(line.split(":", 1) for line in file)
    free = 1024.0 * int(lines["MemAvailable"].split()[0])
    try:
        most, used = (
            int(Path(f"/sys/fs/cgroup/memory.{name}").read_text(encoding="ascii"))
            for name in ("max", "current")
        )
    except (OSError, ValueError):  # there are none, or the limit is "max"
        return free
    return min(free, max(most - used, 0))


def in_words(size: float) -> str:
    """A number of bytes in words: "9.1 GB"."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            break
        size /= 1000
    return f"{size:.3g} {unit}"
