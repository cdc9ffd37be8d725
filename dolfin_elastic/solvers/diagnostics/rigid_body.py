"""Rigid motions that no support prevents: with one, no equilibrium is unique.

Supports constrain nodes in directions; applied to translations and small rotations of a body these
directions are rows of numbers, whose products sum up to one small matrix a body.  Its null space is
what is left free.

A rigid surface constrains its nodes only as far as it is constrained itself: A m - G q = 0 for a
body's motion m and the surface's free degrees of freedom q.  The null space of all such equations,
restricted to a body, is what that body can do.  Contact between bodies holds them by each other.

Before it touches, a body that nothing but contact holds has no equilibrium.  As a rigid one it
moves along its loads, without any force between, until a vertex meets another surface; then along
what that leaves free.  This is where the first step starts, and nothing else: no spring, no damping
is left in the equilibrium.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.connectivity import ConnectedBodies
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.rigid_body_names import motions_in_words
from dolfin_elastic.solvers.linear.ksp import null_combinations

log = logging.getLogger("dolfin_elastic")

FREE = 1e-10
"""Stiffness against a rigid motion, over that of the diagonal, which counts as none."""

MANY = 50
"""Number of parts above which none is checked: so many are fragments of a broken mesh, and each
costs six products with the tangent.  Nor is it looked at then how bodies hold each other."""

TIMES = 1.0, 0.5, 0.1
"""Load factors whose loads say where bodies go: the first at which there are any."""

MEETINGS = 10
"""Motions up to the next meeting, for each body."""

SHOWN = 5
"""Bodies that one message names."""

SLOW = 1e-9
"""Speed over that of the fastest body, and power over the sizes of all loads, that are none."""


@dataclass(frozen=True)
class LoosePart:
    """A part that can move as a rigid body.

    Attributes:
        motions: In words, for example "move along x".
        place: Its middle in the reference configuration [m].
        name: Materials or regions it is made of.
        whole: It is the whole body.
    """

    motions: tuple[str, ...]
    place: tuple[float, ...]
    name: str
    whole: bool


def find_loose_part(assembler: Assembler) -> LoosePart | None:
    """A part that can move rigidly without stiffness of the assembled tangent. Collective."""
    problem = assembler.problem
    if problem.cell is not None:  # its neighbours hold it
        return None
    bodies = ConnectedBodies(problem)
    if bodies.count > MANY:
        return None
    for k in range(bodies.count):
        inside = bodies.of_node == k
        if (part := _motions(assembler, inside)) is not None:
            words, place = part
            return LoosePart(tuple(words), place, _name(problem, inside), bodies.count == 1)
    return None


def pulled_off_obstacles(assembler: Assembler) -> bool:
    """The loads on some body point away from what is near it and might stop it. Collective.

    Their resultant is compared with the sum of their sizes: loads that cancel pull nowhere.
    """
    problem, dim = assembler.problem, assembler.problem.body.dim
    if not problem.terms.opens:
        return False
    bodies = ConnectedBodies(problem)
    forces = assembler.reactions.loads()[assembler.displacement_dofs].reshape(-1, dim)
    local = np.zeros((bodies.count, 2, dim))
    for term in problem.terms:
        for nodes, directions in term.held(near=True) if term.opens else ():
            np.add.at(local[:, 0], bodies.of_node[nodes], directions)
    np.add.at(local[:, 1], bodies.of_node[: len(forces)], forces)
    normals, loads = total(problem.body.comm, local).swapaxes(0, 1)
    size = total(problem.body.comm, float(np.abs(forces).sum()))
    away = np.sum(normals * loads, axis=1)
    return bool(np.any(away > 1e-6 * np.linalg.norm(normals, axis=1) * size))


def _motions(assembler: Assembler, inside: BoolArray) -> tuple[list[str], tuple[float, ...]] | None:
    """Rigid motions of a part against which the tangent has no stiffness. Collective.

    Args:
        inside: Local nodes of the part, ghosts included.

    Returns:
        The motions in words, and the middle of the part [m]; None if there are none.
    """
    problem, comm = assembler.problem, assembler.comm
    dim, own = problem.body.dim, problem.V.dofmap.index_map.size_local
    inside = inside[:own]
    x = problem.places[:own, :dim]
    now = x + problem.u.x.array[: own * dim].reshape(-1, dim)
    local = total(comm, np.array([inside.sum(), *x[inside].sum(axis=0), *now[inside].sum(axis=0)]))
    centre = local[1 + dim :] / local[0]
    radius = largest(comm, float(np.max(np.linalg.norm(now[inside] - centre, axis=1), initial=0.0)))
    modes = rigid_motions((now - centre) / (radius or 1.0)) * inside[:, None, None]
    if problem.geometry == "axisymmetric":
        modes = modes[:, :, 1:2]
    columns = np.zeros((assembler.size, modes.shape[-1]))
    columns[assembler.displacement_dofs] = modes.reshape(own * dim, modes.shape[-1])
    columns /= np.sqrt(total(comm, (columns**2).sum(axis=0)))
    null = null_combinations(assembler, columns, FREE)
    if not null.shape[1]:
        return None
    place = tuple(float(c) for c in local[1 : 1 + dim] / local[0])
    if problem.geometry == "axisymmetric":
        return ["move along y"], place
    return motions_in_words(null, centre, radius, problem.body.unit), place


def _name(problem: Problem, inside: BoolArray) -> str:
    """The named regions, or else the materials, of cells inside. Collective."""
    nodes, body = problem.V.dofmap.list, problem.body
    regions = {name: body.owned_cells(name) for name in sorted(body.regions)}
    materials = {part.name: part.cells for part in problem.regions}
    for groups, kind in ((regions, "region"), (materials, "material")):
        hit = []
        for name, cells in groups.items():
            within = inside[nodes[cells]].all(axis=1)
            some, all_ = total(body.comm, np.array([within.sum(), len(within)]))
            if some and some == all_:
                hit.append(name)
        if hit:
            return f"{kind}{'s' if len(hit) > 1 else ''} '{', '.join(hit)}'"
    return ""


_SAME = 1e-6
"""Share of a motion that is round-off."""

_ROUND_OFF = 1e-10
"""Share of the largest eigenvalue of a matrix of products below which one counts as zero."""

LOOSE = "float about"
"""What a body in a periodic cell can do that is connected to no other."""


@dataclass(frozen=True)
class Constraints:
    """Directions in which this rank's nodes are constrained.

    Attributes:
        nodes: Owned node of each direction, shape (rows,).
        directions: Unit vectors, shape (rows, dim).
    """

    nodes: IndexArray
    directions: FloatArray


@dataclass(frozen=True)
class FreeBody:
    """A connected body and its rigid motions that nothing prevents.

    Attributes:
        name: Of the regions it is made of; empty if it is the only body.
        motions: In words; none: it is constrained.
    """

    name: str
    motions: tuple[str, ...]


@stage("checks")
def check_no_rigid_motion(problem: Problem, *, stay: bool = False) -> None:
    """Supports must prevent every rigid motion of each connected body in equilibrium. Collective.

    Bodies that only contact holds are moved to where they touch.

    Args:
        stay: The displacement is that from before in the end.

    Raises:
        InputError: They do not.
    """
    problem.check_start(default=PROPORTIONAL)
    bodies = free_bodies(problem)
    free = [body for body in bodies if body.motions]
    if not free or (problem.terms.opens and bring_together(problem, stay=stay)):
        return
    if problem.cell is not None:
        text = ", ".join(f"`{body.name}`" for body in free[:SHOWN])
        raise InputError(
            f"{text} can {LOOSE}: the cell has {len(bodies)} bodies that share no nodes, not even "
            "across its faces",
            where="periodic",
            expected="a cell that hangs together; a soft filling binds what lies in a hole",
        )
    if problem.terms.opens:
        _check_obstacles_ahead(problem, free)
    what = "the supports leave the body free" if problem.supports else "there is no support"
    text = f"as a rigid body it can {', '.join(free[0].motions)}"
    if len(bodies) > 1:
        what = "the supports leave bodies free" if problem.supports else what
        text = "; ".join(f"`{b.name}` can {', '.join(b.motions)}" for b in free[:SHOWN])
        more = f" and {len(free) - SHOWN} more bodies" if len(free) > SHOWN else ""
        text = f"of {len(bodies)} bodies that share no nodes, {text}{more}"
    away, unit = _open_contacts(problem), problem.body.unit
    for label, gap in away.items():
        far = f"open by {unit.length(gap)}" if gap < np.inf else "open: nothing lies opposite"
        text += f"; contact '{label}' is {far}"
    raise InputError(
        f"{what}: {text}",
        where="support",
        expected="equilibrium needs supports that hold "
        f"{'each body' if len(bodies) > 1 else 'it'}"
        f"{', or loads that close the contact' if away else ''}; [dynamics] does not",
    )


def _open_contacts(problem: Problem) -> dict[str, float]:
    """Contacts that do not touch, and how far away they are [m]. Collective."""
    return {term.label: gap for term in problem.terms if (gap := term.distance())}


def _check_obstacles_ahead(problem: Problem, free: list[FreeBody]) -> None:
    """Obstacles that would hold the body once they touched are named. Collective.

    Raises:
        InputError: Obstacles would hold them, with how far away they are.
    """
    with problem.terms.assumed(closed=True):
        if free_motions(problem):
            return
    text = ", ".join(
        f"'{label}' is {problem.body.unit.length(gap)} away"
        for label, gap in _open_contacts(problem).items()
    )
    raise InputError(
        f"no obstacle holds the body yet ({text or 'they touch elsewhere'}): as a rigid body it "
        f"can {', '.join(free[0].motions)}",
        where="contact",
        expected="equilibrium needs supports that hold it, or an obstacle that touches from the "
        "start; [dynamics] does not",
    )


def free_motions(problem: Problem) -> list[str]:
    """Rigid motions of any body that no support prevents, in words. Collective."""
    bodies = free_bodies(problem)
    return list(dict.fromkeys(motion for body in bodies for motion in body.motions))


def free_bodies(problem: Problem, *, rubbing: bool = True) -> list[FreeBody]:
    """All connected bodies, each with the rigid motions that no support prevents. Collective.

    Args:
        rubbing: Points with friction count as if they stuck; else as if they slid freely.
    """
    if problem.cell is not None:
        return _parts_of_cell(problem, ConnectedBodies(problem))
    f = rigid_freedom(problem, rubbing=rubbing)
    return [
        FreeBody(name, tuple(_in_words(problem, null, centre, float(size))))
        for name, null, centre, size in zip(
            f.bodies.names(), f.nulls, f.centres, f.sizes, strict=True
        )
    ]


@dataclass(frozen=True)
class Freedom:
    """Rigid motions of connected bodies that nothing prevents.

    Attributes:
        bodies: All of them.
        nulls: Orthonormal free motions of each body, about its centre and by its size.
        centres: Middles of their bounding boxes, shape (bodies, dim) [m].
        sizes: Of these boxes [m].
        kinds: Motions that the problem's geometry has, of those of `rigid_motions`.
        joint: Bodies whose motions depend on each other, and the orthonormal free motions of all of
            them together; None: there are none.
    """

    bodies: ConnectedBodies
    nulls: list[FloatArray]
    centres: FloatArray
    sizes: FloatArray
    kinds: slice
    joint: tuple[IntArray, FloatArray] | None = None

    def along(self, powers: FloatArray) -> FloatArray:
        """Free motions along which the powers of unit motions are largest, (bodies, motions).

        Args:
            powers: Shape (bodies, motions) [W].
        """
        result = np.array([n @ (n.T @ p) for n, p in zip(self.nulls, powers, strict=True)])
        if self.joint is not None:
            which, null = self.joint
            rows = null[: powers[which].size]
            result[which] = (rows @ (rows.T @ powers[which].ravel())).reshape(len(which), -1)
        return result

    def motions(self, k: int, nodes: IndexArray) -> FloatArray:
        """Displacement of nodes under the free motions of body k, shape (nodes, dim, motions)."""
        return np.asarray(self.at(nodes) @ self.nulls[k])

    def at(self, nodes: IndexArray | slice) -> FloatArray:
        """Displacement of nodes under all unit motions of their bodies, (nodes, dim, motions)."""
        return _unit_motions(self.bodies, self.centres, self.sizes, self.kinds, nodes)


def _unit_motions(
    bodies: ConnectedBodies,
    centres: FloatArray,
    sizes: FloatArray,
    kinds: slice,
    nodes: IndexArray | slice,
) -> FloatArray:
    """See `Freedom.at`."""
    of = bodies.of_node[nodes]
    return rigid_motions((bodies.places[nodes] - centres[of]) / sizes[of, None])[:, :, kinds]


def rigid_freedom(problem: Problem, *, rubbing: bool = True) -> Freedom:
    """Rigid motions of all bodies, which are none of a periodic cell. Collective.

    Args:
        rubbing: See `free_bodies`.
    """
    bodies = ConnectedBodies(problem)
    centres, sizes = _bounding_boxes(bodies)
    few = bodies.count <= MANY
    directions = constrained_directions(problem, rubbing=rubbing, joined=not few)
    kinds = slice(1, 2) if problem.geometry == "axisymmetric" else slice(None)
    motions_at = partial(_unit_motions, bodies, centres, sizes, kinds)
    sums = _constraint_products(bodies, directions, motions_at)
    nulls, joint = [_null_space(matrix) for matrix in sums], None
    between = _between_bodies(problem, bodies, motions_at, rubbing=rubbing) if few else None
    if between is not None or any(len(one.free) for one in problem.constraints.rigid_motions):
        which, matrix = _coupled_products(problem, bodies, sums, motions_at, sizes, between)
        joint = which, _null_space(matrix)
        for k, body in enumerate(which):
            nulls[body] = _restricted(joint[1], k, sums.shape[1])
    return Freedom(bodies, nulls, centres, sizes, kinds, joint)


def _between_bodies(
    problem: Problem,
    bodies: ConnectedBodies,
    motions_at: Callable[[IndexArray], FloatArray],
    *,
    rubbing: bool,
) -> FloatArray | None:
    """Products of the motions of all bodies by what bodies hold of each other. Collective.

    None: nothing.
    """
    every = [term for term in problem.terms if term.joins and (rubbing or not term.dissipates)]
    if not every or bodies.count == 1:
        return None
    motions = motions_at(np.arange(len(bodies.of_node), dtype=np.int32))
    fields = [
        (np.where((bodies.of_node == k)[:, None], motions[:, :, m], 0.0)).ravel()
        for k in range(bodies.count)
        for m in range(motions.shape[2])
    ]
    rows = np.concatenate([term.partings(fields) for term in every])
    return np.asarray(total(bodies.comm, rows.T @ rows))


def _parts_of_cell(problem: Problem, bodies: ConnectedBodies) -> list[FreeBody]:
    """Of a periodic cell all that is connected to its fixed vertex is constrained. Collective."""
    nodes = problem.unknowns.merged_dofs(problem.constraints.dofs) // problem.body.dim
    marks = np.bincount(bodies.of_node[nodes], minlength=bodies.count)
    fixed = total(bodies.comm, marks) > 0
    return [
        FreeBody(name, () if one else (LOOSE,))
        for name, one in zip(bodies.names(), fixed, strict=True)
    ]


def constrained_directions(
    problem: Problem, *, rubbing: bool = True, joined: bool = False
) -> Constraints:
    """Directions in which this rank's nodes are constrained. Collective.

    Prescribed components and directions, and what terms hold: springs, and obstacles that touch.

    Args:
        rubbing: See `free_bodies`.
        joined: What bodies hold of each other counts, as if the other one stood still.
    """
    dim, prescribed = problem.body.dim, problem.constraints
    held = prescribed.prescribed_dofs
    rows = [Constraints((held // dim).astype(np.int32), np.eye(dim)[held % dim])]
    if prescribed.skewed:
        nodes = np.repeat(prescribed.skew_dofs[:, 0] // dim, dim)
        rows.append(Constraints(nodes, prescribed.P.reshape(-1, dim)))
    terms = [term for term in problem.terms if rubbing or not term.dissipates]
    rows += [Constraints(*one) for term in terms if joined or not term.joins for one in term.held()]
    return Constraints(
        np.concatenate([row.nodes for row in rows]).astype(np.int32),
        np.concatenate([row.directions for row in rows]),
    )


def _bounding_boxes(bodies: ConnectedBodies) -> tuple[FloatArray, FloatArray]:
    """Middle, shape (bodies, dim), and size of each body's bounding box. Collective."""
    x, of = bodies.places, bodies.of_node
    corners = np.full((bodies.count, 2 * x.shape[1]), -np.inf)
    np.maximum.at(corners, of, np.concatenate([x, -x], axis=1))
    bodies.comm.Allreduce(MPI.IN_PLACE, corners, op=MPI.MAX)
    high, low = np.split(corners, 2, axis=1)
    return (high - low) / 2, np.max(high + low, axis=1)


def _constraint_products(
    bodies: ConnectedBodies,
    constraints: Constraints,
    motions_at: Callable[[IndexArray], FloatArray],
) -> FloatArray:
    """The sum of products of constraints on rigid motions, for each body. Collective.

    Args:
        constraints: Of this rank's nodes.
        motions_at: See `_coupled_products`.

    Returns:
        Shape (bodies, motions, motions).
    """
    of, motions = bodies.of_node[constraints.nodes], motions_at(constraints.nodes)
    rows = np.einsum("rc,rcm->rm", constraints.directions, motions)
    sums = np.zeros((bodies.count, rows.shape[1], rows.shape[1]))
    np.add.at(sums, of, rows[:, :, None] * rows[:, None, :])
    return np.asarray(total(bodies.comm, sums))


def _null_space(matrix: FloatArray) -> FloatArray:
    """Orthonormal null space of a matrix of products."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors[:, values <= _ROUND_OFF * max(values[-1], 1.0)])


def _in_words(problem: Problem, null: FloatArray, centre: FloatArray, size: float) -> list[str]:
    if not null.shape[1]:
        return []
    if problem.geometry == "axisymmetric":
        return ["move along y"] * null.shape[1]
    return motions_in_words(null, centre, size, problem.body.unit)


def planes(dim: int) -> list[tuple[int, int]]:
    """The plane of each rotation: about x, y, z; in a plane about z."""
    return [(1, 2), (2, 0), (0, 1)] if dim == 3 else [(0, 1)]


def rigid_motions(x: FloatArray) -> FloatArray:
    """Displacement of points under unit rigid motions.

    Args:
        x: Places [m], shape (points, dim).

    Returns:
        Translations, then rotations about the origin, shape (points, component, motion).
    """
    points, dim = x.shape
    turns = planes(dim)
    moved = np.zeros((points, dim, dim + len(turns)))
    moved[:, range(dim), range(dim)] = 1.0
    for k, (i, j) in enumerate(turns, start=dim):
        moved[:, i, k], moved[:, j, k] = -x[:, j], x[:, i]
    return moved


def _coupled_products(
    problem: Problem,
    bodies: ConnectedBodies,
    products: FloatArray,
    motions_at: Callable[[IndexArray], FloatArray],
    sizes: FloatArray,
    between: FloatArray | None,
) -> tuple[IntArray, FloatArray]:
    """The joint matrix of all bodies that have rigid surfaces with free motion. Collective.

    Of all bodies where some hold each other.

    Args:
        products: Matrix of each body, as if the surfaces were fixed, shape (bodies, n, n).
        motions_at: From nodes to their displacement under unit motions of their body, shape
            (nodes, dim, n).
        sizes: Length by which the places of each body are divided [m].
        between: See `_between_bodies`.

    Returns:
        Numbers of these bodies, and the matrix of their motions and then those of the surfaces.
    """
    dim, n, comm = problem.body.dim, products.shape[1], problem.body.comm
    surfaces = [motion for motion in problem.constraints.rigid_motions if len(motion.free)]
    count = sum(len(motion.free) for motion in surfaces)
    mixed, own = np.zeros((bodies.count, n, count)), np.zeros((count, count))
    touched, first = np.full(bodies.count, int(between is not None)), 0
    last = len(problem.constraints.values.x.array)
    owned = np.zeros(last, dtype=bool)
    owned[problem.constraints.prescribed_dofs] = True
    for motion in surfaces:
        dofs, D = problem.constraints.motion_directions(motion)
        dofs, D = dofs[owned[dofs]], D[owned[dofs]]
        scale = np.where(np.arange(D.shape[1]) < dim, 1.0, 1 / float(sizes.max()))
        G = (D * scale)[:, list(motion.free)]
        here = slice(first, first + len(motion.free))
        A = motions_at((dofs // dim).astype(np.int32))[np.arange(len(dofs)), dofs % dim]
        of = bodies.of_node[dofs // dim]
        np.add.at(mixed[:, :, here], of, A[:, :, None] * G[:, None, :])
        own[here, here] += G.T @ G
        touched[of] = 1
        first = here.stop
    mixed, own, touched = total(comm, mixed), total(comm, own), total(comm, touched)
    which = np.flatnonzero(touched)
    size = len(which) * n
    joint = np.zeros((size + count, size + count))
    for k, body in enumerate(which):
        rows = slice(k * n, (k + 1) * n)
        joint[rows, rows] = products[body]
        joint[rows, size:] = -mixed[body]
        joint[size:, rows] = -mixed[body].T
    joint[size:, size:] = own
    if between is not None:
        joint[:size, :size] += between
    return which, joint


def _restricted(null: FloatArray, k: int, n: int) -> FloatArray:
    """Orthonormal motions of one body in a null space of the joint matrix.

    Args:
        k: Number of the body among those with rigid surfaces.
    """
    left, sizes, _ = np.linalg.svd(null[k * n : (k + 1) * n], full_matrices=False)
    return np.asarray(left[:, sizes > _SAME])


# --- bodies that only contact holds ---


def bring_together(problem: Problem, *, stay: bool = False) -> bool:
    """Moves free bodies until they touch each other. Collective.

    The displacement is put back if that leads nowhere.

    Args:
        stay: It is put back where that ends, too.

    Returns:
        Whether none is free any more.
    """
    meeting = [term for term in problem.terms if term.joins]
    if not meeting or problem.cell is not None or (loads := _loads(problem)) is None:
        return False
    u, freedom = problem.u.x.array, rigid_freedom(problem)
    start = u.copy()
    for _ in range(MEETINGS * freedom.bodies.count):
        motion = _fall(problem, freedom, loads)
        share = np.inf if motion is None else min(term.way_to_meet(motion) for term in meeting)
        if motion is None or not np.isfinite(share):
            break
        u += share * motion
        freedom = rigid_freedom(problem)
    found = not any(null.shape[1] for null in freedom.nulls)
    if found:
        far = largest(problem.body.comm, float(np.max(np.abs(u - start), initial=0.0)))
        log.info(
            "bodies that only contact holds begin where they touch, up to %s from where they are",
            problem.body.unit.length(far),
        )
    if stay or not found:
        u[:] = start
    problem.unknowns.u_to_w()
    return found


def _loads(problem: Problem) -> FloatArray | None:
    """Nodal forces of the loads at owned nodes, (nodes, dim) [N]; None: there are none. Collective.

    Of the first of `TIMES` at which there are any.
    """
    assembler = Assembler(problem)
    try:
        for t in TIMES:
            problem.set_time(t, default=PROPORTIONAL)
            forces = assembler.reactions.loads()[assembler.displacement_dofs]
            if total(problem.body.comm, float(forces @ forces)) > 0.0:
                return np.asarray(forces.reshape(-1, problem.body.dim))
        return None
    finally:
        problem.set_time(0.0, default=PROPORTIONAL)
        assembler.destroy()


def _fall(problem: Problem, freedom: Freedom, loads: FloatArray) -> FloatArray | None:
    """A motion of all local nodes along the loads, its largest component 1; None: none. Collective.

    Args:
        loads: At owned nodes, (nodes, dim) [N].
    """
    bodies, comm = freedom.bodies, problem.body.comm
    motions, own = freedom.at(slice(None)), len(loads)
    powers = np.zeros((bodies.count, motions.shape[2]))
    np.add.at(powers, bodies.of_node[:own], np.einsum("nd,ndm->nm", loads, motions[:own]))
    along = freedom.along(np.asarray(total(comm, powers)))
    motion = np.einsum("ndm,nm->nd", motions, along[bodies.of_node]).ravel()
    fastest = largest(comm, float(np.max(np.abs(motion), initial=0.0)))
    if fastest <= SLOW * total(comm, float(np.abs(loads).sum())):
        return None
    return np.asarray(motion / fastest)
