"""How much of a material's strength the recovered stress uses, where that is more than one number.

The stress or strain that a criterion judges is recovered as the Cauchy stress is, component by
component, and the criterion evaluated from it: a criterion has kinks, a stress has none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from dolfinx import fem
from dolfinx.fem import Constant
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.strength import Strength
from dolfin_elastic.results.fields import cauchy_stress, judged_tensor

if TYPE_CHECKING:
    from dolfin_elastic.model.materials.law import Law
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

_WHOLE = (0, 3, 4, 3, 1, 5, 4, 5, 2)
"""Nine components, row by row, of six: xx, yy, zz, xy, xz, yz."""


def judged_apart(problem: Problem, region: MaterialRegion, w: fem.Function) -> Expr | None:
    """The tensor that a region's strength judges, 3x3; None where it is the Cauchy stress.

    Args:
        w: All unknowns.
    """
    law, F = cast("Law", problem.weak_form.response(region, w)), problem.weak_form.F(w)
    strength = law.allowable
    assert isinstance(strength, Strength)
    if not strength.of_strain and (law.linear or not strength.directed):
        return None
    return judged_tensor(law, F, cauchy_stress(law, F))


def constant_axis(region: MaterialRegion) -> FloatArray | None:
    """The axis of a region's strength where it is the same everywhere, shape (3,).

    None where it varies; of a strength without a direction zeros.
    """
    strength = region.law.allowable
    assert isinstance(strength, Strength)
    if not strength.directed:
        return np.zeros(3)
    given = strength.axis
    if given is None:
        given = getattr(region.law, region.law.directions[0])
        if isinstance(given, Constant):
            given = given.value
    if isinstance(given, Expr):
        return None
    vector = np.resize(np.append(np.asarray(given, dtype=np.float64), 0.0), 3)
    return np.asarray(vector / np.linalg.norm(vector))


def used_of(strength: Strength, rows: FloatArray, axis: FloatArray) -> FloatArray:
    """Utilisation of a strength, shape (...).

    Args:
        rows: Six components of the tensor that it judges, shape (..., 6).
        axis: Of any length but 0, shape (3,) or (..., 3); without a direction it does not count.
    """
    shape, unit = rows.shape[:-1], None
    if strength.directed:
        with np.errstate(invalid="ignore"):  # of nodes of other regions
            unit = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        unit = np.broadcast_to(unit, (*shape, 3)).reshape(-1, 3)
    return strength.used_at(rows[..., _WHOLE].reshape(-1, 3, 3), unit).reshape(shape)
