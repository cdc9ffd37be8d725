"""A hollow rubber ball falls on the floor and bounces.

Problem
    A ball of 60 mm with a wall of 6 mm (`ball.geo`), of soft rubber, comes down on the floor with
    1.4 m/s, as after a fall from 10 cm.  It flattens by a quarter of its height, leaves the
    floor after some 30 ms, rises, ringing, and falls again.

Equations
    Neo-Hookean with E = 150 kPa, nu = 0.4 and its weight; density * a = div P + density * g.  The
    floor is a rigid plane that the skin may touch; the penalty's energy comes back.

Discretisation
    Some thousand linear tetrahedra of Gmsh; central differences with lumped mass, and nine tenths
    of the stable step, which is recomputed as the ball deforms.

Result
    Strain, kinetic and contact energy minus the work of gravity are conserved.  The centre of
    mass rises by v^2/(2 g), v its speed when it leaves the floor; the rest of the initial
    potential energy is in its vibration.  It is in the air for 2 v/g.

        python3 demos/bounce/bounce.py
        mpirun -n 2 python3 demos/bounce/bounce.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
GRAVITY, SPEED = 9.81, 1.4
BALANCE = 1e-3
"""Share of the first energy: the scheme is of second order, but nodes hit within steps."""


def simulate():
    """Time, momentum, force of the floor, work of gravity and all energy of each state."""
    rows = []
    for state in run(read_case(HERE / "case.toml")):
        energies, momentum = state.energies, state.momenta["linear"][2]
        force = state.reactions["floor"][2]
        rows.append((state.t, momentum, force, energies["external"], energies["total"]))
    return np.array(rows).T


def main():
    t, momentum, force, work, total = simulate()
    mass = -momentum[0] / SPEED
    touching = np.flatnonzero(force > 0)
    left = touching[0] + int(np.argmin(force[touching[0] :] > 0))  # first state in the air again
    back = left + int(np.argmax(force[left:] > 0))
    v = momentum[left] / mass
    top = left + int(np.argmin(np.abs(momentum[left:back])))
    height = (work[left] - work[top]) / (mass * GRAVITY)
    ringing = total[left] - mass * v**2 / 2
    off = np.abs(total - work - total[0]).max() / total[0]
    flight = t[back] - t[left]
    if MPI.COMM_WORLD.rank == 0:
        print(
            f"down at {SPEED:.3f} m/s, {1e3 * (t[left] - t[touching[0]]):.1f} ms on the floor, "
            f"up at {v:.3f} m/s, {100 * ringing / total[0]:.1f} % of the energy rings"
        )
        print(
            f"rises by {1e3 * height:.1f} mm (v^2/2g: {1e3 * v**2 / (2 * GRAVITY):.1f} mm), "
            f"in the air for {1e3 * flight:.0f} ms (2 v/g: {2e3 * v / GRAVITY:.0f} ms)"
        )
        print(f"energy out of balance: {off:.1e} (allowed {BALANCE:.0e})")
    assert off < BALANCE
    # Free flight of the centre, exact but for the state nearest to the top: half of one's distance.
    assert abs(height - v**2 / (2 * GRAVITY)) < GRAVITY * (2 * (t[1] - t[0])) ** 2
    # The ball rings as it comes down again, by a millimetre or two.
    assert abs(flight / (2 * v / GRAVITY) - 1) < 0.03
    # Other meshes ring a little more or less.
    assert 0.85 < v / SPEED < 1.0
    assert 0.0 < ringing < 0.25 * total[0]


if __name__ == "__main__":
    main()
