"""A mode in a few words, such as "bending in y"; where no name is sure, its direction alone."""

from __future__ import annotations

from collections.abc import Sequence
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
_SLENDER = 1 / 8
"""Radius of gyration about the middle line, over the length, up to which a body is a straight bar:
that of a square bar three times as long as high."""
_FLAT = 1 / 5
"""Thickness over width up to which a body in one plane is a plate."""
_AXES = "xyz"


def shape_in_words(problem: Problem, u: fem.Function) -> str:
    """What a mode does, as far as it is sure. Collective.

    In a straight bar the slices across it move along it (stretching), across it (bending), or turn
    about it (torsion); where none of these has half of the mean square of the motion, the section
    changes its shape or its parts move against each other, as the prongs of a tuning fork do.  What
    a plate does across its plane is bending.  Of other bodies, such as brackets, slices are no
    sections: only the direction of the motion is told.

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
    centre, each = sums(x) / mass, sums(moved**2).sum(axis=0)
    square = float(each.sum()) or 1.0
    each = each / square
    middle = (mass * centre).sum(axis=0) / mass.sum()
    gyration = np.sqrt(sums((x - middle)[:, across] ** 2).sum() / mass.sum())
    if gyration > _SLENDER * sides[along]:
        thin, wide = sorted(range(dim), key=lambda k: sides[k])[:2]
        plate = dim == 3 and sides[thin] <= _FLAT * sides[wide] and each[thin] >= _CLEAR
        return f"bending in {_AXES[thin]}" if plate else f"motion in {_directions(each)}"
    mean = sums(moved) / mass
    shares = (mass * mean**2).sum(axis=0) / square
    turning = 0.0
    if dim == 3:
        a, b = across
        r = x - centre[number]
        moment = r[:, [a]] * moved[:, [b]] - r[:, [b]] * moved[:, [a]]
        inertia = sums(r[:, [a]] ** 2 + r[:, [b]] ** 2)
        turning = float((sums(moment) ** 2 / np.maximum(inertia, 1e-300)).sum()) / square
    names = {
        "stretching along " + _AXES[along]: float(shares[along]),
        "torsion about " + _AXES[along]: turning,
        "bending in " + _directions(shares, across): float(shares[across].sum()),
    }
    name, most = max(names.items(), key=lambda one: one[1])
    if most >= _MOST:
        return name
    axis = int(np.argmax(each))
    against = np.abs(mass * mean).sum(axis=0) < _MOST * sums(np.abs(moved)).sum(axis=0)
    if each[axis] >= _CLEAR and against[axis]:
        return f"parts against each other in {_AXES[axis]}"
    clear = dim == 3 and each[axis] < _CLEAR
    return "change of the cross-section" if clear else f"motion in {_directions(each)}"


def _directions(shares: FloatArray, axes: Sequence[int] = (0, 1, 2)) -> str:
    """The fewest of the axes along which nearly all of the motion goes, as "x and y"."""
    ordered = sorted(axes[: len(shares)], key=lambda k: -shares[k])
    enough = _CLEAR * sum(shares[k] for k in ordered)
    count = next(n for n in range(1, 4) if sum(shares[k] for k in ordered[:n]) >= enough)
    named = [_AXES[k] for k in sorted(ordered[:count])]
    return " and ".join(filter(None, [", ".join(named[:-1]), named[-1]]))
