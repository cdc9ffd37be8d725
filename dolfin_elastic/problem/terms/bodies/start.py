"""`StartOffsets`: what counts as no gap of two surfaces that do not touch exactly at the start.

With the mean gap g0 of a vertex on the undeformed meshes, pressures follow g - o, and

    o = g0 where |g0| is at most `adjust`, else (1 - s) min(g0, 0);   o + s d with a length d,

s the amplitude: an overlap grows out of a state without stress, or a given one acts in its place.
Offsets depend on the meshes and the time alone, so a run that goes on has the same ones.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem, geometry

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.contact import Contact
from dolfin_elastic.problem.constraints.ties.segments import GAP
from dolfin_elastic.problem.terms.bodies.functions import PieceFunctions

DEEP, MARGIN = 4.0, 1.2
"""Distance up to which overlaps are looked for, over the longest edge; and how much farther than
the deepest of them the other side is looked for during the run."""

OUTSIDE = 1e-3
"""Way out of a face over the longest edge, after which a point is no more in the body behind it."""


class StartOffsets:
    """Offsets of the gaps of one contact between bodies.

    Attributes:
        field: The present offsets at vertices [m].
        fading: Of these, overlaps that do not act yet.
    """

    def __init__(self, contact: Contact, S: fem.FunctionSpace) -> None:
        self._contact = contact
        self.field, self.fading, self._fixed, self._overlap = (fem.Function(S) for _ in range(4))
        self._share = 0.0

    def take(self, nodes: IndexArray, gaps: FloatArray, edge: float) -> None:
        """Takes the mean gaps of the undeformed bodies. Collective.

        Args:
            nodes: Owned vertices.
            gaps: Theirs [m]; infinite or huge where nothing lies opposite.
            edge: Longest edge of the faces [m].
        """
        given = not isinstance(self._contact.interference, str)
        near = (1 + 1e-9) * (self._contact.adjust or (GAP * edge if given else 0.0))
        counts, overlaps = np.abs(gaps) <= near, gaps < -near
        self._fixed.x.array[nodes] = np.where(counts, gaps, 0.0)
        self._overlap.x.array[nodes] = np.where(overlaps, gaps, 0.0)
        self._counts, self._overlaps = counts & (near > 0.0), overlaps
        for one in (self._fixed, self._overlap):
            one.x.scatter_forward()

    def set_time(self, t: float, default: Amplitude) -> None:
        """Evaluates the offsets. Not collective.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the contact has no curve.
        """
        share, added = self._contact.overlap_at(t, default)
        self._share = share
        self.fading.x.array[:] = (1 - share) * self._overlap.x.array
        self.field.x.array[:] = self._fixed.x.array + self.fading.x.array + added

    def slopes(self) -> FloatArray:
        """Derivatives of the present offsets by the mean gaps that were taken, shape (n,)."""
        return np.where(self._counts, 1.0, (1 - self._share) * self._overlaps)


def overlap_reach(pieces: PieceFunctions, body: Body) -> float:
    """Distance at which both sides are compared [m]: more where they overlap deeply. Collective.

    A face whose only opposite ones are farther than an edge overlaps where it lies within a body;
    else these face it through the bodies, as the far sides of two plates.
    """
    edge = pieces.reach
    near, _, found, gaps = pieces.signed_within(DEEP * edge)
    shallowest = np.full(len(near.x), np.inf)
    np.minimum.at(shallowest, found.near, found.gaps)
    deep = (gaps < 0.0) & (found.gaps > edge) & (found.gaps <= shallowest[found.near])
    if not total(body.comm, float(np.sum(deep))):
        return edge
    x = near.x[found.near[deep], : body.dim]
    normals = np.stack([x[:, 1, 1] - x[:, 0, 1], x[:, 0, 0] - x[:, 1, 0]], axis=1)
    if body.dim == 3:
        normals = np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]))
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    inside = _inside(body, x.mean(axis=1) + OUTSIDE * edge * normals)
    depth = largest(body.comm, float(np.max(found.gaps[deep][inside], initial=0.0)))
    return max(edge, MARGIN * depth)


def _inside(body: Body, points: FloatArray) -> BoolArray:
    """Which of this rank's points lie in an element of any rank. Collective."""
    mesh, comm = body.mesh, body.comm
    parts = comm.allgather(points)
    every = np.zeros((sum(map(len, parts)), 3))
    every[:, : body.dim] = np.concatenate(parts)
    tree = geometry.bb_tree(mesh, body.dim)
    boxes = geometry.compute_collisions_points(tree, every)
    cells = geometry.compute_colliding_cells(mesh, boxes, every)
    hits = total(comm, np.diff(cells.offsets).astype(float)) > 0
    first = sum(map(len, parts[: comm.rank]))
    return np.asarray(hits[first : first + len(points)])
