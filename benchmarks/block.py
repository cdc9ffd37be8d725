"""The block with dolfin_elastic and default options, beside the expert's script: ratios.

    python3 benchmarks/block.py [--sizes 1:24,1:40,2:16] [--ranks 1,2] [--repeat 3]
                                [--expert benchmarks/expert.py]

Each size is run by both in turn, as whole processes with a warm form cache, and the medians of
the wall times are compared.  Any script that takes DEGREE and N and prints JSON with "uz", the
integral of u_z over the loaded face, can stand in for the expert.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent

CASE = """
[mesh]
box = {{size = [2, 1, 1], cells = [{twice}, {n}, {n}]}}
degree = {degree}

[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3

[[support]]
on = "left"

[[load]]
kind = "traction"
on = "right"
value = [0, 0, "-13 kPa"]
"""


def timed(ranks: int, command: list[str]) -> tuple[float, str]:
    """Wall seconds of the whole process, and what it printed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(HERE.parent)}
    launch = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    begin = time.perf_counter()
    done = subprocess.run(
        [*launch, sys.executable, *command],
        env=environment,
        text=True,
        capture_output=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    return time.perf_counter() - begin, done.stdout


def experts(ranks: int, script: str, degree: int, n: int) -> tuple[float, float]:
    """Seconds and the integral of u_z."""
    seconds, text = timed(ranks, [script, str(degree), str(n)])
    return seconds, float(re.search(r'"uz": *([-+.\deE]+)', text)[1])


def ours(ranks: int, degree: int, n: int, profile: bool = False) -> tuple[float, dict]:
    """Seconds of `dolfin-elastic run` with default options, and its summary."""
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "block.toml"
        case.write_text(CASE.format(twice=2 * n, n=n, degree=degree))
        seconds, _ = timed(
            ranks,
            ["-m", "dolfin_elastic", "run", str(case), "--quiet", "--output", f"{folder}/results"],
        )
        summary = json.loads((Path(folder) / "results" / "summary.json").read_text())
    return seconds, summary


def compare(degree: int, n: int, ranks: int, repeat: int, script: str) -> dict:
    """Medians of both, run in turn after one warm-up each."""
    ours(ranks, degree, min(n, 4)), experts(ranks, script, degree, min(n, 4))
    mine, theirs = [], []
    for _ in range(repeat):
        seconds, summary = ours(ranks, degree, n)
        mine.append(seconds)
        seconds, tip = experts(ranks, script, degree, n)
        theirs.append(seconds)
    a, b = statistics.median(mine), statistics.median(theirs)
    return {
        "degree": degree,
        "N": n,
        "ranks": ranks,
        "dofs": summary["dofs"],
        "ours": round(a, 2),
        "expert": round(b, 2),
        "ratio": round(a / b, 2),
        "uz": tip,
        "newton": summary["newton_iterations"],
        "max_displacement": summary["max_displacement"],
        "timings": summary["timings"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="1:24,1:40,2:16")
    parser.add_argument("--ranks", default="1,2")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--expert", default=str(HERE / "expert.py"))
    args = parser.parse_args()
    print("| element | N | unknowns | ranks | ours [s] | expert [s] | ratio |", flush=True)
    print("|---|---|---|---|---|---|---|")
    for size in args.sizes.split(","):
        degree, n = (int(part) for part in size.split(":"))
        for ranks in (int(part) for part in args.ranks.split(",")):
            row = compare(degree, n, ranks, args.repeat, args.expert)
            print(
                f"| P{degree} | {n} | {row['dofs']} | {ranks} | {row['ours']} | {row['expert']} "
                f"| {row['ratio']} |",
                flush=True,
            )
            print(json.dumps(row), file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
