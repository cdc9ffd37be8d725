"""What rigid surfaces that move themselves leave free of a body, by hand."""

from __future__ import annotations

from typing import Any

import pytest

from dolfin_elastic import LinearElastic, Problem, Support, box_body
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.solvers.diagnostics.rigid_body import (
    check_no_rigid_motion,
    constrained_directions,
    free_bodies,
)

FREE, ZERO = ["free"] * 3, [0, 0, 0]
ABOUT_X = "turn about x through (1, 0.5, 0.5) m"
LEFT_END = [f"turn about {axis} through (0, 0.5, 0.5) m" for axis in "yz"]
"""Through the middle of the surface, where rotations begin; along x any point will do."""
CASES: list[tuple[dict[str, Any], dict[str, Any] | None, list[str]]] = [
    ({"displacement": ZERO, "rotation": ZERO}, None, []),
    ({"displacement": ["free", 0, 0], "rotation": ZERO}, None, ["move along x"]),
    ({"displacement": ZERO, "rotation": ["free", 0, 0]}, None, [ABOUT_X]),
    ({"displacement": ZERO, "rotation": [0, 0, "free"]}, None, LEFT_END[1:]),
    ({"displacement": FREE, "rotation": FREE}, None, ["move and turn freely"]),
    (
        {"displacement": ["free", "free", 0], "rotation": [0, 0, "free"]},
        None,
        ["move along x", "move along y", "turn about z through (1, 0.5, 0.5) m"],
    ),
    # Two at once: what both can follow.
    (
        {"displacement": ["free", 0, 0], "rotation": ZERO},
        {"displacement": ["free", 0, 0], "rotation": ZERO},
        ["move along x"],
    ),
    (
        {"displacement": ["free", 0, 0], "rotation": ZERO},
        {"displacement": [0, "free", 0], "rotation": ZERO},
        [],
    ),
    (
        {"displacement": ZERO, "rotation": FREE},
        {"displacement": FREE, "rotation": FREE},
        [ABOUT_X, *LEFT_END],
    ),
    ({"displacement": ZERO, "rotation": FREE}, {"displacement": ZERO, "rotation": FREE}, [ABOUT_X]),
]


def problem(left: dict[str, Any], right: dict[str, Any] | None, **more: Any) -> Problem:
    """A block of 2 x 1 x 1 m between rigid plates."""
    supports = [Rigid(on="left", **left)]
    supports += [] if right is None else [Rigid(on="right", **right)]
    body, law = box_body(size=(2, 1, 1), cells=(4, 2, 2)), LinearElastic(E=1.0, nu=0.3)
    return Problem(body, law, supports=[*supports, *more.get("supports", [])], degree=1)


@pytest.mark.parametrize(("left", "right", "motions"), CASES)
def test_what_rigid_plates_leave_free(
    left: dict[str, Any], right: dict[str, Any] | None, motions: list[str]
) -> None:
    """The body follows its plates as far as they are free, on any number of ranks."""
    held = problem(left, right)
    [body] = free_bodies(held)
    assert [*body.motions] == motions
    if not motions:
        check_no_rigid_motion(held)
        return
    with pytest.raises(InputError, match="as a rigid body it can") as caught:
        check_no_rigid_motion(held)
    assert ", ".join(motions) in str(caught.value)


def test_a_support_beside_a_free_plate() -> None:
    """A plate that may turn about x, and a line of rollers that keeps the block from doing so."""
    free = {"displacement": ZERO, "rotation": ["free", 0, 0]}
    more = [Support(on="bottom", displacement=["free", "free", 0])]
    held = problem(free, None, supports=more)
    assert free_bodies(held)[0].motions == ()
    found = constrained_directions(held)
    assert found.directions.shape == (len(found.nodes), 3)
