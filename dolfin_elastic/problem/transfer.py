"""Unknowns of one mesh as a first guess on a refined one."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.mesh.refine.refinement import Refinement
from dolfin_elastic.problem.problem import Problem


def refined_unknowns(
    refinement: Refinement, coarse: Problem, w: fem.Function, fine: Problem
) -> FloatArray:
    """All unknowns of a problem, interpolated to the same problem on a finer mesh. Collective.

    The functions are the same on cells whose nodes were not moved to a CAD surface.

    Args:
        refinement: From the body of one to that of the other.
        coarse: The problem that was solved, without periodic faces.

    Returns:
        The local array of `fine.w`, ghosts included.
    """
    guess = fem.Function(fine.W)
    fields = coarse.unknowns.auxiliary_fields
    if not fields:
        guess.x.array[:] = _carried(refinement, coarse.V, w.x.array, fine.V)
    for i, scale in enumerate((1.0, *(_rescaled(coarse, fine, f.name) for f in fields))):
        if fields:
            (before, here), (after, there) = (collapsed(p.W.sub(i)) for p in (coarse, fine))
            guess.x.array[there] = scale * _carried(refinement, before, w.x.array[here], after)
    guess.x.scatter_forward()
    return np.asarray(guess.x.array)


def _rescaled(coarse: Problem, fine: Problem, name: str) -> float:
    """An unknown is its field over a scale, which depends on the cells' size."""
    return float(coarse.unknowns.scale[name].value) / float(fine.unknowns.scale[name].value)


def _carried(
    refinement: Refinement, before: fem.FunctionSpace, values: AnyArray, after: fem.FunctionSpace
) -> FloatArray:
    """The local array of a function of a Lagrange space, continuous or not. Collective."""
    width = before.dofmap.index_map_bs
    rows = values.reshape(-1, width)[before.dofmap.list]
    found = refinement.interpolated(int(before.ufl_element().degree), rows)
    index = after.dofmap.index_map
    table = np.zeros((index.size_local + index.num_ghosts, width))
    table[after.dofmap.list] = found
    return table.reshape(-1)
