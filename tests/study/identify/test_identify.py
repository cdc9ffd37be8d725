"""Values of a case from curves and displacement fields: known truth, scatter, the fit of a law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dolfin_elastic import Case, fit, identify
from dolfin_elastic.core.errors import InputError, SolveError
from dolfin_elastic.study.identify import runs as runs_module
from dolfin_elastic.study.identify.measured import Measured, MeasuredCurve, MeasuredField, Number
from dolfin_elastic.study.identify.runs import Runs
from dolfin_elastic.study.identify.unknowns import read_unknowns

MU, K, E = "materials.rubber.mu", "materials.rubber.K", "materials.steel.E"
EXACT = 1e-7
"""Of constants from exact data: runs leave 1e-8 of the forces in the residual."""


def plate(mu: object = "0.4 MPa", bulk: object = "2 MPa", **tables: Any) -> Case:
    """A plate that is clamped on both sides and pulled by a quarter: not homogeneous."""
    return Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [2, 1], "cells": [4, 2]}},
            "materials": {"rubber": {"law": "neo-hookean", "mu": mu, "K": bulk}},
            "support": [
                {"on": "left"},
                {"on": "right", "name": "right", "displacement": [0.5, 0]},
            ],
            **tables,
        }
    )


def bar(**steel: object) -> Case:
    """A linear bar that is pulled by 1 kPa, held at its left end in all directions."""
    return Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [2, 1], "cells": [4, 2]}},
            "materials": {"steel": {"law": "linear-elastic", "E": "1 MPa", "nu": 0.3, **steel}},
            "support": [{"on": "left"}],
            "load": [{"kind": "traction", "on": "right", "value": ["1 kPa", "0.2 kPa"]}],
        }
    )


FORCE = MeasuredCurve(
    Number.read("t"), Number.read("reaction_x of right"), np.linspace(0.2, 1, 5), np.ones(5)
)
GRID = np.stack(np.meshgrid([0.3, 0.9, 1.6], [0.2, 0.5, 0.9]), axis=-1).reshape(-1, 2)
FIELD = MeasuredField(GRID, np.ones((9, 2)), (0, 1), np.full(9, np.nan), tuple(range(9)))


def computed(case: Case, sets: list[Measured], keys: list[str]) -> list[Any]:
    """The same sets with what a case gives."""
    unknowns = read_unknowns(case, keys, {})
    runs = Runs(case, unknowns, sets)
    values = np.array([one.constant.start for one in unknowns])
    runs.plan(values)
    found = runs.by_set(runs.compared(values))
    return [replace(one, values=v) for one, v in zip(sets, found, strict=True)]


@pytest.mark.long
def test_constants_come_back_from_a_curve_and_a_field() -> None:
    """At the end and halfway, from values that are off by a factor of two."""
    half = replace(FIELD, times=np.full(9, 0.5), components=(0,), values=np.ones((9, 1)))
    sets = computed(plate(), [FORCE, FIELD, half], [MU, K])
    found = identify(plate("0.8 MPa", "1 MPa"), sets, [MU, K])
    assert found.ended
    assert [found[MU].value, found[K].value] == pytest.approx([0.4, 2.0], rel=EXACT)
    assert max(one.relative for one in found.sets) < EXACT
    again = identify(found.case, sets, [MU, K])  # it has the values that were found
    assert again[MU].value == pytest.approx(0.4, rel=EXACT)


MIXED = {"mesh": {"rectangle": {"size": [2, 1], "cells": [4, 2]}, "formulation": "mixed"}}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("reaction_x of right", {}),
        ("-2*reaction_right_x", {}),
        ("mid_x", {}),
        ("mid_y", {}),
        ("reaction_x of right", MIXED),
    ],
)
@pytest.mark.sample(2)
def test_derivatives_without_differences_are_those_of_differences(
    name: str, more: dict[str, Any]
) -> None:
    """Of curves over t and over a number that changes with the constants, and of fields."""
    case = plate(output={"probes": {"mid": [0.6, 0.3]}}, **more)
    over = [("t", 0.9), *([("-1*reaction_left_x", 1e5)] if name == "mid_y" else [])]
    half = replace(FIELD, times=np.full(9, 0.5), components=(1,), values=np.ones((9, 1)))
    curves = [
        replace(FORCE, x=Number.read(x), at=FORCE.at * most, y=Number.read(name))
        for x, most in over
    ]
    unknowns = read_unknowns(case, [MU, K], {})
    runs = Runs(case, unknowns, [*curves, FIELD, half])
    values = np.array([0.4, 2.0])
    runs.plan(values)
    ends = values, np.zeros(2), np.full(2, np.inf)
    count = runs.count
    numbers, slopes = runs.jacobian(values, *ends)
    assert runs.count == count + 1
    runs._direct = False
    same, differences = runs.jacobian(values, *ends)
    assert numbers == pytest.approx(same, rel=1e-9, abs=1e-12)
    size = np.abs(differences).max(axis=0)
    # Of the differences by 1e-3 of the value, whose square is their error.
    assert slopes / size == pytest.approx(differences / size, abs=2e-5)


def test_what_has_no_such_derivatives_has_differences() -> None:
    """A largest stress, and a load."""
    case = plate(load=[{"kind": "traction", "on": "top", "value": [0, "1 kPa"]}])
    stress = replace(FORCE, y=Number.read("von_mises on left"))
    for curve, keys in ((stress, [MU]), (FORCE, ["load[0].value[1]"])):
        unknowns = read_unknowns(case, keys, {})
        runs = Runs(case, unknowns, [curve])
        one = np.array([unknowns[0].constant.start])
        _, slopes = runs.jacobian(one, one, np.zeros(1), np.full(1, np.inf))
        assert runs.count == 3
        assert np.abs(slopes).max() > 0


@pytest.mark.long
def test_a_homogeneous_case_gives_what_the_fit_of_the_law_gives() -> None:
    """Also the same interval from curves with scatter: both are the least squares of one curve."""
    square = {"kind": "symmetry"}
    case = Case.from_dict(
        {
            "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
            "materials": {"rubber": {"law": "neo-hookean", "mu": "1 MPa", "K": "2 MPa"}},
            "support": [
                {"on": "left", **square},
                {"on": "front", **square},
                {"on": "bottom", **square},
                {"on": "right", "name": "right", "displacement": [0.5, "free", "free"]},
            ],
        }
    )
    draw = np.random.default_rng(3)
    stretch = 1 + 0.5 * FORCE.at
    stress = 0.4e6 * (stretch - stretch**-2) + 1e3 * draw.normal(size=5)
    law = fit(
        {"law": "neo-hookean", "mu": "1 MPa", "K": "2 MPa"},
        {"uniaxial": (stretch, stress)},
        fix=["K"],
    )
    found = identify(case, replace(FORCE, values=stress), [MU])
    assert 1e6 * found[MU].value == pytest.approx(law["mu"].value, rel=1e-6)
    assert 1e6 * found[MU].half == pytest.approx(law["mu"].half, rel=1e-4)


@pytest.mark.long
def test_intervals_hold_the_truth() -> None:
    """Of 95 %: in 12 draws at least 10 (binomial: 1 % of such tests would have fewer)."""
    points = np.random.default_rng(1).uniform([0.2, 0.0], [2.0, 1.0], (30, 2))
    field = MeasuredField(points, np.ones((30, 2)), (0, 1), np.full(30, np.nan), (0,) * 30)
    (exact,) = computed(bar(), [field], [E])
    size, hits = 0.05 * float(np.abs(exact.values).max()), 0
    for seed in range(12):
        scatter = size * np.random.default_rng(seed).normal(size=(30, 2))
        found = identify(bar(), replace(exact, values=exact.values + scatter), [E])
        low, high = found[E].interval
        hits += low <= 1.0 <= high
    assert hits >= 10


def test_a_curve_over_a_number_that_depends_on_the_constants() -> None:
    """The load is prescribed, and the displacement that it causes is what the curve is over."""
    probe = {"output": {"probes": {"tip": [2, 0.5]}}}
    case = bar().changed({"output": probe["output"]})
    unknowns = read_unknowns(case, [E], {})
    at = np.array([2e-4, 6e-4, 1e-3])
    curve = MeasuredCurve(Number.read("tip_x"), Number.read("-1e-3*reaction_x of left"), at, at)
    curve = replace(curve, values=at * 1e3)
    runs = Runs(case, unknowns, [curve])
    runs.plan(np.array([1.0]))
    (force,) = runs.by_set(runs.compared(np.array([1.0])))
    assert np.diff(force / at) == pytest.approx([0, 0], abs=1e-6 * force[0] / at[0])  # linear
    found = identify(case.changed({E: "0.6 MPa"}), replace(curve, values=force), [E])
    assert found[E].value == pytest.approx(1.0, rel=EXACT)
    far = replace(curve, at=1e3 * at)
    with pytest.raises(SolveError, match="tip_x runs from 0 m to"):
        identify(case, far, [E])


def test_two_constants_that_one_curve_cannot_tell() -> None:
    """A force over the load alone, in a linear case, knows neither."""
    case = bar().changed({"support": [{"on": "left", "name": "left"}]})
    curve = MeasuredCurve(Number.read("t"), Number.read("reaction_x of left"), FORCE.at, -FORCE.at)
    found = identify(case, replace(curve, values=-1e3 * FORCE.at), [E])
    assert found.unknown == ("materials.steel.E cannot be found from these measurements",)
    assert found[E].value == pytest.approx(1.0)


@pytest.mark.long
def test_all_runs_have_one_formulation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond nu = 0.45 no pressure joins in; the fit says so, and once more it begins with one."""
    nu, mixed, make = "materials.steel.nu", list[bool](), Case.make_problem

    def told(case: Case, body: Any) -> Any:
        problem = make(case, body)
        mixed.append(problem.mixed)
        return problem

    points = replace(FIELD, times=np.full(9, np.nan))
    (field,) = computed(bar(nu=0.47), [points], [nu])
    monkeypatch.setattr(Case, "make_problem", told)
    found = identify(bar(nu=0.44), field, [nu])
    assert 0.45 < found[nu].value < 0.5
    assert mixed == [*[False] * (len(mixed) - 1), True]  # the last one to look at the case found
    (note,) = [text for text in found.notes if "formulation" in text]
    assert "displacement; the case with the values found has mixed" in note
    mixed.clear()
    again = identify(found.case, field, [nu])
    assert all(mixed)
    assert again[nu].value == pytest.approx(0.47, rel=EXACT)
    assert not any("formulation" in text for text in again.notes)


def test_runs_that_fail_make_the_step_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first two steps have no solution; the search comes to the answer nevertheless."""
    (exact,) = computed(bar(), [FIELD], [E])
    whole, failed = runs_module.Runs.record, list[float]()

    def record(self: Runs, values: np.ndarray, *rest: Any, **keys: Any) -> Any:
        if values[0] != 1.5 and len(failed) < 2:
            failed.append(float(values[0]))
            raise SolveError("nothing holds")
        return whole(self, values, *rest, **keys)

    monkeypatch.setattr(runs_module.Runs, "record", record)
    found = identify(bar(E="1.5 MPa"), exact, [E])
    assert found.ended
    assert found[E].value == pytest.approx(1.0, rel=EXACT)
    assert 1.5 > failed[1] > failed[0]
    failed.clear()
    with pytest.raises(SolveError, match="nothing holds"):  # from the start
        identify(bar(E="0.5 MPa"), exact, [E])


def test_the_best_so_far_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that breaks off has what it has come to, and says so."""
    (exact,) = computed(bar(), [FIELD], [E])
    whole = runs_module.Runs.jacobian
    asked = list[float]()

    def jacobian(self: Runs, values: np.ndarray, *ends: np.ndarray) -> Any:
        asked.append(values[0])
        if len(asked) > 2:
            raise SolveError("nothing holds")
        return whole(self, values, *ends)

    monkeypatch.setattr(runs_module.Runs, "jacobian", jacobian)
    found = identify(bar(E="0.3 MPa"), exact, [E])
    assert not found.ended
    assert "nothing holds" in found.why
    assert 0.3 < found[E].value < 1.0


def test_points_outside_of_the_body_are_named() -> None:
    """And left out; most of them are refused."""
    (exact,) = computed(bar(), [FIELD], [E])
    points = np.vstack([exact.points, [[5.0, 0.5]]])
    more = replace(
        exact,
        points=points,
        values=np.vstack([exact.values, [[1.0, 1.0]]]),
        times=np.full(10, np.nan),
        lines=tuple(range(2, 12)),
    )
    found = identify(bar(E="2 MPa"), more, [E])
    assert found[E].value == pytest.approx(1.0, rel=EXACT)
    assert "1 of 10 points left out, outside of the body: line 11 (5, 0.5) m" in found.notes[-1]
    with pytest.raises(InputError, match=r"most points \(9 of 9\) are outside") as caught:
        identify(bar(), replace(FIELD, points=1e3 * GRID), [E])
    assert "bare numbers are in m" in str(caught.value)


def test_weights_and_several_starts() -> None:
    """Two sets that contradict each other meet where their weights put them."""
    (exact,) = computed(bar(), [FIELD], [E])
    soft = replace(exact, values=1.2 * exact.values, weight=3.0)
    found = identify(bar(), [exact, soft], [E], starts=2)
    # Least squares of 1/E: (1 + 3/1.2) / (1 + 3/1.44) for sizes s and 1.2 s of the two.
    assert 1 / found[E].value == pytest.approx((1 + 3 / 1.2) / (1 + 3 / 1.44), rel=1e-6)
    assert (found.starts, found.same) == (2, 2)
