"""All terms of a problem, as solvers see them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import ufl
from dolfinx import fem

from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.term import Acting, Blocks, Kind, ScalarTerm, StepWeights, Term


def forms_of(terms: Sequence[Term], kind: Kind) -> list[ufl.Form]:
    """Those of one kind that the terms have."""
    return [form for term in terms if (form := term.form(kind)) is not None]


class Terms(list[Term]):
    """All terms of a problem."""

    @property
    def memory(self) -> dict[str, fem.Function]:
        """What they remember, by its name in restarts."""
        return {name: field for term in self for name, field in term.memory.items()}

    @property
    def past(self) -> dict[str, fem.Function]:
        """What of it changes with each step of a motion, too."""
        followers = Terms(term for term in self if term.follows_path)
        return followers.memory

    @property
    def opens(self) -> bool:
        """Forces of some begin and end."""
        return any(term.opens for term in self)

    @property
    def follows_path(self) -> bool:
        """See `Term`: of any."""
        return any(term.follows_path for term in self)

    @property
    def dissipates(self) -> bool:
        """See `Term`: any does."""
        return any(term.dissipates for term in self)

    @property
    def scalars(self) -> list[ScalarTerm]:
        """Those with scalar unknowns."""
        return [term for term in self if isinstance(term, ScalarTerm) and term.size]

    def blocks(self) -> Blocks | None:
        """The blocks of all terms; None where no term has any. Collective."""
        result = [blocks for term in self if (blocks := term.blocks()) is not None]
        return sum(result[1:], result[0]) if result else None

    @property
    def joins(self) -> bool:
        """See `Term`: any does."""
        return any(term.joins for term in self)

    @property
    def bars(self) -> bool:
        """See `Term`: of any."""
        return any(term.bars for term in self)

    def longest_step(self, motion: FloatArray) -> float:
        """See `Term`: of all terms."""
        return min((term.longest_step(motion) for term in self), default=1.0)

    def make_convex(self) -> bool:
        """See `Term`: of all terms."""
        changed = [term.make_convex() for term in self]
        return any(changed)

    @contextmanager
    def assumed(self, *, closed: bool, near: bool = False) -> Iterator[None]:
        """Within it all that may open is closed, or all of it is open. Not collective.

        Args:
            near: See `Term.assume`.
        """
        try:
            for term in self:
                term.assume(closed, near=near)
            yield
        finally:
            for term in self:
                term.assume(None)

    def begin_step(self) -> None:
        """See `Term`."""
        for term in self:
            term.begin_step()

    @property
    def poses(self) -> list[FloatArray | None]:
        """A copy of the pose of each."""
        return [None if term.pose is None else term.pose.now for term in self]

    def enter_stage(self, step: StepWeights, poses: Sequence[FloatArray | None]) -> None:
        """See `Term`.

        Args:
            poses: Of each at the end of the step.
        """
        for term, pose in zip(self, poses, strict=True):
            term.enter_stage(step, pose)

    def follow(self) -> None:
        """See `Term`."""
        for term in self:
            term.follow()

    def leave_stage(self, *, found: bool) -> None:
        """See `Term`."""
        for term in reversed(self):  # friction while contact has the pressures of the stage
            term.leave_stage(found=found)

    def within_stride(self, t: float, goal: float, acting: Acting) -> float:
        """See `Term`: of all terms, each at the end that the others allow."""
        before = np.inf
        while goal < before:
            before = goal
            for term in self:
                goal = term.within_stride(t, goal, acting)
        return goal

    def begin(self, *, moving: bool) -> None:
        """A run begins, in motion or in statics: from here, too. Collective."""
        for term in self:
            term.begin(moving=moving)
        self.commit()

    def commit(self) -> None:
        """See `Term`."""
        for term in self:
            term.commit()

    def advance(self) -> None:
        """See `Term`."""
        for term in self:
            term.advance()

    def rollback(self) -> None:
        """See `Term`."""
        for term in self:
            term.rollback()

    def unsettled(self) -> bool:
        """See `Term`: of any."""
        return any(term.unsettled() for term in self)

    @stage("contact")
    def solve_again(self) -> bool:
        """Whether the equilibrium is none with what the terms learn of it: all do so. Collective.

        Augmented Lagrangian of contact (Uzawa), lam <- max(0, lam - eps g) until gaps are small.
        Source: J. C. Simo & T. A. Laursen, Computers & Structures 42 (1992) 97, box 1.
        """
        if not self.unsettled():
            return False
        for term in reversed(self):  # friction by the pressure that was found
            term.augment()
        return True

    def results(self, forces: FloatArray) -> dict[str, float]:
        """Their results by name [SI units], see `Term.add_results`. Collective."""
        result: dict[str, float] = {}
        for term in self:
            term.add_results(result, forces)
        return result


def conserve_in_steps(terms: Terms) -> bool:
    """Some forces begin and end, and those of a step do the work that these terms store."""
    return terms.opens and all(term.in_steps for term in terms if term.opens)


def intrusion(terms: Terms) -> tuple[str, tuple[float, ...], str] | None:
    """See `Term`: of the first that has one. Collective."""
    found = (term.intrusion() for term in terms)
    return next((one for one in found if one is not None), None)


def passed(terms: Terms, back: FloatArray, poses: Sequence[FloatArray | None]) -> bool:
    """Whether the motion back to a former state leads through any obstacle. Collective.

    Args:
        back: See `Term.longest_step`.
        poses: Of the obstacles in that state, see `Terms.poses`.
    """
    pairs = zip(terms, poses, strict=True)
    return any(
        term.passes(back, pose) for term, pose in pairs if pose is not None and not term.joins
    )


def refuse_motion(terms: Terms) -> None:
    """Refuses scalar unknowns, which motion does not have.

    Raises:
        InputError: The first one.
    """
    for term in terms.scalars:
        raise term.without_motion()


def refuse_rest(terms: Terms) -> None:
    """Refuses equilibria of what is computed in motion only.

    Raises:
        InputError: The first such term.
    """
    for term in terms:
        if (error := term.without_rest()) is not None:
            raise error
