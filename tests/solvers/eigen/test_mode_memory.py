"""Modes and critical loads of materials that remember: which stiffness they have."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from helpers.damaged import DamagedRubber
from mpi4py import MPI

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
from dolfin_elastic.model.materials.laws.hencky import Hencky
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


@pytest.mark.long
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


@pytest.mark.long
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


def test_a_yielded_state_has_elastic_modes_if_asked_for() -> None:
    """A law of small strains has those at rest."""
    keys = {"E": 10.0, "nu": 0.3, "density": 1.0, "hardening": 1.0, "yield": 0.2}
    rest = frequencies(LinearElastic(E=10, nu=0.3, density=1))
    found = frequencies(J2(**keys), 0.25, stiffness="elastic")
    assert found == pytest.approx(rest, rel=1e-8)


@pytest.mark.long
def test_elastic_modes_of_large_strains() -> None:
    """A rod that has been pulled 10 % longer vibrates as one that was made so, under its stress.

    The latter, elastic, is made of the yielded shape and stressed by Hencky's law from its relaxed
    length; the plastic strain keeps the volume, so that the mass is the same.
    """
    pull, stiff, hard = 0.3, 10.0, 1.0
    keys = {"nu": 0.3, "density": 1.0}

    def rod(size: tuple[float, float, float], law: Law, force: float) -> Problem:
        body = box_body(size=size, cells=(1, 1, 4))
        rollers = [
            Support(on=on, displacement=[0 if i == j else "free" for j in range(3)])
            for i, on in enumerate(("left", "front", "bottom"))
        ]
        pulled = Traction(on="top", value=[0, 0, force / (size[0] * size[1])])
        return Problem(body, law, supports=rollers, loads=[pulled], degree=2)

    metal = J2Logarithmic(E=stiff, hardening=hard, **{"yield": 0.2}, **keys)
    problem = rod((1, 1, 4), metal, pull)
    modes = Modal(problem, count=2, preload=True, stiffness="elastic")
    found = [mode.frequency for mode in modes.modes()]
    assert problem.history is not None
    grown = float(np.exp(problem.history.results()["max_plastic_strain"]))
    assert grown > 1.1
    thin = 1 / np.sqrt(grown)
    relaxed = rod((thin, thin, 4 * grown), Hencky(E=stiff, **keys), pull)
    wanted = [m.frequency for m in Modal(relaxed, count=2, preload=True).modes()]
    assert found == pytest.approx(wanted, rel=1e-7)


def test_the_elastic_choice_needs_a_metal() -> None:
    with pytest.raises(InputError, match="no metal yields") as error:
        Modal(column(rubber(1, prony=PRONY)), count=1, stiffness="elastic")
    assert error.value.where == "modal.stiffness"
    law = DamagedRubber(E=1, nu=0.3, density=1, limit=0.5)
    with pytest.raises(InputError, match="no metal yields"):
        Modal(column(law, 0.1), count=1, preload=True, stiffness="elastic")


def test_a_run_after_elastic_modes_yields() -> None:
    keys = {"E": 10.0, "nu": 0.3, "density": 1.0, "hardening": 1.0, "yield": 0.2}
    used, fresh = (column(J2(**keys), 0.25) for _ in range(2))
    list(Modal(used, count=1, preload=True, stiffness="elastic").modes())
    used.w.x.array[:] = 0.0
    ends = [list(Statics(p, steps=2).steps())[-1].max_displacement for p in (used, fresh)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(("limit", "noted"), [(1.1, False), (0.9, True)])
def test_buckling_beyond_yield_is_noted(
    limit: float, noted: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """A column that yields before its Euler load, or not: with nu = 0 its stress is uniform."""
    body = box_body(size=(1, 1, 10), cells=(1, 1, 10))

    def factor(law: Law) -> float:
        clamped = Support(on="bottom", displacement=[0, 0, 0])
        push = Traction(on="top", value=[0, 0, -1])
        problem = Problem(body, law, supports=[clamped], loads=[push], degree=2)
        (mode, *_) = Buckling(problem, count=1).modes()
        return mode.load_factor

    critical = factor(Hencky(E=1000, nu=0.0))
    with caplog.at_level(logging.WARNING):
        metal = J2Logarithmic(E=1000, nu=0.0, **{"yield": limit * critical})
        assert factor(metal) == pytest.approx(critical, rel=1e-6)
    if MPI.COMM_WORLD.rank == 0:  # others log nothing
        assert ("of the volume would yield" in caplog.text) == noted


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


@pytest.mark.parametrize(
    ("keys", "modal", "noted"),
    [
        ({}, {}, "a preload under which it yields is refused, unless modal.stiffness"),
        ({}, {"stiffness": "elastic"}, ""),
        ({"plastic_viscosity": "1 GPa s"}, {}, "nothing yields, as under a sudden load"),
    ],
)
def test_check_tells_of_a_preload_that_yields(
    keys: dict[str, Any], modal: dict[str, Any], noted: str
) -> None:
    steel = {"law": "j2-logarithmic", "E": "210 GPa", "nu": 0.3, "yield": "250 MPa", "rho": 7800}
    given: dict[str, Any] = {
        "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
        "support": [{"on": "left"}],
        "load": [{"kind": "traction", "on": "right", "value": ["1 MPa", 0, 0]}],
        "modal": {"preload": True, **modal},
    }
    case = Case(**given, materials={"steel": {**steel, **keys}})
    notes = [n for n in check(case, case.read_body()) if n.startswith("materials.steel")]
    assert len(notes) == bool(noted)
    assert not noted or noted in notes[0]
    at_rest = Case(**{**given, "modal": {}}, materials={"steel": {**steel, **keys}})
    assert not any("yields" in n for n in check(at_rest, at_rest.read_body()))
