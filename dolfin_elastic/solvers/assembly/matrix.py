"""Compiled bilinear forms, and the PETSc matrices that are assembled from them.

DOLFINx's own CSR matrix is assembled without PETSc's insertion, which costs more than the element
matrices themselves (DOLFINx pull request 4555), and its values are then copied into the arrays of
a PETSc AIJ matrix of the same pattern.

A form compiler writes the tangent of a law as one kernel, in which the derivative of the stress is
contracted with each pair of shape functions.  In two stages FFCx compiles the moduli A = dP/dF at
the points of integration only, from the same UFL; `stiffness_kernel` contracts them with the shape
functions' gradients and adds the result at places of the matrix that are found once.  Equal to
round-off, and two to five times as fast.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import basix
import numpy as np
import ufl
from dolfinx import cpp, fem, la
from numpy.typing import NDArray
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfin_elastic.core.jit import compile_c, compile_expression, compile_forms
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.skew_rows import SkewProjection
from dolfin_elastic.solvers.assembly.stiffness_kernel import DECLARATIONS, SOURCE
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
            bcs: Whose columns, with the values.
            values: The same values, local entries of all unknowns [m].
            w: The unknowns, local entries [m].
        """
        fem.apply_lifting(out, [self.form], [list(bcs)], [w], -1.0)


class SplitForm(BilinearForm):
    """The tangent of a problem that is `in_two_stages`. Collective to make.

    Args:
        problem: Whose displacement is the only unknown field.
        rest: What the tangent has beside the stress's part; may be empty.
    """

    def __init__(self, problem: Problem, rest: ufl.Form) -> None:
        V = problem.V
        trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)
        every_cell = ufl.dx(domain=problem.body.mesh, metadata={"quadrature_degree": 0})
        forms = [ufl.inner(trial, test) * every_cell] + ([] if rest.empty() else [rest])
        found = compile_forms(problem.body.comm, forms, problem.jit)
        super().__init__(found[0])
        self._rest = None if rest.empty() else found[1]
        self._stiffness = StressStiffness(problem)

    def assemble(self, matrix: la.MatrixCSR, bcs: Conditions) -> None:
        """See `BilinearForm.assemble`."""
        if self._rest is None:
            space = self.form.function_spaces[0]
            conditions = [bc._cpp_object for bc in bcs]
            cpp.fem.insert_diagonal(matrix._cpp_object, space, conditions, 1.0)
        else:
            fem.assemble_matrix(matrix, self._rest, list(bcs))
        self._stiffness.add(matrix, _marked(bcs, self._stiffness.size))

    def lift(self, out: FloatArray, bcs: Conditions, values: FloatArray, w: FloatArray) -> None:
        """See `BilinearForm.lift`."""
        if self._rest is not None:
            fem.apply_lifting(out, [self._rest], [list(bcs)], [w], -1.0)
        fixed = _marked(bcs, self._stiffness.size)
        self._stiffness.add_product(np.where(fixed, values - w, 0.0), out)


def _marked(bcs: Conditions, size: int) -> NDArray[np.int8]:
    marks = np.zeros(size, dtype=np.int8)
    for bc in bcs:
        marks[bc.dof_indices()[0]] = 1
    return marks


def in_two_stages(problem: Problem) -> bool:
    """Whether elastic moduli are all that the tangent of the stress needs.

    So it is where the displacement is the only unknown field and F depends on its gradient only.
    """
    return problem.W is problem.V and not problem.context.axisymmetric


def moduli(problem: Problem, region: MaterialRegion) -> Expr:
    """dP/dF times the measure's weight (UFL), of shape (dim, dim, dim, dim) [Pa].

    Args:
        problem: Whose displacement is the only unknown field.
        region: One of its material regions.
    """
    weak_form, n = problem.weak_form, range(problem.body.dim)
    F = ufl.variable(weak_form.F(problem.w))
    A = ufl.diff(weak_form.response(region, problem.w).stress(F), F)
    A = ufl.as_tensor([[[[A[i, J, k, L] for L in n] for k in n] for J in n] for i in n])
    weight = weak_form.volume(region, weak_form.rule(region)).weight
    return A if weight is None else weight * A


def tangent_of_surroundings(problem: Problem) -> ufl.Form:
    """The tangent without that of the stress: of loads, springs and contact; may be empty.

    Args:
        problem: Whose surroundings.
    """
    weak_form = problem.weak_form
    work = sum(weak_form.restraint_works.values(), weak_form.external or ufl.Form([]))
    return expand_derivatives(ufl.derivative(-work, problem.w, ufl.TrialFunction(problem.W)))


BLOCK = 262144
"""Doubles of moduli that are evaluated at once: 2 MB stay in the cache of a core, and hide what a
call costs in Python."""


class StressStiffness:
    """The stress's part of the tangent of a problem. Collective to make.

    Args:
        problem: Whose displacement is the only unknown field.

    Attributes:
        size: Entries of the displacement, owned and ghost.
    """

    def __init__(self, problem: Problem) -> None:
        mesh, dofmap = problem.body.mesh, problem.V.dofmap
        self._terms = [_Term(problem, region) for region in problem.regions]
        self._nodes = np.ascontiguousarray(dofmap.list, dtype=np.int32)
        self._elements = (
            np.ascontiguousarray(mesh.geometry.dofmap, dtype=np.int32),
            mesh.geometry.x,
            self._nodes,
        )
        nodes = dofmap.index_map.size_local + dofmap.index_map.num_ghosts
        self._dim = int(dofmap.index_map_bs)
        self.size = int(nodes * self._dim)
        self._start: IntArray = np.empty(0, dtype=np.int64)
        self._places: IntArray = np.empty(0, dtype=np.uint16)

    def _find_places(self, matrix: la.MatrixCSR) -> None:
        """First column of node b within the rows of node a, for each cell's pairs of nodes."""
        cells, nodes = self._nodes.shape
        self._start = matrix.indptr.astype(np.int64)
        self._places = np.zeros((cells, nodes, nodes), dtype=np.uint16)
        columns = np.ascontiguousarray(matrix.indices, dtype=np.int32)
        for term in self._terms:
            where = (self._nodes, self._start, columns, self._places)
            missing = term.code.call("find_places", len(term.cells), term.cells, *where)
            if missing >= 0:
                raise RuntimeError(f"the matrix has no place for the stiffness of cell {missing}")

    def add(self, matrix: la.MatrixCSR, fixed: NDArray[np.int8]) -> None:
        """Adds the stiffness at the present displacement. Not collective.

        Args:
            matrix: Of the same sparsity at every call; rows of ghosts get their share [N/m].
            fixed: 1 at entries of the displacement whose rows and columns are left out, else 0.
        """
        if not len(self._places):
            self._find_places(matrix)
        places = (fixed, self._start, self._places, matrix.data)
        for term in self._terms:
            for cells, A in term.blocks(term.cells):
                sizes = (len(cells), cells)
                term.code.call("add_stiffness", *sizes, *self._elements, A, *term.tables, *places)

    def add_product(self, direction: FloatArray, out: FloatArray) -> None:
        """Adds the product of the stiffness and a vector that is zero nearly everywhere.

        Not collective.

        Args:
            direction: Local entries, owned and ghost [m].
            out: Local entries, before the ranks are summed [N].
        """
        moved = (direction != 0.0).reshape(-1, self._dim).any(axis=1)
        touched = moved[self._nodes].any(axis=1)
        for term in self._terms:
            for cells, A in term.blocks(term.cells[touched[term.cells]]):
                sizes = (len(cells), cells)
                term.code.call(
                    "add_product", *sizes, *self._elements, A, *term.tables, direction, out
                )


class _Term:
    """Moduli of one region, compiled, and what the kernel needs to know of its elements."""

    def __init__(self, problem: Problem, region: MaterialRegion) -> None:
        mesh = problem.body.mesh
        self.cells, self._mesh = region.cells.astype(np.int32), mesh
        degree = problem.weak_form.rule(region)
        points, weights = basix.make_quadrature(mesh.basix_cell(), degree)
        A = moduli(problem, region)
        self._A = compile_expression(problem.body.comm, A, points, problem.jit)
        dim = problem.body.dim
        coordinates = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        shape = problem.V.element.basix_element.tabulate(1, points)[1:, :, :, 0]
        geometry = coordinates.tabulate(1, points)[1:]
        nodes = shape.shape[2]
        padded = -(-nodes // 4) * 4  # whole vector registers
        gradients = np.zeros((len(weights), dim, padded))
        gradients[:, :, :nodes] = shape.transpose(1, 0, 2)
        corners = np.ascontiguousarray(geometry.transpose(1, 2, 0))
        self.tables = (gradients, corners, np.ascontiguousarray(weights))
        sizes = {"DIM": dim, "ND": nodes, "NDP": padded, "NG": corners.shape[1], "NQ": len(weights)}
        sizes["SYMMETRIC"] = int(problem.symmetric)
        self.code = compile_c(problem.body.comm, DECLARATIONS, SOURCE, sizes, problem.jit)
        self._block = max(1, BLOCK // (len(weights) * dim**4))

    def blocks(self, cells: IndexArray) -> Iterator[tuple[IndexArray, FloatArray]]:
        """Cells, some at a time, with their moduli (cells, points, dim, dim, dim, dim) [Pa]."""
        for first in range(0, len(cells), self._block):
            some = cells[first : first + self._block]
            yield some, self._A.eval(self._mesh, some)


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
        self.petsc = self._like_native()
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
        count = int(self._native.indptr[self._rows()])
        data = self._native.data[:count]
        overwrite_aij(self.petsc, data[self._diagonal], data[self._others])

    def destroy(self) -> None:
        """Frees the PETSc matrix. Collective."""
        self.petsc.destroy()
