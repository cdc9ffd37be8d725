"""Large deflection of a slender strip, against the elastica.

Problem
    A strip of length L = 1 m and thickness h = L/100, clamped at the left, bent by a dead load P
    at its tip that grows until P L^2 / EI = 10: the tip then points almost straight down.

Equations
    Neo-Hookean in plane strain, so EI = E h^3 / 12 / (1 - nu^2).  The elastica, an inextensible
    line whose curvature is M / EI, is the limit of thin strips; its solution in elliptic
    integrals is tabulated by Bisshopp & Drucker, Quart. Appl. Math. 3 (1945) 272, and Mattiasson,
    Int. J. Numer. Meth. Eng. 17 (1981) 145.

Discretisation
    150 x 2 squares of two quadratic triangles each; ten load steps.

Result
    Tip displacements within 1e-3 of the length L of the elastica, at five loads.

        python3 demos/cantilever/cantilever.py
        mpirun -n 2 python3 demos/cantilever/cantilever.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
TIP = np.array([1.0, 0.005, 0.0])
ELASTICA = {
    1: (0.30172077, 0.05643324),
    2: (0.49345748, 0.16064172),
    3: (0.60325344, 0.25442018),
    5: (0.71379152, 0.38762836),
    10: (0.81060902, 0.55499560),
}
"""P L^2 / EI to deflection w/L and shortening u/L."""
TOLERANCE = 1e-3
"""Of w/L and u/L.  Thickness accounts for about 2e-4 at L/h = 100 (a solid strip shears and
stretches, the elastica does not), the mesh for the rest."""


def displacement_at(u, place):
    """Displacement of the node at a place, on all ranks."""
    nodes = u.function_space.tabulate_dof_coordinates()
    owned = u.function_space.dofmap.index_map.size_local
    near = np.flatnonzero(np.linalg.norm(nodes[:owned] - place, axis=1) < 1e-9)
    own = u.x.array.reshape(-1, 2)[near].sum(axis=0)
    return u.function_space.mesh.comm.allreduce(own, op=MPI.SUM)


def main():
    comm = MPI.COMM_WORLD
    worst = 0.0
    if comm.rank == 0:
        print("P L^2/EI      w/L  elastica       u/L  elastica")
    for state in run(read_case(HERE / "case.toml")):
        load = round(10 * state.load_factor)
        if load not in ELASTICA:
            continue
        ux, uy = displacement_at(state.u, TIP)
        w, u = ELASTICA[load]
        worst = max(worst, abs(-uy - w), abs(-ux - u))
        if comm.rank == 0:
            print(f"{load:8d} {-uy:8.5f}  {w:8.5f}  {-ux:8.5f}  {u:8.5f}")
    if comm.rank == 0:
        print(f"largest difference: {worst:.1e} (allowed {TOLERANCE:.0e})")
    assert worst < TOLERANCE


if __name__ == "__main__":
    main()
