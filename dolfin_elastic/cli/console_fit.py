"""What the tables of fits have in common."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dolfin_elastic.core.si_text import percent, quantity

if TYPE_CHECKING:
    from dolfin_elastic.study.least_squares.fitted import FittedConstant


def interval_text(row: FittedConstant) -> str:
    """The interval of a constant."""
    if row.bound:
        return "at its bound"
    if not math.isfinite(row.half):
        return "not known"
    part = percent(row.half / abs(row.value)) if row.value else ""
    return f"+- {quantity(row.half, row.unit)} ({part})"
