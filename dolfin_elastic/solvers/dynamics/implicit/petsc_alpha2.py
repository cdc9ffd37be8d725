"""PETSc's own generalized-alpha, TSALPHA2: the same scheme, found independently.

It keeps its acceleration for itself and begins with two half steps of first order, so that a motion
cannot be gone on with exactly.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.incompressible import partly_incompressible
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.dynamics.implicit.ts_scheme import FAILURES, Done
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual, Forces
from dolfin_elastic.solvers.nonlinear.newton import Newton


def check_alpha2(problem: Problem) -> None:
    """What the scheme cannot follow. Not collective.

    Raises:
        InputError: A material cannot be compressed.
    """
    if partly_incompressible(problem):
        raise InputError(
            "PETSc's 'alpha2' asks for volumes at its stages: the pressure of what cannot be "
            "compressed swings the more, the smaller dt is",
            where="dynamics.scheme",
            expected="generalized-alpha, which asks for them at the ends of steps",
        )


class Alpha2:
    """What TSALPHA2 asks for.

    The scheme asks for the residual at a stage between two times.  Prescribed values there are
    blended between the two times, so that the end of the step is prescribed exactly.

    Args:
        moving: The body.
        v: Velocity, changed by steps.

    Attributes:
        newton: Set by whoever has the TS and its SNES.
        done: See `stepper.GeneralizedAlphaStepper`.
        error: See `stepper.GeneralizedAlphaStepper`.
        at_end: Mean acceleration of the last step [m/s^2].
    """

    def __init__(self, moving: DynamicResidual, v: fem.Function) -> None:
        self.moving, self.problem, self.assembler = moving, moving.problem, moving.assembler
        self.v = v
        self.newton: Newton
        self.done: Done | None = None
        self.error: InputError | None = None
        self.at_end = fem.Function(self.problem.V, name="acceleration")
        self._F = self.assembler.create_vector()
        self._start, self._known_h = 0.0, 0.0
        self._from = self._to = self.problem.dirichlet.targets
        self._w = np.empty(0)

    def set_up(self, ts: PETSc.TS) -> None:
        """Makes it TS's scheme. Collective."""
        ts.setType("alpha2")
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setI2Function(self._function, self._F)
        matrix = self.assembler.tangent.matrix
        ts.setI2Jacobian(self._jacobian, matrix, matrix)

    def begin(self, ts: PETSc.TS) -> None:
        """Before each step. Collective."""
        self._start, self._known_h = float(ts.getTime()), 0.0
        self._w = self.problem.w.x.array[: self.assembler.size].copy()
        ts.setMaxSNESFailures(ts.getSNESFailures() + FAILURES)
        try:
            self._from = self._prescribed_at(self._start)
            self.problem.set_time(self._start + float(ts.getTimeStep()))
            self.problem.dirichlet.check_finite()
            self.newton.begin()
        except InputError as error:  # the same on all ranks; PETSc would lose it
            self.error = error

    def accept(self, ts: PETSc.TS) -> None:
        """After each step: takes displacement, velocity and mean acceleration from TS."""
        self.newton.finish()
        forces = self.moving.forces()
        moves, extras = self.moving.moves, self.moving.extras
        size, h = len(moves), float(ts.getTime()) - self._start
        U, V = ts.getSolution2()
        # The scheme would extrapolate scalar fields, which have no inertia, from the stage, and
        # they would swing from step to step; they are taken from the stage itself.
        if len(extras):
            U.array_w[extras] = self.problem.w.x.array[extras]
        self.assembler.put(U)
        before, v = self.v.x.array[:size].copy(), V.array_r[moves].copy()
        self.at_end.x.array[:size] = (v - before) / h
        self.at_end.x.scatter_forward()
        self.v.x.array[:size] = v
        self.v.x.scatter_forward()
        self.done = forces, *self._in_the_middle(before, v, self._start + h)

    def start(self, t: float) -> None:
        """Lets `assembler.residual.vector` hold the forces of the first state. Collective."""
        size = len(self.moving.moves)
        self.moving.forces_at(t, self.v.x.array[:size], self.at_end.x.array[:size])

    def _in_the_middle(
        self, before: FloatArray, after: FloatArray, t: float
    ) -> tuple[Forces, FloatArray]:
        """Mean of the forces at both ends of the step, with its mean acceleration, and its way."""
        w, size = self.problem.w.x, self.assembler.size
        a, ends = self.at_end.x.array[: len(before)], []
        there = w.array[:size].copy()
        for place, v, time in ((self._w, before, self._start), (there, after, t)):
            w.array[:size] = place
            w.scatter_forward()
            self.problem.unknowns.w_to_u()
            ends.append(self.moving.forces_at(time, v, a))
        return ends[0].mean(ends[1]), there[self.moving.moves] - self._w[self.moving.moves]

    def _function(
        self, ts: PETSc.TS, t: float, U: PETSc.Vec, V: PETSc.Vec, A: PETSc.Vec, F: PETSc.Vec
    ) -> None:
        if self.error is not None:
            F.set(np.nan)
            return
        moves = self.moving.moves
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
        self.moving.shift.value, self.moving.drag.value = shift_a, shift_v
        self.assembler.tangent.assemble(U, shift_a)
        self.newton.take_tangent(P)

    def _step(self, ts: PETSc.TS) -> float:
        h = float(ts.getTimeStep())
        if h != self._known_h:  # TS has made the step smaller: its end has moved
            self._known_h = h
            self._to = self._prescribed_at(self._start + h)
        return h

    def _prescribed_at(self, t: float) -> FloatArray:
        self.problem.set_time(t)
        return np.asarray(self.problem.dirichlet.targets)

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self._F.destroy()
