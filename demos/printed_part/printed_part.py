"""A printed beam with graded infill: its deflection and its safety factor.

Problem
    A cantilever of length L = 200 mm, width b = 10 mm and height h = 20 mm, printed with an infill
    i(z) that falls from 1 at the top and the bottom to 0.2 in the middle, carries P = 40 N at its
    tip.  The infill governs stiffness, E i^1.5, and strength, 40 MPa i^1.5.

Equations
    Linear elasticity with E(z).  Beam theory for a modulus that varies over the height gives the
    deflection P L^3 / (3 B) + P L s, with the bending stiffness B = b int E z^2 dz and the
    compliance in shear s = b int S^2 / G dz / B^2, where S(z) = int_z^(h/2) E zeta dzeta: the
    shear stress of equilibrium, V S / B, and its energy.  Source: S. Timoshenko and J. Gere,
    Mechanics of Materials, on composite beams and on strain energy in shear.

Discretisation
    32 x 2 x 6 little boxes of six quadratic tetrahedra each.  E is linear in each of them, through
    its values at the four points of the quadrature rule.

Result
    The deflection of the tip within 1 % of beam theory, and the smallest safety factor, which is
    at the clamped end.

        python3 demos/printed_part/printed_part.py
        mpirun -n 2 python3 demos/printed_part/printed_part.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
L, B, H, P, NU = 0.2, 0.01, 0.02, 40.0, 0.35
TOLERANCE = 1e-2
"""Of the deflection.  The clamp hinders the sideways strain near it, which beam theory leaves out:
that accounts for 8e-3; with nu = 0 in both, 1e-4 remains."""


def beam_theory() -> float:
    """Deflection of the tip [m]."""
    z = np.linspace(-H / 2, H / 2, 20001)
    E = 3.5e9 * (0.2 + 0.8 * (z / 0.01) ** 2) ** 1.5
    stiffness = B * np.trapezoid(E * z**2, z)
    steps = (E * z)[:-1] + (E * z)[1:]
    S = -np.concatenate([[0.0], np.cumsum(steps) * (z[1] - z[0]) / 2])
    shear = B * np.trapezoid(S**2 / (E / (2 * (1 + NU))), z) / stiffness**2
    return P * L**3 / (3 * stiffness) + P * L * shear


def tip(u) -> float:
    """Mean vertical displacement of the nodes at the tip's mid-height, on all ranks."""
    nodes = u.function_space.tabulate_dof_coordinates()
    owned = u.function_space.dofmap.index_map.size_local
    near = (np.abs(nodes[:owned, 0] - L) < 1e-9) & (np.abs(nodes[:owned, 2]) < 1e-9)
    own = np.array([u.x.array[: 3 * owned].reshape(-1, 3)[near, 2].sum(), near.sum()])
    total, count = u.function_space.mesh.comm.allreduce(own, op=MPI.SUM)
    return total / count


def main():
    case = read_case(HERE / "case.toml")
    *_, state = run(case)  # to its end, so that the summary is complete
    deflection, expected = -tip(state.u), beam_theory()
    difference = abs(deflection / expected - 1)
    if MPI.COMM_WORLD.rank == 0:
        summary = json.loads((case.results_folder() / "summary.json").read_text())
        factor = summary["extremes"]["safety_factor"]
        place = ", ".join(f"{1e3 * x:.1f}" for x in factor["place"])
        print(f"deflection {1e3 * deflection:.4f} mm, beam theory {1e3 * expected:.4f} mm")
        print(f"smallest safety factor {factor['value']:.2f} at ({place}) mm")
        print(f"difference from beam theory: {difference:.1e} (allowed {TOLERANCE:.0e})")
        assert factor["value"] > 1
    assert difference < TOLERANCE


if __name__ == "__main__":
    main()
