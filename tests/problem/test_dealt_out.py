"""Problems on cells that are dealt out to the ranks, see `helpers/dealt_out.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.bodies import soft_and_hard
from helpers.dealt_out import deal_out, rows_at, same_on_any_ranks
from helpers.stacked import stacked
from mpi4py import MPI

from dolfin_elastic import (
    Contact,
    LinearElastic,
    NeoHookean,
    Normal,
    Periodic,
    Pressure,
    Problem,
    Statics,
    Support,
    Tie,
    Traction,
    box_body,
)
from dolfin_elastic.core.parallel import total
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.pressure.graded import _step
from dolfin_elastic.problem.terms.pressure_symmetry import boundary_edges

RUBBER, STEEL = NeoHookean(mu=80.0, lmbda=120.0), LinearElastic(E=1e3, nu=0.3)


@pytest.fixture(autouse=True)
def _dealt_out(monkeypatch: pytest.MonkeyPatch) -> None:
    deal_out(monkeypatch)


def block(comm: MPI.Comm) -> Any:
    return soft_and_hard(box_body(size=(2, 1, 1), cells=(4, 3, 2), comm=comm), at=1.0)


def wavy(body: Any) -> Any:
    """So that the normals of a side are those of several facets each."""
    x = body.mesh.geometry.x
    x[:, 2] += 0.1 * x[:, 2] * np.sin(2 * x[:, 0] + x[:, 1])
    return body


def solved(problem: Problem) -> Any:
    """The displacement of all nodes at the end, ghosts too, and the reactions."""
    *_, state = Statics(problem, steps=2, rtol=1e-12).steps()
    u = state.u.x.array.reshape(-1, 3)
    own = problem.V.dofmap.index_map.size_local
    everywhere = rows_at(problem.body.comm, problem.places, u)
    twice = (everywhere[1:, :3] == everywhere[:-1, :3]).all(axis=1)
    assert np.abs(np.diff(everywhere[:, 3:], axis=0)[twice]).max(initial=0.0) < 1e-12, "ghosts"
    forces = [f for _, force in sorted(state.reactions.items()) for f in force]
    table = rows_at(problem.body.comm, problem.places[:own], u[:own])
    return np.concatenate([table.ravel(), forces])


CASES: dict[str, Any] = {
    "pressures": lambda comm: Problem(
        block(comm),
        {"soft": NeoHookean(mu=80.0, K=8e5), "hard": NeoHookean(mu=800.0, K=8e6)},
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1.0, 2.0, 0.0])],
        degree=2,
        formulation="mixed",
    ),
    "rollers": lambda comm: Problem(
        wavy(block(comm)),
        {"soft": RUBBER, "hard": NeoHookean(mu="80*(1 + x)", lmbda=120.0)},
        supports=[Normal(on="top"), Support(on="left", displacement=[0, 0, "free"])],
        loads=[Pressure(on="right", value=5.0)],
        degree=2,
    ),
    "ties": lambda comm: Problem(
        stacked((1.0, 0.8, 0.6), (3, 2, 2), (4, 3, 2), comm=comm),
        STEEL,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[5.0, 1.0, 2.0])],
        ties=[Tie(on="above", to="below")],
        degree=1,
    ),
    "contact": lambda comm: Problem(
        block(comm),
        {"soft": RUBBER, "hard": STEEL},
        supports=[Support(on="top", displacement=[0, 0, -0.05])],
        contacts=[Contact(on="bottom", plane={"axis": "z", "at": -0.01}, name="floor")],
        degree=1,
    ),
    "periodic": lambda comm: Problem(
        block(comm),
        {"soft": RUBBER, "hard": STEEL},
        periodic=Periodic(
            pairs=[["left", "right"], ["front", "back"], ["bottom", "top"]],
            gradient=[[1.1, 0.1, 0], [0, 0.9, 0], [0, 0.1, 1]],
        ),
        degree=1,
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_statics(name: str) -> None:
    """Displacements and reactions to the tolerance of the solver."""
    same_on_any_ranks(lambda comm: solved(CASES[name](comm)), rtol=1e-7, atol=1e-8)


def test_parts_and_bodies() -> None:
    """Edges of a surface, steps between neighbours, and bodies that hang together."""

    def found(comm: MPI.Comm) -> Any:
        body = block(comm)
        edges = total(comm, len(boundary_edges(body, ["left", "top"])))
        middles = body.mesh.geometry.x[body.mesh.geometry.dofmap].mean(axis=1)
        values = np.exp(middles[:, 0] + 2 * middles[:, 1] ** 2 - middles[:, 2])
        step = _step(body, values, body.owned_cells())
        pair = Problem(stacked((1, 1, 1), (2, 2, 2), (2, 2, 2), gap=0.1, comm=comm), STEEL)
        return [edges, step, ConnectedBodies(pair).count]

    same_on_any_ranks(found)
