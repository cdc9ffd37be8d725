"""A step of generalized-alpha and its relatives as a type of PETSc's TS.

TS owns time: the loop, the control of the step, monitors, events and options.  What it asks of a
scheme is here: to take a step, to take it back, and what to compare it with.  The scheme keeps the
acceleration, which PETSc's own TSALPHA2 hides, so that a motion can be stopped and gone on with.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.mass import free, held_rates
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import Scheme
from dolfin_elastic.solvers.dynamics.implicit.impact_error import ImpactError
from dolfin_elastic.solvers.dynamics.implicit.volume_constraint import VolumeConstraint
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.petsc.ts_adapt import choose

log = logging.getLogger("dolfin_elastic")

FAILURES = 8
"""Times that one step is made smaller, to a quarter each, before it is given up."""


Done = tuple[Forces, Forces, FloatArray]


@dataclass(frozen=True)
class StepStart:
    """Where a step begins: owned entries.

    Attributes:
        t: Time [s].
        w: All unknowns.
        u: Displacement [m].
        v: Velocity [m/s].
        a: Acceleration of the scheme [m/s^2].
    """

    t: float
    w: FloatArray
    u: FloatArray
    v: FloatArray
    a: FloatArray


class GeneralizedAlphaStepper:
    """The Python context of a TS of type "python".  All of it is collective.

    Args:
        moving: The body.
        v: Velocity, changed by steps.
        a: Acceleration of the scheme, changed by steps.
        scheme: Its parameters.
        order: Power of the step that its error grows with.

    Attributes:
        newton: Set by whoever has the TS and its SNES.
        done: Of the last step the forces of its stage, those of its middle, and the change of the
            displacement; nothing counts before TS has accepted it for good.
        reached: From a time to the one that was meant, without the round-off of a sum.
        weigh: Tells TS, at the end of a step, what errors are judged against.
        strikes: Of obstacles, where errors count.
        error: A fault of the input that a step has met; PETSc would lose it.
        newton_iterations, krylov_iterations: Of all solves so far.
    """

    def __init__(
        self, moving: DynamicResidual, v: fem.Function, a: fem.Function, scheme: Scheme, order: int
    ) -> None:
        self.moving, self.problem, self.assembler = moving, moving.problem, moving.assembler
        self.scheme, self.v, self.a, self._order = scheme, v, a, order
        self.newton: Newton
        self.done: Done | None = None
        self.reached: Callable[[float], float] = lambda t: t
        self.weigh: Callable[[], None] = lambda: None
        self.strikes: ImpactError | None = None
        self.error: InputError | None = None
        self.newton_iterations = self.krylov_iterations = 0
        self.at_end = fem.Function(self.problem.V, name="acceleration")
        linear = self.problem.linear
        self.watch: JacobianWatch | None = None if linear else JacobianWatch(self.problem)
        volumes = VolumeConstraint.needed(self.problem, scheme.alpha_f)
        self._volumes = VolumeConstraint(self.assembler, scheme.alpha_f) if volumes else None
        self._before: StepStart | None = None
        self._ends: Forces | None = None
        self._old_ends: Forces | None = None
        nothing: FloatArray = np.empty(0)
        self._goal = self._end_values = self._held_stage = self._ahead = self._off = nothing
        self._held_rates = nothing, nothing
        self._h = 0.0
        self._hat: FloatArray | None = None

    def start(self, t: float) -> None:
        """Looks at the state that the next step begins with."""
        if self.scheme.alpha_f != 0.5:
            self._ends = self.look(t)

    def look_at_end(self, t: float) -> None:
        """Assembles the residual's vector at the present state, if it is not yet."""
        if self.scheme.alpha_f == 0.5:
            self.look(t)

    def look(self, t: float) -> Forces:
        """The forces at the present state, at a time; the residual's vector is theirs then."""
        size = len(self.moving.moves)
        return self.moving.forces_at(t, self.v.x.array[:size], self.at_end.x.array[:size])

    # --- what SNES asks for: how far the stage is off what was predicted ---

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Out-of-balance forces of the stage, with inertia."""
        v, a = self._rates(x.array_r[self.moving.moves])
        self.moving.set_stage_rates(v, a)
        with stage("assemble"):
            self.assembler.put(x)
            self.assembler.residual.assemble()
            if self._volumes is not None:
                self._volumes.complete()
        self.assembler.residual.constrain(f, target=self._goal)

    def tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Derivative of the residual by the stage's displacement."""
        self.assembler.tangent.assemble(x, self.moving.factor)
        self.newton.take_tangent(P)

    def _rates(self, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity and acceleration of the stage from how far it is off what was predicted."""
        assert self._before is not None
        s, old = self.scheme, self._before
        v1, a1 = self._rates_at_end(np.asarray(off / (1 - s.alpha_f)))
        v = (1 - s.alpha_f) * v1 + s.alpha_f * old.v
        a = (1 - s.alpha_m) * a1 + s.alpha_m * old.a
        self.problem.dirichlet.impose(a, self._held_stage)
        return v, a

    def _rates_at_end(self, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity and acceleration at the end of the step, from how far its place is off.

        Those of prescribed motion are its own: by the formulas of the scheme an error of them, at
        a kink of a curve, would hardly ever die out, and grow as steps become smaller.
        """
        assert self._before is not None
        s, old, held = self.scheme, self._before, self.problem.dirichlet
        a = s.acceleration(off, old.a, self._h)
        v = s.velocity(old.v, old.a, a, self._h)
        held.impose(v, self._held_rates[0])
        held.impose(a, self._held_rates[1])
        return v, a

    # --- what TS asks for ---

    def step(self, ts: PETSc.TS) -> None:
        """Takes one step, smaller where it must be."""
        try:
            found = self._found(ts)
        except InputError as error:  # the same on all ranks
            self.error, found = error, False
        if not found:
            ts.setConvergedReason(PETSc.TS.ConvergedReason.DIVERGED_NONLINEAR_SOLVE)

    def _found(self, ts: PETSc.TS) -> bool:
        """Takes one step; whether there was one, however small."""
        U, V = ts.getSolution2()
        self._before = self._here(float(ts.getTime()))
        if self._volumes is not None:
            self._volumes.begin(self._before.t)
        if self.strikes is not None:
            self.strikes.begin(self._before.t)
        crushed = self._crushed()
        for failure in range(FAILURES + 1):
            while self._solved(float(ts.getTimeStep())):
                if not self._advance(U, V) and not crushed:
                    break
                self.weigh()
                h, good = choose(ts, self._order)
                if good:
                    self._accept(ts, h)
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
        """What TSAdapt compares the step with: the displacement of one order more."""
        assert self._hat is not None
        ts.getSolution().copy(x)
        x.array_w[self.moving.moves] = self._hat
        return True

    def rollback(self, ts: PETSc.TS) -> None:
        """Takes the last step back, for an event within it."""
        self._ends = self._old_ends
        self._put_back(*ts.getSolution2())

    def interpolate(self, ts: PETSc.TS, t: float, x: PETSc.Vec) -> None:
        """The displacement within the last step: the cubic through both ends and velocities."""
        assert self._before is not None
        old, now, h = self._before, self._here(float(ts.getTime())), self._h
        s = (t - old.t) / h
        ts.getSolution().copy(x)
        x.array_w[self.moving.moves] = (
            (1 + 2 * s) * (1 - s) ** 2 * old.u
            + s * (1 - s) ** 2 * h * old.v
            + s * s * (3 - 2 * s) * now.u
            + s * s * (s - 1) * h * now.v
        )

    # --- one step ---

    def _here(self, t: float) -> StepStart:
        moves, size = self.moving.moves, len(self.moving.moves)
        w = self.problem.w.x.array[: self.assembler.size].copy()
        return StepStart(t, w, w[moves], self.v.x.array[:size].copy(), self.a.x.array[:size].copy())

    def _crushed(self) -> bool:
        """Cells are inside out already: then nothing is to be kept from it."""
        return self.watch is not None and self.watch.smallest()[0] <= 0.0

    def _solved(self, h: float) -> bool:
        """Solves for the stage; the problem holds it then, or the last iterate."""
        old, s = self._before, self.scheme
        assert old is not None
        self._h = h
        rate, shift = self.scheme.shifts(h)  # residuals, too, look at them: for prescribed values
        self.moving.shift.value, self.moving.drag.value = shift, rate
        goal = self._prescribed_at(old.t + h)
        held = self.problem.dirichlet.extract(self.problem.u.x.array)
        self._held_rates = held_rates(self.problem, old.t + h, h)
        was = self.problem.dirichlet.extract(self.a.x.array)
        self._held_stage = (1 - s.alpha_f) * self._held_rates[1] + s.alpha_f * was
        self._end_values = goal
        self._goal = s.alpha_f * held + (1 - s.alpha_f) * goal
        self.problem.set_time(old.t + (1 - s.alpha_f) * h)
        self._ahead = s.predicted(old.v, old.a, h)
        if self._volumes is not None:
            self._volumes.end = old.t + h
        origin = self.assembler.origin
        origin[:] = old.w
        origin[self.moving.moves] += (1 - s.alpha_f) * self._ahead
        try:
            return any(self._solved_from(start) for start in self._starts())
        finally:
            origin[:] = 0.0

    def _solved_from(self, start: FloatArray) -> bool:
        self._put_unknowns(start)
        progress = self.newton.solve(self.newton.line_searches()[0])
        while "LINEAR_SOLVE" in progress.reason and self.newton.fall_back():
            self._put_unknowns(start)
            progress = self.newton.solve(self.newton.line_searches()[0])
        self.newton_iterations += progress.newton
        self.krylov_iterations += progress.krylov
        off = self.newton.solution()[self.moving.moves]
        self._off = np.asarray(off / (1 - self.scheme.alpha_f))
        return progress.converged

    def _prescribed_at(self, t: float) -> FloatArray:
        """Prescribed values at the end of the step, where loads, too, must have values."""
        self.problem.set_time(t)
        self.problem.dirichlet.check_finite()
        if self.problem.loads_change:
            self.newton.begin()
        return np.asarray(self.problem.dirichlet.targets)

    def _starts(self) -> list[FloatArray]:
        """Where Newton's method may begin, the better one first: on the way, or at rest."""
        old = self._before
        assert old is not None
        further = self.assembler.origin.copy()
        moved = further[self.moving.moves]
        self.problem.dirichlet.impose(moved, self._goal)
        further[self.moving.moves] = moved
        if self.problem.linear:
            return [further]
        sizes = [self._size(start) for start in (further, old.w)]
        if not np.isfinite(sizes[0]):
            return [old.w]
        return [further, old.w] if sizes[0] <= sizes[1] else [old.w, further]

    def _size(self, start: FloatArray) -> float:
        """Norm of the residual at a start; infinite where a cell is inside out."""
        self._put_unknowns(start)
        if self.watch is not None and self.watch.smallest()[0] <= 0.0:
            return float(np.inf)
        x, f = self.assembler.create_vector(), self.assembler.create_vector()
        self.assembler.get(x)
        self.residual(self.newton.snes, x, f)
        norm = float(f.norm())
        x.destroy()
        f.destroy()
        return norm if np.isfinite(norm) else float(np.inf)

    def _put_unknowns(self, w: FloatArray) -> None:
        self.problem.w.x.array[: len(w)] = w
        self.problem.w.x.scatter_forward()
        self.problem.unknowns.w_to_u()

    def _advance(self, U: PETSc.Vec, V: PETSc.Vec) -> bool:
        """From the stage to the end of the step; whether no cell is inside out there.

        Scalar fields have no inertia and no rate: they stay those of the stage, for extrapolated
        ones would swing from step to step.
        """
        old, s, h = self._before, self.scheme, self._h
        assert old is not None
        self._forces = self.moving.forces()
        if self.strikes is not None:
            self.strikes.at_stage(self._forces)
        moves, size = self.moving.moves, len(self.moving.moves)
        w = self.problem.w.x.array[: self.assembler.size].copy()
        u = old.u + (self._ahead + self._off)
        self.problem.dirichlet.impose(u, self._end_values)
        v, a = self._rates_at_end(self._off)
        w[moves] = u
        self._put_unknowns(w)
        at_end = s.at_end(old.a, a)
        self.problem.dirichlet.impose(at_end, self._held_rates[1])
        for field, values in ((self.v, v), (self.a, a), (self.at_end, at_end)):
            field.x.array[:size] = values
            field.x.scatter_forward()
        self._tell(U, V)
        self.problem.set_time(old.t + h)
        error = s.error((old.v, v), (old.a, a), h)
        if self.strikes is not None:
            error += self.strikes.error(h)
        # What is prescribed has no error, whatever its acceleration does.
        self._hat = u - free(self.problem, error)
        return self._whole()

    def _whole(self) -> bool:
        """No cell is inside out; otherwise the step counts as refused."""
        if self.watch is None:
            return True
        value, place = self.watch.smallest()
        if value > 0.0:
            return True
        self.newton.reject(value, place)
        return False

    def _accept(self, ts: PETSc.TS, h: float) -> None:
        assert self._before is not None
        middle = self._forces
        if self.scheme.alpha_f != 0.5:
            self._old_ends = self._ends
            self._ends = self.look(self._before.t + self._h)
            assert self._old_ends is not None
            middle = self._old_ends.mean(self._ends)
        here = self.problem.w.x.array[self.moving.moves]
        self.done = self._forces, middle, here - self._before.u
        ts.setTime(self.reached(self._before.t + self._h))
        ts.setTimeStep(h)

    def _put_back(self, U: PETSc.Vec, V: PETSc.Vec) -> None:
        old, size = self._before, len(self.moving.moves)
        assert old is not None
        self._put_unknowns(old.w)
        for field, values in ((self.v, old.v), (self.a, old.a)):
            field.x.array[:size] = values
            field.x.scatter_forward()
        self._tell(U, V)

    def _tell(self, U: PETSc.Vec, V: PETSc.Vec) -> None:
        """Gives TS the present displacement and velocity."""
        self.assembler.get(U)
        V.array_w[self.moving.moves] = self.v.x.array[: len(self.moving.moves)]
