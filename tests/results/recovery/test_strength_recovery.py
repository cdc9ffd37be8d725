"""Safety factors of strengths that depend on direction, of bodies whose stress is known exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import (
    LinearElastic,
    NeoHookean,
    Orthotropic,
    Probe,
    Problem,
    Support,
    box_body,
)
from dolfin_elastic.core.parallel import largest, smallest
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import PartNumbers
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import default_fields
from dolfin_elastic.results.quantity import Quantity
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import LOWER, PeakFinder, find_peaks, least_ratio
from dolfin_elastic.results.recovery.singular import singular_places
from dolfin_elastic.results.scene.drawn_field import DrawnField

COMM = MPI.COMM_WORLD
PLY = {
    "along": {"tension": 30.0, "compression": 45.0},
    "across": {"tension": 42.0, "compression": 60.0},
    "shear": 25.0,
}
H = 1e-3 * np.array([[2.0, 1.5, 0.3], [0.5, -3.0, 0.8], [0.1, 0.4, 1.0]])
ROUND_OFF = 1e-9


def solved(laws: Any, gradient: Any, degree: int = 1) -> tuple[Problem, State]:
    """A box of one or two materials in the state u = H X."""
    body = box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2))
    if isinstance(laws, dict):
        body = soft_and_hard(body, at=1.0)
    problem = Problem(body, laws, degree=degree)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: np.asarray(gradient) @ x)
    return problem, State(1, 1.0, u)


def hooke(law: Any, e: Any) -> Any:
    return law.lmbda * np.trace(e) * np.eye(3) + 2 * law.mu * e


def of_all(problem: Problem, state: State) -> tuple[float, float]:
    """Smallest and largest factor at all nodes, also from the pieces of a picture."""
    rows = Evaluator(problem, ["safety_factor"])(state)["safety_factor"]
    drawn = DrawnField(problem, "safety_factor")
    shown = drawn.shown(drawn.at_nodes(state))[: len(rows)]
    assert shown == pytest.approx(rows, rel=ROUND_OFF)
    return smallest(COMM, rows.min(initial=np.inf)), largest(COMM, rows.max(initial=-np.inf))


@pytest.mark.parametrize("criterion", ["tsai-hill", "hoffman", "largest-stress", "largest-strain"])
def test_same_factor_everywhere(criterion: str) -> None:
    """A constant stress, off the axis: field, probe, mean, peak and picture show the one factor."""
    scale = 0.01 if criterion == "largest-strain" else 1.0
    table: dict[str, Any] = {
        key: {name: scale * x for name, x in row.items()} if isinstance(row, dict) else scale * row
        for key, row in PLY.items()
    }
    law = LinearElastic(
        E=4e3, nu=0.3, allowable={**table, "criterion": criterion, "axis": [1, 2, 0.5]}
    )
    problem, state = solved(law, H)
    e = (H + H.T) / 2
    axis = np.array([1, 2, 0.5]) / np.linalg.norm([1, 2, 0.5])
    judged = e if criterion == "largest-strain" else hooke(law, e)
    assert law.allowable is not None
    assert not isinstance(law.allowable, float)
    factor = 1 / law.allowable.used_at(judged[None], axis)[0]
    assert of_all(problem, state) == pytest.approx((factor, factor), rel=ROUND_OFF)
    assert "safety_factor" in default_fields([law])
    assert "safety_factor" not in default_fields([LinearElastic(E=4e3, nu=0.3, allowable=30.0)])
    probe = Probe(problem, {"p": (0.7, 0.3, 0.6)}, ["safety_factor"])(state)
    assert probe["p_safety_factor"] == pytest.approx(factor, rel=ROUND_OFF)
    numbers = PartNumbers(problem, "region", None, ["safety_factor"], ["mean"])(state)
    assert numbers["safety_factor_mean"] == pytest.approx(factor, rel=1e-8)
    peaks = find_peaks(problem, ErrorEstimator(problem)(state))
    assert peaks.safety is not None
    assert peaks.safety.value == pytest.approx(factor, rel=ROUND_OFF)


def test_several_materials() -> None:
    """Each has its criterion; at the interface the smaller factor counts, with its material."""
    bone = {"criterion": "largest-strain", "tension": 0.0073, "compression": 0.0104}
    laws = {
        "soft": LinearElastic(E=1e3, nu=0.3, allowable=bone),
        "hard": LinearElastic(E=4e3, nu=0.3, allowable=10.0),
    }
    problem, state = solved(laws, H)
    e = (H + H.T) / 2
    low, _, high = np.linalg.eigvalsh(e)
    sigma = hooke(laws["hard"], e)
    deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
    factors = {
        "soft": 1 / max(high / 0.0073, -low / 0.0104),
        "hard": 10 / np.sqrt(1.5) / np.linalg.norm(deviator),
    }
    assert of_all(problem, state) == pytest.approx(
        (min(factors.values()), max(factors.values())), rel=ROUND_OFF
    )
    found = Quantity("safety_factor", None, "min").on(problem).of(state)
    assert found.value == pytest.approx(min(factors.values()), rel=ROUND_OFF)
    assert found.part == min(factors, key=lambda name: factors[name])


@pytest.mark.parametrize("criterion", ["tsai-hill", "largest-strain"])
def test_turned_with_the_body(criterion: str) -> None:
    """At finite strain a body that is stretched by U and turned by R has the factor of U alone, and
    the largest strain is the elongation.  A small-strain law keeps its axis.
    """
    scale = 0.01 if criterion == "largest-strain" else 1.0
    table = {k: {n: scale * x for n, x in r.items()} for k, r in PLY.items() if isinstance(r, dict)}
    allowable = {**table, "criterion": criterion, "axis": [0, 1, 1], "shear": 25 * scale}
    law = NeoHookean(E=100.0, nu=0.3, allowable=allowable)
    U = np.array([[1.3, 0.1, 0.0], [0.1, 0.9, 0.05], [0.0, 0.05, 1.1]])
    R = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    assert law.allowable is not None
    assert not isinstance(law.allowable, float)
    J = np.linalg.det(U)
    sigma = (law.mu * (U @ U - np.eye(3)) + law.lmbda * np.log(J) * np.eye(3)) / J
    judged = U - np.eye(3) if criterion == "largest-strain" else sigma
    factor = 1 / law.allowable.used_at(judged[None], np.array([0, 1, 1]) / np.sqrt(2))[0]
    for gradient in (U - np.eye(3), R @ U - np.eye(3)):
        assert of_all(*solved(law, gradient)) == pytest.approx((factor, factor), rel=ROUND_OFF)


def test_axis_of_the_law_that_turns_in_space() -> None:
    """Fibres at the angle x: the factor at x = 0 and x = 2 is that of the axis there.

    The axis is constant in linear elements and its mean is taken at nodes: to a few percent.
    """
    table = {**Orthotropic.example, "axis1": ["cos(x)", "sin(x)", 0], "axis2": [0, 0, 1]}
    same = {"E1": 100.0, "E2": 100.0, "E3": 100.0, "nu12": 0.0, "nu13": 0.0, "nu23": 0.0}
    G = dict.fromkeys(("G12", "G13", "G23"), 50.0)
    law = Orthotropic(**{**table, **same, **G, "allowable": PLY})  # isotropic in its stiffness
    problem, state = solved(law, np.diag([0.1, 0.0, 0.0]))
    low, high = of_all(problem, state)
    along, across = 30 / 10, 42 / 10  # sigma = 10 Pa along x
    assert low < along * 1.02
    assert across * 0.98 < high < across * 1.2  # beyond pi/2 and at 1 rad shear counts
    assert law.allowable is not None


def test_largest_strain_of_a_turned_bar_and_percentiles_of_its_bending() -> None:
    """e(z) = kappa z in a bar that is bent: percentiles and volumes above a value in closed form.

    u = kappa (x z, 0, -x^2/2 - nu...) with nu = 0; quadratic elements are exact.  The quadrature
    points of four layers of elements stand for the height: a sixteenth of it.
    """
    kappa = 0.02
    body = box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 4), origin=(0, 0, -0.5))
    problem = Problem(body, LinearElastic(E=100.0, nu=0.0), degree=2)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: kappa * np.array([x[0] * x[2], 0 * x[0], -(x[0] ** 2) / 2]))
    state = State(1, 1.0, u)
    names = ["percentile:95", "share_above:0.004", "size_above:0.004", "share_above:-1"]
    found = PartNumbers(problem, "region", None, ["max_principal_strain"], names)(state)
    # The largest principal strain is kappa z where that is positive, else 0.
    assert found["max_principal_strain_percentile_95"] == pytest.approx(0.45 * kappa, rel=0.03)
    assert found["max_principal_strain_share_above_0.004"] == pytest.approx(0.3, abs=0.02)
    assert found["max_principal_strain_volume_size_above_0.004"] == pytest.approx(
        2 * found["max_principal_strain_share_above_0.004"], rel=1e-12
    )
    assert found["max_principal_strain_share_above_-1"] == pytest.approx(1.0, rel=1e-12)
    top = PartNumbers(problem, "surface", "top", ["max_principal_strain"], ["share_above:0.009"])
    assert top(state)["max_principal_strain_share_above_0.009"] == pytest.approx(1, rel=1e-12)


def test_weak_tension_at_a_clamp_counts() -> None:
    """Beside a clamp the stress rises to the singular edge: there is no local maximum of tension.

    Compression at the far end is one, at less than its strength by a larger factor, as on the other
    side of a bent bracket: by the von Mises stress it would be the largest one elsewhere.
    """
    law = LinearElastic(
        E=4e3,
        nu=0.3,
        allowable={"criterion": "largest-stress", "tension": 10.0, "compression": 40.0},
    )
    body = box_body(size=(8.0, 1.0, 1.0), cells=(16, 2, 2))
    problem = Problem(body, law, supports=[Support(on="left")], degree=1)
    x, _, z = problem.places[: problem.V.dofmap.index_map.size_local].T
    values = np.where(z > 0.5, 1 - 0.1 * x, 0.6 * np.exp(-((x - 6) ** 2)))
    places = singular_places(problem)
    zero = np.zeros(len(values), dtype=np.int64)
    by_stress, by_strength = (
        PeakFinder(problem, places).pair(values, zero, lower=lower)[1]
        for lower in (LOWER, least_ratio(problem))
    )
    assert by_stress is not None
    assert by_strength is not None
    assert by_stress.value == pytest.approx(0.6, rel=ROUND_OFF)
    # Two cells of 0.5 away from the clamp, or one more where a cell's edge is longer.
    assert 0.8 < by_strength.value < 0.95
