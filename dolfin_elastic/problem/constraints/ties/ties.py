"""Tied nodes as combinations of others: the transformation that eliminates them.

With u = T u the tied nodes have no unknowns of their own: forces on them act on those that they
follow, T^T f, and a matrix K becomes T^T K T.  It stays symmetric and definite, needs no penalty
and no multiplier.  A component that a support prescribes is not tied as well: its multiplier goes
to the tied nodes beside it, so that constant tractions are still passed on in full.  Source: M. A.
Puso & T. A. Laursen, Int. J. Numer. Meth. Engng 58 (2003) 209; T. Cichosz & M. Bischoff (2011),
section 3, for the boundary.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem, la
from scipy.sparse import csr_array

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import first_of, largest, smallest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.model.tie import Tie
from dolfin_elastic.problem.constraints.ties.exchange import Owners, Product
from dolfin_elastic.problem.constraints.ties.facets import (
    Facets,
    areas,
    longest_edge,
    opposite,
    owned,
)
from dolfin_elastic.problem.constraints.ties.mortar import ALPHA, Mortar, integrate
from dolfin_elastic.problem.constraints.ties.segments import GAP, cut

CHAIN = 8
"""Ties that may follow one another."""


@dataclass(frozen=True)
class TiedSurfaces:
    """What one tie holds together.

    Attributes:
        label: Its name in results.
        dofs: Owned entries of the displacement that it ties.
        side: Which owned nodes lie on the tied side.
        area: Area of the tied side [m^2, m in a plane].
        covered: Area of it that lies opposite the other side.
        gap: Largest distance between the two sides [m].
        size: Length of the facets there [m].
    """

    label: str
    dofs: IndexArray
    side: BoolArray
    area: float
    covered: float
    gap: float
    size: float


class Ties:
    """All ties of a body. Collective to make.

    Args:
        ties: What is tied; where a node is tied twice the first one holds.
        held: Owned entries at which supports prescribe anything.
        axisymmetric: The body is one of revolution about y.

    Attributes:
        given: What is tied.
        dofs: Owners of the entries of the displacement.
        tied: Owned entries of the displacement that follow others, sorted.
        nodes: Local nodes, owned and ghost, with tied components, sorted.
        surfaces: What each tie holds together.
        rows: Their rows of T, columns global, shape (tied, all entries); in no column is a tied
            entry.
        row_products: The tied entries, and products of their rows with vectors.

    Raises:
        MeshError: A surface does not exist.
        InputError: Surfaces are too far apart, or follow one another in a circle.
    """

    def __init__(
        self,
        body: Body,
        V: fem.FunctionSpace,
        ties: Sequence[Tie],
        held: BoolArray,
        *,
        axisymmetric: bool = False,
    ) -> None:
        imap = V.dofmap.index_map
        self.comm, self._dim, self.given = body.comm, int(V.dofmap.index_map_bs), tuple(ties)
        self._body, self._V, self._axisymmetric = body, V, axisymmetric
        self._nodes = Owners(body.comm, imap.local_range[0], imap.size_local)
        dim = self._dim
        self.dofs = Owners(body.comm, dim * imap.local_range[0], dim * imap.size_local)
        held = held.copy()
        self._rows: list[tuple[IntArray, IntArray, FloatArray]] = []
        surfaces = []
        for k, tie in enumerate(ties):
            tied, result = self._add(tie, held.reshape(-1, dim), f"tie[{k}]")
            held[tied] = True
            surfaces.append(result)
        self.surfaces: tuple[TiedSurfaces, ...] = tuple(surfaces)
        self.tied: IndexArray = np.sort(np.concatenate([s.dofs for s in surfaces]))
        self._links = self._rows_of_ties()
        self.rows = self._resolved()
        self.row_products = self.tied, Product(self.dofs, self.rows)
        self._passed = [self._passed_on(surface) for surface in surfaces]
        marks = la.vector(imap, 1)
        marks.array[np.unique(self.tied // dim)] = 1.0
        marks.scatter_forward()
        self.nodes: IndexArray = np.flatnonzero(marks.array).astype(np.int32)

    # --- one tie ---

    def _add(self, tie: Tie, held: BoolArray, where: str) -> tuple[IndexArray, TiedSurfaces]:
        """Adds the rows of a tie. Collective."""
        near, far = (owned(self._body, self._V, names) for names in (tie.surfaces, tie.others))
        margin = (
            tie.tolerance if tie.tolerance is not None else GAP * longest_edge(self.comm, near, far)
        )
        there = opposite(self.comm, near, far, margin)
        pieces = cut(near, there, tie.tolerance)
        covered = total(self.comm, float(pieces.weights.sum()))
        if not covered > 0.0:
            self._refuse(tie, near, far, margin, where)
        mortar = integrate(self._nodes, near, there, pieces, axisymmetric=self._axisymmetric)
        dofs = self._eliminate(mortar, held)
        side = np.diff(mortar.beside.indptr) > 0
        area = total(self.comm, float(areas(near).sum()))
        gap = largest(self.comm, float(pieces.gaps.max(initial=0.0)))
        size = longest_edge(self.comm, near, far)
        return dofs, TiedSurfaces(tie.label, dofs, side, area, min(covered, area), gap, size)

    def _refuse(self, tie: Tie, near: Facets, far: Facets, reach: float, where: str) -> None:
        """Says how far apart surfaces are that nothing ties. Collective.

        Args:
            near: This rank's facets of one surface.
            reach: Distance up to which none lie opposite each other [m]; others are looked at step
                by step, for all pairs of large surfaces would be too many.

        Raises:
            InputError: Always.
        """
        farthest, least = float(span(self._body)), np.inf
        reach = max(reach, 1e-3 * farthest)
        while not np.isfinite(least) and reach <= 4 * farthest:
            pieces = cut(near, opposite(self.comm, near, far, reach), reach)
            least = smallest(self.comm, float(pieces.gaps.min(initial=np.inf)))
            reach *= 4
        names = f"'{'+'.join(tie.surfaces)}' and '{'+'.join(tie.others)}'"
        if not np.isfinite(least):
            raise InputError(
                f"{names} lie nowhere opposite each other",
                where=f"{where}.to",
                expected="surfaces that touch, side by side and nearly parallel",
            )
        at = first_of(
            self.comm,
            [tuple(x) for x in pieces.places[pieces.gaps <= least * (1 + 1e-9)].round(12)],
        )
        size = smallest(self.comm, float(pieces.sizes.min(initial=np.inf)))
        unit, limit = self._body.unit, "a tenth of the facets' size"
        if tie.tolerance is not None:
            limit = unit.length(tie.tolerance, 4)
        assert at is not None
        raise InputError(
            f"{names} are {unit.length(least, 4)} apart where they are nearest, at "
            f"{unit.point(at)}, facets of {unit.length(size, 4)}; tied is what is "
            f"nearer than {limit}",
            where=f"{where}.{'on' if tie.tolerance is None else 'tolerance'}",
            expected=f'surfaces that touch, or tolerance = "{unit.length(1.2 * least)}" or '
            "more, which keeps the gap",
        )

    def _eliminate(self, mortar: Mortar, held: BoolArray) -> IndexArray:
        """Appends the rows of the nodes that a tie eliminates; their owned entries. Collective."""
        nodes, dim = self._nodes, self._dim
        first, D = nodes.first, mortar.D
        kept = (D > 0.0)[:, None] & ~held
        middle = np.diff(mortar.ends.indptr) > 0  # of an edge of a quadratic facet
        factor = np.where(middle, 1 - 2 * ALPHA, 1.0) / np.where(D > 0.0, D, 1.0)
        for c in range(dim):
            rows = np.flatnonzero(kept[:, c])
            at, j, v = _entries(mortar.M, rows)
            self._append(first + rows[at], j, factor[rows[at]] * v, c)
            at, j, v = _entries(mortar.ends, rows)
            self._append(first + rows[at], j, ALPHA * v, c)
            self._pass_on(mortar, kept[:, c], held[:, c] & (D > 0.0), factor, c)
        return np.flatnonzero(kept).astype(np.int32)

    def _pass_on(
        self, mortar: Mortar, kept: BoolArray, dropped: BoolArray, factor: FloatArray, c: int
    ) -> None:
        """Gives the multipliers of nodes that are held to tied nodes beside them. Collective.

        Args:
            kept: Owned nodes whose component is tied.
            dropped: Owned nodes whose component is held, though it lies opposite something.
            factor: Of each owned node's row.
        """
        nodes = self._nodes
        rows = np.flatnonzero(dropped)
        at, beside, _ = _entries(mortar.beside, rows)
        k = rows[at]
        about = np.column_stack([kept, factor])
        there = nodes.values_at(about, beside)
        taken = there[:, 0] > 0.0
        k, beside, scale = k[taken], beside[taken], there[taken, 1]
        share = scale / np.bincount(k, minlength=nodes.count)[k]
        ends = mortar.ends
        middle = np.diff(ends.indptr) > 0
        # What the multiplier of k measures: M_kj u_j - D_k w_k, w_k its own coefficient.
        own = mortar.D / np.where(middle, 1 - 2 * ALPHA, 1.0)
        diagonal = csr_array(
            (own, (np.arange(nodes.count), nodes.first + np.arange(nodes.count))),
            shape=(nodes.count, nodes.size),
        )
        scaled = csr_array(
            (np.repeat(ALPHA * own, np.diff(ends.indptr)), ends.indices, ends.indptr),
            shape=ends.shape,
        )
        gap = csr_array(mortar.M - diagonal + scaled)
        pair, j, v = _entries(gap, k)
        self._append(beside[pair], j, share[pair] * v, c)

    def _append(self, i: IntArray, j: IntArray, v: FloatArray, c: int) -> None:
        self._rows.append((self._dim * i + c, self._dim * j + c, v))

    # --- all ties ---

    def passed_forces(
        self, forces: FloatArray
    ) -> Iterator[tuple[TiedSurfaces, IndexArray, FloatArray]]:
        """Tie by tie the owned tied entries and the forces on them by the other side [N].

        Args:
            forces: On the tied entries, out of balance of bodies that are not tied [N].
        """
        for surface, passed in zip(self.surfaces, self._passed, strict=True):
            at = np.searchsorted(self.tied, surface.dofs)
            yield surface, surface.dofs, passed * forces[at]

    def _passed_on(self, surface: TiedSurfaces) -> FloatArray:
        """Share of the force on each entry of a tie that goes to the other side. Collective.

        Where a midside node is tied and a vertex is not, the rest stays on the tied side.
        """
        rows = csr_array(self.rows[np.searchsorted(self.tied, surface.dofs)])
        columns = rows.indices.astype(np.int64)
        far = ~self._nodes.values_at(surface.side, columns // self._dim)
        shares = csr_array((rows.data * far, rows.indices, rows.indptr), shape=rows.shape)
        return np.asarray(shares.sum(axis=1))

    def links(self, numbers: IntArray) -> IntArray:
        """Numbers of tied nodes and of those that they follow, shape (n, 2). Collective.

        Args:
            numbers: Of each owned node, such as that of its body.
        """
        there = self._nodes.values_at(numbers, self.rows.indices.astype(np.int64) // self._dim)
        here = numbers[self.tied // self._dim]
        return np.column_stack([np.repeat(here, np.diff(self.rows.indptr)), there])

    def factors(self, free: FloatArray, numbers: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Row, column and value of T's entries in tied rows, none twice. Collective.

        Args:
            free: See `Rows.free_directions`, of the owned entries.
            numbers: Places of the owned entries in rows and columns.
        """
        dim = self._dim
        i, j, v = _entries(self.rows, np.arange(len(self.tied)))
        columns = ((j - j % dim)[:, None] + np.arange(dim)).ravel()
        values = (v[:, None] * self.dofs.values_at(free, j)).ravel()
        keep = values != 0.0
        result = (values[keep], (np.repeat(i, dim)[keep], columns[keep]))
        i, j, v = _entries(csr_array(result, shape=self.rows.shape), np.arange(len(self.tied)))
        return numbers[self.tied[i]], self.dofs.values_at(numbers, j), v

    def _rows_of_ties(self) -> csr_array:
        i, j, v = (np.concatenate(parts) for parts in zip(*self._rows, strict=True))
        return self.dofs.summed(i, j, v)

    def _resolved(self) -> csr_array:
        """Rows of the tied entries in which no tied entry stands, shape (tied, all). Collective.

        Raises:
            InputError: Ties follow one another in a circle.
        """
        dofs, shape = self.dofs, (len(self.tied), self.dofs.size)
        free = np.ones(dofs.count, dtype=bool)
        free[self.tied] = False
        i, j, v = _entries(self._links, self.tied)
        for _ in range(CHAIN):
            follows = ~dofs.values_at(free, j)
            if not total(self.comm, int(follows.sum())):
                return csr_array((v, (i, j)), shape=shape)
            rows, columns, values = self._expanded(j[follows])
            i = np.concatenate([i[~follows], i[follows][rows]])
            v = np.concatenate([v[~follows], v[follows][rows] * values])
            j = np.concatenate([j[~follows], columns])
            i, j, v = _entries(csr_array((v, (i, j)), shape=shape), np.arange(shape[0]))
        raise InputError(
            "ties follow one another in a circle",
            where="tie",
            expected="surfaces of which none follows, by way of others, itself: exchange `on` "
            "and `to` of one tie",
        )

    def _expanded(self, numbers: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Rows of tied entries of any rank: position in `numbers`, column, value. Collective."""
        links = self._links
        parts = np.empty(self.dofs.count, dtype=object)
        for row in self.tied:
            at = slice(links.indptr[row], links.indptr[row + 1])
            parts[row] = (links.indices[at].astype(np.int64), links.data[at])
        result = self.dofs.values_at(parts, numbers)
        lengths = [len(columns) for columns, _ in result]
        rows = np.repeat(np.arange(len(numbers)), lengths)
        columns = np.concatenate([np.empty(0, dtype=np.int64), *(c for c, _ in result)])
        values = np.concatenate([np.empty(0), *(v for _, v in result)])
        return rows, columns, values


def _entries(
    matrix: csr_array, rows: IndexArray | IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Entries of some rows: position of the row in `rows`, column, value."""
    part = csr_array(matrix[rows])
    position = np.repeat(np.arange(len(rows)), np.diff(part.indptr))
    return position, part.indices.astype(np.int64), np.asarray(part.data)
