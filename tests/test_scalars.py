"""Scalar unknowns beside the fields: pressures of cavities, motions of rigid surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Cavity,
    Gravity,
    NeoHookean,
    Problem,
    Rigid,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
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
