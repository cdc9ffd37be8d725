"""The stage of a generalized-alpha step: its initial guesses, and its solution by Newton's method.

The unknown of a stage is its `offset` from the predictor: displacements less those with which the
acceleration does not change.  A body that flies through space fast has an offset of zero, so that
round-off is that of the change and not of the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import smallest
from dolfin_elastic.core.timing import stage as timed
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.term import StepWeights
from dolfin_elastic.solvers.assembly.mass import prescribed_rates
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.implicit.scheme import SchemeContext
from dolfin_elastic.solvers.dynamics.implicit.volume_constraint import VolumeConstraint
from dolfin_elastic.solvers.nonlinear.passage import leads_through

SUDDEN = 2.0
"""Norm of a first residual over that of the last step, above which another guess is tried."""


@dataclass(frozen=True)
class StepStart:
    """The state that a step begins with: copies of owned entries.

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


@dataclass(frozen=True)
class Stage:
    """One trial of a step, with the motion that supports prescribe in it.

    Rates of prescribed motion are those of the support's own curve: by the formulas of the scheme
    an error of them, at a kink of a curve, would hardly ever die out, and grow as steps become
    smaller.

    Attributes:
        parameters: Coefficients of the scheme.
        prescribed: Puts prescribed values into vectors, which tied nodes follow.
        start: The state that the step begins with.
        h: Length of the step [s].
        predictor: u1 - u0 if the acceleration did not change, owned entries [m].
        u: Prescribed displacement at the stage [m], like `Constraints.targets`.
        a: Prescribed acceleration at the stage [m/s^2].
        u_end: Prescribed displacement at the end of the step [m].
        v_end: Prescribed velocity there [m/s].
        a_end: Prescribed acceleration there [m/s^2].
    """

    parameters: GeneralizedAlphaParameters
    prescribed: Rows
    start: StepStart
    h: float
    predictor: FloatArray
    u: FloatArray
    a: FloatArray
    u_end: FloatArray
    v_end: FloatArray
    a_end: FloatArray

    def rates(self, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity [m/s] and acceleration [m/s^2] at the stage, owned entries.

        Args:
            offset: Displacement of the stage less that of the predictor [m].
        """
        p, old = self.parameters, self.start
        v1, a1 = self.rates_at_end(np.asarray(offset / (1 - p.alpha_f)))
        v = (1 - p.alpha_f) * v1 + p.alpha_f * old.v
        a = (1 - p.alpha_m) * a1 + p.alpha_m * old.a
        self.prescribed.impose(a, self.a)
        return v, a

    def rates_at_end(self, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity [m/s] and acceleration [m/s^2] at the end of the step, owned entries.

        Args:
            offset: Displacement there less that of the predictor [m].
        """
        p, old = self.parameters, self.start
        a = p.acceleration(offset, old.a, self.h)
        v = p.velocity(old.v, old.a, a, self.h)
        self.prescribed.impose(v, self.v_end)
        self.prescribed.impose(a, self.a_end)
        return v, a

    def displacement_at_end(self, offset: FloatArray) -> FloatArray:
        """Displacement at the end of the step, owned entries [m].

        Args:
            offset: Of it from the predictor [m].
        """
        u = self.start.u + (self.predictor + offset)
        self.prescribed.impose(u, self.u_end)
        return u


class StageSolver:
    """Finds the displacement of a stage by Newton's method.  Collective.

    Attributes:
        keeps_volumes: There is a pressure, and the volumes are those of the ends of steps.
        newton_iterations: Of all solves so far.
        krylov_iterations: Linear ones of all solves so far.
    """

    def __init__(self, context: SchemeContext) -> None:
        self._context, self._moving, self._newton = context, context.moving, context.newton
        self._problem, self._assembler = self._moving.problem, self._moving.assembler
        self._parameters = context.parameters
        share = self._parameters.alpha_f
        self.keeps_volumes = VolumeConstraint.needed(self._problem, share)
        # `StepLaw` has a constraint of its own.
        completed = self.keeps_volumes and self._problem.weak_form.start is None
        self._volumes = VolumeConstraint(self._assembler, share) if completed else None
        self._stage: Stage | None = None
        self._seen: tuple[FloatArray, FloatArray, FloatArray] | None = None  # see `residual`
        self.newton_iterations = self.krylov_iterations = 0
        self._F = self._assembler.create_vector()
        context.ts.getSNES().setFunction(self.residual, self._F)
        self._take_matrix()

    def _take_matrix(self) -> None:
        """Hands the matrix of the tangent to SNES: a fallback may make another one."""
        matrix = self._assembler.tangent.matrix
        self._context.ts.getSNES().setJacobian(self.tangent, matrix, matrix)

    # --- callbacks of SNES ---

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Forces out of balance at the stage, with inertia.

        Of a first guess, and where terms bar steps, SNES asks once more for those evaluated last.

        Args:
            x: Offset of the stage from the predictor.
        """
        assert self._stage is not None
        if self._seen is not None and self._again(x, f):
            return
        self._moving.set_stage_rates(*self._stage.rates(x.array_r[self._moving.displacement_dofs]))
        with timed("assemble"):
            self._assembler.put(x)
            self._assemble()
        self._assembler.residual.constrain(f, target=self._stage.u)
        if self._problem.terms.bars:
            self._store(x, f)

    def _store(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._seen = x.array_r.copy(), self._problem.w.x.array.copy(), f.array_r.copy()

    def _again(self, x: PETSc.Vec, f: PETSc.Vec) -> bool:
        """Gives the last residual once more, if it is that of x. Collective."""
        seen, self._seen = self._seen, None
        same = seen is not None and all(
            map(np.array_equal, (x.array_r, self._problem.w.x.array), seen)
        )
        if not smallest(self._assembler.comm, float(same)) or seen is None:
            return False
        f.array_w[:] = seen[2]
        return True

    def _assemble(self) -> None:
        """Assembles the residual at the present state, with the volumes at the end of the step."""
        self._problem.terms.follow()
        self._assembler.residual.assemble()
        if self._volumes is not None:
            self._volumes.complete()

    def tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Derivative of the residual by the displacement of the stage, or that of the last iterate.

        Args:
            x: Offset of the stage from the predictor.
            P: The same.
        """
        if self._newton.test.old_tangent_suffices():
            self._newton.set_linear_tolerance()
            return
        self._assembler.tangent.assemble(x, self._moving.factor)
        self._newton.take_tangent(P)
        self._newton.linear.take(P)

    # --- one step ---

    def begin(self, t: float) -> None:
        """Stores the state at the start of a step.

        Args:
            t: Its time [s].
        """
        if self._volumes is not None:
            self._volumes.begin(t)
        self._problem.terms.begin_step()

    def solve(self, start: StepStart, h: float) -> tuple[Stage, FloatArray] | None:
        """The stage and the offset of the step's end from the predictor; None: not found.

        The problem holds the stage afterwards, or the last iterate.

        Args:
            start: The state that the step begins with.
            h: Length of the step [s].
        """
        p = self._parameters
        # Before the residual of the first guess, whose lifting contains the shifts.
        self._moving.velocity_shift.value, self._moving.acceleration_shift = p.shifts(h)
        stage, self._seen = self._prescribe(start, h), None
        self._stage = stage
        if self._volumes is not None:
            self._volumes.end_at(start.t + h)
        origin = self._assembler.origin
        origin[:] = start.w
        origin[self._moving.displacement_dofs] += (1 - p.alpha_f) * stage.predictor
        with self._moving.step_from(start.w):
            try:
                converged = any(self._solve_from(guess) for guess in self._guesses(stage))
            finally:
                origin[:] = 0.0
            if converged and self._assembler.settle_pressures():
                self._assemble()
        if not converged:
            self._problem.terms.leave_stage(found=False)
        offset = self._newton.solution()[self._moving.displacement_dofs] / (1 - p.alpha_f)
        return (stage, np.asarray(offset)) if converged else None

    def _prescribe(self, start: StepStart, h: float) -> Stage:
        """What supports prescribe in a step; the problem's time is that of the stage then.

        Prescribed values of the stage are means of those at both ends, so that the end, which is
        extrapolated from the stage, is prescribed exactly.
        """
        problem, p = self._problem, self._parameters
        end = start.t + h
        problem.set_time(end)  # loads must have values there, too
        problem.constraints.check_finite()
        if problem.loads_change:
            self._newton.begin()
        u_end, poses = np.asarray(problem.constraints.targets), problem.terms.poses
        u_start = problem.constraints.constrained_part(problem.u.x.array)
        v_end, a_end = prescribed_rates(problem, end, h)
        a = self._prescribed_acceleration(v_end, a_end, h)
        problem.set_time(start.t + (1 - p.alpha_f) * h)
        weights = StepWeights(h, p.alpha_m, p.alpha_f, p.beta, p.gamma, p.start)
        problem.terms.enter_stage(weights, poses)
        return Stage(
            parameters=p,
            prescribed=problem.constraints,
            start=start,
            h=h,
            predictor=p.predicted(start.v, start.a, h),
            u=p.alpha_f * u_start + (1 - p.alpha_f) * u_end,
            a=a,
            u_end=u_end,
            v_end=v_end,
            a_end=a_end,
        )

    def _prescribed_acceleration(
        self, v_end: FloatArray, a_end: FloatArray, h: float
    ) -> FloatArray:
        """Of supports at the stage [m/s^2], like `Constraints.targets`.

        Where the energy is kept, M a must be the change of the momentum, at supports as elsewhere:
        with another acceleration of theirs, nodes beside them do work that nothing accounts for.

        Args:
            v_end: Prescribed velocity at the end of the step [m/s].
            a_end: Prescribed acceleration there [m/s^2].
            h: Length of the step [s].
        """
        context, p = self._context, self._parameters
        extract = self._problem.constraints.constrained_part
        if self._moving.conserves:
            return np.asarray((v_end - extract(context.v.x.array)) / h)
        return np.asarray((1 - p.alpha_f) * a_end + p.alpha_f * extract(context.a.x.array))

    def _solve_from(self, guess: FloatArray) -> bool:
        newton = self._newton
        if self._problem.terms.bars:
            self._seen = None
        self._moving.set_unknowns(guess)
        result = newton.solve(newton.line_searches()[0])
        while "LINEAR_SOLVE" in result.reason and newton.fall_back():
            self._take_matrix()
            self._moving.set_unknowns(guess)
            self._seen = None
            result = newton.solve(newton.line_searches()[0])
        self.newton_iterations += result.newton
        self.krylov_iterations += result.krylov
        return result.converged

    def _guesses(self, stage: Stage) -> list[FloatArray]:
        """Initial guesses of Newton's method, the one with the smaller residual first.

        The predictor is the better one of a body that flies, the old state of one that is stiff
        and is set going at once: there the predictor may turn cells inside out.  So the old state
        is asked only where the predictor's residual is not finite, or well above the last step's.
        """
        moves = self._moving.displacement_dofs
        predicted = self._assembler.origin.copy()
        u = predicted[moves]
        stage.prescribed.impose(u, stage.u)
        predicted[moves] = u
        old = stage.start.w
        terms = self._problem.terms
        put = self._moving.set_unknowns
        if (terms.bars or terms.joins) and leads_through(self._problem, put, predicted, old):
            return [old]
        if self._problem.linear:
            return [predicted]
        norm = self._norm_at(predicted)
        if not np.isfinite(norm):
            return [old]
        usual = norm <= SUDDEN * self._newton.test.first or norm <= self._norm_at(old)
        return [predicted, old] if usual else [old, predicted]

    def _norm_at(self, guess: FloatArray) -> float:
        """Norm of the residual of a first guess; infinite where a cell is inside out."""
        self._moving.set_unknowns(guess)
        if self._context.watch.refused()[0] <= 0.0:
            return float(np.inf)
        x, f = self._assembler.create_vector(), self._assembler.create_vector()
        terms = self._problem.terms
        self._assembler.get(x)
        self.residual(self._newton.snes, x, f)
        norm = float(f.norm())
        if not (terms.bars or terms.opens):  # whose states follow each other
            self._store(x, f)
        x.destroy()
        f.destroy()
        return norm if np.isfinite(norm) else float(np.inf)

    def destroy(self) -> None:
        """Frees what it owns."""
        self._F.destroy()
