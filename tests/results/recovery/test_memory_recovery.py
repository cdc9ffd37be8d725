"""The recovered stress of materials that remember: their history away from its points.

Under a dead traction T on its ends, free at its sides, a bar of any material has the uniform Cauchy
stress T/l^2, l the stretch across.  What is left of it is round-off and the tolerance of Newton's
method.
"""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    J2Logarithmic,
    Ogden,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.parallel import largest, smallest
from dolfin_elastic.problem.history.region import polynomials_through
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import find_peaks
from dolfin_elastic.results.recovery.stress import von_mises

FREE = "free"
STRESS = 0.1e6
RUBBER = {"mu": [0.63e6, 1.2e3, -10e3], "alpha": [1.3, 5.0, -2.0]}
BRANCHES = [{"g": 0.3, "tau": 0.1}, {"g": 0.2, "tau": 1.0}]
CURVE = [[0, 0], [0.2, 1], [1, 1]]


def rubber(nu: float = 0.4) -> Ogden:
    return Ogden(**RUBBER, nu=nu, prony=BRANCHES)


def flowing() -> Ogden:
    """Its viscous deformation solves equations at the points."""
    branch = [{"ratio": 0.5, "time": 0.3}]
    return Ogden(**RUBBER, nu=0.4, viscous=branch, viscous_deviation="large")


def metal() -> J2Logarithmic:
    """It yields at half the stress that acts."""
    return J2Logarithmic(E=10e6, nu=0.3, yield_stress=0.5 * STRESS, hardening=1e6)


def revolved(law: Any, **keys: Any) -> Problem:
    """A cylinder of revolution about y."""
    body = rectangle_body(size=(10e-3, 20e-3), cells=(2, 4))
    supports = [Support(on="bottom", displacement=[FREE, 0])]
    supports += [Support(on="left", displacement=[0, FREE])]
    load = Traction(on="top", value=[0, STRESS], curve=CURVE)
    return Problem(body, law, supports=supports, loads=[load], geometry="axisymmetric", **keys)


def block(law: Any, **keys: Any) -> Problem:
    body: Body = box_body(size=(10e-3, 10e-3, 20e-3), cells=(2, 2, 3))
    sides = {"left": 0, "front": 1, "bottom": 2}
    supports = [
        Support(on=side, displacement=[0 if i == axis else FREE for i in range(3)])
        for side, axis in sides.items()
    ]
    load = Traction(on="top", value=[0, 0, STRESS], curve=CURVE)
    return Problem(body, law, supports=supports, loads=[load], **keys)


@pytest.mark.long
@pytest.mark.parametrize(
    "problem",
    [
        lambda: revolved(rubber()),
        lambda: revolved(rubber(), quadrature_degree=6),
        lambda: revolved(rubber(0.5)),
        lambda: revolved(metal()),
        lambda: revolved(flowing()),
        lambda: block(rubber(), quadrature_degree=5),
    ],
)
def test_a_uniform_stress_is_recovered_exactly(problem: Any) -> None:
    """At every node, and the estimated error says so: it is no larger than what is wrong."""
    made = problem()
    state = list(Statics(made, steps=5).steps())[-1]
    estimate = ErrorEstimator(made)(state)
    own = made.V.dofmap.index_map.size_local
    x, u = made.places[:own, 0], state.u.x.array.reshape(-1, made.body.dim)[:own, 0]
    comm, side = MPI.COMM_WORLD, np.isclose(x, 10e-3)
    across = 1 + largest(comm, float(np.max(u[side] / 10e-3, initial=-1.0)))
    wanted = STRESS / across**2
    found = von_mises(estimate.stress.stress)
    assert largest(comm, float(found.max(initial=0.0))) == pytest.approx(wanted, rel=1e-7)
    assert smallest(comm, float(found.min(initial=np.inf))) == pytest.approx(wanted, rel=1e-7)
    peak = find_peaks(made, estimate).largest
    assert peak.value == pytest.approx(wanted, rel=1e-7)
    assert peak.error < 1e-7
    assert estimate.relative < 1e-7


@pytest.mark.parametrize("kind", [basix.CellType.triangle, basix.CellType.tetrahedron])
@pytest.mark.parametrize("degree", range(11))
def test_polynomials_through_points(kind: basix.CellType, degree: int) -> None:
    """They take all values, and are what these came from up to a quarter of the rule's degree."""
    points = basix.make_quadrature(kind, degree)[0]
    order, to_points, to_nodes = polynomials_through(kind, points)
    assert to_points @ to_nodes == pytest.approx(np.eye(len(points)), abs=1e-12)
    nodes = basix.ufl.element("DG", kind, order).basix_element.points

    def some(x: np.ndarray) -> np.ndarray:
        return np.asarray((1 - x @ np.arange(1, x.shape[1] + 1)) ** (degree // 4))

    assert to_nodes @ some(points) == pytest.approx(some(nodes), abs=1e-11)
