"""`Barrier`: a surface that never passes through itself, by incremental potential contact.

Pairs of vertices, edges and faces that are closer than d^ repel each other with the potential

    kappa sum of w_k b(d_k),    b(d) = -(d - d^2)^2 ln(d/d^2),

d the square of their distance and w_k areas; it grows without bound as a distance goes to zero, and
every step of Newton's method ends before anything meets.  So no state has an intersection.
Friction is a smoothed law of Coulomb, with the pressures and directions of the state that was
accepted last: below the speed `slow` points that stick creep.

Quadratic faces count as flat ones through their nodes, four triangles or two edges each: forces
between these bodies are right, pressures are not (a uniform pressure has none at the vertices of a
quadratic triangle).

All ranks know the places of the whole surface and find the same pairs; each takes some of them.

Source: M. Li, Z. Ferguson, T. Schneider, T. Langlois, D. Zorin, D. Panozzo, C. Jiang & D. M.
Kaufman, ACM Trans. Graph. 39 (2020) 49; area weights: the same, Convergent Incremental Potential
Contact, arXiv 2307.15908 (2023).
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from operator import attrgetter
from types import ModuleType
from typing import Any

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cells_beside_facets,
    dofs_on_facets,
    prepare_facets,
)
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.self_contact import AnyContact, SelfContact
from dolfin_elastic.problem.context import FormContext
from dolfin_elastic.problem.material_regions import shear_modulus
from dolfin_elastic.problem.pose import Pose
from dolfin_elastic.problem.term import Blocks, Term

NEAR = 0.1
"""Distance at which surfaces begin to repel each other, over the median edge."""

PRESSED = 0.5
"""Pressure at half that distance, over three shear moduli, which are Young's modulus or a bit more.
A softer barrier is compressed to a small part of its distance, where it takes many iterations."""

SLOW = 1e-3
"""Speed up to which friction is smoothed, sizes of the surface a second: Li et al. (2020), 5.3."""

CLEAR = 0.9
"""Share of a step up to the first contact that is taken."""

SHORT = 0.1
"""Largest motion of a step of Newton's method, over d^, after which its tangent is exact."""

_FLAT = {2: ((0, 1),), 3: ((0, 1, 2),)}
_SPLIT = {2: ((0, 2), (2, 1)), 3: ((0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5))}
"""Nodes of the flat facets of a linear and of a quadratic facet, by the dimension of the body."""

_KINDS = {
    2: {"ev_candidates": (("edge_id", "vertex_id"), 1, 2)},
    3: {
        "fv_candidates": (("face_id", "vertex_id"), 1, 3),
        "ee_candidates": (("edge0_id", "edge1_id"), 2, 2),
    },
}
"""Pairs that may meet, by the dimension: names of their numbers, and vertices of both partners."""


_TRIAL = """
import sys
sys.path[:] = {path}
import ipctk, numpy
ipctk.CollisionMesh(numpy.eye(3), numpy.array([[0, 1], [1, 2], [2, 0]]), numpy.array([[0, 1, 2]]))
"""


@cache
def runs_here() -> bool:
    """Whether this processor has the instructions that ipctk was compiled for. Local.

    Its package of PyPI has some of AVX-512, at which other processors end the whole process: it is
    tried in another one.
    """
    # Of the current folder nothing is imported.
    path = [folder for folder in sys.path if os.path.isabs(folder)]
    trial = [sys.executable, "-I", "-c", _TRIAL.format(path=path)]
    return subprocess.run(trial, capture_output=True, check=False).returncode >= 0


def library() -> ModuleType:
    """ipctk, with one thread a rank. Local.

    Raises:
        InputError: It is not there, or was compiled for another processor.
    """
    try:
        import ipctk
    except ImportError as error:
        raise InputError(
            f"contact of a surface with itself needs the Python package ipctk ({error})",
            expected="pip install --require-hashes -r docker/python-packages.txt",
        ) from None
    if not runs_here():
        raise InputError(
            "contact of a surface with itself needs the Python package ipctk, which was compiled "
            "for another processor: this one does not know all of its instructions",
            expected="pip install --no-deps --no-binary ipctk ipctk==1.6.1, or another machine",
        )
    ipctk.set_num_threads(1)
    return ipctk


class CollisionSurface:
    """The flat facets of a surface, on all ranks. Collective to make.

    Args:
        facets: Local facets, owned by this rank.

    Attributes:
        nodes: Global nodes of the displacement, sorted, shape (n,).
        mesh: These at rest, their edges and faces, for ipctk.
        edge: Median length of an edge [m].
    """

    def __init__(self, context: FormContext, facets: IndexArray, ipctk: ModuleType) -> None:
        V, d = context.unknowns.V, context.body.dim
        self._body, self._ipctk, self._facets = context.body, ipctk, facets
        self._comm, self._dim, self._u = context.body.comm, d, context.unknowns.u
        index_map = V.dofmap.index_map
        local = dofs_on_facets(V, facets)
        parts = np.array((_FLAT if context.unknowns.degree == 1 else _SPLIT)[d])
        flat = index_map.local_to_global(local[:, parts].ravel()).reshape(-1, d)
        self._flat = flat.reshape(len(facets), -1, d)
        every = np.concatenate(self._comm.allgather(flat))
        self.nodes, corners = np.unique(every, return_inverse=True)
        corners = corners.reshape(-1, d)
        corners = corners[np.lexsort(corners.T)]
        first, last = index_map.local_range
        own = (self.nodes >= first) & (self.nodes < last)
        self._at = np.flatnonzero(own)
        self.own = (self.nodes[own] - first).astype(np.int32)
        self._counts = d * np.array(self._comm.allgather(len(self.own)))
        X = V.tabulate_dof_coordinates()[self.own, :d]
        rest = np.asfortranarray(self._of_ranks(X))
        faces = np.asfortranarray(corners.astype(np.int32))
        edges = np.asfortranarray(ipctk.edges(faces)) if d == 3 else faces
        self.mesh = ipctk.CollisionMesh(
            rest, edges, faces if d == 3 else np.zeros((0, 3), np.int32)
        )
        self.edge = float(np.median(np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)))
        self.rest = rest
        both = [(int(i), int(j)) for i, j in edges]
        self.adjacent = {*both, *((j, i) for i, j in both)}

    def _of_ranks(self, own: FloatArray) -> FloatArray:
        """Rows of the owned nodes of all ranks: in the order of `nodes`, for ranks follow."""
        result = np.empty((len(self.nodes), self._dim))
        self._comm.Allgatherv(np.ascontiguousarray(own), [result, self._counts])
        return result

    def gathered(self, field: FloatArray) -> FloatArray:
        """A vector field of the displacement's nodes at `nodes`, shape (n, dim). Collective.

        Args:
            field: Local array, at least the owned entries.
        """
        return self._of_ranks(field.reshape(-1, self._dim)[self.own])

    def places(self) -> FloatArray:
        """Present places, shape (n, dim) [m]. Collective."""
        return np.asfortranarray(self.rest + self.gathered(self._u.x.array))

    def meeting(self, places: FloatArray) -> str:
        """Where two facets intersect at the start, in words; empty: none do. Collective."""
        edges, faces = self.mesh.edges, self.mesh.faces
        facets = faces if self._dim == 3 else edges
        near = self._ipctk.LBVH()
        near.build(places, edges, faces)
        if self._dim == 3:
            meet = self._ipctk.is_edge_intersecting_triangle
            pairs = [(c.edge_id, c.face_id) for c in near.detect_edge_face_candidates()]
        else:
            meet = self._ipctk.segment_segment_intersect
            pairs = [(c.edge0_id, c.edge1_id) for c in near.detect_edge_edge_candidates()]
        for edge, facet in sorted(pairs):
            ends, corners = edges[edge], facets[facet]
            if np.isin(ends, corners).any() or not meet(*places[ends], *places[corners]):
                continue
            beside = facets[np.isin(facets, ends).sum(axis=1) == 2][0]
            parts = [self._described(one) for one in (beside, corners)]
            return f": faces {parts[0]} and {parts[1]} meet"
        return ""

    def _described(self, corners: IntArray) -> str:
        """Place of a flat facet and, where there are several, the name of its region. Collective.

        Args:
            corners: Indices into `nodes`, shape (dim,).
        """
        where = f"at {self._body.unit.point(self.rest[corners].mean(axis=0))}"
        mine = np.any(np.all(np.isin(self._flat, self.nodes[corners]), axis=2), axis=1)
        cells, _ = cells_beside_facets(self._body.mesh, self._facets[mine])
        here = [name for name, those in self._body.regions.items() if np.isin(cells, those).any()]
        names = sorted({name for part in self._comm.allgather(here) for name in part})
        if len(self._body.regions) < 2 or not names:
            return where
        return f"of '{names[0]}' {where}"

    def add(self, local: FloatArray, forces: FloatArray) -> None:
        """Adds the sum over ranks of forces at `nodes` to nodal forces. Collective.

        Args:
            local: This rank's share, shape (n * dim,) [N].
            forces: See `Term.add_forces`.
        """
        every = total(self._comm, np.ascontiguousarray(local)).reshape(-1, self._dim)
        forces.reshape(-1, self._dim)[self.own] += every[self._at]

    def blocks(self, matrix: Any, known: IntArray) -> tuple[IntArray, Blocks]:
        """A matrix of the places as blocks, of zeros too for pairs of nodes that had some. Local.

        Args:
            matrix: SciPy's, shape (n * dim, n * dim).
            known: Numbers of the pairs that had blocks, sorted.

        Returns:
            The numbers with those that are new, and the blocks.
        """
        n, d = len(self.nodes), self._dim
        parts = matrix.tobsr((d, d))
        first = np.repeat(np.arange(n, dtype=np.int64), np.diff(parts.indptr))
        here = first * n + parts.indices
        known = np.union1d(known, here)
        values = np.zeros((len(known), d, d))
        values[np.searchsorted(known, here)] = parts.data
        return known, Blocks(self.nodes[known // n], self.nodes[known % n], values)


class Barrier(Term):
    """A surface that cannot pass through itself. Collective to make.

    Args:
        index: From 0, among the contacts of the case.
        thickness: Of a plane body [m].

    Attributes:
        reach: d^, up to which two of its points repel each other [m].
        surface: Its flat facets.
    """

    linear, nodal, restrains, opens, account = False, True, True, True, "contact"
    bars = only_implicit = True

    def __init__(
        self, contact: SelfContact, context: FormContext, index: int, thickness: float
    ) -> None:
        body, ipctk = context.body, library()
        self.contact, self.label, self._index = contact, contact.label, index
        self._context = context
        self.comm, self._dim, self._ipctk = body.comm, body.dim, ipctk
        prepare_facets(body.mesh)
        if contact.all:
            facets = boundary_facets(body.mesh)
        else:
            parts = [body.owned_facets(name) for name in contact.surfaces]
            facets = np.unique(np.concatenate(parts)).astype(np.int32)
        self.surface = CollisionSurface(context, facets, ipctk)
        self.pose = Pose(context)
        self.reach = float(contact.distance or 0.0) or NEAR * self.surface.edge
        candidates = ipctk.Candidates()
        candidates.build(self.surface.mesh, self.surface.rest, self.reach)
        self._beside = {kind: self._neighbours(candidates, kind) for kind in _KINDS[body.dim]}
        unit = ipctk.BarrierPotential(self.reach, 1.0)
        modulus = 3 * min(shear_modulus(region.typical) for region in context.regions)
        pressure = abs(unit.force_magnitude((self.reach / 2) ** 2, 0.0))
        self.potential = ipctk.BarrierPotential(
            self.reach, thickness * PRESSED * modulus / pressure
        )
        self._pairs: IntArray = np.zeros(0, dtype=np.int64)
        self.projection = ipctk.PSDProjectionMethod.CLAMP
        self._now: tuple[FloatArray, Any] | None = None

    def _neighbours(self, candidates: Any, kind: str) -> set[tuple[int, int]]:
        """Candidates that are close at rest because they are beside each other. Local.

        A face of a sliver and the far vertex of its neighbour are: the elements between them, not
        the barrier, are what keeps them apart.
        """
        rest, adjacent = self.surface.rest, self.surface.adjacent
        ids, first, second = _KINDS[self._dim][kind]
        mesh, result = self.surface.mesh, set()
        for pair in getattr(candidates, kind):
            vertices = np.array(pair.vertex_ids(mesh.edges, mesh.faces))[: first + second]
            one, other = vertices[:first], vertices[first:]
            if pair.compute_distance(rest[vertices].ravel()) < self.reach**2 and any(
                (int(i), int(j)) in adjacent for i in one for j in other
            ):
                result.add(tuple(getattr(pair, name) for name in ids))
        return result

    # --- pairs ---

    def _share(self, candidates: Any) -> Any:
        """This rank's share of pairs that all ranks have found alike, without neighbours."""
        for kind, beside in self._beside.items():
            if self.comm.size == 1 and not beside:
                continue
            ids, every = _KINDS[self._dim][kind][0], getattr(candidates, kind)
            share = every[self.comm.rank :: self.comm.size]
            if beside:
                numbers = attrgetter(*ids)
                share = [pair for pair in share if numbers(pair) not in beside]
            setattr(candidates, kind, share)
        return candidates

    def pairs_at(self, places: FloatArray) -> Any:
        """This rank's share of the pairs that repel each other. Local."""
        ipctk, mesh = self._ipctk, self.surface.mesh
        candidates = ipctk.Candidates()
        candidates.build(mesh, places, self.reach)
        pairs = ipctk.NormalCollisions()
        pairs.use_area_weighting = True
        pairs.build(self._share(candidates), mesh, places, self.reach)
        return pairs

    def _present(self) -> tuple[FloatArray, Any]:
        """Places of the surface, and this rank's pairs. Collective."""
        places = self.surface.places()
        if self._now is None or not np.array_equal(places, self._now[0]):
            self._now = places, self.pairs_at(places)
        return self._now

    # --- forces ---

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`."""
        places, pairs = self._present()
        self.surface.add(-self.potential.gradient(pairs, self.surface.mesh, places), forces)

    def energy(self) -> float:
        """See `Term`."""
        places, pairs = self._present()
        return total(self.comm, float(self.potential(pairs, self.surface.mesh, places)))

    def blocks(self) -> Blocks:
        """See `Term`: far from the solution of each pair the part that is semidefinite."""
        places, pairs = self._present()
        matrix = self.potential.hessian(pairs, self.surface.mesh, places, self.projection)
        self._pairs, result = self.surface.blocks(matrix, self._pairs)
        return result

    def longest_step(self, motion: FloatArray) -> float:
        """See `Term`.  Once steps are short, the tangent is no longer made semidefinite."""
        ipctk, start, moved = self._ipctk, self.surface.places(), self.surface.gathered(motion)
        end, project = np.asfortranarray(start + moved), ipctk.PSDProjectionMethod
        near = np.abs(moved).max(initial=0.0) < SHORT * self.reach
        self.projection = project.NONE if near else project.CLAMP
        if not np.isfinite(end).all():
            return 1.0  # another reason will shorten it
        candidates = ipctk.Candidates()
        candidates.build(self.surface.mesh, start, end)
        share = self._share(candidates).compute_collision_free_stepsize(
            self.surface.mesh, start, end, narrow_phase_ccd=ipctk.AdditiveCCD()
        )
        share = smallest(self.comm, float(share))
        return 1.0 if share >= 1.0 else CLEAR * share

    def make_convex(self) -> bool:
        """See `Term`."""
        before, self.projection = self.projection, self._ipctk.PSDProjectionMethod.CLAMP
        return bool(before != self.projection)

    def make_exact(self) -> None:
        """See `Term`."""
        self.projection = self._ipctk.PSDProjectionMethod.NONE

    # --- a run ---

    def check_start(self) -> str:
        """See `Term`: nothing intersects at the start."""
        places = self.surface.places()
        if self._ipctk.has_intersections(self.surface.mesh, places):
            raise InputError(
                f"'{self.label}' passes through itself at the start{self.surface.meeting(places)}",
                where=f"contact[{self._index}]",
                expected="bodies that are apart: no two faces that meet but at common nodes",
            )
        near = total(self.comm, len(self.pairs_at(places)))
        if not near:
            return ""
        return (
            f"at the start {near} pairs of vertices, edges and faces of '{self.label}' are closer "
            f"than {self._context.body.unit.length(self.reach)} and push each other apart: a "
            "smaller distance leaves them"
        )

    def commit(self) -> None:
        """See `Term`: pairs that were near long ago leave the tangent's pattern."""
        self._pairs = np.zeros(0, dtype=np.int64)
        self.make_convex()

    def advance(self) -> None:
        """See `Term`: as at an equilibrium."""
        self.commit()

    def rollback(self) -> None:
        """See `Term`."""
        self.make_convex()

    def add_results(self, result: dict[str, float], forces: FloatArray) -> None:
        """See `Term`: smallest distance [m], at most that at which forces begin."""
        (places, pairs), least = self._present(), self.reach
        if len(pairs):
            least = float(np.sqrt(pairs.compute_minimum_distance(self.surface.mesh, places)))
        result[f"smallest_distance_{self.label}"] = smallest(self.comm, least)


class SmoothFriction(Term):
    """Friction of a surface that touches itself. Collective to make.

    Args:
        index: From 0, among the contacts of the case.
    """

    linear, nodal, restrains, account = False, True, True, ""
    follows_path = dissipates = True

    def __init__(self, barrier: Barrier, context: FormContext, index: int) -> None:
        self._barrier, self.label, self.pose = barrier, barrier.label, barrier.pose
        self._surface, self._ipctk, self._dim = barrier.surface, library(), context.body.dim
        V, self._index = context.unknowns.V, index
        self._start, self._last = fem.Function(V), fem.Function(V)  # forces of the last step [N]
        self._u = context.unknowns.u
        self.memory = {
            f"friction_start_{index}": self._start,
            f"friction_last_{index}": self._last,
        }
        diagonal = np.linalg.norm(np.ptp(self._surface.rest, axis=0))
        self._slow = barrier.contact.slow or SLOW * float(diagonal)
        self._t = self._from = 0.0
        self._sliding: tuple[FloatArray, FloatArray, Any] | None = None
        self._pairs: IntArray = np.zeros(0, dtype=np.int64)

    def without_rest(self) -> InputError:
        """See `Term`: it is smoothed by a speed."""
        return InputError(
            "friction of a surface with itself is computed in motion only",
            where=f"contact[{self._index}].friction",
            expected="0, or [dynamics], with damping if only its end is wanted; or `between`",
        )

    def set_time(self, t: float, default: Amplitude) -> None:
        """See `Term`."""
        self._t = t

    def begin(self, *, moving: bool) -> None:
        """See `Term`."""
        self._last.x.array[:] = 0.0
        self._start.x.array[:] = self._u.x.array

    def go_on(self) -> None:
        """See `Term`."""
        self._from = self._t
        self._pairs = np.zeros(0, dtype=np.int64)

    def advance(self) -> None:
        """See `Term`: pressures and directions are those of now."""
        forces = np.zeros(len(self._u.x.array))
        self.add_forces(forces)
        self._last.x.array[:] = forces
        self._start.x.array[:] = self._u.x.array
        self.go_on()

    def _present(self) -> tuple[Any, Any, FloatArray]:
        """The potential, this rank's pairs and the motion since the last step. Collective."""
        first = self._surface.gathered(self._start.x.array)
        if self._sliding is None or not np.array_equal(first, self._sliding[0]):
            places = np.asfortranarray(self._surface.rest + first)
            pairs = self._ipctk.TangentialCollisions()
            normal = self._barrier.pairs_at(places)
            if len(normal):
                args = normal, self._barrier.potential, self._barrier.contact.friction
                pairs.build(self._surface.mesh, places, *args)
            self._sliding = first, places, pairs
        _, places, pairs = self._sliding
        motion = np.asfortranarray(self._surface.places() - places)
        if not len(pairs) or self._t <= self._from:
            return None, pairs, motion
        return self._ipctk.FrictionPotential(self._slow * (self._t - self._from)), pairs, motion

    def add_forces(self, forces: FloatArray) -> None:
        """See `Term`: where a step begins those at the end of the one before."""
        if self._t <= self._from:
            own, rows = self._surface.own, self._last.x.array.reshape(-1, self._dim)
            forces.reshape(-1, self._dim)[own] += rows[own]
            return
        potential, pairs, motion = self._present()
        gradient = np.zeros(motion.size)
        if potential is not None:
            gradient = potential.gradient(pairs, self._surface.mesh, motion)
        self._surface.add(-gradient, forces)

    def blocks(self) -> Blocks:
        """See `Term`."""
        from scipy.sparse import csc_array

        potential, pairs, motion = self._present()
        matrix = csc_array((motion.size, motion.size))
        if potential is not None:
            how = self._barrier.projection
            matrix = potential.hessian(pairs, self._surface.mesh, motion, how)
        self._pairs, result = self._surface.blocks(matrix, self._pairs)
        return result


def make_barriers(
    contacts: Sequence[AnyContact], context: FormContext, thickness: float
) -> Iterator[Term]:
    """Those of the contacts of surfaces with themselves, each followed by its friction. Collective.

    Args:
        thickness: Of a plane body [m].
    """
    for index, contact in enumerate(contacts):
        if isinstance(contact, SelfContact):
            barrier = Barrier(contact, context, index, thickness)
            yield barrier
            if contact.friction > 0.0:
                yield SmoothFriction(barrier, context, index)
