"""The tangent as a PETSc matrix, filled twice as fast as entry by entry.

DOLFINx's own CSR matrix is assembled without PETSc's insertion, which costs more than the element
matrices themselves (DOLFINx pull request 4555), and its values are then copied into the arrays of
a PETSc AIJ matrix of the same pattern.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.assembly.skew_rows import SkewProjection
from dolfin_elastic.solvers.petsc.c_api import check, library


class TangentMatrix:
    """A PETSc matrix that is assembled from one bilinear form again and again.

    Args:
        form: Compiled bilinear form; its sparsity is fixed here. Collective.
        places: Owned rows of nodes that are held along given directions, of shape (nodes, dim);
            None if no rank has any.
        P: Projections on these directions, of shape (nodes, dim, dim).

    Attributes:
        petsc: The PETSc matrix, owned here.
        unit: What stands for held directions that are no entries, in place of ones [N/m].
    """

    def __init__(
        self,
        form: fem.Form,
        places: IndexArray | None = None,
        P: FloatArray | None = None,
    ) -> None:
        self._form = form
        self._native = fem.create_matrix(form, la.BlockMode.expanded)
        self.petsc = self._like_native()
        self._diagonal, self._others = self._places()
        if PETSc.ScalarType != np.float64 or self._entries() != self._native.indptr[self._rows()]:
            raise RuntimeError("PETSc's matrix has not the entries of DOLFINx's")
        self.unit = 1.0
        self._projection: SkewProjection | None = None
        if places is not None and P is not None:
            self._projection = SkewProjection(self._native, self._rows(), places, P)

    def _rows(self) -> int:
        dofmap = self._form.function_spaces[0].dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    def _like_native(self) -> PETSc.Mat:
        """An AIJ matrix with the owned rows of the native one."""
        rows, native = self._rows(), self._native
        start = native.indptr[: rows + 1]
        columns = self._global_columns()[: start[-1]]
        bs = self._form.function_spaces[0].dofmap.index_map_bs
        sizes = ((rows, None), (rows, None))
        matrix = PETSc.Mat().createAIJ(
            sizes,
            bsize=bs,
            comm=self._form.mesh.comm,
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

    def _places(self) -> tuple[Any, Any]:
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

    def assemble(self, bcs: Sequence[fem.DirichletBC]) -> None:
        """Assembles the form, with ones on the diagonal of constrained rows. Collective."""
        self._native.data[:] = 0.0
        fem.assemble_matrix(self._native, self._form, list(bcs))
        self._native.scatter_reverse()
        if self._projection is not None:
            self._projection.apply(self._native.data, self.unit)
        count = int(self._native.indptr[self._rows()])
        data = self._native.data[:count]
        _fill(self.petsc, data[self._diagonal], data[self._others])

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        self.petsc.destroy()


def _fill(matrix: PETSc.Mat, own: FloatArray, others: FloatArray) -> None:
    """Overwrites all values of an AIJ matrix: the block of its own columns, then the rest."""
    if matrix.getType() == "seqaij":
        _write(matrix.handle, own)
    else:
        _write(matrix.getDiagonalBlock().handle, own)
        _write(_off_diagonal(matrix), others)
    matrix.stateIncrease()
    matrix.assemble()


def _off_diagonal(matrix: PETSc.Mat) -> int:
    own, others = ctypes.c_void_p(), ctypes.c_void_p()
    check(
        library().MatMPIAIJGetSeqAIJ(
            ctypes.c_void_p(matrix.handle), ctypes.byref(own), ctypes.byref(others), None
        )
    )
    assert others.value is not None
    return others.value


def _write(handle: int, values: FloatArray) -> None:
    """Copies contiguous values into a sequential AIJ matrix, through MatSeqAIJGetArray."""
    matrix, pointer = ctypes.c_void_p(handle), ctypes.c_void_p()
    check(library().MatSeqAIJGetArray(matrix, ctypes.byref(pointer)))
    if len(values):
        ctypes.memmove(pointer, values.ctypes.data, values.nbytes)
    check(library().MatSeqAIJRestoreArray(matrix, ctypes.byref(pointer)))
