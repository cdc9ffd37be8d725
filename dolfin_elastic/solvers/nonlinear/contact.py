"""Contact as solvers see it: multipliers that grow until nothing penetrates, and its numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.problem.loads.contact import ContactPair
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult

Gap = tuple[float, tuple[float, ...]]
States = Generator[State | Mode, None, None]
log = logging.getLogger("dolfin_elastic")

AUGMENTATIONS = 10
"""Times that the multipliers of one load step are renewed."""

SOFT = 0.1
"""Share of the penalty that motion takes.

A node of an explicit scheme that hits in mid-step is thrown back too fast where the penalty is
stiff, see `stable.HIT`; and a stiffer obstacle than the cells above it would only shorten the step.
"""


class ContactAugmentation:
    """Uzawa's iteration: after each equilibrium lam <- max(0, lam - eps g), until gaps are small.

    Args:
        problem: What may touch; without contacts nothing is ever needed.

    Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97, box 1.
    """

    def __init__(self, problem: Problem) -> None:
        self._touching = problem.contact_pairs
        for touch in self._touching:
            touch.soften(1.0)
        self._saved: list[FloatArray] = []
        self.save()

    def save(self) -> None:
        """Keeps the multipliers, to be restored when a step fails. Not collective."""
        self._saved = [touch.lam.x.array.copy() for touch in self._touching]

    def restore(self) -> None:
        """Puts the kept multipliers back. Not collective."""
        for touch, kept in zip(self._touching, self._saved, strict=True):
            touch.lam.x.array[:] = kept

    def needed(self) -> bool:
        """A node that presses is not on its obstacle, within the tolerance. Collective."""
        return any(off_obstacle(touch) > touch.tolerance for touch in self._touching)

    def update(self) -> None:
        """Renews the multipliers from the gaps at hand. Collective."""
        for touch in self._touching:
            touch.augment()

    def settle(self, result: NewtonResult, solve: Callable[[], NewtonResult]) -> NewtonResult:
        """Solves again with new multipliers until nothing penetrates, if that happens. Collective.

        Args:
            result: Of the equilibrium at hand.
            solve: Finds the next one from there.

        Returns:
            Result of the last solve, with the iterations of all and the prediction of the first.
        """
        newton, krylov, count = result.newton, result.krylov, 0
        predicted = result.predicted
        while result.converged and count < AUGMENTATIONS and self.needed():
            self.update()
            result, count = solve(), count + 1
            newton, krylov = newton + result.newton, krylov + result.krylov
        return replace(result, newton=newton, krylov=krylov, predicted=predicted)


def off_obstacle(touch: ContactPair) -> float:
    """Largest distance from the obstacle of nodes that press or penetrate [m]. Collective."""
    gaps, _ = touch.gaps()
    return largest(touch.comm, float(np.max(np.abs(gaps[touch.pressing | (gaps < 0)]), initial=0)))


class ContactResults:
    """Numbers of each contact for states. Collective to make.

    Args:
        problem: What may touch.
        moving: Energies are wanted, too.
    """

    def __init__(self, problem: Problem, *, moving: bool = False) -> None:
        self._problem, self._touching = problem, problem.contact_pairs
        areas = [touch.area for touch in self._touching]
        self._areas: list[fem.Form] = compiled(problem, areas) if areas else []
        stored = [touch.energy for touch in self._touching] if moving else []
        self._energies: list[fem.Form] = compiled(problem, stored) if stored else []

    def numbers(self) -> dict[str, float]:
        """Largest penetration [m] and area under pressure [m^2] of each contact. Collective."""
        found: dict[str, float] = {}
        for touch, area in zip(self._touching, self._areas, strict=True):
            depth = largest(touch.comm, float(np.max(-touch.gaps()[0], initial=0.0)))
            first, second = f"penetration_{touch.label}", f"contact_area_{touch.label}"
            found[first] = max(found.get(first, 0.0), depth)
            found[second] = found.get(second, 0.0) + integral(self._problem, area)
        return found

    def energies(self) -> dict[str, float]:
        """What the penalties store [J]; nothing without contacts. Collective."""
        if not self._energies:
            return {}
        return {"contact": sum(integral(self._problem, form) for form in self._energies)}


@contextmanager
def all_touching(problem: Problem) -> Iterator[None]:
    """Counts every surface that may touch as touching, for the stiffest tangent there can be."""
    kept = [float(touch.reach.value) for touch in problem.contact_pairs]
    far = 10 * span(problem.body) if problem.contact_pairs else 0.0
    try:
        for touch in problem.contact_pairs:
            touch.reach.value = max(far, 10 * farthest(touch))
        yield
    finally:
        for touch, value in zip(problem.contact_pairs, kept, strict=True):
            touch.reach.value = value


@contextmanager
def none_touching(problem: Problem) -> Iterator[None]:
    """Counts no surface as touching, for the tangent of a body that has been lifted off."""
    kept = [float(touch.reach.value) for touch in problem.contact_pairs]
    try:
        for touch in problem.contact_pairs:
            touch.reach.value = -1e30
        yield
    finally:
        for touch, value in zip(problem.contact_pairs, kept, strict=True):
            touch.reach.value = value


def pulled_off(assembler: Assembler) -> bool:
    """The loads as a whole point away from the obstacles that are near. Collective."""
    problem, dim = assembler.problem, assembler.problem.body.dim
    if not problem.contact_pairs:
        return False
    normals = np.zeros(dim)
    for touch in problem.contact_pairs:
        gaps, n = touch.gaps()
        normals += n[gaps <= touch.size].sum(axis=0)
    forces = assembler.reactions.loads()[assembler.displacement_dofs].reshape(-1, dim)
    sums = [normals, forces.sum(axis=0), [np.abs(forces).sum()]]
    found = total(problem.body.comm, np.concatenate(sums))
    away = float(found[:dim] @ found[dim : 2 * dim])
    return away > 1e-6 * float(np.linalg.norm(found[:dim])) * float(found[-1])


def farthest(touch: ContactPair) -> float:
    """Largest gap at the nodes of a contact [m]. Collective."""
    return largest(touch.comm, float(np.max(touch.gaps()[0], initial=0.0)))


def nearest_gap(touch: ContactPair) -> float:
    """Smallest gap at the nodes of a contact [m]. Collective."""
    return smallest(touch.comm, float(np.min(touch.gaps()[0], initial=np.inf)))


def begin_motion(problem: Problem, *, tell: bool) -> None:
    """Motion has penalties alone, and softer ones. Collective.

    Args:
        problem: What moves, where it begins.
        tell: Say what begins in an obstacle.

    Raises:
        InputError: See `check_start`.
    """
    for touch, (gap, place) in zip(
        problem.contact_pairs, check_start(problem, moving=True), strict=True
    ):
        if tell and gap < -touch.tolerance:
            log.warning("%s", buried(touch, gap, place))
        touch.soften(SOFT)
        touch.lam.x.array[:] = 0.0


def buried(touch: ContactPair, gap: float, place: tuple[float, ...]) -> str:
    """What a motion begins with that begins in an obstacle."""
    return (
        f"at the start '{touch.label}' lies {-gap:.3g} m deep in its obstacle, at "
        f"{coordinates(place)} m: what the penalty stores there throws it off"
    )


def check_start(problem: Problem, *, moving: bool) -> list[Gap]:
    """No surface begins deep inside its obstacle; returns `first_gaps`. Collective.

    Args:
        problem: What may touch.
        moving: See `first_gaps`.

    Raises:
        InputError: With place and depth.
    """
    gaps = first_gaps(problem, moving=moving)
    for index, (touch, (gap, place)) in enumerate(zip(problem.contact_pairs, gaps, strict=True)):
        if gap < -touch.size:
            raise InputError(
                f"at the start '{touch.label}' lies {-gap:.3g} m deep in the obstacle, "
                f"at {coordinates(place)} m",
                where=f"contact[{index}].{touch.contact.shape}",
                expected=f"at most a cell deep, {touch.size:.3g} m; "
                "does the normal point to the free side?",
            )
    return gaps


def first_gaps(problem: Problem, *, moving: bool) -> list[Gap]:
    """Smallest gap of each contact at the start [m], and where [m]. Collective.

    Args:
        problem: What may touch.
        moving: In motion, where what names no curve acts in full from the start.
    """
    if problem.contact_pairs:
        problem.set_time(0.0, default=CONSTANT if moving else PROPORTIONAL)
    found = []
    for touch in problem.contact_pairs:
        gaps = touch.gaps()[0]
        mine = [
            (float(gap), tuple(place.round(12).tolist()))
            for gap, place in zip(gaps, touch.places(), strict=True)
            if gap <= np.min(gaps, initial=np.inf) + 1e-9 * touch.size
        ]
        rows = [row for part in touch.comm.allgather(mine) for row in part]
        # Nodes that are equally near: the same one on any number of ranks.
        least = min((gap for gap, _ in rows), default=np.inf) + 1e-9 * touch.size
        near = (row for row in rows if row[0] <= least)
        found.append(min(near, key=lambda row: row[1], default=(np.inf, ())))
    return found


def tell_untouched(problem: Problem, states: States) -> States:
    """The same states; at their end, warns of contacts that none of them touches."""
    never = {touch.label for touch in problem.contact_pairs}
    with closing(states):
        for state in states:
            numbers = state.numbers if isinstance(state, State) else {}
            area = {label: numbers.get(f"contact_area_{label}", 1.0) for label in never}
            never -= {label for label in never if area[label] > 0}
            yield state
    for label in sorted(never):
        log.warning("contact '%s' was never touched", label)


def rows_of(touch: ContactPair, within: float) -> tuple[IndexArray, FloatArray]:
    """Owned nodes of the displacement at most so far from the obstacle, and its normals there."""
    gaps, normals = touch.gaps()
    near = gaps <= within
    return touch.nodes_of_displacement[near], normals[near]


def touches(touch: ContactPair) -> int:
    """Nodes that count as touching now. Collective."""
    return int(total(touch.comm, int(np.sum(touch.gaps()[0] <= float(touch.reach.value)))))
