"""Which cells are refined: as few as carry a given share of the error."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.types import FloatArray, IndexArray

_HALVINGS = 60
_EQUAL = 1e-6
"""Relative difference of indicators below which cells are refined together.  Otherwise round-off,
which depends on the number of ranks, would separate cells that are mirror images in a symmetric
body."""


def bulk(comm: MPI.Comm, indicators: FloatArray, share: float) -> IndexArray:
    """The cells with the largest indicators that together have a share of their sum.

    Collective.  All cells above one threshold, the same on all ranks, which is found by bisection:
    nothing is sorted over the ranks.

    Source: W. Doerfler, A convergent adaptive algorithm for Poisson's equation, SIAM J. Numer.
    Anal. 33 (1996) 1106.

    Args:
        indicators: Squares of the error of this rank's owned cells, shape (cells,).
        share: Of the sum, between 0 and 1.

    Returns:
        Owned cells, sorted.
    """
    high = float(comm.allreduce(float(indicators.max(initial=0.0)), op=MPI.MAX))
    whole = float(comm.allreduce(float(indicators.sum())))
    if not high > 0.0:
        return np.empty(0, dtype=np.int32)
    low = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        above = float(comm.allreduce(float(indicators[indicators >= middle].sum())))
        low, high = (middle, high) if above >= share * whole else (low, middle)
    near = (1.0 - _EQUAL) * low
    return np.flatnonzero((indicators >= near) & (indicators > 0.0)).astype(np.int32)
