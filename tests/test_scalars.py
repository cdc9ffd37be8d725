"""Scalar unknowns beside the fields: pressures of cavities, motions of rigid surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Cavity,
    Gravity,
    NeoHookean,
    NeoHookeanSplit,
    Problem,
    Rigid,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    read_body,
    rectangle_body,
)

FREE = "free"


def strip(length, thick, cells, *, loads=(), law=None, **plate):
    """A strip along x, held at the left, with a rigid plate at its right end."""
    return Problem(
        rectangle_body(size=(length, thick), cells=cells, origin=(0.0, -thick / 2)),
        law or StVenantKirchhoff(E=1e6, nu=0.0),
        degree=2,
        supports=[Support(on="left", displacement=[0, 0]), Rigid(on="right", **plate)],
        loads=loads,
    )


def test_roll_up():
    """Pure moment M L/(EI) = pi/2."""
    L, h, E = 1.0, 0.02, 1e6
    M = np.pi / 2 * E * h**3 / 12 / L
    problem = strip(L, h, (16, 1), force=[0, 0], moment=M)
    *_, state = Statics(problem).steps()
    print(state.numbers, [s for s in state.residuals], state.reactions)
    R = L / (np.pi / 2)
    assert state.numbers["right_ux"] == pytest.approx(R - L, abs=1e-3)
    assert state.numbers["right_uy"] == pytest.approx(R, abs=1e-3)
    assert state.numbers["right_rz"] == pytest.approx(np.pi / 2, abs=1e-3)
    assert state.numbers["moment_right_z"] == pytest.approx(M, rel=1e-6)


# --- cavities ---


def quarter(folder, cells=(3, 8)):
    """A quarter of a ring of radii 1 and 2, with curved quadratic cells."""
    geo = folder / "quarter.geo"
    if MPI.COMM_WORLD.rank == 0:
        geo.write_text(f"""
Point(1) = {{0, 0, 0}};
Point(2) = {{1, 0, 0}};
Point(3) = {{2, 0, 0}};
Point(4) = {{0, 2, 0}};
Point(5) = {{0, 1, 0}};
Line(1) = {{2, 3}};
Circle(2) = {{3, 1, 4}};
Line(3) = {{4, 5}};
Circle(4) = {{5, 1, 2}};
Curve Loop(1) = {{1, 2, 3, 4}};
Plane Surface(1) = {{1}};
Transfinite Curve {{1, 3}} = {cells[0] + 1};
Transfinite Curve {{2, 4}} = {cells[1] + 1};
Transfinite Surface {{1}};
Mesh.ElementOrder = 2;
Physical Curve("bottom") = {{1}};
Physical Curve("outside") = {{2}};
Physical Curve("axis") = {{3}};
Physical Curve("inside") = {{4}};
Physical Surface("body") = {{1}};
""")
    MPI.COMM_WORLD.barrier()
    return read_body(geo)


def sphere(folder, load, law=None, cells=(3, 8)):
    """A thick sphere, A = 1 and B = 2, as a body of revolution cut at its equator."""
    return Problem(
        quarter(folder, cells),
        law or NeoHookeanSplit(E=3.0, nu=0.5),
        degree=2,
        geometry="axisymmetric",
        supports=[Support(on="bottom", displacement=[FREE, 0])],
        loads=[load],
    )


HALF = 2 * np.pi / 3
"""Volume inside half a sphere of radius 1."""

STATES = {1.1: 0.287154845934, 1.25: 0.551868541979, 1.5: 0.755433118712, 2.0: 0.806926603107,
          3.0: 0.634506675236}


def test_sphere_inflated_by_volume(folder):
    problem = sphere(folder, Cavity(on="inside", volume_ratio="1 + 26*t"))
    times = [(a**3 - 1) / 26 for a in STATES]
    found = {}
    for state in Statics(problem, times=times[:-1]).steps():
        print(state.t, state.numbers, state.newton, state.negative)
        found[round((state.numbers["volume_inside"]/HALF)**(1/3), 6)] = state.numbers["pressure_inside"]
    for a, p in STATES.items():
        assert found[a] == pytest.approx(p, rel=2e-3)
