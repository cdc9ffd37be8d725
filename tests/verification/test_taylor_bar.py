"""Taylor's bar: a rod of copper that hits a rigid wall, and what is left of its length.

Length 32.4 mm, radius 3.2 mm, 227 m/s; E = 117 GPa, nu = 0.35, yield stress 0.4 GPa, hardening
0.1 GPa, 8930 kg/m^3.  After 80 us it rests.  G. T. Camacho and M. Ortiz, Comput. Methods Appl.
Mech. Eng. 142 (1997) 269, with their table of others: lengths of 21.42 to 21.66 mm, radii of the
foot of 6.97 to 7.24 mm, largest plastic strains of 2.47 to 3.3.
"""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Dynamics, J2Logarithmic, Problem, Support, rectangle_body
from dolfin_elastic.core.parallel import largest

LENGTH, RADIUS = 32.4e-3, 3.2e-3
FREE = "free"


@pytest.mark.long
def test_length_and_foot(comm: MPI.Comm) -> None:
    """A body of revolution of quadratic triangles that slides on the wall.

    Measured: 21.41 mm and 7.10 mm.  Other meshes and steps move the length by 0.8 %, which the
    bounds leave.
    """
    law = J2Logarithmic(E=117e9, nu=0.35, density=8930, yield_stress=0.4e9, hardening=0.1e9)
    problem = Problem(
        rectangle_body(size=(RADIUS, LENGTH), cells=(5, 40)),
        law,
        geometry="axisymmetric",
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
    )
    solver = Dynamics(
        problem,
        scheme="generalized-alpha",
        end=80e-6,
        dt=4e-7,
        initial_velocity=[0, -227.0],
    )
    *_, state = solver.steps()
    u, places = problem.u.x.array.reshape(-1, 2), problem.places
    top, foot = (np.abs(places[:, 1] - at) < 1e-9 for at in (LENGTH, 0.0))
    length = LENGTH + largest(comm, float(u[top, 1].max(initial=-1.0)))
    radius = largest(comm, float((places[foot, 0] + u[foot, 0]).max(initial=0.0)))
    assert 0.992 * 21.42e-3 < length < 1.008 * 21.66e-3
    assert 6.97e-3 < radius < 7.24e-3
    assert 2.4 < state.numbers["max_plastic_strain"] < 3.6
    # It rests, and what it brought has become heat.
    brought = 0.5 * 8930 * np.pi * RADIUS**2 * LENGTH * 227.0**2
    assert state.energies["kinetic"] < 1e-3 * brought
    assert state.energies["dissipated"] == pytest.approx(brought, rel=0.02)
