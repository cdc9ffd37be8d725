"""Recovered stress of materials that yield: no more than the law allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfin_elastic import (
    J2,
    J2Logarithmic,
    LinearElastic,
    Problem,
    Statics,
    Support,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.stress import StressRecovery, von_mises

E, NU, YIELD, SLOPE = 200e9, 0.3, 300e6, 2e9


def bent(law: Law, deflection: str) -> tuple[Problem, State]:
    """A clamped bar whose end is moved aside."""
    moved = Support(on="right", displacement=["free", deflection])
    body = rectangle_body(size=(0.1, 0.01), cells=(10, 2))
    problem = Problem(body, law, supports=[Support(on="left"), moved], degree=2)
    *_, state = Statics(problem, steps=6).steps()
    return problem, state


@pytest.mark.long
@pytest.mark.parametrize(
    "law",
    [
        J2(E=E, nu=NU, yield_stress=YIELD, hardening=SLOPE),
        J2(E=E, nu=NU, yield_stress=YIELD, kinematic=SLOPE),
        J2Logarithmic(E=E, nu=NU, yield_stress=YIELD),
    ],
    ids=["hardening", "kinematic", "ideal-large"],
)
def test_nodes_of_a_clamped_edge_do_not_exceed_the_yield_stress(law: Any) -> None:
    """They had up to 1.7 times as much.

    The limit is that of the largest plastic strain.  Of large strains the law bounds the Kirchhoff
    stress: J of an elastic strain differs from 1 by less than 1 %.  What is written and what the
    peak is found from are the same.
    """
    problem, state = bent(law, "-6 mm")
    comm = problem.body.comm
    hardens = law.hardening + law.back_slope
    allowed = YIELD + hardens * state.numbers["max_plastic_strain"]
    large = isinstance(law, J2Logarithmic)
    recovered = von_mises(StressRecovery(problem)(state).stress)
    state.derived.clear()
    found = ErrorEstimator(problem)(state)
    assert found is not None
    for values in (recovered, von_mises(found.stress.stress)):
        most = largest(comm, float(values.max(initial=0.0)))
        assert most <= allowed * (1.01 if large else 1 + 1e-9)
        assert most >= 0.97 * YIELD


def test_below_the_yield_stress_nothing_changes() -> None:
    """The recovered stress is that of the elastic law, at the clamped corners, too."""
    stresses = []
    for law in (J2(E=E, nu=NU, yield_stress=YIELD), LinearElastic(E=E, nu=NU)):
        problem, state = bent(law, "-0.8 mm")
        stresses.append(StressRecovery(problem)(state).stress)
    size = largest(problem.body.comm, float(von_mises(stresses[1]).max(initial=0.0)))
    assert size > 0.3 * YIELD
    assert np.abs(stresses[0] - stresses[1]).max(initial=0.0) < 1e-8 * size
