"""Contact in solvers: augmentation of multipliers, results for states, and checks of gaps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.problem.terms.contact import ContactPair
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult

Gap = tuple[float, tuple[float, ...]]
States = Generator[State | Mode, None, None]
log = logging.getLogger("dolfin_elastic")

AUGMENTATIONS = 10
"""Times that the multipliers of one load step are renewed."""

SOFT = 0.1
"""Penalty in dynamics over that in statics.

In an explicit scheme a node that hits in mid-step gains energy where the penalty is stiff, see
`stable_step.CONTACT`; and a penalty stiffer than the cells above it only shortens the stable step.
"""


class ContactAugmentation:
    """Augmented Lagrangian (Uzawa): lam <- max(0, lam - eps g) until gaps are small.

    Args:
        problem: What may touch; without contacts nothing is ever needed.

    Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97, box 1.
    """

    def __init__(self, problem: Problem) -> None:
        self._pairs = problem.contact_pairs
        for pair in self._pairs:
            pair.soften(1.0)
        self._saved: list[FloatArray] = []
        self.save()

    def save(self) -> None:
        """Saves the multipliers, to be restored when a step fails. Not collective."""
        self._saved = [pair.lam.x.array.copy() for pair in self._pairs]

    def restore(self) -> None:
        """Restores the saved multipliers. Not collective."""
        for pair, saved in zip(self._pairs, self._saved, strict=True):
            pair.lam.x.array[:] = saved

    @stage("contact")
    def needed(self) -> bool:
        """Whether a node that presses is off its obstacle, beyond the tolerance. Collective."""
        return any(contact_gap_error(pair) > pair.tolerance for pair in self._pairs)

    @stage("contact")
    def update(self) -> None:
        """Renews the multipliers from the gaps at hand. Collective."""
        for pair in self._pairs:
            pair.augment()

    def solve(self, result: NewtonResult, solve: Callable[[], NewtonResult]) -> NewtonResult:
        """Solves again with new multipliers until nothing penetrates, if that happens. Collective.

        Args:
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


@stage("contact")
def contact_gap_error(pair: ContactPair) -> float:
    """Largest distance from the obstacle of nodes that press or penetrate [m]. Collective."""
    gaps, _ = pair.gaps()
    return largest(
        pair.comm, float(np.max(np.abs(gaps[(pair.pressures() > 0) | (gaps < 0)]), initial=0))
    )


class ContactResults:
    """Numbers of each contact for states. Collective to make."""

    def __init__(self, problem: Problem, *, moving: bool = False) -> None:
        self._problem, self._pairs = problem, problem.contact_pairs
        areas = [pair.area for pair in self._pairs]
        self._areas: list[fem.Form] = compiled(problem, areas) if areas else []
        stored = [pair.energy for pair in self._pairs] if moving else []
        self._energies: list[fem.Form] = compiled(problem, stored) if stored else []

    @stage("contact")
    def numbers(self) -> dict[str, float]:
        """Largest penetration [m] and area under pressure [m^2] of each contact. Collective."""
        found: dict[str, float] = {}
        for pair, area in zip(self._pairs, self._areas, strict=True):
            depth = largest(pair.comm, float(np.max(-pair.gaps()[0], initial=0.0)))
            first, second = f"penetration_{pair.label}", f"contact_area_{pair.label}"
            found[first] = max(found.get(first, 0.0), depth)
            found[second] = found.get(second, 0.0) + integral(self._problem, area)
        return found

    @stage("contact")
    def energies(self) -> dict[str, float]:
        """What the penalties store [J]; nothing without contacts. Collective."""
        if not self._energies:
            return {}
        return {"contact": sum(integral(self._problem, form) for form in self._energies)}


@contextmanager
def in_full_contact(problem: Problem) -> Iterator[None]:
    """Every surface that may touch is in contact, for the stiffest tangent there can be.

    Collective.
    """
    far = 10 * span(problem.body) if problem.contact_pairs else 0.0
    with _reaching([max(far, 10 * largest_gap(pair)) for pair in problem.contact_pairs], problem):
        yield


@contextmanager
def without_contact(problem: Problem) -> Iterator[None]:
    """No surface is in contact, for the tangent of a body that has been lifted off."""
    with _reaching([-1e30] * len(problem.contact_pairs), problem):
        yield


@contextmanager
def _reaching(reaches: Sequence[float], problem: Problem) -> Iterator[None]:
    """Changes the gap up to which nodes of each contact are in contact [m]."""
    before = [pair.reach for pair in problem.contact_pairs]
    try:
        for pair, reach in zip(problem.contact_pairs, reaches, strict=True):
            pair.set_reach(reach)
        yield
    finally:
        for pair, reach in zip(problem.contact_pairs, before, strict=True):
            pair.set_reach(reach)


def pulled_off_obstacles(assembler: Assembler) -> bool:
    """The loads as a whole point away from the obstacles that are near. Collective.

    Their resultant is compared with the sum of their sizes: loads that cancel pull nowhere.
    """
    problem, dim = assembler.problem, assembler.problem.body.dim
    if not problem.contact_pairs:
        return False
    normals = np.zeros(dim)
    for pair in problem.contact_pairs:
        gaps, n = pair.gaps()
        normals += n[gaps <= pair.size].sum(axis=0)
    forces = assembler.reactions.loads()[assembler.displacement_dofs].reshape(-1, dim)
    sums = [normals, forces.sum(axis=0), [np.abs(forces).sum()]]
    found = total(problem.body.comm, np.concatenate(sums))
    away = float(found[:dim] @ found[dim : 2 * dim])
    return away > 1e-6 * float(np.linalg.norm(found[:dim])) * float(found[-1])


def largest_gap(pair: ContactPair) -> float:
    """Largest gap at the nodes of a contact [m]. Collective."""
    return largest(pair.comm, float(np.max(pair.gaps()[0], initial=0.0)))


def smallest_gap(pair: ContactPair) -> float:
    """Smallest gap at the nodes of a contact [m]. Collective."""
    return smallest(pair.comm, float(np.min(pair.gaps()[0], initial=np.inf)))


@stage("contact")
def begin_motion(problem: Problem, *, warn: bool) -> None:
    """Motion has penalties alone, and softer ones. Collective.

    Args:
        problem: What moves, where it begins.
        warn: Warn of what begins inside an obstacle.

    Raises:
        InputError: See `check_initial_gaps`.
    """
    for pair, (gap, place) in zip(
        problem.contact_pairs, check_initial_gaps(problem, moving=True), strict=True
    ):
        if warn and gap < -pair.tolerance:
            log.warning("%s", penetration_message(pair, gap, place))
        pair.soften(SOFT)
        pair.lam.x.array[:] = 0.0


def penetration_message(pair: ContactPair, gap: float, place: tuple[float, ...]) -> str:
    """The warning that a motion begins inside an obstacle.

    Args:
        gap: Smallest gap, below 0 [m].
        place: Reference place of that node [m].
    """
    return (
        f"at the start '{pair.label}' lies {-gap:.3g} m deep in its obstacle, at "
        f"{coordinates(place)} m: what the penalty stores there throws it off"
    )


@stage("contact")
def check_initial_gaps(problem: Problem, *, moving: bool) -> list[Gap]:
    """No surface begins deep inside its obstacle; returns `initial_gaps`. Collective.

    Args:
        problem: What may touch.
        moving: See `initial_gaps`.

    Raises:
        InputError: With place and depth.
    """
    gaps = initial_gaps(problem, moving=moving)
    for index, (pair, (gap, place)) in enumerate(zip(problem.contact_pairs, gaps, strict=True)):
        if gap < -pair.size:
            raise InputError(
                f"at the start '{pair.label}' lies {-gap:.3g} m deep in the obstacle, "
                f"at {coordinates(place)} m",
                where=f"contact[{index}].{pair.contact.shape}",
                expected=f"at most a cell deep, {pair.size:.3g} m; "
                "does the normal point to the free side?",
            )
    return gaps


def initial_gaps(problem: Problem, *, moving: bool) -> list[Gap]:
    """Smallest gap of each contact at the start [m], and where [m]. Collective.

    Args:
        problem: What may touch.
        moving: In motion, where what names no amplitude acts in full from the start.
    """
    if problem.contact_pairs:
        problem.set_time(0.0, default=CONSTANT if moving else PROPORTIONAL)
    found = []
    for pair in problem.contact_pairs:
        gaps = pair.gaps()[0]
        mine = [
            (float(gap), tuple(place.round(12).tolist()))
            for gap, place in zip(gaps, pair.places(), strict=True)
            if gap <= np.min(gaps, initial=np.inf) + 1e-9 * pair.size
        ]
        rows = [row for part in pair.comm.allgather(mine) for row in part]
        # Nodes that are equally near: the same one on any number of ranks.
        least = min((gap for gap, _ in rows), default=np.inf) + 1e-9 * pair.size
        near = (row for row in rows if row[0] <= least)
        found.append(min(near, key=lambda row: row[1], default=(np.inf, ())))
    return found


def warn_of_untouched(problem: Problem, states: States) -> States:
    """Passes states on, and warns in the end of contacts that have never touched. Collective."""
    never = {pair.label for pair in problem.contact_pairs}
    with closing(states):
        for state in states:
            numbers = state.numbers if isinstance(state, State) else {}
            area = {label: numbers.get(f"contact_area_{label}", 1.0) for label in never}
            never -= {label for label in never if area[label] > 0}
            yield state
    for label in sorted(never):
        log.warning("contact '%s' was never touched", label)


def near_nodes(pair: ContactPair, within: float) -> tuple[IndexArray, FloatArray]:
    """Owned nodes near the obstacle, shape (n,), and its normals there, shape (n, dim).

    Args:
        within: Largest gap that counts as near [m].
    """
    gaps, normals = pair.gaps()
    near = gaps <= within
    return pair.nodes_of_displacement[near], normals[near]


def count_touching(pair: ContactPair) -> int:
    """Number of nodes in contact. Collective."""
    return int(total(pair.comm, int(np.sum(pair.gaps()[0] <= pair.reach))))
