"""Steps that are too long for the motion are told, though they conserve its energy."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic import Dynamics, LinearElastic, Problem, Support, rectangle_body


@pytest.mark.parametrize("scheme", ["newmark", "generalized-alpha"])
@pytest.mark.parametrize(("steps", "verdict"), [(2.1, "warn"), (3, "warn"), (12, "pass")])
def test_steps_a_period(scheme, steps, verdict):
    """The first mode of a bar along x, T = 4 L/c; with two steps a period the audit passed."""
    problem = Problem(
        rectangle_body(size=(1.0, 0.25), cells=(4, 1)),
        LinearElastic(E=1.0, nu=0.0, density=1.0),
        supports=[Support(on="left")],
        degree=1,
    )
    radius = {"spectral_radius": 1.0} if scheme == "generalized-alpha" else {}
    motion = Dynamics(
        problem,
        end=12.0,
        dt=4.0 / steps,
        scheme=scheme,
        initial_displacement=["1e-3*sin(pi*x/2)", 0],
        **radius,
    )
    states = [*motion.steps()]
    assert states[-1].audit.verdict == verdict
    told = states[-1].audit.so_far
    assert all("hardly four steps make a period" in reason for reason in told)
    assert len(told) == (verdict == "warn")
    assert np.isfinite(states[-1].max_displacement)
