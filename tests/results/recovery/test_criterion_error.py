"""The estimated error of a safety factor is that of its own criterion, not of the stress."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from mpi4py import MPI

from dolfin_elastic import Case, LinearElastic, Problem, Statics, box_body
from dolfin_elastic.core.parallel import largest, on_root
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import Peaks, find_peaks
from dolfin_elastic.results.verdict import verdict_of

COMM = MPI.COMM_WORLD
STRAIN = {"criterion": "largest-strain", "tension": 0.01, "compression": 0.01}
RING = """
SetFactory("OpenCASCADE");
Disk(1) = {0, 0, 0, 3}; Disk(2) = {0, 0, 0, 1}; Rectangle(3) = {0, 0, 0, 4, 4};
BooleanDifference(4) = { Surface{1}; Delete; }{ Surface{2}; Delete; };
BooleanIntersection(5) = { Surface{4}; Delete; }{ Surface{3}; Delete; };
Physical Surface("body") = {5};
Physical Curve("bore") = Curve In BoundingBox{-0.1, -0.1, -1, 1.1, 1.1, 1};
Physical Curve("foot") = Curve In BoundingBox{0.5, -0.1, -1, 4, 0.1, 1};
Physical Curve("side") = Curve In BoundingBox{-0.1, 0.5, -1, 0.1, 4, 1};
Mesh.MeshSizeMax = %g; Mesh.MeshSizeMin = %g;
"""
E, NU, INNER, OUTER, PRESSURE = 1e3, 0.3, 1.0, 3.0, 3.0


def ring(folder: Path, size: float, degree: int) -> Peaks:
    """A quarter of a thick tube under inner pressure, in plane strain."""
    path = folder / "ring.geo"
    on_root(COMM, lambda: path.write_text(RING % (size, size)))
    case = Case.from_dict(
        {
            "mesh": {"file": str(path), "degree": degree, "curved": True},
            "materials": {"a": {"law": "linear-elastic", "E": E, "nu": NU, "allowable": STRAIN}},
            "support": [
                {"on": "foot", "displacement": ["free", 0]},
                {"on": "side", "displacement": [0, "free"]},
            ],
            "load": [{"kind": "pressure", "on": "bore", "value": PRESSURE}],
        }
    )
    problem = case.make_problem(case.read_body())
    *_, state = Statics(problem).steps()
    return find_peaks(problem, ErrorEstimator(problem)(state))


@pytest.mark.long
@pytest.mark.parametrize(("size", "degree"), [(0.7, 2), (0.5, 2), (0.4, 2), (0.2, 1)])
def test_effectivity_of_the_largest_strain(folder: Path, size: float, degree: int) -> None:
    """Lame: e_tt = (1 + nu)/E ((1 - 2 nu) C + C b^2/r^2), C = p a^2/(b^2 - a^2), at r = a.

    The limit of e_rr, which is -C b^2/r^2 + (1 - 2 nu) C of the same, is not reached.
    """
    C = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    used = (1 + NU) / E * C * ((1 - 2 * NU) + (OUTER / INNER) ** 2) / 0.01
    peaks = ring(folder, size, degree)
    peak = peaks.safety
    assert peak is not None
    off = abs(used * peak.value - 1)
    assert 0.5 < peak.error / off < 3
    assert peak.surface == "bore"


def stretched(laws: Any, along: Any, degree: int = 2) -> tuple[Problem, State]:
    """A bar of one or two materials in the state u_x = along(x), u_y = u_z = 0."""
    body = box_body(size=(2.0, 1.0, 1.0), cells=(4, 2, 2))
    if isinstance(laws, dict):
        body = soft_and_hard(body, at=1.0)
    problem = Problem(body, laws, degree=degree)
    u = fem.Function(problem.V)
    u.interpolate(lambda x: np.array([along(x[0]), 0 * x[0], 0 * x[0]]))
    return problem, State(1, 1.0, u)


@pytest.mark.parametrize("degree", [1, 2])
def test_no_error_where_materials_meet(degree: int) -> None:
    """A bar of two materials in a row, E = 10 and 1000: exact, and the strain jumps 100 times.

    The error of a recovery, or of a raw value, across the interface would be of the size of it.
    """
    laws = {
        name: LinearElastic(E=modulus, nu=0.0, allowable=STRAIN)
        for name, modulus in (("soft", 10.0), ("hard", 1e3))
    }
    soft, hard = 0.005, 0.00005  # the stress is 0.05 Pa in both

    def along(x: Any) -> Any:
        return np.minimum(x, 1.0) * soft + np.maximum(x - 1.0, 0.0) * hard

    problem, state = stretched(laws, along, degree)
    estimate = ErrorEstimator(problem)(state)
    worst = [float(e.max(initial=0.0)) for e in (estimate.safety_error, estimate.stress_error)]
    assert max(largest(COMM, e) for e in worst) < 1e-10  # round-off
    x = problem.places[: len(estimate.stress.safety), 0]
    factors = np.where(x < 1 + 1e-6, 0.01 / soft, 0.01 / hard)
    np.testing.assert_allclose(estimate.stress.safety, factors, rtol=1e-9)


def test_stiffness_that_varies_is_no_error_of_strain() -> None:
    """A bar stretched evenly, stiff inside and a hundredth as stiff at a side, as bone with a skin.

    The strain is exact; the stress, which varies as E does, has the error of its recovery: that was
    told of the strain.
    """
    law = LinearElastic(E="10 + 990*exp(-40*(z - 0.5)^2)", nu=0.0, allowable=STRAIN)
    problem, state = stretched(law, lambda x: 0.004 * x)
    estimate = ErrorEstimator(problem)(state)
    peaks = find_peaks(problem, estimate)
    assert peaks.largest.error > 0.05
    assert peaks.safety is not None
    assert peaks.safety.value == pytest.approx(2.5, rel=1e-9)
    assert peaks.safety.error < 1e-9  # round-off
    lines = peaks.lines(estimate.relative)
    above = next(i for i, line in enumerate(lines) if line.startswith("smallest safety factor"))
    assert lines[above + 1].startswith("  estimated error ")


def test_an_error_of_compression_is_none_of_weak_tension() -> None:
    """u = -x^2: linear elements have an error of compression; tension is 100 times as weak.

    By the weak tension the error would be many times the utilisation.
    """
    table = {"criterion": "largest-strain", "tension": 0.0001, "compression": 0.01}
    law = LinearElastic(E=10.0, nu=0.0, allowable=table)
    problem, state = stretched(law, lambda x: -0.002 * (x + x**2), 1)
    found = find_peaks(problem, ErrorEstimator(problem)(state)).safety
    assert found is not None
    # The strain is -0.002 (1 + 2 x); in the cells, 0.5 long, that of their middle.  With tension's
    # limit the error would be 100 times as large: 25.
    assert found.value == pytest.approx(1.0, abs=0.01)
    assert 0.01 < found.error < 0.3


def test_the_verdict_names_the_strain_of_a_renamed_material() -> None:
    """A mesh with a region of the material's name: the verdict told of an allowable stress."""
    peak = {"value": 2.0, "error": 0.4, "part": "bone (material)", "place": [0.0, 0.0, 0.0]}
    summary: dict[str, Any] = {
        "status": "completed",
        "steps": 1,
        "load_factor": 1.0,
        "error": {"safety_factor": peak, "may_be_larger": {"unresolved": "of the stress"}},
        "case": {"materials": {"bone": {"allowable": STRAIN}}},
    }
    summary["error"]["safety_factor_may_be_smaller"] = None
    verdict = verdict_of(summary)
    assert verdict is not None
    start = "not known: strain 2 times below the largest strain limit"
    assert verdict.text.startswith(start)
    assert "known to 40 % only" in verdict.text  # not the stress's unresolved place
