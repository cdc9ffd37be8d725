"""Newton's method by PETSc SNES, judged on the forces that are out of balance.

Used by statics directly and by implicit dynamics through TS.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.petsc_options import PREFIX
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import Choice
from dolfin_elastic.solvers.linear.ksp import LinearSolver
from dolfin_elastic.solvers.messages import worthless
from dolfin_elastic.solvers.nonlinear.bordered import Bordered, ScalarUnknowns, python_solver
from dolfin_elastic.solvers.nonlinear.convergence import SAFETY, Progress, RoundOff, Tolerance
from dolfin_elastic.solvers.nonlinear.jacobian import PATIENCE, InversionGuard
from dolfin_elastic.solvers.petsc.options import Options, ksp_reason, snes_reason

log = logging.getLogger("dolfin_elastic")

FORCING = 1e-3
"""Relative tolerance of a linear solve inside Newton: tighter ones cost more than they save."""

LINEAR = 1e-12
"""The same where one linear solve is all: as tight as the residual is judged."""

STALL = 6
"""Backtracking iterations over which the residual has to fall by a third."""

HOPELESS = 1e8
"""Growth of the residual from which no Newton iteration comes back."""


class Inertia(Protocol):
    """What of the residual and of the tangent is inertia, kept up to date by the time scheme."""

    @property
    def mass(self) -> PETSc.Vec:
        """Diagonal of the mass matrix [kg], in the layout of all unknowns."""

    @property
    def factor(self) -> float:
        """Factor of the mass matrix in the tangent [1/s^2]."""

    @property
    def norm(self) -> float:
        """Norm of the inertia forces at the present iterate [N]."""


class Newton:
    """A SNES for one assembler.

    The free residual is compared with the larger of the applied forces and the reactions, so a
    mixed norm of forces and displacements decides nothing; prescribed values must hold exactly.

    Args:
        assembler: Residual and tangent.
        choice: Linear solver.
        tolerance: When equilibrium counts as found.
        defaults: More PETSc options, such as the line search; `users`, the user's, win.
        snes: A SNES made elsewhere (by TS); its functions are then set elsewhere too.
        inertia: In motion, what of the residual and its tangent is inertia: it counts for what the
            residual is measured against, and for its round-off.
        border: Scalar unknowns beside the fields.

    Attributes:
        guard: Shortens steps that turn cells inside out, after `watch_inversion`.
        ksp: The linear solver of the fields, looked after by `linear`.
        bordered: The system with scalar unknowns, if there are any.
        round_off: Of the last tangent.
        factorised: The factors are those of where the last solve has ended.
        shift: Share of its diagonal that was added to the last tangent.
    """

    def __init__(
        self,
        assembler: Assembler,
        choice: Choice,
        tolerance: Tolerance,
        *,
        defaults: Mapping[str, Any] | None = None,
        users: Mapping[str, Any] | None = None,
        snes: PETSc.SNES | None = None,
        inertia: Inertia | None = None,
        border: ScalarUnknowns | None = None,
    ) -> None:
        self.assembler, self.choice, self.tolerance = assembler, choice, tolerance
        self.progress, self._inertia = Progress(), inertia
        self.shift, self.factorised = 0.0, False
        self._flow: Callable[[float, float], float] | None = None
        self._external = 0.0
        self.round_off = RoundOff(assembler)
        self._floor = self._first = self._norm = 0.0
        self._line_search = ""
        body = assembler.problem.body
        self.span, self.cell_size = span(body), cell_size(body)
        self._owns = snes is None
        self.options = Options({**_SNES, **choice.options, **(defaults or {})}, users or {})
        self.snes = PETSc.SNES().create(assembler.comm) if snes is None else snes
        self.guard: InversionGuard | None = None
        self.bordered: Bordered | None = None
        self.ksp = self.snes.ksp
        if border is not None:
            self.ksp = PETSc.KSP().create(assembler.comm)
            self.bordered = Bordered(assembler, border, self.ksp)
        self.linear = LinearSolver(assembler, self.options, self.ksp, self.snes)
        self._source: Assembler | Bordered = self.bordered or assembler
        self._x, self._f = self._source.create_vector(), self._source.create_vector()
        if self._owns:
            self.snes.setFunction(self._residual, self._f)
            self.snes.setJacobian(self._tangent, self._source.matrix)
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
            self.ksp.setOperators(self.assembler.matrix)
        with self.options.in_force(), self.options.input_errors():
            self.snes.setFromOptions()
            self.linear.set_up()
        if not self.choice.direct:
            self.linear.factorise_each_tangent()
        chosen = {name: str(self.choice.options.get(name)) for name in ("ksp_type", "pc_type")}
        taken = {"ksp_type": self.ksp.getType(), "pc_type": self.ksp.getPC().getType()}
        if taken != chosen:
            log.info("PETSc options make it: %s with %s", taken["ksp_type"], taken["pc_type"])
        self.judge()

    def allow(self, iterations: int, flow: Callable[[float, float], float] | None) -> None:
        """Changes how many iterations a solve may take, and what is added to the tangent.

        Args:
            iterations: At most so many.
            flow: From free residual and target [N] to the share of the tangent's diagonal that is
                added to it; None: Newton's method.
        """
        self.tolerance = replace(self.tolerance, max_iterations=iterations)
        self._flow = flow
        self.judge()

    def watch_inversion(self) -> None:
        """Lets no trial state hold a cell that is inside out. Collective.

        A linear problem has one solution only, which is judged when it is found.
        """
        self.guard = InversionGuard(self.assembler, self.bordered)
        if not self.assembler.problem.linear:
            self.snes.setLineSearchPreCheck(self.guard.shorten)

    def judge(self) -> None:
        """Makes the SNES use our test of convergence."""
        self.snes.setTolerances(rtol=0.0, atol=0.0, stol=0.0, max_it=self.tolerance.max_iterations)
        self.snes.setConvergenceTest(self._test)

    @property
    def mass_factor(self) -> float:
        """Factor of the mass matrix in the tangent [1/s^2], 0 in statics."""
        return 0.0 if self._inertia is None else self._inertia.factor

    @property
    def direct(self) -> bool:
        """The linear solver factorises."""
        return self.linear.direct

    def refresh(self) -> None:
        """Lets the preconditioner begin anew, see `LinearSolver`. Collective."""
        self.linear.refresh()

    def fall_back(self) -> bool:
        """Goes to a linear solver that stands more, if there is one. Collective."""
        return self.linear.fall_back(self.progress.reason)

    # --- one solve ---

    def begin(self, reference: float = 0.0) -> None:
        """Forgets the last solve.

        Args:
            reference: Further force to measure the residual against [N].

        Raises:
            InputError: A load has no finite value now.
        """
        self.progress, self.factorised = Progress(reference=reference), False
        self._external = self.assembler.external_norm()
        if not np.isfinite(self._external):
            raise worthless(float(self.assembler.problem.t.value))

    def ladder(self) -> tuple[str, ...]:
        """Line searches to try in turn, by PETSc's names.

        Full Newton steps come first: in bending, the residual has to rise before it falls, and a
        line search that forbids it takes several times the iterations.  What full steps cannot
        do, for want of a finite residual above all, backtracking may.
        """
        chosen = self.options.users.get("snes_linesearch_type")
        return (str(chosen),) if chosen else ("basic", "bt")

    def solve(self, line_search: str) -> Progress:
        """Finds equilibrium from the problem's present displacement. Collective.

        The problem's displacement is the last iterate afterwards, converged or not.

        Args:
            line_search: PETSc's name of it.
        """
        self._line_search = line_search
        with stage("solve"), self.options.in_force(snes_linesearch_type=line_search):
            self.snes.setFromOptions()
            self.ksp.setFromOptions()
            self.begin()
            if self.guard is not None:
                self.guard.begin()
            self._source.get(self._x)
            self.snes.solve(None, self._x)
            self.finish()
            self._source.put(self._x)
            self.options.report_unused()
        return self.progress

    def finish(self) -> None:
        """Notes how the solve ended."""
        p, number = self.progress, self.snes.getConvergedReason()
        p.newton, p.krylov = self.snes.getIterationNumber(), self.snes.getLinearSolveIterations()
        if self.bordered is not None:
            p.krylov = self.bordered.iterations
        p.converged, p.reason = number > 0, snes_reason(number)
        if number == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            p.reason += f" ({ksp_reason(self.ksp.getConvergedReason())})"
        if self.guard is not None and self.guard.rejected:
            value, place = self.guard.worst
            p.rejected, p.worst = self.guard.rejected, (value, tuple(map(float, place)))
        p.target, p.floor = self._target(), self._floor
        if self.direct:
            p.krylov = 0

    def present(self) -> FloatArray:
        """A copy of all unknowns: local array of the fields, and scalars behind them."""
        fields = self.assembler.problem.w.x.array
        if self.bordered is None:
            return np.asarray(fields.copy())
        return np.concatenate([fields, self.bordered.border.get()])

    def put_back(self, unknowns: FloatArray) -> None:
        """Changes all unknowns to those of `present`. Not collective."""
        problem = self.assembler.problem
        fields = problem.w.x.array
        fields[:] = unknowns[: len(fields)]
        if self.bordered is not None:
            self.bordered.border.put(unknowns[len(fields) :])
        problem.unknowns.tell()

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`: the first stiffness and the linear solver in use. Not collective."""
        return {"stiffest": self.round_off.first, "linear": self.ksp.getType()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; evaluates the tangent of the problem's present state. Collective."""
        self.round_off.first = saved["stiffest"]
        x = self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.tangent(x, self.mass_factor)
        x.destroy()
        self.note_tangent(self.assembler.matrix)
        self.progress.reason = "before the checkpoint"
        while self.ksp.getType() != saved["linear"] and self.fall_back():
            with self.options.in_force():
                self.ksp.setFromOptions()

    def found(self) -> FloatArray:
        """Owned entries of where the last solve ended, from `assembler.origin`."""
        return np.asarray(self._x.array_r[: self.assembler.size].copy())

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._source.residual(x, f)

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        if self.bordered is None:
            self.assembler.tangent(x)
        else:
            self.bordered.renew(x)
            self._external = self.assembler.external_norm()  # scalars may load the body
            self.linear.set_tangent(self.assembler.matrix)
        self.note_tangent(self.assembler.matrix)
        self.shift = 0.0 if self._flow is None else self._flow(self.assembler.free, self._target())
        if self.shift > 0.0:
            self.assembler.shift_diagonal(self.shift)

    def factorise(self) -> None:
        """Assembles and factorises the tangent where the problem is. Collective."""
        self._flow, self.factorised = None, True
        self._source.get(self._x)
        with stage("solve"), self.options.in_force():
            self._tangent(self.snes, self._x, self._source.matrix, self._source.matrix)
            self.ksp.setOperators(self.assembler.matrix)
            self.ksp.setUp()
            if self.bordered is not None:
                self.bordered.eliminate()

    def note_tangent(self, P: PETSc.Mat) -> None:
        """Sets the linear tolerance and the round-off floor from a fresh tangent. Collective."""
        a = self.assembler
        self.round_off.renew(P)
        self._floor = self.round_off.norm
        if self._inertia is not None:
            # Round-off of the stress is that of F, round-off of inertia that of x.
            factor, mass = self._inertia.factor, self._inertia.mass
            diagonal = P.getDiagonal()
            diagonal.axpy(-factor, mass)
            heavy = factor * float(mass.norm()) * a.max_unknown()
            stiff = float(diagonal.norm()) * max(self.cell_size, a.max_displacement())
            self._floor = SAFETY * np.finfo(float).eps * (stiff + heavy)
            diagonal.destroy()
        if not self.direct and "ksp_rtol" not in self.options.users:
            forcing = LINEAR if a.problem.linear else FORCING
            needed = 0.5 * self._target() / self._norm if self._norm > 0 else forcing
            self.ksp.setTolerances(rtol=min(0.1, max(forcing, needed)))

    def _wanted(self) -> float:
        a, p = self.assembler, self.progress
        reference = max(self._external, a.held, a.pushed, p.reference)
        if self._inertia is not None:
            reference = max(reference, self._inertia.norm)
        return max(self.tolerance.rtol * reference, self.tolerance.atol)

    def _target(self) -> float:
        return max(self._wanted(), self._floor)

    def _balanced(self) -> bool:
        """The free residual is as small as wanted, but for the round-off of each row."""
        free, wanted = self.assembler.free, self._wanted()
        if free <= wanted or self._inertia is not None:
            return free <= self._target()
        return free <= HOPELESS * self._floor and self.round_off.beyond() <= wanted

    def _test(
        self,
        snes: PETSc.SNES,
        iteration: int,
        norms: tuple[float, float, float],
    ) -> int:
        a = self.assembler
        if iteration == 0:
            self.progress.residuals.clear()
            self._first = norms[2]
        if iteration == 1:
            self.progress.predicted = norms[1]
        self._norm = norms[2]
        self.progress.residuals.append(a.free)
        if not norms[2] <= HOPELESS * max(self._first, self._target()):  # NaN, too
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN)
        held = a.gap <= 1e-12 * self.span
        if held and self._balanced() and self._settled():
            return int(PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE)
        if self._crushed():
            return int(PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN)
        if self._stalled():
            return int(PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH)
        if iteration >= self.tolerance.max_iterations:
            return int(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
        return 0

    def _crushed(self) -> bool:
        """Steps are shortened again and again: a smaller load step gets there sooner."""
        guard = self.guard
        patient = self._flow is not None
        return guard is not None and (guard.stuck or (guard.rejected > PATIENCE and not patient))

    def _settled(self) -> bool:
        if self.bordered is None:
            return True
        return self.bordered.border.settled(self.bordered.last, self._target())

    def _stalled(self) -> bool:
        """Backtracking takes ever smaller steps: a smaller load step gets there sooner."""
        norms = self.progress.residuals
        return (
            self._line_search == "bt"
            and self._inertia is None
            and len(norms) > STALL
            and norms[-1] > 0.7 * norms[-1 - STALL]
        )

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.linear.destroy()
        if self._owns:
            self.snes.destroy()
        if self.bordered is not None:
            self.bordered.free()
            self.ksp.destroy()
        self._x.destroy()
        self._f.destroy()


_SNES: dict[str, Any] = {
    "snes_type": "newtonls",
}
