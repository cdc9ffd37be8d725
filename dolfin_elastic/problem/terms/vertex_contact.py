"""`VertexContact`: contact of quadratic faces, its pressures at their vertices.

A uniform pressure on a quadratic triangle has no nodal forces at the vertices, and the midside
nodes of straight faces lie off a round surface: neither gaps at all nodes nor gaps at quadrature
points give pressures that are right.  The pressure is a sum of functions psi_I of the vertices that
are linear on a face and biorthogonal to the vertices' hat functions l_J,

    integral of psi_I l_J = delta_IJ integral of l_I,

so that the sum of the psi_I is 1, and what is compared is the mean gap g_I at a vertex:

    A_I = integral of l_I,    g_I = (integral of psi_I g)/A_I,    p_I = max(0, lam_I - eps g_I).

With the potential sum of A_I (p_I^2 - lam_I^2)/(2 eps) the virtual work is the sum of p_I times the
integral of psi_I n . v: uniform pressures pass the patch test.  Integrals are over the reference
surface.

A straight face of a body that is round lacks what lies between it and the body's true surface,
which may be more than the gap.  So on straight faces the gap is that of the vertices, linear on a
face, and what the midside displacements add to it: with the place x of a point and that of the same
point on the face through the moved vertices, x',

    g = sum of l_J g(x_J) + g(x) - g(x').

Source: B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989 (dual functions); A. Popp, B. Wohlmuth,
M. W. Gee & W. A. Wall, SIAM J. Sci. Comput. 34 (2012) B421 (quadratic faces); M. A. Puso & T. A.
Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601 (weighted gaps); P. Wriggers, Computational
Contact Mechanics, 2nd ed., Springer 2006, section 6.3.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from dolfinx import fem, la

from dolfin_elastic.core.ghosts import summed, with_ghosts
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.shapes.shapes import Plane
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.geometry.curved import facet_quadrature, facet_shape_functions
from dolfin_elastic.mesh.geometry.simplices import cells_beside_facets
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.constraints.ties.exchange import Owners
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.problem.terms.contact import ContactPair, nodal
from dolfin_elastic.problem.terms.nodal_contact import NodalContact


class VertexContact(ContactPair):
    """One contact of quadratic faces.  Its forces are in no form. Collective to make.

    Args:
        index: From 0, in the case.
        thickness: Of a plane body [m].
    """

    nodal = True

    def __init__(
        self, contact: Contact, context: FormContext, index: int, thickness: float
    ) -> None:
        super().__init__(contact, context, index)
        mesh, d, order = context.body.mesh, self._dim, context.order
        own = self.facets[self.facets < mesh.topology.index_map(d - 1).size_local]
        # The degree of a pressure, a displacement and, on curved faces, the area element.
        rule = facet_quadrature(mesh, own, 1 + order + 2 * (order - 1), raised=False)
        weights = thickness * rule.weights
        if self._axisymmetric:
            weights *= 2 * np.pi * rule.X[:, :, 0]
        hats = facet_shape_functions(d, 1, rule.local)
        means = np.einsum("fq,qi->fi", weights, hats)
        masses = np.einsum("fq,qi,qj->fij", weights, hats, hats)
        dual = means[:, :, None] * np.linalg.inv(masses)
        self._psi = np.einsum("fq,fij,qj->fqi", weights, dual, hats)
        self._shapes = facet_shape_functions(d, context.unknowns.degree, rule.local)
        self._X = rule.X
        if mesh.geometry.cmap.degree == 1:
            self._measure_from_vertices(hats, means, mesh.geometry.x[rule.nodes][:, :, :d])
        S, V = self.lam.function_space, context.unknowns.V
        beside = cells_beside_facets(mesh, own)
        self._vertices, self._nodes = (_on_facets(space, *beside) for space in (S, V))
        self._area_of = self._summed(means)
        index_map = S.dofmap.index_map
        self._owners = Owners(self.comm, index_map.local_range[0], index_map.size_local)
        self._near = np.zeros(index_map.size_local, dtype=bool)

    def _measure_from_vertices(
        self, hats: FloatArray, means: FloatArray, corners: FloatArray
    ) -> None:
        """Adds the points of straight faces, see the module: x' and the vertices.

        Args:
            hats: At the points of the quadrature, shape (points, d).
            means: Integrals of the hats, shape (facets, d).
            corners: Of the faces, shape (facets, d, d) [m].
        """
        d = self._dim
        none = np.zeros((len(hats) + d, self._shapes.shape[1] - d))
        flat = np.vstack([hats, np.eye(d)])
        self._shapes = np.vstack([self._shapes, np.hstack([flat, none])])
        self._psi = np.concatenate([self._psi, -self._psi, means[:, :, None] * np.eye(d)], axis=1)
        self._X = np.concatenate([self._X, self._X, corners], axis=1)

    def _summed(self, rows: FloatArray) -> FloatArray:
        """Sums at the owned nodes of what facets have at their vertices. Collective."""
        index_map = self.lam.function_space.dofmap.index_map
        return summed(index_map, self._vertices, rows[..., None])[self.nodes, 0]

    def _at_vertices(self, values: FloatArray) -> FloatArray:
        """Values of the owned nodes at the vertices of facets, shape (facets, d). Collective."""
        index_map = self.lam.function_space.dofmap.index_map
        every = np.zeros((index_map.size_local, 1))
        every[self.nodes, 0] = values
        return with_ghosts(index_map, every)[self._vertices, 0]

    # --- gaps and pressures ---

    def _places(self) -> FloatArray:
        """Where the gap is measured, as the obstacle sees it, shape (facets, points, dim) [m]."""
        u = self._context.unknowns.u.x.array.reshape(-1, self._dim)
        moved = np.einsum("qk,fkd->fqd", self._shapes, u[self._nodes])
        return np.asarray(self._X + moved - self.shift.value)

    def _point_gaps(self) -> tuple[FloatArray, FloatArray]:
        """Gaps and normals there, shapes (facets, points) and (facets, points, dim)."""
        x = self._places()
        distance, normal = self.contact.obstacle.gap(list(np.moveaxis(x, -1, 0)), float, np.sqrt)
        gaps = np.asarray(distance, dtype=np.float64)
        return gaps, np.stack([np.broadcast_to(n, gaps.shape) for n in normal], axis=-1)

    def pressing_gaps(self) -> FloatArray:
        """See `ContactPair`: mean gaps."""
        gaps, _ = self._point_gaps()
        weighted = np.einsum("fqi,fq->fi", self._psi, gaps)
        return self._summed(weighted) / self._area_of

    def _trial(self) -> tuple[FloatArray, BoolArray]:
        """Pressures where the surface is in contact, else 0, and whether it is. Collective."""
        trial = self.lam.x.array[self.nodes] - self._eps * self.pressing_gaps()
        active = trial >= -self._eps * self.reach
        return np.where(active, trial, 0.0), active

    def nodal_pressures(self) -> tuple[IndexArray, FloatArray]:
        """See `ContactPair`: linear between the vertices."""
        linear, (field, nodes, at) = fem.Function(self.lam.function_space), self._of_nodes
        linear.x.array[self.nodes] = self.pressures()
        linear.x.scatter_forward()
        field.interpolate(linear)
        return at, field.x.array[nodes].copy()

    @cached_property
    def _of_nodes(self) -> tuple[fem.Function, IndexArray, IndexArray]:
        return nodal(self._context, self.facets, self._context.unknowns.degree)

    def area(self) -> float:
        """See `ContactPair`."""
        return total(self.comm, float(np.sum(self._area_of[self.pressures() > 0])))

    # --- forces ---

    def _spread(self, values: FloatArray, directions: FloatArray) -> FloatArray:
        """Integrals of psi_I N_k times directions, values at the vertices I summed up.

        Args:
            values: Shape (facets, d).
            directions: At the points, shape (facets, points, dim).

        Returns:
            Of the nodes k, local, before the ranks are summed, shape (nodes * dim,).
        """
        at_points = np.einsum("fqi,fi->fq", self._psi, values)
        rows = np.einsum("fq,qk,fqd->fkd", at_points, self._shapes, directions)
        index_map = self._context.unknowns.V.dofmap.index_map
        result = np.zeros((index_map.size_local + index_map.num_ghosts, self._dim))
        np.add.at(result, self._nodes, rows)
        return result.reshape(-1)

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`. Collective."""
        pressures, _ = self._trial()
        forces += self._spread(self._at_vertices(pressures), self._point_gaps()[1])

    def energy(self) -> float:
        """See `Term`: the potential has the multiplier at rest."""
        lam = self.lam.x.array[self.nodes]
        squares = np.maximum(lam - self._eps * self.pressing_gaps(), 0.0) ** 2 - lam**2
        return total(self.comm, float(np.sum(self._area_of * squares / (2 * self._eps))))

    def blocks(self) -> Blocks:
        """See `Term`: sum of (eps/A_I) G_I G_I, less that of the pressures by the normals' turn.

        G_I is the integral of psi_I n . N.  Vertices that have ever been in contact keep their
        blocks, of zeros, so that the tangent's pattern seldom changes.
        """
        from scipy.sparse import csr_array, diags_array

        pressures, active = self._trial()
        _, normals = self._point_gaps()
        self._near[self.nodes[active]] = True
        factors = np.zeros(len(self._near))
        factors[self.nodes[active]] = (self._eps / self._area_of)[active]

        d, index_map = self._dim, self.lam.function_space.dofmap.index_map
        near = with_ghosts(index_map, self._near[:, None].astype(float))[self._vertices, 0] > 0
        some = near.any(axis=1)
        G = np.einsum("fqi,qk,fqd->fikd", self._psi[some], self._shapes, normals[some])
        V = self._context.unknowns.V.dofmap.index_map
        nodes = V.local_to_global(self._nodes[some].ravel()).reshape(-1, self._nodes.shape[1])
        vertices = index_map.local_to_global(self._vertices[some].ravel()).reshape(-1, d)
        rows = np.broadcast_to(vertices[:, :, None, None], G.shape)
        columns = nodes[:, None, :, None] * d + np.arange(d)
        kept = np.broadcast_to(near[some][:, :, None, None], G.shape)
        matrix = self._owners.summed(
            rows[kept], np.broadcast_to(columns, G.shape)[kept], G[kept], V.size_global * d
        )
        used, numbers = np.unique(matrix.indices // d, return_inverse=True)
        local = csr_array(
            (matrix.data, numbers * d + matrix.indices % d, matrix.indptr),
            shape=(matrix.shape[0], len(used) * d),
        )
        product = (local.T @ diags_array(factors) @ local).tobsr((d, d))
        first = np.repeat(np.arange(len(used)), np.diff(product.indptr))
        parts = [(used[first], used[product.indices], product.data)]
        if len(curved := self._turning(self._at_vertices(pressures)[some], some)):
            shape = curved.shape[:3]
            parts.append(
                (
                    np.broadcast_to(nodes[:, :, None], shape).ravel(),
                    np.broadcast_to(nodes[:, None, :], shape).ravel(),
                    curved.reshape(-1, d, d),
                )
            )
        i, j, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Blocks(i.astype(np.int64), j.astype(np.int64), np.ascontiguousarray(values))

    def _turning(self, pressures: FloatArray, which: BoolArray) -> FloatArray:
        """Minus the derivative of the forces by the turn of the normals; empty of planes.

        Args:
            pressures: At the vertices of some facets, shape (some, d) [Pa].
            which: Of all facets, bool.

        Returns:
            Shape (some, nodes, nodes, dim, dim) [N/m].
        """
        if isinstance(self.contact.obstacle, Plane):
            return np.empty(0)
        curvature = self.contact.obstacle.curvature(self._places()[which])
        at_points = np.einsum("fqi,fi->fq", self._psi[which], pressures)
        return -np.einsum(
            "fq,qk,ql,fqde->fklde", at_points, self._shapes, self._shapes, curvature, optimize=True
        )

    def along(self, way: FloatArray) -> _ForceOfVertices:
        """See `ContactPair`."""
        return _ForceOfVertices(self, way)

    def force_along(self, way: FloatArray) -> float:
        """The obstacle's force on the body along a unit vector [N]. Collective."""
        pressures, _ = self._trial()
        force = self._spread(self._at_vertices(pressures), self._point_gaps()[1])
        return total(self.comm, float(np.sum(force.reshape(-1, self._dim) @ way)))

    def row_along(self, way: FloatArray) -> FloatArray:
        """The derivative of that force by the unknowns, owned entries [N/m]. Collective."""
        pressures, active = self._trial()
        _, normals = self._point_gaps()
        along = np.einsum("fqi,fq->fi", self._psi, normals @ way)
        softer = np.where(active, -self._eps / self._area_of, 0.0) * self._summed(along)
        row = self._spread(self._at_vertices(softer), normals)
        turns = self.contact.obstacle.curvature(self._places()) @ way
        row += self._spread(self._at_vertices(pressures), turns)
        unknowns, own = self._context.unknowns, self._context.unknowns.V.dofmap.index_map
        vector = la.vector(own, self._dim)
        vector.array[:] = row
        vector.scatter_reverse(la.InsertMode.add)
        entries = unknowns.mixed_dofs(np.arange(own.size_local * self._dim, dtype=np.int32))
        result = np.zeros(unknowns.W.dofmap.index_map.size_local * unknowns.W.dofmap.index_map_bs)
        result[entries] = vector.array[: len(entries)]
        return result

    @property
    def stiffness(self) -> float:
        """Force per depth where all of the surface is in contact [N/m]. Collective."""
        return total(self.comm, float(np.sum(self._area_of * self._eps)))


class _ForceOfVertices:
    """See `ForceAlong`."""

    def __init__(self, pair: VertexContact, way: FloatArray) -> None:
        self._pair, self._way, self.stiffness = pair, way, pair.stiffness

    def value(self) -> float:
        """See `ForceAlong`."""
        return self._pair.force_along(self._way)

    def row(self) -> FloatArray:
        """See `ForceAlong`."""
        return self._pair.row_along(self._way)


def _on_facets(space: fem.FunctionSpace, cells: IndexArray, local: IndexArray) -> IndexArray:
    """Local nodes of a space on facets, shape (facets, nodes).

    Args:
        cells: Local cells beside the facets.
        local: Number of each facet in its cell.
    """
    layout, d = space.dofmap.dof_layout, space.mesh.topology.dim
    closure = np.array([layout.entity_closure_dofs(d - 1, i) for i in range(d + 1)], dtype=np.int32)
    return np.asarray(space.dofmap.list[cells[:, None], closure[local]])


def make_contacts(
    contacts: Sequence[Contact], context: FormContext, thickness: float
) -> tuple[ContactPair, ...]:
    """All contacts on a body. Collective.

    Args:
        thickness: Of a plane body [m].
    """
    return tuple(
        VertexContact(contact, context, i, thickness)
        if context.unknowns.degree > 1
        else NodalContact(contact, context, i)
        for i, contact in enumerate(contacts)
    )
