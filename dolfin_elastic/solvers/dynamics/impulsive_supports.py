"""Supports that a body cannot follow: at the start it is thrown or torn, or later, by a jump."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.parallel import first_of, largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.messages import coordinates

SMALL = 1e-6
"""Share of the largest value of the motion up to which two values are the same: what formulas of
users and differences of supports leave is far below, and a shock so small is none."""

SUDDEN = 0.1
"""A support jumps that goes this share of a step's way in a ten-thousandth of the step."""

LOOKS = 8
"""Times at which supports are looked at for how far they move."""


@dataclass(frozen=True)
class SupportJump:
    """Where a support and the body differ at the start, or as a support jumps.

    Attributes:
        support: Its label.
        what: "velocity" or "displacement".
        most: Largest difference [m/s, m].
        place: Where that is in the undeformed body [m].
    """

    support: str
    what: str
    most: float
    place: tuple[float, ...]

    def __str__(self) -> str:
        unit = {"velocity": "m/s", "displacement": "m"}[self.what]
        follows = {
            "velocity": "its nodes move with the support at once, and a shock runs into the body",
            "displacement": "its nodes are put there at once, and the cells beside them strained: "
            "a shock runs into the body",
        }[self.what]
        return (
            f"at the start the support '{self.support}' and the body differ in {self.what}, by "
            f"{self.most:.3g} {unit} at {coordinates(self.place)} m: {follows}. Was that meant? "
            f"Else dynamics.initial_{self.what} fits it, or a curve that begins gently"
        )


def reach(problem: Problem, span: float) -> float:
    """How far supports move within a time, from where they start [m]. Collective."""
    held, most = problem.prescribed, 0.0
    start, *later = held.targets_at(span * k / LOOKS for k in range(LOOKS + 1))
    for there in later:
        gone = np.abs(there - start)
        most = max(most, float(np.max(gone, initial=0.0, where=np.isfinite(gone))))
    held.move_to(0.0)
    return largest(problem.body.comm, most)


def jump(problem: Problem, t: float, step: float) -> str:
    """Words of the support that moves furthest at once, just after a time, if one does. Collective.

    Args:
        problem: Whose supports.
        t: Time [s]; it is the problem's afterwards.
        step: As long as the steps of the motion [s].
    """
    held = problem.prescribed
    start, *later = held.targets_at((t, t + 1e-4 * step, t + step))
    problem.set_time(t)
    sudden, whole = (np.nan_to_num(there - start) for there in later)
    far = max(float(np.max(np.abs(gone), initial=0.0)) for gone in (sudden, whole))
    change = np.zeros(problem.V.dofmap.index_map.size_local * problem.body.dim)
    held.impose(change, sudden)
    least = SUDDEN * largest(problem.body.comm, far)
    found = list(misfits(problem, "displacement", change, least))
    if not found:
        return ""
    most = max(found, key=lambda misfit: misfit.most)
    at = f"by {most.most:.3g} m at {coordinates(most.place)} m"
    return f"the support '{most.support}' jumps there, {at}"


def misfits(problem: Problem, what: str, change: FloatArray, least: float) -> Iterator[SupportJump]:
    """Supports that change what the body would be without them. Collective.

    Args:
        problem: What moves.
        what: "velocity" or "displacement".
        change: What they have made of it less what it was, at owned entries.
        least: Differences up to this are none.
    """
    x, dim = problem.V.tabulate_dof_coordinates(), problem.body.dim
    for label, rows in _shares(problem, change):
        sizes = np.linalg.norm(rows, axis=1)
        most = largest(problem.body.comm, float(np.max(sizes, initial=0.0)))
        if not most > least:
            continue
        # Nodes that differ equally: the same one on any number of ranks.
        alike = x[: len(sizes)][sizes >= most * (1 - 1e-9)]
        place = first_of(problem.body.comm, map(tuple, alike.round(12).tolist()))
        assert place is not None  # some rank has the largest
        yield SupportJump(label, what, most, place[:dim])


def _shares(problem: Problem, change: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Each support's label, and what it has changed at the owned nodes, of shape (nodes, dim)."""
    held, dim = problem.prescribed, problem.body.dim
    for label, entries in held.moving.items():
        share = np.zeros_like(change)
        share[entries] = change[entries]
        rows = share.reshape(-1, dim)
        if (tilted := held.tilted) is not None:
            at_tilted = change.reshape(-1, dim)[tilted.nodes[: tilted.count]]
            for support, nodes, part in tilted.each(at_tilted):
                if support.label == label:
                    rows[nodes] += part
        yield label, rows
