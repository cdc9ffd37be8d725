"""What rigid surfaces with free motion leave of the bodies' own rigid motions.

A rigid surface holds its nodes only as far as it is held itself: A m - G q = 0 for a body's
motion m and the surface's free degrees of freedom q.  The null space of all such equations,
restricted to a body, is what that body can do.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.diagnostics.connectivity import ConnectedBodies

_SAME = 1e-6
"""Share of a motion that is round-off."""


def couple(
    problem: Problem,
    bodies: ConnectedBodies,
    products: FloatArray,
    motions_at: Callable[[IndexArray], FloatArray],
    sizes: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """The joint matrix of all bodies that have rigid surfaces with free motion. Collective.

    Args:
        problem: Whose surfaces.
        bodies: Its connected bodies.
        products: Matrix of each body, as if the surfaces were held, shape (bodies, n, n).
        motions_at: From nodes to their displacement under unit motions of their body, shape
            (nodes, dim, n).
        sizes: Length by which the places of each body are divided [m].

    Returns:
        Numbers of these bodies, and the matrix of their motions and then those of the surfaces.
    """
    dim, n, comm = problem.body.dim, products.shape[1], problem.body.comm
    plates = [motion for motion in problem.prescribed.motions if len(motion.free)]
    count = sum(len(motion.free) for motion in plates)
    mixed, own = np.zeros((bodies.count, n, count)), np.zeros((count, count))
    touched, first = np.zeros(bodies.count, dtype=np.int64), 0
    last = len(problem.prescribed.values.x.array)
    owned = np.zeros(last, dtype=bool)
    owned[problem.prescribed.owned] = True
    for motion in plates:
        dofs, D = problem.prescribed.directions(motion)
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


def restricted(null: FloatArray, k: int, n: int) -> FloatArray:
    """Orthonormal motions of the k-th body in a null space of the joint matrix."""
    left, sizes, _ = np.linalg.svd(null[k * n : (k + 1) * n], full_matrices=False)
    return np.asarray(left[:, sizes > _SAME])


def turns_alone(null: FloatArray, size: int) -> bool:
    """A motion of a rigid surface alone moves none of its nodes.

    Args:
        null: Null space of the joint matrix.
        size: Of its part of the bodies' motions.
    """
    sizes = np.linalg.svd(null[:size], compute_uv=False)
    return bool(np.sum(sizes > _SAME) < null.shape[1])
