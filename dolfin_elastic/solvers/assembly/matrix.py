"""Compiled bilinear forms, and the PETSc matrices that are assembled from them.

DOLFINx's own CSR matrix is assembled without PETSc's insertion, which costs more than the element
matrices themselves (DOLFINx pull request 4555).  On one rank a PETSc AIJ matrix has its arrays;
on several its values are copied into those of one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.scalar_mass import InertiaForces
from dolfin_elastic.solvers.petsc.aij import from_entries
from dolfin_elastic.solvers.petsc.c_api import overwrite_aij

Conditions = Sequence[fem.DirichletBC]

SOFT = 1e-4
"""Diagonal of tied unknowns, which are coupled to nothing, over that of others.  It must not
hinder the rigid-body modes of multigrid's coarser levels, which do not know of ties."""


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


def marked(bcs: Conditions, size: int) -> NDArray[np.int8]:
    """1 at entries that are prescribed, else 0."""
    marks = np.zeros(size, dtype=np.int8)
    for bc in bcs:
        marks[bc.dof_indices()[0]] = 1
    return marks


class TangentMatrix:
    """A PETSc matrix that is assembled from one bilinear form again and again.

    Args:
        form: Compiled bilinear form; its sparsity is fixed here. Collective.
        fixed: Owned rows of fixed unknowns, and their diagonal in place of ones.
        inertia: What is added to the form; None: nothing.

    Attributes:
        petsc: The PETSc matrix, owned here.
    """

    def __init__(
        self,
        form: BilinearForm,
        *,
        fixed: tuple[IndexArray, FloatArray] | None = None,
        inertia: InertiaForces | None = None,
    ) -> None:
        self._form, self._inertia = form, inertia
        self._native = form.matrix()
        self._shared = form.form.mesh.comm.size == 1
        self.petsc = self._sharing_values() if self._shared else self._like_native()
        self._diagonal, self._others = self._value_order()
        if PETSc.ScalarType != np.float64 or self._entries() != self._native.indptr[self._rows()]:
            raise RuntimeError("PETSc's matrix has not the entries of DOLFINx's")
        self._fixed = None if fixed is None else (self._entry_on_diagonal(fixed[0]), fixed[1])

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
        result = [
            start[row] + int(np.flatnonzero(columns[start[row] : start[row + 1]] == row)[0])
            for row in rows
        ]
        return np.array(result, dtype=np.int64)

    def _value_order(self) -> tuple[slice | BoolArray, IntArray]:
        """Which native values go, in which order, to PETSc's own-column and other-column parts.

        PETSc sorts the own columns by number, as DOLFINx does, and the others by global number,
        where DOLFINx sorts by local number.
        """
        rows = self._rows()
        count = int(self._native.indptr[rows])
        local = self._native.indices[:count]
        own = local < rows
        if own.all():
            return slice(0, count), np.empty(0, dtype=np.int64)
        row = np.repeat(np.arange(rows), np.diff(self._native.indptr[: rows + 1]))
        others = np.flatnonzero(~own)
        order = np.lexsort((self._global_columns()[:count][others], row[others]))
        return own, others[order]

    def assemble(self, bcs: Sequence[fem.DirichletBC]) -> None:
        """Assembles the form, with ones on the diagonal of constrained rows. Collective.

        Args:
            bcs: Dirichlet conditions, whose rows and columns are zeroed.
        """
        self._native.data[:] = 0.0
        self._form.assemble(self._native, bcs)
        if self._inertia is not None:
            self._inertia.add_to_rows(self._native, marked(bcs, len(self._native.indptr) - 1))
        self._native.scatter_reverse()
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


class ConstrainedMatrix:
    """T^T K T + s E of a matrix K; K itself where only entries by themselves are prescribed.

    E is the projection on what T does not reach, with `SOFT` at tied unknowns: their rows and those
    of skew directions are coupled to nothing else.  Rows of prescribed unknowns are left as they
    are in K, the columns of T there are zero elsewhere.  Collective.

    Args:
        rows: The constraints of the owned entries of K's vectors.
        K: The matrix, of whose pattern the product is made; its values may change.
        displacement: Owned rows of K that are displacements, in their order.

    Attributes:
        matrix: The product; owned here unless it is K.
        scale: Mean size of the diagonal at the first `renew`, a power of two: s, the same for all
            states, so that differences of two matrices have zeros there.
    """

    def __init__(
        self, problem: Problem, rows: Rows, K: PETSc.Mat, displacement: IndexArray | IntArray
    ) -> None:
        self.matrix, self.scale, self._K, self._owned = K, 0.0, K, []
        if rows.combined:
            self._T = transformation(problem, rows, K, displacement)
            self._E = from_entries(K, *rows.eliminated(K.getOwnershipRange()[0], SOFT), square=True)
            self.matrix = K.ptap(self._T)
            self._owned = [self._T, self._E, self.matrix]

    def renew(self, unit: float | None = None) -> None:
        """Takes over the values of K. Collective.

        Args:
            unit: The factor s [N/m]; None: `scale`.
        """
        if not self._owned:
            return
        self._K.ptap(self._T, result=self.matrix)
        if self.scale == 0.0:
            diagonal = self.matrix.getDiagonal()
            sizes = total(self.matrix.comm.tompi4py(), float(np.abs(diagonal.array_r).sum()))
            mean = sizes / diagonal.getSize()
            diagonal.destroy()
            self.scale = 2.0 ** np.round(np.log2(mean)) if 0.0 < mean < np.inf else 1.0
        if unit := self.scale if unit is None else unit:
            self.matrix.axpy(unit, self._E, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        for thing in self._owned:
            thing.destroy()


def transformation(
    problem: Problem,
    rows: Rows,
    like: PETSc.Mat,
    displacement: IndexArray | IntArray,
    *,
    prescribed: float = 1.0,
) -> PETSc.Mat:
    """T as a square matrix; the caller destroys it. Collective.

    Tied rows have their diagonal, with the value zero, so that products have it, too.

    Args:
        rows: The constraints of the owned entries of its vectors.
        like: Square, with the same rows.
        displacement: Owned rows of it that are displacements, in their order.
        prescribed: Diagonal of prescribed rows; one by default, as K has it.
    """
    start, offsets = like.getOwnershipRange()[0], rows.skew_dofs
    ones = np.ones(like.getLocalSize()[0])
    ones[rows.tied_dofs], ones[rows.prescribed_dofs] = 0.0, prescribed
    alone = np.ones(len(ones), dtype=bool)
    alone[offsets] = False
    others, dim = np.flatnonzero(alone), offsets.shape[1]
    parts = [
        (others, others + start, ones[others]),
        (
            np.repeat(offsets, dim, axis=1).ravel(),
            start + np.tile(offsets, dim).ravel(),
            (np.eye(dim) - rows.P).ravel(),
        ),
    ]
    if rows.tied:
        i, j, v = problem.constraints.factors(start + np.asarray(displacement))
        parts.append((i - start, j, v))
    i, j, v = (np.concatenate(part) for part in zip(*parts, strict=True))
    return from_entries(like, i, j, v, square=True)
