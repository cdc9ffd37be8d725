"""Material directions in the reference configuration: fibres and axes of anisotropic laws.

In a record a direction is a list of three components (two in a plane).  A law reads it through
`direction`, to which a list of numbers and a UFL vector are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import ufl
from ufl.core.expr import Expr

Axis = Literal["x", "y", "z"]


def axis_vector(axis: object) -> object:
    """The unit vector of "x", "y" or "z"; any other value unchanged."""
    return [float(name == axis) for name in "xyz"] if isinstance(axis, str) else axis


def as_floats(value: object) -> list[float] | None:
    """A list of numbers as floats; None for anything else."""
    if not isinstance(value, list | tuple) or not value:
        return None
    if any(isinstance(item, bool) or not isinstance(item, int | float) for item in value):
        return None
    return [float(item) for item in value]


def direction(value: Expr | Sequence[float]) -> Expr:
    """A direction as a UFL unit vector with three components.

    Args:
        value: A list of numbers, or a UFL vector of any length; two components lie in the plane.
    """
    vector = value if isinstance(value, Expr) else ufl.as_vector(list(value))
    if len(vector) == 2:
        vector = ufl.as_vector([vector[0], vector[1], 0])
    return vector / ufl.sqrt(ufl.inner(vector, vector))


def frame(axis1: Expr | Sequence[float], axis2: Expr | Sequence[float]) -> tuple[Expr, Expr, Expr]:
    """Orthonormal frame of an orthotropic material, three UFL vectors (Gram-Schmidt).

    Args:
        axis1: First direction, of any length: numbers or a UFL vector.
        axis2: Direction in the plane of the first two axes, not parallel to axis1.
    """
    first, towards = direction(axis1), direction(axis2)
    second = direction(towards - ufl.inner(towards, first) * first)
    return first, second, ufl.cross(first, second)
