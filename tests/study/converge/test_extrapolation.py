"""Limits, rates and errors of sequences whose limits are known."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic.study.converge.extrapolation import ASSUMED, OBSERVED, extrapolate, grows


def test_rate_and_limit() -> None:
    """Three values of 3 + 2 N^-0.7 give both, and 1.25 times the error that is left."""
    N = np.array([100, 180, 400])
    q = 3 + 2 * N**-0.7
    found = extrapolate(N, q, rate=1.0)
    assert (found.limit, found.rate) == pytest.approx((3.0, 0.7), rel=1e-9)
    assert found.error == pytest.approx(OBSERVED * (q[-1] - 3) / 3, rel=1e-9)


def test_two_values() -> None:
    """The rate must be assumed, and the error is multiplied by 3."""
    found = extrapolate([100, 200], [1.0, 1.1], rate=1.0)
    assert found.limit == pytest.approx(1.2)
    assert found.error == pytest.approx(ASSUMED * 0.1 / 1.2)
    assert np.isnan(found.rate)


def test_a_rate_too_good_is_not_relied_upon() -> None:
    """Values that happen to be alike: what the step before leaves at the rate expected."""
    found = extrapolate([100, 200, 400], [1.0, 1.1, 1.101], rate=1.0)
    assert found.limit == pytest.approx(1.102)
    assert found.error == pytest.approx(OBSERVED * 0.05 / 1.102)


@pytest.mark.parametrize("values", [[1.0, 1.2, 1.1], [1.0, 1.1, 1.2], [1.0, 1.1, 1.3]])
def test_nothing_converges(values: list[float]) -> None:
    """Values that swing, grow like a logarithm or faster have no limit yet."""
    found = extrapolate([100, 200, 400], values, rate=1.0)
    assert np.isnan(found.limit)
    assert found.error >= 0.1


def test_one_value_and_equal_ones() -> None:
    """Nothing is known of one; equal ones are exact."""
    assert np.isnan(extrapolate([100], [1.0], rate=1.0).error)
    assert extrapolate([100, 200], [0.0, 0.0], rate=1.0).error == 0.0
    assert extrapolate([100, 200, 300], [2.0, 2.0, 2.0], rate=1.0).error == 0.0


def test_growth() -> None:
    """h^-0.45 grows; what converges like h does not, nor does a peak whose cells stay the same."""
    h = np.array([1.0, 0.5, 0.25, 0.125])
    assert grows(h, h**-0.45, 3) == pytest.approx(0.45)
    assert grows(h, 3 - h, 3) == 0.0
    assert grows(np.ones(4), h**-0.45, 3) == 0.0
    assert grows(h[:2], h[:2] ** -0.45, 2) == 0.0
