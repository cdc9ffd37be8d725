"""Inner surfaces of a body: interfaces of regions, cuts, and the cells on their two sides."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.errors import InputError, MeshError
from dolfin_elastic.core.ghosts import summed
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.shapes.directions import Axis
from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray, IndexArray
from dolfin_elastic.core.units import MeshLength
from dolfin_elastic.mesh.body import Body, span
from dolfin_elastic.mesh.criteria import BoundingBox

_ONE_WAY = 0.5
"""Least part of the projected area that faces one way, else no side lies ahead."""


def _corners(body: Body) -> FloatArray:
    """Corners of the owned cells [m], shape (cells, dim + 1, dim)."""
    geometry, dim = body.mesh.geometry, body.dim
    nodes = geometry.dofmap[: len(body.owned_cells()), : dim + 1]
    return np.asarray(geometry.x[nodes][..., :dim])


def outward_areas(body: Body, cells: AnyArray, local: AnyArray) -> tuple[FloatArray, FloatArray]:
    """Area vectors out of cells [m^2], and middles of the facets, by the chord of curved ones."""
    corners, dim = _corners(body)[cells], body.dim
    off = (local[:, None] + 1 + np.arange(dim)) % (dim + 1)  # facet i is opposite to corner i
    facet = np.take_along_axis(corners, off[..., None], axis=1)
    edges = facet[:, 1:] - facet[:, :1]
    if dim == 2:
        N = np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
    else:
        N = np.cross(edges[:, 0], edges[:, 1]) / 2
    inward = corners[np.arange(len(cells)), local] - facet[:, 0]
    return -np.sign((N * inward).sum(axis=1))[:, None] * N, facet.mean(axis=1)


class CellFacets:
    """Facets of owned cells, and sums over the cells beside them on all ranks. Collective."""

    def __init__(self, body: Body) -> None:
        topology, dim, self._comm = body.mesh.topology, body.dim, body.comm
        topology.create_connectivity(dim, dim - 1)
        topology.create_connectivity(dim, 0)
        count = len(body.owned_cells())
        self.of_cells, self.corners = (
            topology.connectivity(dim, d).array.reshape(-1, dim + 1)[:count] for d in (dim - 1, 0)
        )
        self._maps = {d: topology.index_map(d) for d in (dim - 1, 0)}
        self._dim = dim

    def beside(self, rows: FloatArray) -> FloatArray:
        """Sums of rows (cells, columns) at the facets of the cells, shape (facets, columns)."""
        repeated = np.repeat(rows, self._dim + 1, axis=0)
        return self._sum(self._dim - 1, self.of_cells.ravel(), repeated)

    def touching(self, cells: AnyArray, local: AnyArray) -> AnyArray:
        """Whether owned cells have a corner in facets, given as cells and numbers in them."""
        off = (local[:, None] + 1 + np.arange(self._dim)) % (self._dim + 1)
        corners = np.take_along_axis(self.corners[cells], off, axis=1).ravel()
        marks = self._sum(0, corners, np.ones((len(corners), 1)))
        return np.asarray((marks[self.corners, 0] > 0).any(axis=1))

    def anywhere(self, marks: AnyArray) -> bool:
        """Whether a mark is set on any rank."""
        return bool(total(self._comm, int(np.count_nonzero(marks))))

    def _sum(self, d: int, entities: AnyArray, rows: FloatArray) -> FloatArray:
        return summed(self._maps[d], entities, rows)


def on_both(sides: AnyArray) -> FloatArray:
    """Whether cells are of the positive and of the negative side, shape (cells, 2)."""
    return np.stack([sides == 1, sides == -1], axis=1).astype(np.float64)


def interface(body: Body, first: str, second: str) -> IndexArray:
    """Local facets between the cells of two regions, sorted. Collective.

    Raises:
        MeshError: There is no such region, or the two share cells.
    """
    sides = np.zeros(len(body.owned_cells()), dtype=np.int8)
    sides[body.owned_cells(first)] = 1
    shared = body.owned_cells(second)
    if count := int(total(body.comm, int(np.count_nonzero(sides[shared])))):
        raise MeshError(
            f"'{first}' and '{second}' have {count} elements in common",
            where="between",
            expected="two regions that lie beside each other",
        )
    sides[shared] = -1
    return facets_between(CellFacets(body), sides)


def facets_between(facets: CellFacets, sides: AnyArray) -> IndexArray:
    """Local facets that have an owned cell of each side, on any ranks, sorted. Collective."""
    return np.flatnonzero((facets.beside(on_both(sides)) > 0).all(axis=1)).astype(np.int32)


def sides_of_plane(
    body: Body, space: BoundingBox, axis: Axis, at: MeshLength, region: str | None = None
) -> AnyArray:
    """1 of owned cells whose barycentre lies beyond a plane, else -1. Collective.

    Args:
        at: Its coordinate, a bare number in the unit of `space`.
        region: Cells of other regions get 0.

    Raises:
        MeshError: All of them lie on one side.
    """
    scale, (number, place) = space.scale, space.plane(axis, at)
    middles = _corners(body).mean(axis=1)[:, number]
    within = np.zeros(len(middles), dtype=bool)
    within[body.owned_cells(region)] = True
    ahead = middles > place + 1e-9 * span(body)
    counts = total(body.comm, np.array([(within & ahead).sum(), (within & ~ahead).sum()]))
    low, high = float(space.low[number]), float(space.high[number])
    if not low < place < high or not counts.all():
        if low < place < high:  # too near to an end: a cut leaves a cell on each side
            low = -largest(body.comm, float(-middles[within].min(initial=np.inf)))
            high = largest(body.comm, float(middles[within].max(initial=-np.inf)))
        raise MeshError(
            f"no elements lie on both sides of {axis} = {place / scale:.4g} {body.unit.name}",
            where="at",
            expected=f"between {low / scale:.4g} and {high / scale:.4g} {body.unit.name}",
        )
    return np.where(within, np.where(ahead, 1, -1), 0).astype(np.int8)


def sides_of_surface(body: Body, name: str, region: str | None = None) -> AnyArray:
    """Sides of owned cells that touch an inner surface: 1, -1; 0 of the others. Collective.

    Args:
        region: That of the positive side.  By default the positive side lies beyond, along the
            axis that is most normal to the surface.

    Raises:
        InputError: The surface is on the boundary, or has no two sides.
    """
    facets = CellFacets(body)
    ones = facets.beside(np.ones((len(facets.of_cells), 1)))[:, 0]
    on = np.zeros(len(ones), dtype=bool)
    on[body.surface(name)] = True
    cells, local = np.nonzero(on[facets.of_cells])
    if total(body.comm, int((on & (ones < 2)).sum())):
        raise InputError(
            f"'{name}' is on the boundary of the body",
            where="on",
            expected="an inner surface: across the boundary goes what is applied, and the reaction",
        )
    sides, near = np.zeros(len(facets.of_cells), dtype=np.int8), facets.touching(cells, local)
    if region is None:
        told = _coloured_by_axis(body, facets, on, near, sides)
    else:
        sides[cells] = np.where(np.isin(cells, body.region(region)), 1, -1)
        _spread(facets, on, near, sides)
        told = True
    count = facets.beside(on_both(sides))
    wrong = int((count[~on] > 0).all(axis=1).sum() + (count[on] != 1).sum())
    if total(body.comm, wrong) or not told:
        raise InputError(
            f"'{name}' has two sides that cannot be distinguished",
            where="on" if region is None else "side",
            expected="an inner surface that ends at the boundary of the body or is closed; where "
            "it bends round, side = the name of the region on one side of it",
        )
    return sides


def _spread(facets: CellFacets, on: BoolArray, near: AnyArray, sides: AnyArray) -> None:
    """Sides of cells follow from those of their neighbours: the other one across the surface."""
    while True:
        reached = facets.beside(on_both(sides))
        reached[on] = reached[on][:, ::-1]
        votes = reached[facets.of_cells].sum(axis=1)
        new = near & (sides == 0) & (votes > 0).any(axis=1)
        if not facets.anywhere(new):
            return
        sides[new] = np.where(votes[new, 0] >= votes[new, 1], 1, -1)


def _coloured_by_axis(
    body: Body, facets: CellFacets, on: BoolArray, near: AnyArray, sides: AnyArray
) -> bool:
    """Fills in the sides part by part of a surface; whether the axis tells them. Collective.

    The facets that stand for a plane may fold: their sum decides, not each of them.
    """
    cells, local = np.nonzero(on[facets.of_cells])
    N, _ = outward_areas(body, cells, local)
    parts: list[BoolArray] = []
    net: list[FloatArray] = []
    every: list[FloatArray] = []
    while facets.anywhere(sides[cells] == 0):
        before = sides == 0
        first = body.comm.allgather(bool(np.any(sides[cells] == 0))).index(True)
        if body.comm.rank == first:
            sides[cells[sides[cells] == 0][0]] = 1
        _spread(facets, on, near, sides)
        part = before & (sides != 0)
        out = N[part[cells] & (sides[cells] == 1)]
        parts.append(part)
        net.append(total(body.comm, out.sum(axis=0)))
        every.append(total(body.comm, np.abs(out).sum(axis=0)))
    axis = int(np.argmax(np.abs(net).sum(axis=0))) if parts else 0
    for part, forward, area in zip(parts, net, every, strict=True):
        if abs(forward[axis]) <= _ONE_WAY * area[axis]:
            return False
        if forward[axis] > 0:  # out of the positive side it goes forward
            sides[part] *= -1
    return True
