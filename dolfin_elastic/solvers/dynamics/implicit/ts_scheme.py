"""Generalized-alpha and its relatives as a type of PETSc's TS.

TS owns time: the loop, the control of the step, monitors, events and options.  What it asks of a
scheme is here: to take a step, to take it back, and what to compare it with.  The scheme keeps the
acceleration, which PETSc's own TSALPHA2 hides, so that a motion can be restarted exactly.
"""

from __future__ import annotations

import logging

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError, StoppedError
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.dynamics.implicit.scheme import (
    FAILURES,
    ImplicitScheme,
    SchemeContext,
    StepForces,
)
from dolfin_elastic.solvers.dynamics.implicit.stage import Stage, StageSolver, StepStart
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.petsc.c_api import choose_step

log = logging.getLogger("dolfin_elastic")


class ImpactError:
    """Contact forces at the ends of a step and at its stage.  Collective.

    The forces of a step are those of its stage. A surface that hits an obstacle after the stage may
    lie deep in it, or behind it, at the end of the step, and the acceleration of the scheme knows
    nothing of that. While the same nodes are in contact, their penalty forces p are almost linear
    in the displacement: (1 - alpha_f) p1 + alpha_f p0 = p_s. The difference of p1 from that, over
    the mass, is the error of the acceleration at the end; the displacement's is h^2/6 times that,
    its weight where accelerations are linear in time: Zienkiewicz & Xie (1991), see
    `generalized_alpha`.

    Args:
        alpha_f: Share of the old displacement in the stage's.
    """

    def __init__(self, moving: DynamicResidual, alpha_f: float) -> None:
        self._moving, self._share = moving, alpha_f
        mass = moving.mass.array_r[moving.displacement_dofs]
        self._mobility = np.divide(1.0, mass, out=np.zeros(len(mass)), where=mass > 0.0)
        self._first: FloatArray = np.zeros(len(mass))
        self._stage: FloatArray = self._first

    def _contact_forces(self) -> FloatArray:
        """Nodal forces of all contacts at the present displacement and time, owned entries [N]."""
        return np.asarray(self._moving.contact_forces().sum(axis=0))

    def begin(self, t: float) -> None:
        """Stores the contact forces at the start of a step.

        Args:
            t: Time of the start [s].
        """
        self._moving.problem.set_time(t)
        self._first = self._contact_forces()

    def at_stage(self, forces: Forces) -> None:
        """Stores the contact forces at its stage."""
        self._stage = forces.contact.sum(axis=0)

    def error(self, h: float) -> FloatArray:
        """Error of the displacement at the end of the step, where the problem is now [m].

        Args:
            h: The step [s].
        """
        expected = (self._stage - self._share * self._first) / (1 - self._share)
        return np.asarray(-h * h / 6 * (self._contact_forces() - expected) * self._mobility)


CHANGED = 1e-9
"""Relative change of the loads at one time from which a program has changed them."""


class GeneralizedAlphaScheme(ImplicitScheme):
    """The Python context of a TS of type "python", for any `GeneralizedAlphaParameters`.

    Attributes:
        impact_error: Error estimate of contacts, where steps are adaptive.
    """

    def __init__(self, context: SchemeContext) -> None:
        super().__init__(context)
        self._a, self._control = context.a, context.control
        self._parameters = context.parameters
        context.ts.setType("python")
        context.ts.setPythonContext(self)
        self._stages = StageSolver(context)
        # With alpha_f = 0 the stage is the end of the step: no contact there is unseen.
        share = self._parameters.alpha_f
        estimated = context.adaptive and self.problem.terms.opens and share > 0
        self.impact_error = ImpactError(self.moving, share) if estimated else None
        self._start: StepStart | None = None
        self._stage: Stage | None = None
        self._stage_forces: Forces | None = None
        self._end_forces: Forces | None = None
        self._old_end_forces: Forces | None = None
        self._accepted: StepForces | None = None
        self._largest_load = 0.0
        self._higher_order: FloatArray | None = None

    # --- what the motion asks for ---

    def start(self, t: float) -> None:
        """See `ImplicitScheme.start`.

        Args:
            t: Time [s].
        """
        self.acceleration.x.array[:] = self._a.x.array
        self.resume(t)

    def resume(self, t: float) -> None:
        """See `ImplicitScheme.resume`.

        Args:
            t: Time [s].
        """
        if not self._midpoint:
            self._end_forces = self._forces_at(t)

    def loads_changed(self, t: float) -> bool:
        """See `ImplicitScheme.loads_changed`.

        Args:
            t: Time of the state [s].
        """
        if self._end_forces is None:
            return False
        before, now = self._end_forces.loads, self._forces_at(t).loads
        sums = np.array([np.sum((now - before) ** 2), np.sum(before**2), np.sum(now**2)])
        change, *size = total(self.assembler.comm, sums)
        # Loads that pass zero are compared with the largest so far.
        self._largest_load = max(self._largest_load, *size)
        return bool(change > CHANGED**2 * self._largest_load)

    def accept(self) -> StepForces:
        """See `ImplicitScheme.accept`."""
        assert self._accepted is not None
        return self._accepted

    def balance_at_end(self, t: float) -> None:
        """See `ImplicitScheme.balance_at_end`.

        Args:
            t: Time [s].
        """
        if self._midpoint:  # else it was assembled when the step was accepted
            self._forces_at(t)

    def counts(self) -> tuple[int, int]:
        """See `ImplicitScheme.counts`."""
        return self._stages.newton_iterations, self._stages.krylov_iterations

    def close(self) -> None:
        """Frees what it owns."""
        self._stages.destroy()

    @property
    def _midpoint(self) -> bool:
        """The stage is the middle of the step, so its forces give the work to second order."""
        return self._parameters.alpha_f == 0.5

    def _forces_at(self, t: float) -> Forces:
        """The forces at the present state; `assembler.residual.vector` holds them then."""
        size = len(self.moving.displacement_dofs)
        return self.moving.forces_at(t, self.v.x.array[:size], self.acceleration.x.array[:size])

    # --- what TS asks for ---

    def step(self, ts: PETSc.TS) -> None:
        """Takes one step, smaller where it must be."""
        try:
            solution = self._take_step(ts)
        except (InputError, StoppedError) as error:  # the same on all ranks
            self.error, solution = error, False
        if not solution:
            ts.setConvergedReason(PETSc.TS.ConvergedReason.DIVERGED_NONLINEAR_SOLVE)

    def _take_step(self, ts: PETSc.TS) -> bool:
        """Takes one step, as small as necessary; returns whether one was found.

        Two loops, for a step is made smaller for two reasons.  The inner one is TSAdapt's: the step
        was solved, but its error is too large; TSAdapt says how long the next try is, and sees to
        it that this ends.  The outer one is for steps without a solution, of which TSAdapt knows
        nothing: a quarter of the length, at most `FAILURES` times.  A step whose stage is found but
        whose end has cells inside out counts as one without a solution, for its error estimate is
        worthless; unless cells were inside out before: then no shorter step puts that right.
        """
        U, V = ts.getSolution2()
        start = self._start = self._present(float(ts.getTime()))
        self._stages.begin(start.t)
        if self.impact_error is not None:
            self.impact_error.begin(start.t)
        inverted = _inverted(self.context)
        for failure in range(FAILURES + 1):
            while (solution := self._stages.solve(start, float(ts.getTimeStep()))) is not None:
                self._advance(*solution, U, V)
                if not self._upright_at_end() and not inverted:
                    break
                self._control.set_error_scale()
                h, good = choose_step(ts, self._parameters.order)
                if good:
                    self._finish(ts, h)
                    return True
                self._put_back(U, V)
                ts.setTimeStep(h)
            if failure == FAILURES:
                break
            log.debug("t = %g: no solution for a step of %g s", ts.getTime(), ts.getTimeStep())
            self._put_back(U, V)
            ts.setTimeStep(0.25 * ts.getTimeStep())
        return False

    def evaluatestep(self, ts: PETSc.TS, order: int, x: PETSc.Vec) -> bool:
        """The displacement of one order more, with which TSAdapt compares the step.

        Args:
            order: Asked for; there is one only.
            x: Receives all unknowns.
        """
        assert self._higher_order is not None
        ts.getSolution().copy(x)
        x.array_w[self.moving.displacement_dofs] = self._higher_order
        return True

    def rollback(self, ts: PETSc.TS) -> None:
        """Takes the last step back, for an event within it."""
        self._end_forces = self._old_end_forces
        self._put_back(*ts.getSolution2())

    def interpolate(self, ts: PETSc.TS, t: float, x: PETSc.Vec) -> None:
        """The displacement within the last step: the cubic through both ends and velocities.

        Args:
            ts: Its time is that of the end of the step.
            t: Time within the step [s].
            x: Receives all unknowns, of which scalar fields are those of the end.
        """
        assert self._start is not None
        assert self._stage is not None
        old, now, h = self._start, self._present(float(ts.getTime())), self._stage.h
        s = (t - old.t) / h
        ts.getSolution().copy(x)
        x.array_w[self.moving.displacement_dofs] = (
            (1 + 2 * s) * (1 - s) ** 2 * old.u
            + s * (1 - s) ** 2 * h * old.v
            + s * s * (3 - 2 * s) * now.u
            + s * s * (s - 1) * h * now.v
        )

    # --- one step ---

    def _present(self, t: float) -> StepStart:
        moves, size = self.moving.displacement_dofs, len(self.moving.displacement_dofs)
        w = self.problem.w.x.array[: self.assembler.size].copy()
        return StepStart(
            t, w, w[moves], self.v.x.array[:size].copy(), self._a.x.array[:size].copy()
        )

    def _upright_at_end(self) -> bool:
        """Whether det F > 0 where it must be, at the end of the step.

        If not, Newton's result is marked for diagnosis.
        """
        if self.problem.linear:
            return True
        value, place = self.context.watch.refused()
        if value > 0.0:
            return True
        self.newton.reject(value, place)
        return False

    def _advance(self, stage: Stage, offset: FloatArray, U: PETSc.Vec, V: PETSc.Vec) -> None:
        """From the stage to the end of the step.

        Scalar fields have no inertia and no rate: they stay those of the stage, for extrapolated
        ones would swing from step to step.

        Args:
            stage: Which was found; the problem holds it.
            offset: Displacement of the end less that of the predictor [m].
            U: Receives all unknowns.
        """
        self._stage, old, p = stage, stage.start, self._parameters
        self._stage_forces = self.moving.forces()
        self.problem.terms.leave_stage(found=True)
        if self.impact_error is not None:
            self.impact_error.at_stage(self._stage_forces)
        size = len(self.moving.displacement_dofs)
        w = self.problem.w.x.array[: self.assembler.size].copy()
        u = stage.displacement_at_end(offset)
        v, a = stage.rates_at_end(offset)
        w[self.moving.displacement_dofs] = u
        self.moving.set_unknowns(w)
        at_end = p.at_end(old.a, a)
        if self._stages.keeps_volumes and p.midpoint:
            a, at_end = _of_the_middle(stage, a)
        self.problem.constraints.impose(at_end, stage.a_end)
        for field, values in ((self.v, v), (self._a, a), (self.acceleration, at_end)):
            field.x.array[:size] = values
            field.x.scatter_forward()
        self.moving.copy_to(U, V, self.v)
        self.problem.set_time(old.t + stage.h)
        error = p.error((old.v, v), (old.a, a), stage.h)
        if self.impact_error is not None:
            error += self.impact_error.error(stage.h)
        # What is prescribed has no error, whatever its acceleration does.
        self._higher_order = u - self.problem.constraints.free_part(error)

    def _finish(self, ts: PETSc.TS, h: float) -> None:
        """Stores the accepted step and the size of the next one [s]."""
        assert self._stage is not None
        assert self._stage_forces is not None
        start = self._stage.start
        end = self._control.without_round_off(start.t + self._stage.h)
        middle, contact, p = self._stage_forces, None, self._parameters
        if not self._midpoint:
            self._old_end_forces, self._end_forces = self._end_forces, self._forces_at(end)
            assert self._old_end_forces is not None
            middle = self._old_end_forces.mean(self._end_forces)
            if p.alpha_f == 0.0:
                late = min(p.gamma, 1.0)
                before, after = self._old_end_forces.contact, self._end_forces.contact
                contact = (1 - late) * before + late * after
        u = self.problem.w.x.array[self.moving.displacement_dofs]
        self._accepted = StepForces(self._stage_forces, middle, u - start.u, contact)
        ts.setTime(end)
        ts.setTimeStep(h)

    def _put_back(self, U: PETSc.Vec, V: PETSc.Vec) -> None:
        """Goes back to the state that the step began with."""
        old, size = self._start, len(self.moving.displacement_dofs)
        assert old is not None
        self.moving.set_unknowns(old.w)
        for field, values in ((self.v, old.v), (self._a, old.a)):
            field.x.array[:size] = values
            field.x.scatter_forward()
        self.moving.copy_to(U, V, self.v)


def _inverted(context: SchemeContext) -> bool:
    """Whether a cell is inside out that must not be.

    False for linear laws, where det F has no meaning.
    """
    return not context.moving.problem.linear and context.watch.refused()[0] <= 0.0


def _of_the_middle(stage: Stage, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The acceleration of the midpoint rule, and at the end of the step [m/s^2].

    Where volumes are kept the one at the end, twice the mean less the old one, would swing more
    and more.  The rule needs the mean only, so that is kept in its place; at the end it is
    extrapolated from those of two steps, to second order but in the very first step.

    Args:
        a: The acceleration of the formulas at the end [m/s^2].
    """
    old = stage.start.a
    mean = np.asarray((a + old) / 2)
    at_end = mean + (mean - old) / 2
    stage.prescribed.impose(mean, stage.a_end)
    return mean, at_end
