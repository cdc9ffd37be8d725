"""Retries at one load factor, before the load step is made smaller.

Newton's method starts from the last equilibrium or from the extrapolated path, whichever has the
smaller residual: extrapolation saves a third of the iterations in stretching, but in bending it
stretches fibres that only rotate.  Full Newton steps come first: in bending the residual has to
rise before it falls, and a line search that forbids it takes several times the iterations.  If they
fail, backtracking is tried, then the other starting point.  A linear solver that fails is replaced
by a more robust one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.messages import coordinates
from dolfin_elastic.solvers.nonlinear.contact import ContactAugmentation
from dolfin_elastic.solvers.nonlinear.convergence import NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton

log = logging.getLogger("dolfin_elastic")


@dataclass
class RetryStrategy:
    """Tries line searches, linear solvers and starting points until one finds equilibrium.

    Attributes:
        newton: The solver; its problem is at the load that is wanted.
        augmentation: Of its contacts; None without any.
        failed: The last iterate of the last failure, as `Newton.unknowns`.
    """

    newton: Newton
    augmentation: ContactAugmentation | None
    failed: FloatArray | None = field(default=None, init=False)
    _ready: bool = field(default=True, init=False)

    def restarted(self) -> None:
        """Makes the next solve refresh the linear solver, which was set up at another state."""
        self._ready = False

    def solve(self, starts: Sequence[tuple[str, FloatArray]]) -> NewtonResult:
        """Finds equilibrium from the first start that leads there. Collective.

        Args:
            starts: Name for the log and `Newton.unknowns` of each starting point.  The first is
                the last equilibrium, to which the problem returns if all fail.
        """
        newton, first = self.newton, starts[0][1]
        rejected, worst = 0, None
        self.begin()
        if len(starts) > 1 and self._residual_norm(starts[1][1]) < self._residual_norm(first):
            starts = [("", starts[1][1]), ("from where the last step ended", first)]
        for how, start, line_search in self._attempts(starts):
            if not self._ready:
                newton.linear.refresh()
            self._ready = False  # after a failure it is of a state that was no good
            result = self._attempt(start, line_search)
            self._ready = result.converged
            rejected += result.rejected
            if result.worst is not None and (worst is None or result.worst[0] < worst[0]):
                worst = result.worst
            if result.converged:
                if how:
                    log.info("found %s", how)
                return result
            log.debug("%s, line search '%s': %s", how or "start", line_search, result.reason)
        self.failed = newton.unknowns()
        self.undo(first)
        return replace(result, rejected=rejected, worst=worst)

    def undo(self, start: FloatArray) -> None:
        """Goes back to where the last solve began, its contacts too. Not collective."""
        self.newton.put_back(start)
        if self.augmentation is not None:
            self.augmentation.restore()

    def _attempts(
        self, starts: Sequence[tuple[str, FloatArray]]
    ) -> Iterator[tuple[str, FloatArray, str]]:
        """Name for the log, starting point and line search of each attempt."""
        searches = self.newton.line_searches()
        for line_search in searches:
            how = "" if line_search == searches[0] else f"by line search '{line_search}'"
            yield how, starts[0][1], line_search
        for how, start in starts[1:]:
            yield how, start, searches[0]

    def _residual_norm(self, start: FloatArray) -> float:
        """Norm of the residual at a start [N]; infinite where a cell is inside out. Collective."""
        assembler, guard = self.newton.assembler, self.newton.guard
        self.newton.put_back(start)
        if guard is not None and guard.watch.refused()[0] <= 0.0:
            return np.inf
        return assembler.residual.norm()

    def _attempt(self, start: FloatArray, line_search: str) -> NewtonResult:
        self.newton.put_back(start)
        if self.augmentation is not None:
            self.augmentation.restore()
        result = self.newton.solve(line_search)
        while "LINEAR_SOLVE" in result.reason and self.newton.fall_back():
            self.newton.put_back(start)
            result = self.newton.solve(line_search)
        return self.close_contacts(result, line_search)

    def close_contacts(
        self,
        result: NewtonResult,
        line_search: str,
        solve: Callable[[str], NewtonResult] | None = None,
    ) -> NewtonResult:
        """Augments contacts until nothing penetrates, and refuses inverted cells. Collective.

        Args:
            result: Of the solve before.
            line_search: PETSc's name of the line search for further solves.
            solve: Finds equilibrium from the problem's present state; by default `newton.solve`.

        Returns:
            How the last solve ended, with the iterations of all.
        """
        if self.augmentation is not None:
            again = partial(solve or self.newton.solve, line_search)
            result = self.augmentation.solve(result, again)
        return self._refuse_inverted(result)

    def begin(self) -> None:
        """Saves the multipliers of contacts, for `undo`. Not collective."""
        if self.augmentation is not None:
            self.augmentation.save()

    def _refuse_inverted(self, result: NewtonResult) -> NewtonResult:
        """No accepted state has an inverted cell, even if no trial state on the way had one.

        Where the law survives inversion it may have.
        """
        guard = self.newton.guard
        if not result.converged or guard is None:
            return result
        value, place = guard.watch.refused()
        if value > 0.0:
            return result
        return result.inverted(value, place).refused(
            f"a cell turned inside out (det F = {value:.3g}, at {coordinates(place)} m)"
        )
