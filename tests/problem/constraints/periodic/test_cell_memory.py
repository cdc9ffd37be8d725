"""Periodic cells of materials that relax, against points and laminates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import through_json

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookeanSplit,
    Periodic,
    Problem,
    Selector,
    Statics,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.mesh import Body
from dolfin_elastic.model.materials.laws.j2 import J2
from dolfin_elastic.problem.state import State

PAIRS = [["left", "right"], ["bottom", "top"]]
PAIRS3 = [["left", "right"], ["front", "back"], ["bottom", "top"]]
MU, G, TAU = 3.0, 0.6, 0.5
SOFT = {"mu": MU, "nu": 0.3, "prony": [{"g": G, "tau": TAU}]}
STIFF = 7.0
FREE = "free"


def judged(problem: Problem, **keys: Any) -> list[State]:
    states = list(Statics(problem, **keys).steps())
    for state in states:
        assert state.audit is not None
        assert state.audit.verdict == "pass", state.audit.reasons
    return states


def relaxed(t: float, first: float, last: float, tau: float) -> float:
    """Stress of a strain that grows as t, of the modulus last + (first - last) exp(-t/tau)."""
    return float(last * t + (first - last) * tau * -np.expm1(-t / tau))


# --- a homogeneous cell is a point ---


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_a_homogeneous_cell_relaxes_as_a_point(degree: int) -> None:
    """A ramp and a hold, with steps twice as long as tau: exact."""
    rate = 0.01 / 2
    periodic = Periodic(
        pairs=PAIRS3,
        gradient=[[1, 0, 0.01], [0, 1, 0], [0, 0, 1]],
        curve=[[0, 0], [2, 1], [4, 1]],
    )
    body = box_body(size=(1, 1, 1), cells=(2, 1, 2))
    problem = Problem(body, LinearElastic(**SOFT), periodic=periodic, degree=degree)
    for state in judged(problem, steps=4, end=4)[1:]:
        t = state.t
        wanted = relaxed(t, MU, MU * (1 - G), TAU)
        wanted -= relaxed(max(t - 2, 0.0), MU, MU * (1 - G), TAU)
        assert state.numbers["P13"] == pytest.approx(rate * wanted, rel=1e-10)
        assert abs(state.numbers["P12"]) < 1e-12


@pytest.mark.long
def test_large_strains_of_a_cell_are_those_of_a_body() -> None:
    """The mean stress is the stress of a point, and what is free across creeps."""
    periodic = Periodic(
        pairs=PAIRS, gradient=[[1.4, 0.3], [0, FREE]], curve=[[0, 0], [0.2, 1], [1, 1]]
    )
    found = []
    for cells in ((1, 1), (3, 2)):
        body = rectangle_body(size=(1, 1), cells=cells)
        problem = Problem(body, NeoHookeanSplit(**SOFT), periodic=periodic, degree=1)
        found.append(judged(problem, steps=10))
    for one, other in zip(*found, strict=True):
        assert dict(other.numbers) == pytest.approx(dict(one.numbers), rel=1e-8, abs=1e-8)
    held = [state.numbers for state in found[0]][2:]
    assert held[-1]["P12"] < 0.7 * held[0]["P12"]
    # of the mean stress the branches have done all that is not stored for ever
    assert found[0][-1].energies["relaxing"] > 0.02


# --- laminates ---


def layered(dim: int) -> Body:
    """The lowest quarter is one region, the rest the other."""
    size, axis = (1,) * dim, dim - 1
    body = (rectangle_body if dim == 2 else box_body)(size=size, cells=(1,) * axis + (4,))
    low, high, middle = [0.0] * dim, [1.0] * dim, [0.0] * dim
    top = list(high)
    top[axis], middle[axis] = 0.25, 0.25
    regions = {"soft": Selector(box=[low, top]), "stiff": Selector(box=[middle, high])}
    return name_parts(body, regions=regions)


LAWS = {"soft": LinearElastic(**SOFT), "stiff": LinearElastic(mu=STIFF, nu=0.3)}
SHARE = 0.25


@pytest.mark.long
def test_layers_side_by_side() -> None:
    """Sheared along themselves both have the strain of the cell: exact."""
    periodic = Periodic(pairs=PAIRS3, gradient=[[1, 0.01, 0], [0, 1, 0], [0, 0, 1]])
    problem = Problem(layered(3), LAWS, periodic=periodic, degree=1)
    for state in judged(problem, steps=3, end=2)[1:]:
        wanted = SHARE * relaxed(state.t, MU, MU * (1 - G), TAU) + (1 - SHARE) * STIFF * state.t
        assert state.numbers["P12"] == pytest.approx(0.01 * wanted, rel=1e-10)


@pytest.mark.long
def test_layers_one_behind_the_other() -> None:
    """Sheared across both have the stress of the cell: 1/G(s) is a mean, one exponential again."""
    share, rest = SHARE, 1 - SHARE
    first = share * STIFF + rest * MU
    last = share * STIFF + rest * MU * (1 - G)
    moduli = MU * STIFF / first, MU * (1 - G) * STIFF / last
    wanted = 0.01 * relaxed(1.0, *moduli, TAU * first / last)
    off = []
    for n in (10, 20, 40):
        periodic = Periodic(pairs=PAIRS, gradient=[[1, 0.01], [0, 1]])
        problem = Problem(layered(2), LAWS, periodic=periodic, degree=1)
        off.append(abs(judged(problem, steps=n)[-1].numbers["P12"] / wanted - 1))
    assert np.log2(off[1] / off[2]) == pytest.approx(2, abs=0.1)
    assert off[2] < 1e-4


@pytest.mark.long
def test_a_prescribed_stress_creeps() -> None:
    """Free strain under a shear stress that grows in 0.2 s and stays: the compliance of a point."""
    rest = 1 - G
    slow = TAU / rest

    def strain(t: float) -> float:
        return float((t / rest + (1 - 1 / rest) * slow * -np.expm1(-t / slow)) / MU)

    periodic = Periodic(
        pairs=PAIRS,
        gradient=[[1, FREE], [0, 1]],
        stress=[[FREE, 0.01], [FREE, FREE]],
        curve=[[0, 0], [0.2, 1], [1, 1]],
    )
    off = []
    for n in (10, 20, 40):
        body = rectangle_body(size=(1, 1), cells=(2, 2))
        problem = Problem(body, LinearElastic(**SOFT), periodic=periodic, degree=1)
        state = judged(problem, steps=n)[-1]
        wanted = 0.01 / 0.2 * (strain(1.0) - strain(0.8))
        off.append(abs(state.numbers["F12"] / wanted - 1))
    assert np.log2(off[1] / off[2]) == pytest.approx(2, abs=0.1)
    assert off[2] < 1e-3


# --- metals ---


@pytest.mark.long
def test_a_cell_yields() -> None:
    """In simple shear sqrt(3) tau = yield + slope a, tau = mu (gamma - sqrt(3) a); and back."""
    limit, slope, gamma = 0.02, 1.0, 0.02
    law = J2(mu=MU, nu=0.3, hardening=slope, **{"yield": limit})
    periodic = Periodic(
        pairs=PAIRS3,
        gradient=[[1, gamma, 0], [0, 1, 0], [0, 0, 1]],
        curve=[[0, 0], [1, 1], [2, 0.9]],
    )
    problem = Problem(box_body(size=(1, 1, 1), cells=(2, 1, 1)), law, periodic=periodic, degree=1)
    a = (np.sqrt(3) * MU * gamma - limit) / (3 * MU + slope)
    *_, yielded, back = judged(problem, steps=2, end=2)
    tau = MU * (gamma - np.sqrt(3) * a)
    assert yielded.numbers["P12"] == pytest.approx(tau, rel=1e-9)
    assert back.numbers["P12"] == pytest.approx(tau - MU * 0.1 * gamma, rel=1e-9)
    work = limit * a + slope * a**2 / 2
    assert back.energies["dissipated"] == pytest.approx(work, rel=1e-9)


# --- restarts ---


@pytest.mark.long
def test_a_restart_is_exact() -> None:
    def run() -> Statics:
        laws = {"soft": NeoHookeanSplit(**SOFT), "stiff": NeoHookeanSplit(mu=STIFF, nu=0.3)}
        periodic = Periodic(
            pairs=PAIRS, gradient=[[1.3, 0.2], [0, FREE]], curve=[[0, 0], [0.5, 1], [1, 1]]
        )
        return Statics(Problem(layered(2), laws, periodic=periodic), steps=5)

    first, known, middle = run(), [], None
    for state in first.steps():
        known.append((dict(state.numbers), dict(state.energies)))
        if state.step == 3:
            middle = through_json(first.restart_state())
    for state, (numbers, energies) in zip(run().steps(middle), known[4:], strict=True):
        assert dict(state.numbers) == pytest.approx(numbers, rel=1e-12, abs=1e-12)
        assert state.energies == pytest.approx(energies, rel=1e-12)


def test_check_permits() -> None:
    case = Case(
        mesh={"rectangle": {"size": [1, 1], "cells": [1, 1]}},
        materials={"gel": {"law": "neo-hookean-split", **SOFT}},
        periodic={"pairs": PAIRS, "gradient": [[1.1, 0], [0, 1]]},
        statics={"steps": 3},
    )
    check(case, case.read_body())
