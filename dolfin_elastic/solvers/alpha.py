"""Implicit motion by PETSc TS in second-order form: generalized-alpha (TSALPHA2)."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.errors import ConvergenceError, InputError
from dolfin_elastic.parallel import largest, total
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.contact import Measured
from dolfin_elastic.solvers.doctor import diagnose
from dolfin_elastic.solvers.linear import LinearSettings, choose
from dolfin_elastic.solvers.motion import ConsistentMass, Strain, lumped, work
from dolfin_elastic.solvers.newton import Newton
from dolfin_elastic.solvers.options import PREFIX, ts_reason
from dolfin_elastic.solvers.progress import Tolerance
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage

if TYPE_CHECKING:
    from dolfin_elastic.solvers.dynamics import DynamicsSettings

log = logging.getLogger("dolfin_elastic")


UNJUDGED = 1e100
"""Error that scalar fields, which follow from the displacement, may have in a step [m]."""

FAILURES = 8
"""Times that one step is made smaller, to a quarter each, before it is given up."""


class Alpha:
    """TSALPHA2 for one problem.

    The scheme asks for the residual at a stage between two times.  Prescribed values there are
    blended between the two times, so that the end of the step is prescribed exactly.

    Args:
        problem: What moves, in its initial state.
        velocity: Its velocity, in its initial state.
        settings: Of the motion.
        linear: How linear systems are solved.
        petsc: PETSc options of the user.
    """

    def __init__(
        self,
        problem: Problem,
        velocity: fem.Function,
        settings: DynamicsSettings,
        linear: LinearSettings,
        petsc: Mapping[str, Any],
    ) -> None:
        self.settings, self.problem, self.v = settings, problem, velocity
        self.a = fem.Function(problem.V, name="stage acceleration")
        self._mean = fem.Function(problem.V, name="acceleration")
        self.shift = problem.constant(0.0)
        inertia = problem.inertia(self.a, problem.v)
        trial = problem.unknowns.displacement(ufl.TrialFunction(problem.W))
        mass = problem.inertia(trial, problem.v)
        self.drag = problem.constant(0.0)
        tangent = self.shift * mass
        if (damping := problem.damping(trial)) is not None:
            tangent += self.drag * damping
        self.assembler = Assembler(problem, extra=inertia, extra_tangent=tangent)
        self.measure = ConsistentMass(problem, self.v)
        self.strain, self._measured = Strain(problem), Measured(problem, moving=True)
        choice = choose(problem, linear, moving=True)
        log.info("%s", choice.why)
        self.ts = PETSc.TS().create(problem.body.comm)
        self._F = self.assembler.create_vector()
        self._U, self._V = self.assembler.create_vector(), self.assembler.create_vector()
        s = self.settings
        self.newton = Newton(
            self.assembler,
            choice,
            Tolerance(s.rtol, s.atol, s.max_iterations),
            defaults={"snes_linesearch_type": "basic"},
            users=petsc,
            snes=self.ts.getSNES(),
            moving=True,
        )
        self.options = self.newton.options
        self.options.change(self._defaults())
        self._configure()
        self._from = self._to = problem.prescribed.targets
        self._external_work = 0.0
        self._start, self._known_dt = 0.0, 0.0
        self._mass = np.abs(lumped(problem, self.assembler))
        self._norm_of_mass = float(np.sqrt(total(problem.body.comm, np.sum(self._mass**2))))
        self._extras = np.setdiff1d(np.arange(self.assembler.size), self.assembler.moves)
        self._newton = self._krylov = 0
        self._usual = 0.0
        self._error: InputError | None = None
        self._scale = 0.0

    def _defaults(self) -> dict[str, Any]:
        s = self.settings
        adapt: dict[str, Any] = {"ts_adapt_type": "basic" if s.adaptive else "none"}
        if s.adaptive:
            adapt["ts_adapt_dt_min"] = 1e-9 * s.end
        return {
            "ts_alpha_radius": s.spectral_radius,
            **adapt,
            "snes_linesearch_type": "basic",
            **self.newton.choice.options,
        }

    def _configure(self) -> None:
        ts = self.ts
        ts.setOptionsPrefix(PREFIX)
        ts.setType("alpha2")
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setI2Function(self._function, self._F)
        ts.setI2Jacobian(self._jacobian, self.assembler.matrix, self.assembler.matrix)
        ts.setTime(0.0)
        ts.setTimeStep(self.settings.dt)
        ts.setMaxTime(self.settings.end)
        ts.setMaxSteps(10**9)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        with self.options.in_force():
            ts.setFromOptions()
        ts.setErrorIfStepFails(False)
        self.newton.judge()
        self.assembler.get(self._U)
        self._V.array_w[self.assembler.moves] = self.v.x.array[: len(self.assembler.moves)]
        ts.setSolution2(self._U, self._V)

    # --- what TS asks for ---

    def _function(
        self, ts: PETSc.TS, t: float, U: PETSc.Vec, V: PETSc.Vec, A: PETSc.Vec, F: PETSc.Vec
    ) -> None:
        try:
            self.problem.set_time(t)
        except InputError as error:  # the same on all ranks; PETSc would lose it
            self._error = error
            F.set(np.nan)
            return
        self.a.x.array[: len(self.assembler.moves)] = A.array_r[self.assembler.moves]
        self.a.x.scatter_forward()
        self._tell_dashpots(V.array_r[self.assembler.moves])
        forces = self._mass * A.array_r[self.assembler.moves]
        self.newton.inertia = float(np.sqrt(total(self.problem.body.comm, np.sum(forces**2))))
        share = (t - self._start) / self._dt()
        self.assembler.residual(U, F, target=(1 - share) * self._from + share * self._to)

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
        self.shift.value, self.drag.value = shift_a, shift_v
        self.newton.mass = shift_a * self._norm_of_mass
        self.assembler.tangent(U, shift_a)
        self.newton.note_tangent(P)

    def _tell_dashpots(self, v: Any) -> None:
        """Gives dashpots the owned entries of a velocity. Collective."""
        if self.problem.dashpots:
            velocity = self.problem.site.velocity.x
            velocity.array[: len(v)] = v
            velocity.scatter_forward()

    def _dt(self) -> float:
        dt = self.ts.getTimeStep()
        if dt != self._known_dt:  # TS has made the step smaller: its end has moved
            self._known_dt = dt
            self._to = self._prescribed_at(self._start + dt)
        return float(dt)

    def _prescribed_at(self, t: float) -> Any:
        held, now = self.problem.prescribed, float(self.problem.t.value)
        self.problem.set_time(t)
        values = held.targets
        self.problem.set_time(now)
        return values

    # --- the loop ---

    def run(self) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective."""
        s, step = self.settings, 0
        with stage("assemble"):
            self.problem.set_time(0.0)
            self._tell_dashpots(self.v.x.array[: len(self.assembler.moves)])
            self.assembler.assemble_balance()
        self._settle()
        self._held = self.assembler.holding_forces()
        yield self._state(0, 0.0)
        t = 0.0
        while t < s.end * (1 - 1e-12):
            before = self.problem.w.x.array[: self.assembler.size].copy()
            t, step = self._step(t), step + 1
            self._add_work(before)
            if step % s.every == 0 or t >= s.end * (1 - 1e-12):
                yield self._state(step, t)
                self._newton = self._krylov = 0

    def _settle(self) -> None:
        """Finds the scalar fields that belong to an initial displacement. Collective."""
        problem = self.problem
        exactly = any(
            isinstance(part.compliance, fem.Constant) and float(part.compliance.value) == 0.0
            for part in problem.parts
        )
        if not len(self._extras) or exactly or self.assembler.max_displacement() == 0.0:
            return  # an exactly incompressible body's pressure does not follow from its shape
        still = Assembler(problem, still=True)
        newton = Newton(still, choose(problem, LinearSettings(method="direct")), Tolerance())
        start = problem.prescribed.values.x.array.copy()
        try:
            problem.prescribed.values.x.array[:] = problem.u.x.array
            newton.solve("basic")
        finally:
            problem.prescribed.values.x.array[:] = start
            newton.destroy()
            still.destroy()
        self.assembler.get(self._U)
        self.ts.setSolution2(self._U, self._V)
        self.assembler.assemble_balance()

    def _step(self, t: float) -> float:
        """One step of TS from time t; returns the time reached."""
        self._prepare(t)
        ts = self.ts
        linear, newton = ts.getKSPIterations(), ts.getSNESIterations()
        with stage("solve"), self.options.in_force():
            self.newton.begin()
            self._take()
            self.options.report_unused()
        if self._error is not None:
            raise self._error
        newton, linear = ts.getSNESIterations() - newton, ts.getKSPIterations() - linear
        linear = 0 if self.newton.direct else linear
        self._newton += newton
        self._krylov += linear
        if ts.getConvergedReason() < 0:
            raise self._failure(t)
        self._renew(linear / max(newton, 1))
        self._accept(float(ts.getTime()) - t)
        return float(ts.getTime())

    def _prepare(self, t: float) -> None:
        """Says what is wrong with formulas at the end of the step before it is begun."""
        s, ts = self.settings, self.ts
        if not s.adaptive:
            assert s.dt is not None
            remaining = s.end - t
            ts.setTimeStep(remaining if remaining < s.dt * (1 + 1e-9) else s.dt)
        self._start, self._known_dt = t, 0.0
        self._from = self._prescribed_at(t)
        self.problem.set_time(t + ts.getTimeStep())
        self.problem.prescribed.check_finite()
        self._set_tolerance()

    def _take(self) -> None:
        ts, dt = self.ts, self.ts.getTimeStep()
        ts.setMaxSNESFailures(ts.getSNESFailures() + FAILURES)
        ts.step()
        if ts.getConvergedReason() < 0 and self._falls_back():
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
            ts.setMaxSNESFailures(ts.getSNESFailures() + FAILURES)
            ts.setTimeStep(dt)
            ts.step()

    def _accept(self, dt: float) -> None:
        """Takes displacement, velocity and mean acceleration over from TS."""
        moves = self.assembler.moves
        size = len(moves)
        U, V = self.ts.getSolution2()
        # The scheme would extrapolate scalar fields, which have no inertia, from the stage, and
        # they would swing from step to step; they are taken from the stage itself.
        if len(self._extras):
            U.array_w[self._extras] = self.problem.w.x.array[self._extras]
        self.assembler.put(U)
        v = V.array_r[moves]
        self._mean.x.array[:size] = (v - self.v.x.array[:size]) / dt
        self._mean.x.scatter_forward()
        self.v.x.array[:size] = v
        self.v.x.scatter_forward()
        self._tell_dashpots(v)

    def _failure(self, t: float) -> ConvergenceError:
        force, place = self.assembler.largest_unbalance()
        where = ", ".join(f"{x:.4g}" for x in place)
        reason = ts_reason(self.ts.getConvergedReason())
        last = self.problem.w.x.array.copy()
        self.newton.finish()
        found = diagnose(self.assembler, self.newton.progress, good=last, failed=last, moving=True)
        return ConvergenceError(
            f"no solution for the step from t = {t:.6g} s: {reason}; {found.text}\n  at the end: "
            f"the largest force out of balance, {force:.3g} N, is at ({where}) m",
            advice=found.advice,
            state=self._state(-1, t),
            diagnosis=found,
        )

    def _falls_back(self) -> bool:
        """The linear solver has failed and there is another."""
        self.newton.finish()
        return "LINEAR_SOLVE" in self.newton.progress.reason and self.newton.fall_back()

    def _renew(self, each: float) -> None:
        """Lets multigrid begin anew when the body has turned away from the modes it knows.

        Args:
            each: Linear iterations of each Newton iteration.
        """
        if self._usual and each > 1.5 * self._usual + 5:
            self.newton.refresh()
            each = 0.0
        self._usual = self._usual or each

    def _set_tolerance(self) -> None:
        """Lets errors be judged against the largest displacement and velocity so far."""
        if not self.settings.adaptive:
            return
        local = max(
            float(np.max(np.abs(field.x.array), initial=0.0)) for field in (self.problem.u, self.v)
        )
        smallest = 1e-6 * self.newton.span
        self._scale = max(self._scale, largest(self.problem.body.comm, local), smallest)
        tolerance = self.settings.tolerance
        atol: Any = tolerance * self._scale
        if len(self._extras):
            atol = self.assembler.create_vector()
            atol.set(tolerance * self._scale)
            atol.array_w[self._extras] = UNJUDGED
        self.ts.setTolerances(rtol=tolerance, atol=atol)
        if len(self._extras):
            atol.destroy()

    def _add_work(self, before: Any) -> None:
        """Work of loads and supports, with the forces of the stage within the step."""
        du = self.problem.w.x.array[: self.assembler.size] - before
        a = self.assembler
        forces = a.external_forces() + a.constraint_forces(a.balance.array[: a.size])
        now = a.holding_forces()
        forces += (self._held + now) / 2
        self._held = now
        self._external_work += work(self.problem, forces, du)

    def _energies(self) -> dict[str, float]:
        kinetic, self._linear, self._angular = self.measure.measure()
        strain, more = self.strain.energy(), self._measured.energies()
        return {
            "strain": strain,
            "kinetic": kinetic,
            "total": strain + kinetic + sum(more.values()),
            "external": self._external_work,
            **self.strain.springs(),
            **more,
        }

    def _state(self, step: int, t: float) -> State:
        energies = self._energies()
        first = step == 0
        return State(
            step=step,
            t=t,
            u=self.problem.u,
            w=self.problem.w,
            v=self.v,
            a=self._mean,
            newton=0 if first else self._newton,
            krylov=0 if first else self._krylov,
            reason="initial state" if first else "converged",
            residuals=tuple(self.newton.progress.residuals),
            energies=energies,
            reactions=self.assembler.reactions(),
            momenta={"linear": self._linear, "angular": self._angular},
            max_displacement=self.assembler.max_displacement(),
            numbers=self._measured.numbers(),
            done=t / self.settings.end,
        )

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.newton.destroy()
        self.ts.destroy()
        self.assembler.destroy()
        for vector in (self._F, self._U, self._V):
            vector.destroy()
