"""An O-ring in its groove: squeezed by the lid, then pushed to the wall by a fluid of 10 MPa.

Problem
    A ring of rubber, 5 mm thick, lies in a groove, at its outer wall.  The lid squeezes it by 18 %;
    then the fluid inside presses on it.  Under the lid, from where the ring leaves it, the fluid's
    pressure falls to zero along 1.2 mm, as in the film of a lubricated seal.

Equations
    A body of revolution, neo-Hookean with E = 10 MPa and nu = 0.49, and rigid planes with Coulomb's
    friction of 0.1.  Floor and lid act alike: the upper half is computed.  Squeezed with the force
    F per length, a cylinder of the radius r has by Hertz the largest pressure and the width

        P0 = (F E*/(pi r))^(1/2),    2 b = 4 F/(pi P0),    E* = E/(1 - nu^2).

    Rubber passes the fluid's pressure p on nearly as a liquid would: under the lid it becomes about

        P = P0 + nu/(1 - nu) p,

    and the ring seals while the pressure under the lid, beyond the film, is above p.  The load acts
    where the lid presses, too, and the lid's pressure is what is needed beside it: the fluid goes
    only where the rubber presses less than the fluid.

    nu/(1 - nu) being what an elastic body that cannot widen presses sideways.

    Source: K. L. Johnson, Contact Mechanics (1985), (4.43) to (4.45), of Hertz.

Discretisation
    Quadratic triangles of 0.2 mm with a pressure of their own.  The load steps are the solver's.
    Pressures are stresses recovered at the surface.

Result
    Squeezed, pressure and width are those of Hertz to 5 and 10 %, the strain being far from small.
    The ring seals up to 10 MPa, and P is that of the rule to 5 %.

        python3 demos/o_ring/o_ring.py
        mpirun -n 2 python3 demos/o_ring/o_ring.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
E, NU, RADIUS, LENGTH = 10e6, 0.49, 2.5e-3, 2 * np.pi * 0.03
"""Moduli of the rubber [Pa], radius of the section and length of the ring [m]."""
FLUID, SQUEEZED = 10e6, 0.3
"""The last pressure of the fluid [Pa], the load factor from which on it rises."""


def main():
    rows = []
    for state in run(read_case(HERE / "case.toml")):
        pressures = [-state.numbers[f"{part}_cauchy_stress_min_yy"] for part in ("top", "dry")]
        lid = -state.reactions["lid"][1], state.numbers["contact_area_lid"]
        rows.append([state.load_factor, *pressures, *lid])
    t, top, dry, force, area = np.array(rows).T
    (k,) = np.flatnonzero(np.isclose(t, SQUEEZED))
    first = top[k]
    hertz = np.sqrt(force[k] / LENGTH * E / (1 - NU**2) / (np.pi * RADIUS))
    width = 4 * force[k] / LENGTH / (np.pi * hertz)
    pressed, wide = abs(first / hertz - 1), abs(area[k] / LENGTH / width - 1)
    fluid = FLUID * np.clip((t - SQUEEZED) / (1 - SQUEEZED), 0, 1)
    off = np.abs(top[-1] / (first + NU / (1 - NU) * FLUID) - 1)
    if MPI.COMM_WORLD.rank == 0:
        print("fluid [MPa]  largest pressure on the lid [MPa]")
        for p, pressure in zip(fluid[t >= SQUEEZED], dry[t >= SQUEEZED], strict=True):
            print(f"{p / 1e6:11.2f}  {pressure / 1e6:8.2f}")
        print(f"squeezed: pressure off Hertz by {pressed:.1e}, width by {wide:.1e}")
        print(f"squeezed {first / 1e6:.2f} MPa; at the end off the rule by {off:.1e}")
    assert t[-1] == 1
    assert np.all(dry[t >= SQUEEZED] > fluid[t >= SQUEEZED])
    assert pressed < 0.05
    assert wide < 0.1
    assert off < 0.05


if __name__ == "__main__":
    main()
