"""The tangent in two stages.

A form compiler writes the tangent of a law as one kernel, in which the derivative of the stress is
contracted with each pair of shape functions.  In two stages FFCx compiles the `moduli` at the
points of integration only, from the same UFL; tangent.c contracts them with shape functions and
adds the result at places of the matrix that are found once.  Equal to round-off, and two to five
times as fast.
"""

from __future__ import annotations

from collections.abc import Iterator

import basix
import numpy as np
import ufl
from dolfinx import cpp, fem, la
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_coefficients
from ufl.core.expr import Expr

from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.jit.cell_integrals import CellExpression, Loops
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.kinematics import variables
from dolfin_elastic.problem.damping import Damping
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.problem.weak_form import UNUSED
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, Conditions, marked
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks

BLOCK = 262144
"""Doubles of moduli that are evaluated at once: 2 MB stay in the cache of a core, and hide what a
call costs in Python."""


def in_two_stages(problem: Problem) -> bool:
    """Whether `moduli` are all that the tangent of the internal forces needs. Collective.

    So it is where F depends on the displacement's gradient only, and at most a pressure without
    stabilisation is unknown beside it, with the components of a node numbered in a row.

    Args:
        problem: Any.
    """
    if problem.context.axisymmetric:
        return False
    if problem.W is problem.V:
        return True
    unknowns = problem.unknowns
    alone = [field.name for field in unknowns.auxiliary_fields] == ["pressure"]
    # Nodes of a periodic cell are merged.
    if not alone or unknowns.stabilised or unknowns.U is not unknowns.V:
        return False
    entries = _entries(problem)
    apart = entries[:, :1] + np.arange(problem.body.dim) != entries
    return not total(problem.body.comm, int(apart.any()))


def tangent_form(
    problem: Problem, extra: ufl.Form | None = None, damping: Damping | None = None
) -> BilinearForm:
    """The compiled tangent of a problem and of what is added to it. Collective."""
    more = ufl.Form([]) if extra is None else extra
    if in_two_stages(problem):
        return TwoStageForm(problem, tangent_of_external_terms(problem) + more, damping)
    form = problem.weak_form.tangent + more
    if damping is not None:
        form += damping.tangent()
    return BilinearForm(compile_forms(problem.body.comm, [form], problem.jit)[0])


def tangent_of_external_terms(problem: Problem) -> ufl.Form:
    """The tangent without that of the internal forces: of loads, springs and contact.

    It may be empty.
    """
    weak_form = problem.weak_form
    work = sum(weak_form.restraint_works.values(), weak_form.external or ufl.Form([]))
    return expand_derivatives(ufl.derivative(-work, problem.w, ufl.TrialFunction(problem.W)))


def moduli(problem: Problem, region: MaterialRegion, damping: Damping | None = None) -> Expr:
    """What tangent.c contracts with shape functions, times the measure's weight.

    For each pair of components i and k of the displacement, i <= k where the tangent is symmetric,
    dP_iJ/dF_kL of shape (dim, dim) [Pa]; where a pressure is unknown, too, these are followed in a
    row by dP/dp (dim, dim), dg/dF (dim, dim) unless the tangent is symmetric, and dg/dp, with the
    pressure's equation g = 0.  The unknown of the pressure is a length, see `Unknowns`.

    Args:
        problem: That is `in_two_stages`.
    """
    of_fields = _of_displacement if problem.W is problem.V else _mixed
    result = of_fields(problem, region, None if damping is None else damping.moduli(region))
    weight = problem.weak_form.volume(region, problem.weak_form.rule(region)).weight
    return result if weight is None else weight * result


def _of_displacement(problem: Problem, region: MaterialRegion, more: Expr | None) -> Expr:
    weak_form = problem.weak_form
    H, F = variables(weak_form.F(problem.w))
    A = ufl.diff(weak_form.response(region, problem.w).stress(F), H)
    return ufl.as_vector(_in_a_row(problem, A if more is None else A + more))


def _in_a_row(problem: Problem, A: Expr) -> list[Expr]:
    """See `moduli`: of A = dP/dF."""
    n = range(problem.body.dim)
    pairs = [(i, k) for i in n for k in n if i <= k or not problem.symmetric]
    return [A[i, J, k, L] for i, k in pairs for J in n for L in n]


def _mixed(problem: Problem, region: MaterialRegion, more: Expr | None) -> Expr:
    weak_form, n = problem.weak_form, range(problem.body.dim)
    scale = problem.unknowns.scale["pressure"]
    H, F = variables(weak_form.F(problem.w))
    p = ufl.variable(problem.unknowns.auxiliary("pressure", problem.w))
    P = weak_form.response(region, problem.w, pressure=p).stress(F)
    A = ufl.diff(P, H)
    result = _in_a_row(problem, A if more is None else A + more)
    if region.compliance is None:
        rows = 1 if problem.symmetric else 2
        result += [ufl.as_ufl(0.0)] * (rows * len(n) ** 2)
        result.append(-(scale**2) * UNUSED / region.shear)
    else:
        gap = weak_form.gap(region, F, pressure=p)
        by_pressure, of_gap = ufl.diff(P, p), ufl.diff(gap, H)
        couplings = [by_pressure] if problem.symmetric else [by_pressure, of_gap]
        result += [scale * X[i, J] for X in couplings for i in n for J in n]
        result.append(scale**2 * ufl.diff(gap, p))
    return ufl.as_vector(result)


def _parts(rest: ufl.Form) -> tuple[ufl.Form, ufl.Form]:
    """The integrals over cells that are the same in all states, as of a spin, and the others."""
    constant, others = list[ufl.Integral](), list[ufl.Integral]()
    for one in rest.integrals():
        varies = one.integral_type() != "cell" or extract_coefficients(one.integrand())
        (others if varies else constant).append(one)
    return ufl.Form(constant), ufl.Form(others)


class TwoStageForm(BilinearForm):
    """The tangent of a problem that is `in_two_stages`. Collective to make.

    Args:
        rest: What it has beside that of the internal forces; may be empty.

    Attributes:
        can_be_halved: Beside it are integrals over facets at most, and the displacement is the only
            unknown.
        has_rest: There is something beside it.
    """

    def __init__(self, problem: Problem, rest: ufl.Form, damping: Damping | None = None) -> None:
        mesh, W = problem.body.mesh, problem.W
        trial, test = ufl.TrialFunction(W), ufl.TestFunction(W)
        every_cell = ufl.dx(domain=mesh, metadata={"quadrature_degree": 0})
        constant, varying = _parts(rest)
        some = [form for form in (constant, varying) if not form.empty()]
        forms = [ufl.inner(trial, test) * every_cell, *some]
        pattern, *made = compile_forms(problem.body.comm, forms, problem.jit)
        super().__init__(pattern)
        self._constant = None if constant.empty() else made[0]
        self._rest = None if varying.empty() else made[-1]
        self._constants = constant.constants()
        self._values: tuple[FloatArray, FloatArray] | None = None  # of `_constant`
        self.has_rest = not rest.empty()
        self._rest_matrix: la.MatrixCSR | None = None
        on_facets = all(one.integral_type() == "exterior_facet" for one in rest.integrals())
        self.can_be_halved = on_facets and W is problem.V
        self._half: SymmetricBlocks | None = None  # of which `_places` are
        self._terms = [_Term(problem, region, damping) for region in problem.regions]
        self._nodes, self._stride = _nodes(problem), _stride(problem)
        self._dim, self._displacements = problem.body.dim, problem.V.dofmap.list.shape[1]
        self._start: IntArray = np.empty(0, dtype=np.int64)
        self._places: IntArray = np.empty(0, dtype=np.uint16)  # of pairs of nodes, or of halves

    def assemble(self, matrix: la.MatrixCSR, bcs: Conditions) -> None:
        """See `BilinearForm.assemble`."""
        fixed = marked(bcs, len(matrix.indptr) - 1)
        if self._constant is not None:
            matrix.data[:] += self._of_constant(matrix, bcs, fixed)
        if self._rest is None:
            space = self.form.function_spaces[0]
            conditions = [bc._cpp_object for bc in bcs]
            cpp.fem.insert_diagonal(matrix._cpp_object, space, conditions, 1.0)
        else:
            fem.assemble_matrix(matrix, self._rest, list(bcs))
        if self._places.ndim != 3:
            self._find_places(matrix)
        offsets = (self._nodes, fixed, self._start, self._places, matrix.data)
        for term in self._terms:
            term.call("add_tangent", term.cells, *offsets)

    def _of_constant(
        self, matrix: la.MatrixCSR, bcs: Conditions, fixed: NDArray[np.int8]
    ) -> FloatArray:
        """Values of what is the same in all states, assembled where a constant is another. Local.

        Args:
            matrix: Its pattern is that of the values; it is as it was afterwards.
            fixed: Which unknowns `bcs` prescribe.
        """
        key = np.concatenate([fixed, *(np.ravel(c.value) for c in self._constants)])
        if self._values is None or not np.array_equal(key, self._values[0]):
            before = matrix.data.copy()
            matrix.data[:] = 0.0
            fem.assemble_matrix(matrix, self._constant, list(bcs), diagonal=0.0)
            self._values = key, matrix.data.copy()
            matrix.data[:] = before
        return self._values[1]

    def assemble_half(self, blocks: SymmetricBlocks, bcs: Conditions) -> None:
        """Assembles it by the half of its blocks, `rest_blocks` apart. Local.

        Args:
            blocks: Are overwritten; those of rows of other ranks are not yet sent there.
            bcs: Whose rows and columns are left out.
        """
        n, far = blocks.halo.owned, blocks.far
        pattern = (n, blocks.start, blocks.columns)
        if self._places.ndim != 2 or self._half is not blocks:
            self._half = blocks
            pairs = self._displacements * (self._displacements + 1) // 2
            self._places = np.zeros((len(self._nodes), pairs), dtype=np.uint16)
            self._find("find_upper_places", *pattern)
        blocks.clear()
        fixed = marked(bcs, self._dim * blocks.halo.size)
        offsets = (self._nodes, fixed, self._places, n, blocks.start, blocks.high, blocks.low)
        others = (len(far.start) - 1, far.start, far.columns, far.blocks)
        for term in self._terms:
            term.call("add_half", term.cells, *offsets, *others)

    def rest_blocks(self) -> Blocks:
        """What is beside the tangent of the internal forces, which `can_be_halved`. Local."""
        assert self._rest is not None
        if self._rest_matrix is None:
            self._rest_matrix = fem.create_matrix(self._rest, la.BlockMode.compact)
        A = self._rest_matrix
        A.data[:] = 0.0
        fem.assemble_matrix(A, self._rest)
        rows = np.repeat(np.arange(len(A.indptr) - 1, dtype=np.int32), np.diff(A.indptr))
        of_rows, of_columns = A.index_map(0), A.index_map(1)
        pairs = of_rows.local_to_global(rows), of_columns.local_to_global(A.indices)
        return Blocks(*pairs, A.data.reshape(-1, self._dim, self._dim))

    def lift(self, out: FloatArray, bcs: Conditions, values: FloatArray, w: FloatArray) -> None:
        """See `BilinearForm.lift`."""
        for form in (self._constant, self._rest):
            if form is not None:
                fem.apply_lifting(out, [form], [list(bcs)], [w], -1.0)
        direction = np.where(marked(bcs, len(w)), values - w, 0.0)
        touched = self._touched(direction != 0.0)
        for term in self._terms:
            cells = term.cells[touched[term.cells]]
            term.call("add_product", cells, self._nodes, direction, out)

    def _touched(self, moved: BoolArray) -> BoolArray:
        """Which cells have an unknown that moves."""
        if self._stride > 1:
            at_nodes: BoolArray = np.asarray(moved.reshape(-1, self._stride).any(axis=1))
            return np.asarray(at_nodes[self._nodes].any(axis=1))
        mask: BoolArray = np.asarray(moved[self._nodes].any(axis=1))
        for i in range(1, self._dim):
            mask |= moved[self._nodes[:, : self._displacements] + i].any(axis=1)
        return mask

    def _find_places(self, matrix: la.MatrixCSR) -> None:
        """First column of node b within the rows of node a, for each cell's pairs of nodes."""
        cells, nodes = self._nodes.shape
        self._start = matrix.indptr.astype(np.int64)
        self._places = np.zeros((cells, nodes, nodes), dtype=np.uint16)
        columns = np.ascontiguousarray(matrix.indices, dtype=np.int32)
        self._find("find_places", len(self._start) - 1, self._start, columns)

    def _find(self, loop: str, *pattern: int | AnyArray) -> None:
        for term in self._terms:
            cells, nodes = term.cells, self._nodes
            where = (len(cells), cells, len(nodes), nodes, *pattern, self._places)
            missing = term.moduli.loops.call(loop, *where)
            if missing >= 0:
                raise RuntimeError(f"the matrix has no entries for the tangent of cell {missing}")


class _Term:
    """Moduli of one region, compiled, and what the kernel needs to know of its elements."""

    def __init__(self, problem: Problem, region: MaterialRegion, damping: Damping | None) -> None:
        mesh, mixed = problem.body.mesh, problem.W is not problem.V
        self.cells = np.ascontiguousarray(region.cells, dtype=np.int32)
        # At least what integrates the product of two pressures.
        degree = max(2 if mixed else 0, problem.weak_form.rule(region))
        points, weights = basix.make_quadrature(mesh.basix_cell(), degree)
        gradients, corners, sizes = tabulated(problem, points)
        pressures = np.zeros((len(weights), 0))
        if mixed:
            tabulated_pressures = problem.W.sub(1).element.basix_element.tabulate(0, points)
            pressures = np.ascontiguousarray(tabulated_pressures[0, :, :, 0])
        self._tables = (gradients, pressures, corners, np.ascontiguousarray(weights))
        sizes |= {"NP": pressures.shape[1], "SYMMETRIC": int(problem.symmetric)}
        sizes |= {"STRIDE": _stride(problem)}
        values, loops = moduli(problem, region, damping), Loops("tangent.c", sizes)
        self.moduli = CellExpression(values, points, problem.w, problem.jit, loops)
        self._block = max(1, BLOCK // self.moduli.size)

    def call(self, loop: str, cells: IndexArray, *arguments: int | AnyArray) -> None:
        """Calls a loop of tangent.c.

        Args:
            arguments: What it takes after moduli and tables.
        """
        for some, given in self._moduli_of(cells):
            self.moduli.call(loop, some, len(given), given, *self._tables, *arguments)

    def _moduli_of(self, cells: IndexArray) -> Iterator[tuple[IndexArray, FloatArray]]:
        """Cells, with their `moduli` at the points if no kernel has them, until the next ones."""
        if self.moduli.kernel is not None:
            yield cells, np.empty((0, self.moduli.size))
            return
        room = np.empty((min(self._block, len(cells)), self.moduli.size))
        for first in range(0, len(cells), self._block):
            some = cells[first : first + self._block]
            yield some, self.moduli.eval(some, room[: len(some)])


def tabulated(
    problem: Problem, points: FloatArray
) -> tuple[FloatArray, FloatArray, dict[str, int]]:
    """Derivatives of shape functions by reference coordinates, as gradients.h reads them.

    Args:
        points: In the reference cell, shape (points, dim).

    Returns:
        Those of the displacement, of shape (points, dim, nodes) with zeros up to whole vector
        registers; those of the geometry, of shape (points, nodes, dim); and all sizes.
    """
    mesh, dim = problem.body.mesh, problem.body.dim
    coordinates = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    corners = np.ascontiguousarray(coordinates.tabulate(1, points)[1:].transpose(1, 2, 0))
    shape = problem.V.element.basix_element.tabulate(1, points)[1:, :, :, 0]
    nodes = shape.shape[2]
    padded = -(-nodes // 4) * 4
    gradients = np.zeros((len(points), dim, padded))
    gradients[:, :, :nodes] = shape.transpose(1, 0, 2)
    sizes = {"DIM": dim, "ND": nodes, "NDP": padded, "NG": corners.shape[1], "NQ": len(points)}
    return gradients, corners, sizes


def _entries(problem: Problem) -> IndexArray:
    """Entries of all unknowns of each node of the displacement, of shape (nodes, dim)."""
    entries = problem.unknowns.mixed_dofs(np.arange(len(problem.u.x.array), dtype=np.int32))
    return entries.reshape(-1, problem.body.dim)


def _nodes(problem: Problem) -> IndexArray:
    """The kernel's `nodes`: numbers of nodes, or first unknowns where there is a pressure.

    Of each cell: those of the displacement, then those of the pressure.
    """
    if problem.W is problem.V:
        return np.ascontiguousarray(problem.V.dofmap.list, dtype=np.int32)  # DOLFINx's: no copy
    moving = _entries(problem)[:, 0][problem.V.dofmap.list]
    pressures = problem.W.sub(1).dofmap.list
    return np.ascontiguousarray(np.concatenate([moving, pressures], axis=1), dtype=np.int32)


def _stride(problem: Problem) -> int:
    """By what the kernel's `nodes` are multiplied to be numbers of first unknowns."""
    return problem.body.dim if problem.W is problem.V else 1
