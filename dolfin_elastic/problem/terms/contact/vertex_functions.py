"""`VertexFunctions`: functions of the vertices of a surface by which contact is weighted.

A uniform pressure on a quadratic triangle has no nodal forces at the vertices, and the midside
nodes of straight faces lie off a round surface: neither gaps at all nodes nor gaps at quadrature
points give pressures that are right.  So pressures are sums of functions psi_I of the vertices that
are linear on a face and biorthogonal to the vertices' hat functions l_J,

    integral of psi_I l_J = delta_IJ A_I,    A_I = integral of l_I,

so that the sum of the psi_I is 1, and what is compared is the mean (integral of psi_I f)/A_I of a
quantity f at a vertex.  Integrals are over the reference surface.

A straight face of a body that is round lacks what lies between it and the body's true surface,
which may be more than the gap.  So on straight faces a quantity f(x) is that of the vertices,
linear on a face, and what the midside displacements add to it: with the place x of a point and that
of the same point on the face through the moved vertices, x',

    f = sum of l_J f(x_J) + f(x) - f(x').

Source: B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989 (dual functions); A. Popp, B. Wohlmuth,
M. W. Gee & W. A. Wall, SIAM J. Sci. Comput. 34 (2012) B421 (quadratic faces); M. A. Puso & T. A.
Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 601 (weighted gaps).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.ghosts import summed, with_ghosts
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.curved import (
    facet_areas,
    facet_quadrature,
    facet_shape_functions,
)
from dolfin_elastic.mesh.geometry.simplices import dofs_on_facets
from dolfin_elastic.problem.constraints.ties.exchange import Owners
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.problem.terms.contact.pair import ContactPair
from dolfin_elastic.problem.terms.contact.surfaces import nodal

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class VertexFunctions:
    """The functions of the surface of a contact. Collective to make.

    Args:
        pair: The contact that weights its gaps; its multiplier is linear on each facet.
        thickness: Of a plane body [m].

    Attributes:
        areas: A_I of the owned vertices [m^2].
        X: Reference places of the points at which f is asked for, shape (facets, points, dim) [m].
        psi: What f at each point counts for the vertices of its facet, integrals included, shape
            (facets, points, vertices) [m^2].
        shapes: Shape functions of the displacement at the points, shape (points, nodes), or those
            of each facet, (facets, points, nodes).
        weights: Areas of the points of the quadrature, shape (facets, inner) [m^2].
        bulge: What f at these is beside its linear part on a facet, from f at all points, shape
            (facets, inner, points).
        lengths: Of the facets [m].
        distinct: Of all points, one of each that is different, and for each of all its row there.
    """

    areas: FloatArray
    shapes: FloatArray
    weights: FloatArray
    bulge: FloatArray
    lengths: FloatArray
    linear = False

    def __init__(self, pair: ContactPair, context: FormContext, thickness: float) -> None:
        mesh, d, order = context.body.mesh, context.body.dim, context.order
        self._context, self._pair, self._dim = context, pair, d
        own = pair.facets[pair.facets < mesh.topology.index_map(d - 1).size_local]
        # The degree of a pressure, a displacement and, on curved faces, the area element.
        rule = facet_quadrature(mesh, own, 1 + order + 2 * (order - 1), raised=False)
        weights = thickness * rule.weights
        if context.axisymmetric:
            weights *= 2 * np.pi * rule.X[:, :, 0]
        hats = facet_shape_functions(d, 1, rule.local)
        means = np.einsum("fq,qi->fi", weights, hats)
        masses = np.einsum("fq,qi,qj->fij", weights, hats, hats)
        dual = means[:, :, None] * np.linalg.inv(masses)
        self.psi = np.einsum("fq,fij,qj->fqi", weights, dual, hats)
        self.shapes = facet_shape_functions(d, context.unknowns.degree, rule.local)
        self.X, self.weights = rule.X, weights
        self.lengths = facet_areas(mesh, own) ** (1 / (d - 1))
        linear = np.linalg.solve(masses, np.einsum("fq,qi->fiq", weights, hats))
        self.bulge = np.eye(len(hats)) - hats @ linear
        if mesh.geometry.cmap.degree == 1:
            self._measure_from_vertices(hats, means, mesh.geometry.x[rule.nodes][:, :, :d])
        S, V = pair.lam.function_space, context.unknowns.V
        self._vertices, self._nodes = dofs_on_facets(S, own), dofs_on_facets(V, own)
        self._map, self._node_map = S.dofmap.index_map, V.dofmap.index_map
        self._owners = Owners(pair.comm, self._map.local_range[0], self._map.size_local)
        self.areas = self.summed(means[..., None])[:, 0]

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
        none = np.zeros((len(hats) + d, self.shapes.shape[1] - d))
        flat = np.vstack([hats, np.eye(d)])
        at_corners = means[:, :, None] * np.eye(d)
        if self.shapes.shape[1] == d:  # linear: x is x'
            self.shapes, self.psi, self.X = np.eye(d), at_corners, corners
            self.linear = True
            return
        self.shapes = np.vstack([self.shapes, np.hstack([flat, none])])
        self.psi = np.concatenate([self.psi, -self.psi, at_corners], axis=1)
        # A linear part is none of a bulge: what is left of f is f(x) - f(x').
        nothing = np.zeros((*self.bulge.shape[:2], d))
        self.bulge = np.concatenate([self.bulge, -self.bulge, nothing], axis=2)
        self.X = np.concatenate([self.X, self.X, corners], axis=1)

    def summed(self, rows: FloatArray) -> FloatArray:
        """Sums at the owned vertices of what facets have at theirs, shape (n, columns)."""
        return summed(self._map, self._vertices, rows)[self._pair.nodes]

    def displacements(self, of_nodes: FloatArray | None = None) -> FloatArray:
        """Of the points, shape of `X` [m]. Not collective.

        Args:
            of_nodes: Of all nodes of this rank, (nodes, dim) [m]; None: the present ones.
        """
        u = self._context.unknowns.u.x.array if of_nodes is None else of_nodes
        return np.asarray(self.shapes @ u.reshape(-1, self._dim)[self._nodes])

    def means(self, values: FloatArray) -> FloatArray:
        """Means at the owned vertices, shape (n, columns). Collective.

        Args:
            values: At the points, shape (facets, points, columns).
        """
        return self.summed(self.psi.swapaxes(1, 2) @ values) / self.areas[:, None]

    def at_points(self, values: FloatArray) -> FloatArray:
        """psi_I times values, summed up, with integrals, shape (facets, points, columns).

        Collective.

        Args:
            values: Of the owned vertices, shape (n, columns).
        """
        return np.asarray(self.psi @ self.at_vertices(values))

    def at_vertices(self, values: FloatArray, vertices: IntArray | None = None) -> FloatArray:
        """Values of the owned vertices at the vertices of facets, shape (facets, d, columns).

        Collective.

        Args:
            vertices: Local ones of other facets.
        """
        every = np.zeros((self._map.size_local, values.shape[1]))
        every[self._pair.nodes] = values
        return with_ghosts(self._map, every)[self._vertices if vertices is None else vertices]

    def beside(self, which: BoolArray) -> BoolArray:
        """Which vertices of facets are some of the owned vertices, shape (facets, d). Collective.

        Args:
            which: Of the owned vertices.
        """
        return np.asarray(self.at_vertices(which[:, None].astype(float))[:, :, 0] > 0)

    def spread(self, vectors: FloatArray, *, turned: bool = True) -> FloatArray:
        """Vectors at the points times the shape functions, at the nodes of the displacement. Local.

        Args:
            vectors: Shape (facets, points, dim).

        Returns:
            Before the ranks are summed, shape (nodes * dim,).
        """
        result = np.zeros((self._node_map.size_local + self._node_map.num_ghosts, self._dim))
        np.add.at(result, self._nodes, self.shapes.swapaxes(-1, -2) @ vectors)
        return result.reshape(-1)

    def rows(
        self, which: BoolArray, directions: FloatArray | None = None
    ) -> tuple[IntArray, csr_array]:
        """Rows of A_I times the means at some owned vertices. Collective.

        Args:
            which: Of the owned vertices; rows of all others are empty.
            directions: At the points, shape (facets, points, dim): of the component along these;
                None: of a scalar.

        Returns:
            Global nodes of the displacement, and by them the rows, all components of a node
            together.
        """
        from scipy.sparse import csr_array

        d, wanted = self._dim, self.beside(which)
        some: BoolArray = np.asarray(wanted.any(axis=1))
        psi, N = self.psi[some], self.at(some)
        if directions is None:
            entries = (psi.swapaxes(1, 2) @ N)[..., None]
        else:
            entries = np.einsum("fqi,fqk,fqd->fikd", psi, N, directions[some], optimize=True)
        width = entries.shape[-1]
        columns = self.nodes(some)[:, None, :, None] * width + np.arange(width)
        rows = self._map.local_to_global(self._vertices[some].ravel()).reshape(-1, d, 1, 1)
        kept = np.broadcast_to(wanted[some][:, :, None, None], entries.shape)
        i, j = (np.broadcast_to(a, entries.shape)[kept] for a in (rows, columns))
        size = self._node_map.size_global * width
        matrix = self._owners.summed(i, j, entries[kept], size)[self._pair.nodes]
        used, numbers = np.unique(matrix.indices // width, return_inverse=True)
        local = numbers * width + matrix.indices % width
        shape = (matrix.shape[0], len(used) * width)
        return used.astype(np.int64), csr_array((matrix.data, local, matrix.indptr), shape=shape)

    def at(self, which: BoolArray) -> FloatArray:
        """Shape functions on some facets, shape (some, points, nodes)."""
        shape = len(self.psi), *self.shapes.shape[-2:]
        return np.asarray(np.broadcast_to(self.shapes, shape)[which])

    def nodes(self, which: BoolArray) -> IntArray:
        """Global nodes of the displacement on some facets, shape (some, nodes)."""
        some = self._nodes[which]
        return np.asarray(self._node_map.local_to_global(some.ravel())).reshape(some.shape)

    def at_nodes(self, values: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Owned nodes of the displacement on the surface, and values linear on each edge there.

        Collective.

        Args:
            values: Of the owned vertices, shape (n, columns).
        """
        linear, (field, nodes, at) = fem.Function(self._pair.lam.function_space), self.every
        result = np.empty((len(nodes), values.shape[1]))
        for column, found in zip(values.T, result.T, strict=True):
            linear.x.array[self._pair.nodes] = column
            linear.x.scatter_forward()
            field.interpolate(linear)
            found[:] = field.x.array[nodes]
        return at, result

    @cached_property
    def distinct(self) -> tuple[IntArray, IntArray]:
        """See the class: facets have vertices in common."""
        every = np.arange(self.X.shape[0] * self.X.shape[1])
        if not self.linear:
            return every, every
        _, first, rows = np.unique(self._vertices, return_index=True, return_inverse=True)
        return first, rows.reshape(-1)

    @cached_property
    def every(self) -> tuple[fem.Function, IndexArray, IndexArray]:
        """A scalar field of the displacement's degree, and its owned nodes on the surface.

        These in its space, and in that of the displacement.
        """
        return nodal(self._context, self._pair.facets, self._context.unknowns.degree)


def diagonal(blocks: FloatArray) -> csr_array:
    """A matrix of blocks, shape (n, rows, columns), along its diagonal."""
    from scipy.sparse import bsr_array, csr_array

    n, rows, columns = blocks.shape
    parts = (blocks, np.arange(n), np.arange(n + 1))
    return csr_array(bsr_array(parts, shape=(n * rows, n * columns)))


def blocks_of(nodes: IntArray, matrix: csr_array, rows: csr_array, d: int) -> Blocks:
    """A matrix of nodes as blocks, of zeros, too: products of sparse matrices leave zeros out.

    Args:
        nodes: Global numbers.
        matrix: By the components of these.
        rows: Of vertices, by the nodes or their components; all pairs of nodes of a row have a
            block, and no others.
    """
    from scipy.sparse import csr_array

    n, width = len(nodes), rows.shape[1] // max(len(nodes), 1)
    parts = (np.ones(len(rows.indices)), rows.indices // max(width, 1), rows.indptr)
    touched = csr_array(parts, shape=(rows.shape[0], n))
    pairs = csr_array(touched.T @ touched).tocoo()
    numbers = np.sort(pairs.coords[0].astype(np.int64) * n + pairs.coords[1])
    product = matrix.tobsr((d, d))
    first = np.repeat(np.arange(n), np.diff(product.indptr))
    values = np.zeros((len(numbers), d, d))
    values[np.searchsorted(numbers, first * n + product.indices)] = product.data
    return Blocks(nodes[numbers // max(n, 1)], nodes[numbers % max(n, 1)], values)
