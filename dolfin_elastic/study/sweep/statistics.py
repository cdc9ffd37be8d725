"""What samples tell of a result: mean, deviation, percentiles, and which setting causes them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.study.sweep.rows import Row
from dolfin_elastic.study.sweep.settings import Design

PERCENTILES = (5, 50, 95)
_FEWEST = 3
"""Samples of which a deviation is told."""
_ROUND_OFF = 1e-9
"""Relative change of a result that is none: that of solvers with tolerances."""


@dataclass(frozen=True)
class Sobol:
    """Which fraction of the variance a setting causes.

    Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259, table 2 (b) and (f); errors
    by resampling, as `scipy.stats.sobol_indices` does it.

    Attributes:
        first: Alone.
        total: With all others.
        error: Half the width of the 95 % interval of `total`.
    """

    first: float
    total: float
    error: float


@dataclass(frozen=True)
class Statistics:
    """Of one result.

    Attributes:
        mean: Of the samples, in its SI unit.
        deviation: Standard deviation of the samples.
        percentiles: Percent to the value below which so many lie.
        mesh: Estimated error of the mesh, the mean of the samples'; nan where it is not known.
        sobol: Key of a setting to its indices; none of other samples.
        samples: Of which all that is.
    """

    mean: float
    deviation: float
    percentiles: Mapping[int, float]
    mesh: float
    sobol: Mapping[str, Sobol]
    samples: int


def statistics(design: Design, rows: Sequence[Row]) -> dict[str, Statistics]:
    """Of each result that samples have; none where nothing scatters or values are listed, too.

    Rows that have failed are left out; with one of them there are no indices of Sobol's.

    Args:
        rows: All of the design, in its order.
    """
    if len(design.scatter) < len(design.settings) or not design.scatter:
        return {}
    good = [row for row in rows if row.status == "solved"]
    names = dict.fromkeys(name for row in good for name in row.numbers)
    result = {}
    # Saltelli's third kind of sample varies one setting: only A and B are drawn independently.
    drawn = [row for row in good if not design.base or row.number <= 2 * design.base]
    for name in names:
        has = [row for row in drawn if math.isfinite(row.numbers.get(name, math.nan))]
        values = np.array([row.numbers[name] for row in has])
        if len(values) < _FEWEST:
            continue
        errors = [row.errors.get(name, math.nan) * abs(row.numbers[name]) for row in has]
        result[name] = Statistics(
            float(values.mean()),
            float(values.std(ddof=1)),
            {p: float(np.percentile(values, p)) for p in PERCENTILES},
            float(np.mean(errors)),
            _sobol(design, rows, name),
            len(values),
        )
    return result


def _sobol(design: Design, rows: Sequence[Row], name: str) -> dict[str, Sobol]:
    """Indices of each setting; none where a row is missing, or nothing changes the result."""
    n, d = design.base, len(design.scatter)
    good = [row.numbers if row.status == "solved" else {} for row in rows]
    f: FloatArray = np.array([numbers.get(name, math.nan) for numbers in good])
    if not n or not np.all(np.isfinite(f)) or len(f) != n * (d + 2):
        return {}
    if np.ptp(f) <= _ROUND_OFF * np.max(np.abs(f)):
        return {}
    from scipy.stats import sobol_indices

    parts = {"f_A": f[None, :n], "f_B": f[None, n : 2 * n], "f_AB": f[2 * n :].reshape(d, 1, n)}
    found = sobol_indices(func=parts, n=n, rng=np.random.default_rng(0))
    interval = found.bootstrap().total_order.confidence_interval
    half = (np.ravel(interval.high) - np.ravel(interval.low)) / 2
    columns = zip(np.ravel(found.first_order), np.ravel(found.total_order), half, strict=True)
    pairs = zip(design.scatter, columns, strict=True)
    return {one.key: Sobol(*(float(value) for value in column)) for one, column in pairs}
