"""What a sweep of forty rows costs beside forty solves: processor time of one process on one rank.

Run it by hand, with compiled forms in the cache (a first run is made and not counted):

    docker/run python3 benchmarks/sweep.py [ROUNDS]

The case is `demos/bracket_sweep` (10 092 unknowns).  A solve is what a further row costs, with its
checks, audit, estimated error and files: the difference of sweeps of 40 and of 4 rows over 36.
What is beside the solves is the start of the program, the mesh, the plot, the page and the table.
Of all rounds the medians are taken.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

CASE = Path(__file__).parent.parent / "demos" / "bracket_sweep" / "case.toml"
E, F = "materials.aluminium.E", "load.end.value[2]"
FEW, MANY = 4, 40
LIMIT = 1.2
"""Time of the sweep over that of its solves, at most."""


def listed(count: int) -> list[str]:
    """Moduli one after the other."""
    return ["--set", f"{E}={','.join(f'{70 + 0.1 * n:.1f} GPa' for n in range(count))}"]


def scattered(count: int) -> list[str]:
    """Samples of modulus and weight, as in the demo."""
    return ["--set", f"{E}=normal(3 %)", "--set", f"{F}=normal(5 %)", "--samples", str(count)]


def measure(words: list[str]) -> float:
    """Processor time of a sweep with its children, such as the process that makes the mesh [s]."""
    with tempfile.TemporaryDirectory() as folder:
        before = os.times()
        command = ["dolfin-elastic", "sweep", str(CASE), "--quiet", "--output", "rows", *words]
        subprocess.run(command, cwd=folder, capture_output=True, check=True)
        after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def main(rounds: int) -> None:
    measure(listed(1))
    for kind in (listed, scattered):
        pairs = [(measure(kind(FEW)), measure(kind(MANY))) for _ in range(rounds)]
        few, many = (statistics.median(column) for column in zip(*pairs, strict=True))
        solve = (many - few) / (MANY - FEW)
        print(
            f"{kind.__name__:10s} {MANY} rows {many:5.2f} s, a solve {solve:5.3f} s, beside them "
            f"{many - MANY * solve:4.2f} s: {many / (MANY * solve):4.2f} (at most {LIMIT})",
            flush=True,
        )


main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
