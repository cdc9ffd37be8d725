"""Directions as users write them: along an axis, or by components."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Field

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray

Axis = Literal["x", "y", "z"]
Along = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES = get_args(Along)
_NOT_SQUARE = 1e-3
"""Cosine of an angle that is more than a right angle with rounded components."""


def _nonzero(value: str | tuple[float, ...]) -> str | tuple[float, ...]:
    if not isinstance(value, str) and not any(value):
        raise ValueError("a direction cannot be zero")
    return value


Direction = Annotated[
    Along | Annotated[tuple[float, ...], Field(min_length=2, max_length=3)],
    AfterValidator(_nonzero),
]
"""A pydantic field type: x, y, z, -x, -y or -z, or two or three components of any length but 0."""


def vector_of(direction: str | Sequence[float]) -> tuple[float, ...]:
    """Components of a direction, of the length that they are written with; of an axis three."""
    if not isinstance(direction, str):
        return tuple(direction)
    sign = -1.0 if direction.startswith("-") else 1.0
    return tuple(sign if name == direction[-1] else 0.0 for name in "xyz")


def unit_vector(direction: str | Sequence[float]) -> tuple[float, float, float]:
    """Unit vector of a direction that is not zero; of two components it lies in the plane."""
    x, y, z = (*vector_of(direction), 0.0)[:3]
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


def square(x: str | Sequence[float], y: str | Sequence[float]) -> FloatArray:
    """Unit vectors along x and y and normal to both, one a row.

    Raises:
        InputError: x and y are not at a right angle.
    """
    a, b = np.array(unit_vector(x)), np.array(unit_vector(y))
    if abs(a @ b) > _NOT_SQUARE:
        raise InputError(
            f"x and y are at {np.degrees(np.arccos(np.clip(a @ b, -1, 1))):.4g} degrees",
            where="y",
            expected="a direction at a right angle to x",
        )
    b = np.array(unit_vector([*(b - (a @ b) * a)]))
    return np.array([a, b, np.cross(a, b)])


def check_count(vector: Sequence[object], count: int, where: str, expected: str = "") -> None:
    """Raises where a vector has not so many components.

    Args:
        where: Key of the vector, which errors name where it is wrong.
        expected: That in words; empty: the number.
    """
    if len(vector) != count:
        raise InputError(
            f"{len(vector)} components given", where=where, expected=expected or f"expected {count}"
        )


def check_components(vector: str | Sequence[object] | None, dim: int, where: str) -> None:
    """Raises where a vector or direction, if there is one, is none of a body.

    Args:
        dim: Of the body, and so many components.
        where: Key of the vector, which errors name where it is wrong.
    """
    if isinstance(vector, str) and vector[-1] not in "xyz"[:dim]:
        raise InputError(f"a plane body has no axis '{vector}'", where=where, expected="x or y")
    if vector is not None and not isinstance(vector, str):
        check_count(vector, dim, where, f"the body is {dim}-dimensional, expected {dim}")
