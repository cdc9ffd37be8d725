"""What the command `gradient` prints."""

from __future__ import annotations

import math

import pytest

from dolfin_elastic.cli.tools.gradient import cells_of, gradient, order_text, show
from dolfin_elastic.study.gradient.table import Derivative, Gradient, GradientTable


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


@pytest.mark.parametrize(
    ("at", "room", "text"),
    [
        (0.499, 0.001, "-0.03 % for +0.0001"),  # 0.504 is none
        (0.4, 0.1, "-1.2 %"),
        (-0.3, 0.7, "+0.9 %"),
        (-0.999, 0.001, "+0.03 % for -0.0001"),
    ],
)
def test_one_per_cent_more_is_possible(at: float, room: float, text: str) -> None:
    """Beside the end of the range of a number the change is told for a smaller step."""
    d = Derivative("materials.gel.nu", at, "", -6.0, room, room=room)
    assert cells_of(Gradient("strain_energy", 2.0, "J", (d,)), d)[3] == text


def test_norms_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    """A norm stands for the largest value that was asked for."""
    one = Gradient("norm:16 von_mises", 2.0, "Pa", ())
    fields = ["norm 16 von_mises by shape: at most 3 Pa per m"]
    show(GradientTable((one, one)), fields, verified=True)
    out = capsys.readouterr().out
    assert out.count("norm:16 is the p-norm of order 16, which is below the largest value") == 1
    assert "at most 3 Pa per m" in out


def test_keys_with_brackets_are_quoted() -> None:
    """A shell takes brackets for a pattern of file names."""
    assert '--by "load[0].value[2]"' in str(gradient.__doc__)
