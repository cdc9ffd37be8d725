"""A rubber duck, squeezed to two thirds of its width.

Problem
    A solid duck of 14 cm length (`duck.geo`: ellipsoids, spheres and a cone in one piece), glued
    to a table by its flat bottom.  Two smooth jaws press on its flanks until the width between
    them, 72 mm, has become 48 mm.

Equations
    Neo-Hookean with E = 1 MPa, nu = 0.45; equilibrium.  On the flanks y is prescribed,
    u_y = +-24 mm - y, and the other two components are free.

Discretisation
    Quadratic tetrahedra of Gmsh, 7 mm and finer at eyes, beak and tail; five load steps; conjugate
    gradients with multigrid.  With `degree = 1` it takes half the time, but linear elements are
    too stiff for nearly incompressible rubber: the force comes out a fifth too large.

Result
    The duck is two thirds as wide between the jaws, which press with almost 0.7 kN; no cell
    turns inside out; all forces balance.

        python3 demos/duck/duck.py
        mpirun -n 2 python3 demos/duck/duck.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
WIDTH = 0.072


def width_of_the_flanks(u):
    """Width of the body in y where the jaws are, before and after [m]."""
    comm = u.function_space.mesh.comm
    x = u.function_space.tabulate_dof_coordinates()
    moved = x[:, 1] + u.x.array.reshape(-1, 3)[:, 1]
    near = (np.abs(x[:, 0]) < 0.02) & (np.abs(x[:, 2] - 0.0275) < 0.015)

    def extent(y):
        return comm.allreduce(y[near].max(initial=-1), op=MPI.MAX) - comm.allreduce(
            y[near].min(initial=1), op=MPI.MIN
        )

    return extent(x[:, 1]), extent(moved)


def main():
    comm = MPI.COMM_WORLD
    case = read_case(HERE / "case.toml")
    *_, state = run(case)
    before, after = width_of_the_flanks(state.u)
    left, right = (state.reactions[f"{side}_flank"][1] for side in ("left", "right"))
    imbalance = np.abs(sum(state.reactions.values())).max()
    summary = json.loads((case.results_folder() / "summary.json").read_text())
    smallest = summary["extremes"]["min_jacobian"]["value"]
    if comm.rank == 0:
        print(
            f"width {1e3 * before:.2f} mm -> {1e3 * after:.3f} mm, "
            f"{after / WIDTH:.4f} of the duck's {1e3 * WIDTH:.0f} mm"
        )
        print(f"forces of the jaws {left:.1f} N and {right:.1f} N, imbalance {imbalance:.1e} N")
        print(f"smallest det F {smallest:.3f}")
    # Prescribed values hold exactly.
    assert abs(after - 2 / 3 * WIDTH) < 1e-9
    # Newton's tolerance is 1e-8 of the forces, in the norm over some ten thousand nodes.
    assert imbalance < 1e-6 * right
    # Half a per cent between meshes of 6 and 7 mm; another version of Gmsh makes another one.
    assert abs(right - FORCE) < 0.03 * FORCE
    assert smallest > 0.5


FORCE = 685.0
"""Of one jaw [N], on this mesh."""

if __name__ == "__main__":
    main()
