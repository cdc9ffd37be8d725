"""`Surface`: triangles with common corners, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.types import AnyArray, FloatArray, IntArray
from dolfin_elastic.core.units import LengthUnit
from dolfin_elastic.mesh.formats.surfaces.crossings import crossings
from dolfin_elastic.mesh.formats.surfaces.readers.soup import Soup
from dolfin_elastic.mesh.formats.surfaces.topology import (
    CrowdedError,
    Edges,
    OneSidedError,
    heights,
    oriented,
    volumes,
    weld,
)

DIGITS = 1e-7
"""Distance of corners that are one, over the largest coordinate: files have seven digits."""

_NO_THICKNESS = 1e-9
"""Smallest over largest extent of what is flat."""

FLAT = 1e-7
"""Height over longest edge of triangles without area."""

ELSEWHERE = "mend it in the program that it comes from"

ON_EDGE = 1e-6
"""Distance from an edge, over the size of the body, of a corner that lies on it."""


@dataclass(frozen=True)
class Fault:
    """What is wrong with a surface.

    Attributes:
        what: In words: "12 open edges".
        remedy: What `repair = true` does about it; empty: nothing.
        places: In the file's unit, shape (n, 3).
    """

    what: str
    remedy: str
    places: FloatArray

    def error(self, name: str, unit: LengthUnit) -> MeshError:
        """The error that says it."""
        first = unit.point(self.places[0] * unit.metres)
        at = f", {'first ' if len(self.places) > 1 else ''}at {first}"
        return MeshError(
            self.what + at,
            where=name,
            expected=f"repair = true {self.remedy}"
            if self.remedy
            else f"{ELSEWHERE}; repair = true cannot",
        )


@dataclass(frozen=True)
class Surface:
    """Triangles with common corners.

    Attributes:
        points: In the file's unit, shape (n, 3).
        triangles: Shape (m, 3).
        groups, solids: Of each triangle, see `Soup`.
        names, solid_names: See `Soup`.
    """

    points: FloatArray
    triangles: IntArray
    groups: IntArray
    solids: IntArray
    names: Sequence[str]
    solid_names: Sequence[str]

    @staticmethod
    def of(soup: Soup, name: str) -> tuple[Surface, list[str]]:
        """Common corners of the triangles of a file, and what that has left out.

        Corners that differ by the last digits of their coordinates are one where that closes gaps.

        Raises:
            MeshError: It has no shape, or no thickness.
        """
        plain = Surface(
            soup.points, soup.triangles, soup.groups, soup.solids, soup.names, soup.solid_names
        )
        exact, left_out = plain.welded(0.0, name)
        if not exact.edges.is_closed or (heights(exact.corners) < FLAT).any():
            distance = DIGITS * float(np.abs(exact.points).max())
            near, more = plain.welded(distance, name)
            if near.wrong < exact.wrong:
                exact, left_out = near, more
        extent = np.ptp(exact.points, axis=0)
        if extent.min() <= _NO_THICKNESS * extent.max():
            raise MeshError(
                "the surface has no thickness", where=name, expected="the surface of a body"
            )
        notes = [f"{left_out} triangles without area left out"] if left_out else []
        return exact, [*soup.notes, *notes]

    def welded(self, distance: float, name: str) -> tuple[Surface, int]:
        """The same with near corners made one, and how many triangles lose their area by that."""
        try:
            points, triangles = weld(self.points, self.triangles, distance, self.solids)
        except CrowdedError:
            raise crowded(name) from None
        result = replace(self, points=points, triangles=triangles)
        sound = (triangles != np.roll(triangles, -1, axis=1)).all(axis=1)
        if not sound.any():
            raise MeshError("none of its triangles has an area", where=name, expected="a surface")
        return result.kept(sound), int((~sound).sum())

    def kept(self, rows: AnyArray) -> Surface:
        """The same with some of its triangles."""
        return replace(
            self,
            triangles=self.triangles[rows],
            groups=self.groups[rows],
            solids=self.solids[rows],
        )

    def with_triangles(self, triangles: IntArray, of: IntArray) -> Surface:
        """Other triangles, of which each has group and solid of one of these."""
        return replace(self, triangles=triangles, groups=self.groups[of], solids=self.solids[of])

    @cached_property
    def edges(self) -> Edges:
        """Of its triangles."""
        return Edges.of(self.triangles)

    @property
    def corners(self) -> FloatArray:
        """Shape (m, 3, 3)."""
        return self.points[self.triangles]

    @property
    def size(self) -> float:
        """Largest extent."""
        return float(np.ptp(self.points[np.unique(self.triangles)], axis=0).max())

    def middles(self, sides: IntArray) -> FloatArray:
        """Middles of sides of triangles, see `Edges`."""
        return (self.points[self.edges.starts[sides]] + self.points[self.edges.ends[sides]]) / 2

    @cached_property
    def doubled(self) -> IntArray:
        """Triangles whose corners another one before them has too."""
        first = np.unique(np.sort(self.triangles, axis=1), axis=0, return_index=True)[1]
        return np.setdiff1d(np.arange(len(self.triangles)), first)

    @cached_property
    def facing(self) -> IntArray:
        """Both of each two triangles with the same corners, the other way round."""
        _, of, count = np.unique(
            np.sort(self.triangles, axis=1), axis=0, return_inverse=True, return_counts=True
        )
        of = of.reshape(-1)
        a, b, c = self.triangles.T
        ahead = ((a < b).astype(int) + (b < c) + (c < a)) == 2  # as in ascending order
        return np.flatnonzero((count[of] == 2) & (np.bincount(of, ahead)[of] == 1))

    @property
    def wrong(self) -> int:
        """How many edges have not two triangles."""
        return int((self.edges.count != 2).sum())

    def without_doubled(self) -> Surface:
        """Each triangle once, or neither of two that face each other where two bodies touch."""
        every = np.arange(len(self.triangles))
        once = self.kept(np.setdiff1d(every, self.doubled))
        if not len(self.facing):
            return once
        apart = self.kept(np.setdiff1d(every, np.union1d(self.doubled, self.facing)))
        return apart if apart.wrong < once.wrong else once


def crowded(name: str) -> MeshError:
    """The error of a surface that has lost its shape by the digits of its coordinates."""
    return MeshError(
        "its corners coincide to the seven digits of their coordinates",
        where=name,
        expected="the origin near the surface",
    )


def find_faults(surface: Surface, *, all_of_them: bool = False) -> list[Fault]:
    """What is wrong with a surface, the first alone by default. Local.

    Whether triangles cross is asked of closed surfaces only.
    """
    result: list[Fault] = []
    for find in (_doubled, _crowded, _open, _turned, _crossing):
        if result and (not all_of_them or find is _crossing):
            continue
        result += find(surface)
    return result


def _doubled(surface: Surface) -> list[Fault]:
    rows = surface.doubled
    if not len(rows):
        return []
    what, remedy = (
        f"{counted(len(rows), 'triangle is', 'triangles are')} there twice",
        "leaves them out",
    )
    if set(rows) <= set(surface.facing):
        what = f"faces touch: {what}, the other way round"
        remedy = "makes one body of those that touch"
    return [Fault(what, remedy, surface.corners[rows].mean(axis=1))]


def _crowded(surface: Surface) -> list[Fault]:
    single = surface.kept(np.setdiff1d(np.arange(len(surface.triangles)), surface.doubled))
    sides = single.edges.crowded
    if not len(sides):
        return []
    what = f"more than two triangles meet in {counted(len(sides), 'edge', 'edges')}"
    return [Fault(what, "", single.middles(sides))]


def _open(surface: Surface) -> list[Fault]:
    sides = surface.edges.open
    if not len(sides):
        return []
    result = []
    on = on_edges(surface, ON_EDGE * surface.size)
    divided = np.unique([side for side, _ in on]).astype(np.int64)
    if len(divided):
        what = f"{counted(len(divided), 'edge is', 'edges are')} divided on one side only"
        result.append(Fault(what, "divides the other side", surface.middles(divided)))
    rest = np.setdiff1d(sides, divided)
    starts = set(surface.edges.starts[divided]) | set(surface.edges.ends[divided])
    inner = {corner for _, corners in on for corner in corners} | starts
    both = surface.edges.starts[rest], surface.edges.ends[rest]
    rest = rest[[not (a in inner and b in inner) for a, b in zip(*both, strict=True)]]
    if len(rest):
        what = f"the surface has a hole: {counted(len(rest), 'edge', 'edges')} with one triangle"
        result.append(Fault(what, "closes gaps and small holes", surface.middles(rest)))
    return result


def on_edges(surface: Surface, near: float) -> list[tuple[int, IntArray]]:
    """Sides with one triangle, and the corners of others that lie on them, in their order."""
    from scipy.spatial import cKDTree

    edges, points = surface.edges, surface.points
    sides = edges.open
    corners = np.unique(np.concatenate([edges.starts[sides], edges.ends[sides]]))
    if not len(corners):
        return []
    a, b = points[edges.starts[sides]], points[edges.ends[sides]]
    length = np.linalg.norm(b - a, axis=1)
    around = cKDTree(points[corners]).query_ball_point((a + b) / 2, length * 0.5001)
    result = []
    for k, found in enumerate(around):
        if len(found) < 3:  # both ends, and no more
            continue
        some = corners[np.array(found)]
        along = (points[some] - a[k]) @ (b[k] - a[k]) / length[k] ** 2
        off = np.linalg.norm(points[some] - a[k] - along[:, None] * (b[k] - a[k]), axis=1)
        on = (along * length[k] > near) & ((1 - along) * length[k] > near) & (off < near)
        if on.any():
            result.append((int(sides[k]), some[on][np.argsort(along[on])]))
    return result


def _turned(surface: Surface) -> list[Fault]:
    """Of shells that are wholly turned round nothing is said: they are turned."""
    try:
        shell, turned = oriented(surface.edges)
    except OneSidedError as error:
        place = surface.corners[error.triangle].mean(axis=0)[None]
        return [Fault("the surface has one side only", "", place)]
    few = minority(shell, turned)
    if not few.any():
        return []
    what = f"{counted(int(few.sum()), 'triangle is', 'triangles are')} turned round"
    return [Fault(what, "turns them as their neighbours", surface.corners[few].mean(axis=1))]


def minority(shell: IntArray, turned: AnyArray) -> AnyArray:
    """Triangles that go against most of their shell, see `oriented`."""
    many = 2 * np.bincount(shell, turned) > np.bincount(shell)
    return turned ^ many[shell]


def _crossing(surface: Surface) -> list[Fault]:
    if not surface.edges.is_closed:
        return []
    pairs = crossings(surface.points, surface.triangles)
    if not len(pairs):
        return []
    shell, _ = oriented(surface.edges)
    s, t = shell[pairs].T
    own = s == t
    if not own.any():
        places = surface.corners[pairs.reshape(-1)].mean(axis=1)
        return [Fault("two bodies run into each other or touch", "unites them", places)]
    places = surface.corners[pairs[own].reshape(-1)].mean(axis=1)
    return [Fault("the surface runs through itself or touches itself", "", places)]


def counted(count: int, one: str, many: str) -> str:
    """A number with its noun: "1 edge", "12 edges"."""
    return f"{count} {one if count == 1 else many}"


def turned_outwards(surface: Surface) -> Surface:
    """All triangles of a closed surface as their neighbours, each shell outwards. Local.

    Raises:
        OneSidedError: See there.
    """
    shell, turned = oriented(surface.edges)
    triangles = np.where(turned[:, None], surface.triangles[:, ::-1], surface.triangles)
    inward = volumes(surface.points[triangles], shell, int(shell.max()) + 1) < 0
    triangles = np.where(inward[shell][:, None], triangles[:, ::-1], triangles)
    return replace(surface, triangles=np.ascontiguousarray(triangles))
