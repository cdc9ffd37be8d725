"""`Turn`: a rotation that places something beside a mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from dolfin_elastic.core.errors import MeshError, UnitError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Direction, check_components, unit_vector
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import MeshLength, no_switch, to_si


def _degrees(angle: float | str) -> float:
    """An angle [degrees], of a bare number or of a text with a unit."""
    try:
        return float(angle)
    except ValueError:
        return float(np.degrees(to_si(str(angle), "rad")))


def _angle(angle: float | str) -> float | str:
    try:
        _degrees(angle)
    except UnitError as error:
        wanted = 'expected a number in degrees, or a text such as "0.5 rad"'
        raise UnitError(error.what, expected=wanted) from None
    return angle


def rotation(axis: Sequence[float], angle: float) -> FloatArray:
    """The orthogonal matrix of a right-handed rotation, shape (3, 3).

    Source: O. Rodrigues, J. Math. Pures Appl. 5 (1840) 380.

    Args:
        axis: Unit vector.
        angle: Of any size [rad].
    """
    cross = np.cross(axis, np.eye(3)).T  # cross @ a = axis x a
    # 1 - cos(a) = 2 sin^2(a/2): small angles lose no digits.
    less = 2 * np.sin(angle / 2) ** 2
    return np.asarray(np.eye(3) + np.sin(angle) * cross + less * cross @ cross)


class Turn(Record):
    """A rotation about an axis, right-handed.

    Attributes:
        axis: Its direction; of a plane body it may be left out, and is z.
        angle: A number in degrees, or a text with a unit.
        point: On the axis; by default the origin.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point",)
    angles: ClassVar[Mapping[str, str]] = {"angle": "deg"}
    axis: Direction | None = None
    angle: Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_angle)]
    point: Annotated[tuple[MeshLength, ...], Field(min_length=2, max_length=3)] | None = None

    def matrix(self, dim: int) -> FloatArray:
        """The orthogonal matrix, shape (dim, dim).

        Raises:
            MeshError: A body of this dimension has no such axis.
        """
        if self.axis is None and dim == 3:
            raise MeshError("the axis is missing", where="axis", expected='for example "z"')
        check_components(self.axis, 3, "axis")
        n = unit_vector(self.axis or "z")
        if dim == 2 and (n[0] or n[1]):
            raise MeshError(
                "a plane part turns about z only", where="axis", expected="leave it out"
            )
        return rotation(n, np.radians(_degrees(self.angle)))[:dim, :dim]

    def vectors(self, v: FloatArray, dim: int) -> FloatArray:
        """Vectors of a body of this dimension after it, shape (..., dim or more)."""
        R = self.matrix(dim)
        # Not by BLAS, whose round-off depends on how many vectors a rank has.
        rows = [sum(v[..., j] * R[i, j] for j in range(dim)) for i in range(dim)]
        return np.concatenate([np.stack(rows, axis=-1), v[..., dim:]], axis=-1)
