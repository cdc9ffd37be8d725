"""Modes and critical loads of materials that remember: which stiffness they have."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.damaged import DamagedRubber

from dolfin_elastic import (
    Buckling,
    Case,
    LinearElastic,
    Modal,
    NeoHookeanSplit,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.laws.j2 import J2
from dolfin_elastic.model.materials.laws.j2_logarithmic import J2Logarithmic

K, MU, G = 10.0, 3.0, 0.4
PRONY = [{"g": 0.3, "tau": 1}, {"g": 0.1, "tau": 0.01}]


def column(law: Law, pull: float = 0.0) -> Problem:
    body = box_body(size=(1, 1, 4), cells=(1, 1, 2))
    loads = [Traction(on="top", value=[0, 0, pull])] if pull else []
    held = Support(on="bottom", displacement=[0, 0, 0])
    return Problem(body, law, supports=[held], loads=loads)


def frequencies(law: Law, pull: float = 0.0, **keys: Any) -> list[float]:
    modes = Modal(column(law, pull), count=2, preload=bool(pull), **keys).modes()
    return [mode.frequency for mode in modes]


def rubber(share: float, **keys: Any) -> Law:
    return NeoHookeanSplit(K=K, mu=share * MU, density=1, **keys)


@pytest.mark.parametrize("pull", [0.0, 0.5])
@pytest.mark.parametrize(("stiffness", "left"), [("instantaneous", 1.0), ("long-term", 1 - G)])
def test_modes_have_the_stiffness_that_is_chosen(stiffness: str, left: float, pull: float) -> None:
    """Those of an elastic material with the moduli at once, or after a long time; loaded, too."""
    found = frequencies(rubber(1, prony=PRONY), pull, stiffness=stiffness)
    assert found == pytest.approx(frequencies(rubber(left), pull), rel=1e-7)


def test_critical_loads_have_the_stiffness_that_is_chosen() -> None:
    def factor(law: Law, **keys: Any) -> float:
        (mode,) = Buckling(column(law, -0.01), count=1, **keys).modes()
        return mode.load_factor

    slow = factor(rubber(1, prony=PRONY), stiffness="long-term")
    assert slow == pytest.approx(factor(rubber(1 - G)), rel=1e-7)
    assert factor(rubber(1, prony=PRONY)) == pytest.approx(factor(rubber(1)), rel=1e-7)


def test_a_run_after_modes_relaxes_again() -> None:
    """The choice belongs to the modes, not to the problem."""
    used, fresh = (column(rubber(1, prony=PRONY), 0.1) for _ in range(2))
    list(Modal(used, count=1, stiffness="long-term").modes())
    ends = [list(Statics(p, steps=2).steps())[-1].max_displacement for p in (used, fresh)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


@pytest.mark.parametrize("law", [rubber(1), DamagedRubber(E=1, nu=0.3, density=1)])
def test_a_choice_of_one_is_refused(law: Law) -> None:
    with pytest.raises(InputError, match="no material relaxes") as error:
        Modal(column(law), count=1, stiffness="long-term")
    assert error.value.where == "modal.stiffness"


def test_a_preload_that_yields_is_refused() -> None:
    law = DamagedRubber(E=1, nu=0.3, density=1, limit=0.5)
    with pytest.raises(InputError, match="a material has yielded") as error:
        list(Modal(column(law, 0.1), count=1, preload=True).steps())
    assert error.value.where == "modal.preload"
    with pytest.raises(InputError, match="a material has yielded") as error:
        list(Buckling(column(law, -0.01), count=1, preload=0.5).steps())
    assert error.value.where == "buckling.preload"


@pytest.mark.parametrize("kind", [J2, J2Logarithmic])
@pytest.mark.parametrize("pull", [0.05, 0.25])
def test_a_metal_below_its_yield_stress_has_modes(kind: type[Law], pull: float) -> None:
    """At 0.05 Pa, not at 0.25 Pa, of a yield stress of 0.2 Pa: round-off is no yielding."""
    law = kind(E=10, nu=0.3, density=1, hardening=1, **{"yield": 0.2})
    problem = column(law, pull)
    modes = Modal(problem, count=1, preload=True)
    if pull < 0.2:
        (mode,) = modes.modes()
        assert mode.frequency > 0
    else:
        with pytest.raises(InputError, match="a material has yielded"):
            list(modes.modes())


def test_at_rest_nothing_has_yielded() -> None:
    """Not even after a run on the same problem."""
    problem = column(DamagedRubber(E=1, nu=0.3, density=1, limit=0.5), 0.1)
    list(Statics(problem, steps=2).steps())
    problem.w.x.array[:] = 0.0
    found = [mode.frequency for mode in Modal(problem, count=2).modes()]
    fresh = column(DamagedRubber(E=1, nu=0.3, density=1, limit=0.5))
    assert found == pytest.approx([m.frequency for m in Modal(fresh, count=2).modes()], rel=1e-8)


def test_check_knows_it() -> None:
    table = {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, "rho": 1000}
    given: dict[str, Any] = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
        "modal": {"stiffness": "long-term"},
    }
    case = Case(**given, materials={"gel": table})
    with pytest.raises(InputError, match="no material relaxes") as error:
        check(case, case.read_body())
    assert error.value.where == "modal.stiffness"
    case = Case(**given, materials={"gel": {**table, "prony": [{"g": 0.3, "tau": "1 s"}]}})
    assert not any("nothing relaxes" in note for note in check(case, case.read_body()))
    assert LinearElastic(E=1, nu=0, prony=[{"g": 0.3, "tau": 1}]).lasting == 0.7
