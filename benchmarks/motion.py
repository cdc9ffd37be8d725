"""Long runs of motion, too long for the tests: conservation, columns in space, Turek & Hron's rows.

    python3 benchmarks/motion.py spin          10,000 steps of a free brick: its momenta
    python3 benchmarks/motion.py bending       column 1 x 1 x 6 thrown sideways, to 2 %
    python3 benchmarks/motion.py twisting      the same twisted at 105 rad/s, to 3 %
    python3 benchmarks/motion.py flag          CSM3 over 10 s by steps of 20, 10 and 5 ms, to 0.5 %

References: the columns by an independent code of order 3 to 4 (after J. Haider's
explicitSolidDynamics), the flag's rows by S. Turek & J. Hron (2006), FEATFLOW's page
fsi_csm_tests.html; the momenta are integrals over the brick.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Dynamics, NeoHookean, Problem, Support, box_body, read_case, run
from dolfin_elastic.case import Case

FLAG = Path(__file__).resolve().parent.parent / "demos/turek_hron"
ROWS = {0.02: (-64.371, 64.695), 0.01: (-64.766, 64.948), 0.005: (-63.607, 65.160)}
"""Step [s] to mean and amplitude of u_y(A) over the last period [mm]."""


def say(text):
    if MPI.COMM_WORLD.rank == 0:
        print(text, flush=True)


def top(problem, height):
    """Displacement of the node above the middle of the foot."""
    x = problem.V.tabulate_dof_coordinates()
    near = np.flatnonzero(np.linalg.norm(x - [0.0, 0.0, height], axis=1) < 1e-9)
    found = problem.u.x.array.reshape(-1, 3)[near[0]].copy() if len(near) else None
    return next(v for v in problem.body.comm.allgather(found) if v is not None)


def spin():
    """Linear momentum, angular momentum about the centre, and energy over 10,000 steps.

    Newton's method leaves 1e-12 of the forces in each step, which adds up; and the brick flies 390
    m, so that accelerations, second differences of places, lose digits.
    """
    body = box_body(size=(1.0, 0.6, 0.3), cells=(2, 1, 1))
    problem = Problem(body, NeoHookean(E=1e5, nu=0.3, density=1000.0))
    w, c, v = (3.0, -2.0, 5.0), ("x - 0.5", "y - 0.3", "z - 0.15"), (1.0, 2.0, -0.5)
    velocity = [
        f"{v[i]} + ({w[j]})*({c[k]}) - ({w[k]})*({c[j]})"
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    dt = 2 * np.pi / np.linalg.norm(w) / 60
    rows = []
    for s in Dynamics(
        problem,
        end=10_000 * dt,
        dt=dt,
        every=100,
        rtol=1e-12,
        spectral_radius=1.0,
        initial_velocity=velocity,
    ).steps():
        centre = np.array([0.5, 0.3, 0.15]) + np.array(v) * s.t
        angular = s.momenta["angular"] - np.cross(centre, s.momenta["linear"])
        rows.append((*s.momenta["linear"], *angular, s.energies["total"]))
    rows = np.array(rows)
    off = np.abs(rows - rows[0])
    linear = off[:, :3].max() / np.linalg.norm(rows[0, :3])
    angular = off[:, 3:6].max() / np.linalg.norm(rows[0, 3:6])
    energy = off[:, 6].max() / rows[0, 6]
    say(f"spin: momentum off by {linear:.1e}, angular {angular:.1e}, energy by {energy:.1e}")
    assert linear < 1e-9
    assert angular < 1e-7
    assert energy < 2e-2


def column(velocity, nu, n=3):
    return Problem(
        box_body(size=(1.0, 1.0, 6.0), cells=(n, n, 6 * n), origin=(-0.5, -0.5, 0.0)),
        NeoHookean(E=17e6, nu=nu, density=1100.0),
        degree=2,
        formulation="displacement",
        supports=[Support(on="bottom")],
    ), {"initial_velocity": velocity, "spectral_radius": 1.0}


def bending():
    """u of the top of the bending column."""
    known = {0.1: (0.9925, -0.0605), 0.25: (2.421, -0.620), 0.5: (3.000, -0.940)}
    problem, settings = column(["10*z/6", 0, 0], 0.3, n=2)
    states = Dynamics(problem, end=0.5, dt=5e-3, every=1000, times=list(known), **settings).steps()
    first = next(states)
    assert abs(first.energies["kinetic"] / 110000 - 1) < 1e-9
    for state in states:
        u = top(problem, 6.0)
        say(f"bending: t = {state.t:g} s, top moved ({u[0]:.4f}, {u[2]:.4f}) m, {known[state.t]}")
        assert np.abs(u[[0, 2]] - known[state.t]).max() < 0.02 * 3.0


def twisting():
    """Rotation of the top of the twisting column [deg]."""
    known = {0.02: 111.3, 0.05: 253.2}
    spin = "105*sin(pi*z/12)"
    problem, settings = column([f"-{spin}*y", f"{spin}*x", 0], 0.45, n=4)
    states = Dynamics(problem, end=0.05, dt=1e-3, every=1000, times=list(known), **settings).steps()
    first = next(states)
    say(f"twisting: energy {first.energies['kinetic']:.0f} J, 3031875 J")
    for state in states:
        x = problem.V.tabulate_dof_coordinates()
        near = np.flatnonzero(np.linalg.norm(x - [0.0, 0.5, 6.0], axis=1) < 1e-9)
        mine = problem.u.x.array.reshape(-1, 3)[near[0]].copy() if len(near) else None
        u = next(v for v in problem.body.comm.allgather(mine) if v is not None)
        angle = np.degrees(np.arctan2(-(u[0]), 0.5 + u[1])) % 360
        say(f"twisting: t = {state.t:g} s, top turned by {angle:.1f} deg, {known[state.t]}")
        assert abs(angle - known[state.t]) < 0.03 * known[state.t]


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
    for name in sys.argv[1:] or ("spin", "bending", "twisting", "flag"):
        {"spin": spin, "bending": bending, "twisting": twisting, "flag": flag}[name]()
