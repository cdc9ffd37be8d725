"""Moments of what holds a body, against closed forms and against each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.stacked import stacked

from dolfin_elastic import (
    Contact,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Normal,
    Problem,
    Rigid,
    Spring,
    Statics,
    Support,
    Tie,
    Traction,
    box_body,
    rectangle_body,
)

MESHES: dict[int, dict[str, Any]] = {
    2: {"size": (1.0, 0.6), "lower": (3, 2), "upper": (5, 2)},
    3: {"size": (1.0, 0.8, 0.6), "lower": (3, 2, 2), "upper": (4, 3, 2)},
}


@pytest.mark.parametrize("holder", ["support", "spring"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_cantilever(dim: int, holder: str) -> None:
    """F L about the clamped face's middle, F L/2 where two halves are tied; also about the load.

    Nodal forces are in balance whatever the mesh is: all that is left is the residual, 1e-8 of the
    forces by default.
    """
    held = {
        "support": Support(on="bottom"),
        "spring": Spring(on="bottom", normal=1e9, tangential=1e9),
    }[holder]
    area, L = (1.0, 0.6) if dim == 2 else (0.8, 0.6)
    pull = np.array([1e3, 0.0] if dim == 2 else [1e3, 5e2, 0.0])
    problem = Problem(
        stacked(**MESHES[dim]),
        LinearElastic(E=1e6, nu=0.3, density=1000.0),
        supports=[held],
        loads=[Traction(on="top", value=list(pull))],
        ties=[Tie(on="above", to="below")],
        degree=1,
    )
    *_, state = Statics(problem, steps=1).steps()
    bottom, tie, F = state.moments["bottom"], state.moments["tie_above"], area * pull
    size = L * float(np.linalg.norm(F))
    middle = np.array([0.5, 0.0] if dim == 2 else [0.5, 0.4, 0.0])
    np.testing.assert_allclose(bottom.about, middle, atol=1e-12)
    # Arm L e times force -F: the support turns the body against the load.
    whole = np.array([F[0] * L]) if dim == 2 else np.array([F[1] * L, -F[0] * L, 0.0])
    np.testing.assert_allclose(bottom.value, whole, atol=1e-7 * size)
    np.testing.assert_allclose(tie.value, whole / 2, atol=1e-7 * size)
    above = middle + L * np.eye(dim)[-1]
    at_load = bottom.about_point(above, state.reactions["bottom"])
    np.testing.assert_allclose(at_load, 0.0, atol=1e-7 * size)


def test_all_that_holds_is_in_balance() -> None:
    """A block of rubber, bent over an obstacle: about any point the moments cancel, where it is.

    Among them a support along a slanted normal, whose forces are found by projections.  Each of
    them is a good part of the largest, or the sum would not show that it is wrong.
    """
    body = box_body(size=(1.0, 0.4, 0.3), cells=(4, 2, 2))
    x = body.mesh.geometry.x
    x[:, 0] += 0.2 * x[:, 2] * x[:, 0]  # the right face slants
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        supports=[
            Support(on="left", displacement=[0, 0.02, 0.1]),
            Normal(on="right", displacement=-0.05),
            Spring(on="back", stiffness=[0, 1e6, 1e6]),
        ],
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": 0.02}, name="floor")],
        degree=1,
    )
    *_, state = Statics(problem, steps=2, rtol=1e-10).steps()
    point = np.array([0.3, -1.0, 2.0])
    found = {
        name: moment.about_point(point, state.reactions[name])
        for name, moment in state.moments.items()
    }
    assert set(found) == {"left", "right", "back", "floor"}
    sizes = {name: float(np.linalg.norm(value)) for name, value in found.items()}
    assert min(sizes.values()) > 1e-2 * max(sizes.values())
    np.testing.assert_allclose(sum(found.values()), 0.0, atol=1e-8 * max(sizes.values()))


@pytest.mark.parametrize("scheme", ["newmark", "symplectic-euler"])
def test_in_motion(scheme: str) -> None:
    """With inertia, as of a rigid surface about the same point, which is found in another way."""
    problem = Problem(
        rectangle_body(size=(1.0, 0.4), cells=(3, 2)),
        NeoHookean(E=1e6, nu=0.3, density=1000.0),
        supports=[Rigid(on="left")],
        loads=[Traction(on="right", value=[0, -1e4])],
        degree=1,
    )
    dt = {} if scheme == "symplectic-euler" else {"dt": 0.01}
    *_, state = Dynamics(problem, scheme=scheme, end=0.1, **dt).steps()
    assert abs(state.numbers["moment_left_z"]) > 100.0
    moment = state.moments["left"]
    assert moment.value[0] == pytest.approx(state.numbers["moment_left_z"], rel=1e-9)
