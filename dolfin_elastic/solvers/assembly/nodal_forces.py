"""Nodal forces of explicit motion, assembled at each step without allocating memory."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.cpp.fem import pack_coefficients, pack_constants

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.history.fused import FusedSteps
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Term
from dolfin_elastic.solvers.assembly.assembler import in_cells


class Forces:
    """One virtual work as nodal forces in one vector, without allocating anything.

    Integrals over cells are those of the residual of statics, with present fields.  Of all others,
    coefficients and constants are packed once.  What changes from step to step, the displacement,
    what materials remember and the velocity that dashpots see, is read into the packed arrays
    again; numbers and formulas that change with time are taken over by `renew`, and what a program
    has changed by `pack_again`.

    Args:
        problem: Whose displacement; linear elements, no unknowns beside it.
        vector: Receives the forces [N], ghosts included.
        points: What the forces of loads that are in no form are multiplied by; below 0 those of
            restraints, too.
        steps: Add the forces of materials that remember, which are not in `work`.

    Attributes:
        owned: The forces at owned entries [N].
    """

    def __init__(
        self,
        problem: Problem,
        work: ufl.Form,
        vector: la.Vector,
        *,
        points: float = 0.0,
        steps: FusedSteps | None = None,
    ) -> None:
        self._vector, self._array, self._steps = vector, vector.array, steps
        self.owned = self._array[: problem.u.x.index_map.size_local * problem.u.x.block_size]
        terms = problem.terms if points else []
        nodal = [term for term in terms if term.nodal]
        self._in_no_form = [term for term in nodal if not term.restrains]
        self._answering = [term for term in nodal if term.restrains] if points < 0.0 else []
        self._points = points
        self._cells, others = in_cells(problem, work)
        self._others = None if others is None else _Packed(problem, others)
        moving = [field._cpp_object for fields in _moving(problem) for field in fields]
        ours = [] if self._cells is None else self._cells.fields
        self._fields = [field for field in ours if field not in moving]
        self._constants: FloatArray = np.empty(0)
        self._at_points: FloatArray = np.empty(0)
        self.renew()

    def renew(self) -> None:
        """Takes over the numbers of the present time. Not collective."""
        if self._cells is not None:
            self._constants = self._cells.constants
        if self._others is not None:
            self._others.renew()
        if self._in_no_form:
            self._at_points = self._points * self._of(self._in_no_form)

    def _of(self, terms: Sequence[Term]) -> FloatArray:
        forces = np.zeros(len(self._array))
        for term in terms:
            term.add_forces(forces)
        return forces

    def fingerprint(self) -> bytes:
        """Of this rank's numbers and fields, but those that follow the motion or the time.

        Where it has changed from one look to the next without a step, a program has changed it.
        """
        digest = blake2b()
        values = [] if self._cells is None else [self._cells.constants]
        values += [field.x.array for field in self._fields]
        if self._steps is not None:
            values += self._steps.given()
        if self._others is not None:
            values += self._others.given()
        if self._in_no_form:
            values.append(self._of(self._in_no_form))
        for value in values:
            digest.update(np.ascontiguousarray(value))
        return digest.digest()

    def pack_again(self) -> None:
        """Takes over all numbers and fields, which a program may have changed. Not collective."""
        if self._others is not None:
            self._others.pack_again()
        self.renew()

    def assemble(self, *, accept: bool = False) -> FloatArray:
        """`owned` at the present displacement, summed over the ranks. Collective.

        Args:
            accept: The displacement is that of the end of a step, see `FusedSteps`.
        """
        self._array.fill(0.0)
        if self._steps is not None:
            self._steps.add_forces(self._array, accept=accept)
        if self._cells is not None:
            self._cells.add_to(self._array, self._constants)
        if self._others is not None:
            self._others.add_to(self._array)
        if self._in_no_form:
            self._array += self._at_points
        if self._answering:
            self._array += self._points * self._of(self._answering)
        self._vector.scatter_reverse(la.InsertMode.add)
        return self.owned


def _moving(problem: Problem) -> tuple[Sequence[fem.Function], Sequence[fem.Function]]:
    """Fields that follow the motion, and those that follow the time."""
    formulas = problem.context.formulas
    past = () if problem.history is None else problem.history.past
    followed = (problem.u, problem.context.velocity, *problem.terms.past.values(), *past)
    return followed, () if formulas is None else formulas.moving


class _Packed:
    """A form with its coefficients and constants, as `Forces` says."""

    def __init__(self, problem: Problem, form: fem.Form) -> None:
        self._form = form
        self._packed = pack_coefficients(form._cpp_object)
        moving = _moving(problem)
        self._reads, self._timed = (
            [read for field in fields for read in _reads(form, field, self._packed)]
            for fields in moving
        )
        read = [field._cpp_object for fields in moving for field in fields]
        self._fixed = [field for field in form._cpp_object.coefficients if field not in read]
        self._constants = pack_constants(form._cpp_object)

    def renew(self) -> None:
        self._constants = pack_constants(self._form._cpp_object)
        for read in self._timed:
            read.again()

    def given(self) -> list[FloatArray]:
        """Numbers and fields that follow neither the motion nor the time."""
        return [pack_constants(self._form._cpp_object), *(field.x.array for field in self._fixed)]

    def pack_again(self) -> None:
        for key, values in pack_coefficients(self._form._cpp_object).items():
            self._packed[key][...] = values  # in place: the reads have views of them

    def add_to(self, out: FloatArray) -> None:
        for read in self._reads:
            read.again()
        fem.assemble_vector(out, self._form, self._constants, self._packed)


class _Read:
    """The values of one field in the packed coefficients of one integral.

    Args:
        packed: Coefficients of all cells, one row each.
        cells: Cell of each row.
    """

    def __init__(
        self,
        field: fem.Function,
        packed: FloatArray,
        cells: IndexArray,
        first: int,
    ) -> None:
        dofmap = field.function_space.dofmap
        self._rows = field.x.array.reshape(-1, dofmap.bs)
        self._dofs = dofmap.list[cells].astype(np.intp)  # others would be converted each time
        width = self._dofs.shape[1] * dofmap.bs
        shape = (*self._dofs.shape, dofmap.bs)
        self._whole = packed.shape[1] == width
        self._columns = packed[:, first : first + width]
        self._values = packed.reshape(shape) if self._whole else np.empty(shape)

    def again(self) -> None:
        """Reads the field's present values."""
        np.take(self._rows, self._dofs, axis=0, out=self._values, mode="clip")
        if not self._whole:
            self._columns[...] = self._values.reshape(self._columns.shape)


def _reads(
    form: fem.Form, field: fem.Function, packed: dict[tuple[fem.IntegralType, int], FloatArray]
) -> Sequence[_Read]:
    """Where an assembly finds a field's values."""
    inner = form._cpp_object
    first = 0
    for coefficient in inner.coefficients:
        if coefficient is field._cpp_object:
            break
        first += coefficient.function_space.element.space_dimension
    else:
        return []
    used = _used(form, field, first)
    return [
        _Read(field, values, _cells(inner.domains(*key), len(values)), first)
        for key, values in packed.items()
        if len(values) and key in used
    ]


def _used(form: fem.Form, field: fem.Function, first: int) -> set[tuple[fem.IntegralType, int]]:
    """Integrals that read a field: the others leave its columns empty."""
    saved = field.x.array.copy()
    field.x.array[:] = 1.0
    coefficients = pack_coefficients(form._cpp_object)
    field.x.array[:] = saved
    return {key for key, values in coefficients.items() if len(values) and values[0, first] == 1.0}


def _cells(entities: IndexArray, rows: int) -> IndexArray:
    """Cells of an integral over cells, or over facets as pairs of cell and local facet."""
    return entities.ravel()[:: max(entities.size // max(rows, 1), 1)]
