"""Strain and stress measures, principal values, fibres and normals against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Guccione,
    LinearElastic,
    NeoHookean,
    Probe,
    Problem,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived import spectral
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS

COMM = MPI.COMM_WORLD
MU, LMBDA = 80.0, 120.0
GAMMA = 0.5
"""Simple shear x = X + gamma Y."""
STRETCHES = (1.5, 0.8, 0.9)
CELLS = [
    "deformation_gradient",
    "log_strain",
    "almansi_strain",
    "second_piola",
    "kirchhoff_stress",
    "principal_stretches",
    "stretch_direction_1",
    "stretch_direction_2",
    "stretch_direction_3",
]
NODES = [
    "principal_stresses",
    "max_principal_stress",
    "min_principal_stress",
    "principal_direction_1",
    "principal_direction_2",
    "principal_direction_3",
    "tresca",
    "cauchy_stress",
]


def state_of(problem: Problem, F: Any) -> State:
    """The homogeneous deformation F of a body."""
    u, dim = fem.Function(problem.V), problem.body.dim
    u.interpolate(lambda x: (F - np.eye(3))[:dim, :dim] @ x[:dim])
    return State(1, 1.0, u)


def block(law: Any = None, degree: int = 1) -> Problem:
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    return Problem(body, law or NeoHookean(mu=MU, lmbda=LMBDA), degree=degree)


def agrees(found: Any, expected: Any, atol: float) -> None:
    """All rows of this rank are the expected one; the largest difference of all ranks is asked."""
    difference = np.abs(found - np.ravel(expected)).max(initial=0.0)
    assert largest(COMM, float(difference)) < atol


def test_simple_shear():
    """F = I + gamma e1 e2 of a neo-Hookean body: tau = mu (b - I), J = 1.

    The stretches are lambda, 1, 1/lambda with lambda - 1/lambda = gamma; the first direction lies
    at tan 2 theta = -2/gamma to X (Ogden, Non-linear Elastic Deformations (1984), (2.2.58)).
    """
    problem = block()
    F = np.eye(3)
    F[0, 1] = GAMMA
    values = Evaluator(problem, CELLS + NODES)(state_of(problem, F))
    b, one = F @ F.T, np.eye(3)
    tau = MU * (b - one)
    long = GAMMA / 2 + np.sqrt(1 + GAMMA**2 / 4)
    agrees(values["deformation_gradient"], F, 1e-14)
    agrees(values["almansi_strain"], (one - np.linalg.inv(b)) / 2, 1e-14)
    agrees(values["kirchhoff_stress"], tau, 1e-12)
    agrees(values["second_piola"], MU * (one - np.linalg.inv(F.T @ F)), 1e-12)
    agrees(values["principal_stretches"], [long, 1, 1 / long], 1e-14)
    angle = np.arctan(long)
    agrees(values["stretch_direction_1"], [np.cos(angle), np.sin(angle), 0], 1e-14)
    agrees(values["stretch_direction_2"], [0, 0, 1], 1e-14)
    # ln V = ln(lambda) (n1 n1 - n3 n3), n1 at the angle pi/2 - angle to x in the deformed body.
    n1, n3 = [np.sin(angle), np.cos(angle), 0], [-np.cos(angle), np.sin(angle), 0]
    agrees(values["log_strain"], np.log(long) * (np.outer(n1, n1) - np.outer(n3, n3)), 1e-14)
    stresses = MU * np.array([long**2 - 1, 0, 1 / long**2 - 1])
    # Fitted values have the round-off of the fit.
    agrees(values["principal_stresses"], stresses, 1e-10)
    agrees(values["max_principal_stress"], stresses[0], 1e-10)
    agrees(values["min_principal_stress"], stresses[2], 1e-10)
    agrees(values["tresca"], stresses[0] - stresses[2], 1e-10)
    agrees(values["principal_direction_1"], n1, 1e-10)
    agrees(values["principal_direction_2"], [0, 0, 1], 1e-10)


@pytest.mark.parametrize("degree", [1, 2])
def test_stretches_along_the_axes(degree):
    """F = diag: each measure has one number an axis."""
    problem, L = block(degree=degree), np.array(STRETCHES)
    values = Evaluator(problem, CELLS + NODES)(state_of(problem, np.diag(L)))
    J = np.prod(L)
    tau = MU * (L**2 - 1) + LMBDA * np.log(J)
    agrees(values["log_strain"], np.diag(np.log(L)), 1e-14)
    agrees(values["almansi_strain"], np.diag((1 - L**-2) / 2), 1e-14)
    agrees(values["kirchhoff_stress"], np.diag(tau), 1e-11)
    agrees(values["second_piola"], np.diag(tau / L**2), 1e-11)
    order = [0, 2, 1]
    agrees(values["principal_stretches"], L[order], 1e-14)
    agrees(values["principal_stresses"], tau[order] / J, 1e-9)
    for number, axis in enumerate(order):
        agrees(values[f"stretch_direction_{number + 1}"], np.eye(3)[axis], 1e-14)
        agrees(values[f"principal_direction_{number + 1}"], np.eye(3)[axis], 1e-9)


def test_a_linear_law_has_one_stress():
    problem = block(LinearElastic(mu=MU, lmbda=LMBDA))
    H = np.array([[0.1, 0.2, 0], [0, -0.1, 0], [0, 0, 0.05]])
    values = Evaluator(problem, ["second_piola", "kirchhoff_stress"])(
        state_of(problem, np.eye(3) + H)
    )
    stress = MU * (H + H.T) + LMBDA * np.trace(H) * np.eye(3)
    agrees(values["second_piola"], stress, 1e-12)
    agrees(values["kirchhoff_stress"], stress, 1e-12)


def test_strain_along_a_fibre():
    """Of a law with a fibre its direction and strain; others have none, and second ones neither."""
    a = np.array([1.0, 2.0, 2.0]) / 3
    law = Guccione(**{**Guccione.example, "fibre": [1, 2, 2]})
    problem = block(law)
    F = np.eye(3) + np.array([[0.1, 0.2, 0], [0, -0.1, 0.1], [0, 0, 0.05]])
    names = ["fibre", "fibre_strain", "fibre_stretch", "fibre2", "fibre2_strain"]
    values = Evaluator(problem, names)(state_of(problem, F))
    agrees(values["fibre"], a, 1e-15)
    agrees(values["fibre_strain"], a @ (F.T @ F - np.eye(3)) @ a / 2, 1e-14)
    agrees(values["fibre_stretch"], np.linalg.norm(F @ a), 1e-14)
    assert np.isnan(values["fibre2"]).all()
    assert np.isnan(values["fibre2_strain"]).all()
    plain = block()
    assert np.isnan(Evaluator(plain, ["fibre"])(state_of(plain, F))["fibre"]).all()


@pytest.mark.parametrize(("dim", "degree"), [(3, 2), (2, 1), (3, 1), (2, 2)])
def test_normals(dim, degree):
    """Of a sheared box: cof F N on its faces (Nanson), 0 inside, unit length everywhere else."""
    make = (rectangle_body, box_body)[dim - 2]
    body = make(size=(1.0,) * dim, cells=(4,) * dim)
    problem = Problem(body, NeoHookean(mu=MU, lmbda=LMBDA), degree=degree)
    F = np.eye(3)
    F[0, 1], F[1, 1] = GAMMA, 1.2
    normals = Evaluator(problem, ["normal"])(state_of(problem, F))["normal"]
    X = problem.V.tabulate_dof_coordinates()[: len(normals), :dim]
    sides = np.stack([np.isclose(X, 0.0), np.isclose(X, 1.0)], axis=2)
    faces = sides.sum(axis=(1, 2))
    expected = np.zeros((2 * dim, 3))
    for axis in range(dim):
        for end in (0, 1):
            N = np.eye(3)[axis] * (2 * end - 1)
            n = np.linalg.inv(F).T @ N
            expected[2 * axis + end] = n / np.linalg.norm(n)
            on = (faces == 1) & sides[:, axis, end]
            assert total(COMM, int(on.sum())) > 0
            agrees(normals[on], expected[2 * axis + end], 1e-14)
    agrees(normals[faces == 0], np.zeros(3), 1e-15)
    agrees(np.linalg.norm(normals[faces > 0], axis=1), 1.0, 1e-14)
    edge = (faces == 2) & sides[:, 0, 1] & sides[:, 1, 1]
    mean = normals[edge] @ (expected[1] + expected[3])
    assert total(COMM, int(edge.sum())) > 0
    assert largest(COMM, -float(mean.min(initial=1.0))) < 0  # between the normals of both faces


def test_rows_without_a_value_stay_so():
    """Of a law without the quantity; the others beside it are not touched."""
    rows = np.array([[np.nan] * 9, [3, 0, 0, 0, 2, 0, 0, 0, 1]], dtype=float)
    for function in (spectral.principal_values, spectral.tresca, spectral.log_strain):
        found = function(rows)
        assert np.isnan(found[0]).all()
        assert np.isfinite(found[1]).all()
    assert spectral.tresca(rows)[1] == pytest.approx([2.0])


def test_probes_read_them():
    """Principal values of the tensor at the point, not interpolated ones."""
    problem = block(degree=2)
    F = np.diag(STRETCHES)
    names = ["log_strain", "principal_stretches", "tresca", "principal_stresses"]
    found = Probe(problem, {"p": [0.3, 0.4, 0.35]}, names)(state_of(problem, F))
    L = np.array(STRETCHES)
    sigma = (MU * (L**2 - 1) + LMBDA * np.log(np.prod(L))) / np.prod(L)
    np.testing.assert_allclose(found["p_log_strain"], np.diag(np.log(L)).ravel(), atol=1e-13)
    np.testing.assert_allclose(found["p_principal_stretches"], sorted(L, reverse=True), rtol=1e-13)
    np.testing.assert_allclose(
        found["p_principal_stresses"], sorted(sigma, reverse=True), rtol=1e-10
    )
    np.testing.assert_allclose(found["p_tresca"], [max(sigma) - min(sigma)], rtol=1e-10)


def test_every_field_has_a_unit_of_its_kind():
    """Stresses are in Pa, measures of strain and directions are numbers."""
    for name in NODES:
        assert FIELDS[name].unit == ("" if "direction" in name else "Pa")
    for name in CELLS:
        assert FIELDS[name].unit == ("Pa" if name in ("second_piola", "kirchhoff_stress") else "")
