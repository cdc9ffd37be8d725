"""PETSc's own generalized-alpha, TSALPHA2: the same scheme, found independently.

It keeps its acceleration for itself and begins with two half steps of first order, so that a motion
cannot be gone on with exactly.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.petsc_options import PetscValue
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem, partly_incompressible
from dolfin_elastic.solvers.dynamics.implicit.scheme import (
    FAILURES,
    ImplicitScheme,
    SchemeContext,
    StepForces,
)
from dolfin_elastic.solvers.dynamics.residual import Forces


class PetscAlpha2(ImplicitScheme):
    """Registers TSALPHA2 with a TS.

    The scheme asks for the residual at a stage between two times.  Prescribed values there are
    means of those at both times, so that the end of the step is prescribed exactly.

    TSALPHA2 does not give its acceleration away: that of the states is the mean one of the step.
    """

    not_adaptive: ClassVar[str] = (
        "PETSc's 'alpha2' judges the error of velocities by what is allowed for displacements, and "
        "takes thousands of steps for it"
    )
    not_restartable: ClassVar[str] = (
        "PETSc's 'alpha2' keeps its acceleration for itself and begins anew with two half steps of "
        "first order; 'generalized-alpha', the same scheme, goes on exactly"
    )

    def __init__(self, context: SchemeContext) -> None:
        super().__init__(context)
        ts = context.ts
        self._F = self.assembler.create_vector()
        self._start, self._known_h = 0.0, 0.0
        self._from = self._to = self.problem.constraints.targets
        self._w = np.empty(0)
        ts.setType("alpha2")
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setI2Function(self._function, self._F)
        self._take_matrix()

    def _take_matrix(self) -> None:
        matrix = self.assembler.tangent.matrix
        self.context.ts.setI2Jacobian(self._jacobian, matrix, matrix)

    @classmethod
    def check(cls, problem: Problem, name: str) -> None:
        """See `ImplicitScheme.check`.

        Raises:
            InputError: A material is incompressible.
        """
        for term in problem.terms:
            if term.mass:
                raise InputError(
                    f"PETSc's '{name}' does not move the mass of '{term.label}'",
                    where="dynamics.scheme",
                    expected="generalized-alpha",
                )
        if partly_incompressible(problem):
            raise InputError(
                f"PETSc's '{name}' keeps volumes at its stages, where the pressure of an "
                "incompressible material swings the more, the smaller dt is",
                where="dynamics.scheme",
                expected="generalized-alpha, which keeps them at the ends of steps",
            )

    @property
    def options(self) -> dict[str, PetscValue]:
        """See `ImplicitScheme.options`: petsc4py's setter is that of another scheme, TSALPHA."""
        return {"ts_alpha_radius": self.context.parameters.spectral_radius}

    # --- what the motion asks for ---

    def start(self, t: float) -> None:
        """See `ImplicitScheme.start`.

        Args:
            t: Time [s].
        """
        self.acceleration.x.array[:] = self.context.a.x.array
        size = len(self.moving.displacement_dofs)
        self.moving.forces_at(t, self.v.x.array[:size], self.acceleration.x.array[:size])

    def begin_step(self) -> None:
        """See `ImplicitScheme.begin_step`."""
        ts = self.context.ts
        self._start, self._known_h = float(ts.getTime()), 0.0
        self._w = self.problem.w.x.array[: self.assembler.size].copy()
        ts.setMaxSNESFailures(ts.getSNESFailures() + FAILURES)
        try:
            self._from = self._prescribed_at(self._start)
            self.problem.set_time(self._start + float(ts.getTimeStep()))
            self.problem.constraints.check_finite()
            self.newton.begin()
        except InputError as error:  # the same on all ranks; PETSc would lose it
            self.error = error

    def accept(self) -> StepForces:
        """See `ImplicitScheme.accept`; the acceleration is the mean one of the step."""
        self.newton.finish()
        ts, stage = self.context.ts, self.moving.forces()
        moves, extras = self.moving.displacement_dofs, self.moving.auxiliary_dofs
        size, t = len(moves), float(ts.getTime())
        h = t - self._start
        U, V = ts.getSolution2()
        # TSALPHA2 would extrapolate scalar fields, which have no inertia, from the stage, and they
        # would swing from step to step: they are taken from the stage itself.
        if len(extras):
            U.array_w[extras] = self.problem.w.x.array[extras]
        self.assembler.put(U)
        before, v = self.v.x.array[:size].copy(), V.array_r[moves].copy()
        self.acceleration.x.array[:size] = (v - before) / h
        self.acceleration.x.scatter_forward()
        self.v.x.array[:size] = v
        self.v.x.scatter_forward()
        middle, du = self._in_the_middle(before, v, self._start + h)
        self.problem.set_time(t)
        return StepForces(stage, middle, du)

    def balance_at_end(self, t: float) -> None:
        """Leaves the mean forces at the end, assembled by `accept`: they have its acceleration.

        Args:
            t: Time [s].
        """

    def counts(self) -> tuple[int, int]:
        """See `ImplicitScheme.counts`."""
        ts = self.context.ts
        return ts.getSNESIterations(), ts.getKSPIterations()

    def fall_back(self) -> bool:
        """See `ImplicitScheme.fall_back`."""
        self.newton.finish()
        if "LINEAR_SOLVE" not in self.newton.result.reason or not self.newton.fall_back():
            return False
        self._take_matrix()
        return True

    def close(self) -> None:
        """Frees what it owns."""
        self._F.destroy()

    # --- one step ---

    def _in_the_middle(
        self, before: FloatArray, after: FloatArray, t: float
    ) -> tuple[Forces, FloatArray]:
        """Mean of the forces at both ends of the step, and the change of the displacement.

        Both forces are with the mean acceleration of the step: there is no other.

        Args:
            before: Velocity at the start of the step [m/s].
            after: Velocity at its end [m/s].
            t: Time of its end [s].
        """
        w, size = self.problem.w.x, self.assembler.size
        a, ends = self.acceleration.x.array[: len(before)], []
        there = w.array[:size].copy()
        for place, v, time in ((self._w, before, self._start), (there, after, t)):
            self.moving.set_unknowns(place)
            ends.append(self.moving.forces_at(time, v, a))
        return ends[0].mean(ends[1]), there[self.moving.displacement_dofs] - self._w[
            self.moving.displacement_dofs
        ]

    def _function(
        self, ts: PETSc.TS, t: float, U: PETSc.Vec, V: PETSc.Vec, A: PETSc.Vec, F: PETSc.Vec
    ) -> None:
        if self.error is not None:
            F.set(np.nan)
            return
        moves = self.moving.displacement_dofs
        share = (t - self._start) / self._step(ts)
        self.problem.set_time(t)
        self.moving.set_stage_rates(V.array_r[moves], A.array_r[moves])
        self.assembler.residual.evaluate(U, F, target=(1 - share) * self._from + share * self._to)

    def _jacobian(
        self,
        ts: PETSc.TS,
        t: float,
        U: PETSc.Vec,
        V: PETSc.Vec,
        A: PETSc.Vec,
        shift_v: float,
        shift_a: float,
        J: PETSc.Mat,
        P: PETSc.Mat,
    ) -> None:
        self.moving.acceleration_shift, self.moving.velocity_shift.value = shift_a, shift_v
        self.assembler.tangent.assemble(U, shift_a)
        self.newton.take_tangent(P)
        self.newton.linear.take(P)

    def _step(self, ts: PETSc.TS) -> float:
        h = float(ts.getTimeStep())
        if h != self._known_h:  # TS has made the step smaller: its end has moved
            self._known_h = h
            self._to = self._prescribed_at(self._start + h)
        return h

    def _prescribed_at(self, t: float) -> FloatArray:
        self.problem.set_time(t)
        return np.asarray(self.problem.constraints.targets)
