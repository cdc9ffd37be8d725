"""`Turning`: the rotation of a rigid obstacle over time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Direction, check_components, unit_vector
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.shapes.turn import rotation
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import no_switch
from dolfin_elastic.model.values import Component, angle_of


class Turning(Record):
    """A rotation by any angle about an axis, right-handed.

    Attributes:
        point: On the axis before any motion, in the mesh's unit; the obstacle's motion moves it.
        axis: x, y, z or a direction; in a plane body z.
        angle: "90 deg", a number in rad, or a formula in t.
    """

    lengths: ClassVar[tuple[str, ...]] = ("point",)
    angles: ClassVar[Mapping[str, str]] = {"angle": "rad"}
    point: Point
    axis: Direction | None = None
    angle: Annotated[float | str, BeforeValidator(no_switch)]

    @model_validator(mode="after")
    def _read(self) -> Turning:
        _ = self.value
        return self

    @cached_property
    def value(self) -> Component:
        """The angle [rad] as a number or formula."""
        return angle_of(self.angle)

    def matrix(self, angle: float, dim: int) -> FloatArray:
        """The orthogonal matrix of an angle [rad], shape (dim, dim)."""
        return rotation(unit_vector(self.axis or "z"), angle)[:dim, :dim]

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where axis or point do not fit the body.

        Raises:
            InputError: With the key.
        """
        if axisymmetric:
            raise InputError(
                "an obstacle about the axis does not turn",
                expected="a motion along the axis; or a three-dimensional body",
            )
        if dim == 3 and self.axis is None:
            raise InputError("this key is missing", where="axis", expected='for example "z"')
        check_components(self.axis, 3, "axis")
        if dim == 2 and any(unit_vector(self.axis or "z")[:2]):
            raise InputError(
                "a plane body meets obstacles that turn about z only",
                where="axis",
                expected="leave it out",
            )
        check_components(self.point, dim, "point")
