"""Middles of curved surfaces and edges against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import ball, made
from mpi4py import MPI
from scipy.integrate import quad

from dolfin_elastic import Selector, name_parts, read_body
from dolfin_elastic.mesh.body import centre_of, middle_of

COMM = MPI.COMM_WORLD


def test_a_parabola() -> None:
    """Of a cell with one curved side, exact but for the quadrature of the arc's length.

    With a straight third side its y would be larger by more than 0.03.
    """
    h = 0.2
    points = [[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0, 0.5], [0.5, -h]]
    body = made(COMM, [[0, 1, 2, 3, 4, 5]], points, order=2)
    # The curve y = -4 h x (1 - x), and straight sides of lengths 1 and sqrt 2.
    length = quad(lambda x: np.hypot(1, 4 * h * (1 - 2 * x)), 0, 1, epsabs=1e-12)[0]
    moment = quad(
        lambda x: -4 * h * x * (1 - x) * np.hypot(1, 4 * h * (1 - 2 * x)), 0, 1, epsabs=1e-12
    )[0]
    diagonal = np.sqrt(2.0)
    exact = np.array([length / 2 + diagonal / 2, moment + 0.5 + diagonal / 2])
    exact /= length + 1 + diagonal
    # The rule has 5 points on the arc.
    np.testing.assert_allclose(centre_of(body, ["all"]), exact, rtol=0, atol=1e-5)


def test_an_eighth_of_a_sphere(folder: Path) -> None:
    """Curved face (1/2, 1/2, 1/2); flat faces, quarters of a disc, 4 / (3 pi).

    The error of quadratic cells, h/4 = 0.09 at most, is below h^4; that of flat facets is 1.4e-3.
    """
    if COMM.rank == 0:
        ball(folder / "ball.msh")
    COMM.barrier()
    body = name_parts(
        read_body(folder / "ball.msh", comm=COMM),
        surfaces={
            "round": Selector(sphere={"center": [0, 0, 0], "radius": 1}),
            "flat": Selector(plane="z", at=0),
        },
    )
    assert middle_of(body, ["round"]) == pytest.approx([0.5] * 3, abs=2e-4)
    quarter = 4 / (3 * np.pi)
    assert middle_of(body, ["flat"]) == pytest.approx([quarter, quarter, 0], abs=2e-4)
