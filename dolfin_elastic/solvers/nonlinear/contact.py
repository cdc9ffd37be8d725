"""Contact in solvers: augmentation of multipliers, results for states, and checks of gaps."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import span
from dolfin_elastic.model.amplitude import CONSTANT, PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Mode, State
from dolfin_elastic.problem.terms.contact import ContactPair
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult

Gap = tuple[float, tuple[float, ...]]
States = Generator[State | Mode, None, None]
log = logging.getLogger("dolfin_elastic")

AUGMENTATIONS = 10
"""Times that what terms remember is renewed in one load step."""
_ALONG = 1e-6
"""Part of a normal that is free where the displacement along it is prescribed."""


class Augmentation:
    """Solves again where terms remember something that an equilibrium changes. Local to make.

    Multipliers of contact: augmented Lagrangian (Uzawa), lam <- max(0, lam - eps g) until gaps are
    small.  Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97, box 1.

    Attributes:
        memory: What the terms remember, by its name in restarts.
    """

    def __init__(self, problem: Problem) -> None:
        self._terms = problem.terms
        for term in self._terms:
            term.begin(moving=False)
        self.memory = {name: f for term in self._terms for name, f in term.memory.items()}
        self._saved = self.copies()

    def copies(self) -> list[FloatArray]:
        """What the terms remember now, for `put`. Not collective."""
        return [field.x.array.copy() for field in self.memory.values()]

    def put(self, copies: Sequence[FloatArray]) -> None:
        """Restores what they remembered. Not collective."""
        for field, saved in zip(self.memory.values(), copies, strict=True):
            field.x.array[:] = saved

    def save(self) -> None:
        """Saves it, to be restored when a step fails. Not collective."""
        self._saved = self.copies()

    def restore(self) -> None:
        """Restores what was saved. Not collective."""
        self.put(self._saved)

    def solve(self, result: NewtonResult, solve: Callable[[], NewtonResult]) -> NewtonResult:
        """Solves again until all terms are settled, if that happens. Collective.

        Args:
            solve: Finds the next one from there.

        Returns:
            Result of the last solve, with the iterations of all and the prediction of the first.
        """
        newton, krylov, count = result.newton, result.krylov, 0
        predicted = result.predicted
        while result.converged and count < AUGMENTATIONS and self._augmented():
            result, count = solve(), count + 1
            newton, krylov = newton + result.newton, krylov + result.krylov
        return replace(result, newton=newton, krylov=krylov, predicted=predicted)

    @stage("contact")
    def _augmented(self) -> bool:
        """Whether a term was not settled: all have been augmented then. Collective."""
        if not any(term.unsettled() for term in self._terms):
            return False
        for term in self._terms:
            term.augment()
        return True


def results_of_terms(problem: Problem) -> dict[str, float]:
    """Results of the problem's terms by name [SI units]. Collective."""
    result: dict[str, float] = {}
    for term in problem.terms:
        term.add_results(result)
    return result


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
    result = total(problem.body.comm, np.concatenate(sums))
    away = float(result[:dim] @ result[dim : 2 * dim])
    return away > 1e-6 * float(np.linalg.norm(result[:dim])) * float(result[-1])


def held_inside(problem: Problem, index: int) -> tuple[str, tuple[float, ...]] | None:
    """That an obstacle pushes into nodes whose displacement along its normal is prescribed.

    No state has these nodes outside.  What is prescribed, and where the obstacle is, are those of
    the time that was set last; all else is the problem's displacement.  Collective.

    Args:
        index: Of the contact, from 0, as in its key.

    Returns:
        That in words, and the reference place of the deepest of these nodes [m]; None: none is
        deeper than the tolerance.
    """
    pair = problem.contact_pairs[index]
    parts = pair.comm.allgather(_deepest_held(problem, pair))
    if (found := min((one for one in parts if one is not None), default=None)) is None:
        return None
    (_, *place), gap, names = found
    by = f"the support '{names[0]}'" if names else "the axis"
    text = (
        f"the obstacle of contact[{index}] '{pair.label}' pushes {-gap:.3g} m deep into nodes "
        f"that {by} holds, at {coordinates(place)} m"
    )
    return text, tuple(place)


def _deepest_held(
    problem: Problem, pair: ContactPair
) -> tuple[list[float], float, list[str]] | None:
    """The deepest of this rank's nodes, see `held_inside`: a key, its gap [m], who holds it.

    The key orders nodes by depth and place, alike on any number of ranks; the place [m] ends it.
    Collective.
    """
    constraints, dim = problem.constraints, problem.body.dim
    u, own = problem.u.x.array, problem.V.dofmap.index_map.size_local * dim
    saved = u.copy()
    constraints.impose(u[:own], constraints.values.x.array)
    gaps, normals = pair.gaps()
    u[:] = saved
    free, nodes = constraints.free_directions(own, dim), pair.nodes_of_displacement
    for motion in (one for one in constraints.rigid_motions if one.free):
        dofs = constraints.motion_directions(motion)[0]
        dofs = dofs[dofs < own]
        free[dofs, dofs % dim] = 1.0
    left = np.einsum("nij,nj->ni", free.reshape(-1, dim, dim)[nodes], normals)
    inside = (gaps < -pair.tolerance) & (np.abs(left).max(axis=1, initial=0.0) < _ALONG)
    places = pair.places().round(12) + 0.0
    keys = [
        ([round(gaps[k] / pair.size, 9), *places[k].tolist()], k) for k in np.flatnonzero(inside)
    ]
    if not keys:
        return None
    key, k = min(keys)
    forces = np.zeros(own)
    forces.reshape(-1, dim)[nodes[k]] = normals[k]
    holders = constraints.reactions(forces)
    names = [one.label for one, at, rows in holders if np.any(rows[at == nodes[k]])]
    return key, float(gaps[k]), names


def largest_gap(pair: ContactPair) -> float:
    """Largest gap at the nodes of a contact [m]. Collective."""
    return largest(pair.comm, float(np.max(pair.gaps()[0], initial=0.0)))


def smallest_gap(pair: ContactPair) -> float:
    """Smallest gap at the nodes of a contact [m]. Collective."""
    return smallest(pair.comm, float(np.min(pair.gaps()[0], initial=np.inf)))


@stage("contact")
def begin_motion(problem: Problem, *, warn: bool) -> None:
    """Begins a motion from where surfaces are not deep inside obstacles. Collective.

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
    for term in problem.terms:
        term.begin(moving=True)


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
    result = []
    for pair in problem.contact_pairs:
        gaps = pair.gaps()[0]
        local = [
            (float(gap), tuple(place.round(12).tolist()))
            for gap, place in zip(gaps, pair.places(), strict=True)
            if gap <= np.min(gaps, initial=np.inf) + 1e-9 * pair.size
        ]
        rows = [row for part in pair.comm.allgather(local) for row in part]
        # Nodes that are equally near: the same one on any number of ranks.
        least = min((gap for gap, _ in rows), default=np.inf) + 1e-9 * pair.size
        near = (row for row in rows if row[0] <= least)
        result.append(min(near, key=lambda row: row[1], default=(np.inf, ())))
    return result


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
