"""What the commands take to start: wall and processor time of a case of six tetrahedra.

Run it by hand, with compiled forms in the cache (a first run is made and not counted):

    docker/run python3 benchmarks/startup.py [ROUNDS]

Beside the seconds stands the ratio of processor times to 10^7 additions in Python, measured before
and after, as machines differ and have other work; of all rounds the least is taken.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CASE = """
[mesh]
box = {size = [1, 1, 1], cells = [1, 1, 1]}
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.45
density = "1100 kg/m^3"
[[support]]
on = "left"
displacement = [0, 0, 0]
[[load]]
kind = "gravity"
[statics]
steps = 1
"""
COMMANDS = {"--help": 0.5, "check case.toml": 1.0, "run case.toml": 1.5}
"""Command to the wall time that it is to take at most [s]."""


def additions() -> float:
    start, total = time.process_time(), 0
    for i in range(10**6):
        total += i
    return 10 * (time.process_time() - start)


def measure(command: str, folder: Path) -> tuple[float, float, float]:
    """Wall time, processor time, and processor time over that of the additions."""
    before, spent, start = additions(), os.times(), time.perf_counter()
    words = ["dolfin-elastic", *command.split()]
    subprocess.run(words, cwd=folder, capture_output=True, check=True)
    wall, after = time.perf_counter() - start, os.times()
    processor = sum(after[2:4]) - sum(spent[2:4])
    return wall, processor, processor / ((before + additions()) / 2)


def main(rounds: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "case.toml").write_text(CASE)
        measure("run case.toml", folder)
        for command, limit in COMMANDS.items():
            found = zip(*(measure(command, folder) for _ in range(rounds)), strict=True)
            wall, processor, ratio = map(min, found)
            text = f"{command:16s} wall {wall:5.2f} s (at most {limit} s)"
            print(
                f"{text}  processor {processor:5.2f} s  {ratio:5.2f} times 10^7 additions",
                flush=True,
            )


main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
