"""Modes in words: those of a bar of a rectangular section, clamped at one end."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem

from dolfin_elastic import LinearElastic, Problem, Support, box_body
from dolfin_elastic.results.derived.mode_shape import shape_in_words

MOTIONS = {
    "stretching along x": lambda x: np.stack([x[0], 0 * x[0], 0 * x[0]]),
    "bending in y": lambda x: np.stack([-2 * x[0] * x[1], x[0] ** 2, 0 * x[0]]),
    "bending in y and z": lambda x: np.stack([0 * x[0], x[0] ** 2, x[0] ** 2]),
    "torsion about x": lambda x: np.stack([0 * x[0], -x[0] * (x[2] - 0.5), x[0] * (x[1] - 0.5)]),
    "parts against each other in y": lambda x: np.stack([0 * x[0], x[1] - 0.5, 0 * x[0]]),
    "change of the cross-section": lambda x: np.stack([0 * x[0], x[1] - 0.5, x[2] - 0.5]),
}


@pytest.mark.parametrize("words", MOTIONS)
def test_motions_of_a_bar(words: str) -> None:
    body = box_body(size=(8.0, 1.0, 1.0), cells=(16, 3, 3))
    problem = Problem(body, LinearElastic(E=1.0, nu=0.3), supports=[Support(on="left")])
    u = fem.Function(problem.V)
    u.interpolate(MOTIONS[words])
    assert shape_in_words(problem, u) == words
