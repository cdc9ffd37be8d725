"""A constant in each cell: derivatives against differences, known fields, penalties, what fails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Case, identify_field, read_case
from dolfin_elastic.core.errors import InputError, SolveError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.study.identify import cells as cells_module
from dolfin_elastic.study.identify.jumps import Jumps
from dolfin_elastic.study.identify.measured import MeasuredField
from dolfin_elastic.study.identify.points import LocatedPoints
from dolfin_elastic.study.identify.written_field import write_field

WORLD = MPI.COMM_WORLD
KEY = "materials.gel.E"
SIDE = np.linspace(0.05, 0.95, 10)
GRID = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)


def block(E: object = "1 kPa", law: str = "linear-elastic", **tables: Any) -> Case:
    """A square on its foot that is pressed and sheared from above."""
    return Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [1, 1], "cells": [6, 6]}},
            "materials": {"gel": {"law": law, "E": E, "nu": 0.4}},
            "support": [{"on": "bottom"}],
            "load": [{"kind": "traction", "on": "top", "value": ["5 Pa", "-20 Pa"]}],
            **tables,
        }
    )


def displaced(case: Case) -> MeasuredField:
    """What points of a case move by."""
    body = case.read_body()
    *_, state = case.make_solver(case.make_problem(body)).steps()
    values = LocatedPoints(body, GRID).displacements(state.u)
    n = len(GRID)
    return MeasuredField(GRID, values, (0, 1), np.full(n, np.nan), tuple(range(n)))


def places(body: Body) -> np.ndarray:
    """Midpoints of owned cells."""
    mesh = body.mesh
    return mesh.geometry.x[mesh.geometry.dofmap[: len(body.owned_cells())], :2].mean(axis=1)


@pytest.mark.parametrize("law", ["linear-elastic", "neo-hookean"])
def test_slopes_of_the_misfit_are_those_of_differences(law: str) -> None:
    """Central differences of fourth order along a random field."""
    sets = [displaced(block("where(x < 0.5, 1000, 2000)", law))]
    search = cells_module._Search(
        block(law=law), KEY, sets, "tv", (0.0, np.inf), None, WORLD, lambda _: None
    )
    x, y = places(search.body).T
    m, along = 0.3 * np.sin(5 * x + 3 * y), np.cos(7 * x - 2 * y)
    slope = total(WORLD, float(search.at(m).slopes @ along))
    h = 1e-2
    values = {k: search.at(m + k * h * along).value for k in (-2, -1, 1, 2)}
    exact = (values[-2] - 8 * values[-1] + 8 * values[1] - values[2]) / (12 * h)
    assert slope == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("kind", ["tv", "tikhonov"])
def test_penalties_and_their_slopes(kind: Any) -> None:
    """Slopes by differences; a step across the square has the length of its edge."""
    case = block(mesh={"rectangle": {"size": [2, 2], "cells": [8, 8]}})
    body = case.read_body()
    x, y = places(body).T
    jumps = Jumps(body, np.ones(len(x), dtype=bool), kind)
    assert jumps.value(np.full(len(x), 3.0))[0] == pytest.approx(0.0, abs=1e-12)
    field, along, h = np.sin(2 * x + y), np.cos(3 * x), 1e-6
    slope = total(WORLD, float(jumps.value(field)[1] @ along))
    ends = [jumps.value(field + k * h * along)[0] for k in (-1, 1)]
    assert slope == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-7)
    value = jumps.value(np.where(x < 1.0, 0.0, 5.0))[0]
    if kind == "tv":  # 2 m long, over the root of 4 m^2; a hundredth less is the rounding
        assert value == pytest.approx(5.0, abs=0.0101)
    else:  # 2 m over the distance of two midpoints: thirds of the sides of 0.25 m, along x and y
        apart = np.array([2, 1]) * 0.25 / 3
        assert value == pytest.approx(25.0 * 2 / np.linalg.norm(apart), rel=1e-9)


@pytest.mark.long
def test_a_known_field_comes_back() -> None:
    """Halves of 1 and 3 kPa, of the mesh's own displacements: to 3 % (1.1 % were seen)."""
    field = displaced(block("where(y < 0.5, 1000, 3000)"))
    found = identify_field(block("2 kPa"), field, KEY, weight=1e-5)
    y = places(found.problem.body)[:, 1]
    assert found.values == pytest.approx(np.where(y < 0.5, 1e3, 3e3), rel=0.03)
    assert found.rms < 1e-3 * np.abs(field.values).max()
    assert found.penalty[1] == pytest.approx(np.log(3), rel=0.05)  # one edge of one metre


@pytest.mark.long
@pytest.mark.parametrize("penalty", ["tv", "tikhonov"])
def test_the_weight_follows_from_the_scatter(penalty: str) -> None:
    """The differences are as large as it, and the field is not far off."""
    field = displaced(block("where(y < 0.5, 1000, 3000)"))
    noise = 0.01 * float(np.abs(field.values).max())
    scatter = noise * np.random.default_rng(2).normal(size=field.values.shape)
    field = replace(field, values=field.values + scatter)
    found = identify_field(block("2 kPa"), field, KEY, noise=noise, penalty=penalty)
    assert found.ended
    assert 0.9 * noise < found.rms <= 1.1 * noise
    y = places(found.problem.body)[:, 1]
    off = np.abs(np.log(found.values / np.where(y < 0.5, 1e3, 3e3)))
    mean = total(WORLD, float(off.sum())) / total(WORLD, len(off))
    assert mean < (0.15 if penalty == "tv" else 0.35)


@pytest.mark.long
def test_only_the_cells_of_its_material_change() -> None:
    """And with a bound none is beyond it."""
    two = {
        "regions": {"low": {"box": [[-1, -1], [2, 0.5]]}, "high": {"box": [[-1, 0.5], [2, 2]]}},
        "materials": {
            "gel": {"law": "linear-elastic", "E": "2 kPa", "nu": 0.4, "on": "high"},
            "foot": {"law": "linear-elastic", "E": "1 kPa", "nu": 0.4, "on": "low"},
        },
    }
    field = displaced(block("where(y < 0.5, 1000, 3000)"))
    found = identify_field(block(**two), field, KEY, weight=1e-5)
    y = places(found.problem.body)[:, 1]
    assert np.array_equal(found.chosen, y > 0.5)
    assert np.isnan(found.values[y < 0.5]).all()
    assert found.values[y > 0.5] == pytest.approx(3000, rel=0.03)
    bound = identify_field(block(**two), field, KEY, weight=1e-4, bounds=(0.0, 2500.0))
    assert (bound.values[y > 0.5] <= 2500 * (1 + 1e-12)).all()
    above = GRID[:, 1] > 0.5
    assert np.array_equal(np.isnan(found.seen[0]), ~above)


@pytest.mark.long
def test_fields_without_a_solution_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line search goes back, and the best field is kept; other errors come through."""
    field = displaced(block("where(y < 0.5, 1000, 1500)"))
    whole, failed = cells_module._Search.at, list[float]()

    def at(self: Any, m: np.ndarray) -> Any:
        if WORLD.allreduce(float(np.abs(m).max(initial=0.0)), op=MPI.MAX) > 0.1:
            failed.append(1.0)
            raise SolveError("nothing holds")
        return whole(self, m)

    monkeypatch.setattr(cells_module._Search, "at", at)
    found = identify_field(block("1 kPa"), field, KEY, weight=1e-5)
    assert failed
    assert not found.ended
    assert found.why == "beyond the best field there is no solution"
    start = np.abs(np.log(found.values / 1e3)).max(initial=0.0)
    assert 0.0 < WORLD.allreduce(float(start), op=MPI.MAX) <= 0.1

    def broken(self: Any, m: np.ndarray) -> Any:
        if m.any():
            raise RuntimeError("a fault")
        return whole(self, m)

    monkeypatch.setattr(cells_module._Search, "at", broken)
    with pytest.raises(RuntimeError, match="a fault"):
        identify_field(block("1 kPa"), field, KEY, weight=1e-6)


@pytest.mark.long
def test_the_case_that_is_written_has_the_field(tmp_path: Path) -> None:
    folder = on_root(WORLD, lambda: tmp_path)
    field = displaced(block("where(y < 0.5, 1000, 3000)"))
    found = identify_field(block("2 kPa"), field, KEY, weight=1e-5)
    names = write_field(found, folder)
    assert names == ["case.toml", "case_field.xdmf", "case_points.csv", "case.png"]
    again = displaced(read_case(folder / "case.toml"))
    assert again.values == pytest.approx(found.sets[0].computed, rel=1e-6, abs=1e-9)
    head, row = on_root(WORLD, (folder / "case_points.csv").read_text).splitlines()[:2]
    assert head.endswith("measured,computed,E")
    assert float(row.split(",")[-1]) == pytest.approx(found.seen[0][0], rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, ("one of --noise and --smooth",)),
        ({"noise": 1.0, "weight": 1.0}, ("one of --noise and --smooth",)),
        ({"weight": -1.0}, ("-1 is wrong", "--smooth")),
        ({"weight": 1.0, "penalty": "tw"}, ("no penalty 'tw'", "tv")),
        ({"weight": 1.0, "bounds": (1.0, 2.0)}, ("outside of its bounds", "--bounds")),
        ({"weight": 1.0, "key": "materials.gel.F"}, ("'F'",)),
        ({"weight": 1.0, "key": "load[0].value[0]"}, ("no number of a material", "--field")),
        ({"weight": 1.0, "key": "materials.gel.law"}, ("no number of a material",)),
    ],
)
def test_what_is_refused(keys: dict[str, Any], words: tuple[str, ...]) -> None:
    n = len(GRID)
    field = MeasuredField(GRID, np.ones((n, 2)), (0, 1), np.full(n, np.nan), tuple(range(n)))
    with pytest.raises(InputError) as caught:
        identify_field(block(), field, keys.pop("key", KEY), **keys)
    for word in words:
        assert word in str(caught.value)
    with pytest.raises(InputError, match="no column t"):
        identify_field(block(), replace(field, times=np.ones(n)), KEY, weight=1.0)
