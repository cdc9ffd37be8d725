"""Components of vectors and tensors in local axes, and in those of a material.

Axes with a name (`model/axes.py`) are directions of the undeformed body, and do not turn with it.
The axes of a material are those of its law: axis 1 along its first direction, axis 2 in the plane
of both, axis 3 normal to it.  A law with one direction has as axis 2 what is nearest to the
coordinate axis most normal to it.

At finite strain the material's axes have two configurations.  In the reference configuration they
are e_i as above; in the current one axis 1 is F e_1 over its length, the direction of the deformed
fibre (Holzapfel, Nonlinear Solid Mechanics (2000), section 6.7), and axis 3 is normal to F e_1 and
F e_2, the deformed ply: the direction of cof F e_3 by Nanson's formula (ibid., (2.54)).  Each index
of a tensor has the axes of the configuration that it belongs to: both of the Cauchy stress the
current ones, both of the second Piola-Kirchhoff stress the reference ones, and of P and F the first
index the current and the second index the reference ones.  A linear law has one configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.model.axes import JOINT, MATERIAL, LocalAxes, PlacedAxes
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.spatial import frame
from dolfin_elastic.results.field import Component, FieldTable
from dolfin_elastic.results.fields import FIELDS, fibre_of, table_of

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem


def check_axes(
    names: Iterable[str],
    axes: Mapping[str, LocalAxes | PlacedAxes],
    table: FieldTable = FIELDS,
) -> None:
    """Checks that the axes of components exist, and have the directions that are asked for.

    Args:
        names: Of fields, see `field_table`; others are passed over.
        axes: Name to local axes; those of materials are not among them.
        table: See `field_table`; by default without fields of a body.

    Raises:
        InputError: They do not.
    """
    for name in names:
        component = table[name].component if name in table else None
        if component is None or component.axes == MATERIAL:
            continue
        if component.axes not in axes:
            known = [*axes, MATERIAL]
            raise InputError(
                f"'{name}': there are no axes '{component.axes}'",
                expected=f"{nearest(component.axes, known)}, or a table [axes.{component.axes}]",
            )
        letters = axes[component.axes].letters
        if not set(component.letters) <= set(letters):
            first = letters[0] * len(component.letters)
            raise InputError(
                f"'{name}': the axes '{component.axes}' are {', '.join(letters)}",
                expected=f"for example {component.field}_{first}{JOINT}{component.axes}",
            )


def component_rows(
    problem: Problem, component: Component, rows: AnyArray, X: FloatArray
) -> FloatArray:
    """A component of a vector or tensor at places.

    Args:
        rows: Components along x, y, z, shape (n, 3 or 9); of a plane vector (n, 2).
        X: Places in the reference configuration [m], shape (n, 2 or 3).

    Returns:
        Shape (n, 1).
    """
    axes = problem.axes[component.axes].at(X)
    i, *j = component.indices
    if not j:
        return np.einsum("na,na->n", rows, axes[:, i, : rows.shape[1]])[:, None]
    tensors = rows.reshape(-1, 3, 3)
    return np.einsum("nab,na,nb->n", tensors, axes[:, i], axes[:, j[0]])[:, None]


class ComponentForms:
    """The same in UFL inside the cells of a material.

    All components share one expression of each tensor and of each axes.

    Args:
        law: The one of the cells' material, see `cell_components`.
        F: Deformation gradient, 3x3.
    """

    def __init__(self, problem: Problem, law: Law, F: Expr) -> None:
        self._table = table_of(problem)
        self._whole = cache(lambda name: self._table[name].of_cell(law, F))
        self._axes = cache(lambda name: _axes(problem, name, law, F))

    def __call__(self, component: Component) -> Expr | None:
        """A component; of a field that follows in NumPy the tensor from which it does, in the axes.

        Returns:
            None: the law has no such quantity, or no axes.
        """
        field, value = self._table[component.field], self._whole(component.field)
        axes = self._axes(component.axes)
        if value is None or axes is None:
            return None
        left, right = (axes[field.current > n] for n in (0, 1))

        # Sums over fixed indices: expressions of entries are found again.
        def along(a: Expr, b: Expr) -> Expr:
            return sum(a[i] * value[i, j] * b[j] for i in range(3) for j in range(3))

        if field.of_tensor is not None:
            return ufl.as_matrix([[along(a, b) for b in right] for a in left])
        i, *j = component.indices
        return along(left[i], right[j[0]]) if j else ufl.inner(left[i], value)


def _axes(problem: Problem, name: str, law: Law, F: Expr) -> tuple[list[Expr], list[Expr]] | None:
    """The axes in the reference and in the current configuration; None: the law has none."""
    if name != MATERIAL:
        axes = problem.axes[name].of(problem.X)
        return axes, axes
    first = fibre_of(law, 0)
    if first is None:
        return None
    second = fibre_of(law, 1)
    reference = frame(first, _across(first) if second is None else second)
    current = reference if law.linear else frame(F * reference[0], F * reference[1])
    return [*reference], [*current]


def _across(a: Expr) -> Expr:
    """The coordinate axis that is most normal to a unit vector."""
    x, y, z = (ufl.as_vector([float(i == k) for i in range(3)]) for k in range(3))
    of_y_and_z = [ufl.conditional(ufl.le(abs(a[1]), abs(a[2])), y[i], z[i]) for i in range(3)]
    is_x = ufl.And(ufl.le(abs(a[0]), abs(a[1])), ufl.le(abs(a[0]), abs(a[2])))
    return ufl.as_vector([ufl.conditional(is_x, x[i], of_y_and_z[i]) for i in range(3)])
