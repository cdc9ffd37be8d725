"""Pseudo-transient continuation: lets a body that has lost its equilibrium flow to another.

(K + theta |diag K|) du = -R with theta that falls as the residual does: backward Euler steps of the
flow D du/dt = -R, which goes downhill in energy, that end as Newton's method.  Source: C. T. Kelley
and D. E. Keyes, SIAM J. Numer. Anal. 35 (1998) 508, "switched evolution relaxation".
"""

from __future__ import annotations

import logging

from dolfin_elastic.solvers.nonlinear.convergence import UNSTABLE, NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.inertia_count import disturb, negative_eigenvalues
from dolfin_elastic.solvers.statics.retry import RetryStrategy

log = logging.getLogger("dolfin_elastic")

FIRST = 1.0
"""Shift of the first step, as a share of the tangent's diagonal."""

ITERATIONS = 400


PUSHES = (1e-2, 1e-1)
"""Of the body's size: pushes off an unstable equilibrium, after a gentle one.  A slender body comes
back from pushes that are small against what it bends."""


def flow_away(ladder: RetryStrategy, *, settled: bool) -> NewtonResult:
    """Lets a body flow to a stable equilibrium. Collective.

    Args:
        ladder: Of the solver; its problem is at the load and in the state to start from.
        settled: That state is an equilibrium, an unstable one.

    Returns:
        How it ended; never with an equilibrium that is known to be unstable.
    """
    newton = ladder.newton
    pushes = [1e-2 * newton.cell_size, *(share * newton.span for share in PUSHES)]
    result = NewtonResult(converged=True) if settled else _flowed(ladder)
    while result.converged and (settled or (negative_eigenvalues(newton) or 0) > 0):
        if not pushes:
            return result.refused(UNSTABLE)
        settled = False
        disturb(newton, pushes.pop(0))
        result = _flowed(ladder)
    return result


def _flowed(ladder: RetryStrategy) -> NewtonResult:
    ladder.newton.linear.refresh()
    result = ladder.settled(relax(ladder.newton), "basic")
    log.debug("flow to another equilibrium: %s", result.reason)
    return result


def relax(newton: Newton) -> NewtonResult:
    """Finds an equilibrium that the body flows to from where it is. Collective.

    Args:
        newton: The solver; its problem is at the load and in the state to start from.
    """
    return newton.solve("basic", shift=_Flow(newton), max_iterations=ITERATIONS)


class _Flow:
    """Chooses the shift of each step."""

    def __init__(self, newton: Newton) -> None:
        self._newton = newton
        self._before = 0.0
        self._shift = FIRST

    def __call__(self, residual: float, target: float) -> float:
        """The shift for a free residual [N], of which `target` would be small enough."""
        if self._before > 0.0:
            factor = residual / self._before
            self._shift *= min(max(factor, 0.1), 1.5)
        self._before = residual
        self._shift = min(self._shift, 1e3)
        return self._shift if self._shift > 1e-6 else 0.0
