"""What a law that yields allows of the stress that is recovered at nodes.

The stress of the finite element solution obeys the yield condition at every point at which the law
is evaluated.  A polynomial that is fitted to it does not: beside a clamped edge it is up to 1.7
times the yield stress at the nodes.  So in each cell the deviator of what is recovered is made
smaller, where its von Mises stress is above the largest one that the law allows at the sampling
points of the cell; nodes have the mean of the cells around them, and the von Mises stress of a mean
is at most the mean of theirs.
"""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.model.materials.plasticity import PLASTIC_STRAIN, Plastic
from dolfin_elastic.model.materials.stepped import stepped
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem

_NORMAL = 3
"""Normal components come first among the six of a stress."""


class YieldLimit:
    """The von Mises stress at which a material yields, at points of cells [Pa]. Collective to make.

    With kinematic hardening an upper bound: the yield stress and the largest back stress that the
    equivalent plastic strain can have left.

    Args:
        w: All unknowns of the states that are looked at.
        points: Of the reference cell.
    """

    def __init__(
        self, problem: Problem, region: MaterialRegion, w: fem.Function, points: FloatArray
    ) -> None:
        law, over_step = region.law, stepped(problem.weak_form.response(region, w))
        assert isinstance(law, Plastic)
        assert over_step is not None
        strain = ufl.max_value(over_step.past[PLASTIC_STRAIN.name], 0.0)
        limit = law.flow.stress(strain) + law.back_slope * strain
        self._kernel = CellExpression(ufl.as_vector([limit]), points, w, problem.jit)

    def __call__(self, cells: IndexArray) -> FloatArray:
        """Its values, shape (cells, points). Not collective."""
        return np.asarray(self._kernel.eval(cells).reshape(len(cells), self._kernel.size))


def bounded(stress: FloatArray, von_mises: FloatArray, most: FloatArray) -> FloatArray:
    """Stresses with a smaller deviator where their von Mises stress is too large.

    Args:
        stress: Six components, and more that are left as they are, shape (cells, nodes, 6 or more).
        von_mises: Of these [Pa], shape (cells, nodes).
        most: What it may be [Pa], shape (cells,).
    """
    excess = von_mises > most[:, None]
    if not excess.any():
        return stress
    factor = np.where(excess, most[:, None] / np.where(excess, von_mises, 1.0), 1.0)[..., None]
    result = stress.copy()
    mean = stress[..., :_NORMAL].mean(axis=-1, keepdims=True)
    result[..., :_NORMAL] = mean + factor * (stress[..., :_NORMAL] - mean)
    result[..., _NORMAL:6] = factor * stress[..., _NORMAL:6]
    return result
