"""Why a solve failed, where, and what to try.

Each cause is decided by evidence, the cheap and certain ones first:

"rigid-motion": the tangent of the last equilibrium maps a rigid motion of a piece to nothing; what
    such a system gives is no evidence of anything else, so this comes before all others; or that
    without contacts does, and the load pulls the body off its obstacles; or contact does not
    hold a body any more in the last iterate of the step that failed.
"sliding": friction gives less than the loads demand of it along a rigid motion.
"obstacle": one pushes into nodes whose displacement is prescribed, where nothing can give way.
"edge": one has entered a face between its vertices, which bear no force of it.
"nan": a term of the residual has no finite value although no cell has turned inside out.
"inverted": solutions were refused because cells had turned inside out.
"round-off": the residual stopped at a level that round-off explains.
"unstable": the tangent of the last equilibrium has a negative eigenvalue, or has lost its stiffness
    against some motion, of which there is less than none in the last iterate; or a material has
    lost ellipticity there, or nearly.
"linear-solver", "stalled", "iterations": what Newton's method itself reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import BadCell, Diagnosis
from dolfin_elastic.core.si_text import percent
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.problem.term_list import intrusion
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics import instability
from dolfin_elastic.solvers.diagnostics.evidence import (
    Cells,
    Fault,
    TrialStates,
    explained,
    not_finite,
)
from dolfin_elastic.solvers.diagnostics.material_limit import NEARLY, softest_spot
from dolfin_elastic.solvers.diagnostics.rigid_body import find_loose_part, pulled_off_obstacles
from dolfin_elastic.solvers.diagnostics.sliding import ContactStates, find_slide, released
from dolfin_elastic.solvers.diagnostics.stability import LIMIT
from dolfin_elastic.solvers.nonlinear.convergence import (
    ANOTHER,
    BEYOND,
    ENTERED,
    UNSTABLE,
    NewtonResult,
)
from dolfin_elastic.solvers.nonlinear.jacobian import PATIENCE

FLOOR = 100.0
"""Times the estimated round-off that a residual may keep to be called so."""


@dataclass(frozen=True)
class RejectedSteps:
    """Trial states and solutions that were refused because a cell had turned inside out.

    Attributes:
        count: How many.
        jacobian: The smallest det F of them.
        place: Where that was, in the reference configuration [m].
    """

    count: int = 0
    jacobian: float = np.inf
    place: tuple[float, ...] = ()

    @classmethod
    def of(cls, result: NewtonResult) -> RejectedSteps:
        """What a solve has refused."""
        J, place = result.worst or (np.inf, ())
        if J > 0.0:
            return cls(result.rejected)
        return cls(result.rejected, float(J), tuple(float(x) for x in place))


def diagnose(
    assembler: Assembler,
    result: NewtonResult,
    *,
    good: FloatArray,
    failed: FloatArray,
    judge_stability: bool = True,
    moving: bool = False,
) -> Diagnosis:
    """Finds out why a solve failed. Collective.

    Args:
        assembler: Residual and tangent; the load is that of the step that failed.
        good: All unknowns at the last equilibrium, local array with ghosts.
        failed: The same at the last iterate; the problem holds it afterwards.
        judge_stability: An equilibrium of this kind has to be stable, and the tangent of the
            fields tells whether it is: not along a path, nor beside scalar unknowns.
        moving: In motion, where a body may be free or unstable.
    """
    with stage("diagnose"):
        search = _CauseSearch(
            assembler,
            result,
            good,
            failed,
            judge_stability=judge_stability and not moving,
            moving=moving,
        )
        try:
            return search.first_cause()
        finally:
            search.states.put(failed)
            assembler.residual.assemble()


class _CauseSearch:
    """Looks for the cause of one failure. Collective. See `diagnose`."""

    def __init__(
        self,
        assembler: Assembler,
        result: NewtonResult,
        good: FloatArray,
        failed: FloatArray,
        *,
        judge_stability: bool,
        moving: bool,
    ) -> None:
        self.assembler, self.result, self.problem = assembler, result, assembler.problem
        self.good, self.failed = good.copy(), failed.copy()
        self._judge_stability, self._moving = judge_stability, moving
        self.rejected = RejectedSteps.of(result)
        self.states, self.cells = TrialStates(assembler), Cells(assembler)
        self._not_examined = ""  # in words, for every diagnosis after the look at stability
        self._contact_changes = ""  # in words, for a stop without another cause
        self._inverted_ahead: Fault | None = None
        self._finite = self.states.residual(self.failed)
        gap = assembler.residual.gap
        self._prescribed = self._finite and gap <= 1e-9 * span(self.problem.body)
        self.worst: tuple[BadCell, ...] = self.cells.worst()

    def first_cause(self) -> Diagnosis:
        """The first cause for which there is evidence."""
        checks = (
            self._loose_part,
            self._held_inside,
            self._sliding,
            self._not_finite,
            self._solution_inverted,
            self._released,
            self._round_off,
            self._unstable,
            self._material_gives_way,
            self._linear_solver,
            self._next_step,
            self._steps_shortened,
            self._inverted_cells,
        )
        for check in checks:
            if (diagnosis := check()) is not None:
                return diagnosis
        return self._stopped()

    def _make(self, cause: str, text: str, advice: str, place: tuple[float, ...] = ()) -> Diagnosis:
        if self._moving and cause in ("inverted", "stalled", "iterations"):
            advice = messages.SMALLER_STEP
        elif self._moving:
            advice = messages.in_motion(advice)
        place = place[: self.problem.body.dim]
        text += self._not_examined + self._yielded()
        return Diagnosis(cause, text, advice, place, self.worst)

    # --- causes, in the order of the checks ---

    def _loose_part(self) -> Diagnosis | None:
        if self._moving or not self.states.tangent(self.good):
            return None
        part, start, advice = find_loose_part(self.assembler), "", messages.HOLD
        if part is None and pulled_off_obstacles(self.assembler):
            with self.problem.terms.assumed(closed=False):
                part = find_loose_part(self.assembler) if self.states.tangent(self.good) else None
            start, advice = "the load pulls it off its obstacles, and then ", messages.LIFTED
        if part is None:
            return None
        unit = self.problem.body.unit
        what = "the body" if part.whole else f"a piece of it about {unit.point(part.place)}"
        what += f" ({part.name})" if part.name and not part.whole else ""
        text = f"{start}nothing holds {what}: as a rigid body it can {', '.join(part.motions)}"
        return self._make("rigid-motion", text, advice, part.place)

    def _held_inside(self) -> Diagnosis | None:
        self.states.put(self.failed)
        for term in self.problem.terms:
            if (found := term.conflict(self.problem.constraints)) is not None:
                return self._make("obstacle", found[0], messages.RELEASE, found[1])
        if self.result.reason == ENTERED and (what := intrusion(self.problem.terms)) is not None:
            text, place, advice = what
            return self._make("edge", text, advice, place)
        return None

    def _sliding(self) -> Diagnosis | None:
        if self._moving or (slide := find_slide(self.states, self.good)) is None:
            return None
        return self._make("sliding", slide.in_words(), messages.SLIDES)

    def _released(self) -> Diagnosis | None:
        """In the last iterate contact holds a body no more."""
        if self._moving or self.result.reason in (UNSTABLE, ANOTHER, BEYOND):
            return None
        self.states.put(self.failed)
        if (found := released(self.problem)) is None:
            return None
        text = f"contact no longer holds {found[0]}: as a rigid body it can {found[1]}"
        return self._make("rigid-motion", text, messages.LIFTED)

    def _not_finite(self) -> Diagnosis | None:
        self.states.residual(self.failed)
        if self._finite and self.states.energy_is_finite():
            return None
        fault = not_finite(self.cells)
        if fault is None or fault.inverted:
            return self._inverted() if fault is not None else None
        return self._nan(fault.text, fault)

    def _nan(self, text: str, fault: Fault) -> Diagnosis:
        return self._make(
            "nan", text, messages.LOAD if fault.load else messages.DOMAIN, fault.place
        )

    def _solution_inverted(self) -> Diagnosis | None:
        """An equilibrium was found, but its cells are inside out."""
        if "inside out" not in self.result.reason:
            return None
        return self._material_gives_way() or self._inverted()

    def _steps_shortened(self) -> Diagnosis | None:
        """Many steps were shortened; instability shortens steps, too, and is checked before."""
        many = self.rejected.count > PATIENCE or "DOMAIN" in self.result.reason
        return self._inverted() if self.rejected.count and many else None

    def _inverted_cells(self) -> Diagnosis | None:
        if self._inverted_ahead is not None:
            text = messages.ahead(self._inverted_ahead.text)
            return self._make("inverted", text, self._without_crushing, self._inverted_ahead.place)
        return self._inverted() if self._count_inverted() else None

    def _count_inverted(self) -> int:
        """Cells of the last iterate that have turned inside out."""
        self.states.put(self.failed)
        return sum(self.assembler.comm.allgather(int(np.sum(self.cells.jacobians() <= 0.0))))

    def _inverted(self) -> Diagnosis:
        count, bad = self._count_inverted(), self.rejected
        if "inside out" in self.result.reason:
            start = "the solution was refused: "
        else:
            often = messages.count(bad.count, "trial state")
            start = f"{often} of Newton's method refused: " if bad.count else ""
        worst = self.worst[0]
        J, place = (bad.jacobian, bad.place) if bad.place else (worst.jacobian, worst.place)
        place, unit = place[: self.problem.body.dim], self.problem.body.unit
        text = f"{start}an element turned inside out (det F = {J:.3g}, at {unit.point(place)})"
        if count:
            text += (
                f"; the last iterate has {messages.count(count, 'such element')} in {self._names()}"
            )
        diagnosis = self._make("inverted", text, self._without_crushing, place)
        return explained(self.problem, diagnosis)

    @property
    def _without_crushing(self) -> str:
        """Advice against elements that turn inside out; steps change no linear equilibrium."""
        return messages.SMALL_STRAINS if self.problem.linear else messages.SMALLER

    def _names(self) -> str:
        names = sorted({cell.material for cell in self.worst if cell.jacobian <= 0.0})
        return messages.material(self.problem, names)

    def _round_off(self) -> Diagnosis | None:
        """The residual has stopped falling where round-off of the internal forces begins."""
        norms = self.result.residuals[-3:]
        if self._moving or not (self._prescribed and norms and np.isfinite(norms).all()):
            return None  # in motion inertia has a round-off of its own, which is not estimated
        refused = self.result.reason in (UNSTABLE, ANOTHER, BEYOND)
        best = min(norms)
        if refused or best <= self.result.target:
            return None
        floor = self._floor()
        if best > FLOOR * floor:
            return None
        assembler = self.assembler
        reference = max(
            assembler.reactions.load_norm(),
            assembler.residual.reaction_norm,
            assembler.residual.restraint_norm,
        )
        relative = best / reference if reference > 0.0 else np.inf
        text = (
            f"round-off: the forces out of balance stay at {best:.3g} N, {relative:.1e} of the "
            f"loads and reactions, where rounding errors alone make about {floor:.1e} N; "
            "rtol is too tight for this problem"
        )
        return self._make("round-off", text, messages.round_off(relative), self.worst[0].place)

    def _floor(self) -> float:
        """Rounding errors of the internal forces [N]: epsilon K (|x| + |u|), row by row.

        Differences of displacements lose what their own size loses, so far from where it began a
        body's strains are less exact.  Source: N. Higham, Accuracy and Stability of Numerical
        Algorithms (2002), (3.5).
        """
        if not self.states.tangent(self.failed):
            return 0.0
        diagonal = self.assembler.tangent.matrix.getDiagonal()
        rows = np.abs(diagonal.array_r.copy())
        diagonal.destroy()
        rows[self.assembler.prescribed_dofs] = 0.0
        norm = float(np.sqrt(sum(self.assembler.comm.allgather(float(np.sum(rows**2))))))
        size = cell_size(self.problem.body) + self.assembler.max_displacement()
        return float(np.finfo(float).eps) * norm * size

    def _unstable(self) -> Diagnosis | None:
        if not self._judge_stability:
            return None
        settled = self.result.reason == UNSTABLE
        look = instability.unstable(self.states, self.good, self.failed, settled=settled)
        self._not_examined = look.not_examined
        if not look.text and self.result.reason == ANOTHER:
            text = "the equilibrium that was found lies on another path: the body has jumped to it"
            return self._make("unstable", text, messages.LIMIT_POINT, self.worst[0].place)
        if not look.text:
            return None
        return self._make("unstable", look.text, look.advice, look.place)

    def _material_gives_way(self) -> Diagnosis | None:
        """The last equilibrium has lost ellipticity, or nearly, and a later iterate has.

        The body need not be unstable yet: a strip of cells may keep it, however fine the mesh.  In
        motion inertia carries it on for a while, so that only what has been lost counts.
        """
        self.states.put(self.good)
        spot = softest_spot(self.cells)
        if spot is None or spot.share >= (0.0 if self._moving else NEARLY):
            return None
        if not spot.lost:
            self.states.put(self.failed)
            later = softest_spot(self.cells)
            if later is None or not later.lost:
                return None
        text, advice = spot.in_words(self.problem)
        return self._make("unstable", text, advice, spot.place)

    def _linear_solver(self) -> Diagnosis | None:
        if "LINEAR_SOLVE" not in self.result.reason:
            return None
        cause, advice = messages.linear(self.result.reason)
        return self._make("linear-solver", f"the linear solver failed: {cause}", advice)

    def _next_step(self) -> Diagnosis | None:
        """Terms without a finite value after one more full Newton step. Collective."""
        if self._moving:  # the tangent contains the mass, with the factor of the step before
            return None
        limit = LIMIT[self.problem.body.dim]
        if (
            not self._finite
            or self.problem.num_dofs > limit
            or not self.states.tangent(self.failed)
        ):
            return None
        states = ContactStates(self.problem)
        if not instability.take_newton_step(self.assembler):
            return None
        self._contact_changes = states.changes()
        self.states.residual(self.problem.w.x.array.copy())
        fault = not_finite(self.cells)
        self.states.residual(self.failed)
        if fault is None:
            return None
        if fault.inverted:
            self._inverted_ahead = fault
            return None
        before = "; the last iterate stands just before that, and Newton's step leads there"
        return self._nan(fault.text + before, fault)

    def _stopped(self) -> Diagnosis:
        self.states.residual(self.failed)
        _, node = self.assembler.residual.largest()
        where = tuple(float(x) for x in node)
        p = self.result
        if "MAX_IT" in p.reason:
            fall = "still falls" if _falls(p.residuals) else "does not fall any more"
            text = f"{p.newton} Newton iterations were not enough: the residual {fall}"
            text += self._contact_changes
            return self._make("iterations", text, messages.iterations(fall), where)
        text = (
            "Newton's method came to a stand: no step along its direction brings the forces "
            f"into balance{self._contact_changes}"
        )
        return self._make("stalled", text, messages.STALLED, where)

    def _yielded(self) -> str:
        """In words, how much of a metal yields: it may bear no more. Collective."""
        if self.problem.history is None:
            return ""
        now, w = self.problem.w.x.array.copy(), self.problem.w.x.array
        w[:] = self.good
        part = self.problem.history.results().get("yielded_fraction", 0.0)
        w[:] = now
        if part == 0.0:
            return ""
        return (
            f"; {percent(part)} of the volume yields at the last equilibrium, so that the body may "
            "bear no more: displacements that are prescribed go on where forces end"
        )


def _falls(norms: Sequence[float]) -> bool:
    return len(norms) > 1 and norms[-1] < 0.5 * norms[-2]
