"""A snap-fit: a hook that is pushed over an edge and pulled out again, with friction.

Problem
    A cantilever of length L = 43 mm to its round nose, 2 mm high and 5 mm thick, meets a rigid
    wedge that moves past it by 8 mm and returns.  The wedge is 0.5 mm lower than the nose; its
    flanks are at a = 30 degrees (in) and 45 degrees (out) to the way.

Equations
    Plane stress with E = 2.8 GPa, contact with Coulomb's friction mu = 0.2.  While the nose slides
    on a flank the force W along the way and the force P that bends the hook by d are

        W = P (mu + tan a)/(1 - mu tan a),    P = 3 E I d/L^3.

    Source: Bayer MaterialScience, Snap-Fit Joints for Plastics: A Design Guide.

Discretisation
    Quadratic triangles of 0.2 mm on the nose.  The solver makes steps that fail smaller by itself.
    While the tip of the wedge passes the nose, forces waver: it is sharper than the elements.

Result
    The hook snaps in and comes out.  On the way in W/P is that of the rule to 1e-3, and P to 5 %:
    the rule leaves out the moment of W about the beam's axis.

        python3 demos/snap_fit/snap_fit.py
        mpirun -n 2 python3 demos/snap_fit/snap_fit.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
SLOPE, MU = np.tan(np.radians(30.0)), 0.2
RULE = (MU + SLOPE) / (1 - MU * SLOPE)
STIFFNESS = 3 * 2.8e9 * (0.005 * 0.002**3 / 12) / 0.043**3
"""3 E I/L^3 [N/m]."""
ON_FLANK = 0.2e-3
"""Deflection up to which the nose slides on the flank, an element from its end at least [m]."""


def deflection(state):
    """How far the upper end of the nose has gone down [m]."""
    space = state.u.function_space
    own = space.dofmap.index_map.size_local
    x = space.tabulate_dof_coordinates()[:own, :2]
    down = -state.u.x.array.reshape(-1, 2)[:own, 1][np.hypot(*(x - [0.043, 0.003]).T) < 1e-7]
    return space.mesh.comm.allreduce(float(np.max(down, initial=-1.0)), op=MPI.MAX)


def main():
    case = read_case(HERE / "case.toml")
    rows = np.array(
        [[s.load_factor, deflection(s), *np.abs(s.reactions["edge"])] for s in run(case)]
    )
    t, d, W, P = rows.T
    on = (t < 0.5) & (d > 1e-5) & (d < ON_FLANK) & (np.arange(len(t)) < np.argmax(d))
    off = np.abs(W[on] / P[on] / RULE - 1).max(initial=-1.0)
    bent = np.abs(P[on] / (STIFFNESS * d[on]) - 1).max(initial=-1.0)
    if MPI.COMM_WORLD.rank == 0:
        print(f"largest deflection {1e3 * d.max():.3f} mm, left at the end {1e3 * d[-1]:.1e} mm")
        print(f"{on.sum()} states on the flank: P off by {bent:.1e}, W/P by {off:.1e}")
    assert on.sum() > 1
    assert off < 1e-3
    assert bent < 0.05
    assert abs(d.max() / 0.5e-3 - 1) < 0.05
    assert abs(d[-1]) < 1e-9


if __name__ == "__main__":
    main()
