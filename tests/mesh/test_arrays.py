"""Bodies of arrays, and fields that are set as arrays, on any number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    Energy,
    LinearElastic,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
    mesh_body,
)
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.fields import MeshField

COMM = MPI.COMM_WORLD
SIDE = np.linspace(0, 1, 5)
POINTS = np.stack(np.meshgrid(SIDE, SIDE, indexing="ij"), axis=-1).reshape(-1, 2)
CORNERS = np.arange(25).reshape(5, 5)
SQUARES = np.stack([CORNERS[:-1, :-1], CORNERS[1:, :-1], CORNERS[1:, 1:], CORNERS[:-1, 1:]])
CELLS = np.concatenate([SQUARES.reshape(4, -1).T[:, nodes] for nodes in ([0, 1, 2], [0, 2, 3])])


def square(**more: Any) -> Body:
    """A unit square in mm, with names."""
    x = POINTS[:, 0]
    sides = {"left": np.flatnonzero(x == 0), "right": np.flatnonzero(x == 1)}
    return mesh_body(POINTS, CELLS, nodes=sides, scale=1e-3, **more)


def middles(body: Body) -> np.ndarray:
    """x of the middle of each local cell [mm]."""
    return body.mesh.geometry.x[body.mesh.geometry.dofmap][:, :, 0].mean(axis=1) * 1e3


def test_a_mesh_made_by_hand() -> None:
    """It has the names of its parts, and pulled it is stretched as Hooke says."""
    middle = POINTS[CELLS][:, :, 0].mean(axis=1)
    body = square(regions={"soft": np.flatnonzero(middle < 0.5)}, fields={"x": middle})
    assert body.num_cells == 32 and body.count("left") == 4
    assert COMM.allreduce(len(body.owned_cells("soft"))) == 16
    np.testing.assert_allclose(body.fields["x"].values[:, 0], middles(body), atol=1e-12)
    problem = Problem(
        body,
        LinearElastic(E=1e6, nu=0.0),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[1e3, 0])],
    )
    *_, state = Statics(problem).steps()
    assert state.max_displacement == pytest.approx(1e-6, rel=1e-9)


@pytest.mark.parametrize("rows", ["owned", "all", "input"])
@pytest.mark.parametrize("centre", ["cell", "point"])
def test_fields_set_as_arrays(rows: str, centre: str) -> None:
    """In the order of the rank, without or with ghosts; or found by the order of the input."""
    body = square()
    mesh = body.mesh
    if centre == "cell":
        local, every = middles(body), POINTS[CELLS][:, :, 0].mean(axis=1)
        order, owned = mesh.topology.original_cell_index, len(body.owned_cells())
    else:
        local, every = mesh.geometry.x[:, 0] * 1e3, POINTS[:, 0]
        order, owned = mesh.geometry.input_global_indices, mesh.geometry.index_map().size_local
    given = {"owned": local[:owned], "all": local, "input": every[order]}[rows]
    body.fields["x"] = np.column_stack([given, 2 * given])
    field = body.mesh_field("x")
    assert field.centre == centre
    np.testing.assert_allclose(field.values, np.column_stack([local, 2 * local]), atol=1e-12)
    assert "x" in body.named(points={}).fields


def test_a_field_that_was_set_is_a_parameter() -> None:
    """Of an energy, as the field of a mesh file is; a number that does not vary gives the same."""
    body = square()

    def psi(E: Any, G: Any) -> Any:
        return G * sum(E[i, j] ** 2 for i in range(3) for j in range(3))

    body.fields["G"] = np.full(len(body.owned_cells()), 2.0)
    problems = [
        Problem(
            body,
            Energy(psi, G=G),
            supports=[Support(on="left")],
            loads=[Traction(on="right", value=[1e3, 0])],
        )
        for G in ({"field": "G", "unit": "MPa"}, 2e6)
    ]
    first, second = ([*Statics(p).steps()][-1].max_displacement for p in problems)
    assert first == pytest.approx(second, rel=1e-9)


def test_what_is_no_mesh() -> None:
    """Each fault on all ranks, with what was given."""
    with pytest.raises(MeshError, match=r"points of shape \(25, 2\) and cells of shape \(1, 4\)"):
        mesh_body(POINTS, [[0, 1, 2, 3]])
    with pytest.raises(MeshError, match=r"cells: .*whole numbers from 0 to 24"):
        mesh_body(POINTS, [[0, 1, 25]])
    with pytest.raises(MeshError, match=r"regions\.soft"):
        square(regions={"soft": [-1]})
    with pytest.raises(MeshError, match="'E' has 3 rows"):
        square(fields={"E": [1, 2, 3]})


def test_what_is_no_field() -> None:
    """Another number of rows on one rank is refused on all; so is one that fits twice."""
    body = square()
    count = len(body.owned_cells()) + (COMM.rank == COMM.size - 1) * 500
    with pytest.raises(MeshError, match="'f' has .* rows on this rank"):
        body.fields["f"] = np.zeros(count)
    with pytest.raises(MeshError, match="not a number"):
        body.fields["f"] = ["a"] * count
    single = mesh_body([[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [1, 3, 2]])
    assert single.num_cells == 2
    if COMM.size == 1:
        twice = box_body(size=[1, 1], cells=[1, 1])
        twice.fields["f"] = np.zeros(2)
        assert twice.fields["f"].centre == "cell"
    body.fields["f"] = MeshField("cell", np.zeros((len(middles(body)), 1)))
