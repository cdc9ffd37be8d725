"""Mounted masses: weight, frequencies in closed form, motion, and the check's sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from scipy.optimize import brentq

from dolfin_elastic import (
    BaseAcceleration,
    Centrifugal,
    Dynamics,
    Fixed,
    Gravity,
    LinearElastic,
    Modal,
    Normal,
    PointMass,
    Problem,
    Statics,
    box_body,
    rectangle_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.assembly.energy_momentum import NodalMass, lumped
from dolfin_elastic.solvers.assembly.scalar_mass import ScalarMass

E, RHO, L = 1e9, 1000.0, 2.0
BAR = RHO * L


def bar(masses: Any, dim: int = 3, **keys: Any) -> Problem:
    """A bar of 1 m^2 along x, held at the left unless other supports are given."""
    size, number = (L, 1, 1)[:dim], (4, 1, 1)[:dim]
    body = (box_body if dim == 3 else rectangle_body)(size=size, cells=number)
    law = LinearElastic(E=E, nu=0.0, density=RHO)
    return Problem(body, law, **{"supports": [Fixed(on="left")], "masses": masses, **keys})


@pytest.mark.parametrize("ratio", [0.5, 4.0])
def test_axial_modes_of_a_bar_with_a_mass_at_its_end(ratio):
    """beta tan(beta) = m_bar/M, omega = beta/L sqrt(E/rho): cross-sections move along x only."""
    held = [Normal(on=name) for name in ("front", "back", "bottom", "top")]
    mass = PointMass(on="right", mass=f"{ratio * BAR} kg")
    problem = bar([mass], supports=[Fixed(on="left"), *held])
    (mode,) = Modal(problem, count=1).modes()
    beta = brentq(lambda b: b * np.tan(b) - 1 / ratio, 0, 1.57)
    exact = beta / L * np.sqrt(E / RHO) / (2 * np.pi)
    assert mode.frequency == pytest.approx(exact, rel=1e-4)
    assert mode.whole["x"] == pytest.approx((1 + ratio) * BAR, rel=1e-12)


@pytest.mark.parametrize("value", [[], ["3 + 0*y", 0, 0]])
def test_weight(value):
    """Of the bar and the mass; a formula counts where the mass is, too."""
    mass = PointMass(on=["right", "top"], mass="500 kg")
    *_, state = Statics(bar([mass], loads=[Gravity(value=value)], degree=1)).steps()
    wanted = [-3 * 2500, 0, 0] if value else [0, 0, 9.81 * 2500]
    np.testing.assert_allclose(state.reactions["left"], wanted, rtol=1e-12, atol=1e-8)


def test_weight_of_a_region_is_without_the_mass():
    mass = PointMass(on="right", mass=500)
    problem = bar([mass], degree=1)
    body = problem.body.named(regions={"all": problem.body.owned_cells()})
    law = LinearElastic(E=E, nu=0.0, density=RHO)
    keys = {"supports": [Fixed(on="left")], "masses": [mass], "degree": 1}
    *_, state = Statics(Problem(body, law, loads=[Gravity(on="all")], **keys)).steps()
    np.testing.assert_allclose(state.reactions["left"], [0, 0, 9.81 * BAR], rtol=1e-12, atol=1e-8)


def test_a_base_that_is_accelerated():
    mass = PointMass(on="right", mass=500)
    *_, state = Statics(bar([mass], loads=[BaseAcceleration(value=[3, 0, 0])], degree=1)).steps()
    np.testing.assert_allclose(state.reactions["left"], [7500, 0, 0], rtol=1e-12, atol=1e-8)


def test_a_mass_that_is_swung():
    """omega^2 (m_bar L/2 + M L) about the fixed end."""
    mass = PointMass(on="right", mass=500)
    *_, state = Statics(bar([mass], loads=[Centrifugal(value=2)], degree=1)).steps()
    np.testing.assert_allclose(state.reactions["left"][0], -4 * (BAR + 500 * L), rtol=1e-12)


@pytest.mark.parametrize(("dim", "thickness"), [(3, 1.0), (2, 0.25)])
def test_mass_of_motion(dim, thickness):
    """Kinetic energy and momentum, and the lumped mass of explicit schemes."""
    keys = {"thickness": thickness} if dim == 2 else {}
    problem = bar([PointMass(on="right", mass=500)], dim, degree=1, supports=[], **keys)
    v = fem.Function(problem.V)
    v.x.array[0::dim] = 3.0
    energy, momentum, _ = NodalMass(problem, v, ScalarMass(problem).times).measure()
    m = BAR * thickness + 500
    assert energy == pytest.approx(4.5 * m, rel=1e-12)
    np.testing.assert_allclose(momentum, [3 * m, 0, 0][:dim], rtol=1e-12, atol=1e-9)
    assembler = Assembler(problem)
    own = lumped(problem, assembler)
    assembler.destroy()
    assert problem.body.comm.allreduce(own.sum()) == pytest.approx(dim * m, rel=1e-12)


@pytest.mark.parametrize(
    ("scheme", "keys"), [("newmark", {"dt": 5e-4}), ("central-differences", {})]
)
def test_free_fall(scheme, keys):
    """Body and mass fall alike, and energy is conserved."""
    mass = PointMass(on="right", mass=500)
    problem = bar([mass], supports=[], loads=[Gravity()], degree=1)
    *_, state = Dynamics(problem, scheme=scheme, end=2e-3, **keys).steps()
    v = state.v.x.array.reshape(-1, 3)
    np.testing.assert_allclose(v[:, 2], -9.81 * 2e-3, rtol=1e-6)


def test_check_counts_it():
    """Total mass and its centre, and the weight with its moment."""
    case = Case(
        mesh={"box": {"size": [L, 1, 1], "cells": [2, 1, 1]}, "degree": 1},
        materials={"steel": {"law": "linear-elastic", "E": E, "nu": 0.3, "density": RHO}},
        support=[{"kind": "fixed", "on": "left"}],
        load=[{"kind": "gravity"}],
        mass=[{"on": "right", "mass": "500 kg", "name": "motor"}],
        statics={},
    )
    made = report(case)
    whole = made.regions[0]
    assert whole.mass == pytest.approx(2500, rel=1e-12)
    np.testing.assert_allclose(whole.centre_of_mass, [(2000 + 1000) / 2500, 0.5, 0.5], rtol=1e-12)
    (weight,) = made.loads
    np.testing.assert_allclose(weight.force, [0, 0, -9.81 * 2500], rtol=1e-12)
    np.testing.assert_allclose(weight.moment[1], 9.81 * 3000, rtol=1e-12)
    assert case.model_tables()["mass"] == [{"on": "right", "mass": 500.0, "name": "motor"}]


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"on": "right", "mass": "2 N"}, "mass"),
        ({"on": "right", "mass": 0}, "mass"),
        ({"on": "right"}, "mass"),
        ({"on": [], "mass": 1}, "on: no name is given"),
    ],
)
def test_what_is_no_mass(keys, says):
    with pytest.raises(InputError) as caught:
        PointMass(**keys)
    assert says in str(caught.value)


def test_surface_without_area():
    empty = box_body(size=(1, 1, 1), cells=(1, 1, 1)).named(
        surfaces={"none": np.empty(0, dtype=np.int32)}
    )
    law, masses = LinearElastic(E=E, nu=0.0, density=RHO), [PointMass(on="none", mass=1)]
    with pytest.raises(InputError, match=r"mass\[0\].on: the surface has no area"):
        Problem(empty, law, loads=[Gravity()], masses=masses)
