"""The elastic flag of Turek & Hron, released under its weight: CSM3, without the fluid.

Problem
    A flag 0.35 m long and 2 cm thick is clamped to a cylinder at its left end.  Its weight (g = 2
    m/s^2) begins to act at t = 0, and it swings about its sagged state, 13 cm to and fro.

Equations
    St. Venant-Kirchhoff in plane strain: density * a = div P + density * g.

Discretisation
    60 x 4 squares of two quadratic triangles each, 2178 unknowns; trapezoidal rule, 5 ms.

Result
    The place of A, the middle of the free end, at 0.25, 0.5 and 1 s, against values that were
    computed for this project by an independent code of order 4 to 10 in space with ever smaller
    steps; the error is relative to the amplitude of the motion.  `--full` computes 10 s: S. Turek &
    J. Hron (2006) have published the last period of that for this very step (their page:
    mathematik.tu-dortmund.de/~featflow), -63.607 +- 65.160 mm; the oscillation beats, so other
    steps give other last periods.

        python3 demos/turek_hron/turek_hron.py
        mpirun -n 2 python3 demos/turek_hron/turek_hron.py --full
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run
from dolfin_elastic.case.case import Case

HERE = Path(__file__).parent
KNOWN = {0.25: (-9.014, -74.26), 0.5: (-27.29, -126.09), 1.0: (-0.1337, -9.50)}
"""Time [s] to u_x and u_y of A [mm], to +-0.04 mm."""
AMPLITUDE = 130.0
TOLERANCE = 2e-3
"""Over the amplitude [mm].  The mesh leaves 1e-3 of it, being a little too stiff; the step 3e-4."""
PERIOD = {"x": (-14.305, 14.305), "y": (-63.607, 65.160)}
"""Mean and amplitude of the last period [mm], for steps of 5 ms (Turek & Hron 2006)."""
FREQUENCY = 1.0941
"""Mean frequency over the whole ten seconds [1/s], by the independent code; the published one,
1.0995, is that of one period of the beating signal."""


def swing(end):
    """Rows of time [s], u_x and u_y of A [mm]."""
    tables = read_case(HERE / "case.toml").to_dict()
    tables["dynamics"]["end"] = end
    case = Case.from_dict(tables, folder=HERE)
    rows = [(s.t, 1e3 * s.numbers["A_x"], 1e3 * s.numbers["A_y"]) for s in run(case)]
    return np.array(rows)


def early(rows):
    """Largest difference from what is known, over the amplitude."""
    worst = 0.0
    for t, exact in KNOWN.items():
        found = rows[np.argmin(np.abs(rows[:, 0] - t)), 1:]
        say(f"t = {t:<4} s   A moved ({found[0]:8.3f}, {found[1]:8.3f}) mm, known {exact}")
        worst = max(worst, float(np.abs(found - exact).max()) / AMPLITUDE)
    say(f"largest difference over the amplitude: {worst:.1e} (allowed {TOLERANCE:.0e})")
    return worst


def late(rows):
    """Compares the last period, and the mean frequency of all of it, with what is known."""
    last = rows[rows[:, 0] > rows[-1, 0] - 1.1]
    for axis, column in (("x", 1), ("y", 2)):
        high, low = last[:, column].max(), last[:, column].min()
        mean, half = (high + low) / 2, (high - low) / 2
        say(f"last period: u_{axis} = {mean:.3f} +- {half:.3f} mm, published {PERIOD[axis]}")
        assert abs(mean - PERIOD[axis][0]) < 5e-3 * PERIOD[axis][1]
        assert abs(half - PERIOD[axis][1]) < 5e-3 * PERIOD[axis][1]
    t, off = rows[:, 0], rows[:, 2] - (rows[:, 2].max() + rows[:, 2].min()) / 2
    i = np.flatnonzero(off[:-1] * off[1:] < 0)
    zeros = t[i] - off[i] * (t[i + 1] - t[i]) / (off[i + 1] - off[i])
    frequency = (len(zeros) - 1) / 2 / (zeros[-1] - zeros[0])
    say(f"mean frequency {frequency:.4f} Hz, known {FREQUENCY}")
    assert abs(frequency - FREQUENCY) < 3e-3


def say(text):
    if MPI.COMM_WORLD.rank == 0:
        print(text)


def main():
    full = "--full" in sys.argv[1:]
    rows = swing(10.0 if full else 1.0)
    if full:
        late(rows)
    assert early(rows) < TOLERANCE


if __name__ == "__main__":
    main()
