"""`Turned`: a shape that has been turned about a point, to be drawn and measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

import numpy as np
from pydantic import PrivateAttr

from dolfin_elastic.core.shapes.box import Box
from dolfin_elastic.core.shapes.shapes import Distance, Operations, Shape
from dolfin_elastic.core.shapes.triangles import Triangles, whole
from dolfin_elastic.core.types import FloatArray, Scalar


class Turned(Shape):
    """Another shape, in metres, after a rotation."""

    _shape: Shape = PrivateAttr()
    _matrix: FloatArray = PrivateAttr()
    _centre: FloatArray = PrivateAttr()

    @classmethod
    def of(cls, shape: Shape, matrix: FloatArray, centre: Sequence[float]) -> Self:
        """A shape after a rotation about a point.

        Args:
            matrix: Orthogonal, shape (dim, dim).
            centre: The point [m].
        """
        result = cls()
        result._shape, result._matrix = shape, np.eye(3)
        result._matrix[: len(matrix), : len(matrix)] = matrix
        result._centre = whole(centre)
        return result

    def distance(self, x: Sequence[Scalar], use: Operations) -> Distance:
        """See `Shape.distance`: of arrays only, on the side on which bodies may be."""
        places = np.stack([np.asarray(item, dtype=np.float64) for item in x], axis=-1)
        dim = places.shape[-1]
        R, c = self._matrix[:dim, :dim], self._centre[:dim]
        gaps, normals = self._shape.gaps(c + (places - c) @ R)
        return gaps, list(np.moveaxis(normals @ R.T, -1, 0))

    def triangles(self, near: Box, dim: int) -> Triangles:
        """See `Shape.triangles`."""
        R, c = self._matrix, self._centre
        middle, half = c + (near.middle - c) @ R, (near.high - near.low) / 2
        points, triangles = self._shape.drawn(Box(middle - half, middle + half), dim)
        every = np.zeros((len(points), 3))
        every[:, : points.shape[1]] = points
        return (c + (every - c) @ R.T)[:, : points.shape[1]], triangles
