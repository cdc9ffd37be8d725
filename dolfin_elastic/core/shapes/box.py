"""`Box`: what lies between two corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import metres


@dataclass(frozen=True)
class Box:
    """A box along the axes.

    Attributes:
        low: Smallest coordinates [m], shape (dim,).
        high: Largest coordinates [m].
    """

    low: FloatArray
    high: FloatArray

    @staticmethod
    def between(
        corners: Sequence[Sequence[float | str]], scale: float, dim: int, where: str
    ) -> Box:
        """The box between two opposite corners. See `point_of`."""
        a, b = (np.array(point_of(corner, scale, dim, where)) for corner in corners)
        return Box(np.minimum(a, b), np.maximum(a, b))

    @property
    def diagonal(self) -> float:
        """Its length [m]."""
        return float(np.linalg.norm(self.high - self.low))

    @property
    def middle(self) -> FloatArray:
        """Its centre [m]."""
        return np.asarray((self.low + self.high) / 2)

    def beyond(self, x: FloatArray) -> FloatArray:
        """How far points, shape (..., dim), lie beyond its faces along each axis [m], else 0."""
        return np.asarray(np.maximum(np.maximum(self.low - x, x - self.high), 0.0))

    def outside(self, x: FloatArray) -> FloatArray:
        """Distance of points, shape (..., dim), from the box [m], 0 within."""
        return np.asarray(np.linalg.norm(self.beyond(x), axis=-1))

    def volume(self, dim: int) -> float:
        """Its volume [m^3], or area in 2D."""
        return float(np.prod((self.high - self.low)[:dim]))


def point_of(
    values: Sequence[float | str], scale: float, dim: int, where: str
) -> tuple[float, ...]:
    """A point that is written beside a mesh, in metres, with as many coordinates as the body has.

    Args:
        values: Two or three coordinates: bare numbers in the mesh's unit, or texts with a unit.
        scale: Metres per unit of length of the mesh.
        dim: Of the body; further coordinates are left out.

    Raises:
        MeshError: There are too few.
    """
    if len(values) < dim:
        raise MeshError(
            f"the body is three-dimensional, {list(values)} is not",
            where=where,
            expected="3 coordinates",
        )
    return tuple(metres(value, scale) for value in values[:dim])
