"""Boxes and cones as obstacles: punches, plugs in conical bores, and what falls on an edge."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfin_elastic import (
    Contact,
    Dynamics,
    NeoHookean,
    Problem,
    Statics,
    Support,
    rectangle_body,
)

FREE = "free"
E, NU, MU = 1e6, 0.3, 0.2
ANGLE = np.radians(20)


@pytest.mark.long
@pytest.mark.parametrize("degree", [1, 2])
def test_a_flat_punch_is_a_plane_where_it_is_wider(degree):
    """A block under a box and under a plane, alike to the solver's tolerance."""
    states = []
    for shape in (
        {"plane": {"axis": "-y", "at": 1}},
        {"box": {"center": [0.5, 1.25], "size": [0.5, 3], "x": "y"}},
    ):
        problem = Problem(
            rectangle_body(size=(1, 1), cells=(3, 3)),
            NeoHookean(E=E, nu=NU),
            supports=[Support(on="bottom")],
            contacts=[Contact(on="top", motion=[0, -0.1], name="punch", friction=MU, **shape)],
            degree=degree,
        )
        *_, state = Statics(problem, steps=2).steps()
        states.append((state.u.x.array.copy(), state.reactions["punch"]))
    (u, force), (same_u, same_force) = states
    assert force[1] < -0.05 * E
    np.testing.assert_allclose(same_force, force, rtol=0, atol=1e-8 * E)
    np.testing.assert_allclose(same_u, u, atol=1e-8)


def plug(turned: bool, degree: int, friction: float) -> Problem:
    """One half of a plug, radius 1 below, in a bore that fits, whose top is pressed down."""
    body = rectangle_body(size=(1, 1), cells=(3, 3))
    place = body.mesh.geometry.x
    place[:, 0] *= 1 + place[:, 1] * np.tan(ANGLE)
    bore = {"tip": [0, -1 / np.tan(ANGLE)], "axis": "y", "half_angle": 20, "inside": True}
    return Problem(
        body,
        NeoHookean(E=E, nu=NU),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="top", displacement=[FREE, -0.1], name="press"),
        ],
        contacts=[Contact(on="right", cone=bore, friction=friction, name="bore")],
        geometry="axisymmetric" if turned else "plane-strain",
        degree=degree,
    )


@pytest.mark.parametrize(
    ("turned", "degree", "friction"), [(False, 1, 0.0), (False, 1, MU), (True, 2, MU)]
)
def test_a_plug_in_a_conical_bore(turned, degree, friction):
    """Once all of it slides, F = N (sin a + mu cos a), N the bore's force along its normal.

    Forces balance to Newton's tolerance, 1e-8 of the nodal ones.
    """
    problem = plug(turned, degree, friction)
    *_, state = Statics(problem, steps=4).steps()
    normal = -state.reactions["bore"] @ [np.cos(ANGLE), -np.sin(ANGLE)]
    force = -state.reactions["press"][1]
    assert force > 0.01 * E
    assert force == pytest.approx(normal * (np.sin(ANGLE) + friction * np.cos(ANGLE)), rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("degree", "settings", "shape"),
    [
        (
            2,
            {"scheme": "generalized-alpha", "dt": 4e-3, "spectral_radius": 1.0},
            {"cone": {"tip": [0.5, -0.02], "axis": "-y", "half_angle": 80}},
        ),
        (
            1,
            {"scheme": "symplectic-euler"},
            {"box": {"center": [0.5, -0.4], "size": [0.6, 0.7], "x": [1, 0.1]}},
        ),
    ],
    ids=["cone, implicit", "box, explicit"],
)
def test_a_block_bounces_off_an_edge(degree: int, settings: Any, shape: Any) -> None:
    """What the penalty stores comes back."""
    problem = Problem(
        rectangle_body(size=(1, 1), cells=(2, 2)),
        NeoHookean(E=E, nu=NU, density=1000),
        contacts=[Contact(on="bottom", name="edge", **shape)],
        degree=degree,
    )
    motion = Dynamics(problem, end=0.2, initial_velocity=[0, -1.0], **settings)
    rows = [
        (s.energies["total"], s.energies["contact"], s.momenta["linear"][1]) for s in motion.steps()
    ]
    total, stored, momentum = np.array(rows).T
    assert stored.max() > 0.01 * total[0]
    assert stored[0] == stored[-1] == 0.0
    assert momentum[-1] > 0.5 * abs(momentum[0])
    assert total[-1] == pytest.approx(total[0], rel=0.05)
