"""An O-ring in its groove: squeezed by the lid, then pushed to the wall by a fluid of 10 MPa.

Problem
    A ring of rubber, 5 mm thick, lies in a groove, at its outer wall.  The lid squeezes it by 18 %;
    then the fluid inside presses on it.  Under the lid, from where the ring leaves it, the fluid's
    pressure falls to zero along 1.2 mm, as in the film of a lubricated seal.

Equations
    A body of revolution, neo-Hookean with E = 10 MPa and nu = 0.49, and rigid planes without
    friction.  Floor and lid act alike: the upper half is computed.  Rubber passes the fluid's
    pressure on nearly as a liquid would: with P0 the largest pressure under the lid of the squeezed
    ring, and p that of the fluid, it becomes about

        P = P0 + nu/(1 - nu) p,

    and the ring seals while the pressure under the lid, beyond the film, is above p.

Discretisation
    Linear triangles of 0.2 mm with a pressure of their own: gaps vanish at all nodes of the
    contact.  Pressures are stresses recovered at the surface.

Result
    The ring seals up to 10 MPa, and P is that of the rule to 5 %, of which the recovered stress is
    the larger part.

        python3 demos/o_ring/o_ring.py
        mpirun -n 2 python3 demos/o_ring/o_ring.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
NU, FLUID, SQUEEZED = 0.49, 10e6, 0.3
"""Poisson's ratio, the last pressure of the fluid [Pa], the load factor from which on it rises."""


def main():
    rows = []
    for state in run(read_case(HERE / "case.toml")):
        pressures = [-state.numbers[f"{part}_cauchy_stress_min_yy"] for part in ("top", "dry")]
        rows.append([state.load_factor, *pressures])
    t, top, dry = np.array(rows).T
    (first,) = top[np.isclose(t, SQUEEZED)]
    fluid = FLUID * np.clip((t - SQUEEZED) / (1 - SQUEEZED), 0, 1)
    off = np.abs(top[-1] / (first + NU / (1 - NU) * FLUID) - 1)
    if MPI.COMM_WORLD.rank == 0:
        print("fluid [MPa]  largest pressure on the lid [MPa]")
        for p, pressure in zip(fluid[t >= SQUEEZED], dry[t >= SQUEEZED], strict=True):
            print(f"{p / 1e6:11.2f}  {pressure / 1e6:8.2f}")
        print(f"squeezed {first / 1e6:.2f} MPa; at the end off the rule by {off:.1e}")
    assert t[-1] == 1
    assert np.all(dry[t >= SQUEEZED] > fluid[t >= SQUEEZED])
    assert off < 0.05


if __name__ == "__main__":
    main()
