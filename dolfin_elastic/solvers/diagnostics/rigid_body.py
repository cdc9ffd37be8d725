"""Rigid motions that no support prevents: with one, no equilibrium is unique.

Supports constrain nodes in directions; applied to translations and small rotations of a body these
directions are rows of numbers, whose products sum up to one small matrix a body.  Its null space is
what is left free.

A rigid surface constrains its nodes only as far as it is constrained itself: A m - G q = 0 for a
body's motion m and the surface's free degrees of freedom q.  The null space of all such equations,
restricted to a body, is what that body can do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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

FREE = 1e-10
"""Stiffness against a rigid motion, over that of the diagonal, which counts as none."""

MANY = 50
"""Number of parts above which none is checked: so many are fragments of a broken mesh, and each
costs six products with the tangent."""


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
_SHOWN = 5
"""Bodies that one message names."""


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
def check_no_rigid_motion(problem: Problem) -> None:
    """Supports must prevent every rigid motion of each connected body in equilibrium. Collective.

    Raises:
        InputError: They do not.
    """
    problem.check_start(default=PROPORTIONAL)
    bodies = free_bodies(problem)
    free = [body for body in bodies if body.motions]
    if not free:
        return
    if problem.cell is not None:
        text = ", ".join(f"`{body.name}`" for body in free[:_SHOWN])
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
        text = "; ".join(f"`{b.name}` can {', '.join(b.motions)}" for b in free[:_SHOWN])
        more = f" and {len(free) - _SHOWN} more bodies" if len(free) > _SHOWN else ""
        text = f"of {len(bodies)} bodies that share no nodes, {text}{more}"
    raise InputError(
        f"{what}: {text}",
        where="support",
        expected="equilibrium needs supports that hold "
        f"{'each body' if len(bodies) > 1 else 'it'}; [dynamics] does not",
    )


def _check_obstacles_ahead(problem: Problem, free: list[FreeBody]) -> None:
    """Obstacles that would hold the body once they touched are named. Collective.

    Raises:
        InputError: Obstacles would hold them, with how far away they are.
    """
    with problem.terms.assumed(closed=True):
        if free_motions(problem):
            return
    away = {term.label: gap for term in problem.terms if (gap := term.distance())}
    text = ", ".join(
        f"'{label}' is {problem.body.unit.length(gap)} away" for label, gap in away.items()
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
    """

    bodies: ConnectedBodies
    nulls: list[FloatArray]
    centres: FloatArray
    sizes: FloatArray
    kinds: slice

    def motions(self, k: int, nodes: IndexArray) -> FloatArray:
        """Displacement of nodes under the free motions of body k, shape (nodes, dim, motions)."""
        arms = (self.bodies.places[nodes] - self.centres[k]) / self.sizes[k]
        return np.asarray(rigid_motions(arms)[:, :, self.kinds] @ self.nulls[k])


def rigid_freedom(problem: Problem, *, rubbing: bool = True) -> Freedom:
    """Rigid motions of all bodies, which are none of a periodic cell. Collective.

    Args:
        rubbing: See `free_bodies`.
    """
    bodies = ConnectedBodies(problem)
    centres, sizes = _bounding_boxes(bodies)
    directions = constrained_directions(problem, rubbing=rubbing)
    sums = _constraint_products(bodies, directions, centres, sizes)
    nulls = [_null_space(problem, matrix) for matrix in sums]
    if any(len(motion.free) for motion in problem.constraints.rigid_motions):

        def motions_at(nodes: IndexArray) -> FloatArray:
            of = bodies.of_node[nodes]
            return rigid_motions((bodies.places[nodes] - centres[of]) / sizes[of, None])

        which, joint = _coupled_products(problem, bodies, sums, motions_at, sizes)
        n = sums.shape[1]
        null = _null_space(problem, joint)
        for k, body in enumerate(which):
            nulls[body] = _restricted(null, k, n)
    kinds = slice(1, 2) if problem.geometry == "axisymmetric" else slice(None)
    return Freedom(bodies, nulls, centres, sizes, kinds)


def _parts_of_cell(problem: Problem, bodies: ConnectedBodies) -> list[FreeBody]:
    """Of a periodic cell all that is connected to its fixed vertex is constrained. Collective."""
    nodes = problem.unknowns.merged_dofs(problem.constraints.dofs) // problem.body.dim
    marks = np.bincount(bodies.of_node[nodes], minlength=bodies.count)
    fixed = total(bodies.comm, marks) > 0
    return [
        FreeBody(name, () if one else (LOOSE,))
        for name, one in zip(bodies.names(), fixed, strict=True)
    ]


def constrained_directions(problem: Problem, *, rubbing: bool = True) -> Constraints:
    """Directions in which this rank's nodes are constrained. Collective.

    Prescribed components and directions, and what terms hold: springs, and obstacles that touch.

    Args:
        rubbing: See `free_bodies`.
    """
    dim, prescribed = problem.body.dim, problem.constraints
    held = prescribed.prescribed_dofs
    rows = [Constraints((held // dim).astype(np.int32), np.eye(dim)[held % dim])]
    if prescribed.skewed:
        nodes = np.repeat(prescribed.skew_dofs[:, 0] // dim, dim)
        rows.append(Constraints(nodes, prescribed.P.reshape(-1, dim)))
    terms = [term for term in problem.terms if rubbing or not term.dissipates]
    rows += [Constraints(*one) for term in terms for one in term.held()]
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
    bodies: ConnectedBodies, constraints: Constraints, centres: FloatArray, sizes: FloatArray
) -> FloatArray:
    """The sum of products of constraints on rigid motions, for each body. Collective.

    Args:
        constraints: Of this rank's nodes.
        centres: Of rotations, shape (bodies, dim) [m].
        sizes: Length by which places are divided, shape (bodies,) [m].

    Returns:
        Shape (bodies, motions, motions).
    """
    of = bodies.of_node[constraints.nodes]
    arms = (bodies.places[constraints.nodes] - centres[of]) / sizes[of, None]
    rows = np.einsum("rc,rcm->rm", constraints.directions, rigid_motions(arms))
    sums = np.zeros((bodies.count, rows.shape[1], rows.shape[1]))
    np.add.at(sums, of, rows[:, :, None] * rows[:, None, :])
    return np.asarray(total(bodies.comm, sums))


def _null_space(problem: Problem, matrix: FloatArray) -> FloatArray:
    """Orthonormal null space of a matrix of products."""
    if problem.geometry == "axisymmetric":  # of rigid motions only the one along the axis is one
        matrix = matrix[1:2, 1:2]
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
) -> tuple[IntArray, FloatArray]:
    """The joint matrix of all bodies that have rigid surfaces with free motion. Collective.

    Args:
        products: Matrix of each body, as if the surfaces were fixed, shape (bodies, n, n).
        motions_at: From nodes to their displacement under unit motions of their body, shape
            (nodes, dim, n).
        sizes: Length by which the places of each body are divided [m].

    Returns:
        Numbers of these bodies, and the matrix of their motions and then those of the surfaces.
    """
    dim, n, comm = problem.body.dim, products.shape[1], problem.body.comm
    surfaces = [motion for motion in problem.constraints.rigid_motions if len(motion.free)]
    count = sum(len(motion.free) for motion in surfaces)
    mixed, own = np.zeros((bodies.count, n, count)), np.zeros((count, count))
    touched, first = np.zeros(bodies.count, dtype=np.int64), 0
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
    return which, joint


def _restricted(null: FloatArray, k: int, n: int) -> FloatArray:
    """Orthonormal motions of one body in a null space of the joint matrix.

    Args:
        k: Number of the body among those with rigid surfaces.
    """
    left, sizes, _ = np.linalg.svd(null[k * n : (k + 1) * n], full_matrices=False)
    return np.asarray(left[:, sizes > _SAME])
