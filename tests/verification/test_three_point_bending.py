"""A beam on two edges with a force along a third one: deflection and stress of the closed form."""

from __future__ import annotations

import pytest

from dolfin_elastic import (
    EdgeSelector,
    Force,
    LinearElastic,
    PointSelector,
    Probe,
    Problem,
    Statics,
    Support,
    box_body,
    name_parts,
)

E, NU = 210e9, 0.3
LENGTH, WIDTH, HEIGHT = 0.2, 0.01, 0.02
FORCE = 1000.0


def test_three_point_bending() -> None:
    """Deflection F L^3/(48 E I) + 6/5 F L/(4 G A), and the stress opposite of the force.

    A force along a line lowers the stress of bending at the other side by 0.133 F/(b c), with half
    the height c.  Source: Timoshenko & Goodier, Theory of Elasticity (1970), section 40.  The lower
    side at midspan sinks by a little less than the axis, and the narrow beam is neither in plane
    stress nor strain: half a percent.
    """
    body = name_parts(
        box_body(size=(LENGTH, WIDTH, HEIGHT), cells=(20, 1, 4)),
        edges={
            "near": EdgeSelector(between=["left", "bottom"]),
            "far": EdgeSelector(between=["right", "bottom"]),
            "middle": EdgeSelector(of="top", plane="x", at=LENGTH / 2),
        },
        points={"corner": PointSelector(nearest=(0, 0, 0))},
    )
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[
            Support(on="near", displacement=["free", "free", 0]),
            Support(on="far", displacement=["free", 0, 0]),
            Support(on="corner", displacement=[0, 0, "free"], name="pin"),
        ],
        loads=[Force(on="middle", value=[0, 0, -FORCE])],
        degree=2,
    )
    *_, state = Statics(problem, steps=1).steps()
    for end in ("near", "far"):
        assert state.reactions[end][2] == pytest.approx(FORCE / 2, rel=1e-9)
    points = {"below": [LENGTH / 2, WIDTH / 2, 0]}
    found = Probe(problem, points, ["displacement", "cauchy_stress"])(state)
    inertia, area, shear = WIDTH * HEIGHT**3 / 12, WIDTH * HEIGHT, E / (2 * (1 + NU))
    bending = FORCE * LENGTH**3 / (48 * E * inertia)
    sunk = bending + 1.2 * FORCE * LENGTH / (4 * shear * area)
    assert found["below_displacement"][2] == pytest.approx(-sunk, rel=5e-3)
    stress = FORCE * LENGTH / 4 * (HEIGHT / 2) / inertia - 0.133 * FORCE / (WIDTH * HEIGHT / 2)
    assert found["below_cauchy_stress"][0] == pytest.approx(stress, rel=5e-3)
