"""What least squares say of the constants in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dolfin_elastic.core.si_text import listed, number, quantity
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.study.least_squares.certainty import Certainty
from dolfin_elastic.study.least_squares.problem import LeastSquares

_ALIKE = 0.95
"""Correlation from which on two constants are hardly told apart."""
_NOTHING = 1e-6
"""Bound, over the size of a constant, that is 0 but for what keeps the constant above it."""


def remarks_on(
    model: LeastSquares,
    z: FloatArray,
    known: Certainty,
    data: str,
    what: str,
    which: Callable[[FloatArray, Sequence[int]], str] = lambda *_: "",
) -> tuple[list[str], list[str]]:
    """What is not told, and further remarks, a sentence each.

    Args:
        z: The answer, shape (k,).
        known: What is known of them at z, from `certainty`.
        data: What was measured, such as "tests".
        what: Describes it, such as "the law".
        which: From a change of z that is hardly seen, and the indices of the constants in it, to
            what would tell them, behind a colon; empty where nothing is known to.
    """
    names, unknown, notes = [row.name for row in model.free], [], []
    for group in known.unknown:
        direction = np.zeros(len(z))
        direction[list(group)] = 1.0
        alone = len(group) == 1
        text = (
            f"{names[group[0]]} cannot be found from these {data}"
            if alone
            else f"{listed([names[i] for i in group])} cannot be distinguished by these {data}"
        )
        unknown.append(text + which(direction if alone else known.weak, group))
    wide = [
        i
        for i in range(len(z))
        if np.isfinite(known.half[i]) and known.half[i] > abs(z[i]) * model.scale[i] > 0
    ]
    if wide:
        who = f"{listed([names[i] for i in wide])} {'is' if len(wide) == 1 else 'are'}"
        unknown.append(f"{who} known to no better than 100 %" + which(known.weak, wide))
    pairs = [
        f"{names[i]} and {names[j]} ({known.correlation[i, j]:.3f})"
        for i in range(len(z))
        for j in range(i)
        if abs(known.correlation[i, j]) > _ALIKE
    ]
    if pairs:
        notes.append(f"strongly correlated: {', '.join(pairs)}")
    notes += [
        f"{names[i]} is at a bound of its range: the {data} want {_beyond(model, z, i, what)}"
        for i in np.flatnonzero(known.bound)
    ]
    return unknown, notes


def _beyond(model: LeastSquares, z: FloatArray, i: int, what: str) -> str:
    """On which side of its range a constant would be, and what has this end."""
    row, below = model.free[i], z[i] - model.low[i] < model.high[i] - z[i]
    limit = row.low if below else row.high
    limit = 0.0 if abs(limit) < _NOTHING * row.scale else limit
    text = quantity(limit, row.unit) if row.unit else number(limit)
    why = "--bounds leaves out" if row.narrowed[not below] else f"{what} cannot have"
    return f"{'less' if below else 'more'} than {text}, which {why}"
