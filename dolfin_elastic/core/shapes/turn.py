"""`Turn`: a rotation that places something beside a mesh."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from dolfin_elastic.core.errors import UnitError
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


class Turn(Record):
    """A rotation about an axis, right-handed.

    Attributes:
        axis: Its direction.
        angle: A number in degrees, or a text with a unit.
        point: On the axis; by default the origin.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point",)
    axis: Direction
    angle: Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_angle)]
    point: Annotated[tuple[MeshLength, ...], Field(min_length=3, max_length=3)] | None = None

    def check(self) -> None:
        """Raises where its axis has not three components."""
        check_components(self.axis, 3, "axis")

    def points(self, x: FloatArray) -> FloatArray:
        """Points [m] after it, shape (n, 3), by the formula of O. Rodrigues (1840).

        It is in metres.
        """
        n, angle = np.array(unit_vector(self.axis)), np.radians(_degrees(self.angle))
        centre = np.zeros(3) if self.point is None else np.array(self.point, dtype=np.float64)
        arm = x - centre
        across, twice = np.cross(n, arm), np.cross(n, np.cross(n, arm))
        return np.asarray(x + np.sin(angle) * across + (1 - np.cos(angle)) * twice)
