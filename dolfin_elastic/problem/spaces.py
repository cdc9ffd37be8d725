"""Unknowns: the displacement, and auxiliary scalar fields where a problem needs them.

All unknowns are lengths and all their equations forces: a scalar field is its unknown times a
scale, so that one norm measures the whole residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import Constant
from dolfinx.mesh import Mesh
from ufl.core.expr import Expr
from ufl.finiteelement import AbstractFiniteElement

from dolfin_elastic.core.compat import collapsed
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.problem.pressure.doubled import DoubledSpace, doubled


@dataclass(frozen=True)
class AuxiliaryField:
    """A scalar field beside the displacement.

    Attributes:
        name: "pressure" or "stretch" (out of the plane).
        degree: Degree of its polynomials.
        continuous: Whether it is continuous between cells.
    """

    name: str
    degree: int
    continuous: bool


class Unknowns:
    """Function spaces and functions of all unknowns. Collective to make.

    Args:
        groups: Group of each local cell, ghosts too: each has a continuous pressure of its own;
            None: all have one.

    Attributes:
        V: Space of the displacement.
        U: Space of what is unknown of it; V, but that nodes on periodic faces are merged.
        u: The displacement [m], on V.
        W: Space of all unknowns; V itself when there are no others.
        w: All unknowns; `u` itself when there are no others.
        v: Test function of the displacement.
        degree: Degree of the displacement.
        groups: See the arguments; None, too, where no pressure is continuous in the cells' groups.
        scale: Name of an auxiliary field to the factor of its unknown (UFL constant, 1 at first).
    """

    def __init__(
        self,
        mesh: Mesh,
        degree: int,
        auxiliary_fields: Sequence[AuxiliaryField] = (),
        groups: IntArray | None = None,
    ) -> None:
        self.auxiliary_fields, self.degree = tuple(auxiliary_fields), degree
        jumps = any(e.name == "pressure" and e.continuous for e in self.auxiliary_fields)
        self.groups = groups if jumps else None
        cell = mesh.basix_cell()
        elements = [basix.ufl.element("Lagrange", cell, degree, shape=(mesh.geometry.dim,))]
        elements += [
            basix.ufl.element("Lagrange" if e.continuous else "DG", cell, e.degree)
            for e in self.auxiliary_fields
        ]
        self.V, self.U, self.W, self._dofs = self._spaces(mesh, elements)
        if self.W is self.V:
            self.w = self.u = fem.Function(self.V, name="displacement")
        else:
            self.w = fem.Function(self.W, name="unknowns")
            self.u = fem.Function(self.V, name="displacement")
        self.tests = self._split(ufl.TestFunction(self.W))
        self.v = self.tests[0]
        self.scale = {e.name: Constant(mesh, 1.0) for e in self.auxiliary_fields}

    def _spaces(
        self, mesh: Mesh, elements: Sequence[AbstractFiniteElement]
    ) -> tuple[fem.FunctionSpace, fem.FunctionSpace, fem.FunctionSpace, IndexArray | None]:
        """V, U, W, and the entry of W of each entry of V where these differ."""
        if not self.auxiliary_fields:
            V = fem.functionspace(mesh, elements[0])
            return V, V, V, None
        plain = fem.functionspace(mesh, basix.ufl.mixed_element(elements))
        V, dofs = collapsed(plain.sub(0))
        split = self._split_pressure(plain)
        return (V, V, plain, dofs) if split is None else (V, V, split.space, split.new[dofs])

    def _split_pressure(self, plain: fem.FunctionSpace) -> DoubledSpace | None:
        """Space of all unknowns with a pressure of each group; None: one will do. Collective."""
        if self.groups is None:
            return None
        return doubled(plain, 1 + self._index("pressure"), self.groups)

    @cached_property
    def places(self) -> FloatArray:
        """Places [m] of the nodes of V in the reference configuration, ghosts too, shape (n, 3)."""
        coordinates: FloatArray = self.V.tabulate_dof_coordinates()
        coordinates.flags.writeable = False
        return coordinates

    @property
    def unknown_places(self) -> FloatArray:
        """As `places`, of the nodes of U."""
        return self.places

    def _split(self, w: Expr) -> tuple[Expr, ...]:
        return tuple(ufl.split(w)) if self.auxiliary_fields else (w,)

    def displacement(self, w: Expr) -> Expr:
        """The displacement in a function, test or trial function of W."""
        return self._split(w)[0]

    def total_displacement(self, w: Expr) -> Expr:
        """The whole displacement of the body [m], of a function of W."""
        return self.displacement(w)

    def auxiliary(self, name: str, w: Expr) -> Expr:
        """A scalar field in physical units, in a function, test or trial function of W.

        Args:
            w: Function, test or trial function of W.
        """
        return self.scale[name] * self._split(w)[1 + self._index(name)]

    def _index(self, name: str) -> int:
        return [e.name for e in self.auxiliary_fields].index(name)

    def count(self, name: str) -> int:
        """How many unknowns a scalar field has on all ranks."""
        if not self.has(name):
            return 0
        dofmap = self.W.sub(1 + self._index(name)).collapse()[0].dofmap
        return int(dofmap.index_map.size_global)

    @property
    def stabilised(self) -> bool:
        """The pressure has the degree of the displacement: it is stable only with stabilisation."""
        return any(
            e.name == "pressure" and e.continuous and e.degree == self.degree
            for e in self.auxiliary_fields
        )

    def has(self, name: str) -> bool:
        """Whether there is such a scalar field."""
        return name in self.scale

    def mixed_dofs(self, dofs: IndexArray) -> IndexArray:
        """Entries of the displacement's local array as entries of all unknowns' local array."""
        return dofs if self._dofs is None else self._dofs[dofs]

    @property
    def single_valued(self) -> FloatArray | None:
        """Displacement at the nodes of U, where they have one place only."""
        return self.u.x.array if self.U is self.V else None

    def merged_dofs(self, dofs: IndexArray) -> IndexArray:
        """Entries of the displacement's local array as entries of U."""
        return dofs

    @property
    def displacement_dofs(self) -> IndexArray:
        """Owned entries of all unknowns that belong to the displacement, in the order of U."""
        size = self.U.dofmap.index_map.size_local * self.U.dofmap.index_map_bs
        return self.mixed_dofs(np.arange(size, dtype=np.int32))

    def linear_space(self) -> fem.FunctionSpace:
        """U with linear elements. Collective."""
        mesh = self.V.mesh
        return fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))

    def w_to_u(self) -> None:
        """Copies the displacement out of all unknowns, after they were changed."""
        if self._dofs is not None:
            self.u.x.array[:] = self.w.x.array[self._dofs]

    def u_to_w(self) -> None:
        """Copies the displacement into all unknowns, after it was changed."""
        if self._dofs is not None:
            self.w.x.array[self._dofs] = self.u.x.array


def part_nodes(body: Body, V: fem.FunctionSpace, name: str) -> IndexArray:
    """Nodes, owned and ghost, sorted, of all parts of a name that are no regions. Collective.

    Of quadratic elements the midside nodes of facets and edges are among them, but of a set of
    nodes only those that are nodes of the mesh, too.

    Args:
        name: Of surface, edge, point, or several of them.

    Raises:
        MeshError: There is no such part, or it has no node in the space.
    """
    result: list[IndexArray] = [np.empty(0, dtype=np.int32)]
    kinds = [kind for kind in body.kinds(name) if kind != "region"]
    if not kinds:
        body.surface(name)  # raises
    if "surface" in kinds:
        facets = body.surfaces[name]
        result.append(fem.locate_dofs_topological(V, body.mesh.topology.dim - 1, facets))
    if "edge" in kinds:
        result.append(fem.locate_dofs_topological(V, 1, body.edges[name]))
    if "point" in kinds:
        nodes = _of_geometry(body, V)[body.points[name]]
        result.append(nodes[nodes >= 0])
    nodes = np.unique(np.concatenate(result)).astype(np.int32)
    if kinds == ["point"] and not total(body.comm, len(nodes)):
        raise MeshError(
            f"'{name}' holds midside nodes only, which linear elements do not have",
            expected="mesh.degree = 2",
        )
    return nodes


def _of_geometry(body: Body, V: fem.FunctionSpace) -> IndexArray:
    """Node of a space at each local node of the mesh's geometry; -1: none.

    Both number the nodes of a cell in the order vertices, edges.
    """
    rows, nodes = np.asarray(body.mesh.geometry.dofmap), np.asarray(V.dofmap.list)
    width = min(rows.shape[1], nodes.shape[1])
    result = np.full(len(body.mesh.geometry.x), -1, dtype=np.int32)
    result[rows[:, :width]] = nodes[:, :width]
    return result
