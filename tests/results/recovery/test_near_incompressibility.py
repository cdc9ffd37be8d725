"""The estimated error of displacement elements near nu = 1/2: right, or told to be too small.

References: the closed form of a thick tube and a thick sphere; and a clamped block in bending,
whose energy under forces is that of fine mixed elements (60 cells a metre in the plane, 9 in space,
whose own error is below 0.2 % of the errors here).
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import ufl
from helpers.layers import Layers, layers, solve

from dolfin_elastic import Case, LinearElastic, Problem, Statics, Support, Traction, box_body, run
from dolfin_elastic.report.contents import audit_of
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.locking import unseen_locking
from dolfin_elastic.solvers.assembly.assembler import compiled, integral

MU = 1e6


def error_energy(problem: Problem, nu: float, n: int) -> float:
    """Strain energy of the true error of a displacement, of one material in both layers [J]."""
    exact, lmbda, found = Layers((MU, MU), nu, n), 2 * MU * nu / (1 - 2 * nu), 0
    for region in problem.regions:
        u = problem.u - exact.displacement(0, problem.X)
        e = ufl.sym(ufl.grad(u))
        hoop = u[0] / problem.X[0] if n == 2 else 0.0 * u[0]
        trace = ufl.tr(e) + hoop
        density = MU * (ufl.inner(e, e) + hoop**2) + lmbda / 2 * trace**2
        found += density * problem.weak_form.volume(region, 8)
    return integral(problem, compiled(problem, [found])[0])


@pytest.mark.long
@pytest.mark.sample(2)
@pytest.mark.parametrize("n", [2, 1], ids=["sphere", "tube"])
@pytest.mark.parametrize("nu", [0.49, 0.45, 0.499])
def test_quadratic_elements(folder, nu, n):
    """0.94 to 1.12 times the true error, as at nu = 0.3: there is nothing to tell."""
    case = layers(folder, 0.1, (MU, MU), nu, n)
    case["mesh"]["formulation"] = "displacement"
    problem, state = solve(case)
    assert not problem.mixed
    estimate = ErrorEstimator(problem)(state)
    ratio = np.sqrt(estimate.energy / error_energy(problem, nu, n))
    assert 0.9 < ratio < 1.15
    assert unseen_locking(problem, estimate.relative) is None


def bent(dim: int, cells: int, nu: float) -> tuple[float, Any, Problem]:
    """Strain energy, estimate and problem of the clamped block in linear elements."""
    body = box_body(size=(2.0, 1.0, 1.0)[:dim], cells=(2 * cells, cells, cells)[:dim])
    problem = Problem(
        body,
        LinearElastic(mu=1.0, nu=nu),
        degree=1,
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 1e-3, 0][:dim])],
    )
    *_, state = Statics(problem).steps()
    return state.energies["strain"], ErrorEstimator(problem)(state), problem


REFERENCE = {
    (2, 0.49): 4.959164e-6,
    (2, 0.499): 4.872615e-6,
    (3, 0.49): 6.012284e-6,
    (3, 0.499): 5.959747e-6,
}
"""Energy of the block in fine mixed elements [J]."""


@pytest.mark.parametrize(
    ("dim", "nu", "cells"),
    [(2, 0.49, 3), (2, 0.499, 3), (2, 0.499, 12), (3, 0.49, 4), (3, 0.499, 2)],
)
def test_linear_elements_that_lock(dim, nu, cells):
    """The estimate is 0.17 to 0.66 times the true error, and the bound that is told holds."""
    energy, estimate, problem = bent(dim, cells, nu)
    true = np.sqrt(1 - energy / REFERENCE[dim, nu])
    locking = unseen_locking(problem, estimate.relative)
    assert locking is not None
    assert np.sqrt(estimate.energy / (REFERENCE[dim, nu] - energy)) < 0.7
    assert true < locking.up_to < 1.0
    assert locking.nu == pytest.approx(nu, rel=1e-12)


def test_linear_elements_that_do_not():
    """With fine cells, at a lower ratio, or in a mixed formulation, the estimate is right."""
    _, estimate, problem = bent(2, 12, 0.49)
    assert unseen_locking(problem, estimate.relative) is None
    _, estimate, problem = bent(2, 6, 0.3)
    assert unseen_locking(problem, estimate.relative) is None


def test_it_is_told(folder):
    """In the summary, in the console and in the report."""
    case = {
        "mesh": {"rectangle": {"size": [2, 1], "cells": [6, 3]}, "degree": 1},
        "materials": {"rubber": {"law": "linear-elastic", "E": 1e6, "nu": 0.499}},
        "support": [{"on": "left"}],
        "load": [{"on": "right", "kind": "traction", "value": [0, 1e3]}],
        "output": {"folder": str(folder / "results")},
    }
    [*_] = run(Case.from_dict(case))
    summary = json.loads((folder / "results" / "summary.json").read_text())
    found = summary["error"]["locking"]
    assert found["nu"] == pytest.approx(0.499)
    assert found["up_to"] > summary["error"]["energy_norm"]
    peak = summary["error"]["elsewhere"] or summary["error"]["von_mises"]
    assert peak["error"] is None
    assert peak["unresolved"].startswith("linear elements lock at nu = 0.499")
    notes = " ".join(audit_of(FinishedRun(folder / "results")).notes)
    assert "linear elements lock at nu = 0.499" in notes
