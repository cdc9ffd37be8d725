"""Parameters of users' energies and constants of laws that vary in space, by each way to say so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfin_elastic import (
    Energy,
    NeoHookean,
    Problem,
    SplitEnergy,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.report import report
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.fields import MeshField
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.user import read_energy
from dolfin_elastic.model.point.report import material_report

COMM = MPI.COMM_WORLD
LMBDA = 2e6
FORMULA = "1e6*(1 + x/0.1)"
WRITTEN = "mu/2*(I1 - 3) - mu*ln(J) + lmbda/2*ln(J)^2"


def psi(F: Expr, mu: Any, lmbda: Any) -> Expr:
    """Neo-Hookean, as `NeoHookean` has it."""
    lnJ = ufl.ln(ufl.det(F))
    return mu / 2 * (ufl.tr(F.T * F) - 3) - mu * lnJ + lmbda / 2 * lnJ**2


def beam() -> Body:
    return box_body(size=[0.1, 0.01, 0.01], cells=[6, 2, 2])


def modulus(body: Body, degree: int) -> fem.Function:
    """mu = 1e6 (1 + x/0.1), the mean of each cell or the linear function."""
    kind = ("DG", 0) if degree == 0 else ("Lagrange", degree)
    f = fem.Function(fem.functionspace(body.mesh, kind))
    f.interpolate(lambda x: 1e6 * (1 + x[0] / 0.1))
    return f


def tip(body: Body, law: Law, degree: int) -> tuple[float, float]:
    """Displacement and strain energy of a cantilever under a load at its end."""
    problem = Problem(
        body,
        law,
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 0, -200])],
        degree=degree,
    )
    *_, state = Statics(problem).steps()
    return state.max_displacement, state.energies["strain"]


WAYS: dict[str, Callable[[Body, int], Law]] = {
    "formula": lambda body, k: Energy(psi, mu=FORMULA, lmbda=LMBDA),
    "function": lambda body, k: Energy(psi, mu=modulus(body, k), lmbda=LMBDA),
    "default": lambda body, k: _default(modulus(body, k)),
    "in a closure": lambda body, k: _closure(modulus(body, k)),
    "case file": lambda body, k: read_energy(
        {"energy": WRITTEN, "parameters": {"mu": FORMULA, "lmbda": "2 MPa"}}
    ),
    "law": lambda body, k: NeoHookean(mu=modulus(body, k), lmbda=LMBDA),
}


def _default(mu: fem.Function) -> Energy:
    def energy(F: Expr, lmbda: Any, mu: Any = mu) -> Expr:
        return psi(F, mu, lmbda)

    return Energy(energy, lmbda=LMBDA)


def _closure(mu: fem.Function) -> Energy:
    return Energy(lambda F, lmbda: psi(F, mu, lmbda), lmbda=LMBDA)


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("way", WAYS)
def test_each_way_gives_the_law_with_that_formula(way: str, degree: int) -> None:
    """A linear mu is taken exactly by both degrees, so only round-off of the solve differs."""
    body = beam()
    expected = tip(body, NeoHookean(mu=FORMULA, lmbda=LMBDA), degree)
    found = tip(body, WAYS[way](body, degree - 1), degree)
    assert found == pytest.approx(expected, rel=1e-8)
    constant = tip(body, NeoHookean(mu=1.5e6, lmbda=LMBDA), degree)
    assert found != pytest.approx(constant, rel=1e-2)


def test_values_of_cells() -> None:
    """An array with a value for each cell, with or without ghosts, is constant in each."""
    body = beam()
    f = modulus(body, 0)
    owned = len(body.owned_cells())
    expected = tip(body, Energy(psi, mu=f, lmbda=LMBDA), 1)
    for values in (f.x.array, f.x.array[:owned]):
        found = tip(body, Energy(psi, mu=values, lmbda=LMBDA), 1)
        assert found == pytest.approx(expected, rel=1e-12)


def test_a_field_of_the_mesh_with_its_unit() -> None:
    body = beam()
    f = modulus(body, 0)
    body.fields["stiff"] = MeshField("cell", f.x.array[:, None] / 1e6)
    law = Energy(psi, mu={"field": "stiff", "unit": "MPa"}, lmbda="2 MPa")
    expected = tip(body, Energy(psi, mu=f, lmbda=LMBDA), 1)
    assert tip(body, law, 1) == pytest.approx(expected, rel=1e-12)


@pytest.mark.long
def test_a_split_energy_may_use_functions() -> None:
    body = beam()
    mu = modulus(body, 1)
    law = SplitEnergy(lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=mu, volumetric="quadratic", K=1e10)
    plain = SplitEnergy(
        lambda I1bar, mu: mu / 2 * (I1bar - 3), mu=FORMULA, volumetric="quadratic", K=1e10
    )
    assert tip(body, law, 2) == pytest.approx(tip(body, plain, 2), rel=1e-8)


@pytest.mark.parametrize(
    ("mu", "said"),
    [
        (lambda body: modulus(beam(), 0), "another mesh"),
        (lambda body: np.ones(3), "values for the"),
        (lambda body: np.ones((4, 2)), r"an array of shape \(4, 2\)"),
        (lambda body: np.array(["a"]), "expected a real number for each element"),
        (
            lambda body: fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,)))),
            "expected a scalar function",
        ),
        (lambda body: "1e6*(1 + roh)", "unknown name 'roh'"),
        (lambda body: {"field": "roh"}, "no field 'roh'"),
        (lambda body: "1e6/(x - x)", "inf at"),
        (lambda body: "1e6*(x - 1)", "stable at rest"),
    ],
)
def test_what_is_refused(mu: Callable[[Body], Any], said: str) -> None:
    """Alike on all ranks, with the name of the parameter."""
    body = beam()
    with pytest.raises(InputError, match=said) as caught:
        Problem(body, Energy(psi, mu=mu(body), lmbda=LMBDA))
    assert "mu" in str(caught.value) or "stable" in said
    COMM.barrier()  # all ranks have raised


def test_a_case_is_checked_and_written_back() -> None:
    """`check` looks names of parameters up; a case with a formula is written as it was read."""
    tables: dict[str, Any] = {
        "mesh": {"box": {"size": [0.1, 0.01, 0.01], "cells": [4, 1, 1]}, "degree": 1},
        "materials": {"gel": {"energy": WRITTEN, "parameters": {"mu": FORMULA, "lmbda": "2 MPa"}}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": [0, 0, -200]}],
    }
    report(Case.from_dict(tables))
    law = Case.from_dict(tables).materials["gel"].law
    assert law.model_dump()["parameters"] == {"mu": FORMULA, "lmbda": 2e6}
    tables["materials"]["gel"]["parameters"]["mu"] = "1e6*(1 + X/0.1)"
    with pytest.raises(InputError, match=r"materials\.gel\.parameters\.mu: unknown name 'X'"):
        report(Case.from_dict(tables))


def test_a_material_point_has_no_place() -> None:
    with pytest.raises(InputError, match=r"parameters\.mu: this constant varies in space"):
        material_report(Energy(psi, mu=FORMULA, lmbda=LMBDA))
