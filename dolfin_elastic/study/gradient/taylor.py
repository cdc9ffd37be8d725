"""Taylor's remainder: what tells a right derivative from a wrong one.

|Q(m + h) - Q(m) - h dQ/dm| falls like h^2 if the derivative is right, and else like h.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.study.gradient.spatial import OFFSET, nodes_moved
from dolfin_elastic.study.gradient.table import Derivative, Gradient

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case

STEP = 0.01
"""Larger one of the two, relative to the size of a parameter."""
ROUND_OFF = 1e-7
"""Remainder over the number below which it tells nothing: forces are balanced to 1e-8."""

Values = Callable[["Case"], Sequence[float]]
"""The numbers of a case on the body as it is now. Collective."""


def with_orders(
    gradients: Sequence[Gradient], case: Case, body: Body, values: Values
) -> tuple[Gradient, ...]:
    """Gradients with the orders of their remainders, by two solutions a parameter. Collective.

    Args:
        body: Whose nodes are moved for a while.
    """
    orders: list[list[float]] = [[] for _ in gradients]
    for number, derivative in enumerate(gradients[0].by):
        step = STEP * derivative.size
        try:
            sides = [_at(case, body, derivative, share * step, values) for share in (1.0, 0.5)]
        except InputError:  # nu = 0.4995 has no larger one: the other side
            step = -step
            sides = [_at(case, body, derivative, share * step, values) for share in (1.0, 0.5)]
        for row, one in enumerate(gradients):
            left = [
                abs(side[row] - one.value - share * step * one.by[number].value)
                for side, share in zip(sides, (1.0, 0.5), strict=True)
            ]
            known = min(left) > ROUND_OFF * max(abs(one.value), abs(step * one.by[number].value))
            orders[row].append(math.log2(left[0] / left[1]) if known else math.nan)
    return tuple(
        replace(
            one, by=tuple(replace(d, order=order) for d, order in zip(one.by, own, strict=True))
        )
        for one, own in zip(gradients, orders, strict=True)
    )


def _moves(derivative: Derivative) -> bool:
    return derivative.key.startswith(OFFSET)


def _at(
    case: Case, body: Body, derivative: Derivative, step: float, values: Values
) -> Sequence[float]:
    """The numbers where a parameter is a step further. Collective."""
    if not _moves(derivative):
        number = derivative.at + step
        text = f"{number!r} {derivative.unit}" if derivative.unit else number
        return values(case.changed({derivative.key: text}))
    x, before = body.mesh.geometry.x, body.mesh.geometry.x.copy()
    x[:, : body.dim] += step * nodes_moved(body, derivative.key.removeprefix(OFFSET))
    try:
        return values(case)
    finally:
        x[:] = before
