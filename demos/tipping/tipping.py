"""A rubber duck on the floor tips over under a plate from above.

Problem
    A duck as in `demos/duck` (`duck.geo`: ellipsoids, spheres and a cone in one piece) stands on
    the floor; its flat bottom may lift, but does not slide.  A smooth plate comes down on its head
    by 10 mm.  The head is in front of the bottom's edge: the duck tips over it, rolls onto its
    breast, and its tail comes up against the plate.

Equations
    Neo-Hookean with E = 1 MPa, nu = 0.45 and its weight; equilibrium.  Floor and plate are rigid
    planes that the skin may touch but not pass, without friction: wherever the gap g is closed
    there is a pressure, g >= 0, p >= 0, g p = 0.

Discretisation
    Linear tetrahedra of Gmsh, 7 mm and finer at eyes, beak and tail, which are fast and too stiff:
    the way of the duck is of interest, not its stress.  Five load steps; augmented multipliers,
    renewed until no node is deeper than a thousandth of a cell.

Result
    Plate and floor balance the weight; nothing is left inside floor and plate; the tail touches.

        python3 demos/tipping/tipping.py
        mpirun -n 2 python3 demos/tipping/tipping.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
DENSITY, GRAVITY, HEIGHT, DOWN = 1100.0, 9.81, 0.093, 0.010


def volume_and_tops(u):
    """Volume of the undeformed body [m^3]; after, the highest points of all and of the tail [m]."""
    from dolfin_elastic.mesh.geometry.simplices import cell_corners, signed_volumes

    mesh = u.function_space.mesh
    own = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    volume = np.abs(signed_volumes(cell_corners(mesh, own))).sum()
    X = u.function_space.tabulate_dof_coordinates()
    z = X[:, 2] + u.x.array.reshape(-1, 3)[:, 2]
    tops = [z.max(initial=-1), z[X[:, 0] < -0.05].max(initial=-1)]
    return mesh.comm.allreduce(volume), *(mesh.comm.allreduce(top, op=MPI.MAX) for top in tops)


def main():
    comm = MPI.COMM_WORLD
    case = read_case(HERE / "case.toml")
    *_, state = run(case)
    volume, top, tail = volume_and_tops(state.u)
    weight = DENSITY * GRAVITY * volume
    plate, floor = (state.reactions[name][2] for name in ("plate", "floor"))
    imbalance = abs(plate + floor - weight)
    deepest = max(state.numbers[f"penetration_{name}"] for name in ("plate", "floor"))
    summary = json.loads((case.results_folder() / "summary.json").read_text())
    smallest = summary["extremes"]["min_jacobian"]["value"]
    if comm.rank == 0:
        print(f"height {1e3 * HEIGHT:.0f} mm -> {1e3 * top:.2f} mm, tail up to {1e3 * tail:.2f} mm")
        print(
            f"plate {plate:.2f} N, floor {floor:.2f} N, weight {weight:.2f} N: "
            f"imbalance {imbalance:.1e} N"
        )
        print(f"deepest node {1e6 * deepest:.1f} um, smallest det F {smallest:.3f}")
    # Newton's tolerance is 1e-8 of the forces, in the norm over some ten thousand nodes.
    assert imbalance < 1e-6 * abs(plate)
    # A thousandth of a cell, 5 mm on the mean.
    assert deepest < 1e-5
    assert abs(top - (HEIGHT - DOWN)) < 1e-5
    assert abs(tail - (HEIGHT - DOWN)) < 1e-5
    # A few per cent between meshes; another version of Gmsh makes another one.
    assert abs(plate + FORCE) < 0.05 * FORCE
    assert smallest > 0.7


FORCE = 26.0
"""Of the plate [N], on this mesh."""

if __name__ == "__main__":
    main()
