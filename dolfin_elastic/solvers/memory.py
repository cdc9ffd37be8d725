"""What solvers of equations remember between two steps, as JSON knows it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfin_elastic.solvers.newton import Newton


def remembered(newton: Newton) -> dict[str, Any]:
    """How stiff the body was at first, and the linear solver it has come to."""
    return {"stiffest": newton.round_off.first, "linear": newton.ksp.getType()}


def remind(newton: Newton, memory: Mapping[str, Any]) -> None:
    """Makes a new solver remember; its assembler has the present tangent. Collective."""
    newton.round_off.first = memory["stiffest"]
    newton.note_tangent(newton.assembler.matrix)
    newton.progress.reason = "before the checkpoint"
    while newton.ksp.getType() != memory["linear"] and newton.fall_back():
        with newton.options.in_force():
            newton.ksp.setFromOptions()
