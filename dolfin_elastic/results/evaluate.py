"""`Evaluator`: the values of fields in a state, on the rank that owns the node or cell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import basix
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.problem.mesh_fields import fields_at_nodes
from dolfin_elastic.problem.state import State
from dolfin_elastic.problem.terms.contact.friction import SLIP
from dolfin_elastic.results.cell_fields import CellKernel, cell_kernel, unknowns_of_outputs
from dolfin_elastic.results.components import check_axes, component_rows
from dolfin_elastic.results.field import Component, RecoveredField
from dolfin_elastic.results.fields import check_field_names, laws_of, table_of
from dolfin_elastic.results.grid import Grid
from dolfin_elastic.results.recovery.error import ErrorEstimate, ErrorEstimator
from dolfin_elastic.results.recovery.stress import NodalStress, StressRecovery

if TYPE_CHECKING:
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem


class NodalNormals:
    """Unit normals of the deformed surface at the nodes on it; zeros inside.  Collective.

    At a node it is the direction of the sum of the area vectors that its facets have there: on an
    edge of the body the mean of its faces' normals, by the areas of the facets beside it.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        mesh, tdim = V.mesh, V.mesh.topology.dim
        self._V, self._dim = V, tdim
        mesh.topology.create_connectivity(tdim - 1, tdim)
        mesh.topology.create_connectivity(tdim, tdim - 1)
        facets = exterior_facet_indices(mesh.topology)
        cell_of = mesh.topology.connectivity(tdim - 1, tdim)
        facets_of = mesh.topology.connectivity(tdim, tdim - 1)
        cells = [int(cell_of.links(facet)[0]) for facet in facets]
        local = [
            int(np.flatnonzero(facets_of.links(cell) == facet)[0])
            for cell, facet in zip(cells, facets, strict=True)
        ]
        element = V.element.basix_element
        closure = [np.asarray(element.entity_closure_dofs[tdim - 1][i]) for i in range(tdim + 1)]
        lists = V.dofmap.list
        width = len(closure[0])
        self._nodes = np.array(
            [lists[cell, closure[i]] for cell, i in zip(cells, local, strict=True)], dtype=np.int64
        ).reshape(-1, width)
        self._opposite = np.array(
            [lists[cell, i] for cell, i in zip(cells, local, strict=True)], dtype=np.int64
        )
        kind = basix.CellType.interval if tdim == 2 else basix.CellType.triangle
        facet = basix.create_element(
            basix.ElementFamily.P,
            kind,
            V.element.basix_element.degree,
            basix.LagrangeVariant.equispaced,
        )
        self._slopes = np.asarray(facet.tabulate(1, facet.points)[1:, :, :, 0])
        self._places = np.asarray(V.tabulate_dof_coordinates())

    def __call__(self, u: fem.Function) -> FloatArray:
        """Normals at the owned nodes, shape (nodes, 3).

        Args:
            u: The displacement [m], ghosts up to date.
        """
        dim = self._dim
        x = self._places.copy()
        x[:, :dim] += u.x.array.reshape(-1, dim)
        # Tangents at the nodes: the derivatives of the shape functions times the nodes' places.
        tangents = np.einsum("dpn,fni->dfpi", self._slopes, x[self._nodes])
        out_of_plane = np.broadcast_to([0.0, 0.0, 1.0], tangents[0].shape)
        areas = np.cross(tangents[0], tangents[1] if dim == 3 else out_of_plane)
        outward = x[self._nodes].mean(axis=1) - x[self._opposite]
        turned = np.einsum("fpi,fi->f", areas, outward) < 0
        areas[turned] *= -1.0
        table = summed(self._V.dofmap.index_map, self._nodes, areas)
        own = table[: self._V.dofmap.index_map.size_local]
        lengths = np.linalg.norm(own, axis=1, keepdims=True)
        return np.asarray(own / np.where(lengths > 0, lengths, 1.0))


class Evaluator:
    """Evaluates fields of a problem's states.  All of it is collective.

    The constructor compiles one kernel of all fields of cells per material.

    Raises:
        InputError: An unknown field, or an energy density without an energy.

    Attributes:
        table: Name to field, those of the body among them.
    """

    def __init__(self, problem: Problem, names: Iterable[str]) -> None:
        self.problem, self.names = problem, check_field_names(names, problem.body, laws_of(problem))
        self.table = table_of(problem)
        check_axes(self.names, problem.axes, self.table)
        wholes = {self.table[name].whole or name for name in self.names}
        self.grid = Grid(problem.V, problem.places)
        self._w = unknowns_of_outputs(problem)
        self.fields_at_nodes = fields_at_nodes(problem.body, problem.V)
        self.cell_names = tuple(name for name in self.names if self._of_cells(name))
        self._kernels = [self._kernel(part) for part in problem.regions] if self.cell_names else []
        self._error = ErrorEstimator(problem) if "error" in self.names else None
        recovered = any(self.table[name].recovered for name in self.names)
        self._recovery = StressRecovery(problem) if recovered else None
        if {"reaction", "residual"} & wholes:
            _ = self.residual
        if "normal" in wholes:
            _ = self.normals

    def _kernel(self, region: MaterialRegion) -> CellKernel | None:
        dim = self.problem.body.dim
        barycentre = np.full((1, dim), 1 / (dim + 1))
        return cell_kernel(self.problem, region, self._w, self.cell_names, barycentre)

    def _of_cells(self, name: str) -> bool:
        """Whether a field is evaluated by its formula, once per cell."""
        return self.table[name].centre == "cell" and self.table[name].formula is not None

    @property
    def _widths(self) -> list[int]:
        return [self.table[name].evaluated for name in self.cell_names]

    @cached_property
    def normals(self) -> NodalNormals:
        """Of the body's surface."""
        return NodalNormals(self.problem.V)

    @cached_property
    def residual(self) -> fem.Form:
        """Compiled residual at `unknowns_of_outputs`; solvers have the same kernel."""
        form = ufl.replace(self.problem.weak_form.residual, {self.problem.w: self._w})
        return compile_forms(self.problem.body.comm, [form], self.problem.jit)[0]

    def __call__(self, state: State, more: Iterable[str] = ()) -> dict[str, AnyArray]:
        """Name to this rank's rows of each field. Collective.

        Args:
            more: Further fields, which have no formula.

        Returns:
            Rows of the owned points or cells: floats of shape (rows, 1, 3 or 9), or integers of
            shape (rows, 1).

        Raises:
            InputError: A field of motion is asked for in statics, or the reverse.
        """
        self._w.x.array[:] = (state.w or state.u).x.array
        error = None if self._error is None else self._error(state)
        stress = None if self._recovery is None else self._recovery(state)
        source = StateSource(self, state, self._cells(), stress, error)
        return {name: source.get(name) for name in (*self.names, *more)}

    def _cells(self) -> dict[str, AnyArray]:
        widths = self._widths
        table = np.full((self.grid.own_cells, sum(widths)), np.nan)
        for kernel, part in zip(self._kernels, self.problem.regions, strict=False):
            if len(part.cells) and kernel is not None:
                table[part.cells[:, None], kernel.columns] = kernel(part.cells)[:, 0]
        ends = np.cumsum(widths)
        return {
            name: self.table[name].finished(table[:, end - width : end])
            for name, width, end in zip(self.cell_names, widths, ends, strict=True)
        }


@dataclass(frozen=True)
class StateSource:
    """The `FieldSource` of one state.

    Attributes:
        evaluator: Has the problem, its grid and the compiled residual.
        state: The state.
        cells: Fields of cells that are evaluated already.
        stress: The recovered stress, where a field needs it.
        error: The estimated error, where a field needs it.
    """

    evaluator: Evaluator
    state: State
    cells: dict[str, AnyArray]
    stress: NodalStress | None = None
    error: ErrorEstimate | None = None

    def get(self, name: str) -> AnyArray:
        """This rank's rows of a field. Collective."""
        field = self.evaluator.table[name]
        return field.values(self) if field.values else self.cells[name]

    def nodal(self, name: Literal["u", "v", "a"]) -> AnyArray:
        """See `FieldSource`."""
        function = getattr(self.state, name)
        if function is None:
            raise InputError(
                f"the state of step {self.state.step} has no '{name}'",
                expected="velocity and acceleration exist in motion only",
            )
        return self._padded(function.x.array)

    def _own(self) -> int:
        return int(self.evaluator.grid.own_points * self.evaluator.grid.mesh.geometry.dim)

    def _padded(self, array: AnyArray) -> AnyArray:
        grid = self.evaluator.grid
        dim = grid.mesh.geometry.dim
        values = np.zeros((grid.own_points, 3))
        values[:, :dim] = array[: grid.own_points * dim].reshape(-1, dim)
        return values

    def reaction(self) -> AnyArray:
        """See `FieldSource`."""
        return self._padded(self._out_of_balance("reaction"))

    def residual(self) -> AnyArray:
        """See `FieldSource`."""
        forces = self._out_of_balance("residual")
        conditions = self.evaluator.problem.constraints
        forces[conditions.dofs[conditions.dofs < len(forces)]] = 0.0
        if conditions.skewed:
            forces = conditions.free_part(forces)
        return self._padded(forces)

    def _out_of_balance(self, name: str) -> AnyArray:
        if self.state.v is not None:
            raise InputError(
                f"the state of step {self.state.step} is in motion: its nodal forces are not in "
                "equilibrium",
                expected=f"the field '{name}' exists in statics only",
            )
        problem = self.evaluator.problem
        if problem.history is not None:
            problem.history.follow()
        force = fem.assemble_vector(self.evaluator.residual)
        force.scatter_reverse(la.InsertMode.add)
        moves = problem.unknowns.displacement_dofs
        force.array[moves] = problem.constraints.collect(force.array[moves])
        force.scatter_forward()  # nodes of periodic faces may be unknowns of another rank
        offsets = self.evaluator.problem.unknowns.mixed_dofs
        return np.asarray(force.array[offsets(np.arange(self._own(), dtype=np.int32))])

    def recovered(self, name: RecoveredField) -> AnyArray:
        """See `FieldSource`."""
        assert self.stress is not None
        return self.stress.rows(name)

    def component(self, component: Component, rows: AnyArray) -> AnyArray:
        """See `FieldSource`."""
        problem = self.evaluator.problem
        return component_rows(problem, component, rows, problem.places[: len(rows)])

    def contact_pressure(self) -> AnyArray:
        """See `FieldSource`; of the problem's present state, which is the one that is written."""
        values = np.zeros((self.evaluator.grid.own_points, 1))
        for pair in self.evaluator.problem.contact_pairs:
            nodes, pressures = pair.nodal_pressures()
            values[nodes, 0] += pressures
        return values

    def contact_gap(self) -> AnyArray:
        """See `FieldSource`; as `contact_pressure`. Not a number where no contact is."""
        values = np.full((self.evaluator.grid.own_points, 1), np.nan)
        for pair in self.evaluator.problem.contact_pairs:
            nodes, gaps = pair.nodal_gaps()
            values[nodes, 0] = np.fmin(values[nodes, 0], gaps)
        return values

    def friction_traction(self) -> AnyArray:
        """See `FieldSource`; as `contact_pressure`."""
        problem = self.evaluator.problem
        values = np.zeros((self.evaluator.grid.own_points, 3))
        for friction in problem.frictions:
            nodes, tractions = friction.nodal_tractions()
            values[nodes, : problem.body.dim] += tractions
        return values

    def contact_status(self) -> AnyArray:
        """See `FieldSource`; as `contact_pressure`. What has no friction slides."""
        problem = self.evaluator.problem
        values = np.zeros((self.evaluator.grid.own_points, 1), dtype=np.int32)
        for pair in problem.contact_pairs:
            nodes, pressures = pair.nodal_pressures()
            values[nodes[pressures > 0.0], 0] = SLIP
        for friction in problem.frictions:
            nodes, status = friction.nodal_status()
            values[nodes, 0] = status
        return values

    def normal(self) -> AnyArray:
        """See `FieldSource`."""
        return self.evaluator.normals(self.state.u)

    def stress_error(self) -> AnyArray:
        """See `FieldSource`."""
        assert self.error is not None
        return self.error.stress_in_cells[:, None]

    def region(self) -> AnyArray:
        """See `FieldSource`; the last region where several overlap."""
        body = self.evaluator.problem.body
        numbers = np.full((self.evaluator.grid.own_cells, 1), -1, dtype=np.int32)
        for i, name in enumerate(sorted(body.regions)):
            numbers[body.owned_cells(name)] = i
        return numbers

    def material(self) -> AnyArray:
        """See `FieldSource`."""
        numbers = np.zeros((self.evaluator.grid.own_cells, 1), dtype=np.int32)
        for i, part in enumerate(self.evaluator.problem.regions):
            numbers[part.cells] = i
        return numbers

    def rank(self) -> AnyArray:
        """See `FieldSource`."""
        grid = self.evaluator.grid
        return np.full((grid.own_cells, 1), grid.mesh.comm.rank, dtype=np.int32)

    def of_body(self, name: str) -> AnyArray:
        """See `FieldSource`."""
        evaluator, field = self.evaluator, self.evaluator.problem.body.mesh_field(name)
        if field.centre == "cell":
            own = field.values[: evaluator.grid.own_cells]
        else:
            own = evaluator.fields_at_nodes(name)[: evaluator.grid.own_points]
        return np.pad(own, ((0, 0), (0, int(field.columns == 2))))  # vectors have three components
