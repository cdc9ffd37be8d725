"""The tangent of a problem as a PETSc matrix.

DOLFINx's own CSR matrix is assembled without PETSc's insertion, which costs more than the element
matrices themselves (DOLFINx pull request 4555), and its values are then copied into the arrays of
a PETSc AIJ matrix of the same pattern.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.assembly.skew_rows import SkewProjection
from dolfin_elastic.solvers.assembly.tied import TiedMatrix
from dolfin_elastic.solvers.petsc.c_api import overwrite_aij


class Tangent:
    """The tangent of a problem, with ones on the diagonal of prescribed dofs. Collective.

    Fixed pressures have the pivots of `ConstrainedDofs.level` there, of their own sign.  At skew
    nodes it is Q K Q + s P, see `SkewProjection`, where s is of the size of K: round-off
    of K would drown P otherwise.

    Args:
        dofs: The unknowns and what is prescribed of them.
        form: The compiled bilinear form.

    Attributes:
        form: The compiled bilinear form.
        matrix: The tangent; owned here.
    """

    def __init__(self, dofs: ConstrainedDofs, form: fem.Form) -> None:
        self._dofs, self.form = dofs, form
        skew = dofs.skew
        with stage("assemble"):
            fixed = None if dofs.level is None else (dofs.fixed_pressures, dofs.level.pivots)
            self._assembled = (
                TangentMatrix(form, fixed=fixed)
                if skew is None
                else TangentMatrix(form, dofs.skew_dofs, skew.P[: skew.count], fixed=fixed)
            )
        self._tied: TiedMatrix | None = None
        self.matrix = self._assembled.petsc
        if dofs.ties is not None:
            self._tied = TiedMatrix(dofs.problem, self.matrix, dofs.displacement_dofs)
            self.matrix = self._tied.matrix
        self._shift: float | None = None
        self._scale = 0.0
        if dofs.problem.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def assemble(self, x: PETSc.Vec, shift: float = 0.0, *, unit: float | None = None) -> None:
        """Assembles the tangent into `matrix`, unless neither it nor the shift can have changed.

        A matrix that is left alone keeps its factorisation.

        Args:
            x: The unknowns, from `ConstrainedDofs.origin`.
            shift: Factor of the inertia in the form, by which linear tangents differ.
            unit: The factor s of P at skew nodes; by default of the size of the tangent [N/m].
        """
        with stage("assemble"):
            self._dofs.put(x)
            if self._dofs.problem.linear and shift == self._shift:
                return
            if unit is None and self._dofs.skew is not None:
                unit = self.scale()
            self._renew(unit or 0.0)
            self._shift = shift

    def _renew(self, unit: float) -> None:
        self._assembled.assemble(self._dofs.bcs, unit=unit)
        if self._tied is not None:
            self._tied.renew()

    def scale(self) -> float:
        """Mean size of the tangent's diagonal at the first call, a power of two [N/m]."""
        if self._scale == 0.0:
            self._renew(0.0)
            self.invalidate()
            diagonal = self.matrix.getDiagonal()
            mean = float(diagonal.norm(PETSc.NormType.NORM_1)) / diagonal.getSize()
            diagonal.destroy()
            self._scale = 2.0 ** np.round(np.log2(mean)) if 0.0 < mean < np.inf else 1.0
        return self._scale

    def shift_diagonal(self, share: float) -> None:
        """Adds a share of its size to the diagonal of free dofs."""
        diagonal = self.matrix.getDiagonal()
        added = share * np.abs(diagonal.array_r)
        added[self._dofs.prescribed_dofs] = 0.0
        diagonal.array_w[:] += added
        self.matrix.setDiagonal(diagonal)
        diagonal.destroy()
        self.invalidate()

    def invalidate(self) -> None:
        """`matrix` was changed: `assemble` assembles it, also in a linear problem. Local."""
        self._shift = None

    def destroy(self) -> None:
        """Frees the matrix."""
        if self._tied is not None:
            self._tied.destroy()
        self._assembled.destroy()


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
        form: fem.Form,
        places: IndexArray | None = None,
        P: FloatArray | None = None,
        *,
        fixed: tuple[IndexArray, FloatArray] | None = None,
    ) -> None:
        self._form = form
        self._native = fem.create_matrix(form, la.BlockMode.expanded)
        self.petsc = self._like_native()
        self._diagonal, self._others = self._value_order()
        if PETSc.ScalarType != np.float64 or self._entries() != self._native.indptr[self._rows()]:
            raise RuntimeError("PETSc's matrix has not the entries of DOLFINx's")
        self._fixed = None if fixed is None else (self._entry_on_diagonal(fixed[0]), fixed[1])
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
        fem.assemble_matrix(self._native, self._form, list(bcs))
        self._native.scatter_reverse()
        if self._projection is not None:
            self._projection.apply(self._native.data, unit)
        if self._fixed is not None:
            self._native.data[self._fixed[0]] = self._fixed[1]
        count = int(self._native.indptr[self._rows()])
        data = self._native.data[:count]
        overwrite_aij(self.petsc, data[self._diagonal], data[self._others])

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        self.petsc.destroy()
