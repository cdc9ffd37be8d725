"""Newton's method by PETSc SNES, whose convergence test compares nodal forces.

Used by statics directly and by implicit dynamics through TS.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions, PetscValue
from dolfin_elastic.core.signals import raise_if_agreed
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.problem.term import Multipliers, ScalarUnknowns
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import Choice
from dolfin_elastic.solvers.linear.ksp import LinearSolver
from dolfin_elastic.solvers.nonlinear.bordered import Bordered, JoinedScalars, python_solver
from dolfin_elastic.solvers.nonlinear.convergence import (
    ConvergenceTest,
    Inertia,
    IterationCheck,
    NewtonResult,
    Tolerance,
)
from dolfin_elastic.solvers.nonlinear.jacobian import InversionGuard, JacobianWatch
from dolfin_elastic.solvers.nonlinear.passage import PassageGuard, free_share, motion_of
from dolfin_elastic.solvers.nonlinear.scalars import FreeStrains, UniformPressure
from dolfin_elastic.solvers.petsc.monitors import FileMonitors
from dolfin_elastic.solvers.petsc.options import Options, failed_by_petsc, ksp_reason, snes_reason

log = logging.getLogger("dolfin_elastic")


@dataclass(frozen=True)
class Soft:
    """What one judgement of stability leaves for the next, owned rows of displacements.

    Attributes:
        directions: Along which it solved with the tangent.
        motions: These solutions, owned entries of all unknowns.
        force: One with a part in every mode; None before the first judgement.
        responses: Motions that it causes, roughly, in the last states that were stable: soft modes
            stand out of them.
        starts: Forces at `displacement_dofs` with which factors are asked first.
    """

    directions: tuple[FloatArray, ...] = ()
    motions: tuple[FloatArray, ...] = ()
    force: FloatArray | None = None
    responses: tuple[FloatArray, ...] = ()
    starts: tuple[FloatArray, ...] = ()


Shift = Callable[[float, float], float]
"""From free residual and target [N] to the share of the tangent's diagonal that is added to it."""


class Newton:
    """A SNES for one assembler, with `ConvergenceTest` in place of PETSc's tests.

    Args:
        tolerance: When equilibrium counts as found.
        defaults: More PETSc options, such as the line search; `users`, the user's, win.
        snes: A SNES made elsewhere (by TS); its functions are then set elsewhere too, and whoever
            sets them calls `begin`, `take_tangent`, then `linear.take`, and `finish`.
        inertia: In motion: it counts for what the residual is measured against, and for its
            round-off.
        watch: Of det F: steps are shortened until no cell is inside out, but in linear problems,
            where only the solution is checked.

    Attributes:
        result: How the last solve ended.
        guard: Shortens steps that turn cells inside out; None without `watch`.
        ksp: The linear solver of the fields, managed by `linear`.
        bordered: The system with scalar unknowns, if there are any.
        test: When a solve ends.
        factorised: The factors are those of the tangent at the end of the last solve.
        shift: Share of its diagonal that was added to the last tangent.
        soft: What the last judgement of stability has left.
    """

    def __init__(
        self,
        assembler: Assembler,
        choice: Choice,
        tolerance: Tolerance,
        *,
        defaults: PetscOptions | None = None,
        users: PetscOptions | None = None,
        snes: PETSc.SNES | None = None,
        inertia: Inertia | None = None,
        scalars: ScalarUnknowns | None = None,
        watch: JacobianWatch | None = None,
    ) -> None:
        self.assembler, self.choice, self.tolerance = assembler, choice, tolerance
        self.result, self._inertia = NewtonResult(), inertia
        self.shift, self.factorised, self.soft = 0.0, False, Soft()
        self._shift_of: Shift | None = None
        self._multipliers: list[Multipliers] = []  # what else are unknowns in this solve
        body = assembler.problem.body
        self.span, self.cell_size = span(body), cell_size(body)
        self._owns = snes is None
        self.options = Options({**_SNES, **choice.options, **(defaults or {})}, users or {})
        self.snes = PETSc.SNES().create(assembler.comm) if snes is None else snes
        self.bordered: Bordered | None = None
        self.ksp = self.snes.ksp
        if scalars is not None:
            self.ksp = PETSc.KSP().create(assembler.comm)
            self.bordered = Bordered(assembler, scalars, self.ksp)
        self.guard = None if watch is None else InversionGuard(assembler, watch, self.bordered)
        self.test = ConvergenceTest(
            assembler, tolerance, inertia=inertia, bordered=self.bordered, guard=self.guard
        )
        self._monitors: FileMonitors | None = None
        self._passage: PassageGuard | None = None
        if FileMonitors.NAMES & self.options.users.keys():
            self._monitors = FileMonitors(self.snes, self.ksp, self.options)
        self.linear = LinearSolver(assembler, self.options, self.ksp, self.snes)
        self._source: Assembler | Bordered = self.bordered or assembler
        matrix = assembler.tangent.matrix if self.bordered is None else self.bordered.matrix
        self._matrix: PETSc.Mat = matrix
        self._x, self._f = self._source.create_vector(), self._source.create_vector()
        if self._owns:
            self.snes.setFunction(self._residual, self._f)
            self.snes.setJacobian(self._tangent, self._matrix)
        try:
            self._configure()
        except Exception:  # the same on all ranks: nobody else can free what is there already
            self.destroy()
            raise

    def _configure(self) -> None:
        self.snes.setOptionsPrefix(PREFIX)
        if self.bordered is not None:
            python_solver(self.snes, self.bordered, PREFIX + "bordered_")
            self.ksp.setOptionsPrefix(PREFIX)
            self.ksp.setOperators(self.assembler.tangent.matrix)
        with self.options.in_force(), self.options.elastic_errors():
            self.snes.setFromOptions()
            self.linear.set_up()
        if not self.choice.direct:
            self.linear.factorise_each_tangent()
        chosen = {name: str(self.choice.options.get(name)) for name in ("ksp_type", "pc_type")}
        taken = {"ksp_type": self.ksp.getType(), "pc_type": self.ksp.getPC().getType()}
        if taken != chosen:
            log.info("PETSc options make it: %s with %s", taken["ksp_type"], taken["pc_type"])
        self.install_test()
        if not self.assembler.problem.linear:
            self.snes.setLineSearchPreCheck(self._shorten)
        terms = self.assembler.problem.terms
        if terms.opens or terms.bars:
            self._passage = PassageGuard(self.assembler, self.snes, self._source)

    def install_test(self, max_iterations: int | None = None) -> None:
        """Makes the SNES use our test of convergence, and none of PETSc's tolerances."""
        most = max_iterations or self.tolerance.max_iterations
        self.snes.setTolerances(rtol=0.0, atol=0.0, stol=0.0, max_it=most)
        self.snes.setConvergenceTest(self.test)

    def fall_back(self) -> bool:
        """Goes to a more robust linear solver, if there is one. Collective."""
        return self._fall_back(self.result.reason)

    def _fall_back(self, reason: str) -> bool:
        changed = self.linear.fall_back(reason)
        if self._owns and self.bordered is None and self._matrix != self.assembler.tangent.matrix:
            self._matrix = self.assembler.tangent.matrix  # of entries, to be factorised
            self.snes.setJacobian(self._tangent, self._matrix)
        return changed

    def line_searches(self) -> tuple[str, ...]:
        """Line searches to try in turn, by PETSc's names.

        Full Newton steps come first: in bending, the residual has to rise before it falls, and a
        line search that forbids it takes several times the iterations.  What full steps cannot
        do, for want of a finite residual above all, backtracking may.
        """
        chosen = self.options.users.get("snes_linesearch_type")
        return (str(chosen),) if chosen else ("basic", "bt")

    # --- one solve ---

    def solve(
        self,
        line_search: str,
        *,
        shift: Shift | None = None,
        max_iterations: int | None = None,
        check: IterationCheck | None = None,
    ) -> NewtonResult:
        """Finds equilibrium from the problem's present displacement. Collective.

        The problem's displacement is the last iterate afterwards, converged or not.

        Args:
            shift: What is added to the diagonal of the tangent; None: Newton's method.
            check: See `ConvergenceTest.begin`.

        Raises:
            StoppedError: A signal has asked for the end of the run.
            InputError: A load has no finite value now, or PETSc cannot do what the user's options
                ask for: preconditioners of levels, blocks and factors are made only here.
        """
        self._shift_of = shift
        self._multipliers = self._joint(line_search) if (shift or check) is None else []
        with (
            stage("solve"),
            ExitStack() as left,
            self.options.in_force(snes_linesearch_type=line_search),
            self.options.elastic_errors(),
        ):
            left.callback(self._end_multipliers)
            self.install_test(max_iterations)
            self.snes.setFromOptions()
            self.ksp.setFromOptions()
            self.begin(
                multipliers=self._multipliers,
                backtracks=line_search == "bt",
                patient=shift is not None,
                max_iterations=max_iterations,
                check=check,
            )
            if self.guard is not None:
                self.guard.begin()
            self._source.get(self._x)
            try:
                self.snes.solve(None, self._x)
                failed = ""
            except PETSc.Error as error:
                failed = failed_by_petsc(error)
                if self.options.users or not failed:
                    raise
                self.linear.refresh()
            if self.test.interrupted:
                raise_if_agreed(self.assembler.comm)
            self.finish(failed)
            self._source.put(self._x)
            self._end_multipliers(found=self.result.converged)
            at_rest = self._inertia is None  # in motion the stage does so: it has rows of its own
            if at_rest and self.result.converged and self.assembler.settle_pressures():
                self.assembler.residual.assemble()
            self.options.report_unused()
        return self.result

    def _joint(self, line_search: str) -> list[Multipliers]:
        """The multipliers that are unknowns in a solve with full steps.

        Backtracking looks at the displacement alone: then they follow it, and in motion do so.
        """
        terms, moving = self.assembler.problem.terms, self._inertia is not None
        if line_search != "basic" or self.bordered is not None or terms.bars or moving:
            return []
        return [term.multipliers for term in terms if term.multipliers is not None]

    def _end_multipliers(self, *, found: bool = False) -> None:
        """What else was unknown is so no longer; after errors, too. Collective where found."""
        for one in self._multipliers:
            one.end(found=found)
        self._multipliers = []

    def begin(
        self,
        *,
        multipliers: Sequence[Multipliers] = (),
        backtracks: bool = False,
        patient: bool = False,
        max_iterations: int | None = None,
        check: IterationCheck | None = None,
    ) -> None:
        """Forgets the last solve. Collective.

        Args:
            multipliers: See `ConvergenceTest.begin`.
            backtracks: The same.
            patient: The same.
            max_iterations: The same.
            check: The same.

        Raises:
            InputError: A load has no finite value now.
        """
        self.result, self.factorised = NewtonResult(), False
        self.test.begin(
            multipliers=multipliers,
            backtracks=backtracks,
            patient=patient,
            max_iterations=max_iterations,
            check=check,
        )

    def finish(self, failed: str = "") -> NewtonResult:
        """Stores how SNES has ended as `result`. Collective.

        Args:
            failed: PETSc's error at which SNES has ended, of a preconditioner.
        """
        number, linear = self.snes.getConvergedReason(), self.ksp.getConvergedReason()
        if failed:
            log.debug("PETSc: %s", failed)
            number = PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
            linear = PETSc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED
        reason = snes_reason(number)
        if number == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            reason += f" ({ksp_reason(linear)})"
        krylov = self.snes.getLinearSolveIterations()
        if self.bordered is not None:
            krylov = self.bordered.iterations
        rejected, worst = 0, None
        if self.guard is not None and self.guard.rejected:
            value, place = self.guard.worst
            rejected, worst = self.guard.rejected, (value, tuple(map(float, place)))
        self.result = NewtonResult(
            residuals=tuple(self.test.residuals),
            newton=self.snes.getIterationNumber(),
            krylov=0 if self.linear.direct else krylov,
            reason=reason,
            converged=number > 0,
            rejected=rejected,
            worst=worst,
            target=self.test.target(),
            predicted=self.test.predicted,
        )
        return self.result

    def reject(self, jacobian: float, place: FloatArray) -> None:
        """Marks the last result as one that leads to an inverted cell.

        Args:
            place: Reference place of that cell [m].
        """
        self.result = self.result.inverted(jacobian, place)

    # --- all unknowns ---

    def unknowns(self) -> FloatArray:
        """A copy of all unknowns: local array of the fields, and scalars behind them."""
        fields = self.assembler.problem.w.x.array
        if self.bordered is None:
            return np.asarray(fields.copy())
        return np.concatenate([fields, self.bordered.scalars.get()])

    def put_back(self, unknowns: FloatArray) -> None:
        """Changes all unknowns to a copy that `unknowns` has made. Not collective."""
        problem = self.assembler.problem
        fields = problem.w.x.array
        fields[:] = unknowns[: len(fields)]
        if self.bordered is not None:
            self.bordered.scalars.put(unknowns[len(fields) :])
        problem.unknowns.w_to_u()

    def solution(self) -> FloatArray:
        """Owned entries of where the last solve has ended, from `assembler.origin`."""
        return np.asarray(self._x.array_r[: self.assembler.size].copy())

    # --- what SNES calls ---

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        if self.bordered is None:
            self.assembler.residual.evaluate(x, f)
        else:
            self.bordered.residual(x, f)

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        if sum(one.linearise() for one in self._multipliers):
            f = snes.getFunction()[0]
            self.assembler.residual.evaluate(x, f)
            self.test.take_norm(f.norm())
        if self.bordered is None:
            self.assembler.tangent.assemble(x)
        else:
            self.bordered.renew(x)
            self.test.take_loads()  # scalars may load the body
        self.take_tangent(self.assembler.tangent.matrix)
        self.shift = 0.0
        if self._shift_of is not None:
            self.shift = self._shift_of(self.assembler.residual.free_norm, self.test.target())
        if self.shift > 0.0:
            self.assembler.tangent.shift_diagonal(self.shift)
        self.linear.take(self.assembler.tangent.matrix)

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shortens steps between states that alternate, or that invert or pass. Collective."""
        shorter, terms, length = False, self.assembler.problem.terms, y.norm()
        if self._multipliers:
            motion = motion_of(self.assembler, x, y)
            for one in self._multipliers:
                one.foresee(motion)
        elif self._passage is not None and (terms.bars or self.test.alternates()):
            shorter = self._passage.shorten(x, y)
        if terms.joins:
            if self.bordered is not None:  # trials have moved obstacles under forces
                self.bordered.scalars.put(self.bordered.scalar_part(x))
            share = free_share(self.assembler, x, y)
            if share < 1.0:
                y.scale(share)
                shorter = True
                if self.guard is not None:
                    self.guard.passes += 1
        shorter |= self.guard is not None and self.guard.shorten(x, y)
        for one in self._multipliers:
            one.take_step(y.norm() / length if shorter else 1.0)
        return shorter

    def take_tangent(self, P: PETSc.Mat) -> None:
        """Sets the linear tolerance and the round-off floor from a fresh tangent. Collective.

        `linear.take` has to follow.
        """
        self.test.round_off.renew(P)
        self.set_linear_tolerance()

    def set_linear_tolerance(self) -> None:
        """Sets how exact the next linear solve has to be. Collective."""
        if not self.linear.direct and "ksp_rtol" not in self.options.users:
            self.ksp.setTolerances(rtol=self.test.linear_tolerance())
            self.linear.judge(may_be_last=self.test.may_be_last())

    def factorise(self, *, anew: bool = True) -> None:
        """Assembles and factorises the tangent where the problem is. Collective.

        Args:
            anew: Else the factors of the tangent before are left, if there are any, and its
                preconditioner, if it serves for many digits.

        Raises:
            InputError: See `solve`.
        """
        self._shift_of, self.factorised = None, self.factorised or anew
        self._source.get(self._x)
        with ExitStack() as left, self.options.in_force(), self.options.elastic_errors():
            left.enter_context(stage("solve"))
            if not anew:
                left.enter_context(self.linear.many_digits())
            self._tangent(self.snes, self._x, self._matrix, self._matrix)
            self.ksp.setOperators(self.assembler.tangent.matrix)
            self.ksp.setUp()
            if self.bordered is not None:
                self.bordered.eliminate()

    # --- from one run to the next ---

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`: stiffness, linear solver in use, first residual. Not collective."""
        return {
            "stiffest": self.test.round_off.first,
            "linear": self.ksp.getType(),
            "first": self.test.first,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; evaluates the tangent of the problem's present state. Collective."""
        self.test.round_off.restore(saved["stiffest"])
        self.test.first = float(saved.get("first", 0.0))
        x = self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.tangent.assemble(x, 0.0 if self._inertia is None else self._inertia.factor)
        x.destroy()
        self.take_tangent(self.assembler.tangent.matrix)
        while self.ksp.getType() != saved["linear"] and self._fall_back("before the checkpoint"):
            with self.options.in_force():
                self.ksp.setFromOptions()

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.linear.destroy()
        if self._monitors is not None:
            self._monitors.close()
        if self._passage is not None:
            self._passage.destroy()
        if self._owns:
            self.snes.destroy()
        if self.bordered is not None:
            self.bordered.free()
        # Also the one of SNES: what Python alone still holds is never freed on several ranks.
        self.ksp.destroy()
        self._x.destroy()
        self._f.destroy()


_SNES: dict[str, PetscValue] = {
    "snes_type": "newtonls",
}


def scalar_unknowns(assembler: Assembler) -> JoinedScalars | None:
    """All scalar unknowns of a problem; None without any. Collective.

    Those of its terms, free strains of a periodic cell, and uniform pressures that both change.
    """
    parts: list[ScalarUnknowns] = [*assembler.problem.terms.scalars]
    if assembler.cell is not None and assembler.cell.cell.free:
        parts.append(FreeStrains(assembler.cell))
    enclosed = [] if assembler.level is None else assembler.level.bodies
    parts += [UniformPressure(assembler, body) for body in enclosed if body.coupled]
    return JoinedScalars(parts) if parts else None
