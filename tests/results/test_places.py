"""Places of extremes with equal values are those nearest to the origin, on any number of ranks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Case,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.case.check.loads import LoadSum
from dolfin_elastic.case.glyphs import SAMPLES, glyphs_of
from dolfin_elastic.case.model_record import model_record
from dolfin_elastic.core.parallel import largest_row
from dolfin_elastic.mesh.geometry.simplices import facet_corners, prepare_facets
from dolfin_elastic.results.quantity import Extremes
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import find_peaks
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

WORLD = MPI.COMM_WORLD


def pulled(law=None) -> Problem:
    """A cube under homogeneous stress: every value of stress and det F is equal to round-off."""
    return Problem(
        box_body(size=(1, 1, 1), cells=(4, 4, 4), origin=(-0.25, -0.5, -0.5)),
        law or LinearElastic(E=1e6, nu=0.3),
        supports=[
            Support(on="left", displacement=[0, "free", "free"]),
            Support(on="front", displacement=["free", 0, "free"]),
            Support(on="bottom", displacement=["free", "free", 0]),
        ],
        loads=[Traction(on="right", value=[1e3, 0, 0])],
    )


@pytest.mark.parametrize("method", ["direct", "iterative"])
def test_equal_values(method: str) -> None:
    """The stress is that of the node at the origin, det F that of the cell nearest to it."""
    problem = pulled()
    (*_, state) = Statics(problem, linear=LinearSettings(method=method)).steps()
    found = Extremes(problem).of(state)
    assert found["von_mises"].place == pytest.approx((0, 0, 0), abs=1e-12)
    assert found["von_mises"].value == pytest.approx(1e3, rel=1e-6)
    assert found["displacement"].place[0] == pytest.approx(0.75)
    corners = problem.body.mesh.geometry.x[problem.body.mesh.geometry.dofmap]
    nearest = np.linalg.norm(corners.mean(axis=1), axis=1).min()
    nearest = WORLD.allreduce(float(nearest), op=MPI.MIN)
    for name in ("min_jacobian", "max_jacobian"):
        assert np.linalg.norm(found[name].place) == pytest.approx(nearest)
        assert found[name].place == min(WORLD.allgather(found[name].place))
    assert found["min_jacobian"].place == found["max_jacobian"].place
    watch = JacobianWatch(problem)
    for value, place in (*watch.extremes(), watch.steepest(), watch.refused()):
        assert place == pytest.approx(found["min_jacobian"].place), value
    peaks = find_peaks(problem, ErrorEstimator(problem)(state))
    assert peaks.largest.place == pytest.approx((0, 0, 0), abs=1e-12)


def test_symmetric_values() -> None:
    """Of two corners alike the one that comes first along x, y and z."""
    problem = Problem(
        box_body(size=(2, 1, 1), cells=(4, 2, 2), origin=(-1, -0.5, -0.5)),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="left"), Support(on="right")],
        loads=[Traction(on="top", value=[0, 0, -1e4])],
    )
    (*_, state) = Statics(problem).steps()
    at = Extremes(problem).of(state)["von_mises"].place
    assert at[0] < 0
    assert at[1] <= 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_round_off_decides_nothing(seed: int) -> None:
    """Rows of one table, dealt out to ranks at random, and disturbed by less than they agree to."""
    known = np.random.default_rng(seed)
    x = known.integers(-3, 4, (200, 3)) / 7.0
    values = known.integers(0, 3, 200).astype(float)
    best = x[values == 2.0]
    away = np.linalg.norm(best, axis=1)
    wanted = min(tuple(row) for row in best[away < away.min() + 1e-6])
    own = np.random.default_rng(seed + 100).integers(0, WORLD.size, 200) == WORLD.rank
    noise = np.random.default_rng([seed, WORLD.rank])
    x, values = x[own] * (1 + 1e-13), values[own] * (1 + 1e-9 * noise.random(own.sum()))
    found = largest_row(WORLD, values, lambda rows: x[rows])
    assert found is not None
    assert found.place == pytest.approx(wanted, abs=1e-12)
    assert found.value == pytest.approx(2.0, rel=1e-8)
    assert WORLD.bcast(found) == found


def test_differences_count() -> None:
    """Of numbers near 1 their differences from it: 1e-9 is not equal to 2e-9, but to round-off."""
    values = 1 + 1e-9 * np.array([2.0, 1.0, 2.0 + 1e-7])
    x = np.array([[2.0, 0, 0], [0, 0, 0], [3, 0, 0]])
    found = largest_row(WORLD, values, lambda rows: x[rows], least=1e-14, about=1.0)
    assert found is not None
    assert found.place == (2, 0, 0)


def test_nothing_counts() -> None:
    values = np.full(3, np.nan)
    assert largest_row(WORLD, values, lambda rows: np.zeros((len(rows), 3))) is None


def test_places_of_parts() -> None:
    """Glyphs of a surface with more facets than these: spread, and found without the ranks."""
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [6, 6, 6]}},
            "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3}},
            "support": [{"on": "left"}],
        }
    )
    body = case.read_body(WORLD)
    (row,) = model_record(case, body, (), (), {})["glyphs"]
    places = np.array(row["places"])
    assert places.shape == (SAMPLES, 3)
    assert np.array(row["along"]) == pytest.approx(np.tile([1.0, 0, 0], (SAMPLES, 1)))
    facets = np.concatenate(WORLD.allgather(centres(body)))
    kept = [int(np.argmin(keys(facets)))]
    while len(kept) < SAMPLES:
        away = np.linalg.norm(facets[:, None] - facets[kept], axis=2).min(axis=1)
        far = np.flatnonzero(away > away.max() * (1 - 1e-9))
        kept.append(int(far[np.argmin(keys(facets[far]))]))
    assert places == pytest.approx(facets[kept], abs=1e-6)
    gaps = [np.linalg.norm(places[:k] - places[k], axis=1).min() for k in range(1, SAMPLES)]
    assert all(one >= other - 1e-5 for one, other in pairwise(gaps))


def test_places_of_forces_at_points_and_along_lines() -> None:
    """Their glyphs stand where the forces act, not in the middle of the body."""
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [2, 2, 2]}},
            "materials": {"m": {"law": "neo-hookean", "E": 1e6, "nu": 0.3}},
            "support": [{"on": "left"}],
            "load": [
                {"kind": "point-force", "at": [1, 1, 1], "value": [0, 0, -3]},
                {"kind": "line-force", "start": [1, 0, 1], "end": [1, 1, 1], "value": [0, 0, -2]},
            ],
        }
    )
    sums = [LoadSum(f"load[{k}]", "", (0.0, 0.0, -1.0), None, 1.0) for k in range(2)]
    _, point, line = glyphs_of(case, case.read_body(WORLD), sums)
    assert point.places == pytest.approx(np.ones((1, 3)))
    assert line.places[:, [0, 2]] == pytest.approx(1.0)
    assert np.ptp(line.places[:, 1]) > 0.9
    for glyphs in (point, line):
        assert glyphs.along == pytest.approx(np.tile([0, 0, -1.0], (len(glyphs.places), 1)))


def centres(body) -> np.ndarray:
    prepare_facets(body.mesh)
    return facet_corners(body.mesh, body.owned_facets("left")).mean(axis=1)


def keys(x: np.ndarray) -> np.ndarray:
    """A number that grows with the distance from the origin, and then with x, y and z."""
    return np.linalg.norm(x, axis=1) + x @ np.array([1e-4, 1e-6, 1e-8])
