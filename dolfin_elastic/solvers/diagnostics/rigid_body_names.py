"""Rigid motions in words: directions, axes, and a point that each axis goes through."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import METRE, LengthUnit

_SAME = 1e-6
"""Differences of directions and places, over the body's size, that nobody means."""


def motions_in_words(
    null: FloatArray, centre: FloatArray, size: float, unit: LengthUnit = METRE
) -> list[str]:
    """Rigid motions in words.

    Args:
        null: Orthonormal columns of translations, then rotations about `centre` in units of
            1/`size`, shape (6, motions), in a plane (3, motions).
        centre: What rotations are about [m].
        size: Length by which places were divided [m].
    """
    if null.shape[1] == len(null):
        return ["move and turn freely"]
    dim = len(centre)
    shifts, turns = null[:dim], null[dim:]
    _, sizes, mixes = np.linalg.svd(turns)
    rank = int(np.sum(sizes > _SAME))
    along = shifts @ mixes[rank:].T  # combinations that do not turn
    words = [f"move along {_direction(d)}" for d in _basis(along)]
    for axis in _basis(turns):
        mix = np.linalg.lstsq(turns, axis, rcond=_SAME)[0]
        shift = shifts @ mix
        shift -= along @ (np.linalg.pinv(along) @ shift) if along.size else 0.0
        words.append(_turn(axis, shift, centre, size, unit))
    return words


def _turn(
    axis: FloatArray, shift: FloatArray, centre: FloatArray, size: float, unit: LengthUnit
) -> str:
    """Rotation about an axis: through the point that it leaves where it is.

    The velocity shift + axis x (x - centre) is along the axis at the point
    centre + axis x shift/|axis|^2 (Chasles).
    """
    if len(centre) == 2:
        point = centre + size * np.array([-shift[1], shift[0]]) / axis[0]
        return f"turn about z through {_place(point, size, unit)}"
    point = centre + size * np.cross(axis, shift)
    while_moving = ""
    if abs(float(shift @ axis)) > _SAME:
        while_moving = (
            f" while it moves {unit.length(size * float(shift @ axis))} along it per radian"
        )
    return f"turn about {_direction(axis)} through {_place(point, size, unit)}{while_moving}"


def _basis(columns: FloatArray) -> list[FloatArray]:
    """Orthonormal vectors that span the columns, coordinate axes first."""
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    span = left[:, sizes > _SAME]
    result: list[FloatArray] = []
    inside = span @ span.T
    for axis in [*np.eye(len(columns)), *span.T]:
        rest = axis - sum((f * (f @ axis) for f in result), np.zeros(len(axis)))
        length = np.linalg.norm(rest)
        in_span = np.linalg.norm(inside @ axis - axis) < _SAME
        if in_span and length > _SAME and len(result) < span.shape[1]:
            result.append(rest / length)
    return result


def _direction(vector: FloatArray) -> str:
    for name, part in zip("xyz", vector, strict=False):
        if abs(part) > 1 - _SAME:
            return name
    first = vector[np.argmax(np.abs(vector) > _SAME)]
    return _text(vector * np.sign(first), 1.0)


def _place(point: FloatArray, size: float, unit: LengthUnit) -> str:
    return unit.point(np.where(np.abs(point) < _SAME * size, 0.0, point))


def _text(vector: FloatArray, size: float) -> str:
    rounded = np.where(np.abs(vector) < _SAME * size, 0.0, vector)
    return "(" + ", ".join(f"{x:.4g}" for x in rounded) + ")"
