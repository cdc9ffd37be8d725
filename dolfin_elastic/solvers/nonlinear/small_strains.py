"""Laws for small strains that are used beyond them."""

from __future__ import annotations

import logging

from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

log = logging.getLogger("dolfin_elastic")

SMALL_STRAINS = 0.1
"""|grad u| up to which laws for small strains may be trusted: they leave out terms of its square,
one percent."""


class SmallStrains:
    """Says once that a law for small strains sees large ones.  Collective to make.

    Args:
        problem: Its laws.
        watch: Of its displacement gradient; made here if none is given and one is needed.

    Attributes:
        note: What has been said; nothing at first.
    """

    def __init__(self, problem: Problem, watch: JacobianWatch | None = None) -> None:
        self.note, self._dim = "", problem.body.dim
        self._names = ", ".join(sorted({p.law.name() for p in problem.parts if p.law.linear}))
        self._watch = (watch or JacobianWatch(problem)) if self._names else None

    def look(self, when: str) -> None:
        """Looks at the present displacement, unless all has been said. Collective.

        Args:
            when: Load factor or time, for the message.
        """
        if self._watch is None or self.note:
            return
        steepest, place = self._watch.steepest()
        if steepest <= SMALL_STRAINS:
            return
        self.note = (
            f"the law {self._names} is for small strains and rotations, but |grad u| is "
            f"{steepest:.2g} at {coordinates(place[: self._dim])} m ({when}): st-venant-kirchhoff "
            "or neo-hookean follow large ones"
        )
        log.warning("%s", self.note)
