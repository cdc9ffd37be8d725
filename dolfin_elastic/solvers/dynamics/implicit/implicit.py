"""Implicit motion by PETSc's TS: the loop over steps, the yielded states, and restarts."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.errors import ConvergenceError
from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions, PetscValue
from dolfin_elastic.core.signals import raise_if_agreed
from dolfin_elastic.core.timing import stage
from dolfin_elastic.problem.problem import Problem, conserves, over_step, results_of
from dolfin_elastic.problem.state import RestartState, SavedState, State, restoring
from dolfin_elastic.problem.term_list import conserve_in_steps
from dolfin_elastic.problem.weak_form import derives_from_strain
from dolfin_elastic.solvers.assembly.assembler import SupportForces
from dolfin_elastic.solvers.assembly.energy_momentum import NodalMass
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.diagnostics.diagnose import diagnose
from dolfin_elastic.solvers.dynamics.audit import CONSERVING, MAX_ENERGY_GAIN, MotionAuditor
from dolfin_elastic.solvers.dynamics.consistent_start import (
    AuxiliaryFields,
    find_initial_acceleration,
    settle_auxiliary_fields,
)
from dolfin_elastic.solvers.dynamics.implicit.gain import GainRemoval
from dolfin_elastic.solvers.dynamics.implicit.generalized_alpha import GeneralizedAlphaParameters
from dolfin_elastic.solvers.dynamics.implicit.output_times import OutputTimes
from dolfin_elastic.solvers.dynamics.implicit.scheme import SchemeContext
from dolfin_elastic.solvers.dynamics.implicit.step_control import (
    StepControl,
    warn_of_inexact_restart,
)
from dolfin_elastic.solvers.dynamics.implicit.volume_constraint import (
    PressureEnergy,
    VolumeConstraint,
)
from dolfin_elastic.solvers.dynamics.initial_conditions import support_jump
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual
from dolfin_elastic.solvers.dynamics.schemes import ImplicitRow
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.dynamics.work import EnergyBalance, MotionBook
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose, in_blocks
from dolfin_elastic.solvers.messages import JUMP, in_words
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.petsc.options import Options, ts_reason

log = logging.getLogger("dolfin_elastic")


class TSOutput:
    """Prints each step once, in PETSc's format, and TS at the end. Collective.

    TS monitors the state that a solve begins with and the one that it ends with, and is viewed at
    the end of each solve: with as many solves as states, each state would be printed twice and TS
    as often as there are states.

    Viewers other than ASCII ones, such as `draw`, stay with PETSc.

    Args:
        ts: Whose steps are printed; its options are set already, but for these two.
        options: Of which the user's `ts_monitor` and `ts_view` are taken.
    """

    def __init__(self, ts: PETSc.TS, options: Options) -> None:
        self._ts, self._options = ts, options
        self._view = options.take("ts_view")
        self._last: tuple[int, float] | None = None
        self._viewer: PETSc.Viewer | None = None
        self._owned = False
        words = _words(options.users.get("ts_monitor"))
        if "ts_monitor" not in options.users or words[0] not in ("", "ascii"):
            return
        options.take("ts_monitor")
        self._owned = words[1] != ""
        if self._owned:
            mode = "a" if words[3] == "append" else "w"
            self._viewer = PETSc.Viewer().createASCII(words[1], mode, comm=ts.comm)
        else:
            self._viewer = PETSc.Viewer.STDOUT(ts.comm)
        ts.setMonitor(self._print)

    def _print(self, ts: PETSc.TS, step: int, t: float, u: PETSc.Vec) -> None:
        if self._last == (step, t):
            return
        self._last = step, t
        assert self._viewer is not None
        h = float(ts.getTimeStep())
        self._viewer.printfASCII(f"{step} TS dt {_real(h)} time {_real(t)}\n")

    def finish(self) -> None:
        """Views TS, when the motion has come to its end."""
        if self._view:
            with self._options.in_force(**self._view):
                self._ts.viewFromOptions("-ts_view")

    def destroy(self) -> None:
        """Closes a file of its own."""
        if self._owned and self._viewer is not None:
            self._viewer.destroy()


def _words(value: PetscValue) -> list[str]:
    """Type, file, format and mode of a viewer, as PETSc's options spell it."""
    text = "" if value is None or value is True else str(value)
    return [*text.split(":"), "", "", ""][:4]


def _real(value: float) -> str:
    """As PETSc's %g, which puts a point behind whole numbers."""
    text = f"{value:g}"
    return text if set(text) & set(".en") else f"{text}."


CONSERVED = (
    "energy-momentum scheme: the stress of each step does the work by which the strain energy "
    "changes, so energy, linear and angular momentum are conserved"
)

NOT_CONSERVED = (
    "the stress of %s is that of the middle of each step, which conserves the energy to second "
    "order in dt: these laws have none, are linear, or depend on the orientation"
)

MIDPOINT = (
    "with a pressure as an unknown the trapezoidal rule is not stable: its conjugate, the midpoint "
    "rule, with forces and pressure of the middle of each step"
)

AHEAD = 1e-4
"""Largest step, over the whole motion, of the differences in time for the first acceleration of
supports: the first try of an adaptive step may be as long as the motion."""


def suited(problem: Problem, parameters: GeneralizedAlphaParameters) -> GeneralizedAlphaParameters:
    """The coefficients with which a scheme can move a problem. Not collective.

    Raises:
        InputError: There are none.
    """
    pressure = problem.mixed and not problem.unknowns.has("stretch")
    return parameters.with_pressure() if pressure else parameters


def conserving(settings: DynamicsSettings, problem: Problem) -> DynamicsSettings:
    """The settings with a spectral radius of 1 for bodies in contact, if none is given.

    Below 1 the acceleration of the step before pushes in a step, too: where forces begin and end at
    once, that makes energy or takes it.  Not collective.
    """
    row, laws = settings.row, [part.law for part in problem.regions]
    if not (row.implicit and row.conserves and "spectral_radius" in row.keys):
        return settings
    if settings.spectral_radius is not None or not conserve_in_steps(problem.terms):
        return settings
    quadratic = all(law.linear and law.has_energy and law.memory is None for law in laws)
    kept = quadratic or (conserves(problem) and all(map(derives_from_strain, laws)))
    return settings.model_copy(update={"spectral_radius": 1.0}) if kept else settings


def conserved(problem: Problem, settings: DynamicsSettings) -> Problem:
    """The problem with the forces of steps where the scheme conserves the energy. Collective.

    What it does not conserve is logged.
    """
    row, parameters = settings.row, settings.parameters
    assert isinstance(row, ImplicitRow)
    assert parameters is not None
    if not (row.conserves and parameters.midpoint and conserves(problem)):
        return problem
    log.info(CONSERVED)
    others = sorted({p.name for p in problem.regions if not derives_from_strain(p.law)})
    if others:
        log.info(NOT_CONSERVED, ", ".join(f"'{name}'" for name in others))
    return over_step(problem)


def tolerance(settings: DynamicsSettings, problem: Problem) -> Tolerance:
    """When the equations of a step count as solved. Not collective.

    Where energy and momenta are conserved, as well as round-off lets them be, unless a larger
    `rtol` asks for less: what is out of balance in a step does work that no later one takes back.
    """
    rtol, usual = settings.rtol, Tolerance.rtol
    exhaust = problem.weak_form.start is not None and rtol <= usual
    return Tolerance(
        usual if exhaust else rtol,
        settings.atol,
        settings.max_iterations,
        to_round_off=exhaust,
    )


class Implicit:
    """An implicit motion of one problem. Collective.

    Attributes:
        ts: PETSc's TS; its solutions are all unknowns, and the velocity.
        moving: Residual and tangent with inertia.
        newton: Solver of the equations of a step.
        scheme: Takes the steps, registered with `ts`.
        control: Sizes of steps.
        times: Which states are yielded.
        balance: Work and dissipation so far.
        auditor: Of the balances of momentum and energy.
        a: Acceleration of the scheme [m/s^2].
    """

    def __init__(
        self,
        problem: Problem,
        velocity: fem.Function,
        settings: DynamicsSettings,
        linear: LinearSettings,
        petsc: PetscOptions,
    ) -> None:
        self.settings, self.problem, self.v = settings, problem, velocity
        self._owned = ExitStack()
        try:
            self._prepare(linear, petsc)
        except Exception:  # the same on all ranks: nobody else can free what is there already
            self.destroy()
            raise

    def _prepare(self, linear: LinearSettings, petsc: PetscOptions) -> None:
        problem, settings = self.problem, self.settings
        stepped = conserved(problem, settings)
        choice = choose(stepped, linear, moving=True)
        choice.report()
        iterated = in_blocks(choice, petsc)
        self.moving = DynamicResidual(stepped, **settings.damping, iterated=iterated)
        self._owned.callback(self.moving.destroy)
        self.assembler = self.moving.assembler
        self.a = fem.Function(problem.V, name="acceleration of the scheme")
        if problem.mixed:
            HydrostaticConstant(problem).report()
        self.ts = PETSc.TS().create(problem.body.comm)
        self._owned.callback(self.ts.destroy)
        self.ts.setOptionsPrefix(PREFIX)
        self.newton = Newton(
            self.assembler,
            choice,
            tolerance(settings, stepped),
            defaults={"snes_linesearch_type": "basic"},
            users=petsc,
            snes=self.ts.getSNES(),
            inertia=self.moving,
        )
        self._owned.callback(self.newton.destroy)
        self.times = OutputTimes(settings.end, settings.times, settings.every)
        self.control = StepControl(
            self.ts,
            self.moving,
            self.times,
            dt=float(settings.dt or 0.0),
            tolerance=settings.tolerance if settings.adaptive else None,
            span=self.newton.span,
        )
        watch = JacobianWatch(problem)
        parameters = self._make_scheme(watch)
        self._owned.callback(self.scheme.close)
        self.options = self.newton.options
        self.options.update(self._defaults())
        self._U, self._V = (self.assembler.create_vector() for _ in range(2))
        for vector in (self._U, self._V):
            self._owned.callback(vector.destroy)
        self._configure()
        self.balance = EnergyBalance(self.moving, self.v)
        lag, inertia = None, NodalMass(problem, self.v, self.moving.inertia.mass.times)
        at_stage = VolumeConstraint.needed(problem, parameters.alpha_f)
        if at_stage and PressureEnergy.compressible(problem):
            lag = PressureEnergy(problem)
            self._owned.callback(lag.destroy)
        self._energies = MotionBook(problem, inertia, self.balance.energies, lag)
        self._removal = None
        if problem.terms.bars:
            self._removal = GainRemoval(self.moving, self._energies, self.balance, self.v)
        self._supports = SupportForces(self.assembler)
        self.auditor = MotionAuditor(problem, self.moving, watch, parameters, end=settings.end)
        self.auxiliary = AuxiliaryFields(problem)
        self._newton = self._krylov = 0

    # --- TS ---

    def _make_scheme(self, watch: JacobianWatch) -> GeneralizedAlphaParameters:
        """Registers the scheme with TS."""
        row, parameters = self.settings.row, self.settings.parameters
        assert isinstance(row, ImplicitRow)
        assert parameters is not None
        if row.overshoots and self.moving.damping.inside:
            parameters = parameters.without_overshoot()
        chosen = suited(self.problem, parameters)
        if chosen != parameters:
            log.info(MIDPOINT)
            parameters = chosen
        context = SchemeContext(
            ts=self.ts,
            moving=self.moving,
            newton=self.newton,
            control=self.control,
            watch=watch,
            v=self.v,
            a=self.a,
            parameters=parameters,
            adaptive=self.settings.adaptive,
        )
        self.scheme = row.scheme(context)
        return parameters

    def _defaults(self) -> dict[str, PetscValue]:
        more = {"snes_linesearch_type": "basic", **self.newton.choice.options}
        return {**self.control.options, **more, **self.scheme.options}

    def _configure(self) -> None:
        ts = self.ts
        ts.setTime(0.0)
        ts.setTimeStep(self.settings.dt)
        ts.setMaxTime(self.settings.end)
        ts.setMaxSteps(10**9)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
        ts.setSolution2(self._U, self._V)
        self._output = TSOutput(ts, self.options)
        self._owned.callback(self._output.destroy)
        with self.options.in_force(), self.options.elastic_errors():
            ts.setFromOptions()
        ts.setErrorIfStepFails(False)
        ts.setPreStep(self._before_step)
        ts.setPostStep(self._after_step)
        self.newton.install_test()

    def _before_step(self, ts: PETSc.TS) -> None:
        self.control.begin_step()
        self.scheme.begin_step()

    def _after_step(self, ts: PETSc.TS) -> None:
        ts.setMaxTime(self.settings.end)
        if ts.getConvergedReason() < 0:
            return  # TS calls this after a failed step, too
        forces = self.scheme.accept()
        if self.problem.history is not None:
            self.problem.history.commit()
        self.problem.terms.advance()
        self._stop_at_goals()
        self.control.end_step()
        self.balance.add(forces.middle, forces.of_obstacles, forces.du)
        if self._removal is not None and self._removal.end(forces.of_obstacles, forces.du):
            self.moving.copy_to(self._U, self._V, self.v)
        self.auditor.add_step(forces.stage, forces.du)

    def _stop_at_goals(self) -> None:
        """Ends `TSSolve` at the goal, also where the time differs from it by round-off.

        A scheme of PETSc adds up the steps and may miss the goal by a rounding error; TS, which
        compares the times exactly, would take one more tiny step.
        """
        ts = self.ts
        ts.setTime(self.control.without_round_off(float(ts.getTime())))
        shown = self.times.is_output(int(ts.getStepNumber()), float(ts.getTime()))
        if shown and not ts.getConvergedReason():
            ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_TIME)

    # --- the loop ---

    def run(self, saved: SavedState | None = None) -> Iterator[State]:
        """Yields the initial state and then every state asked for. Collective.

        Args:
            saved: A `restart_state` from which the motion continues, with the state after it.
        """
        if saved is None:
            self._begin()
            yield self._state()
            self._renew_loads()
        else:
            with restoring(saved):
                self.restore(saved)
        while not self.times.ended(float(self.ts.getTime())):
            self._march()
            yield self._state()
            self._renew_loads()
            self._newton = self._krylov = 0
        self._output.finish()

    def stop_at(self, t: float) -> None:
        """See `marching.Loop`."""
        self.times.add(t)

    def _renew_loads(self) -> None:
        """Takes over loads that a program has changed while it had the state. Collective.

        The motion goes on from there as from a start: with the acceleration of the new forces.
        """
        t = float(self.ts.getTime())
        if self.times.ended(t) or not self.scheme.loads_changed(t):
            return
        with stage("solve"):
            h = min(self.control.nominal / 8, AHEAD * self.settings.end)
            find_initial_acceleration(self.moving, self.v, self.a, h)
        self.problem.set_time(t)
        self.scheme.start(t)
        self.moving.copy_to(self._U, self._V, self.v)

    def _begin(self) -> None:
        """Forces and acceleration of the initial state."""
        self.control.warn_of_passed_corners()
        if self.problem.history is not None:
            self.problem.history.begin()
        with stage("assemble"):
            self.problem.set_time(0.0)
            for term in self.problem.terms:
                term.go_on()
            size = len(self.moving.displacement_dofs)
            self.moving.set_rates(self.v.x.array[:size], np.zeros(size))
            self.assembler.residual.assemble()
        settle_auxiliary_fields(self.problem, self.assembler)
        if self.problem.history is not None:
            self.problem.history.commit()  # the body is strained suddenly, at the start
        with stage("solve"):
            h = min(self.control.nominal / 8, AHEAD * self.settings.end)
            find_initial_acceleration(self.moving, self.v, self.a, h)
        self.scheme.start(0.0)
        self.problem.set_time(0.0)
        self.balance.begin()
        if self._removal is not None:
            self._removal.begin()
        self.moving.copy_to(self._U, self._V, self.v)

    def _march(self) -> None:
        """Runs TS until the next output state; `TSSolve` returns at each time that is met."""
        ts = self.ts
        while True:
            step = int(ts.getStepNumber())
            ts.setMaxSteps(step + self.times.steps_left(step))
            self._solve()
            if self.times.is_output(int(ts.getStepNumber()), float(ts.getTime())):
                return

    def _solve(self) -> None:
        ts = self.ts
        newton, krylov = self.scheme.counts()
        with stage("solve"), self.options.in_force(), self.options.elastic_errors():
            ts.solve()
            while _failed(ts, self.newton) and self.scheme.fall_back():
                ts.setConvergedReason(PETSc.TS.ConvergedReason.CONVERGED_ITERATING)
                ts.solve()
            self.options.report_unused()
        if self.scheme.error is not None:
            raise self.scheme.error
        if self.newton.test.interrupted:
            raise_if_agreed(self.assembler.comm)
        now = self.scheme.counts()
        newton, krylov = now[0] - newton, 0 if self.newton.linear.direct else now[1] - krylov
        self._newton += newton
        self._krylov += krylov
        if ts.getConvergedReason() < 0:
            raise self._failure()

    def _failure(self) -> ConvergenceError:
        t = float(self.ts.getTime())
        force, place = self.assembler.residual.largest()
        reason = in_words(ts_reason(self.ts.getConvergedReason()))
        last = self.problem.w.x.array.copy()
        diagnosis = diagnose(
            self.assembler, self.newton.result, good=last, failed=last, moving=True
        )
        gain = self._gain()
        if gain > MAX_ENERGY_GAIN:  # whatever gave way did so under that
            scheme, dt = self.settings.scheme, self.settings.dt
            text = (
                f"{100 * gain:.3g} % of the energy has come from nowhere before: the scheme "
                f"'{scheme}' makes it with steps of {dt:.3g} s, neither the loads nor the material"
            )
            other = "" if self.moving.conserves else f", or {CONSERVING}"
            diagnosis = replace(diagnosis, cause="energy", text=text, advice=f"a smaller dt{other}")
        if sudden := support_jump(self.problem, t, self.control.nominal):
            diagnosis = replace(diagnosis, text=f"{sudden}; {diagnosis.text}", advice=JUMP)
        return ConvergenceError(
            f"no solution for the step from t = {t:.6g} s: {reason}; {diagnosis.text}\n"
            "  at the end: "
            f"the largest force out of balance, {force:.3g} N, is at "
            f"{self.problem.body.unit.point(place)}",
            advice=diagnosis.advice,
            state=self._state(failed=True),
            diagnosis=diagnosis,
        )

    def _gain(self) -> float:
        """Energy at the last accepted state that nothing has brought in, over the largest energy.

        Collective.
        """
        size, tried = self.assembler.size, self.problem.w.x.array.copy()
        self.moving.set_unknowns(self.ts.getSolution().array_r[:size])
        off = self.balance.relative_imbalance(self._energies.measure()[0])
        self.moving.set_unknowns(tried[:size])
        return off

    # --- states ---

    def _state(self, *, failed: bool = False) -> State:
        step, t, a = int(self.ts.getStepNumber()), float(self.ts.getTime()), self.assembler
        first = step == 0 and not failed
        if not failed:
            self.scheme.balance_at_end(t)
            self.assembler.check_volumes()
        reactions, moments = self._supports()
        energies, momenta = self._energies.measure()
        audit = None if failed else self.auditor.judge(t, self.balance, energies)
        return State(
            step=-1 if failed else step,
            t=t,
            unit=self.problem.body.unit,
            u=self.problem.u,
            w=self.problem.w,
            v=self.v,
            a=self.scheme.acceleration,
            newton=0 if first else self._newton,
            krylov=0 if first else self._krylov,
            reason="initial state" if first else "converged",
            residuals=self.newton.result.residuals,
            energies=energies,
            reactions=reactions,
            moments=moments,
            momenta=momenta,
            max_displacement=self.assembler.max_displacement(),
            numbers=results_of(self.problem, a.residual.owned[a.displacement_dofs]),
            audit=audit,
            failure=audit.so_far[0] if audit and audit.verdict_so_far == "fail" else "",
            done=t / self.settings.end,
        )

    # --- restarts: keys are those of checkpoint format 3 ---

    def restart_state(self) -> RestartState:
        """See `Restartable`. Collective."""
        self.auxiliary.read()
        numbers = {
            "t": float(self.ts.getTime()),
            "step": int(self.ts.getStepNumber()),
            "dt": float(self.ts.getTimeStep()),
            "scale": self.control.scale,
            "ledger": self.balance.restart_state(),
            "audit": self.auditor.restart_state(),
            "newton": self.newton.restart_state(),
        }
        if self.problem.history is None:
            return RestartState(self._fields(), numbers)
        numbers["history"] = self.problem.history.restart_state()
        return RestartState(self._fields() | self.problem.history.fields(), numbers)

    def _fields(self) -> dict[str, fem.Function]:
        return {
            "displacement": self.problem.u,
            "velocity": self.v,
            "acceleration": self.a,
            "acceleration_at_end": self.scheme.acceleration,
            **self.problem.terms.past,
            **self.auxiliary.fields,
        }

    def restore(self, saved: SavedState) -> None:
        """See `Restartable`. Collective."""
        history = self.problem.history
        past = {} if history is None else history.fields()
        saved.fill(self._fields() | past)
        numbers = saved.numbers
        warn_of_inexact_restart(self.scheme.not_restartable, self.options.users)
        self.auxiliary.write()
        if history is not None:
            history.restore(past, numbers["history"])
        self.ts.setTime(numbers["t"])
        self.ts.setStepNumber(numbers["step"])
        self.ts.setTimeStep(numbers["dt"])
        self.control.restore(numbers["scale"])
        self.problem.set_time(numbers["t"])
        for term in self.problem.terms:
            term.go_on()
        self.balance.restore(numbers["ledger"])
        self.auditor.restore(numbers["audit"])
        self.scheme.resume(numbers["t"])
        if self._removal is not None:
            self._removal.begin()
        self.moving.copy_to(self._U, self._V, self.v)
        self.newton.restore(numbers["newton"])

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self._owned.close()


def _failed(ts: PETSc.TS, newton: Newton) -> bool:
    """Whether a step has no solution, and not because a signal has asked for the end."""
    return ts.getConvergedReason() < 0 and not newton.test.interrupted
