"""A mode in a word, such as "bending in y": which rigid motion of its cross-sections moves most."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import extent
from dolfin_elastic.mesh.criteria import bounding_box
from dolfin_elastic.mesh.geometry.curved import cell_volumes

if TYPE_CHECKING:
    from dolfinx import fem

    from dolfin_elastic.problem.problem import Problem

_SLICES = 24
"""Slices across the longest side of the body."""
_MOST = 0.5
"""Share of the mean square of the motion that is enough to name it."""
_CLEAR = 0.9
"""Share of a motion across the body along one axis that is enough to name the axis."""
_AXES = "xyz"


def shape_in_words(problem: Problem, u: fem.Function) -> str:
    """What the slices across the longest side do most. Collective.

    Each slice moves along that side (stretching), across it (bending), or turns about it (torsion).
    Where none of these has half of the mean square of the motion, parts of the slices move against
    each other, as the prongs of a tuning fork do, or the section changes its shape.

    Args:
        u: The mode, on `problem.V`.
    """
    body, dim = problem.body, problem.body.dim
    cells = body.owned_cells()
    nodes = problem.V.dofmap.list[: len(cells)]
    x = problem.places[nodes, :dim].mean(axis=1)
    moved = u.x.array.reshape(-1, dim)[nodes].mean(axis=1)
    weight = cell_volumes(body.mesh)[cells]
    sides = np.array(extent(body))
    along = int(np.argmax(sides))
    across = [k for k in range(dim) if k != along]
    low = bounding_box(body.mesh)[0][along]
    number = np.clip((_SLICES * (x[:, along] - low) / sides[along]).astype(int), 0, _SLICES - 1)

    def sums(values: FloatArray) -> FloatArray:
        """Of each slice, weighted by volume, shape (slices, columns)."""
        rows = np.zeros((_SLICES, values.shape[1]))
        np.add.at(rows, number, weight[:, None] * values)
        return np.asarray(total(body.comm, rows))

    mass = np.maximum(sums(np.ones((len(x), 1))), 1e-300)
    mean, centre = sums(moved) / mass, sums(x) / mass
    square = float(sums((moved**2).sum(axis=1, keepdims=True)).sum()) or 1.0
    shares = (mass * mean**2).sum(axis=0) / square
    turning = 0.0
    if dim == 3:
        a, b = across
        r = x - centre[number]
        moment = r[:, [a]] * moved[:, [b]] - r[:, [b]] * moved[:, [a]]
        inertia = sums(r[:, [a]] ** 2 + r[:, [b]] ** 2)
        turning = float((sums(moment) ** 2 / np.maximum(inertia, 1e-300)).sum()) / square
    bending = float(shares[across].sum())
    names = {
        "stretching along " + _AXES[along]: float(shares[along]),
        "torsion about " + _AXES[along]: turning,
        _bending(shares, across): bending,
    }
    name, most = max(names.items(), key=lambda one: one[1])
    if most >= _MOST:
        return name
    each = sums(moved**2).sum(axis=0) / square
    axis = int(np.argmax(each))
    if each[axis] >= _CLEAR:
        return f"parts against each other in {_AXES[axis]}"
    return "change of the cross-section" if dim == 3 else "mixed"


def _bending(shares: FloatArray, across: list[int]) -> str:
    axis = max(across, key=lambda k: shares[k])
    clear = shares[axis] >= _CLEAR * sum(shares[k] for k in across)
    return f"bending in {_AXES[axis] if clear else ' and '.join(_AXES[k] for k in across)}"
