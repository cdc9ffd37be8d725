"""Results on cells that are dealt out to the ranks, see `helpers/dealt_out.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.bodies import soft_and_hard
from helpers.dealt_out import deal_out, rows_at, same_on_any_ranks
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    NeoHookean,
    Periodic,
    Problem,
    Support,
    box_body,
)
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.derived.part_numbers import members
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.grid import to_nodes
from dolfin_elastic.results.probes import Probe
from dolfin_elastic.results.recovery.error import ErrorEstimator
from dolfin_elastic.results.recovery.peaks import _local_maxima
from dolfin_elastic.results.recovery.singular import singular_places
from dolfin_elastic.results.recovery.stress import von_mises

SOFT, HARD = NeoHookean(mu=80.0, lmbda=120.0, allowable=50.0), NeoHookean(mu=800.0, lmbda=900.0)


@pytest.fixture(autouse=True)
def _dealt_out(monkeypatch: pytest.MonkeyPatch) -> None:
    deal_out(monkeypatch)


def problem_on(comm: MPI.Comm, degree: int, **more: Any) -> Problem:
    body = soft_and_hard(box_body(size=(2, 1, 1), cells=(4, 3, 3), comm=comm), at=1.0)
    return Problem(body, {"soft": SOFT, "hard": HARD}, degree=degree, **more)


def bent(problem: Problem) -> State:
    """Neither linear nor symmetric, so that no two cells are alike."""
    u = fem.Function(problem.V)
    u.interpolate(
        lambda x: (
            0.02 * np.array([np.sin(3 * x[0] + x[1]), x[0] * x[2] ** 2, np.cos(2 * x[1]) * x[0]])
        )
    )
    return State(1, 1.0, u)


@pytest.mark.parametrize("degree", [1, 2])
def test_probes(degree: int) -> None:
    """Of fields of cells and of recovered stresses, at nodes and between them."""

    def found(comm: MPI.Comm) -> Any:
        points = [(x, y, z) for x in (0.3, 0.5, 1.6) for y in (0.1, 2 / 3) for z in (0.2, 0.8)]
        problem = problem_on(comm, degree)
        probe = Probe(
            problem, {f"{x}": x for x in points}, ["jacobian", "von_mises", "cauchy_stress"]
        )
        return np.concatenate([*probe(bent(problem)).values()])

    same_on_any_ranks(found)


def test_members_of_regions() -> None:
    """Of an owned node's region all cells may be on other ranks."""

    def found(comm: MPI.Comm) -> Any:
        problem = problem_on(comm, 2)
        x = [problem.places[members(problem, "region", r, "node")] for r in ("soft", "hard")]
        return np.concatenate([rows_at(comm, each, np.zeros(len(each))) for each in x])

    same_on_any_ranks(found)


def test_fields() -> None:
    """Values at all nodes and cells, and of cells averaged at the nodes, ghosts too."""

    def found(comm: MPI.Comm) -> Any:
        problem = problem_on(comm, 2, supports=[Support(on="left")])
        state = bent(problem)
        values = Evaluator(problem, ["von_mises_nodal", "normal", "residual", "jacobian"])(state)
        nodes = problem.V.dofmap.index_map.size_local
        table = np.column_stack([values[n] for n in ("von_mises_nodal", "normal", "residual")])
        J = np.asarray(values["jacobian"], dtype=float).reshape(-1, 1)
        averaged = to_nodes(problem.V, J)
        means = rows_at(comm, problem.places, averaged)
        same = (means[1:, :3] == means[:-1, :3]).all(axis=1)
        assert np.ptp(means[:, 3]) > 0.1
        assert np.abs(np.diff(means[:, 3])[same]).max(initial=0.0) < 1e-12, "ghosts, too"
        own = rows_at(comm, problem.places[:nodes], averaged[:nodes])
        return np.hstack([rows_at(comm, problem.places[:nodes], table), own])

    same_on_any_ranks(found)


def test_errors_and_peaks() -> None:
    """The error of the recovered stress, and which nodes are larger than all around them."""

    def found(comm: MPI.Comm) -> Any:
        problem = problem_on(comm, 2)
        estimate = ErrorEstimator(problem)(bent(problem))
        errors = estimate.stress_error
        values = von_mises(estimate.stress.stress)
        maxima = _local_maxima(problem.V, values)
        peaks = rows_at(comm, problem.places[: len(maxima)][maxima], values[maxima])
        return np.concatenate([rows_at(comm, problem.places[: len(errors)], errors), peaks])

    same_on_any_ranks(found)


def test_singular_places() -> None:
    """Of an interface, the rim of a support and the edge of a contact, and the cells around."""

    def found(comm: MPI.Comm) -> Any:
        floor = Contact(on="bottom", plane={"axis": "z", "at": -1e-3})
        problem = problem_on(comm, 2, supports=[Support(on="left")], contacts=[floor])
        problem.u.interpolate(lambda x: np.array([0 * x[0], 0 * x[0], -2e-3 * (x[0] > 0.6)]))
        places = singular_places(problem)
        wide = places.widened(problem.V)
        marks = np.column_stack([places.near, wide]).astype(float)
        return rows_at(comm, problem.places[: len(marks)], marks)

    same_on_any_ranks(found)


def test_residual_of_a_periodic_cell() -> None:
    """Nodes of its faces may be unknowns of another rank."""

    def found(comm: MPI.Comm) -> Any:
        pairs = [["left", "right"], ["front", "back"], ["bottom", "top"]]
        cell = Periodic(pairs=pairs, gradient=[[1.1, 0.1, 0], [0, 0.9, 0], [0, 0.1, 1]])
        problem = problem_on(comm, 1, periodic=cell)
        problem.set_time(1.0)
        even = State(1, 1.0, problem.u, w=problem.w)  # without fluctuation
        forces = Evaluator(problem, ["residual"])(even)["residual"]
        return rows_at(comm, problem.places[: len(forces)], forces)

    same_on_any_ranks(found)
