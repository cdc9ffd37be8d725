"""`Mixing`: Anderson's acceleration of an iteration whose steps are expensive."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray

_DEPTH = 20
"""Steps that are combined."""


class Mixing:
    """Anderson's acceleration of x <- x + f(x): f of a combination of the last x is smallest.

    Source: H. F. Walker & P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715; of a linear f it is GMRES.

    Args:
        comm: Each rank has its part of x.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._last: list[tuple[FloatArray, FloatArray]] = []

    def next(self, x: FloatArray, f: FloatArray) -> FloatArray:
        """The next x. Collective.

        Args:
            x: The present one, this rank's part of it.
            f: At x: what the plain iteration would add.
        """
        self._last.append((x, f))
        del self._last[: -1 - _DEPTH]
        result: FloatArray = x + f
        if len(self._last) > 1:
            dx, df = (np.diff([one[i] for one in self._last], axis=0) for i in (0, 1))
            gram, right = total(self._comm, df @ df.T), total(self._comm, df @ f)
            scale = 1 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
            shares = np.linalg.lstsq(scale[:, None] * gram * scale, scale * right, rcond=1e-13)[0]
            result = result - (scale * shares) @ (dx + df)
        return result
