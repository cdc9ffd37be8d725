"""`Level` and `Progress`: the results of each mesh, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dolfin_elastic.study.converge.quantity import Quantity

Verdict = Literal["running", "reached", "singular", "audit", "refinements", "unknowns", "stopped"]


@dataclass(frozen=True)
class Level:
    """The results of one mesh.

    Attributes:
        number: 1, 2, ...
        cells: Of the mesh, on all ranks.
        unknowns: Of the problem.
        value: The quantity, in its SI unit.
        error: Its estimated relative error; of the first mesh that of the recovered stress, nan of
            other quantities.
        limit: Its extrapolated value; nan where there is none.
        rate: Observed s of an error that falls like N^-s; nan where it is not known.
        energy_error: Estimated relative error in the energy norm.
        place: Where a field has its largest value [m]; empty for other quantities.
        size: About the edge length of the cells there [m].
        newton: Newton iterations.
    """

    number: int
    cells: int
    unknowns: int
    value: float
    error: float
    limit: float
    rate: float
    energy_error: float
    place: tuple[float, ...]
    size: float
    newton: int


@dataclass(frozen=True)
class Progress:
    """All meshes so far, and whether the goal is reached.

    Attributes:
        quantity: What is wanted.
        tolerance: Relative error at which it counts as known.
        levels: Of each mesh.
        verdict: "running"; "reached"; "singular", the quantity has no limit; "audit", that of a
            solution fails; the limit that ended it, "refinements" or "unknowns"; or "stopped".
        reason: Why it ended without reaching the goal, in words; empty otherwise.
    """

    quantity: Quantity
    tolerance: float
    levels: tuple[Level, ...]
    verdict: Verdict = "running"
    reason: str = ""

    @property
    def last(self) -> Level:
        """The results of the finest mesh."""
        return self.levels[-1]

    @property
    def head(self) -> str:
        """The quantity with its unit."""
        unit = self.quantity.unit
        return f"{self.quantity} [{unit}]" if unit else str(self.quantity)
