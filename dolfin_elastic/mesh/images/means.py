"""Means of an image over the cells of a mesh, to which each voxel contributes by its part in them.

Each cell is crossed by lines along the first axis of the image, four a voxel in both other
directions, and more through small cells.  Along a line the image, constant in voxels, is
integrated exactly by sums from its beginning on, so the work grows with the area of a cell, not
its volume.  As the lines of all large cells are the same, no part of the image counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dolfin_elastic.core.types import FloatArray, IntArray

_A_VOXEL: Final = 4
"""Lines across a voxel."""
_ACROSS: Final = 2.0
"""Voxels across a cell below which there are more."""
_TINY: Final = 1e-3
_GOLDEN: Final = 0.6180339887498949
"""Part of a step by which lines of a row lie beside those of the row before.

In a square pattern whole rows would lie on the diagonal faces of the cells of a box.
"""
_LINES: Final = 1 << 17
"""Lines that are looked at together."""
_MIDDLE: Final = 1e-9
"""Weight of the value at the middle, for cells so thin that no line meets them."""


@dataclass(frozen=True)
class Layers:
    """Neighbouring layers of an image along its last axis.

    Attributes:
        sums: Of the values from the beginning of each line on, shape (layers, nj, ni + 1).
        first: Number of the first layer in the image.
        shape: Of the whole image, (ni, nj, nk).
        outside: Value outside of the image; None: that of the nearest voxel.
    """

    sums: FloatArray
    first: int
    shape: tuple[int, int, int]
    outside: float | None

    @classmethod
    def of(
        cls,
        values: FloatArray,
        first: int,
        shape: tuple[int, int, int],
        outside: float | None,
    ) -> Layers:
        """Sums of values of shape (layers, nj, ni)."""
        sums = np.zeros((*values.shape[:2], values.shape[2] + 1))
        np.cumsum(values, axis=2, out=sums[:, :, 1:])
        return cls(sums, first, shape, outside)

    def has(self, k: IntArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether layers are among these; those outside of the image belong to the outermost."""
        k = np.clip(k, 0, self.shape[2] - 1)
        return np.asarray((k >= self.first) & (k < self.first + len(self.sums)))

    def along(self, low: FloatArray, high: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Integrals along lines from `low` to `high` [voxels], at y and z in these layers."""
        ni, nj, nk = self.shape
        j, k = np.floor(y).astype(np.int64), np.floor(z).astype(np.int64)
        beside = (j < 0) | (j >= nj) | (k < 0) | (k >= nk)
        start = (np.clip(k, 0, nk - 1) - self.first) * nj + np.clip(j, 0, nj - 1)
        start *= ni + 1
        flat = self.sums.reshape(-1)
        result = self._up_to(flat, start, high) - self._up_to(flat, start, low)
        before = np.maximum(np.minimum(high, 0.0) - low, 0.0)
        behind = np.maximum(high - np.maximum(low, ni), 0.0)
        if self.outside is not None:
            result += self.outside * (before + behind)
            return np.where(beside, self.outside * (high - low), result)
        result += before * flat[start + 1]
        return np.asarray(result + behind * (flat[start + ni] - flat[start + ni - 1]))

    def _up_to(self, flat: FloatArray, start: IntArray, x: FloatArray) -> FloatArray:
        x = np.clip(x, 0.0, self.shape[0])
        i = np.minimum(x.astype(np.int64), self.shape[0] - 1)
        left = flat[start + i]
        return np.asarray(left + (x - i) * (flat[start + i + 1] - left))


class CellMeans:
    """Means over simplices, of an image whose layers are given one after the other.

    Args:
        corners: In units of voxels, of which the first one is from 0 to 1 along each axis, shape
            (n, 4, 3); of triangles (n, 3, 2), in an image of one layer.
    """

    def __init__(self, corners: FloatArray) -> None:
        n, d = len(corners), corners.shape[2]
        self._low = np.zeros((n, 3))
        self._high = np.tile([0.0, 0.0, 1.0], (n, 1))
        self._low[:, :d], self._high[:, :d] = corners.min(axis=1), corners.max(axis=1)
        size = self._high - self._low
        # By factors of 2, so that cells of about one size have lines in common.
        double = np.rint(np.log2(_ACROSS / np.maximum(size[:, 1:], _TINY)))
        lines = _A_VOXEL * 2.0 ** np.maximum(double, 0.0)
        if d == 2:
            lines[:, 1] = 1
        self._step = 1.0 / lines
        self._first = np.floor(self._low[:, 1:] * lines)
        last = np.ceil(self._high[:, 1:] * lines)
        self._count = np.maximum(last - self._first, 1).astype(np.int64)
        self._middle = np.full((n, 3), 0.5)
        self._middle[:, :d] = corners.mean(axis=1)
        # A barycentric coordinate is constant + gradient . place.
        self._gradient = np.zeros((n, d + 1, 3))
        with np.errstate(all="ignore"):
            self._gradient[:, 1:, :d] = _inverse(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        self._gradient[:, 0] = -self._gradient[:, 1:].sum(axis=1)
        self._constant = -np.einsum("nmi,ni->nm", self._gradient[..., :d], corners[:, 0])
        self._constant[:, 0] += 1.0
        self._sum, self._length = np.zeros(n), np.zeros(n)

    def add(self, layers: Layers) -> None:
        """Adds what lies in some layers. Local."""
        end = layers.first + len(layers.sums)
        last = end >= layers.shape[2]
        low, high = self._low[:, 2], self._high[:, 2]
        inside = ((high >= layers.first) | (layers.first == 0)) & ((low <= end) | last)
        cells = np.flatnonzero(inside)
        ends = np.cumsum(self._count[cells].prod(axis=1))
        parts = np.searchsorted(ends, np.arange(_LINES, ends[-1] if len(ends) else 0, _LINES))
        for some in np.split(cells, np.unique(parts)):
            if len(some):
                self._lines(some, layers)
        self._middles(cells, layers)

    def _lines(self, cells: IntArray, layers: Layers) -> None:
        """Adds what lies on the lines through cells."""
        counts = self._count[cells]
        each = counts.prod(axis=1)
        row = np.repeat(np.arange(len(cells)), each)
        number = np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each)
        along = counts[row, 1]
        layer = self._first[cells, 1][row] + number % along
        z = (layer + 0.5) * self._step[cells, 1][row]
        here = layers.has(np.floor(z).astype(np.int64))
        row, number, along, z = row[here], number[here], along[here], z[here]
        cell, shift = cells[row], (0.5 + _GOLDEN * layer[here]) % 1.0
        y = (self._first[cell, 0] + number // along + shift) * self._step[cell, 0]
        low, high = self._between(cell, y, z)
        here = high > low
        cell, low, high, y, z = cell[here], low[here], high[here], y[here], z[here]
        n = len(self._sum)
        self._sum += np.bincount(cell, layers.along(low, high, y, z), n)
        self._length += np.bincount(cell, high - low, n)

    def _between(
        self, cell: IntArray, y: FloatArray, z: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Where lines enter cells and leave them."""
        low, high = self._low[cell, 0], self._high[cell, 0]
        for m in range(self._gradient.shape[1]):
            slope, dy, dz = self._gradient[cell, m].T
            value = self._constant[cell, m] + dy * y + dz * z
            with np.errstate(all="ignore"):
                at = -value / slope
            low = np.where(slope > 0, np.fmax(low, at), low)
            high = np.where(slope < 0, np.fmin(high, at), high)
            high = np.where((slope == 0) & (value < 0), -np.inf, high)
        return low, high

    def _middles(self, cells: IntArray, layers: Layers) -> None:
        cells = cells[layers.has(np.floor(self._middle[cells, 2]).astype(np.int64))]
        x, y, z = self._middle[cells].T
        half = 0.5 * _MIDDLE * np.maximum((self._high - self._low)[cells, 0], _MIDDLE)
        self._sum[cells] += layers.along(x - half, x + half, y, z)
        self._length[cells] += 2 * half

    @property
    def means(self) -> FloatArray:
        """Of all layers, shape (n,)."""
        return np.asarray(self._sum / self._length)


def _inverse(matrices: FloatArray) -> FloatArray:
    """Inverses; of cells without volume zeros, so that lines within their box count."""
    whole = abs(np.linalg.det(matrices)) > np.finfo(np.float64).tiny
    result = np.zeros_like(matrices)
    result[whole] = np.linalg.inv(matrices[whole])
    return result
