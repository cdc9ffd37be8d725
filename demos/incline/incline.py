"""Three bodies on a slope: a block sticks, a block slides, a ball rolls.

Problem
    Two blocks and a ball of soft rubber lie side by side on planks at an angle a = 20 degrees.
    Their friction is mu = 0.5, 0.2 and 0.5.  The weight grows within 0.1 s.

Equations
    Neo-Hookean with E = 600 kPa, nu = 0.3 and 1000 kg/m^3; contact with rigid boxes, with Coulomb's
    friction.  Rigid bodies would begin to move with the acceleration

        0                          where mu > tan a,
        g (sin a - mu cos a)       where a block slides,
        5/7 g sin a                where a ball rolls, mu > 2/7 tan a.

Discretisation
    Linear tetrahedra, on the ball two across the radius of its contact.  Generalized-alpha with
    steps of 10 ms.

Result
    The first block stays where it is; the others have these accelerations, the ball to 1 %: it is
    a polyhedron, and gives way.

        python3 demos/incline/incline.py
        mpirun -n 2 python3 demos/incline/incline.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
SLOPE, G = np.radians(20.0), 9.81
BODIES = {"sticks": 0.3, "slides": 0.0, "rolls": -0.3}
"""Body to the middle of its plank [m]."""


def ways(state):
    """How far the nodes of each body have gone down the slope, on average [m]."""
    space = state.u.function_space
    own = space.dofmap.index_map.size_local
    across = space.tabulate_dof_coordinates()[:own, 1]
    down = state.u.x.array.reshape(-1, 3)[:own] @ [np.cos(SLOPE), 0.0, -np.sin(SLOPE)]
    lanes = [np.abs(across - middle) < 0.12 for middle in BODIES.values()]
    sums = np.array([[down[lane].sum(), lane.sum()] for lane in lanes])
    length, count = space.mesh.comm.allreduce(sums, op=MPI.SUM).T
    return length / count


def main():
    case = read_case(HERE / "case.toml")
    rows = np.array([[state.t, *ways(state)] for state in run(case)])
    t, late = rows[:, 0], rows[:, 0] > 0.15
    found = [2 * np.polyfit(t[late], way[late], 2)[0] for way in rows[:, 1:].T]
    exact = [0.0, G * (np.sin(SLOPE) - 0.2 * np.cos(SLOPE)), 5 / 7 * G * np.sin(SLOPE)]
    if MPI.COMM_WORLD.rank == 0:
        for name, a, b, way in zip(BODIES, found, exact, rows[-1, 1:], strict=True):
            print(f"{name}: {1e3 * way:.2f} mm, acceleration {a:.4f} m/s^2, rigid {b:.4f}")
        off = [abs(a / b - 1) for a, b in zip(found[1:], exact[1:], strict=True)]
        print(f"acceleration of the block off by {off[0]:.1e}, of the ball by {off[1]:.1e}")
        assert abs(rows[-1, 1]) < 1e-3
        assert off[0] < 1e-4
        assert off[1] < 0.01


if __name__ == "__main__":
    main()
