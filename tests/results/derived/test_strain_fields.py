"""Strain fields: without the square of the rotation in small-strain laws, and down to 1e-18."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Force,
    Growth,
    Hencky,
    LinearElastic,
    NeoHookean,
    Orthotropic,
    Probe,
    Problem,
    Statics,
    Support,
    Thermal,
    box_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.evaluate import Evaluator

COMM = MPI.COMM_WORLD
I = np.eye(3)
H = np.array([[0.02, 0.10, -0.03], [-0.12, 0.01, 0.04], [0.05, -0.03, -0.015]])
"""More rotation than strain."""
STRAINS = ["strain", "green_strain", "almansi_strain", "log_strain"]


def fields(law: Any, gradient: np.ndarray, names: list[str], loads: Any = ()) -> dict[str, Any]:
    """Values of a homogeneous deformation, which must be the same in all cells."""
    problem = Problem(box_body(size=(1, 1, 1), cells=(1, 1, 1)), law, degree=1, loads=loads)
    problem.set_time(1.0)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: gradient @ x)
    return Evaluator(problem, names)(State(1, 1.0, u))


def agrees(found: Any, expected: Any, atol: float) -> None:
    difference = np.abs(found - np.ravel(expected)).max(initial=0.0)
    assert largest(COMM, float(difference)) <= atol


def test_bent_beam():
    """A beam with a deflection of 3.4 mm over 200 (nu = 0): strain is stress over E, everywhere.

    Round-off of the stress alone is between them; Green's strain of it has 20 % more.
    """
    body = box_body(size=(0.2, 0.02, 0.01), cells=(10, 2, 2))
    E = 70e9
    problem = Problem(
        body,
        LinearElastic(E=E, nu=0),
        supports=[Support(on="left")],
        loads=[Force(on="right", value=[0, 0, -100.0])],
    )
    probe = Probe(problem, {"g": [0.1, 0.01, 0.01]}, ["strain", "green_strain"])
    *_, state = Statics(problem).steps()
    values = Evaluator(problem, [*STRAINS, "cauchy_stress_cell"])(state)
    stress = values["cauchy_stress_cell"].reshape(-1, 3, 3)
    top = largest(COMM, float(np.abs(stress).max(initial=0.0))) / E
    assert top > 4e-4
    for name in ("strain", "green_strain", "almansi_strain"):
        agrees(values[name].ravel(), stress.ravel() / E, 1e-14 * top)
    # The logarithm of 1 + strain: half a square of the strain apart.
    agrees(values["log_strain"].ravel(), stress.ravel() / E, 1.01 * top**2 / 2)
    found = probe(state)
    np.testing.assert_array_equal(found["g_strain"], found["g_green_strain"])
    # M/(W E) in the middle; quadratic elements of this size are 2.3 % off at the surface.
    assert found["g_strain"][0] == pytest.approx(100 * 0.1 / (0.02 * 0.01**2 / 6) / E, rel=3e-2)


@pytest.mark.parametrize("law", [LinearElastic, Orthotropic])
def test_linear_law_has_one_strain(law):
    e = (H + H.T) / 2
    found = fields(law(**law.example), H, [*STRAINS, "principal_stretches", "stretch_direction_1"])
    for name in STRAINS[:3]:
        agrees(found[name], e, 1e-16)
    values, axes = np.linalg.eigh(e)
    agrees(found["log_strain"], axes @ np.diag(np.log1p(values)) @ axes.T, 1e-15)
    agrees(found["principal_stretches"], 1 + values[::-1], 1e-14)
    agrees(np.abs(found["stretch_direction_1"]), np.abs(axes[:, 2]), 1e-12)


def test_fibre_of_a_linear_law():
    law = Orthotropic(**{**Orthotropic.example, "axis1": [1, 2, 2], "axis2": [0, 1, 0]})
    a = np.array([1, 2, 2]) / 3
    found = fields(law, H, ["fibre_strain", "fibre_stretch"])
    agrees(found["fibre_strain"], a @ H @ a, 1e-16)
    agrees(found["fibre_stretch"], 1 + a @ H @ a, 1e-15)


def test_large_strain_laws_keep_their_measures():
    F = I + H
    found = fields(NeoHookean(**NeoHookean.example), H, STRAINS)
    E, e = (F.T @ F - I) / 2, (I - np.linalg.inv(F @ F.T)) / 2
    agrees(found["strain"], E, 1e-15)
    agrees(found["green_strain"], E, 1e-15)
    agrees(found["almansi_strain"], e, 1e-15)
    values, axes = np.linalg.eigh(F.T @ F)
    found = fields(Hencky(**Hencky.example), H, ["strain"])
    agrees(found["strain"], axes @ np.diag(np.log(values) / 2) @ axes.T, 1e-14)


@pytest.mark.parametrize("law", [LinearElastic, NeoHookean])
@pytest.mark.parametrize("load", [Thermal(value=50), Growth(value=[1.001, 1.002, 1.003])])
def test_strain_is_what_makes_stress(law, load: Any):
    """A body that grows freely: the whole strain is that of growth, and none makes stress."""
    G = 50 * 2e-5 * I if load.kind == "thermal" else np.diag([1.001, 1.002, 1.003]) - I
    made = law(E=1e6, nu=0.3, expansion=2e-5)
    found = fields(made, G, ["strain", "green_strain", "cauchy_stress_cell"], [load])
    agrees(found["green_strain"], G if law.linear else G + G @ G / 2, 1e-17)
    agrees(found["strain"], np.zeros(9), 2e-18)  # of 3e-3
    agrees(found["cauchy_stress_cell"], np.zeros(9), 1e-11)


@pytest.mark.parametrize("law", [LinearElastic, NeoHookean])
def test_tiny_strains(law):
    """All measures are the symmetric gradient at 1e-18, which F - I has rounded off."""
    tiny = 1e-17 * H
    found = fields(law(**law.example), tiny, STRAINS)
    for name in STRAINS:
        agrees(found[name], (tiny + tiny.T) / 2, 1e-30)
