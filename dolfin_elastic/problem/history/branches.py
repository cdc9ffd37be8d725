"""Work that is done on the branches of materials that relax."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.jit import compile_forms, options
from dolfin_elastic.core.jit.cell_integrals import CellIntegrals, can_be_packed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.constraints.periodic.unit_cell import Cell
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.weak_form import WeakForm


class BranchWork:
    """Work on branches over the present step, by the trapezoidal rule. Collective to make.

    Args:
        weak_form: One whose `branches` are not empty.
        cell: See `History`.
    """

    def __init__(self, context: FormContext, weak_form: WeakForm, cell: Cell | None) -> None:
        self._context, self._cell = context, cell
        self._comm, self._w = context.body.comm, context.unknowns.w
        forms = [weak_form.branches()]
        if cell is not None:
            forms.append(weak_form.branches(of_cell=True))
        compiled = compile_forms(self._comm, forms, options(self._comm))
        self._parts = [self._assembly(*one) for one in zip(forms, compiled, strict=True)]
        self._before: tuple[FloatArray, FloatArray] | None = None

    def _assembly(self, form: ufl.Form, compiled: fem.Form) -> Callable[[FloatArray], None]:
        """Adds the vector of a form, by loops of our own where they can. Collective."""
        (test,), w = form.arguments(), self._w
        ours = test.ufl_function_space() == w.function_space
        if ours and all(can_be_packed(field, w) for field in form.coefficients()):
            used = form.coefficients()
            return CellIntegrals(compiled, w, options(self._comm), used).add_to
        return lambda part: fem.assemble_vector(part, compiled)

    def _forces(self) -> FloatArray:
        """This rank's share of the nodal forces of the branches, not summed over ranks [N].

        Of a periodic cell first on the unknowns, then on the macroscopic displacement.
        """
        result = np.zeros_like(self._moved())
        size = len(self._w.x.array)
        for add, part in zip(self._parts, (result[:size], result[size:]), strict=False):
            add(part)
        return result

    def _moved(self) -> FloatArray:
        """What `_forces` do work on: a copy of the local unknowns and, of a cell, more [m]."""
        w = self._w.x.array
        if self._cell is None:
            return w.copy()
        return np.append(w, self._cell.affine_at(self._context.unknowns.places))

    def begin(self, forces: FloatArray | None = None) -> None:
        """A step begins at the present state.

        Args:
            forces: Those of the branches, from `since`, if they are known.
        """
        self._before = self._forces() if forces is None else forces, self._moved()

    def since(self) -> tuple[float, float, FloatArray]:
        """Work of the step up to now, by how much it may be wrong [J], and forces. Collective."""
        now = self._forces()
        if self._before is None:
            return 0.0, 0.0, now
        before, w = self._before
        moved = self._moved() - w
        local = np.array([np.dot(before + now, moved), np.dot(now - before, moved)]) / 2
        work, change = total(self._comm, local)
        return float(work), abs(float(change)), now
