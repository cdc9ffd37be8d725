"""What a solver keeps from one step to the next, so that a run can go on from there.

A solver's `kept()` gives it between two steps; `steps(restore)` begins with it.  The fields are the
solver's own: whoever saves them reads their values, and whoever restores them changes these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from dolfinx import fem


@dataclass(frozen=True)
class Kept:
    """All that the next step needs to know.

    Attributes:
        fields: Name to function; live, in spaces of Lagrange or piecewise constant elements.
        numbers: The rest, as JSON knows it: numbers, texts, lists and tables with text keys; the
            same on all ranks.
    """

    fields: Mapping[str, fem.Function]
    numbers: Mapping[str, Any] = field(default_factory=dict)


Restore = Callable[[Mapping[str, fem.Function]], Mapping[str, Any]]
"""Fills a solver's fields, ghosts too, and returns the numbers that belong to them. Collective."""
