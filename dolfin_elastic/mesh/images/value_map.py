"""Steps from the values of an image to those of a field, such as HU to ash density to a modulus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.schema import quoted
from dolfin_elastic.core.types import AnyArray, FloatArray

VALUE = "v"
_EXPECTED = 'a formula in v, such as "0.9*v + 50", or pairs such as [[-1000, 0], [2000, 1.8]]'


class Table:
    """Pairs of a value and what it becomes: linear between, constant beyond the ends."""

    def __init__(self, rows: Sequence[Sequence[float]]) -> None:
        table = np.array(rows, dtype=np.float64)
        if len(table) < 2 or not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0).all():
            raise InputError(
                f"{quoted(rows)} is no table", expected="two pairs or more, with ascending values"
            )
        self._from, self._to = table.T

    def __call__(self, values: FloatArray) -> FloatArray:
        """Values of any shape."""
        return np.asarray(np.interp(values, self._from, self._to))


class _OfFormula:
    def __init__(self, text: str) -> None:
        self._formula = Formula.parse(text, allowed=[VALUE])

    def __call__(self, values: FloatArray) -> FloatArray:
        result = self._formula.evaluate(**{VALUE: values})
        return np.broadcast_to(np.asarray(result, dtype=np.float64), values.shape)


class ValueMap:
    """The steps one after the other.

    Args:
        written: A formula in v, a table of pairs, or a list of several of these; none: unchanged.

    Raises:
        InputError: None of these.
    """

    def __init__(self, written: object) -> None:
        steps = [written] if isinstance(written, str) or _is_table(written) else written
        if not isinstance(steps, list | tuple):
            raise InputError(f"{quoted(written)} is no map", expected=_EXPECTED)
        self._steps: list[Table | _OfFormula] = []
        for index, step in enumerate(steps):
            with keyed(f"[{index}]" if steps is written else ""):
                self._steps.append(_step(step))

    def __call__(self, values: AnyArray) -> FloatArray:
        """Maps values of any shape.

        Raises:
            InputError: One has no finite result.
        """
        result = np.asarray(values, dtype=np.float64)
        for step in self._steps:
            with np.errstate(all="ignore"):
                result = step(result)
        bad = ~np.isfinite(result)
        if bad.any():
            raise InputError(
                f"the value {float(values[bad].ravel()[0]):g} of the image has no finite result",
                expected='for example "max(v, 0)^1.49" where v may be negative',
            )
        return result


def _is_table(written: object) -> bool:
    return (
        isinstance(written, list | tuple)
        and len(written) > 0
        and all(isinstance(row, list | tuple) and len(row) == 2 for row in written)
        and all(isinstance(x, int | float) for row in written for x in row)
    )


def _step(written: object) -> Table | _OfFormula:
    if isinstance(written, str):
        return _OfFormula(written)
    if not _is_table(written):
        raise InputError(f"{quoted(written)} is no step of a map", expected=_EXPECTED)
    assert isinstance(written, list | tuple)
    return Table(written)
