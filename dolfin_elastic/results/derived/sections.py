"""Forces and moments that cross sections of the body: `[output] sections`.

A section parts cells into a positive and a negative side; those that do not touch an inner surface
are on neither.  With r the nodal forces of the cells of the positive side alone, internal ones less
loads and in motion plus inertia, these cells exert -r on the nodes that both sides share, and the
sum is the resultant across the section.  Nodal forces are virtual work, and a translation, and
where the stress is in balance a rotation, is one of the displacements of the elements.  So the
resultant is that of the loads, reactions and inertia of the side, to the tolerance of the solver,
on every mesh.  The integral of the stress is not, for the stress of elements jumps between them.

Source: T. Belytschko, W. K. Liu, B. Moran, Nonlinear Finite Elements for Continua and Structures
(2000), section 4.4 (nodal forces from virtual work).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
import ufl
from dolfinx import fem, la
from pydantic import field_validator, model_validator

from dolfin_elastic.core.errors import InputError, MeshError, keyed
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.schema import Record
from dolfin_elastic.core.shapes.directions import Axis
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray
from dolfin_elastic.core.units import MeshLength, metres
from dolfin_elastic.mesh.body import centre_of
from dolfin_elastic.mesh.criteria import BoundingBox
from dolfin_elastic.mesh.inner_surfaces import (
    CellFacets,
    facets_between,
    on_both,
    outward_areas,
    sides_of_plane,
    sides_of_surface,
)
from dolfin_elastic.model.kinematics import moment_of
from dolfin_elastic.problem.problem import configuration_of_moments
from dolfin_elastic.problem.state import Moment, State
from dolfin_elastic.results.cell_fields import unknowns_of_outputs
from dolfin_elastic.results.derived.part_numbers import check_surface
from dolfin_elastic.results.moments import MIDDLE, check_reference, place_of

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.problem.problem import Problem


class Section(Record):
    """A section of the undeformed body: an inner surface, or a plane.

    Attributes:
        on: Name of an inner surface.
        side: Name of the region whose force on the rest is found; by default, and of a plane, it is
            the side of the larger coordinate along the axis that is most normal to the section.
        plane: The axis across a plane, in place of `on`.
        at: The plane's coordinate, a bare number in the mesh's unit.
        about: Point of reference of the moment: "middle" of the section, coordinates, or the name
            of a surface, edge or point.
    """

    on: str | None = None
    side: str | None = None
    plane: Axis | None = None
    at: MeshLength | None = None
    about: str | Point = MIDDLE

    @field_validator("about", mode="before")
    @classmethod
    def _a_point(cls, value: object) -> object:
        if isinstance(value, Mapping):
            raise InputError("a section has one point of reference", expected="a single point")
        check_reference(value)
        return value

    @model_validator(mode="after")
    def _one(self) -> Self:
        planar = self.plane is not None and self.at is not None
        if (self.on is None) != planar or (self.plane is None) != (self.at is None):
            raise InputError(
                "it is not clear where the section is",
                expected='on = the name of an inner surface, or plane = "x" and at = 100',
            )
        if planar and self.side is not None:
            raise InputError(
                "the sides of a plane are those of its axis", where="side", expected="no side"
            )
        return self


@dataclass(frozen=True)
class SectionForce:
    """What the positive side of a section exerts on the other.

    Attributes:
        force: Resultant [N], shape (dim,); of a body of revolution along its axis, shape (1,).
        moment: Its moment; None of a body of revolution.
    """

    force: FloatArray
    moment: Moment | None


class SectionForces:
    """Forces and moments across sections.  All of it is collective.

    Args:
        problem: The problem that is solved, of whose present state the loads are.

    Raises:
        InputError: A section misses the body, or does not part it.
    """

    def __init__(self, problem: Problem, sections: Mapping[str, Section]) -> None:
        self.problem = problem
        self._axial = problem.geometry == "axisymmetric"
        self._moves = configuration_of_moments(problem) != "reference"
        self._own = problem.V.dofmap.index_map.size_local
        self._w = unknowns_of_outputs(problem)
        self._inside = fem.Function(fem.functionspace(problem.body.mesh, ("DG", 0)))
        self._a = fem.Function(problem.V)
        self._forms: dict[bool, fem.Form] = {}
        self._cuts = {name: self._cut(name, section) for name, section in sections.items()}

    def _cut(self, name: str, section: Section) -> tuple[AnyArray, IndexArray, FloatArray]:
        """Side of each owned cell, owned nodes that both share, and the point of reference."""
        body, where = self.problem.body, f"output.sections.{name}"
        if self.problem.cell is not None:
            raise InputError(
                "sections of a periodic cell are crossed by what its neighbours exert, too",
                where=where,
                expected="no output.sections; the mean stress P11 ... is in history.csv",
            )
        try:
            if section.on is None:
                sides = _sides_of_plane(body, section)
                middle = _centre(body, section, sides)
            else:
                check_surface(body, section.on, "on")
                if section.side is not None:
                    with keyed("side"):
                        body.region(section.side)
                sides = sides_of_surface(body, section.on, section.side)
                _refuse_loaded(self.problem, section.on)
                middle = centre_of(body, [section.on])
        except (InputError, MeshError) as error:
            raise error.at(where) from None
        place = section.about
        if not isinstance(place, str):
            place = tuple(metres(x, body.unit.metres) for x in place)
        about = place_of(place, f"{where}.about", self.problem)
        return sides, self._shared(sides), middle if about is None else about

    def _shared(self, sides: AnyArray) -> IndexArray:
        dofmap = self.problem.V.dofmap
        rows = summed(dofmap.index_map, dofmap.list[: len(sides)], on_both(sides)[:, None])
        return np.flatnonzero((rows[: self._own] > 0).all(axis=1)).astype(np.int32)

    def _form(self, moving: bool) -> fem.Form:
        """Virtual work of the cells of the positive side, compiled."""
        if moving not in self._forms:
            weak, unknowns = self.problem.weak_form, self.problem.unknowns
            work = ufl.replace(weak.residual, {self.problem.w: self._w})
            if moving:
                work += weak.inertia(self._a, unknowns.v)
            own = ufl.Form(
                [i.reconstruct(integrand=self._inside * i.integrand()) for i in work.integrals()]
            )
            self._forms[moving] = compile_forms(self.problem.body.comm, [own], self.problem.jit)[0]
        return self._forms[moving]

    def __call__(self, state: State) -> dict[str, SectionForce]:
        """Name to what crosses the section, the same on every rank."""
        self._w.x.array[:] = (state.w or state.u).x.array
        if state.a is not None:
            self._a.x.array[:] = state.a.x.array
        form = self._form(state.a is not None)
        dim, size = self.problem.body.dim, self._own * self.problem.body.dim
        x = self.problem.places[: self._own, :dim]
        if self._moves:
            x = x + state.u.x.array[:size].reshape(-1, dim)
        dofs = self.problem.unknowns.mixed_dofs(np.arange(size, dtype=np.int32))
        result = {}
        if self.problem.history is not None:
            self.problem.history.follow()
        for name, (sides, nodes, about) in self._cuts.items():
            self._inside.x.array[: len(sides)] = sides == 1
            vector = fem.assemble_vector(form)
            vector.scatter_reverse(la.InsertMode.add)
            force = -vector.array[dofs].reshape(-1, dim)[nodes]
            moment = moment_of(x[nodes] - about, force)
            sums = total(self.problem.body.comm, np.hstack([force, moment]).sum(axis=0))
            result[name] = (
                SectionForce(sums[1:2], None)
                if self._axial
                else SectionForce(sums[:dim], Moment(sums[dim:], about))
            )
        return result

    def numbers(self, state: State) -> dict[str, float]:
        """Column of the history to value, "section_force_NAME_x" [N], "section_moment_NAME_x"."""
        columns: dict[str, float] = {}
        for name, force in self(state).items():
            axes = "y" if force.moment is None else "xyz"
            columns |= {
                f"section_force_{name}_{axis}": float(value)
                for axis, value in zip(axes, force.force, strict=False)
            }
            if force.moment is not None:
                values = force.moment.value
                columns |= {
                    f"section_moment_{name}_{axis}": float(value)
                    for axis, value in zip("xyz"[-len(values) :], values, strict=True)
                }
        return columns


def distance_from_plane(body: Body, section: Section) -> float:
    """Largest distance of the facets that stand for a plane from it [m]. Collective.

    Raises:
        InputError: The plane misses the body.
    """
    assert section.plane is not None
    assert section.at is not None
    axis, at = BoundingBox.of(body, body.unit.metres).plane(section.plane, section.at)
    cells, local = _beside(body, _sides_of_plane(body, section))
    geometry, dim = body.mesh.geometry, body.dim
    layout = geometry.cmap.create_dof_layout()  # with the nodes amid edges of curved cells
    nodes = np.array([layout.entity_closure_dofs(dim - 1, i) for i in range(dim + 1)])[local]
    x = geometry.x[np.take_along_axis(geometry.dofmap[cells], nodes, axis=1)][..., axis]
    return largest(body.comm, float(np.abs(x - at).max(initial=0.0)))


def _sides_of_plane(body: Body, section: Section) -> AnyArray:
    """See `sides_of_plane`."""
    assert section.plane is not None
    assert section.at is not None
    return sides_of_plane(body, BoundingBox.of(body, body.unit.metres), section.plane, section.at)


def _beside(body: Body, sides: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Owned cells of the positive side at facets between the sides, and the numbers of these."""
    facets = CellFacets(body)
    between = np.isin(facets.of_cells, facets_between(facets, sides))
    cells, local = np.nonzero(between & (sides == 1)[:, None])
    return cells, local


def _centre(body: Body, section: Section, sides: AnyArray) -> FloatArray:
    """Centroid of the facets between the sides, as they are seen along the plane's normal [m]."""
    assert section.plane is not None
    assert section.at is not None
    axis = "xyz".index(section.plane)
    cells, local = _beside(body, sides)
    N, middle = outward_areas(body, cells, local)
    area = -N[:, axis]
    sums = total(body.comm, np.array([*(area @ middle), area.sum(), len(area)]))
    if not sums[-1]:
        raise InputError(
            "no element is joined to another one across the plane",
            where="at",
            expected="a plane through a part; ties and contacts have reactions of their own",
        )
    about = np.asarray(sums[:-2] / sums[-2])
    about[axis] = metres(section.at, body.unit.metres)
    return about


def _refuse_loaded(problem: Problem, surface: str) -> None:
    """Refuses integrals of loads and springs over an inner surface: they are of neither side."""
    body, on = problem.body, problem.body.surface(surface)
    acting = {one for load in problem.loads if not load.is_eigenstrain for one in load.parts}
    acting |= {part for spring in (*problem.springs, *problem.dashpots) for part in spring.surfaces}
    for part in sorted(acting & body.surfaces.keys()):
        if total(body.comm, int(np.isin(body.owned_facets(part), on).sum())):
            raise InputError(
                f"the load or spring on '{part}' acts on the section itself, on neither side of it",
                where="on",
                expected="a plane or surface beside it",
            )
