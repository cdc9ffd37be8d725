"""Distributed matrices as numpy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI


def dense(matrix: Any, comm: MPI.Comm) -> np.ndarray:
    """A distributed matrix as one array on every rank."""
    rows, columns, values = matrix.getValuesCSR()
    start, _ = matrix.getOwnershipRange()
    out = np.zeros(matrix.getSize())
    for i in range(len(rows) - 1):
        part = slice(rows[i], rows[i + 1])
        out[start + i, columns[part]] = values[part]
    return comm.allreduce(out, op=MPI.SUM)
