"""Gradients by fields: by a constant of a material in each cell, and by the positions of nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import interpolation_matrix
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, MeshError, nearest
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.ghosts import assembled
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.loads import BodyForce, Force, Gravity, Pressure, Traction
from dolfin_elastic.model.materials.spatial import SpatialDirection, SpatialFormula
from dolfin_elastic.model.supports.displacement import Restraint, Rotation
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import PLACE
from dolfin_elastic.problem.constraints.normals import surface_normals
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Term
from dolfin_elastic.problem.terms.bodies.contact import BodyContact
from dolfin_elastic.solvers.assembly.assembler import compiled, integral
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.nonlinear.adjoint import AdjointState
from dolfin_elastic.study.gradient.functionals import Functional
from dolfin_elastic.study.gradient.parameters import STEP, WEIGHTS
from dolfin_elastic.study.quiet import quietly


class _Field:
    """The virtual work of all forces on an adjoint as a form.

    Attributes:
        adjoint: A function of all unknowns.
        work: The form.
    """

    def __init__(self, dofs: ConstrainedDofs, residual: ufl.Form | None = None) -> None:
        self.dofs, self.problem = dofs, dofs.problem
        self.adjoint = fem.Function(self.problem.W)
        forces = self.problem.weak_form.residual if residual is None else residual
        self.work = ufl.action(forces, self.adjoint)
        self._forms: dict[str, fem.Form] = {}

    def _take(self, adjoint: AdjointState, functional: Functional) -> None:
        """Sets the adjoint, with the motion whose work the functional is. Collective."""
        motion, values = functional.motion(), adjoint.fields.copy()
        self.dofs.extend(values)
        self.adjoint.x.array[: len(values)] = values + (0.0 if motion is None else motion)
        self.adjoint.x.scatter_forward()

    @property
    def _motion(self) -> FloatArray:
        """The adjoint as a displacement, its local entries."""
        problem = self.problem
        entries = problem.unknowns.mixed_dofs(np.arange(len(problem.u.x.array), dtype=np.int32))
        return np.asarray(self.adjoint.x.array[entries])

    def _compiled(self, name: str, form: Callable[[], ufl.Form]) -> fem.Form:
        if name not in self._forms:
            self._forms[name] = compiled(self.problem, [form()])[0]
        return self._forms[name]


class CellConstant(_Field):
    """A constant of one material as a field with a value in each of its cells.  Collective.

    What the forces of a cell and the integrals over it are changes with its own value alone, so
    that all cells are changed at once, by differences as in `parameters`.

    Args:
        key: Dotted, "materials.NAME.E"; a constant, or one that varies in space.
        residual: Virtual work of the equations; None: of the problem's.

    Raises:
        InputError: There is no such constant.
    """

    def __init__(self, key: str, dofs: ConstrainedDofs, residual: ufl.Form | None = None) -> None:
        super().__init__(dofs, residual)
        self.key, (self.region, self._coefficient) = key, coefficient_of(key, self.problem)
        self._cells = fem.functionspace(self.problem.body.mesh, ("DG", 0))

    def by_logarithm(self, adjoint: AdjointState | None, functional: Functional) -> FloatArray:
        """dQ/d ln m of each owned cell, in the unit of Q; 0 in other materials. Collective.

        Args:
            adjoint: None: the number does not depend on the unknowns.
            functional: At the equilibrium at which its value was asked for last.
        """
        test, parts = ufl.TestFunction(self._cells), list[tuple[float, fem.Form]]()
        if adjoint is not None:
            self._take(adjoint, functional)
            parts.append((1.0, self._compiled("work", lambda: _in_cells(self.work, test))))
        if (own := functional.form) is not None:
            parts.append(
                (functional.factor, self._compiled(functional.name, lambda: _in_cells(own, test)))
            )
        coefficient = self._coefficient
        values = coefficient.x.array if isinstance(coefficient, fem.Function) else coefficient.value
        start, result = values.copy(), np.zeros(len(self.problem.body.owned_cells()))
        of_means = 0.0
        try:
            for k, weight in WEIGHTS.items():
                values[...] = start * (1 + k * STEP)
                for factor, form in parts:
                    result += weight / STEP * factor * assembled(form, self._cells)
                if adjoint is not None:
                    of_means += weight / STEP * self._of_contact()
        finally:
            values[...] = start
        chosen = np.zeros(len(result), dtype=bool)
        chosen[self.region.cells] = True
        return np.where(chosen, result + of_means / total(self.problem.body.comm, chosen.sum()), 0)

    def _of_contact(self) -> float:
        """The work of forces of contact that are in no form on the adjoint. Collective.

        They depend on means of a constant over the cells of a material, see `FaceBulges`.
        """
        forces = np.zeros(len(self.problem.u.x.array))
        for pair in self.problem.contact_pairs:
            pair.add_forces(forces)
        return -total(self.problem.body.comm, float(forces @ self._motion))


def _in_cells(form: ufl.Form, test: Expr) -> ufl.Form:
    """An integral as a linear form whose entries are those over the cells."""
    return ufl.Form([one.reconstruct(integrand=one.integrand() * test) for one in form.integrals()])


def coefficient_of(
    key: str, problem: Problem
) -> tuple[MaterialRegion, fem.Constant | fem.Function]:
    """The region of a constant, and what its law has in its place. Not collective.

    Raises:
        InputError: There is none that is a number.
    """
    known = {
        f"{region.table}.{name}": (
            region,
            region.constants.get(name, getattr(region.law, name, None)),
        )
        for region in problem.regions
        for name in [*region.constants, *region.given.spatial_constants()]
    }
    region, coefficient = known.get(key, (None, None))
    scalar = isinstance(coefficient, fem.Constant | fem.Function) and not coefficient.ufl_shape
    if region is None or not scalar:
        raise InputError(
            f"no material has a constant '{key}' that could vary from cell to cell",
            where="--field",
            expected=nearest(key, known),
        )
    return region, coefficient


def _depends_on_place(support: Restraint) -> bool:
    """Whether it prescribes displacements that differ from node to node."""
    values = [one for vector in support.time_functions for one in vector]
    of_place = any(isinstance(one, Formula) and one.names & PLACE for one in values)
    return of_place or isinstance(support, Rotation | Rigid)


_SHAPED = (Traction, Force, Pressure, BodyForce, Gravity)
"""Loads whose dependence on the positions of nodes is known."""


def _between(problem: Problem) -> list[BodyContact]:
    """Contacts between surfaces of the mesh."""
    return [pair for pair in problem.contact_pairs if isinstance(pair, BodyContact)]


def check_shape(problem: Problem) -> None:
    """Checks that what depends on the positions of nodes is known. Not collective.

    Raises:
        InputError: Something depends on them in a way that is in no form.
    """
    between = _between(problem)
    known = [
        one
        for one in problem.loads
        if isinstance(one, _SHAPED)
        and not any(isinstance(c, Formula) and c.names & PLACE for c in one.values)
    ]
    others: list[object] = [one for one in problem.loads if one not in known]
    others += [one for one in problem.terms if one not in between]
    others += [problem.cell] if problem.cell else []
    if between and problem.unknowns.degree < problem.body.mesh.geometry.cmap.degree:
        others.append("contact of linear elements with curved faces")
    others += [one for one in problem.supports if _depends_on_place(one)]
    others += [
        f"{region.name}.{name}"
        for region in problem.regions
        for name, value in region.given.spatial_constants().items()
        if isinstance(value, SpatialFormula | SpatialDirection)
    ]
    if others or problem.constraints.combined or problem.unknowns.stabilised:
        what = others[0] if others else "a tie, an oblique support or a stabilised pressure"
        named = f"'{what if isinstance(what, str) else type(what).__name__}'"
        if isinstance(what, Term) and what.account == "contact":
            named = f"contact of '{what.label}'"
        raise InputError(
            f"there is no gradient by the shape with {named}",
            where="--offset",
            expected="tractions, total forces, pressures, gravity, fixed supports, and contact "
            "between surfaces of the mesh",
        )


class Shape(_Field):
    """The positions of the nodes of the undeformed body, see `check_shape`.  Collective.

    Args:
        residual: See `CellConstant`.

    Attributes:
        V: Space of the positions.
    """

    def __init__(self, dofs: ConstrainedDofs, residual: ufl.Form | None = None) -> None:
        super().__init__(dofs, residual)
        problem = self.problem
        self._between = _between(problem)
        mesh = problem.body.mesh
        self.V = _positions(problem.body)
        self._x, self._test = ufl.SpatialCoordinate(mesh), ufl.TestFunction(self.V)
        # The traction of a total force is that over the area, which is a constant of the form.
        loads = [(load, work) for load, work in problem.weak_form.works if type(load) is Force]
        self._forces = [
            compiled(problem, [ufl.action(work, self.adjoint), one, self._by(one)])
            for load, work in loads
            for one in [problem.constant(1.0) * problem.context.areas(load.parts)]
        ]

    def by_positions(self, adjoint: AdjointState | None, functional: Functional) -> FloatArray:
        """dQ/dX at owned entries of `V` [Q's unit per m]. Collective.

        Args:
            adjoint: None: the number does not depend on the unknowns.
        """
        result = np.zeros(self.V.dofmap.index_map.size_local * self.problem.body.dim)
        if adjoint is not None:
            self._take(adjoint, functional)
            result += assembled(self._compiled("work", lambda: self._by(self.work)), self.V)
        for work, area, change in self._forces if adjoint is not None else ():
            share = integral(self.problem, work) / integral(self.problem, area)
            result += share * assembled(change, self.V)
        if adjoint is not None and self._between:
            result += self._of_contact(adjoint)
        if (own := functional.form) is not None:
            own_change = self._compiled(functional.name, lambda: self._by(own))
            result += functional.factor * assembled(own_change, self.V)
        further = functional.by_positions(self.V)
        return result if further is None else result + further

    def _of_contact(self, adjoint: AdjointState) -> FloatArray:
        """The same of the forces of contact between surfaces, and of its gaps. Collective."""
        start, parts = 0, []
        for pair in self._between:
            end = start + len(pair.nodes)
            of_gaps = -pair.eps * adjoint.pressures[start:end]
            parts.append(pair.by_positions(-self._motion, of_gaps).ravel())
            start = end
        matrix = interpolation_matrix(self.V, self.problem.V)
        matrix.assemble()
        x, y = matrix.createVecs()
        y.array_w[:] = sum(parts)
        matrix.multTranspose(y, x)
        result = np.array(x.array_r)
        for one in (matrix, x, y):
            one.destroy()
        return result

    def _by(self, form: ufl.Form) -> ufl.Form:
        return ufl.derivative(form, self._x, self._test)

    def offset(self, surface: str) -> FloatArray:
        """Motion of a surface, see `nodes_moved`, at owned entries of `V`. Collective."""
        with quietly():  # an edge was told by `nodes_moved`
            rows = _normals(self.problem.body, self.V, surface)
        return rows[: self.V.dofmap.index_map.size_local].reshape(-1)

    def at_nodes(self, entries: FloatArray) -> FloatArray:
        """Owned entries of `V` at the local nodes of the geometry, ghosts included. Collective."""
        rows = fem.Function(self.V)
        rows.x.array[: len(entries)] = entries
        rows.x.scatter_forward()
        return _at_geometry(self.V, rows.x.array.reshape(-1, self.problem.body.dim))


OFFSET = "offset of "
"""Begins the name of the parameter by which a surface moves along its normal [m]."""


def nodes_moved(body: Body, surface: str) -> FloatArray:
    """Motion of nodes as a surface moves along its outward normal by 1 m. Collective.

    Nodes inside the body stay where they are.

    Returns:
        At the local nodes of the geometry, ghosts included, shape (nodes, dim).

    Raises:
        InputError: The body has no such surface, or it lies inside.
    """
    V = _positions(body)
    return _at_geometry(V, _normals(body, V, surface))


def _positions(body: Body) -> fem.FunctionSpace:
    """Space of the positions of nodes."""
    degree = int(body.mesh.geometry.cmap.degree)
    return fem.functionspace(body.mesh, ("Lagrange", degree, (body.dim,)))


def _normals(body: Body, V: fem.FunctionSpace, surface: str) -> FloatArray:
    """Normals of a surface at local nodes of a space, shape (nodes, dim); 0 elsewhere."""
    try:
        normals = surface_normals(body, V, surface)
    except MeshError as error:
        raise InputError(error.what, where="--offset", expected=error.expected) from None
    index_map = V.dofmap.index_map
    rows = np.zeros((index_map.size_local + index_map.num_ghosts, body.dim))
    rows[normals.nodes] = normals.normals
    return rows


def _at_geometry(V: fem.FunctionSpace, rows: FloatArray) -> FloatArray:
    """Rows at local nodes of the space of positions at those of the geometry."""
    geometry = V.mesh.geometry
    result = np.zeros((len(geometry.x), rows.shape[1]))
    result[geometry.dofmap] = rows[V.dofmap.list]
    return result
