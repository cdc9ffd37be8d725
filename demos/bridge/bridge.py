"""A steel arch bridge under its own weight and a gust of wind: stress, frequencies and buckling.

Problem
    A tied arch of 40 m span, 6.5 m wide and 8 m high (`bridge.geo`: deck, two ribs, hangers and
    struts, all of solid steel).  Its west end is clamped, its east end slides along the bridge.
    It carries its weight and a wind pressure of 1.5 kPa on every face that looks to windward.

Equations
    Linear elasticity: E = 210 GPa, nu = 0.3, 7850 kg/m^3.

Discretisation
    Quadratic tetrahedra of Gmsh, one layer of them through deck, ribs and hangers: enough for
    displacements and forces.  Stresses where members meet are singular: the largest von Mises
    stress grows as the mesh gets finer, and is to be read as an order of magnitude.

Result
    The reactions of both ends balance weight and wind; the largest stress is far below the yield
    stress of steel, 235 MPa.  It buckles at more than ten times these loads.  Its lowest frequency
    is that of arch and deck swaying.

        python3 demos/bridge/bridge.py
        mpirun -n 2 python3 demos/bridge/bridge.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run
from dolfin_elastic.mesh import mesh_statistics
from dolfin_elastic.problem.state import Mode

HERE = Path(__file__).parent
DENSITY, G, WIND, YIELD = 7850, 9.81, 1500, 235e6
TOLERANCE = 1e-8
"""Of the forces, relative to the weight.  Reactions are those of the discrete equations and so
balance exactly, on any mesh; what is left is the residual of the linear solve, about 1e-12."""


def main():
    comm = MPI.COMM_WORLD
    case = read_case(HERE / "case.toml")
    found = list(run(case))
    modes = [one for one in found if isinstance(one, Mode)]
    state = [one for one in found if not isinstance(one, Mode)][-1]
    frequencies = [mode.frequency for mode in modes if mode.kind == "elastic"]
    (factor,) = [mode.load_factor for mode in modes if mode.kind == "buckling"]
    size = mesh_statistics(case.read_body(comm))
    weight, wind = DENSITY * G * size.volume, WIND * size.surfaces["windward"]
    total = sum(state.reactions.values())
    summary = json.loads((case.results_folder() / "statics/summary.json").read_text())
    peak = summary["extremes"]["von_mises"]
    if comm.rank == 0:
        for name, force in state.reactions.items():
            print(f"reaction of {name:<5} {force[0]:14.3f} {force[1]:14.3f} {force[2]:14.3f} N")
        print(f"both together     {total[0]:14.3f} {total[1]:14.3f} {total[2]:14.3f} N")
        print(f"wind and weight   {0:14.3f} {wind:14.3f} {-weight:14.3f} N")
        print(f"largest deflection {1e3 * state.max_displacement:.2f} mm")
        place = ", ".join(f"{x:.2f}" for x in peak["place"])
        print(f"largest von Mises stress {peak['value'] / 1e6:.1f} MPa at ({place}) m")
        print("frequencies " + ", ".join(f"{one:.2f}" for one in frequencies) + " Hz")
        print(f"buckles at {factor:.1f} times the loads")
    error = np.abs(total - [0, -wind, weight]).max() / weight
    if comm.rank == 0:
        print(f"imbalance over weight: {error:.1e} (allowed {TOLERANCE:.0e})")
    assert error < TOLERANCE
    # Load in tension members and bending of the deck: tens of MPa, whatever the mesh.
    assert 5e6 < peak["value"] < YIELD
    assert factor > 10


if __name__ == "__main__":
    main()
