"""The table of reductions: what `values` of probes, `Quantity` and `converge` may ask for.

Below the percentile p lie p % of the area or volume, each quadrature point with its weight; between
two points it is interpolated, as it is for the middle of the weight of each.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.derived.reduction import Reduction, Samples

_HALVINGS = 64
"""Of the range of values, down to round-off."""
_ANY = (-np.inf, np.inf)
_NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
"""Behind a colon, in the SI unit that its reduction says: 95, -0.5 or 2.5e8."""


def _maximum(samples: Samples, sign: float) -> FloatArray:
    """Largest value of each column; nan where no row has one. Collective.

    The field of the mean is another one, see `part_numbers`: no extreme is within its mean.
    """
    rows = sign * np.vstack([samples.peaks, samples.mean(samples.values)])
    known = np.where(np.isnan(rows), -np.inf, rows)
    result = np.max(samples.comm.allgather(known.max(axis=0, initial=-np.inf)), axis=0)
    return sign * np.where(np.isinf(result), np.nan, result)


def _percentiles(samples: Samples, number: float) -> FloatArray:
    comm, weights = samples.comm, samples.weights
    return np.array([percentile(comm, c, weights, number / 100) for c in samples.values.T])


def _above(samples: Samples, limit: float) -> FloatArray:
    """Area [m^2] or volume [m^3] in which each column exceeds a limit; nan where a value is.

    Each quadrature point counts with its whole weight.
    """
    values = samples.values
    size = samples.integral(np.where(values > limit, 1.0, 0.0))
    missing = samples.integral(np.where(np.isnan(values), 1.0, 0.0))
    return np.asarray(np.where(missing > 0, np.nan, size), dtype=np.float64)


def _fraction_above(samples: Samples, limit: float) -> FloatArray:
    return np.asarray(_above(samples, limit) / samples.size, dtype=np.float64)


def percentile(comm: MPI.Comm, values: FloatArray, weights: FloatArray, share: float) -> float:
    """The value below which a share of the weights lies; nan where a value is. Collective.

    Args:
        values: This rank's, shape (n,).
        weights: Of each, positive.
        share: 0 to 1.
    """
    if total(comm, int(np.isnan(values).sum())):
        return float("nan")
    order = np.argsort(values)
    known, sums = values[order], np.concatenate([[0.0], np.cumsum(weights[order])])

    def below(x: float) -> float:
        """Weights of the values below x, and half of those that equal it."""
        ends = np.searchsorted(known, x, "left"), np.searchsorted(known, x, "right")
        return float(total(comm, float(sums[ends[0]] + sums[ends[1]]))) / 2

    goal = share * total(comm, float(sums[-1]))
    low = smallest(comm, known.min(initial=np.inf))
    high = largest(comm, known.max(initial=-np.inf))
    for _ in range(_HALVINGS):
        middle = low + (high - low) / 2
        low, high = (middle, high) if below(middle) <= goal else (low, middle)
    first = largest(comm, known[known <= low].max(initial=-np.inf))
    second = smallest(comm, known[known > low].min(initial=np.inf))
    if second == np.inf:
        return first
    start = below(first)
    return first + (second - first) * min(max((goal - start) / (below(second) - start), 0.0), 1.0)


REDUCTIONS: dict[str, Reduction] = {
    "max": Reduction(lambda samples, _: _maximum(samples, 1.0)),
    "min": Reduction(lambda samples, _: _maximum(samples, -1.0)),
    "mean": Reduction(factor=lambda size: 1 / size),
    "integral": Reduction(factor=lambda _: 1.0, over=True),
    "percentile:95": Reduction(_percentiles, limits=(0, 100)),
    "share_above:0.01": Reduction(_fraction_above, limits=_ANY, unit=""),
    "size_above:0.01": Reduction(_above, limits=_ANY, over=True, unit=""),
}
"""Name to reduction, of one with a number behind a colon an example."""


def reduction_of(text: str) -> tuple[Reduction, float]:
    """The reduction of a name, and the number behind its colon; 0 without one.

    Raises:
        InputError: There is none.
    """
    name, colon, number = text.partition(":")
    expected = nearest(text, REDUCTIONS)
    for example, row in REDUCTIONS.items():
        if name == example.partition(":")[0] and bool(colon) == (row.limits is not None):
            if row.limits is None:
                return row, 0.0
            if re.fullmatch(_NUMBER, number) and row.limits[0] <= float(number) <= row.limits[1]:
                return row, float(number)
            low, high = row.limits
            span = f" from {low:g} to {high:g}" if np.isfinite(high - low) else ""
            expected = f"expected a number{span} behind the colon, for example '{example}'"
    raise InputError(f"unknown value '{text}'", expected=expected)


def ending(text: str, over: str) -> str:
    """What stands for a reduction at the end of the names of columns.

    Args:
        text: Such as "mean" or "percentile:95".
        over: "area" or "volume".
    """
    name = text.replace(":", "_")
    return f"{over}_{name}" if reduction_of(text)[0].over else name


def reduced_unit(column: str, unit_of_field: Callable[[str], str | None]) -> str | None:
    """Unit of a column whose name ends in a reduction; None of others.

    Args:
        unit_of_field: Of the column of the field, its component included.
    """
    for example, row in REDUCTIONS.items():
        name, colon, _ = example.partition(":")
        over, number = "_(area|volume)" if row.over else "()", f"_{_NUMBER}" if colon else ""
        result = re.search(rf"(?:_length)?{over}_{name}{number}(_[xyz]{{1,2}})?$", column)
        unit = (
            None if result is None else unit_of_field(column[: result.start()] + (result[2] or ""))
        )
        if result is not None and unit is not None:
            measure = {"area": "m^2", "volume": "m^3"}.get(result[1], "")
            return " ".join(filter(None, (unit if row.unit is None else row.unit, measure)))
    return None
