"""Bodies that slide as a whole, and points whose contact changes while Newton's method goes on.

If the loads do more work on a rigid motion than friction can take up at the present pressures,
there is no equilibrium.

Source: D. C. Drucker, Coulomb friction, plasticity, and limit loads, J. Appl. Mech. 21 (1954) 71.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.diagnostics.evidence import TrialStates
from dolfin_elastic.solvers.diagnostics.instability import take_newton_step
from dolfin_elastic.solvers.diagnostics.rigid_body import free_bodies, rigid_freedom
from dolfin_elastic.solvers.diagnostics.stability import LIMIT

NEARLY = 0.98
"""Demanded over available force from which on a failure is that of sliding: near it points slide,
and pressures are others than where all of them stick."""

STEPS, SMALL = 10, 1e-4
"""Newton's steps for the equilibrium in which nothing slides, and the residual, over that at its
start, with which it is known well enough."""


@dataclass(frozen=True)
class Slide:
    """A body that no friction keeps where it is.

    Attributes:
        labels: Of the contacts that keep it.
        demanded: Tangential force that loads ask for [N]; of a turn, at the contacts' mean arm.
        available: Coefficient of friction times normal force [N].
    """

    labels: tuple[str, ...]
    demanded: float
    available: float

    def in_words(self) -> str:
        """What it does, and why."""
        names = " and ".join(f"'{label}'" for label in self.labels)
        return (
            f"the body slides over all of contact {names}: the loads demand a tangential force of "
            f"{self.demanded:.3g} N, and friction gives at most mu N = {self.available:.3g} N"
        )


def find_slide(states: TrialStates, good: FloatArray) -> Slide | None:
    """A body that slides as a whole under the loads of the step that failed. Collective.

    Its pressures are those of the equilibrium in which nothing can slide.

    Args:
        good: All unknowns at the last equilibrium, local array with ghosts.
    """
    problem, assembler = states.problem, states.assembler
    if problem.cell is not None or not problem.terms.dissipates:
        return None
    states.put(good)
    freedom = rigid_freedom(problem, rubbing=False)
    if not any(null.shape[1] for null in freedom.nulls):
        return None
    if problem.num_dofs > LIMIT[problem.body.dim] or not _solved_without_sliding(states, good):
        return None
    found = [(term.label, limits) for term in problem.terms if (limits := term.slip_limits())]
    loads = assembler.reactions.loads()[assembler.displacement_dofs].reshape(-1, problem.body.dim)
    for k, null in enumerate(freedom.nulls):
        if not null.shape[1]:
            continue
        inside = np.flatnonzero(freedom.bodies.of_node[: len(loads)] == k).astype(np.int32)
        work = np.einsum("nd,ndm->m", loads[inside], freedom.motions(k, inside))
        power = total(assembler.comm, work)
        local = np.zeros((len(found), 2))
        for row, (_, (at, forces, normals)) in zip(local, found, strict=True):
            mine = freedom.bodies.of_node[at] == k
            v, n = freedom.motions(k, at[mine]) @ power, normals[mine]
            speeds = np.linalg.norm(v - n * np.sum(v * n, axis=1)[:, None], axis=1)
            row[:] = forces[mine] @ speeds, forces[mine].sum()
        sums = total(assembler.comm, local)
        taken, available = sums.sum(axis=0)
        if taken > 0.0 and power @ power >= NEARLY * taken:
            labels = (label for (label, _), row in zip(found, sums, strict=True) if row[1] > 0.0)
            return Slide(tuple(labels), float(power @ power / taken * available), float(available))
    return None


def released(problem: Problem) -> tuple[str, str] | None:
    """A body that no support, and no contact that touches at the present state, holds. Collective.

    Returns:
        What it is called, and how it can move as a rigid body; None: all are held, or no contact
        opens.
    """
    if problem.cell is not None or not problem.terms.opens:
        return None
    with problem.terms.assumed(closed=True, near=True):
        free = [body for body in free_bodies(problem) if body.motions]
    if not free:
        return None
    name = f"`{free[0].name}`" if free[0].name else "the body"
    return name, ", ".join(free[0].motions)


def _solved_without_sliding(states: TrialStates, good: FloatArray) -> bool:
    """Whether Newton's method finds an equilibrium in which nothing can slide. Collective."""
    problem, assembler = states.problem, states.assembler
    for term in problem.terms:
        term.stick(always=True)
    try:
        start = np.inf if not states.residual(good) else assembler.residual.free_norm
        for _ in range(STEPS):
            now = problem.w.x.array.copy()
            if not states.tangent(now) or not take_newton_step(assembler):
                return False
            if not states.residual(problem.w.x.array.copy()):
                return False
            if assembler.residual.free_norm <= SMALL * start:
                return True
        return False
    finally:
        for term in problem.terms:
            term.stick(always=False)


class ContactStates:
    """States of contact of all points when it was made. Collective to make."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self._before = problem, _states(problem)

    def changes(self) -> str:
        """What has changed since, in words; empty: nothing. Collective."""
        for term, was, now in zip(
            self._problem.terms, self._before, _states(self._problem), strict=True
        ):
            if was is None or now is None:
                continue
            unit, comm = self._problem.body.unit, self._problem.body.comm
            (places, before), (_, after) = was, now
            moved = [tuple(row) for row in (places[before != after].round(12) + 0.0).tolist()]
            counts = total(comm, np.array([len(moved), len(before)]))
            every = [place for part in comm.allgather(moved) for place in part]
            if every:
                return (
                    f"; {counts[0]:.0f} of {counts[1]:.0f} points of contact '{term.label}' change "
                    f"from iteration to iteration between {_words(term.states)}, one of them at "
                    f"{unit.point(min(every))}"
                )
        return ""


def _states(problem: Problem) -> Sequence[tuple[FloatArray, IndexArray] | None]:
    return [term.point_states() for term in problem.terms]


def _words(states: Sequence[str]) -> str:
    return f"{', '.join(states[:-1])} and {states[-1]}"
