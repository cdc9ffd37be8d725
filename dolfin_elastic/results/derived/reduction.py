"""`Reduction`: how a field over a part becomes one number, and of what it is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray


@dataclass(frozen=True)
class Samples:
    """A field over a surface or region: this rank's part of it.

    Attributes:
        comm: The ranks that share it.
        size: Area [m^2] or volume [m^3] of the whole undeformed part.
        weights: Of the quadrature points [m^2 or m^3], shape (points,).
        values: There, shape (points, columns): components, and behind them their length.
        peaks: Values among which extremes are sought, at nodes or at the same points.
    """

    comm: MPI.Comm
    size: float
    weights: FloatArray
    values: FloatArray
    peaks: FloatArray

    def integral(self, values: FloatArray) -> FloatArray:
        """Integral over the whole part of values at the points of this rank. Collective."""
        return np.asarray(total(self.comm, self.weights @ values))

    def mean(self, values: FloatArray) -> FloatArray:
        """Mean over the whole part of values at the points of this rank. Collective."""
        return np.asarray(self.integral(values) / self.size, dtype=np.float64)


@dataclass(frozen=True)
class Reduction:
    """A number of each column of `Samples`.

    Attributes:
        of: Collective function of the samples, and of the number behind a colon of its name, to the
            numbers of all columns, the same on every rank; unless there is a `factor`.
        factor: Of a share of the integral, by the part's size: it is linear in the field, so that
            it has a derivative, and of a vector is no length.
        limits: Smallest and largest number behind the colon, such as (-inf, inf); None: its name
            has no colon.
        over: Area or volume belong to its name and unit.
        unit: Its SI unit, "" of a share or count; None: that of the field.
    """

    of: Callable[[Samples, float], FloatArray] | None = None
    factor: Callable[[float], float] | None = None
    limits: tuple[float, float] | None = None
    over: bool = False
    unit: str | None = None

    def __call__(self, samples: Samples, number: float) -> FloatArray:
        """The numbers, shape (columns,). Collective."""
        if self.of is not None:
            return self.of(samples, number)
        assert self.factor is not None
        return samples.integral(samples.values) * self.factor(samples.size)
