"""Means of fields over surfaces of the undeformed body, and sums of nodal reactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.schema import within
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.kinematics import weight
from dolfin_elastic.problem.spaces import part_nodes
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.cell_fields import cell_components, unknowns_of_outputs
from dolfin_elastic.results.evaluate import Evaluator
from dolfin_elastic.results.fields import FIELDS

if TYPE_CHECKING:
    from dolfin_elastic.mesh.body import Body
    from dolfin_elastic.problem.material_regions import MaterialRegion
    from dolfin_elastic.problem.problem import Problem

NODAL = {"displacement": "u", "velocity": "v", "acceleration": "a"}
"""Fields that are functions of the state: name to attribute of `State`."""


def check_surface(body: Body, name: str, where: str = "") -> None:
    """Checks that a mean over a surface is defined. Collective.

    Args:
        where: Key of the case file, for the message.

    Raises:
        MeshError: The body has no such surface, or it has no facets.
    """
    try:
        body.surface(name)
    except MeshError as error:
        raise within(where, error) from None
    if not total(body.comm, len(body.owned_facets(name))):
        raise MeshError(
            f"the surface '{name}' has no facets", where=where, expected="a surface with facets"
        )


class SurfaceMean:
    """Means over the undeformed area of one surface.  All of it is collective.

    Fields are integrated by quadrature of the finite element functions, fields of cells with the
    displacement gradient of the adjacent cell; in an axisymmetric body over the surface of
    revolution.

    The stress is that of the cells: its integrals are closer to equilibrium than those of the
    recovered stress, which is fitted to it point by point.

    Args:
        fields: Names from `FIELDS` that `check_readable` accepts.

    Raises:
        InputError: A field that a material of the surface does not have.
    """

    def __init__(self, problem: Problem, surface: str, fields: Sequence[str]) -> None:
        check_surface(problem.body, surface)
        if derived := [name for name in fields if name in FIELDS and FIELDS[name].of_tensor]:
            raise InputError(
                f"'{derived[0]}' has no form to integrate",
                where="output.probes",
                expected="PartNumbers, which evaluates it at quadrature points",
            )
        self.problem, self.fields = problem, tuple(fields)
        mesh = problem.body.mesh
        self._w = unknowns_of_outputs(problem)
        self._nodal = {n: fem.Function(problem.V) for n in self.fields if n in NODAL}
        self._widths = [
            problem.body.dim if name in NODAL else FIELDS[name].columns for name in self.fields
        ]
        size = 1 + sum(self._widths)
        space = fem.functionspace(mesh, ("DG", 0, (size,)))
        test, form = ufl.TestFunction(space), 0
        ds = self._measure(surface)
        for k, part in enumerate(problem.regions):
            components = [problem.constant(1.0), *self._components(part)]
            rho = weight(problem.geometry, problem.X, None)
            integrand = ufl.inner(ufl.as_vector(components), test)
            form += (integrand if rho is None else integrand * rho) * ds(1 + k)
        self._form = compile_forms(mesh.comm, [form], problem.jit)[0]
        self._sums = fem.Function(space).x.array.reshape(-1, size)

    def _measure(self, surface: str) -> ufl.Measure:
        """Integration over the surface; facets of region k of the problem have the number 1 + k."""
        body = self.problem.body
        mesh, tdim = body.mesh, body.mesh.topology.dim
        mesh.topology.create_connectivity(tdim, tdim - 1)
        mesh.topology.create_connectivity(tdim - 1, tdim)
        sides = integration_entities(mesh, np.asarray(body.owned_facets(surface))).reshape(-1, 2)
        data = [
            (1 + k, sides[np.isin(sides[:, 0], part.cells)].reshape(-1))
            for k, part in enumerate(self.problem.regions)
        ]
        degree = {"quadrature_degree": 2 * self.problem.context.order}
        return ufl.Measure("ds", domain=mesh, subdomain_data=data, metadata=degree)

    def _components(self, region: MaterialRegion) -> list[Expr]:
        """Components of all fields beside a region; nan for quantities that its law lacks."""
        names = [name for name in self.fields if name not in NODAL]
        components = cell_components(self.problem, region, self._w, names, "output.probes")
        of_cells = dict(zip(names, components, strict=True))
        found: list[Expr] = []
        for name in self.fields:
            if name in NODAL:
                found += [*self._nodal[name]]
            else:
                lacking = [self.problem.constant(float("nan"))] * FIELDS[name].columns
                found += of_cells[name] or lacking
        return found

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Field to the means of its components in SI units, the same on every rank."""
        self._w.x.array[:] = (state.w or state.u).x.array
        for name, function in self._nodal.items():
            values = getattr(state, NODAL[name])
            if values is None:
                raise InputError(
                    f"there is no '{name}' in statics",
                    where="output.probes",
                    expected="leave it out, or use [dynamics]",
                )
            function.x.array[:] = values.x.array
        self._sums[:] = 0.0
        fem.assemble_vector(self._sums.reshape(-1), self._form)
        sums = np.asarray(total(self.problem.body.comm, self._sums.sum(axis=0)))
        parts = np.split(sums[1:] / sums[0], np.cumsum(self._widths)[:-1])
        return dict(zip(self.fields, parts, strict=True))


REACTION = "reaction"
"""The field that is a force at nodes: it is summed up, not averaged."""

_AT_NODE = 1e-6
"""Distance of a point from the node that is meant, over the body's size."""


class ReactionSums:
    """Sums of the supports' nodal forces over parts, or at one node.  All of it is collective.

    Args:
        parts: Name to the name of a surface, edge or point, or to the place of a node [m].

    Raises:
        InputError: There is no node at a place.
    """

    def __init__(self, problem: Problem, parts: Mapping[str, str | Sequence[float]]) -> None:
        self._comm, self._dim = problem.body.comm, problem.body.dim
        self._evaluator = Evaluator(problem, [REACTION])
        self._nodes = {
            name: _owned_nodes(problem, part)
            if isinstance(part, str)
            else node_at(problem, part, f"output.probes.{name}")
            for name, part in parts.items()
        }

    def __call__(self, state: State) -> dict[str, FloatArray]:
        """Name to the force of the supports on the body there [N], the same on every rank.

        Raises:
            InputError: The state is one of a motion.
        """
        forces = self._evaluator(state)[REACTION][:, : self._dim]
        sums = np.array([forces[nodes].sum(axis=0) for nodes in self._nodes.values()])
        return dict(zip(self._nodes, total(self._comm, sums), strict=True))


def _owned_nodes(problem: Problem, part: str) -> IndexArray:
    nodes = np.unique(part_nodes(problem.body, problem.V, part))
    return np.asarray(nodes[nodes < problem.V.dofmap.index_map.size_local])


def node_at(problem: Problem, place: Sequence[float], where: str) -> IndexArray:
    """The node at a place, on the rank that owns it; the others have none. Collective.

    Args:
        place: In the reference configuration, shape (gdim,) [m].
        where: Key of the case file, for the message.

    Raises:
        InputError: There is none.
    """
    own, dim = problem.V.dofmap.index_map.size_local, problem.body.dim
    x = problem.places[:own, :dim]
    distance = np.linalg.norm(x - np.array(place[:dim]), axis=1)
    first = int(np.argmin(distance)) if own else -1
    mine = (float(distance[first]), problem.body.comm.rank, tuple(x[first])) if own else None
    nearest = min(one for one in problem.body.comm.allgather(mine) if one is not None)
    if nearest[0] > _AT_NODE * span(problem.body):
        raise InputError(
            f"there is no node at {_in_words(place[:dim])} m, and a reaction is a force at nodes",
            where=where,
            expected=f"the nearest is at {_in_words(nearest[2])} m; or on = the name of a part",
        )
    return np.array([first] if nearest[1] == problem.body.comm.rank else [], dtype=np.int64)


def _in_words(place: Sequence[float]) -> str:
    return "(" + ", ".join(f"{round(x, 12) + 0.0:.6g}" for x in place) + ")"
