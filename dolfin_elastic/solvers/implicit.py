"""Implicit motion by PETSc TS: the loop over steps, what is yielded, and what is kept."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.errors import ConvergenceError
from dolfin_elastic.kept import Kept, Restore
from dolfin_elastic.parallel import largest
from dolfin_elastic.problem import Problem
from dolfin_elastic.solvers.alpha import Scheme
from dolfin_elastic.solvers.alpha2 import Alpha2
from dolfin_elastic.solvers.contact import Measured
from dolfin_elastic.solvers.doctor import diagnose
from dolfin_elastic.solvers.extras import Extras
from dolfin_elastic.solvers.inversion import JacobianWatch
from dolfin_elastic.solvers.ledger import Ledger
from dolfin_elastic.solvers.linear import LinearSettings, choose
from dolfin_elastic.solvers.memory import remembered, remind
from dolfin_elastic.solvers.motion import ConsistentMass, Strain
from dolfin_elastic.solvers.motion_audit import MotionAuditor
from dolfin_elastic.solvers.moving import Moving
from dolfin_elastic.solvers.newton import Newton
from dolfin_elastic.solvers.options import PREFIX, ts_reason
from dolfin_elastic.solvers.progress import Tolerance
from dolfin_elastic.solvers.saddle import begin
from dolfin_elastic.solvers.settle import settle
from dolfin_elastic.solvers.stepper import Stepper
from dolfin_elastic.solvers.steptimes import StepTimes
from dolfin_elastic.state import State
from dolfin_elastic.timing import stage

if TYPE_CHECKING:
    from dolfin_elastic.solvers.dynamics import DynamicsSettings

Vector = npt.NDArray[np.float64]
log = logging.getLogger("dolfin_elastic")

UNJUDGED = 1e100
"""Error that scalar fields, which follow from the displacement, may have in a step [m]."""


class Implicit:
    """An implicit scheme on one problem.

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
        self.moving = Moving(problem, **settings.damping)
        self.assembler = self.moving.assembler
        self.a = fem.Function(problem.V, name="acceleration of the scheme")
        choice = choose(problem, linear, moving=True)
        log.info("%s", choice.why)
        self.ts = PETSc.TS().create(problem.body.comm)
        self.ts.setOptionsPrefix(PREFIX)
        scheme = settings.parameters
        if scheme and self.moving.damping.inside and settings.scheme == "generalized-alpha":
            scheme = scheme.without_overshoot()
        self.stepper: Stepper | Alpha2 = self._stepper(scheme)
        s = settings
        self.newton = self.stepper.newton = Newton(
            self.assembler,
            choice,
            Tolerance(s.rtol, s.atol, s.max_iterations),
            defaults={"snes_linesearch_type": "basic"},
            users=petsc,
            snes=self.ts.getSNES(),
            moving=True,
        )
        self.newton.mass = self.moving.mass
        self.options = self.newton.options
        self.options.change(self._defaults())
        self._U, self._V = self.assembler.create_vector(), self.assembler.create_vector()
        self._f = self.assembler.create_vector()
        self._configure()
        self.measure, self.strain = ConsistentMass(problem, self.v), Strain(problem)
        self._measured = Measured(problem, moving=True)
        self.ledger = Ledger(self.moving)
        watch = getattr(self.stepper, "watch", None) or JacobianWatch(problem)
        self.auditor = MotionAuditor(problem, self.moving, watch, damps=settings.damps)
        self.extras = Extras(problem)
        self.times = StepTimes(s.end, s.times, s.every)
        self._newton = self._krylov = 0
        self._usual = self._scale = 0.0
        self._nominal = float(s.dt or 0.0)

    # --- TS ---

    def _stepper(self, scheme: Scheme | None) -> Stepper | Alpha2:
        """The scheme, registered with TS."""
        if scheme is None:
            petsc = Alpha2(self.moving, self.v)
            petsc.set_up(self.ts)
            return petsc
        own = Stepper(self.moving, self.v, self.a, scheme, self.settings.order)
        self.ts.setType("python")
        self.ts.setPythonContext(own)
        own.reached = self._meant
        return own

    def _defaults(self) -> dict[str, Any]:
        s = self.settings
        adapt: dict[str, Any] = {"ts_adapt_type": "basic" if s.adaptive else "none"}
        if s.adaptive:
            # The error is that of the worst node, so that it does not depend on the mesh.
            adapt |= {"ts_adapt_dt_min": 1e-9 * s.end, "ts_adapt_wnormtype": "infinity"}
        if isinstance(self.stepper, Alpha2):
            adapt["ts_alpha_radius"] = s.spectral_radius
        return {**adapt, "snes_linesearch_type": "basic", **self.newton.choice.options}

    def _configure(self) -> None:
        ts = self.ts
        if isinstance(self.stepper, Stepper):
            snes = ts.getSNES()
            snes.setFunction(self.stepper.residual, self._f)
            snes.setJacobian(self.stepper.tangent, self.assembler.matrix, self.assembler.matrix)
        ts.setTime(0.0)
        ts.setTimeStep(self.settings.dt)
        ts.setMaxTime(self.settings.end)
        ts.setMaxSteps(10**9)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setSolution2(self._U, self._V)
        with self.options.in_force(), self.options.told():
            ts.setFromOptions()
        ts.setErrorIfStepFails(False)
        ts.setPreStep(self._before_step)
        ts.setPostStep(self._after_step)
        self.newton.judge()

    def _meant(self, t: float) -> float:
        """A time that is asked for, or of equal steps, without the round-off of a sum."""
        slack = 1e-9 * float(self.ts.getTimeStep())
        goal = self.times.next(float(self.ts.getTime()))
        if abs(t - goal) < slack:
            return goal
        even = round(t / self._nominal) * self._nominal
        return even if abs(t - even) < slack and not self.settings.adaptive else t

    def _before_step(self, ts: PETSc.TS) -> None:
        t = float(ts.getTime())
        goal = self.times.next(t)
        ts.setMaxTime(goal)
        step = float(ts.getTimeStep()) if self.settings.adaptive else self._nominal
        remaining = goal - t
        # A step that ends there but for round-off stays as it is, and so does its factorisation.
        ts.setTimeStep(remaining if remaining < step * (1 - 1e-9) else step)
        self._set_tolerance()
        if isinstance(self.stepper, Alpha2):
            self.stepper.begin(ts)

    def _after_step(self, ts: PETSc.TS) -> None:
        ts.setMaxTime(self.settings.end)
        if ts.getConvergedReason() < 0:
            return  # TS comes here after a step that it has given up, too
        if isinstance(self.stepper, Alpha2):
            self.stepper.accept(ts)
        assert self.stepper.done is not None
        at_stage, in_the_middle, du = self.stepper.done
        self.ledger.add(in_the_middle, du)
        self.auditor.look(at_stage)

    def _set_tolerance(self) -> None:
        """Lets errors be judged against the largest displacement so far."""
        if not self.settings.adaptive:
            return
        local = float(np.max(np.abs(self.problem.u.x.array), initial=0.0))
        smallest = 1e-6 * self.newton.span
        self._scale = max(self._scale, largest(self.problem.body.comm, local), smallest)
        atol: Any = self.settings.tolerance * self._scale
        extras = self.moving.extras
        several = bool(self.problem.unknowns.extras)
        if several:
            value, atol = atol, self.assembler.create_vector()
            atol.set(value)
            atol.array_w[extras] = UNJUDGED
        self.ts.setTolerances(rtol=0.0, atol=atol)
        if several:
            atol.destroy()

    # --- the loop ---

    def run(self, restore: Restore | None = None) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            restore: Fills what is kept, so that the motion goes on from there; then the state
                that was kept is not yielded again.
        """
        if restore is None:
            self._begin()
            yield self._state()
        else:
            self._take(restore(self.kept().fields))
        while not self.times.done(float(self.ts.getTime())):
            self._march()
            yield self._state()
            self._newton = self._krylov = 0

    def _begin(self) -> None:
        """Forces and acceleration of the initial state."""
        with stage("assemble"):
            self.problem.set_time(0.0)
            size = len(self.moving.moves)
            self.moving.set_rates(self.v.x.array[:size], np.zeros(size))
            self.assembler.assemble_balance()
        settle(self.problem, self.assembler)
        if isinstance(self.stepper, Stepper):
            with stage("solve"):
                begin(self.moving, self.v, self.a, self._nominal / 8)
            self.stepper.at_end.x.array[:] = self.a.x.array
            self.stepper.begin(0.0)
        self._tell_ts()

    def _tell_ts(self) -> None:
        self.assembler.get(self._U)
        self._V.array_w[self.moving.moves] = self.v.x.array[: len(self.moving.moves)]

    def _march(self) -> None:
        """Lets TS go on to the next state that is to be shown; it stops at times that are met."""
        ts = self.ts
        while True:
            step = int(ts.getStepNumber())
            ts.setMaxSteps(step + self.times.steps_left(step))
            self._solve()
            if self.times.shown(int(ts.getStepNumber()), float(ts.getTime())):
                return

    def _solve(self) -> None:
        ts = self.ts
        newton, krylov = self._counts()
        with stage("solve"), self.options.in_force():
            ts.solve()
            if ts.getConvergedReason() < 0 and self._falls_back():
                ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
                ts.solve()
            self.options.report_unused()
        if self.stepper.error is not None:
            raise self.stepper.error
        now = self._counts()
        newton, krylov = now[0] - newton, 0 if self.newton.direct else now[1] - krylov
        self._newton += newton
        self._krylov += krylov
        if ts.getConvergedReason() < 0:
            raise self._failure()
        self._renew(krylov / max(newton, 1))

    def _counts(self) -> tuple[int, int]:
        if isinstance(self.stepper, Stepper):
            return self.stepper.newton_iterations, self.stepper.krylov_iterations
        return self.ts.getSNESIterations(), self.ts.getKSPIterations()

    def _falls_back(self) -> bool:
        """PETSc's scheme has met a linear solver that fails, and there is another."""
        if isinstance(self.stepper, Stepper):
            return False
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

    def _failure(self) -> ConvergenceError:
        t = float(self.ts.getTime())
        force, place = self.assembler.largest_unbalance()
        where = ", ".join(f"{x:.4g}" for x in place)
        reason = ts_reason(self.ts.getConvergedReason())
        last = self.problem.w.x.array.copy()
        if isinstance(self.stepper, Alpha2):
            self.newton.finish()
        found = diagnose(self.assembler, self.newton.progress, good=last, failed=last, moving=True)
        return ConvergenceError(
            f"no solution for the step from t = {t:.6g} s: {reason}; {found.text}\n  at the end: "
            f"the largest force out of balance, {force:.3g} N, is at ({where}) m",
            advice=found.advice,
            state=self._state(failed=True),
            diagnosis=found,
        )

    # --- what is yielded ---

    def _reactions(self, t: float) -> dict[str, Vector]:
        """Of the state at the end of the step, its inertia included. Collective.

        PETSc's scheme does not tell its acceleration: its reactions are those of the stage.
        """
        if isinstance(self.stepper, Stepper):
            self.stepper.look_at_end(t)
        return self.assembler.reactions()

    def _state(self, *, failed: bool = False) -> State:
        step, t = int(self.ts.getStepNumber()), float(self.ts.getTime())
        first = step == 0 and not failed
        reactions = self.assembler.reactions() if failed else self._reactions(t)
        kinetic, linear, angular = self.measure.measure()
        strain, contact = self.strain.energy(), self._measured.energies()
        energies = {
            "strain": strain,
            "kinetic": kinetic,
            "total": strain + kinetic + sum(contact.values()),
            **self.ledger.energies(kinetic, strain),
            **self.strain.springs(),
            **contact,
        }
        return State(
            step=-1 if failed else step,
            t=t,
            u=self.problem.u,
            w=self.problem.w,
            v=self.v,
            a=self.stepper.at_end,
            newton=0 if first else self._newton,
            krylov=0 if first else self._krylov,
            reason="initial state" if first else "converged",
            residuals=tuple(self.newton.progress.residuals),
            energies=energies,
            reactions=reactions,
            momenta={"linear": linear, "angular": angular},
            max_displacement=self.assembler.max_displacement(),
            numbers=self._measured.numbers(),
            audit=None if failed else self.auditor.judge(t, self.ledger.off(energies), energies),
            done=t / self.settings.end,
        )

    # --- restarts ---

    def kept(self) -> Kept:
        """What the next step needs to know. Collective."""
        self.extras.take()
        fields = {
            "displacement": self.problem.u,
            "velocity": self.v,
            "acceleration": self.a,
            "acceleration_at_end": self.stepper.at_end,
            **self.extras.fields,
        }
        numbers = {
            "t": float(self.ts.getTime()),
            "step": int(self.ts.getStepNumber()),
            "dt": float(self.ts.getTimeStep()),
            "scale": self._scale,
            "usual": self._usual,
            "ledger": self.ledger.kept(),
            "audit": self.auditor.kept(),
            "newton": remembered(self.newton),
        }
        return Kept(fields, numbers)

    def _take(self, numbers: Mapping[str, Any]) -> None:
        """Goes on from what was kept; the fields hold it already."""
        self.extras.give()
        self.ts.setTime(numbers["t"])
        self.ts.setStepNumber(numbers["step"])
        self.ts.setTimeStep(numbers["dt"])
        self._scale, self._usual = numbers["scale"], numbers["usual"]
        self.ledger.restore(numbers["ledger"])
        self.auditor.restore(numbers["audit"])
        if isinstance(self.stepper, Stepper):
            self.stepper.begin(numbers["t"])
        self._tell_ts()
        remind(self.newton, numbers["newton"])

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.newton.destroy()
        self.ts.destroy()
        if isinstance(self.stepper, Alpha2):
            self.stepper.destroy()
        self.moving.destroy()
        for vector in (self._f, self._U, self._V):
            vector.destroy()
