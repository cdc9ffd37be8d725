"""Richardson's extrapolation of a quantity on meshes that grow finer, and the error that is left.

With q(N) = q0 + c N^-s three meshes of N1 < N2 < N3 unknowns determine the rate s, and q0.  The
error is that of Roache's grid convergence index, with his safety factors: 1.25 where the rate is
observed, 3 where it must be assumed.  Adapted meshes have no uniform size: N is the number of
unknowns, or for a value at one place h^-d of the cells there.

Source: P. J. Roache, Perspective: a method for uniform reporting of grid refinement studies,
J. Fluids Eng. 116 (1994) 405.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from dolfin_elastic.core.types import FloatArray

OBSERVED, ASSUMED = 1.25, 3.0
"""Safety factors of Roache."""
_SLOWEST = 0.1


@dataclass(frozen=True)
class Extrapolation:
    """The limit of a sequence and the relative error of its last number.

    Attributes:
        limit: The value on an infinitely fine mesh; nan before there are two meshes, or where
            nothing converges yet.
        error: Relative error of the last value; nan with one mesh.
        rate: Observed s of N^-s; nan where it is assumed.
    """

    limit: float = float("nan")
    error: float = float("nan")
    rate: float = float("nan")


def extrapolate(
    fineness: Sequence[float], values: Sequence[float], *, rate: float
) -> Extrapolation:
    """Extrapolates the last two or three values.

    Args:
        fineness: N of each mesh.
        values: The quantity on each mesh.
        rate: Expected s; a faster one that is observed is not relied upon.
    """
    if len(values) < 2 or fineness[-1] <= fineness[-2]:
        return Extrapolation()
    N, q = np.array(fineness[-3:], dtype=float), np.array(values[-3:], dtype=float)
    last = float(q[-1] - q[-2])
    observed = _observed(N, q) if len(q) == 3 else None
    if observed is None and len(q) == 3:
        # The values oscillate or do not converge: only the differences are known, and these are the
        # smaller the less the mesh was refined.
        ahead = float(np.max(np.abs(np.diff(q)))) / min(1.0, (N[-1] / N[-2]) ** rate - 1.0)
        return Extrapolation(error=_relative(ASSUMED * ahead, float(q[-1])))
    s = rate if observed is None else min(observed, rate)
    ahead = last / ((N[-1] / N[-2]) ** s - 1.0)
    limit = float(q[-1]) + ahead
    if observed is None:
        return Extrapolation(limit, _relative(ASSUMED * abs(ahead), limit))
    # The last difference may be small by accident: that before it counts, too.
    before = np.diff(q) / np.diff(N**-s) * N[-1] ** -s
    left = float(np.max(np.abs(before)))
    return Extrapolation(limit, _relative(OBSERVED * left, limit), observed)


def _relative(error: float, value: float) -> float:
    return 0.0 if error == 0.0 else error / abs(value) if value else float("inf")


def _observed(N: FloatArray, q: FloatArray) -> float | None:
    """The rate of three values; None if they oscillate or do not converge.

    (N1^-s - N2^-s)/(N2^-s - N3^-s) grows with s, from log(N2/N1)/log(N3/N2) at s = 0, where the
    values grow like a logarithm.
    """
    before, last = q[1] - q[0], q[2] - q[1]
    if last == 0.0:
        return np.inf
    if not np.all(np.diff(N) > 0) or before * last <= 0.0:
        return None

    def excess(s: float) -> float:
        a, b, c = N**-s / N[2] ** -s
        return float((a - b) / (b - c) - before / last)

    if excess(_SLOWEST) > 0.0:
        return None
    return float(brentq(excess, _SLOWEST, 50.0)) if excess(50.0) > 0.0 else 50.0


def grows(sizes: Sequence[float], values: Sequence[float], steps: int) -> float:
    """Exponent a of a value that grows like h^-a, 0 if it settles.

    The value at a singular place grows by the same factor whenever the cells there are halved.  A
    value that converges takes smaller steps each time.

    Args:
        sizes: Of the cells at the place, on each mesh.
        steps: Refinements that must show it.
    """
    if len(values) <= steps:
        return 0.0
    h, q = np.log(np.array(sizes[-steps - 1 :])), np.abs(np.array(values[-steps - 1 :]))
    finer = -np.diff(h)
    if np.any(finer <= 0.2) or np.any(q <= 0.0):
        return 0.0
    slopes = np.diff(np.log(q)) / finer
    steady = bool(np.all(slopes > 0.05)) and slopes[-1] > 0.8 * slopes[0]
    return float(np.mean(slopes)) if steady else 0.0
