"""Paths followed by their length, of materials that remember but know no time.

A bar is pulled beyond its strength: sigma = E eps exp(-E eps^2/(2 limit)) has its largest value at
eps = sqrt(limit/E), and falls from there.
"""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import through_json
from helpers.damaged import Damaged

from dolfin_elastic import LinearElastic, Problem, Statics, Support, Traction, box_body
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.statics.arc_length import ArcLength

E, LIMIT = 2.0, 0.02
PEAK = float(np.sqrt(LIMIT / E))
STRENGTH = E * PEAK * np.exp(-0.5)
FREE = "free"
AROUND = ["left", "right", "front", "back"]


def bar(**keys: Any) -> Problem:
    """One cube of six tetrahedra under a traction of 1 Pa at the load factor 1, nu = 0."""
    supports = [
        Support(on=AROUND, displacement=[0, 0, FREE]),
        Support(on="bottom", displacement=[0, 0, 0]),
    ]
    law = Damaged(E=E, nu=0, limit=LIMIT)
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    pull = Traction(on="top", value=[0, 0, 1])
    return Problem(body, law, supports=supports, loads=[pull], degree=1, **keys)


def stress(strain: float) -> float:
    return float(E * strain * np.exp(-E * strain**2 / 2 / LIMIT))


def path(problem: Problem, **keys: Any) -> Statics:
    settings = {"first_step": 0.01, "max_displacement": 3 * PEAK} | keys
    return Statics(problem, method="arc-length", **settings)


def remembered(problem: Problem, name: str) -> float:
    assert problem.history is not None
    values = [f.x.array for key, f in problem.history.fields().items() if key.endswith(name)]
    return largest(problem.body.comm, float(np.max(values[0], initial=0.0)))


def followed(states: list[State]) -> None:
    """Every state has the stress of its strain, and the audit balances with what is lost."""
    for state in states:
        assert state.t == pytest.approx(stress(state.max_displacement), rel=1e-7, abs=1e-12)
        assert state.audit is not None
        assert state.audit.verdict in ("pass", "warn"), state.audit.reasons
        assert not any("differ by more" in reason for reason in state.audit.reasons)


def test_a_path_goes_beyond_the_strength() -> None:
    problem = bar()
    states = list(path(problem).steps())
    followed(states)
    assert states[-1].max_displacement > 3 * PEAK
    assert states[-1].t < 0.5 * STRENGTH
    assert states[-1].limit_points == pytest.approx([STRENGTH], rel=1e-6)
    last = states[-1].max_displacement
    assert remembered(problem, "count") == len(states) - 1  # every point once, and no trial
    assert remembered(problem, "kappa") == pytest.approx(E * last**2 / 2, rel=1e-9)
    # what is lost is the work, but for what is stored
    kappa = E * last**2 / 2
    lost = LIMIT - (LIMIT + kappa) * np.exp(-kappa / LIMIT)
    assert states[-1].energies["dissipated"] == pytest.approx(lost, rel=1e-6)


def test_rejected_points_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second point that was found is given up, and the step repeated with half its length."""
    turns = cycle([True, False])
    monkeypatch.setattr(ArcLength, "_turns_sharply", lambda self, last: next(turns))
    problem = bar()
    states = list(path(problem, min_step=1e-6, max_displacement=1.5 * PEAK).steps())
    assert next(turns)  # as many were given up as were kept
    followed(states)
    assert len(states) > 8
    assert remembered(problem, "count") == len(states) - 1
    last = states[-1].max_displacement
    assert remembered(problem, "kappa") == pytest.approx(E * last**2 / 2, rel=1e-9)


def test_a_path_goes_on() -> None:
    first, known, middle = path(bar()), [], None
    for state in first.steps():
        known.append((state.t, state.max_displacement, dict(state.energies)))
        if len(known) == 5:
            middle = through_json(first.restart_state())
    assert len(known) > 8
    problem = bar()
    for state, (t, moved, energies) in zip(path(problem).steps(middle), known[5:], strict=True):
        assert state.t == pytest.approx(t, rel=1e-9)
        assert state.max_displacement == pytest.approx(moved, rel=1e-9)
        assert state.energies == pytest.approx(energies, rel=1e-8)
    assert remembered(problem, "count") == len(known) - 1


def test_an_end_is_met() -> None:
    """The last point is found between two others, from the history of the first of them."""
    problem = bar()
    states = list(path(problem, end=0.5 * STRENGTH).steps())
    followed(states)
    assert states[-1].t == 0.5 * STRENGTH
    assert remembered(problem, "count") == len(states) - 1
    by_load = bar()
    *_, last = Statics(by_load, steps=3, end=0.5 * STRENGTH).steps()
    assert last.max_displacement == pytest.approx(states[-1].max_displacement, rel=1e-7)


def test_what_relaxes_is_refused() -> None:
    law = LinearElastic(E=1, nu=0, prony=[{"g": 0.5, "tau": 1}])
    body = box_body(size=(1, 1, 1), cells=(1, 1, 1))
    problem = Problem(body, law, supports=[Support(on="bottom", displacement=[0, 0, 0])])
    with pytest.raises(InputError, match="along a path no time passes"):
        list(Statics(problem, method="arc-length").steps())
