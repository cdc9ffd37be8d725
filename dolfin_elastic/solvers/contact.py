"""Contact as solvers see it: multipliers that grow until nothing penetrates, and its numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfin_elastic.errors import InputError
from dolfin_elastic.meshes.body import Indices, span
from dolfin_elastic.model.curves import RAMP
from dolfin_elastic.parallel import largest, smallest, total
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import compiled, integral
from dolfin_elastic.solvers.progress import Progress
from dolfin_elastic.touching import Touching

Floats = npt.NDArray[np.float64]

AUGMENTATIONS = 10
"""Times that the multipliers of one load step are renewed."""

SOFT = 0.1
"""Share of the penalty that motion takes.

A node of an explicit scheme that hits in mid-step is thrown back too fast where the penalty is
stiff, see `stable.HIT`; and a stiffer obstacle than the cells above it would only shorten the step.
"""


class Augmentation:
    """Uzawa's iteration: after each equilibrium lam <- max(0, lam - eps g), until gaps are small.

    Args:
        problem: What may touch; without contacts nothing is ever needed.

    Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97, box 1.
    """

    def __init__(self, problem: Problem) -> None:
        self._touching = problem.touching
        for touch in self._touching:
            touch.soften(1.0)
        self._saved: list[Floats] = []
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

    def settle(self, progress: Progress, solve: Callable[[], Progress]) -> Progress:
        """Solves again with new multipliers until nothing penetrates, if that happens. Collective.

        Args:
            progress: Of the equilibrium at hand.
            solve: Finds the next one from there.

        Returns:
            Progress of the last solve, with the iterations of all and the prediction of the first.
        """
        newton, krylov, count = progress.newton, progress.krylov, 0
        predicted = progress.predicted
        while progress.converged and count < AUGMENTATIONS and self.needed():
            self.update()
            progress, count = solve(), count + 1
            newton, krylov = newton + progress.newton, krylov + progress.krylov
        progress.newton, progress.krylov, progress.predicted = newton, krylov, predicted
        return progress


def off_obstacle(touch: Touching) -> float:
    """Largest distance from the obstacle of nodes that press or penetrate [m]. Collective."""
    gaps, _ = touch.gaps()
    return largest(touch.comm, float(np.max(np.abs(gaps[touch.pressing | (gaps < 0)]), initial=0)))


class Measured:
    """Numbers of each contact for states. Collective to make.

    Args:
        problem: What may touch.
        moving: Energies are wanted, too.
    """

    def __init__(self, problem: Problem, *, moving: bool = False) -> None:
        self._problem, self._touching = problem, problem.touching
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
    kept = [float(touch.reach.value) for touch in problem.touching]
    far = 10 * span(problem.body) if problem.touching else 0.0
    try:
        for touch in problem.touching:
            touch.reach.value = max(far, 10 * farthest(touch))
        yield
    finally:
        for touch, value in zip(problem.touching, kept, strict=True):
            touch.reach.value = value


def farthest(touch: Touching) -> float:
    """Largest gap at the nodes of a contact [m]. Collective."""
    return largest(touch.comm, float(np.max(touch.gaps()[0], initial=0.0)))


def nearest_gap(touch: Touching) -> float:
    """Smallest gap at the nodes of a contact [m]. Collective."""
    return smallest(touch.comm, float(np.min(touch.gaps()[0], initial=np.inf)))


def begin_motion(problem: Problem) -> None:
    """Motion has penalties alone, and softer ones. Collective.

    Raises:
        InputError: See `check_start`.
    """
    check_start(problem)
    for touch in problem.touching:
        touch.soften(SOFT)
        touch.lam.x.array[:] = 0.0


def check_start(problem: Problem) -> None:
    """No surface begins deep inside its obstacle. Collective.

    Raises:
        InputError: With place and depth.
    """
    if problem.touching:
        problem.set_time(0.0, default=RAMP)
    for index, touch in enumerate(problem.touching):
        gaps = touch.gaps()[0]
        node = int(np.argmin(gaps)) if len(gaps) else -1
        mine = (float(gaps[node]), touch.places()[node]) if node >= 0 else (np.inf, np.zeros(3))
        gap, place = min(touch.comm.allgather(mine), key=lambda pair: pair[0])
        if gap < -touch.size:
            text = ", ".join(f"{x:.4g}" for x in place)
            raise InputError(
                f"at the start '{touch.label}' lies {-gap:.3g} m deep in the obstacle, "
                f"at ({text}) m",
                where=f"contact[{index}].{touch.contact.shape}",
                expected=f"at most a cell deep, {touch.size:.3g} m; "
                "does the normal point to the free side?",
            )


def out_of_reach(problem: Problem) -> list[str]:
    """Contacts at rest that begin farther away than the body is large, in words. Collective."""
    far = span(problem.body) if problem.touching else 0.0
    gaps = {t.label: nearest_gap(t) for t in problem.touching if not t.contact.values}
    return [
        f"contact '{label}': the obstacle is {gap:.3g} m away, farther than the body is large"
        for label, gap in gaps.items()
        if gap > far
    ]


def rows_of(touch: Touching, within: float) -> tuple[Indices, Floats]:
    """Owned nodes of the displacement at most so far from the obstacle, and its normals there."""
    gaps, normals = touch.gaps()
    near = gaps <= within
    return touch.nodes_of_displacement[near], normals[near]


def touches(touch: Touching) -> int:
    """Nodes that count as touching now. Collective."""
    return int(total(touch.comm, int(np.sum(touch.gaps()[0] <= float(touch.reach.value)))))
