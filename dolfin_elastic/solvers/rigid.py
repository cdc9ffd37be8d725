"""What is left free to move as a rigid body, of which no equilibrium is unique."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfin_elastic.errors import InputError
from dolfin_elastic.parallel import total
from dolfin_elastic.problem import Problem

Floats = npt.NDArray[np.float64]
_ROUND_OFF = 1e-10


def check_held(problem: Problem) -> None:
    """A body in equilibrium must be held against every rigid motion. Collective.

    Raises:
        InputError: It is not.
    """
    free = free_motions(problem)
    if free:
        what = "the supports leave the body free" if problem.supports else "there is no support"
        raise InputError(
            f"{what}: as a rigid body it can {', '.join(free)}",
            where="support",
            expected="statics needs supports that hold it; [dynamics] does not",
        )


def free_motions(problem: Problem) -> list[str]:
    """Rigid motions that no support prevents, in words. Collective.

    The prescribed components, applied to translations and small rotations, sum up to a matrix of
    6x6 numbers (3x3 in a plane) whose null space is what is left free.  Prescribed directions and
    those of springs count as components do; dashpots hold nothing.  Free degrees of freedom of
    rigid surfaces are further unknowns: what they move is held only as far as they are.
    """
    dim, prescribed = problem.body.dim, problem.prescribed
    held = prescribed.owned
    x = problem.V.tabulate_dof_coordinates()[:, :dim]
    centre, size = _frame(x, problem.body.comm)
    rows = _rigid((x[held // dim] - centre) / size)[np.arange(len(held)), held % dim]
    more = problem.resisting
    if (tilted := prescribed.tilted) is not None:
        more = [*more, (tilted.nodes[: tilted.count], tilted.P[: tilted.count])]
    rows = np.hstack([rows, *(-part for part in _plates(problem, held, size))])
    for nodes, P in more:
        moved = _rigid((x[nodes] - centre) / size)
        found = (P @ moved).reshape(-1, moved.shape[2])
        rows = np.vstack([rows, np.pad(found, [(0, 0), (0, rows.shape[1] - found.shape[1])])])
    if problem.geometry == "axisymmetric":  # of rigid motions only the one along the axis is one
        rows = rows[:, 1:2]
    values, vectors = np.linalg.eigh(total(problem.body.comm, rows.T @ rows))
    null = vectors[:, values <= _ROUND_OFF * max(values[-1], 1.0)]
    if problem.geometry == "axisymmetric":
        return ["move along y"] * null.shape[1]
    # What is left of the body's own motions, and what rigid surfaces can do without the body.
    body, sizes, _ = np.linalg.svd(null[: dim + 2 * dim - 3], full_matrices=False)
    body = body[:, sizes > 1e-6]
    said = _said(body, dim) if body.shape[1] else []
    return said + ["leave a rigid surface to turn about itself"] * (null.shape[1] > body.shape[1])


def _plates(problem: Problem, held: npt.NDArray[np.int32], size: float) -> list[Floats]:
    """What unit motions of rigid surfaces prescribe at the held entries."""
    found: list[Floats] = []
    for motion in problem.prescribed.motions:
        dofs, D = problem.prescribed.directions(motion)
        own = np.isin(dofs, held)
        scale = np.where(np.arange(D.shape[1]) < problem.body.dim, 1.0, 1 / size)
        columns = np.zeros((len(held), len(motion.free)))
        columns[np.searchsorted(held, dofs[own])] = (D * scale)[own][:, list(motion.free)]
        found.append(columns)
    return found


def _frame(x: Floats, comm: MPI.Comm) -> tuple[Floats, float]:
    """Middle and size of the body's bounding box. Collective."""
    corners = np.concatenate([x.max(axis=0, initial=-np.inf), -x.min(axis=0, initial=np.inf)])
    comm.Allreduce(MPI.IN_PLACE, corners, op=MPI.MAX)
    high, low = np.split(corners, 2)
    return (high - low) / 2, float(np.max(high + low))


def _planes(dim: int) -> list[tuple[int, int]]:
    """The plane of each rotation: about x, y, z; in a plane about z."""
    return [(1, 2), (2, 0), (0, 1)] if dim == 3 else [(0, 1)]


def _rigid(x: Floats) -> Floats:
    """Displacement of points under unit rigid motions, shape (points, component, motion)."""
    points, dim = x.shape
    planes = _planes(dim)
    moved = np.zeros((points, dim, dim + len(planes)))
    moved[:, range(dim), range(dim)] = 1.0
    for k, (i, j) in enumerate(planes, start=dim):
        moved[:, i, k], moved[:, j, k] = -x[:, j], x[:, i]
    return moved


def _said(null: Floats, dim: int) -> list[str]:
    names = [f"move along {axis}" for axis in "xyz"[:dim]] + [
        f"turn about {axis}" for axis in ("xyz" if len(null) > 3 else "z")
    ]
    share = np.linalg.norm(null, axis=1)
    if null.shape[1] == len(null):
        return ["move and turn freely"]
    plain = [name for name, part in zip(names, share, strict=True) if part > 1 - 1e-6]
    if len(plain) < null.shape[1]:
        plain.append("turn about some axis")
    return plain
