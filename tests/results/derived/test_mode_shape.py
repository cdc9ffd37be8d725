"""Modes in words: of a bar, a plate, and of an L-bracket, whose slices are no cross-sections."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import LinearElastic, Modal, Problem, Support, box_body
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.selection import name_parts
from dolfin_elastic.mesh.selectors import Selector
from dolfin_elastic.results.derived.mode_shape import shape_in_words
from tests.helpers.bodies import made

MOTIONS = {
    "stretching along x": lambda x: np.stack([x[0], 0 * x[0], 0 * x[0]]),
    "bending in y": lambda x: np.stack([-2 * x[0] * x[1], x[0] ** 2, 0 * x[0]]),
    "bending in y and z": lambda x: np.stack([0 * x[0], x[0] ** 2, x[0] ** 2]),
    "torsion about x": lambda x: np.stack([0 * x[0], -x[0] * (x[2] - 0.5), x[0] * (x[1] - 0.5)]),
    "parts against each other in y": lambda x: np.stack([0 * x[0], x[1] - 0.5, 0 * x[0]]),
    "motion in y": lambda x: np.stack([0 * x[0], np.where(x[1] > 0.5, x[1] ** 8, 0), 0 * x[0]]),
    "change of the cross-section": lambda x: np.stack([0 * x[0], x[1] - 0.5, x[2] - 0.5]),
}


@pytest.mark.parametrize("words", MOTIONS)
def test_motions_of_a_bar(words: str) -> None:
    body = box_body(size=(8.0, 1.0, 1.0), cells=(16, 3, 3))
    problem = Problem(body, LinearElastic(E=1.0, nu=0.3), supports=[Support(on="left")])
    u = fem.Function(problem.V)
    u.interpolate(MOTIONS[words])
    assert shape_in_words(problem, u) == words


def l_bracket() -> Body:
    """Two legs in the plane of x and z, of 6 x 2 x 1 and 5 x 2 x 1 m."""
    mesh = box_body(size=(6.0, 2.0, 6.0), cells=(6, 2, 6), comm=MPI.COMM_SELF).mesh
    x, cells = mesh.geometry.x, mesh.geometry.dofmap
    middle = x[cells].mean(axis=1)
    kept = cells[(middle[:, 0] < 1) | (middle[:, 2] < 1)]
    nodes, rows = np.unique(kept, return_inverse=True)
    body = made(MPI.COMM_WORLD, rows.reshape(kept.shape), x[nodes])
    return name_parts(body, surfaces={"bottom": Selector(plane="z", at="min")})


@pytest.mark.parametrize(("body", "words"), [("L", "motion in x"), ("plate", "bending in z")])
def test_the_first_mode_of_other_bodies(body: str, words: str) -> None:
    bodies = {"plate": lambda: box_body(size=(6, 6, 0.6), cells=(4, 4, 1)), "L": l_bracket}
    held = Support(on="left" if body == "plate" else "bottom")
    law = LinearElastic(E=2e11, nu=0.3, density=7850.0)
    problem = Problem(bodies[body](), law, supports=[held], degree=2)
    (mode,) = Modal(problem, count=1).modes()
    assert shape_in_words(problem, mode.u) == words
