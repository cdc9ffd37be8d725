"""Which shells lie within which."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import BoolArray, FloatArray, IntArray


def winding(corners: FloatArray, x: FloatArray) -> FloatArray:
    """How often a closed surface goes round each point: 1 inside, 0 outside; -1 if turned round.

    Source: A. Van Oosterom & J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.

    Args:
        corners: Shape (m, 3, 3).
        x: Shape (n, 3).
    """
    result = np.empty(len(x))
    for row, place in enumerate(x):
        a, b, c = np.moveaxis(corners - place, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = np.einsum("ni,ni->n", a, np.cross(b, c))
        below = la * lb * lc + sum(
            np.einsum("ni,ni->n", p, q) * r for p, q, r in ((a, b, lc), (b, c, la), (c, a, lb))
        )
        result[row] = np.sum(2 * np.arctan2(top, below))
    return np.asarray(result / (4 * np.pi))


def containing(corners: FloatArray, shell: IntArray, closed: BoolArray) -> list[IntArray]:
    """The closed shells within which each shell lies, by one of its points. Local.

    Args:
        corners: Shape (m, 3, 3).
        shell: Of each triangle.
        closed: Of each shell.
    """
    count = len(closed)
    order = np.argsort(shell, kind="stable")
    begin = np.searchsorted(shell[order], np.arange(count + 1))
    rows = [order[begin[k] : begin[k + 1]] for k in range(count)]
    low = np.array([corners[r].min(axis=(0, 1)) for r in rows])
    high = np.array([corners[r].max(axis=(0, 1)) for r in rows])
    starts = np.array([corners[r[0]].mean(axis=0) for r in rows])
    result: list[list[int]] = [[] for _ in range(count)]
    for k in np.flatnonzero(closed):
        inner = np.flatnonzero(((low >= low[k]) & (high <= high[k])).all(axis=1))
        inner = inner[inner != k]
        if len(inner):
            around = np.abs(winding(corners[rows[k]], starts[inner])) > 0.5
            for one in inner[around]:
                result[one].append(int(k))
    return [np.array(one, dtype=np.int64) for one in result]
