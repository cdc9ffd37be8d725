"""Work of loads and supports in explicit motion, summed up no more often than it must be."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import ufl
from dolfinx import fem, la

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.loads.contact import ContactPair
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.assembly.nodal_forces import Forces


class _Share(Protocol):
    """What does work that must be summed up step by step."""

    def begin(self) -> None:
        """Takes in the state from which the next step starts. Collective."""

    def renew(self) -> None:
        """Takes over the numbers of the present time. Not collective."""

    def step(self, du: FloatArray) -> float:
        """This rank's share of the work of a step with the displacement du [J]. Collective."""


class _Pushing:
    """Forces on nodes that are in a form of their own, by the trapezoidal rule."""

    def __init__(self, forces: Forces) -> None:
        self._forces = forces
        self._before = np.zeros(len(forces.owned))

    def begin(self) -> None:
        self._forces.assemble()
        self._before[:] = self._forces.owned

    def renew(self) -> None:
        self._forces.renew()

    def step(self, du: FloatArray) -> float:
        self._forces.assemble()
        now = self._forces.owned
        work = 0.5 * (np.dot(self._before, du) + np.dot(now, du))
        self._before[:] = now
        return float(work)


class _Obstacle:
    """A moving obstacle: its force on the body, times the way that it has gone."""

    def __init__(self, touch: ContactPair, forces: Forces) -> None:
        self._touch, self._forces = touch, forces
        self._dim = len(touch.shift.value)
        self._force = self._place = np.zeros(self._dim)

    def begin(self) -> None:
        self._forces.assemble()
        self._force = self._forces.owned.reshape(-1, self._dim).sum(axis=0)
        self._place = self._touch.shift.value.copy()

    def renew(self) -> None:
        self._forces.renew()

    def step(self, du: FloatArray) -> float:
        force, place = self._force, self._place
        self.begin()
        return float((force + self._force) @ (self._place - place)) / 2


class _Leading:
    """Supports that move: what they push with, beside the inertia of what they carry."""

    def __init__(self, assembler: Assembler) -> None:
        self._assembler = assembler
        self._reactions = np.zeros(assembler.size)

    def begin(self) -> None:
        a = self._assembler
        self._reactions = a.constrained_part(a.residual.owned)

    def renew(self) -> None: ...

    def step(self, du: FloatArray) -> float:
        before = self._reactions
        self.begin()
        return float(np.dot(before + self._reactions, self._assembler.constrained_part(du))) / 2


class ExternalWork:
    """Work on the body, and on the penalties of obstacles, since the start. Collective to make.

    What follows from two states waits until it is asked for: of loads that do not change, force
    times displacement; of springs at rest, their energy; of the mass that supports move, its
    kinetic energy.  Obstacles at rest do no work.  The rest is summed up step by step by the
    trapezoidal rule: loads that change, springs whose base moves, dashpots, and supports and
    obstacles that move.

    Args:
        problem: What moves.
        assembler: Of this problem.
        mass: Lumped mass at every owned entry [kg].
        v: Velocity.

    Attributes:
        sum: The work at the last state asked for [J].
        shares: What must be summed up step by step.
    """

    def __init__(
        self, problem: Problem, assembler: Assembler, mass: FloatArray, v: fem.Function
    ) -> None:
        self._problem, self._assembler, self._mass = problem, assembler, mass
        size = assembler.size
        self._u, self._v = problem.u.x.array[:size], v.x.array[:size]
        self.shares: list[_Share] = []
        loaded = bool(problem.loads)
        if loaded and problem.loads_change:
            self.shares.append(_Pushing(self._of(self._external(), points=1.0)))
        self._steady = loaded and not problem.loads_change
        self._constant = np.zeros(size if self._steady else 0)
        self._from = np.zeros(len(self._constant))
        resting = all(spring.at_rest for spring in problem.springs)
        for support in problem.supports:
            if support in problem.dashpots or (support in problem.springs and not resting):
                work = support.virtual_work(problem.context)
                self.shares.append(_Pushing(self._of(work)))
        self.leading = supports_move(problem)
        if self.leading:
            self.shares.append(_Leading(assembler))
        for touch in problem.contact_pairs:
            if touch.contact.values:
                self.shares.append(_Obstacle(touch, self._of(touch.work)))
        springs = problem.weak_form.spring_energy if resting else None
        self._springs = None if springs is None else compiled(problem, [springs])[0]
        self._stored = self._carried = self._local = self.sum = 0.0

    def _external(self) -> ufl.Form:
        problem = self._problem
        if problem.weak_form.external is not None:
            return problem.weak_form.external
        return (
            problem.constant(0.0) * sum(problem.v) * problem.weak_form.volume(None, 1)
        )  # points only

    def _of(self, form: ufl.Form, points: float = 0.0) -> Forces:
        dofmap = self._problem.V.dofmap
        vector = la.vector(dofmap.index_map, dofmap.index_map_bs)
        return Forces(self._problem, compiled(self._problem, [form])[0], vector, points=points)

    def begin(self, work: float = 0.0) -> None:
        """Takes in the state from which the next step starts. Collective.

        Args:
            work: Done so far [J].
        """
        self.sum, self._local = work, 0.0
        if self._steady:
            self._constant[:] = self._assembler.reactions.loads()
            self._from[:] = self._u
        self._stored, self._carried = self._in_springs(), self._on_supports()
        for share in self.shares:
            share.begin()

    def renew(self) -> None:
        """Takes over the numbers of the present time. Not collective."""
        for share in self.shares:
            share.renew()

    def step(self, du: FloatArray) -> None:
        """Adds a step that has led to the present state; for nothing without `shares`. Collective.

        Args:
            du: Its displacement, owned entries [m].
        """
        for share in self.shares:
            self._local += share.step(du)

    def close(self) -> float:
        """The work up to the present state [J]. Collective."""
        local, self._local = self._local, 0.0
        if self._steady:
            local += float(np.dot(self._constant, self._u) - np.dot(self._constant, self._from))
            self._from[:] = self._u
        stored, carried = self._in_springs(), self._on_supports()
        local += carried - self._carried
        self.sum += float(total(self._problem.body.comm, local)) - (stored - self._stored)
        self._stored, self._carried = stored, carried
        return self.sum

    def _in_springs(self) -> float:
        """Energy of springs at rest [J]. Collective."""
        return 0.0 if self._springs is None else integral(self._problem, self._springs)

    def _on_supports(self) -> float:
        """This rank's kinetic energy of what supports move [J]."""
        if not self.leading:
            return 0.0
        v = self._assembler.constrained_part(self._v)
        return 0.5 * float(np.dot(self._mass * v, v))


def supports_move(problem: Problem) -> bool:
    """A prescribed displacement is not zero."""
    return any(not s.at_rest for s in problem.supports if s not in problem.springs)
