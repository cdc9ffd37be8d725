"""Contact between two deformable surfaces: patch tests, tangent, references, other ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.stacked import stacked
from helpers.tangents import against_differences

from dolfin_elastic import (
    Contact,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
)
from dolfin_elastic.problem.terms.bodies import functions

FREE = "free"
E, NU = 1e6, 0.3
MESHES: dict[int, dict[str, Any]] = {
    2: {"size": (1.0, 0.6), "lower": (3, 2), "upper": (5, 2)},
    3: {"size": (1.0, 0.8, 0.6), "lower": (3, 2, 2), "upper": (4, 3, 2)},
}
BETWEEN = Contact(between=["below", "above"], name="joint")


def last(problem: Problem, **settings: Any) -> Any:
    *_, state = Statics(problem, **settings).steps()
    return state


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_patch_test(dim, degree):
    """Uniform stress passes a flat interface of unlike faces and materials: round-off only."""
    sides = [Support(on=["left", "right"], displacement=[0, *[FREE] * (dim - 1)])]
    if dim == 3:
        sides.append(Support(on=["front", "back"], displacement=[FREE, 0, FREE]))
    problem = Problem(
        stacked(**MESHES[dim]),
        {"lower": LinearElastic(E=E, nu=NU), "upper": LinearElastic(E=4 * E, nu=0.2)},
        degree=degree,
        supports=[Support(on="bottom", displacement=[*[FREE] * (dim - 1), 0]), *sides],
        loads=[Traction(on="top", value=[*[0] * (dim - 1), -1e4])],
        contacts=[BETWEEN],
    )
    state = last(problem, steps=1)
    (pair,) = problem.contact_pairs
    np.testing.assert_allclose(pair.pressures(), 1e4, rtol=1e-10)
    x, u = (a.reshape(-1, dim) for a in (problem.places[:, :dim], problem.u.x.array))
    moduli = [e * (1 - n) / (1 + n) / (1 - 2 * n) for e, n in ((E, NU), (4 * E, 0.2))]
    height = MESHES[dim]["size"][-1] / 2
    strain = -1e4 / np.array(moduli)
    low, high = strain[0] * x[:, -1], strain[0] * height + strain[1] * (x[:, -1] - height)
    high -= state.numbers["penetration_joint"]
    off = np.minimum(np.abs(u[:, -1] - low), np.abs(u[:, -1] - high))
    assert off.max(initial=0.0) < 1e-10 * abs(strain[0]) * height
    assert np.abs(u[:, :-1]).max(initial=0.0) < 1e-10 * abs(strain[0]) * height
    area = np.prod(MESHES[dim]["size"][:-1])
    assert state.reactions["joint"][-1] == pytest.approx(1e4 * area, rel=1e-10)
    assert state.numbers["contact_area_joint"] == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_tangent(dim, degree, monkeypatch):
    """Against central differences where the cut stays as it is; symmetric."""
    problem = Problem(
        stacked(**MESHES[dim]), NeoHookean(E=E, nu=NU), contacts=[BETWEEN], degree=degree
    )
    pair, comm = problem.contact_pairs[0], problem.body.comm
    pair.lam.x.array[:] = 1e5

    def freeze() -> None:
        assert comm.allreduce(int(np.sum(pair.pressures() > 0))) > 0
        cut = functions.cut
        known: list[Any] = []

        def frozen(*args: Any, **keys: Any) -> Any:
            known.extend([] if known else [cut(*args, **keys)])
            return known[0]

        monkeypatch.setattr(functions, "cut", frozen)
        pair.pieces._at = np.empty(0)
        pair.pressures()

    with against_differences(problem, freeze) as (assembler, off, size):
        # Cancellation: 1e-16 of the forces over 1e-7 of the place.
        assert off < 1e-7 * size
        assert assembler.tangent.matrix.isSymmetric(1e-9 * size)
