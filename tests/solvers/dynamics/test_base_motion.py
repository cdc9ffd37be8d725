"""An oscillator on a base that follows a record of accelerations, against the closed form.

A triangle with one free component has u" + omega^2 u = -2 a(t) for its displacement u relative to
the base: its mass is rho A/6, and the force on its node rho a A/3.  Between the rows of a record
a(t) is a straight line, for which the solution is known.  Source: A. K. Chopra, Dynamics of
Structures (2012), section 5.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.motion import FREE, NU, OMEGA, PERIOD, RHO, E, oscillator, tip

from dolfin_elastic import Dynamics, LinearElastic, Problem, Support
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.values import component

ROWS = [[0.0, 0.0], [0.2 * PERIOD, 3.0], [0.5 * PERIOD, -4.0], [0.9 * PERIOD, 0.0]]
RECORD = {"table": ROWS, "unit": "m/s^2"}
END = 1.6 * PERIOD


def exact(times: np.ndarray) -> np.ndarray:
    """Relative displacement, piece by piece."""
    pieces = [*zip(ROWS, [*ROWS[1:], [np.inf, 0.0]], strict=True)]
    u, v, result = 0.0, 0.0, np.zeros(len(times))

    def solution(s: Any, a: float, slope: float) -> tuple[Any, Any]:
        p, q = 2 * a / OMEGA**2, 2 * slope / OMEGA**2
        c, d = np.cos(OMEGA * s), np.sin(OMEGA * s)
        place = (u + p) * c + (v + q) / OMEGA * d - p - q * s
        return place, -(u + p) * OMEGA * d + (v + q) * c - q

    for (t0, a0), (t1, a1) in pieces:
        slope = (a1 - a0) / (t1 - t0)
        here = (times >= t0) & (times <= t1)
        result[here] = solution(times[here] - t0, a0, slope)[0]
        if np.isfinite(t1):
            u, v = solution(t1 - t0, a0, slope)
    return result


def relative(way: str, steps: int) -> np.ndarray:
    """Rows of time and displacement relative to the base."""
    record = component(RECORD, "m/s^2", integrals=2)
    if way == "frame":
        problem = oscillator(loads=[LOADS["base-acceleration"](value=[RECORD, 0])])
    else:
        problem = Problem(
            oscillator().body,
            LinearElastic(E=E, nu=NU, density=RHO),
            supports=[
                Support(on="bottom", displacement=[FREE, 0]),
                Support(on="left", acceleration=[RECORD, 0]),
            ],
            degree=1,
        )
    rows = [
        (state.t, tip(problem, state)[0])
        for state in Dynamics(
            problem, end=END, dt=END / steps, rtol=1e-12, spectral_radius=1.0
        ).steps()
    ]
    t, u = np.array(rows).T
    base = 0.0 if way == "frame" else record.evaluate(t=t)  # type: ignore[union-attr]
    return np.stack([t, u - base])


@pytest.mark.parametrize("way", ["frame", "support"])
def test_the_oscillator_follows_the_closed_form(way: str) -> None:
    """In the frame of the base and with the base moved: of second order in the time step."""
    errors = []
    for steps in (30, 60):
        t, u = relative(way, steps)
        known = exact(t)
        errors.append(float(np.abs(u - known).max() / np.abs(known).max()))
    assert errors[1] < 0.04
    assert 3.3 < errors[0] / errors[1] < 4.7
