"""What nobody else sees of a motion that solves no equations: strains, cells inside out, energy."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.messages import coordinates, load_not_finite
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch, SmallStrains

log = logging.getLogger("dolfin_elastic")

DRIFT = 0.1
"""Share of the largest energy so far that may come from nowhere."""

LOOK = 8
"""States from one look at det F to the next: it costs about as much as a step."""

RESISTS = "smaller loads, or a law that resists, such as neo-hookean"


class StabilityMonitor:
    """Looks at the states of an explicit motion, and says each thing once. Collective to make.

    Args:
        problem: What moves.
        assembler: Of this problem.

    Attributes:
        watch: Of det F.
        nonlinear: A law has a det F to speak of.
        inside_out: What has been said of cells inside out; nothing at first.
        place: Of them [m].
    """

    def __init__(self, problem: Problem, assembler: Assembler) -> None:
        self._problem, self._assembler = problem, assembler
        self.watch = JacobianWatch(problem)
        self._small = SmallStrains(problem, self.watch)
        self.nonlinear = any(not part.law.linear for part in problem.regions)
        self._states, self.inside_out, self._told = 0, "", False
        self.place: tuple[float, ...] = ()
        self._first: FloatArray | None = None
        self._most = 0.0

    def look(self, t: float, *, last: bool) -> None:
        """Looks at the displacement, now and then. Collective.

        Laws without a barrier let cells turn inside out and go on; what is linear has no det F to
        speak of, and is told of by its strains.

        Args:
            t: Time [s].
            last: It is the last state, which is always looked at.
        """
        if self._states % LOOK == 0 or last:
            self._small.look(f"t = {t:.6g} s")
            self._look_at_volumes(t)
        self._states += 1

    def _look_at_volumes(self, t: float) -> None:
        if self.inside_out or not self.nonlinear:
            return
        J, place = self.watch.smallest()
        if J > 0.0:
            return
        self.place = tuple(float(x) for x in place[: self._problem.body.dim])
        what = f"det F = {J:.3g} at {coordinates(self.place)} m"
        self.inside_out = f"cells had turned inside out by t = {t:.6g} s, {what}"
        log.warning(
            "%s: the law lets them, but no body does so: %s",
            self.inside_out,
            RESISTS,
        )

    def drifts(self, energies: Mapping[str, float], quiver: float, t: float) -> bool:
        """Whether energy seems to have appeared, or to be lost; says so if it is. Collective.

        The energy of one time swings, the one that the scheme conserves does not; but the latter
        does not notice either what a step too long lets grow, as long as that is linear.

        Args:
            energies: Of the state.
            quiver: What the energy that the scheme conserves has beyond these, this rank's part.
            t: Time [s].
        """
        if self._problem.eigenstrains:  # what grows or is heated stores energy without work
            return False
        gained = energies["total"] - energies["external"]
        now = np.array([gained, gained + total(self._problem.body.comm, quiver)])
        if self._first is None:
            self._first = now
        sizes = (energies["kinetic"], energies["strain"], abs(energies["external"]))
        self._most = max(self._most, *sizes)
        seems, drifts = np.abs(now - self._first) > DRIFT * self._most
        if seems or drifts:
            self._first = np.where([seems, drifts], now, self._first)  # looked into once
            self._look_at_volumes(t)  # then that is why
        if drifts and not (self._told or self.inside_out):
            self._told = True
            log.warning(
                "more than a tenth of the energy has come from nowhere, or got lost, by "
                "t = %.4g s: the step is too long for what happens; try a smaller dt or safety",
                t,
            )
        return bool(seems or drifts)

    def check_given(self, t: float) -> None:
        """Raises if it is a support or a load that has no finite value. Collective.

        Raises:
            InputError: It is.
        """
        problem, u = self._problem, self._problem.u.x.array
        problem.dirichlet.check_finite()
        kept = u.copy()
        u[:] = 0.0  # loads that follow the body are not finite where it is not
        forces = self._assembler.reactions.loads()
        u[:] = kept
        if total(problem.body.comm, int(np.sum(~np.isfinite(forces)))):
            raise load_not_finite(t)

    # --- from one run to the next ---

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`. Not collective."""
        return {
            "far": self._small.note,
            "inside_out": self.inside_out,
            "place": list(self.place),
            "told": self._told,
            "states": self._states,
            "first": [] if self._first is None else self._first.tolist(),
            "most": self._most,
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`. Not collective."""
        self._small.note, self.inside_out = saved["far"], saved["inside_out"]
        self.place = tuple(saved["place"])
        self._told, self._most = saved["told"], saved["most"]
        self._states = int(saved["states"])
        self._first = np.array(saved["first"]) if saved["first"] else None
