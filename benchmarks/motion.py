"""Turek & Hron's flag over ten seconds, too long for the tests: CSM3 by three time steps.

    python3 benchmarks/motion.py

By steps of 20, 10 and 5 ms, to 0.5 %.  References: the rows that S. Turek & J. Hron (2006) give
for each step, FEATFLOW's page fsi_csm_tests.html.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run
from dolfin_elastic.case.case import Case

FLAG = Path(__file__).resolve().parent.parent / "demos/turek_hron"
ROWS = {0.02: (-64.371, 64.695), 0.01: (-64.766, 64.948), 0.005: (-63.607, 65.160)}
"""Step [s] to mean and amplitude of u_y(A) over the last period [mm]."""


def say(text):
    if MPI.COMM_WORLD.rank == 0:
        print(text, flush=True)


def flag():
    """Mean and amplitude of u_y(A) over the last period, for each step that was published."""
    for dt, (mean, half) in ROWS.items():
        tables = read_case(FLAG / "case.toml").to_dict()
        tables["dynamics"] |= {"end": 10.0, "dt": dt}
        tables["output"] = {"probes": tables["output"]["probes"], "every": 1000}
        case = Case.from_dict(tables, folder=FLAG)
        rows = np.array([(s.t, 1e3 * s.numbers["A_y"]) for s in run(case)])
        last = rows[rows[:, 0] > 8.9, 1]
        found = (last.max() + last.min()) / 2, (last.max() - last.min()) / 2
        say(f"flag: dt = {dt:g} s: {found[0]:.3f} +- {found[1]:.3f} mm, {mean} +- {half}")
        assert max(abs(found[0] - mean), abs(found[1] - half)) < 5e-3 * half


if __name__ == "__main__":
    flag()
