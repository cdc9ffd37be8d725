"""A snap-fit: a hook that is pushed over an edge and pulled out again, with friction.

Problem
    A cantilever of L = 43 mm to the middle of its round nose, 2 mm high and 5 mm thick, meets a
    rigid wedge that moves past it by 8 mm and returns.  The wedge reaches 0.8 mm below the top of
    the nose; its flanks are at a = 30 degrees (in) and 45 degrees (out) to the way, and its end is
    round, of the nose's radius of 1 mm.

Equations
    Plane stress with E = 2.8 GPa, contact with Coulomb's friction mu = 0.2.  While the nose slides
    on a flank, the force W along the way and the force P that bends the hook are related by

        W = P (mu + tan a)/(1 - mu tan a).

    By beam theory P and the moment of W about the beam's axis deflect the middle of the nose by

        d = (P (L/3 + c/2) - s W e/2) L^2/(E I),

    where the flank touches c beyond the middle and e above the axis; s is 1 on the way in and -1 on
    the way out.  The design rule leaves c and e out, which is 4 % of P in and 7 % out.

    Source: Bayer MaterialScience, Snap-Fit Joints for Plastics: A Design Guide.

Discretisation
    Quadratic triangles of 0.1 mm on the nose, a tenth of the radii: while the round end passes, the
    direction of the force turns by 3 degrees from one vertex to the next.

Result
    The hook snaps in and comes out.  On both flanks W/P is that of the rule to 1e-6, and P that of
    the beam to 1 %.

        python3 demos/snap_fit/snap_fit.py
        mpirun -n 2 python3 demos/snap_fit/snap_fit.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
MU, LENGTH, NOSE = 0.2, 0.043, 1e-3
"""Friction, length to the middle of the nose and radius of that [m]."""
BENDING = 2.8e9 * 0.005 * 0.002**3 / 12
"""E I [N m^2]."""
FLANKS = ((30.0, 1.0, 0.45e-3), (45.0, -1.0, 0.15e-3))
"""Angle [degrees], sign of c and of the moment, and the deflection up to which the nose is on the
flank [m]."""


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
    with np.errstate(invalid="ignore"):  # before the nose is met, both are 0
        compare(rows)


def compare(rows):
    """With the rule and the beam; rows of load factor, deflection [m], W and P [N]."""
    t, d, W, P = rows.T
    rises = np.append(0.0, np.diff(d)) > 0
    results = []
    for (degrees, sign, most), way in zip(FLANKS, (t < 0.5, t > 0.5), strict=True):
        a = np.radians(degrees)
        on = way & rises & (d > 1e-5) & (d < most)
        rule = (MU + np.tan(a)) / (1 - MU * np.tan(a))
        c, e = sign * NOSE * np.sin(a), 1e-3 + NOSE * np.cos(a)
        bent = (P * (LENGTH / 3 + c / 2) - sign * W * e / 2) * LENGTH**2 / BENDING
        offs = [np.abs(one[on] - 1).max(initial=-1.0) for one in (bent / d, W / P / rule)]
        results.append((int(on.sum()), *offs))
    if MPI.COMM_WORLD.rank == 0:
        print(f"largest deflection {1e3 * d.max():.3f} mm, left at the end {1e3 * d[-1]:.1e} mm")
        for way, (count, beam, ratio) in zip(("in", "out"), results, strict=True):
            print(f"{way}: {count} states on the flank: P off by {beam:.1e}, W/P by {ratio:.1e}")
    for count, beam, ratio in results:
        assert count > 0
        assert ratio < 1e-5
        assert beam < 0.012
    assert abs(d.max() / 0.8e-3 - 1) < 0.05
    assert abs(d[-1]) < 1e-9


if __name__ == "__main__":
    main()
