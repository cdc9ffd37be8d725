"""Fields of cells in one material region: UFL components, and their compiled kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.jit.cell_integrals import CellExpression
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.materials.law import Law, ModifiedLaw, once
from dolfin_elastic.results.components import ComponentForms, check_axes
from dolfin_elastic.results.fields import table_of

if TYPE_CHECKING:
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem


_UNKNOWNS: WeakKeyDictionary[Problem, fem.Function] = WeakKeyDictionary()


def unknowns_of_outputs(problem: Problem) -> fem.Function:
    """The unknowns that the kernels of outputs read: one function for all outputs of a problem.

    Whoever evaluates a state writes it there before.  Collective.
    """
    if problem not in _UNKNOWNS:
        _UNKNOWNS[problem] = fem.Function(problem.W)
    return _UNKNOWNS[problem]


def cell_components(
    problem: Problem, region: MaterialRegion, w: fem.Function, names: Sequence[str], where: str = ""
) -> list[list[Expr] | None]:
    """Components of fields of cells for the law of one region.

    Args:
        w: All unknowns of the state.
        names: Fields of `field_table` that have a formula.
        where: Key of the case file that asks for the fields, for the message.

    Returns:
        For each field the components of its formula, of tensors row by row; None: the law has no
        such quantity.

    Raises:
        InputError: An energy density of a law without a strain energy, or unknown axes.
    """
    table = table_of(problem)
    check_axes(names, problem.axes, table)
    F = problem.weak_form.F(w)
    law = cast("Law", _Once(problem.weak_form.response(region, w)))
    if "energy_density" in names and not law.has_energy:
        raise InputError(
            f"the law of '{region.name}' has no strain energy",
            where=where,
            expected="leave the field 'energy_density' out",
        )
    part = ComponentForms(problem, law, F)
    fields = [table[name] for name in names]
    tensors = (one.of_cell(law, F) if (c := one.component) is None else part(c) for one in fields)
    return [None if tensor is None else _components(tensor) for tensor in tensors]


@dataclass(frozen=True)
class _Once(ModifiedLaw):
    """A law whose stress is one expression for all fields, see `once`.

    Attributes:
        law: The law of a region.
    """

    law: Law | ModifiedLaw

    def energy(self, F: Expr) -> Expr:
        """See `ModifiedLaw.energy`."""
        return self.law.energy(F)

    @once
    def stress(self, F: Expr) -> Expr:
        """See `ModifiedLaw.stress`."""
        return self.law.stress(F)


def _components(tensor: Expr) -> list[Expr]:
    if not tensor.ufl_shape:
        return [tensor]
    if len(tensor.ufl_shape) == 1:
        return [tensor[i] for i in range(len(tensor))]
    return [tensor[i, j] for i in range(3) for j in range(3)]


@dataclass(frozen=True)
class CellKernel:
    """Compiled fields of cells in one region; evaluating it is not collective.

    Attributes:
        expression: All components that the law has.
        columns: Their columns in a table with the components of all fields.
    """

    expression: CellExpression
    columns: IntArray

    def __call__(self, cells: IndexArray) -> AnyArray:
        """Values in cells of this rank.

        Args:
            cells: Local cells of the region.

        Returns:
            Shape (cells, points, columns).
        """
        points, columns = self.expression.size // len(self.columns), len(self.columns)
        return self.expression.eval(cells).reshape(len(cells), points, columns)


def cell_kernel(
    problem: Problem,
    region: MaterialRegion,
    w: fem.Function,
    names: Sequence[str],
    points: FloatArray,
    where: str = "",
) -> CellKernel | None:
    """Compiles fields of cells at points of the reference cell. Collective.

    One kernel gives all fields, so that common subexpressions are computed once.

    Args:
        w: All unknowns of the states that are to be evaluated.
        names: Fields of `field_table` that have a formula.
        points: Shape (points, dim).
        where: See `cell_components`.

    Returns:
        None if the region's law has none of the fields.

    Raises:
        InputError: See `cell_components`.
    """
    components = cell_components(problem, region, w, names, where)
    table = table_of(problem)
    widths = [table[name].evaluated for name in names]
    columns = np.flatnonzero(np.repeat([part is not None for part in components], widths))
    if not len(columns):
        return None
    vector = ufl.as_vector([component for part in components if part for component in part])
    return CellKernel(CellExpression(vector, points, w, problem.jit), columns)
