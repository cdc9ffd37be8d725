"""`Placed`: a body that is turned and moved before it becomes a part of another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from dolfin_elastic.core.errors import MeshError, UnitError
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Direction, unit_vector
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import MeshLength, metres, no_switch, to_si

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body

Place = Annotated[tuple[MeshLength, ...], Field(min_length=2, max_length=3)]


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
        axis: Its direction; of a plane body it may be left out, and is z.
        angle: A number in degrees, or a text with a unit.
        point: On the axis; by default the origin of the mesh.
    """

    axis: Direction | None = None
    angle: Annotated[float | str, BeforeValidator(no_switch), AfterValidator(_angle)]
    point: Place | None = None

    def matrix(self, dim: int) -> FloatArray:
        """The orthogonal matrix, shape (dim, dim), by the formula of O. Rodrigues (1840).

        Raises:
            MeshError: A body of this dimension has no such axis.
        """
        if self.axis is None and dim == 3:
            raise MeshError("the axis is missing", where="turn.axis", expected='for example "z"')
        n = np.array(unit_vector(self.axis or "z"))
        if dim == 2 and (n[0] or n[1]):
            raise MeshError(
                "a plane part turns about z only", where="turn.axis", expected="leave it out"
            )
        angle = np.radians(_degrees(self.angle))
        cross = np.cross(n, np.eye(3)).T  # cross @ a = n x a
        result = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        return np.asarray(result[:dim, :dim])


@dataclass(frozen=True)
class Placed:
    """A body that is first turned, then moved.

    Attributes:
        body: The body where its mesh has it.
        move: By how much along x, y and z, bare numbers in the unit of its mesh; none: not at all.
        turn: How it is turned; None: not at all.

    Example:
        Placed(pin, move=[0, 0, "12 mm"], turn=Turn(axis="z", angle=30))
    """

    body: Body
    move: Sequence[float | str] | None = None
    turn: Turn | None = None

    @cached_property
    def rotation(self) -> FloatArray | None:
        """The matrix of `turn`, shape (dim, dim); None where nothing turns.

        Raises:
            MeshError: See `Turn.matrix`.
        """
        return None if self.turn is None else self.turn.matrix(self.body.dim)

    def vectors(self, v: FloatArray) -> FloatArray:
        """Vectors of the body after it was turned, shape (..., dim or more)."""
        if (rotation := self.rotation) is None:
            return v
        d = len(rotation)
        # Not by BLAS, whose round-off depends on how many vectors a rank has.
        rows = [sum(v[..., j] * rotation[i, j] for j in range(d)) for i in range(d)]
        return np.concatenate([np.stack(rows, axis=-1), v[..., d:]], axis=-1)

    def points(self, x: FloatArray) -> FloatArray:
        """Points [m] of the body in their final positions, shape (n, dim).

        Raises:
            MeshError: A vector has another number of components than the body.
        """
        centre = self._vector("turn.point", None if self.turn is None else self.turn.point)
        moved = self.vectors(x - centre) + centre if self.turn is not None else x
        return np.asarray(moved + self._vector("move", self.move))

    def _vector(self, key: str, components: Sequence[float | str] | None) -> FloatArray:
        if components is None:
            return np.zeros(self.body.dim)
        if len(components) != self.body.dim:
            raise MeshError(
                f"{len(components)} components given",
                where=key,
                expected=f"the part is {self.body.dim}-dimensional, expected {self.body.dim}",
            )
        return np.array([metres(c, self.body.unit.metres) for c in components])


def check_names(names: Mapping[str, object]) -> None:
    """Refuses names of parts that no table can have, or of which others could not be told apart.

    Raises:
        MeshError: There is none, or one has a point or is blank.
    """
    if not names:
        raise MeshError("there is no part", expected='for example pin = {file = "pin.msh"}')
    for name in names:
        if "." in name or not name.strip() or not name.isprintable():
            raise MeshError(
                f"'{name}' is no name of a part: a point stands between the part and its own names",
                expected="a name without points, such as pin_2",
            )
