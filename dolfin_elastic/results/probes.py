"""Probes: values of fields at points of the undeformed body, and means over surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from dolfinx import fem
from pydantic import Field as Key
from pydantic import field_validator, model_validator

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.core.units import MeshLength, metres
from dolfin_elastic.mesh.geometry.curved import cell_volumes
from dolfin_elastic.mesh.geometry.locate import LocatedPoint, locate
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.problem.state import State
from dolfin_elastic.problem.terms.edges_points import points_of
from dolfin_elastic.results.cell_fields import CellKernel, cell_kernel, unknowns_of_outputs
from dolfin_elastic.results.components import check_axes, component_rows
from dolfin_elastic.results.derived.part_numbers import (
    NODAL,
    PartNumbers,
    check_surface,
    nodal_function,
)
from dolfin_elastic.results.derived.reductions import reduction_of
from dolfin_elastic.results.derived.sections import Section, SectionForces
from dolfin_elastic.results.field import Field
from dolfin_elastic.results.fields import (
    check_field_names,
    component_names,
    field_table,
    laws_of,
    table_of,
)
from dolfin_elastic.results.moments import ReferencePoints, columns_of_moments
from dolfin_elastic.results.reactions import REACTION, ReactionSums
from dolfin_elastic.results.recovery.patches import sampling_points
from dolfin_elastic.results.recovery.stress import StressAtPoints, cells_around, is_recovered
from dolfin_elastic.results.writers.history import row

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.problem.problem import Problem

_WHERE = "output.probes"


class ProbePoint(Record):
    """A point of the undeformed body where fields are evaluated, or a part for their means.

    Attributes:
        at: The point's coordinates, bare numbers in the mesh's unit.
        on: Name of a surface, edge or point in place of coordinates.
        surface: The same for a surface.
        fields: Names of `field_table`: displacement, velocity, acceleration, those of cells and
            those of the body; with `values` all of them.
        values: Of a surface or region: which numbers of the fields are asked for, names of
            `REDUCTIONS` such as "max" or "percentile:95"; by default the mean.
    """

    at: Annotated[list[MeshLength], Key(min_length=2, max_length=3)] | None = None
    on: str | None = None
    surface: str | None = None
    fields: tuple[str, ...] = ("displacement",)
    values: tuple[str, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: object) -> object:
        """A list of coordinates stands for a point where the displacement is evaluated."""
        return {"at": value} if isinstance(value, list | tuple) else value

    @field_validator("values")
    @classmethod
    def _statistics(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for index, name in enumerate(names):
            try:
                reduction_of(name)
            except InputError as error:
                raise error.at(f"[{index}]") from None
        return names

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = [key for key in ("at", "on", "surface") if getattr(self, key) is not None]
        if len(given) != 1:
            what = (
                f"{given[0]} and {given[1]} are given together" if given else "no position is given"
            )
            raise InputError(what, expected="at = [x, y, z], or on with the name of a part")
        if self.values and self.at is not None:
            raise InputError(
                "values are those of a surface or region, and this is a point",
                where="values",
                expected="on = the name of a surface or region, or no `values`",
            )
        return self

    def check_fields(self, body: Body, laws: Iterable[Law] = ()) -> None:
        """Checks that the fields exist, and can be evaluated there. Local.

        Args:
            laws: Of the materials, for what they remember.

        Raises:
            InputError: They cannot.
        """
        if self.values:
            check_field_names(self.fields, body, laws)
        else:
            check_readable(self.fields, body, laws)

    @property
    def part(self) -> str | None:
        """Name of the part over which means are taken."""
        return self.on if self.surface is None else self.surface

    def place(self, scale: float) -> list[float]:
        """Coordinates [m] of a probe that is a point.

        Args:
            scale: Metres per unit of the mesh.
        """
        assert self.at is not None
        return [metres(x, scale) for x in self.at]


def _points(probes: Mapping[str, ProbePoint], scale: float) -> dict[str, list[float]]:
    return {name: p.place(scale) for name, p in probes.items() if p.at is not None}


def check_places(probes: Mapping[str, ProbePoint], body: Body, scale: float) -> None:
    """Checks that a body has the points and surfaces of probes. Collective.

    Args:
        scale: Metres per unit of the mesh.

    Raises:
        MeshError: A point lies outside, or has too few coordinates; or there is no such surface.
    """
    locate(body, _points(probes, scale))
    for name, probe in probes.items():
        if probe.surface is not None:
            check_surface(body, probe.surface, f"{name}.surface")
        elif probe.on is not None:
            kind = _kind(body, probe.on, f"{name}.on")
            if kind == "surface":
                check_surface(body, probe.on, f"{name}.on")
            if probe.values and kind not in ("surface", "region"):
                raise MeshError(
                    f"'{probe.on}' is of the kind {kind}",
                    where=f"{name}.values",
                    expected="values are those of a surface or region",
                )


def _kind(body: Body, name: str, where: str = "") -> str:
    """Whether a name is that of a surface, edge, point or region, in this order."""
    if set(body.kinds(name)) == {"region"}:
        return "region"
    try:
        return body.common_kind([name])
    except MeshError as error:
        raise error.at(where) from None


def _samples(body: Body, kind: str, on: str, degree: int) -> FloatArray:
    """Gauss points of all mesh edges of an edge, or all nodes of a point. Collective.

    Args:
        kind: "edge" or "point".
        degree: Of polynomials whose means are exact on straight edges.

    Returns:
        Places [m] and weights with the sum 1, shape (points, dim + 1), in the order of the places
        and the same on every rank.
    """
    own = points_of(body, kind, [on], degree)
    rows = np.column_stack([own.X.reshape(-1, body.dim), own.weights.ravel()])
    every = np.concatenate(body.comm.allgather(rows))
    every = every[np.lexsort(every[:, ::-1].T)]
    every[:, -1] /= every[:, -1].sum()
    return every


def check_readable(names: Iterable[str], body: Body, laws: Iterable[Law] = ()) -> tuple[str, ...]:
    """Checks that a probe in a body can evaluate these fields, and returns their names. Local.

    Args:
        laws: Of the materials, for what they remember.

    Raises:
        InputError: It cannot: the field is of nodes, but for displacement, velocity, acceleration
            and reaction, and is not one of the body.
    """
    readable, table = (*NODAL, REACTION), field_table(body, laws)
    known = [n for n, row in table.items() if n in readable or row.formula or row.of_body]
    for name in (result := tuple(names)):
        whole = table[name].whole if name in table else ""
        if (whole or name) not in known or whole == REACTION:
            raise InputError(f"a probe cannot read '{name}'", expected=table.nearest(name, known))
    return result


class Probe:
    """Evaluates fields of states at points of the undeformed body.  All of it is collective.

    The displacement is evaluated by the shape functions, and so is the stress that is recovered at
    the nodes (`results/recovery`), from which von Mises stress, pressure and safety factor follow.
    Another field of cells is extrapolated linearly from sampling points of the cells to their
    corners, averaged there over the adjacent cells of the same material with their volumes as
    weights, and interpolated to the point.  The sampling point of linear elements is the
    barycentre; those of quadratic elements are the points of the quadrature rule of degree 2, where
    stresses are most accurate (J. Barlow, Int. J. Numer. Meth. Eng. 10 (1976) 243).  On an
    interface it is the field of the material that comes first in the problem.

    Args:
        points: Name to coordinates [m] in the reference configuration.
        fields: Fields at all points, or name of the point to its fields.
        samples: Name to places and weights of which the weighted mean is evaluated, the fields
            being those of its name; shape (points, dim + 1).
        reactions: Name to the part whose nodal reactions are summed up.
        parts: Name to the numbers of a surface or region, and whether they are its means, which
            are called as the field alone.
        others: What gives further columns of the history, name to number.

    Raises:
        InputError: A field cannot be evaluated at a point.
        MeshError: A point lies outside of the body.
    """

    def __init__(
        self,
        problem: Problem,
        points: Mapping[str, Sequence[float]],
        fields: Iterable[str] | Mapping[str, Iterable[str]] = ("displacement",),
        samples: Mapping[str, FloatArray] | None = None,
        reactions: Mapping[str, str] | None = None,
        parts: Mapping[str, tuple[PartNumbers, bool]] | None = None,
        others: Sequence[Callable[[State], Mapping[str, float]]] = (),
    ) -> None:
        self.problem, self.dim = problem, problem.body.dim
        self._table, laws = table_of(problem), laws_of(problem)
        self._samples, self._parts, self._others = samples or {}, parts or {}, others
        of = fields if isinstance(fields, Mapping) else dict.fromkeys(points, tuple(fields))
        named = (*points, *self._samples)
        asked = {name: check_readable(of[name], problem.body, laws) for name in named}
        check_axes((n for row in asked.values() for n in row), problem.axes, self._table)
        held: dict[str, str | Sequence[float]] = dict(reactions or {})
        held |= {name: place for name, place in points.items() if REACTION in asked[name]}
        self._reactions = ReactionSums(problem, held) if held else None
        every, self.fields = dict(points), {name: _interpolated(asked[name]) for name in points}
        for name, rows in self._samples.items():
            every |= {f"{name} {i}": row[:-1].tolist() for i, row in enumerate(rows)}
            self.fields |= {f"{name} {i}": _interpolated(asked[name]) for i in range(len(rows))}
        self.places = locate(problem.body, every, _materials(problem))
        self._at = every
        names = dict.fromkeys(name for row in self.fields.values() for name in row)
        of_cells = tuple(name for name in names if self._of_cells(name))
        self._cells = _CellFields(problem, self.places, of_cells) if of_cells else None
        recovered = {
            name: place for name, place in self.places.items() if is_recovered(self.fields[name])
        }
        self._stress = StressAtPoints(problem, recovered) if recovered else None

    @classmethod
    def of(
        cls,
        probes: Mapping[str, ProbePoint],
        problem: Problem,
        scale: float,
        moments: ReferencePoints | None = None,
        sections: Mapping[str, Section] | None = None,
    ) -> Probe:
        """Makes it from the settings of a case. Collective.

        Args:
            scale: Metres per unit of the mesh.
            moments: Label of a support to the points about which its moment is found.
            sections: Name to a section of which force and moment are found.
        """
        samples: dict[str, FloatArray] = {}
        parts: dict[str, tuple[PartNumbers, bool]] = {}
        named = {name: probe.part for name, probe in probes.items() if probe.part is not None}
        for name, part in named.items():
            probe, kind = probes[name], _kind(problem.body, part)
            fields = _interpolated(probe.fields)
            if kind not in ("surface", "region"):
                samples[name] = _samples(problem.body, kind, part, problem.context.order)
            elif fields:
                numbers = PartNumbers(problem, kind, part, fields, probe.values or ("mean",))
                parts[name] = numbers, not probe.values
        held = {name: part for name, part in named.items() if REACTION in probes[name].fields}
        asked = {name: probe.fields for name, probe in probes.items()}
        others = [SectionForces(problem, sections).numbers] if sections else []
        others += columns_of_moments(moments or {}, problem)
        return cls(problem, _points(probes, scale), asked, samples, held, parts, others)

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Column stem "POINT_FIELD" to the field's components in SI units, the same on every rank.

        Vectors have as many components as the body has dimensions, tensors nine, row by row.
        """
        with stage("output"):
            result = self._at_points(state)
            for name, rows in self._samples.items():
                points = [f"{name} {i}" for i in range(len(rows))]
                for field in self.fields[points[0]]:
                    values = np.array([result.pop(f"{point}_{field}") for point in points])
                    result[f"{name}_{field}"] = rows[:, -1] @ values
            for name, (part, plain) in self._parts.items():
                for number, values in part(state).items():
                    result[f"{name}_{number.removesuffix('_mean') if plain else number}"] = values
        held = self._reactions(state) if self._reactions else {}
        return result | {f"{name}_{REACTION}": force for name, force in held.items()}

    def _at_points(self, state: State) -> dict[str, FloatArray]:
        if not any(self.fields.values()):
            return {}
        cells = self._cells(state) if self._cells else {}
        stress = self._stress(state) if self._stress else {}

        def whole(name: str, field: str) -> FloatArray:
            if field in NODAL:
                return self._nodal(state, field, self.places[name])
            if self._table[field].of_body is not None:
                return self._of_body(self._table[field], self.places[name])
            return stress[name].row(field)

        def value(name: str, field: str) -> FloatArray:
            kind = self._table[field]
            if self._of_cells(field):
                return cells[name][field]
            if kind.component is None:
                return whole(name, field)
            place = np.array([self._at[name]], dtype=np.float64)
            rows = whole(name, kind.component.field)[None]
            return component_rows(self.problem, kind.component, rows, place)[0]

        values = {
            f"{name}_{field}": value(name, field)
            for name, row in self.fields.items()
            for field in row
        }
        sent = np.concatenate(list(values.values()))
        ends = np.cumsum([len(v) for v in values.values()])[:-1]
        rows = np.split(total(self.problem.body.comm, sent), ends)
        return dict(zip(values, rows, strict=True))

    def _nodal(self, state: State, field: str, place: LocatedPoint) -> FloatArray:
        """A vector at a point, on the rank that owns its cell; zeros on the others."""
        function = nodal_function(state, field)
        if place.cell < 0:
            return np.zeros(self.dim)
        element = self.problem.V.element.basix_element
        shape = element.tabulate(0, place.local[None])[0, 0, :, 0]
        nodes = function.function_space.dofmap.list[place.cell]
        return np.asarray(shape @ function.x.array.reshape(-1, self.dim)[nodes])

    def _of_body(self, field: Field, place: LocatedPoint) -> FloatArray:
        """A field of the body at a point, as `_nodal`."""
        given, size = field.of_body, self.dim if field.shape == "vector" else field.columns
        assert given is not None
        result = np.zeros(size)
        if place.cell >= 0:
            cells = np.array([place.cell], dtype=np.int32)
            values = given.at_each(self.problem.body.mesh, cells, place.local[None])[0, :size]
            result[: len(values)] = values
        return result

    def _of_cells(self, name: str) -> bool:
        """Whether a field is fitted inside the cells."""
        row = self._table[name]
        return not row.recovered and (row.whole or name) not in NODAL and row.of_body is None

    def numbers(self, state: State) -> dict[str, float]:
        """Column of the history to value, "POINT_x" ... of the displacement, else "POINT_FIELD".

        Raises:
            InputError: A probe has the name of a column of moments.
        """
        force = {
            column: float(value)
            for name, components in self(state).items()
            for column, value in zip(_columns(name, len(components)), components, strict=True)
        }
        with stage("output"):
            for columns in (other(state) for other in self._others):
                if twice := force.keys() & columns.keys():
                    raise duplicate_column(min(twice))
                force |= columns
        return force

    def add_to(self, state: State) -> State:
        """A copy of the state whose numbers contain those of the probes.

        Raises:
            InputError: A probe's column has the name of another column of the history.
        """
        result = self.numbers(state)
        if twice := result.keys() & row(state).keys():
            raise duplicate_column(min(twice))
        return replace(state, numbers={**state.numbers, **result})


def _interpolated(fields: Sequence[str]) -> tuple[str, ...]:
    """Those of the fields that have a value between nodes, too."""
    return tuple(name for name in fields if name != REACTION)


def duplicate_column(column: str) -> InputError:
    """The error of a probe whose column has the name of another one."""
    return InputError(
        f"there are two results called '{column}'",
        where=_WHERE,
        expected="give the probe another name",
    )


def _materials(problem: Problem) -> IndexArray:
    """Number of each owned cell's material region."""
    result = np.zeros(len(problem.body.owned_cells()), dtype=np.int32)
    for number, part in enumerate(problem.regions):
        result[part.cells] = number
    return result


def _columns(name: str, size: int) -> list[str]:
    return component_names(name.removesuffix("_displacement"), size)


def _linear(local: FloatArray) -> FloatArray:
    """Linear shape functions at a point of the reference cell, shape (dim + 1,)."""
    return np.array([1.0 - local.sum(), *local])


class _CellFields:
    """Fields of cells at points, averaged over adjacent cells; see `Probe`.  Collective.

    Args:
        places: Name of the point to its cell and local coordinates.
    """

    def __init__(
        self, problem: Problem, places: Mapping[str, LocatedPoint], names: Sequence[str]
    ) -> None:
        mesh, self.places, self.names = problem.body.mesh, places, names
        self.w = unknowns_of_outputs(problem)
        self._fields = {name: table_of(problem)[name] for name in names}
        self.widths = [self._fields[name].evaluated for name in names]
        self.corners = fem.functionspace(mesh, ("Lagrange", 1)).dofmap
        self.volumes = cell_volumes(mesh)
        samples = sampling_points(problem.body.dim, problem.degree)
        # Least squares: values at the sampling points to a linear function's values at corners.
        self.fit = np.linalg.pinv(np.array([_linear(sample) for sample in samples]))
        # Points of this rank in a region, the cells that share a corner with theirs, and the fields
        # at the sampling points; None: the material has none of them.
        self._parts: list[tuple[list[str], IndexArray, CellKernel | None]] = []
        for region in problem.regions:
            local = [n for n, p in places.items() if p.cell >= 0 and p.cell in region.cells]
            if total(problem.body.comm, len(local)):
                cells = cells_around(problem, region, [places[n].cell for n in local], rings=1)
                kernel = cell_kernel(problem, region, self.w, names, samples, _WHERE)
                self._parts.append((local, cells, kernel))

    def __call__(self, state: State) -> dict[str, dict[str, FloatArray]]:
        """Point and field to components, on the rank that owns the cell; zeros on the others."""
        self.w.x.array[:] = (state.w or state.u).x.array
        rows = {name: np.full((1, sum(self.widths)), np.nan) for name in self.places}
        for local, cells, kernel in self._parts:
            if kernel is not None:
                corners = self._at_corners(kernel, cells)
                for name in local:
                    place = self.places[name]
                    around = corners[self.corners.list[place.cell]]
                    rows[name][0, kernel.columns] = _linear(place.local) @ around
        ends = np.cumsum(self.widths)[:-1]
        return {
            point: {
                name: np.asarray(self._fields[name].finished(part)[0])
                if self.places[point].cell >= 0
                else np.zeros(self._fields[name].columns)
                for name, part in zip(self.names, np.split(row, ends, axis=1), strict=True)
            }
            for point, row in rows.items()
        }

    def _at_corners(self, kernel: CellKernel, cells: IndexArray) -> FloatArray:
        """Means at the local corners, shape (corners, columns); 0 away from these cells."""
        width = len(kernel.columns)
        weighted = np.empty((0, self.fit.shape[0], width + 1))
        if len(cells):
            fitted = np.einsum("cs,nsw->ncw", self.fit, kernel(cells))
            ones = np.ones((*fitted.shape[:2], 1))
            weighted = np.concatenate([fitted, ones], axis=2) * self.volumes[cells, None, None]
        table = summed(self.corners.index_map, self.corners.list[cells], weighted)
        weights = table[:, -1:]
        return np.asarray(table[:, :-1] / np.where(weights > 0, weights, 1.0))
