"""`Problem.parameters`: numbers of materials that are set after the problem is made."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    Energy,
    LinearElastic,
    MooneyRivlin,
    NeoHookean,
    Orthotropic,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.model.materials.law import Law

COMM = MPI.COMM_WORLD


def psi(F: Any, mu: Any, k: Any) -> Any:
    J = ufl.det(F)
    return mu / 2 * (ufl.tr(F.T * F) - 3) - mu * ufl.ln(J) + k / 2 * ufl.ln(J) ** 2


def wood(**axes: Any) -> Orthotropic:
    return Orthotropic(**{**Orthotropic.example, **axes})


NEARLY = NeoHookean(E=1e6, nu=0.499)
CASES: dict[str, tuple[Law, Law, dict[str, Any], dict[str, Any]]] = {
    "linear": (
        LinearElastic(E=1e6, nu=0.3),
        LinearElastic(E=3e6, nu=0.1),
        {"E": 3e6, "nu": 0.1},
        {},
    ),
    "bulk": (NeoHookean(K=2e6, mu=4e5), NeoHookean(K=1e6, mu=4e5), {"K": 1e6}, {}),
    "pressure": (NEARLY, NeoHookean(E=2e6, nu=0.49999), {"E": 2e6, "nu": 0.49999}, {"degree": 2}),
    "stabilised": (
        NEARLY,
        NeoHookean(E=3e6, nu=0.4999),
        {"E": 3e6, "nu": 0.4999},
        {"formulation": "mixed"},
    ),
    "incompressible": (
        MooneyRivlin(c10=1e5, c01=4e4, nu=0.5),
        MooneyRivlin(c10=3e5, c01=4e4, nu=0.5),
        {"c10": 3e5},
        {"formulation": "mixed"},
    ),
    "own": (Energy(psi, mu=4e5, k=1e6), Energy(psi, mu=6e5, k=1e6), {"parameters.mu": 6e5}, {}),
    "direction": (wood(), wood(axis1=[0, 0, 1]), {"axis1": [0, 0, 1]}, {}),
    "beside what varies": (
        LinearElastic(E="1e6*(1 + x)", nu=0.3),
        LinearElastic(E="1e6*(1 + x)", nu=0.1),
        {"nu": 0.1},
        {},
    ),
}


def block(law: Law, **keys: Any) -> Problem:
    return Problem(
        box_body(size=(2, 1, 1), cells=(3, 2, 2)),
        law,
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 0, -2e3])],
        **{"degree": 1, **keys},
    )


def solved(problem: Problem) -> np.ndarray:
    *_, state = Statics(problem, rtol=1e-11).steps()
    return np.append(problem.u.x.array, state.energies["strain"])


def value(problem: Problem, form: ufl.Form) -> float:
    (compiled,) = compile_forms(COMM, [form], problem.jit)
    return COMM.allreduce(fem.assemble_scalar(compiled))


@pytest.mark.parametrize("name", CASES)
def test_a_new_value_is_a_new_problem(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same displacement and energy as from the start, and nothing is compiled."""
    law, other, changed, keys = CASES[name]
    problem = block(law, **keys)
    before = solved(problem)
    monkeypatch.setattr("dolfin_elastic.core.jit.compile.find_or_compile", None)
    expected = solved(block(other, **keys))
    for key, number in changed.items():
        problem.parameters[f"materials.body.{key}"].value = number
    found, scale = solved(problem), abs(expected[:-1]).max(initial=1e-9)
    np.testing.assert_allclose(found[:-1], expected[:-1], rtol=0, atol=1e-8 * scale)
    assert found[-1] == pytest.approx(expected[-1], rel=1e-8)
    assert abs(before[-1] - found[-1]) > 1e-2 * found[-1]
    typical, fresh = problem.regions[0].typical, block(other, **keys).regions[0].typical
    assert typical.constants() == pytest.approx(fresh.constants(), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("linear", "nu"),
        ("bulk", "K"),
        ("pressure", "E"),
        ("pressure", "nu"),
        ("own", "parameters.mu"),
    ],
)
def test_derivative_of_the_energy(name: str, key: str) -> None:
    """Through UFL, of E and nu through the moduli, against a difference quotient."""
    law, _, _, keys = CASES[name]
    problem = block(law, **keys)
    solved(problem)
    constant, W = problem.parameters[f"materials.body.{key}"], problem.weak_form.strain_energy
    p = ufl.variable(constant)
    slope = value(problem, ufl.diff(ufl.replace(W, {constant: p}), p))
    at, step = float(constant.value), 1e-5 * float(constant.value)
    if key == "nu":
        step = 1e-3 * (0.5 - at)
    energies = []
    for constant.value in (at - step, at + step):
        energies.append(value(problem, W))
    assert slope == pytest.approx((energies[1] - energies[0]) / (2 * step), rel=1e-5)
    assert abs(slope * at) > 1e-3 * energies[0]


def test_names() -> None:
    """Dotted keys as in a case file; nu = 0.5 is another problem, derived moduli follow."""
    body = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    problem = Problem(body, NeoHookean(E=1e6, nu=0.3, density=1100), degree=1)
    keys = [f"materials.body.{name}" for name in ("E", "density", "nu")]
    assert sorted(problem.parameters) == keys
    rigid = Problem(body, NeoHookean(E=1e6, nu=0.5), degree=2)
    assert list(rigid.parameters) == ["materials.body.E"]
    assert rigid.regions[0].incompressible


def test_an_unknown_key_is_told_with_the_nearest() -> None:
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    parameters = Problem(body, NEARLY, supports=[]).parameters
    hint = "there is no parameter 'materials.bodi.E'; did you mean 'materials.body.E'?"
    with pytest.raises(InputError, match=re.escape(hint)):
        parameters["materials.bodi.E"]
    assert parameters.get("materials.bodi.E") is None
