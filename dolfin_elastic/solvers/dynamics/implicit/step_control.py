"""Step sizes of an implicit motion: times that are met exactly, and the tolerance of errors.

TSAdapt compares the error of a step with the tolerance and chooses the next step.  Errors are
relative to the largest displacement so far, that of the end of the step included, as E. Hairer,
S. P. Norsett & G. Wanner, Solving Ordinary Differential Equations I (1993), (II.4.10), have it: a
body that has not moved yet would allow no error, and the first step would be tiny.

The first step that is tried is the user's, and its displacement is a scale of the motion, also if
it is rejected for its error: of u'' + w^2 u = f from rest, a step of any length moves at most as
far as the motion itself does, twice f/w^2, or from the velocity v to v/w.  Without that scale the
first wave fronts that leave a clamp would be resolved in each cell.

Adaptive steps end at the corners of curves: the error of a body at rest is zero, whatever load sets
in within the step.  Equal steps keep the user's length, and pass over corners with a warning.
"""

from __future__ import annotations

import logging
from bisect import bisect_right
from math import ceil
from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue
from dolfin_elastic.solvers.dynamics.implicit.output_times import OutputTimes
from dolfin_elastic.solvers.dynamics.residual import DynamicResidual

log = logging.getLogger("dolfin_elastic")

IGNORED = 1e100
"""Error tolerance of auxiliary fields: they follow from the displacement, whose error counts."""

LONGER = 0.01
"""Share of a step by which it may be longer to meet a time, rather than leave a tiny next one."""

FEWEST_STEPS = 50
"""Fewest steps of a motion whose loads or supports are formulas in t: the steps of a body at rest
have no error, and would pass over what begins later."""

SAME = 1e-9
"""Difference over the step up to which two times are the same."""


class StepControl:
    """The sizes of the steps of a TS.

    Args:
        ts: Its step is set before each one.
        times: Times that are met exactly, and the end.
        dt: The user's step [s].
        tolerance: Error of a step over the largest displacement, if steps are adaptive; else None.
        span: Size of the body [m].

    Attributes:
        times: See the arguments.
        nominal: The user's step [s].
        scale: The largest displacement so far; during the first step, of all its attempts [m].
    """

    def __init__(
        self,
        ts: PETSc.TS,
        moving: DynamicResidual,
        times: OutputTimes,
        *,
        dt: float,
        tolerance: float | None,
        span: float,
    ) -> None:
        self._ts, self._moving, self._span = ts, moving, span
        self.times, self._end = times, times.end
        self.nominal, self.scale = dt, 0.0
        self._adaptive, self._tolerance = tolerance is not None, tolerance or 0.0
        self._corners = [t for t in moving.problem.corners if 0.0 <= t <= self._end]
        self._longest = self._end / FEWEST_STEPS if moving.problem.driven_by_formula else self._end
        self._start, self._goal, self._planned, self._free = 0.0, 0.0, 0.0, 0.0

    def warn_of_passed_corners(self) -> None:
        """Warns where equal steps may pass over what a curve does. Not collective."""
        least = float(np.min(np.diff(self._corners), initial=np.inf))
        if not self._adaptive and least < self.nominal * (1 - SAME):
            log.warning(
                "a curve has corners %.3g s apart, closer than dt = %.3g s: steps may pass over "
                "what is between them; a smaller dt, or dynamics.adaptive, which meets them",
                least,
                self.nominal,
            )

    def restore(self, scale: float) -> None:
        """Goes on with the scale of a run that was stopped [m]. Not collective."""
        self.scale = scale

    @property
    def options(self) -> dict[str, PetscValue]:
        """PETSc options of TSAdapt."""
        if not self._adaptive:
            return {"ts_adapt_type": "none"}
        # The error is that of the worst node, so that it does not depend on the mesh.
        return {
            "ts_adapt_type": "basic",
            "ts_adapt_dt_min": 1e-9 * self._end,
            "ts_adapt_wnormtype": "infinity",
        }

    def begin_step(self) -> None:
        """Sets the step, before TS takes it. Collective."""
        ts = self._ts
        self._start = float(ts.getTime())
        self._goal, self._free = self.times.next_time(self._start), self.nominal
        if self._adaptive:
            ahead = bisect_right(self._corners, self._start + 1e-12 * self._end)
            self._goal = min(self._goal, *self._corners[ahead : ahead + 1], self._end)
            self._free = min(float(ts.getTimeStep()), self._longest)
        ts.setMaxTime(self._goal)
        self._planned = self._fitting(self._goal - self._start)
        ts.setTimeStep(self._planned)
        self.set_error_scale()

    def _fitting(self, remaining: float) -> float:
        """A step of about the free size, with which no tiny step remains.

        Args:
            remaining: Time to the next one that is met exactly [s].
        """
        step = self._free
        if self._adaptive and remaining < 2 * step:
            return remaining / max(1, ceil(remaining / step - LONGER))
        # A step that ends there but for round-off stays as it is, and so does its factorisation.
        return remaining if remaining < step * (1 - SAME) else step

    def without_round_off(self, t: float) -> float:
        """The time at the end of a step, without the round-off of a sum [s].

        Args:
            t: Sum of the steps [s].
        """
        slack = SAME * (t - self._start)
        if abs(t - self._goal) < slack:
            return self._goal
        even = round(t / self.nominal) * self.nominal
        return even if abs(t - even) < slack and not self._adaptive else t

    def end_step(self) -> None:
        """Updates scale and step size after TS has accepted a step. Collective.

        A step that was cut short to meet a time says nothing against longer ones: the next one is
        as long as it would have been.
        """
        if not self._adaptive:
            return
        ts = self._ts
        if int(ts.getStepNumber()) == 1:
            self.scale = 0.0  # rejected attempts are a scale for the first step only
        self.scale = self._present()
        if float(ts.getTime()) - self._start > self._planned * (1 - SAME):
            ts.setTimeStep(max(float(ts.getTimeStep()), self._free))

    def _present(self) -> float:
        """The largest displacement so far, the present one included [m]. Collective."""
        u = self._moving.problem.u.x.array
        local = float(np.max(np.abs(u), initial=0.0))
        return max(self.scale, largest(self._moving.comm, local), 1e-6 * self._span)

    def set_error_scale(self) -> None:
        """Sets the tolerance to the largest displacement, the present one included. Collective."""
        if not self._adaptive:
            return
        present = self._present()
        if int(self._ts.getStepNumber()) == 0:
            self.scale = present
        atol: Any = self._tolerance * present
        if len(self._moving.problem.unknowns.auxiliary_fields):
            value, atol = atol, self._moving.assembler.create_vector()
            atol.set(value)
            atol.array_w[self._moving.auxiliary_dofs] = IGNORED
            self._ts.setTolerances(rtol=0.0, atol=atol)
            atol.destroy()
        else:
            self._ts.setTolerances(rtol=0.0, atol=atol)


def warn_of_inexact_restart(reason: str, options: PetscOptions) -> None:
    """Warns where PETSc has data of former steps that cannot be saved: steps then differ a little.

    Args:
        reason: Why the scheme cannot be restarted exactly; empty if it can.
        options: PETSc options of the user, without prefix.
    """
    adapt = str(options.get("ts_adapt_type", "basic"))
    if not reason and adapt not in ("basic", "none"):
        reason = (
            f"PETSc's '-ts_adapt_type {adapt}' keeps the errors of former steps for itself; "
            "'basic' goes on exactly"
        )
    if reason:
        log.warning("the motion goes on, but not exactly as without the stop: %s", reason)
