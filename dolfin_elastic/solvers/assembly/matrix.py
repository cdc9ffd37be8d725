"""Compiled bilinear forms, and the PETSc matrices that are assembled from them.

DOLFINx's own CSR matrix is assembled without PETSc's insertion, which costs more than the element
matrices themselves (DOLFINx pull request 4555).  On one rank a PETSc AIJ matrix has its arrays;
on several its values are copied into those of one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.assembly.skew_rows import SkewProjection
from dolfin_elastic.solvers.petsc.c_api import overwrite_aij

Conditions = Sequence[fem.DirichletBC]


class BilinearForm:
    """A compiled bilinear form.

    Args:
        form: All of it.

    Attributes:
        form: A compiled form with its sparsity and its spaces.
    """

    def __init__(self, form: fem.Form) -> None:
        self.form = form

    def matrix(self) -> la.MatrixCSR:
        """A matrix with the form's sparsity, blocks expanded. Collective."""
        return fem.create_matrix(self.form, la.BlockMode.expanded)

    def assemble(self, matrix: la.MatrixCSR, bcs: Conditions) -> None:
        """Adds the form, with ones on the diagonal of prescribed rows. Not collective.

        Args:
            matrix: One of `matrix`; rows of ghosts are not yet sent to their owners.
            bcs: Whose rows and columns are left out.
        """
        fem.assemble_matrix(matrix, self.form, list(bcs))

    def lift(self, out: FloatArray, bcs: Conditions, values: FloatArray, w: FloatArray) -> None:
        """Adds the product of the prescribed columns and values - w. Not collective.

        Args:
            out: Local entries, before the ranks are summed [N].
            values: The same values, local entries of all unknowns [m].
            w: The unknowns, local entries [m].
        """
        fem.apply_lifting(out, [self.form], [list(bcs)], [w], -1.0)


class TangentMatrix:
    """A PETSc matrix that is assembled from one bilinear form again and again.

    Args:
        form: Compiled bilinear form; its sparsity is fixed here. Collective.
        places: Owned rows of skew nodes, shape (nodes, dim); None if no rank has any.
        P: Projections on these directions, shape (nodes, dim, dim).
        fixed: Owned rows of fixed unknowns, and their diagonal in place of ones.

    Attributes:
        petsc: The PETSc matrix, owned here.
    """

    def __init__(
        self,
        form: BilinearForm,
        places: IndexArray | None = None,
        P: FloatArray | None = None,
        *,
        fixed: tuple[IndexArray, FloatArray] | None = None,
    ) -> None:
        self._form = form
        self._native = form.matrix()
        self._shared = form.form.mesh.comm.size == 1
        self.petsc = self._sharing_values() if self._shared else self._like_native()
        self._diagonal, self._others = self._value_order()
        if PETSc.ScalarType != np.float64 or self._entries() != self._native.indptr[self._rows()]:
            raise RuntimeError("PETSc's matrix has not the entries of DOLFINx's")
        self._fixed = None if fixed is None else (self._entry_on_diagonal(fixed[0]), fixed[1])
        self._projection: SkewProjection | None = None
        if places is not None and P is not None:
            self._projection = SkewProjection(self._native, self._rows(), places, P)

    def _rows(self) -> int:
        dofmap = self._form.form.function_spaces[0].dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    def _sharing_values(self) -> PETSc.Mat:
        """An AIJ matrix of one rank that has the values of the native one for its own."""
        rows, native = self._rows(), self._native
        bs = self._form.form.function_spaces[0].dofmap.index_map_bs
        start, columns = (
            a.astype(PETSc.IntType, copy=False) for a in (native.indptr, native.indices)
        )
        comm = self._form.form.mesh.comm
        matrix = PETSc.Mat().createAIJWithArrays(
            (rows, rows), (start, columns, native.data), bs, comm
        )
        matrix.assemble()
        return matrix

    def _like_native(self) -> PETSc.Mat:
        """An AIJ matrix with the owned rows of the native one."""
        rows, native = self._rows(), self._native
        start = native.indptr[: rows + 1]
        columns = self._global_columns()[: start[-1]]
        bs = self._form.form.function_spaces[0].dofmap.index_map_bs
        sizes = ((rows, None), (rows, None))
        matrix = PETSc.Mat().createAIJ(
            sizes,
            bsize=bs,
            comm=self._form.form.mesh.comm,
            csr=(
                start.astype(PETSc.IntType),
                columns.astype(PETSc.IntType),
                np.zeros(len(columns)),
            ),
        )
        matrix.assemble()
        return matrix

    def _global_columns(self) -> IntArray:
        columns = self._native.index_map(1)  # has ghosts that the function space has not
        return columns.local_to_global(self._native.indices.astype(np.int32))

    def _entries(self) -> int:
        return int(self.petsc.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_used"])

    def _entry_on_diagonal(self, rows: IndexArray) -> IntArray:
        """Which native values are on the diagonal of owned rows."""
        start, columns = self._native.indptr, self._native.indices
        found = [
            start[row] + int(np.flatnonzero(columns[start[row] : start[row + 1]] == row)[0])
            for row in rows
        ]
        return np.array(found, dtype=np.int64)

    def _value_order(self) -> tuple[slice | BoolArray, IntArray]:
        """Which native values go, in which order, to PETSc's own-column and other-column parts.

        PETSc sorts the own columns by number, as DOLFINx does, and the others by global number,
        where DOLFINx sorts by local number.
        """
        rows = self._rows()
        count = int(self._native.indptr[rows])
        local = self._native.indices[:count]
        mine = local < rows
        if mine.all():
            return slice(0, count), np.empty(0, dtype=np.int64)
        row = np.repeat(np.arange(rows), np.diff(self._native.indptr[: rows + 1]))
        others = np.flatnonzero(~mine)
        order = np.lexsort((self._global_columns()[:count][others], row[others]))
        return mine, others[order]

    def assemble(self, bcs: Sequence[fem.DirichletBC], *, unit: float = 1.0) -> None:
        """Assembles the form, with ones on the diagonal of constrained rows. Collective.

        Args:
            bcs: Dirichlet conditions, whose rows and columns are zeroed.
            unit: Factor of P at skew nodes, in place of the ones [N/m].
        """
        self._native.data[:] = 0.0
        self._form.assemble(self._native, bcs)
        self._native.scatter_reverse()
        if self._projection is not None:
            self._projection.apply(self._native.data, unit)
        if self._fixed is not None:
            self._native.data[self._fixed[0]] = self._fixed[1]
        if self._shared:
            self.petsc.stateIncrease()
            self.petsc.assemble()
            return
        count = int(self._native.indptr[self._rows()])
        data = self._native.data[:count]
        overwrite_aij(self.petsc, data[self._diagonal], data[self._others])

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        self.petsc.destroy()
