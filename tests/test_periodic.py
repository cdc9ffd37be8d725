"""Periodic faces: homogeneous cells, laminates, holes, free strains, work."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfin_elastic import LinearElastic, NeoHookean, Problem, Statics, box_body, rectangle_body
from dolfin_elastic.model.periodic import Periodic

PAIRS = [["left", "right"], ["bottom", "top"]]
PAIRS3 = [["left", "right"], ["front", "back"], ["bottom", "top"]]


def last(problem: Problem, **settings: Any) -> Any:
    *_, state = Statics(problem, **settings).steps()
    return state


def neo_hooke(F: np.ndarray, E: float, nu: float) -> np.ndarray:
    """P = mu (F - F^-T) + lmbda ln J F^-T: Bonet & Wood (2008), (6.28)."""
    mu, lmbda = E / 2 / (1 + nu), E * nu / (1 + nu) / (1 - 2 * nu)
    inverse = np.linalg.inv(F).T
    return mu * (F - inverse) + lmbda * np.log(np.linalg.det(F)) * inverse


@pytest.mark.parametrize("degree", [1, 2])
def test_homogeneous(degree):
    F = [[1.3, 0.2, 0.0], [0.1, 0.9, 0.05], [0.0, -0.1, 1.1]]
    body = box_body(size=(1, 2, 1.5), cells=(2, 2, 3))
    problem = Problem(
        body, NeoHookean(E=1e6, nu=0.3), degree=degree, periodic=Periodic(pairs=PAIRS3, gradient=F)
    )
    state = last(problem, steps=1)
    P = np.array([[state.numbers[f"P{i}{j}"] for j in (1, 2, 3)] for i in (1, 2, 3)])
    np.testing.assert_allclose(P, neo_hooke(np.array(F), 1e6, 0.3), rtol=1e-10)
