"""What solvers of equations remember between two steps, as JSON knows it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from dolfin_elastic.solvers.nonlinear.newton import Newton

log = logging.getLogger("dolfin_elastic")


def remembered(newton: Newton) -> dict[str, Any]:
    """How stiff the body was at first, and the linear solver it has come to."""
    return {"stiffest": newton.round_off.first, "linear": newton.ksp.getType()}


def remind(newton: Newton, memory: Mapping[str, Any]) -> None:
    """Makes a new solver remember, with the tangent of the present state. Collective."""
    newton.round_off.first = memory["stiffest"]
    x = newton.assembler.create_vector()
    newton.assembler.get(x)
    newton.assembler.tangent(x, newton.mass_factor)
    x.destroy()
    newton.note_tangent(newton.assembler.matrix)
    newton.progress.reason = "before the checkpoint"
    while newton.ksp.getType() != memory["linear"] and newton.fall_back():
        with newton.options.in_force():
            newton.ksp.setFromOptions()


def tell_forgotten(scheme: str, options: Mapping[str, Any]) -> None:
    """Warns of what PETSc keeps for itself, so that a motion goes on otherwise than it would have.

    Args:
        scheme: Of the motion.
        options: PETSc options of the user, without prefix.
    """
    adapt = str(options.get("ts_adapt_type", "basic"))
    if scheme == "alpha2":
        log.warning(
            "the motion goes on, but not exactly as without the stop: PETSc's 'alpha2' keeps its "
            "acceleration for itself and begins anew with two half steps of first order; "
            "'generalized-alpha', the same scheme, goes on exactly"
        )
    elif adapt not in ("basic", "none"):
        log.warning(
            "the motion goes on, but not exactly as without the stop: PETSc's '-ts_adapt_type %s' "
            "keeps the errors of former steps for itself; 'basic' goes on exactly",
            adapt,
        )
