"""Amplitudes over time: what is written is what happens."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic.errors import InputError
from dolfin_elastic.model.components import components, depends_on_time
from dolfin_elastic.model.curves import CONSTANT, RAMP, amplitude
from dolfin_elastic.model.loads import Traction
from dolfin_elastic.model.supports import Support


@pytest.mark.parametrize(
    ("written", "t", "value"),
    [
        ("constant", -1.0, 1.0),
        ("constant", 5.0, 1.0),
        ("ramp", -1.0, 0.0),
        ("ramp", 0.0, 0.0),
        ("ramp", 0.25, 0.25),
        ("ramp", 1.0, 1.0),
        ("ramp", 3.0, 1.0),
        ("sin(pi*t)", 0.5, 1.0),
        ("t^2", 3.0, 9.0),
        ("t", 0.7, 0.7),
        ("2", 0.1, 2.0),
        ("where(t < 1, 5, -1)", 0.5, 5.0),
        ("where(t < 1, 5, -1)", 1.0, -1.0),
        ([[0, 0], [2, 10], [3, 4]], -1.0, 0.0),
        ([[0, 0], [2, 10], [3, 4]], 1.0, 5.0),
        ([[0, 0], [2, 10], [3, 4]], 2.5, 7.0),
        ([[0, 0], [2, 10], [3, 4]], 9.0, 4.0),
        ([["10 ms", 1], ["30 ms", 3]], 0.02, 2.0),
        ([[1, 7]], 0.0, 7.0),
    ],
)
def test_value_at_a_time(written, t, value):
    assert amplitude(written).at(t) == pytest.approx(value, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("rmap", "did you mean 'ramp'"),
        ("sin(x)", "x"),
        ("", "formula"),
        (3.0, "not a curve"),
        ([], "pairs"),
        ([[0, 1, 2]], "pairs"),
        ([0, 1], "pairs"),
        ([[0, 0], [0, 1]], "increase"),
        ([[1, 0], [0, 1]], "increase"),
        ([[0, "a"]], "a"),
    ],
)
def test_what_is_no_curve_is_refused(written, says):
    with pytest.raises(InputError) as caught:
        amplitude(written)
    assert says in str(caught.value)


def test_an_amplitude_stays_itself():
    assert amplitude(RAMP) is RAMP
    assert CONSTANT.at(0.3) == 1.0


def test_curves_of_loads_and_supports_survive_being_written():
    for curve in ("ramp", "t^2", [[0.0, 1.0], [2.0, 0.0]]):
        load = Traction(on="top", value=[0, 0, 1], curve=curve)
        assert load.model_dump()["curve"] == curve
        again = Traction(**load.model_dump())
        times = np.linspace(-1, 3, 9)
        assert [again.curve.at(t) for t in times] == [load.curve.at(t) for t in times]
    assert Support(on="top").model_dump()["curve"] is None


def test_who_says_how_it_changes():
    """A curve, else a formula in t, else the solver."""
    assert Traction(on="top", value=[0, 0, 1]).amplitude is None
    assert Traction(on="top", value=["t*x", 0, 1]).amplitude is CONSTANT
    assert Traction(on="top", value=["t*x", 0, 1], curve="ramp").amplitude.written == "ramp"
    assert Support(on="top", displacement=[0, "0.1*x", "free"]).amplitude is None
    assert Support(on="top", displacement=[0, "0.1*t", "free"]).amplitude is CONSTANT


def test_time_in_formulas_is_seen():
    assert depends_on_time(components([0, "sin(t)"], "m"))
    assert not depends_on_time(components([0, "sin(x)"], "m"))
    assert not depends_on_time(components(["1 mm", 2.0], "m"))
