"""Every law against energies typed anew in extended precision (`reference_energies`).

Energy, stress and tangent at points where formulas for stretches break: at F = I and as good as
there, under rotations, where two stretches meet, in strong tension and compression.  Then bars
with free sides, through the whole solver.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from helpers import reference_energies as reference
from helpers.law_at_points import Point
from helpers.laws import FREE, ROLLERS, SIZE, homogeneous, make, random_F, rotation
from mpi4py import MPI
from ufl.algorithms import expand_derivatives

from dolfin_elastic.model.kinematics import gradient_symbol
from dolfin_elastic.model.materials.isochoric import VOLUME_STRAINS, Volumetric
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.ufl_to_numpy import NumpyProgram

I = np.eye(3)
ROUND = 1e-14 * 1e6
"""A few roundings of the moduli, which are of the order of 1 MPa."""
SMALL = np.random.default_rng(7).uniform(-1, 1, (3, 3))
Q, R = rotation(1), rotation(2)
STATES = {
    "rest": I,
    "1e-12 from rest": I + 1e-12 * SMALL,
    "1e-9 from rest": I + 1e-9 * SMALL,
    "1e-4 from rest": I + 1e-4 * SMALL,
    "just in the series": I + 8.5e-3 * SMALL,
    "just out of the series": I + 2e-2 * SMALL,
    "turned": Q,
    "uniaxial": np.diag([1.5, 0.9, 0.9]),
    "uniaxial, turned": Q @ np.diag([1.5, 0.9, 0.9]) @ R,
    "uniaxial by 1e-6": Q @ np.diag([1.5, 0.9, 0.9 + 1e-6]) @ R,
    "uniaxial by 1e-3": Q @ np.diag([1.5, 0.9, 0.9 + 1e-3]) @ R,
    "equibiaxial": Q @ np.diag([1.2, 1.2, 0.7]) @ R,
    "equibiaxial by 1e-6": Q @ np.diag([1.2, 1.2 + 1e-6, 0.7]) @ R,
    "volumetric": 1.3 * R,
    "to a tenth": np.diag([0.1, 1.0, 1.0]),
    "to a tenth, turned": Q @ np.diag([0.1, 1.3, 1.1]) @ R,
    "to three": np.diag([3.0, 1.0, 1.0]),
    "to three, turned": Q @ np.diag([3.0, 3**-0.5, 3**-0.5]) @ R,
    "anyhow": random_F(5),
}
SLACK = ("rest", "1e-12 from rest", "turned", "volumetric")
"""Where the second differences of a law cross the point at which fibres go slack."""
ALONG = np.random.default_rng(8).uniform(-1, 1, (3, 3))
ENERGIES = [name for name, kind in MATERIALS.items() if name in reference.ENERGIES]


def law_of(name: str, **more: Any) -> Law:
    return make(name, **more)


def compare(law: Law, states: dict[str, np.ndarray], tolerance: float) -> None:
    """Errors over the value; near rest, where F itself is rounded, a few roundings of moduli."""
    point, faults = Point(law), []
    for state, F in states.items():
        psi, P = float(reference.energy(law, reference.matrix(F))), reference.stress(law, F)
        dP = reference.stress_along(law, F, ALONG)
        errors = {
            "energy": abs(point.energy(F) - psi) / (tolerance * abs(psi) + ROUND),
            "stress": np.abs(point.stress(F) - P).max() / (tolerance * np.abs(P).max() + ROUND),
            "tangent": np.abs(point.along(F, ALONG) - dP).max() / (tolerance * np.abs(dP).max()),
        }
        faults += [(state, what, error) for what, error in errors.items() if not error < 1]
    assert not faults


@pytest.mark.usefixtures("serial_only")
def test_every_energy_has_a_reference():
    assert [n for n, kind in MATERIALS.items() if n not in ENERGIES] == ["textbook"]


@pytest.mark.sample(3)
@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("name", ENERGIES)
def test_energy_stress_and_tangent(name):
    states = STATES
    if name == "holzapfel-gasser-ogden":  # its tangent jumps where the fibres go slack
        states = {k: F for k, F in STATES.items() if k not in SLACK}
    # Reached: 1e-9 for laws of the stretches where two of them meet, 1e-13 for the others.
    compare(law_of(name), states, 1e-8)


@pytest.mark.long
@pytest.mark.usefixtures("serial_only")
def test_fibres_that_bear_compression_are_smooth():
    law = law_of("holzapfel-gasser-ogden", slack=False, fibre2=None)
    compare(law, STATES, 1e-11)


SIZES = (1, 1 - 1e-12, 1 + 1e-9, 1 + 1e-5, 1.1, 0.903, 0.908, 1.104, 1.107, 0.2, 5.0)


@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("volumetric", VOLUME_STRAINS)
def test_energies_of_volume(volumetric):
    """About J = 1, where a formula for the square root of the energy would cancel, and far off."""
    law = law_of("neo-hookean-split", volumetric=volumetric)
    compare(law, {str(s): s * R for s in SIZES}, 1e-11)
    for kind in MATERIALS.values():
        assert not issubclass(kind, Volumetric) or "volumetric" in kind.model_fields


@pytest.mark.usefixtures("serial_only")
@pytest.mark.parametrize("volumetric", VOLUME_STRAINS)
def test_derivatives_of_volume_strains(volumetric):
    """Those that are written out, of which a pressure sees g' and a modulus g g', are g's."""
    measure, F = VOLUME_STRAINS[volumetric], gradient_symbol()
    J = ufl.variable(ufl.det(F))
    g, slope = measure.strain(J, J - 1), ufl.as_ufl(measure.slope(J, J - 1))
    wanted = ufl.diff(g, J), g * ufl.diff(g, J), ufl.diff(ufl.diff(g, J), J)
    found = slope, measure.stress(J, J - 1), ufl.diff(slope, J)
    program = NumpyProgram(expand_derivatives(ufl.as_vector([*wanted, *found])), F)
    values = program(np.array([s * I for s in SIZES])).reshape(-1, 2, 3)
    np.testing.assert_allclose(values[:, 1], values[:, 0], rtol=1e-11, atol=1e-14)
    refused = np.isnan(program(np.diag([-1.0, 0.7, 0.9])[None])[0, 3:5]).tolist()
    # Of g' and of g g': where ln J is in them.
    wrong = {"simo-taylor": [True, True], "quadratic": [False, False], "log": [False, True]}
    assert refused == wrong[volumetric]


# --- bars with free sides ---

STRAIGHT = {
    "guccione": {"fibre": [1, 0, 0]},
    "orthotropic": {"axis1": [0, 1, 0], "axis2": [0, 0, 1]},
}
"""Directions with which the bar stays straight."""


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", ENERGIES)
@pytest.mark.parametrize("stretch", [0.8, 1.3])
def test_uniaxial_states(comm, name, stretch):
    """The sides' stretches and the force from the reference energy, found independently."""
    law = law_of(name, **STRAIGHT.get(name, {}))
    expected, P11 = reference.uniaxial(law, stretch)
    held = {**ROLLERS, "right": [(stretch - 1) * SIZE[0], FREE, FREE]}
    found, reaction = homogeneous(law, held, SIZE)
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert reaction["right"][0] == pytest.approx(P11, rel=1e-8)
    assert comm.allreduce(found[0], op=MPI.MAX) == pytest.approx(stretch)
