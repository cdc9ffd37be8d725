"""Why a solve failed, where, and what to try.

Each cause is decided by evidence, the cheap and certain ones first:

"rigid-motion": the tangent of the last equilibrium maps a rigid motion of a piece to nothing; what
    such a system gives is no evidence of anything else, so this comes before all others; or that
    without contacts does, and the load pulls the body off its obstacles.
"nan": a term of the residual has no finite value although no cell has turned inside out.
"inverted": solutions were refused because cells had turned inside out.
"round-off": the residual stopped at a level that round-off explains.
"unstable": the tangent of the last equilibrium has a negative eigenvalue, or has lost its stiffness
    against some motion, of which there is less than none in the last iterate.
"linear-solver", "stalled", "iterations": what Newton's method itself reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.errors import BadCell, Diagnosis
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.solvers import messages
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral
from dolfin_elastic.solvers.diagnostics import instability
from dolfin_elastic.solvers.diagnostics.evidence import Cells, Fault, not_finite
from dolfin_elastic.solvers.diagnostics.loose_parts import loose
from dolfin_elastic.solvers.diagnostics.stability import LIMIT
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.contact import none_touching, pulled_off
from dolfin_elastic.solvers.nonlinear.convergence import (
    ANOTHER,
    BEYOND,
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
        result: How Newton's method ended.
        good: All unknowns at the last equilibrium, local array with ghosts.
        failed: The same at the last iterate; the problem holds it afterwards.
        judge_stability: An equilibrium of this kind has to be stable, and the tangent of the
            fields tells whether it is: not along a path, nor beside scalar unknowns.
        moving: In motion, where a body may be free or unstable.
    """
    with stage("diagnose"):
        doctor = _Doctor(assembler, result, good, failed)
        doctor.stable, doctor.moving = judge_stability and not moving, moving
        try:
            return doctor.said()
        finally:
            doctor.put(failed)
            assembler.residual.assemble()


class _Doctor:
    """One diagnosis. Collective."""

    def __init__(
        self, assembler: Assembler, result: NewtonResult, good: FloatArray, failed: FloatArray
    ) -> None:
        self.assembler, self.result, self.problem = assembler, result, assembler.problem
        self.good, self.failed = good.copy(), failed.copy()
        self.rejected, self.stable, self.moving = RejectedSteps.of(result), True, False
        self.cells, self.unseen = Cells(assembler), ""
        self.next: Fault | None = None
        self.finite = self._residual(self.failed)
        self.held = self.finite and assembler.residual.gap <= 1e-9 * span(self.problem.body)
        self.worst: tuple[BadCell, ...] = self.cells.worst()

    def said(self) -> Diagnosis:
        """The first cause for which there is evidence."""
        checks = (
            self._loose,
            self._not_finite,
            self._refused,
            self._round_off,
            self._unstable,
            self._linear_solver,
            self._ahead,
            self._piled_up,
            self._inside_out,
        )
        for check in checks:
            if (found := check()) is not None:
                return found
        return self._gave_up()

    def put(self, values: FloatArray) -> None:
        """Makes these the problem's unknowns."""
        self.problem.w.x.array[:] = values
        self.problem.unknowns.w_to_u()

    def _make(self, cause: str, text: str, advice: str, place: tuple[float, ...] = ()) -> Diagnosis:
        if self.moving and cause in ("inverted", "stalled", "iterations"):
            advice = messages.SMALLER_STEP
        place = place[: self.problem.body.dim]
        return Diagnosis(cause, text + self.unseen, advice, place, self.worst)

    # --- looking ---

    def _residual(self, values: FloatArray) -> bool:
        """Evaluates the residual; returns whether all of it is finite."""
        self.put(values)
        x, f = self.assembler.create_vector(), self.assembler.create_vector()
        self.assembler.get(x)
        self.assembler.residual.evaluate(x, f)
        finite = bool(np.isfinite(f.array_r).all() and np.isfinite(x.array_r).all())
        x.destroy()
        f.destroy()
        return largest(self.assembler.comm, float(not finite)) == 0.0

    def _tangent(self, values: FloatArray) -> bool:
        """Assembles the tangent; returns whether its diagonal is finite."""
        return instability.tangent(self.assembler, self.put, values)

    def _upside_down(self) -> int:
        """Cells of the last iterate that have turned inside out."""
        self.put(self.failed)
        return sum(self.assembler.comm.allgather(int(np.sum(self.cells.jacobians() <= 0.0))))

    # --- causes, in the order in which they are looked for ---

    def _loose(self) -> Diagnosis | None:
        if self.moving or not self._tangent(self.good):
            return None
        found, start, advice = loose(self.assembler), "", messages.HOLD
        if found is None and pulled_off(self.assembler):
            with none_touching(self.problem):
                found = loose(self.assembler) if self._tangent(self.good) else None
            start, advice = "the load pulls it off its obstacles, and then ", messages.LIFTED
        if found is None:
            return None
        what = "the body" if found.whole else f"a piece of it about {coordinates(found.place)} m"
        what += f" ({found.name})" if found.name and not found.whole else ""
        text = f"{start}nothing holds {what}: as a rigid body it can {', '.join(found.motions)}"
        return self._make("rigid-motion", text, advice, found.place)

    def _not_finite(self) -> Diagnosis | None:
        self._residual(self.failed)
        if self.finite and self._energy_is_finite():
            return None
        fault = not_finite(self.cells)
        if fault is None or fault.inverted:
            return self._inverted() if fault is not None else None
        return self._nan(fault.text, fault)

    def _energy_is_finite(self) -> bool:
        if self.problem.weak_form.strain_energy is None:
            return True
        form = compiled(self.problem, [self.problem.weak_form.strain_energy])[0]
        return bool(np.isfinite(integral(self.problem, form)))

    def _nan(self, text: str, fault: Fault) -> Diagnosis:
        return self._make(
            "nan", text, messages.LOAD if fault.load else messages.DOMAIN, fault.place
        )

    def _refused(self) -> Diagnosis | None:
        """An equilibrium was found, but its cells are inside out."""
        return self._inverted() if "inside out" in self.result.reason else None

    def _piled_up(self) -> Diagnosis | None:
        """Step after step was shortened; a body that gives way does so too, so that comes first."""
        many = self.rejected.count > PATIENCE or "DOMAIN" in self.result.reason
        return self._inverted() if self.rejected.count and many else None

    def _inside_out(self) -> Diagnosis | None:
        if self.next is not None:
            text = messages.ahead(self.next.text)
            return self._make("inverted", text, messages.SMALLER, self.next.place)
        return self._inverted() if self._upside_down() else None

    def _inverted(self) -> Diagnosis:
        count, bad = self._upside_down(), self.rejected
        if "inside out" in self.result.reason:
            start = "the solution was refused: "
        else:
            often = messages.count(bad.count, "trial state")
            start = f"{often} of Newton's method refused: " if bad.count else ""
        worst = self.worst[0]
        J, place = (bad.jacobian, bad.place) if bad.place else (worst.jacobian, worst.place)
        place = place[: self.problem.body.dim]
        text = f"{start}a cell turned inside out (det F = {J:.3g}, at {coordinates(place)} m)"
        if count:
            text += (
                f"; the last iterate has {messages.count(count, 'such cell')} in {self._names()}"
            )
        return self._make("inverted", text, messages.SMALLER, place)

    def _names(self) -> str:
        found = sorted({cell.material for cell in self.worst if cell.jacobian <= 0.0})
        return messages.material(self.problem, found)

    def _round_off(self) -> Diagnosis | None:
        """The residual has stopped falling where round-off of the internal forces begins."""
        norms = self.result.residuals[-3:]
        if self.moving or not (self.held and norms and np.isfinite(norms).all()):
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
        if not self._tangent(self.failed):
            return 0.0
        diagonal = self.assembler.tangent.matrix.getDiagonal()
        rows = np.abs(diagonal.array_r.copy())
        diagonal.destroy()
        rows[self.assembler.prescribed_dofs] = 0.0
        norm = float(np.sqrt(sum(self.assembler.comm.allgather(float(np.sum(rows**2))))))
        size = cell_size(self.problem.body) + self.assembler.max_displacement()
        return float(np.finfo(float).eps) * norm * size

    def _unstable(self) -> Diagnosis | None:
        if not self.stable:
            return None
        settled = self.result.reason == UNSTABLE
        look = instability.unstable(
            self.assembler, self.put, self.good, self.failed, settled=settled
        )
        self.unseen = look.unseen
        if not look.text and self.result.reason == ANOTHER:
            text = "the equilibrium that was found lies on another path: the body has jumped to it"
            return self._make("unstable", text, messages.LIMIT_POINT, self.worst[0].place)
        if not look.text:
            return None
        return self._make("unstable", look.text, look.advice, look.place)

    def _linear_solver(self) -> Diagnosis | None:
        if "LINEAR_SOLVE" not in self.result.reason:
            return None
        said, advice = messages.linear(self.result.reason)
        return self._make("linear-solver", f"the linear solver failed: {said}", advice)

    def _ahead(self) -> Diagnosis | None:
        """What Newton's next step would run into."""
        if self.moving:  # its tangent has the mass in it, with the factor of a step that is over
            return None
        limit = LIMIT[self.problem.body.dim]
        if not self.finite or self.problem.num_dofs > limit or not self._tangent(self.failed):
            return None
        if not instability.take_newton_step(self.assembler):
            return None
        self._residual(self.problem.w.x.array.copy())
        fault = not_finite(self.cells)
        self._residual(self.failed)
        if fault is None:
            return None
        if fault.inverted:
            self.next = fault
            return None
        before = "; the last iterate stands just before that, and Newton's step leads there"
        return self._nan(fault.text + before, fault)

    def _gave_up(self) -> Diagnosis:
        self._residual(self.failed)
        _, node = self.assembler.residual.largest()
        where = tuple(float(x) for x in node)
        p = self.result
        if "MAX_IT" in p.reason:
            fall = "still falls" if _falls(p.residuals) else "does not fall any more"
            text = f"{p.newton} Newton iterations were not enough: the residual {fall}"
            return self._make("iterations", text, messages.iterations(fall), where)
        text = (
            "Newton's method came to a stand: no step along its direction brings the forces "
            "into balance"
        )
        return self._make("stalled", text, messages.STALLED, where)


def _falls(norms: Sequence[float]) -> bool:
    return len(norms) > 1 and norms[-1] < 0.5 * norms[-2]
