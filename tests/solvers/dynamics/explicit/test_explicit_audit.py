"""Audit of explicit motion: what holds in any motion, and what is told where it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import through_json

from dolfin_elastic import (
    Body,
    Contact,
    Dashpot,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Normal,
    Pressure,
    Problem,
    Spring,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.problem.state import Audit, State
from dolfin_elastic.solvers.assembly.assembler import Reactions

SCHEMES = ("symplectic-euler", "central-differences")
SOFT: dict[str, Any] = {"E": 1e5, "nu": 0.3, "density": 1000.0}
ROUND_OFF = 1e-11
"""Forces add up over some hundred elements, each exact to machine precision."""


def audits(problem: Problem, **settings: Any) -> list[tuple[State, Audit]]:
    settings = {"end": 0.05, "every": 5, "dt": 4e-4, **settings}
    states = [*Dynamics(problem, **settings).steps()]
    return [(s, s.audit) for s in states if s.audit is not None and not s.between]


def moving(law: Any, body: Body | None = None) -> Problem:
    return Problem(
        body or box_body(size=(1, 0.5, 0.5), cells=(4, 2, 2)),
        law,
        supports=[
            Normal(on="left", displacement="0.01*(1 - cos(60*t))"),
            Spring(on="front", normal=1e5, displacement=[0, "0.005*sin(80*t)", 0]),
            Dashpot(on="right", normal=300.0, tangential=100.0),
        ],
        loads=[Pressure(on="top", value="2000*t/0.05")],
        contacts=[
            Contact(
                on="bottom",
                plane={"axis": "z", "at": -0.004},
                motion=[0, 0, "0.02*sin(50*t)"],
                name="floor",
            )
        ],
        degree=1,
    )


@pytest.mark.long
@pytest.mark.parametrize("scheme", SCHEMES)
def test_all_that_acts_balances(scheme: str) -> None:
    """Loads, a moving support, springs, dashpots, an obstacle, inertia; with all dampings, too."""
    damped = {"rayleigh": [30.0, 0], "bulk_viscosity": True}
    cases = [{}, damped] if scheme == "central-differences" else [{}]
    for more in cases:
        found = audits(moving(NeoHookean(**SOFT)), scheme=scheme, **more)
        assert len(found) > 8
        for state, audit in found:
            assert audit.verdict_so_far == "pass", audit.so_far
            assert max(audit.force, audit.moment) < ROUND_OFF
            assert audit.work == state.energies["external"]
            first = found[0][0].energies["total"]
            assert audit.energy == state.energies["total"] - first
            assert 0.5 < audit.min_jacobian <= audit.max_jacobian < 1.5
            assert not audit.notes or state.step == 0  # nothing but round-off acts then


def test_motion_from_a_checkpoint_without_its_energy() -> None:
    """One of an older version: the note says so, and that is no reason to warn."""
    settings: dict[str, Any] = {"end": 0.02, "every": 25, "dt": 4e-4, "scheme": SCHEMES[0]}
    body = box_body(size=(1, 0.5, 0.5), cells=(4, 2, 2))
    first = Dynamics(moving(NeoHookean(**SOFT), body), **settings)
    states = first.steps()
    for _ in range(2):
        next(states)
    for known in (True, False):
        state = first.restart_state()
        if not known:
            state = replace(
                state, numbers={k: x for k, x in state.numbers.items() if k != "initial"}
            )
        again = Dynamics(moving(NeoHookean(**SOFT), body), **settings).steps(through_json(state))
        audit = [state.audit for state in again if not state.between][-1]
        assert audit is not None
        assert np.isnan(audit.energy) == (not known)
        assert any("energy since the start is not known" in x for x in audit.notes) != known
        assert audit.verdict_so_far == "pass"
    states.close()


def test_a_linear_law_balances_on_the_undeformed_body() -> None:
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(body, LinearElastic(**SOFT), supports=[Support(on="left")], degree=1)
    for _, audit in audits(problem, scheme=SCHEMES[1], initial_velocity=[0, "x", 0]):
        assert max(audit.force, audit.moment) < ROUND_OFF
        assert audit.verdict_so_far == "pass"


def test_a_force_that_is_lost_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A load a thousandth of which does not arrive: 0.1 % of it is out of balance."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    load = Traction(on="right", value=[1e3, 0, 0])
    law = NeoHookean(**SOFT)
    problem = Problem(body, law, supports=[Support(on="left")], loads=[load], degree=1)
    loads = Reactions.loads
    monkeypatch.setattr(Reactions, "loads", lambda self: np.asarray(1.001 * loads(self)))
    _, audit = audits(problem, scheme=SCHEMES[0])[-1]
    assert audit.verdict_so_far == "warn"
    assert any("loads and reactions do not balance" in reason for reason in audit.so_far)
    assert audit.force == pytest.approx(1e-3, rel=0.7)
