"""Replay of the last interval of an explicit motion, to find out why its state is not finite.

A value that is not finite spreads through the mesh within a few steps.  Checking each step would
double its cost, so only yielded states are checked.  The last finite one is saved; if the next one
is not finite, the steps between them are repeated, and after each one det F, the largest
displacement, forces and energies are checked.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dolfin_elastic.core.errors import Diagnosis, StabilityError
from dolfin_elastic.core.parallel import first_of, largest_row, total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.mesh.body import span
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import Restartable, RestartState, SavedState, State, StateCopy
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.evidence import Cells, explained, not_finite, plain
from dolfin_elastic.solvers.dynamics.explicit.monitor import RESISTS, StabilityMonitor
from dolfin_elastic.solvers.dynamics.explicit.stable_step import StepSize

Place = tuple[float, ...]

FAR = 1e6
"""Displacement over the size of the body from which the motion is unbounded."""

SHORTER = "a smaller dt or safety"
CRUSHED = f"{SHORTER}, a finer mesh where the elements are crushed, or a smaller load or velocity"
STRAINED = (
    "a smaller load or velocity; the material cannot be strained further than its formula has "
    f"values; or {SHORTER}"
)


class ExplicitMarch(Restartable[RestartState, SavedState], Protocol):
    """An explicit motion, as far as a replay needs it."""

    problem: Problem
    assembler: Assembler
    size: StepSize

    @property
    def now(self) -> tuple[int, float]:
        """Steps done, and the time [s]."""

    def step(self) -> None:
        """One step. Collective."""

    def finite(self) -> bool:
        """Whether energies and forces are. Collective."""

    def state(self, *, moved: bool) -> State:
        """The present state. Collective."""


class Replay:
    """Finds the first step since the last finite state that fails, and its cause.

    It is made when needed: a motion that owned its replay would form a reference cycle with it,
    which the garbage collector frees at different times on different ranks, but destroying PETSc
    objects is collective.
    """

    def __init__(self, march: ExplicitMarch, monitor: StabilityMonitor, last: StateCopy) -> None:
        self._march, self._monitor, self._last = march, monitor, last
        self._inverted: tuple[int, str, Place] | None = None
        self._unbounded: tuple[int, str, Place] | None = None

    def not_finite(self) -> StabilityError:
        """The error for a state without finite forces or energies. Collective.

        The motion is at an earlier, finite state afterwards.

        Raises:
            InputError: A support or a load has no finite value.
        """
        march = self._march
        with stage("diagnose"), np.errstate(all="ignore"):
            last, t = march.now
            if self._last:
                t = self._step_through(last)
            self._monitor.check_input(march.now[1])
            diagnosis = self._diagnosis()
            state = self._before(march.now[0])
        text = f"no finite motion after t = {t:.6g} s: {diagnosis.text}"
        return StabilityError(text, advice=diagnosis.advice, state=state, diagnosis=diagnosis)

    def _before(self, first: int) -> State:
        """The last state worth looking at. Collective.

        That is the state before the first step that is not finite, or, where cells had turned
        inside out or displacements were unbounded before, the last one without that.

        Args:
            first: Number of the first step that is not finite.
        """
        march, goal = self._march, first - 1
        if self._inverted is not None:
            goal = min(goal, self._inverted[0])
        if self._unbounded is not None:
            goal = min(goal, self._unbounded[0] - 1)
        if self._last:
            march.restore(self._last)
        begin, _ = march.now
        while march.now[0] < goal:
            march.step()
        return march.state(moved=march.now[0] > begin)

    def unstable_step(self, error: StabilityError) -> StabilityError:
        """The error for a step above the stable one, with state and place. Collective.

        If the state is not finite any more, that is the error.

        Args:
            error: The same on all ranks.
        """
        march = self._march
        if not march.finite():
            return self.not_finite()
        state, place = march.state(moved=True), march.size.location()
        unit = march.problem.body.unit
        text = error.what + (f"; elements at {unit.point(place)} ask for it" if place else "")
        cells = Cells(march.assembler).worst()
        diagnosis = Diagnosis("step", text, error.advice, place, cells)
        return StabilityError(text, advice=error.advice, state=state, diagnosis=diagnosis)

    # --- step by step ---

    def _step_through(self, last: int) -> float:
        """Replays up to the first step after which a value is not finite. Collective.

        Args:
            last: Number of the last step to take.

        Returns:
            The time before that step [s].
        """
        march = self._march
        march.restore(self._last)
        before = march.now[1]
        self._inspect("by")
        while march.finite() and march.now[0] < last:
            before = march.now[1]
            march.step()
            self._inspect("in the step to")
        return before

    def _inspect(self, when: str) -> None:
        """Notes when and where cells first turn inside out, and displacements are unbounded.

        Args:
            when: How the time of the message begins: "by" or "in the step to".
        """
        step, t = self._march.now
        when = f"{when} t = {t:.6g} s"
        if self._monitor.nonlinear and self._inverted is None:
            J, middle = self._monitor.watch.smallest()
            if J <= 0.0 and np.isfinite(J):
                self._inverted = step, *self._inversion(J, plain(middle), when)
        if self._unbounded is None:
            (far, place), unit = self._farthest(), self._march.problem.body.unit
            if far > FAR * span(self._march.problem.body):
                at = f"max |u| = {unit.length(far)}, at {unit.point(place)}"
                self._unbounded = step, f"it has grown beyond all bounds {when} ({at})", place

    def _inversion(self, J: float, place: Place, when: str) -> tuple[str, Place]:
        body = self._march.problem.body
        place = place[: body.dim]
        cells = Cells(self._march.assembler)
        many = total(cells.comm, int(np.sum(cells.jacobians() <= 0.0)))
        at = f"det F = {J:.3g}, at {body.unit.point(place)}"
        return f"{messages.count(many, 'element')} turned inside out {when} ({at})", place

    def _farthest(self) -> tuple[float, Place]:
        """Largest nodal displacement, and where; what is not finite is infinite. Collective."""
        problem = self._march.problem
        dim, nodes = problem.body.dim, problem.V.dofmap.index_map.size_local
        u = problem.u.x.array[: nodes * dim].reshape(-1, dim)
        far = np.nan_to_num(np.linalg.norm(u, axis=1), nan=np.inf, posinf=np.inf)
        row = largest_row(problem.body.comm, far, lambda rows: problem.places[rows, :dim])
        return (-1.0, ()) if row is None else (row.value, plain(np.array(row.place)))

    # --- why ---

    def _diagnosis(self) -> Diagnosis:
        """Diagnosis of the present state, the first that is not finite. Collective."""
        cells, dim = Cells(self._march.assembler), self._march.problem.body.dim
        cause, (text, advice, place) = self._why(cells)
        diagnosis = Diagnosis(cause, text, advice, place[:dim], cells.worst())
        return explained(self._march.problem, diagnosis)

    def _why(self, cells: Cells) -> tuple[str, tuple[str, str, Place]]:
        step, t = self._march.now
        lets = f"{RESISTS}, or {SHORTER}"
        if before := self._monitor.inverted:
            return "inverted", (before, lets, self._monitor.place)
        if self._inverted is not None:
            when, text, place = self._inverted
            # A law without a barrier has finite forces for some steps after the inversion.
            return "inverted", (text, CRUSHED if when == step else lets, place)
        if self._unbounded is not None:
            _, text, place = self._unbounded
            return "unbounded", (text, SHORTER, place)
        if (fault := not_finite(cells)) is not None:
            text = f"{fault.text}, at t = {t:.6g} s"
            if fault.inverted:
                return "inverted", (text, CRUSHED, fault.place)
            return "nan", (text, messages.LOAD if fault.load else STRAINED, fault.place)
        place = self._first_without_force()
        at = f" at {self._march.problem.body.unit.point(place)}" if place else ""
        return "nan", (f"forces or energies have no finite value{at}", SHORTER, place)

    def _first_without_force(self) -> Place:
        """Undeformed position of the first node, by coordinates, whose force is not finite [m].

        Collective.
        """
        assembler, problem = self._march.assembler, self._march.problem
        dim = problem.body.dim
        forces = assembler.residual.owned.reshape(-1, dim)
        bad = ~np.isfinite(forces).all(axis=1)
        places = problem.places[: len(forces), :dim][bad]
        return first_of(problem.body.comm, map(plain, places)) or ()
