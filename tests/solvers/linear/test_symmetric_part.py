"""A direct solver by factors of the symmetric part: solutions, pivots, and where it gives way."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.buckling import LU, equilibrium, referee

from dolfin_elastic import (
    Contact,
    NeoHookean,
    Pressure,
    Problem,
    Rigid,
    Rotation,
    Statics,
    Support,
    rectangle_body,
)
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.diagnostics.stability import judge, negative_pivots
from dolfin_elastic.solvers.linear import symmetric_part
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose
from dolfin_elastic.solvers.linear.symmetric_part import DIGITS

RUBBER = NeoHookean(E=1.0, nu=0.3)


def strip(pressure: float, **settings: Any) -> Problem:
    """Held at its left end, under a pressure that follows its lower side [Pa]."""
    return Problem(
        rectangle_body(size=(8, 1), cells=(16, 2)),
        settings.pop("law", RUBBER),
        supports=[settings.pop("held", Support(on="left"))],
        loads=[Pressure(on="bottom", value=pressure)],
        **{"degree": 2, **settings},
    )


def states(problem: Problem, petsc: Any) -> list[FloatArray]:
    """Local displacements after each step. Collective."""
    linear = LinearSettings(method="direct", petsc=petsc)
    statics = Statics(problem, steps=3, linear=linear, rtol=1e-11)
    return [problem.u.x.array.copy() for _ in statics.steps()]


def same(problem: Callable[[], Problem]) -> bool:
    """Whether the states are those by factors of the tangent itself. Collective.

    Both are solved to round-off, which the softest motion enlarges: by 3e-15 in a strip bent by
    5 m.
    """
    pairs = zip(states(problem(), {}), states(problem(), LU), strict=True)
    return all(np.allclose(one, other, rtol=0.0, atol=1e-12) for one, other in pairs)


PLATE = {"plane": {"point": [0, 1.3], "normal": [0, -1]}}
"""That the strip meets after its first step, with other nodes in each step."""


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"degree": 1},
        {"law": NeoHookean(E=1.0, nu=0.4999)},
        {"contacts": [Contact(on="top", **PLATE)]},
        {"held": Rotation(on="left", point=[0, 0.5], angle="0.2*t")},
    ],
    ids=["quadratic", "linear", "mixed", "contact", "turned"],
)
def test_solutions_are_those_of_factors(settings: Any):
    problem = partial(strip, 3e-4, **settings)
    assert not problem().symmetric
    assert same(problem)


def test_a_solve_and_its_pivots():
    """Residual about that of factors, and as many negative pivots as negative eigenvalues."""
    with equilibrium(strip(3e-4), "direct") as newton:
        factors, A = newton.linear.factors, newton.assembler.tangent.matrix
        assert factors.getType() == "cholesky"
        x, f = newton.assembler.create_vector(), newton.assembler.create_vector()
        x.setRandom()
        A.mult(x, f)
        newton.ksp.solve(f, x)
        r = f.duplicate()
        A.mult(x, r)
        r.axpy(-1.0, f)
        assert r.norm() <= 2 * DIGITS * f.norm()
        assert negative_pivots(factors, newton.assembler) == referee(newton) == 0
        for vector in (x, f, r):
            vector.destroy()


def test_far_from_symmetric_the_tangent_itself_is_factorised(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    """GMRES needs three iterations here."""
    caplog.set_level(logging.INFO, "dolfin_elastic")
    monkeypatch.setattr(symmetric_part, "LIMIT", 2)
    with equilibrium(strip(3e-4), "direct") as newton:
        assert newton.linear.factors.getType() == "lu"
        assert judge(newton).stable
    if newton.assembler.comm.rank == 0:  # that alone logs
        assert caplog.text.count("far from symmetric") == 1
    assert same(partial(strip, 3e-4))


def test_the_symmetric_part_is_tried_again():
    """After as many tangents as are factorised themselves."""
    with equilibrium(strip(3e-4), "direct") as newton:
        newton.linear._parts._left = 2
        kinds = []
        for _ in range(3):
            newton.factorise()
            kinds.append(newton.linear.factors.getType())
    assert kinds == ["lu", "lu", "cholesky"]


def test_where_it_is_chosen():
    """In statics without scalar unknowns, where the user has no say."""

    def kind(problem: Problem, petsc: Any = None, **how: Any) -> object:
        linear = LinearSettings(method="direct", petsc=petsc or {})
        return choose(problem, linear, **how).options["pc_type"]

    turned = Rotation(on="left", point=[0, 0.5], angle=0.1)
    assert kind(strip(1e-3)) == kind(strip(1e-3, held=turned)) == "python"
    assert kind(strip(1e-3, held=Rigid(on="left", force=[0, 0]))) == "lu"
    assert kind(strip(1e-3), moving=True) == kind(strip(1e-3), {"mat_mumps_icntl_14": 90}) == "lu"
