"""`Placed`: a body that is turned and moved before it becomes a part of another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from dolfin_elastic.core.errors import MeshError, keyed
from dolfin_elastic.core.shapes.turn import Turn
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import MeshLength, metres

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body

Place = Annotated[tuple[MeshLength, ...], Field(min_length=2, max_length=3)]


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

    def vectors(self, v: FloatArray) -> FloatArray:
        """Vectors of the body after it was turned, shape (..., dim or more).

        Raises:
            MeshError: See `Turn.matrix`.
        """
        if self.turn is None:
            return v
        with keyed("turn"):
            return self.turn.vectors(v, self.body.dim)

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
