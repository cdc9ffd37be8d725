"""Explicit steps of a material that relaxes: what they leave out changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem

from dolfin_elastic import (
    J2,
    LinearElastic,
    NeoHookean,
    NeoHookeanSplit,
    Problem,
    Selector,
    Support,
    box_body,
    name_parts,
)
from dolfin_elastic.core.jit import cell_integrals
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.viscous import Relaxation
from dolfin_elastic.problem.history.fused import FusedSteps
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import CentralDifferences

SERIES = [{"ratio": 0.5, "time": 2e-3}, {"ratio": 0.3, "time": 1e-4}]
LAWS = [LinearElastic, NeoHookeanSplit]


@pytest.mark.parametrize("kind", LAWS)
def test_the_past_of_many_points(kind: Any) -> None:
    """In place and in parts it is what the formulas give for all at once, to the last digits."""
    law = kind(E=1e6, nu=0.3, viscous=SERIES)
    memory, random, dt = Relaxation(law), np.random.default_rng(1), 3e-4
    values = {v.name: random.normal(size=(5000, v.size)) for v in memory.variables}
    found = {v.name: random.normal(size=(5000, v.size)) for v in memory.found}
    old = {name: array.copy() for name, array in values.items()}
    x = dt / np.array([term["time"] for term in SERIES])
    e, f, w = np.exp(-x), -np.expm1(-x) / x, np.array([term["ratio"] for term in SERIES])

    def folded(of: dict[str, FloatArray]) -> FloatArray:
        return sum(w[i] * (e[i] * of[f"h{i + 1}"] - f[i] * of["S"]) for i in range(2))

    assert memory.fold(values, dt)["H"] == pytest.approx(folded(old), rel=1e-12, abs=1e-14)
    new = dict(memory.follow(values, found, dt))
    for i in range(2):
        h = e[i] * old[f"h{i + 1}"] + f[i] * (found["S"] - old["S"])
        assert new[f"h{i + 1}"] == pytest.approx(h, rel=1e-12, abs=1e-14)
    assert np.array_equal(new["S"], found["S"])
    assert memory.fold(new, dt)["H"] == pytest.approx(folded(new), rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("kind", LAWS)
def test_the_law_of_the_next_step_has_the_same_forces(kind: Any) -> None:
    """At the end of a step the laws of the next one have its stress.

    Twenty steps, each with forces to round-off; other displacements have other forces.
    """
    body = box_body(size=(1, 1, 1), cells=(3, 2, 2))
    law = kind(E=1e6, nu=0.3, density=1000, viscous=SERIES)
    problem = Problem(body, law, degree=1)
    v = fem.Function(problem.V)
    v.interpolate(lambda x: 30 * np.array([x[0] * x[1], -x[1] * x[2], x[2] * x[0]]))
    march = Explicit(problem, v, CentralDifferences, end=1.0, dt=None, safety=0.9)
    scheme = march.scheme
    next(march.run())
    for _ in range(20):
        scheme.advance(scheme.dt)
        forces = scheme.out_of_balance.copy()
        scheme.assemble_forces()
        size = np.abs(forces).max(initial=1.0)
        assert np.abs(scheme.out_of_balance - forces).max(initial=0.0) < 1e-13 * size
    problem.u.x.array[:] *= 1.01
    scheme.assemble_forces()
    assert np.abs(scheme.out_of_balance - forces).max(initial=1.0) > 1e-4 * size
    march.destroy()


@pytest.mark.long
@pytest.mark.parametrize("many", [False, True], ids=["few", "many"])
@pytest.mark.parametrize(
    "law",
    [
        LinearElastic(E=1e6, nu=0.3, density=1000, viscous=SERIES),
        NeoHookeanSplit(E=1e6, nu=0.3, density=1000, viscous=SERIES),
        NeoHookean(E=1e6, nu=0.3, density=1000, viscous=SERIES),
        J2(E=1e6, nu=0.3, density=1000, yield_stress=1e4, hardening=1e5),
    ],
    ids=["linear", "split", "whole", "j2"],
)
def test_one_loop_for_forces_and_history(law: Any, many: bool, monkeypatch: Any) -> None:
    """Forces, history and energies of steps in one loop are those of separate evaluations.

    Cells of another material stand beside.  Differences are of the order of sums, 1e-12 at most.
    """
    if many:
        monkeypatch.setattr(cell_integrals, "MANY_CELLS", 0)
    found = []
    for fits in (FusedSteps.fits, lambda *_: False):
        monkeypatch.setattr(FusedSteps, "fits", staticmethod(fits))
        body = box_body(size=(1, 1, 1), cells=(4, 3, 2))
        halves = {
            "near": Selector(box=((0, 0, 0), (0.5, 1, 1))),
            "far": Selector(box=((0.5, 0, 0), (1, 1, 1))),
        }
        body = name_parts(body, regions=halves)
        laws = {"near": law, "far": NeoHookean(E=2e6, nu=0.3, density=500)}
        problem = Problem(body, laws, supports=[Support(on="left")], degree=1)
        v = fem.Function(problem.V)
        v.interpolate(lambda x: np.array([x[0] * x[1], -x[1] * x[2], x[2] * x[0]]))
        march = Explicit(problem, v, CentralDifferences, end=0.05, dt=None, safety=0.7, every=9)
        *_, state = march.run()
        history = problem.history
        assert history is not None
        assert (history.fused is not None) == (not found)
        remembered = {name: field.x.array for name, field in history.fields().items()}
        found.append((state.energies, {"u": problem.u.x.array.copy(), **remembered}))
        march.destroy()
    (energies, fields), (other_energies, others) = found
    assert energies == pytest.approx(other_energies, rel=1e-12)
    for name, values in others.items():
        size = np.abs(values).max(initial=0.0)
        assert fields[name] == pytest.approx(values, rel=1e-12, abs=1e-12 * size)
