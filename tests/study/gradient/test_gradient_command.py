"""What the command `gradient` prints."""

from __future__ import annotations

import math

import pytest

from dolfin_elastic.cli.tools.gradient import order_text


@pytest.mark.parametrize(
    ("order", "text", "meaning"),
    [
        (2.0, "2.00", ""),
        (1.0, "1.00 (!)", "wrong derivative"),
        (-0.5, "-0.50 (!)", "wrong derivative"),
        (9.27, "9.27 (?)", "not of second order either"),
        (math.nan, "round-off", ""),
    ],
)
def test_orders_that_are_not_two(order: float, text: str, meaning: str) -> None:
    """Below 2 and well above: neither remainder is of second order."""
    shown, told = order_text(order)
    assert shown == text
    assert meaning in told and bool(meaning) == bool(told)
