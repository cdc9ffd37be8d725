"""A run on many ranks, from what was measured on one and counted on two.

What grows with the unknowns, by the difference of two sizes on one rank, takes as much longer as
the given bandwidth of memory is smaller than the one here; what does not grow stays.  A rank has a
surface of 6 (nodes)^(2/3) where a half of the block has one face, and as many messages for each
neighbour; levels of multigrid grow by one with each factor of coarsening; collective operations
take a latency for each doubling of the ranks, those in which each rank gets something of every
other one a message of 8 bytes for each.  Iterations are those measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

COARSE = 500
"""Unknowns that multigrid solves directly."""

COUNTS = 0.0005
"""Share of a run from which on a part is worth a line."""

STOPS = 0.75
"""A part stops scaling where twice the ranks do not take it below this share of its time."""


@dataclass(frozen=True)
class Machine:
    """A machine with many ranks.

    Attributes:
        latency: Of a message [s].
        bandwidth: Of the network, for each rank [byte/s].
        memory_bandwidth: For each core [byte/s].
        disk: Of the file system, for all ranks together [byte/s].
        neighbours: Of a rank's part of the mesh.
        coarsening: Unknowns of a level of multigrid over those of the next.
    """

    latency: float = 1.5e-6
    bandwidth: float = 1e9
    memory_bandwidth: float = 4e9
    disk: float = 50e9
    neighbours: float = 14
    coarsening: float = 15

    def levels(self, unknowns: float) -> float:
        """Levels of multigrid."""
        return 1 + max(0.0, math.log(unknowns / COARSE) / math.log(self.coarsening))


@dataclass(frozen=True)
class Part:
    """A part of a run.

    Attributes:
        stages: The stages of a run that belong to it.
        local: What it does on its own cells and rows.
        repeated: How often: the key of a number of the run; "": once.
        on_levels: It is done on all levels of multigrid.
    """

    stages: tuple[str, ...]
    local: str
    repeated: str = ""
    on_levels: bool = False


PARTS = {
    "iterations": Part(("solve",), "matrix, vectors", "linear", on_levels=True),
    "multigrid set-up": Part(("multigrid",), "products", on_levels=True),
    "tangents, residuals": Part(("assemble",), "cells", "newton"),
    "reading": Part(("mesh",), "cells"),
    "partitioning": Part(("partition",), "cells"),
    "checks, stability, audits": Part(("checks", "stability", "audit"), "cells"),
    "output": Part(("output",), "recovered stress, files"),
}


@dataclass(frozen=True)
class Model:
    """Seconds and memory on many ranks.

    Attributes:
        small: A run of a smaller block on one rank.
        one: A run of the block on one rank.
        two: The same on two.
        here: Bandwidth of memory of one process where they ran [byte/s].
        machine: Where the many ranks are.
    """

    small: dict
    one: dict
    two: dict
    here: float
    machine: Machine = field(default_factory=Machine)

    def seconds(self, ranks: int, dofs: float) -> dict[str, float]:
        """Seconds of each part of a run.

        Args:
            ranks: Their number.
            dofs: Unknowns of the whole body.
        """
        one, two, machine = self.one, self.two, self.machine
        found, fixed = dict[str, float](), 0.0
        for name, part in PARTS.items():
            growing, rest = self._local(part)
            found[f"{name}: {part.local}"] = growing * dofs / ranks
            fixed += rest
            found |= {f"{name}: {k}": s for k, s in self._sent(part, ranks, dofs).items()}
        found["what no rank shares: calls from Python, small arrays"] = fixed
        # Two triangular solves with a dense factor of the coarsest level, on one rank.
        coarsest = one["linear"] * 8 * COARSE**2 / machine.memory_bandwidth
        found["iterations: coarsest level"] = coarsest
        # Surfaces and edges, which every rank gets while it looks for its own part of them.
        shared = two["counts"]["mesh"]["collective_bytes"] / 2 * (dofs / two["dofs"]) ** (2 / 3)
        found["reading: named surfaces, to all ranks"] = (ranks > 1) * shared / machine.bandwidth
        size = one["counts"]["output"]["file_bytes"] / one["dofs"] * dofs
        found["output: file system"] = size / machine.disk
        return found

    def _local(self, part: Part) -> tuple[float, float]:
        """Seconds for each unknown of a rank, and those that stay."""
        small, one = self.small, self.one
        less, more = (
            sum(run["timings"].get(name, 0.0) for name in part.stages) for run in (small, one)
        )
        if part.repeated:
            less *= one[part.repeated] / small[part.repeated]
        slope = max(0.0, (more - less) / (one["dofs"] - small["dofs"]))
        slower = self.here / self.machine.memory_bandwidth
        return slope * slower, max(0.0, more - slope * one["dofs"])

    def _sent(self, part: Part, ranks: int, dofs: float) -> dict[str, float]:
        """Seconds of what a rank sends; of what was counted there were two."""
        if ranks == 1:
            return {}
        two, machine = self.two, self.machine
        rows = [two["counts"][name] for name in part.stages if name in two["counts"]]
        counted = {kind: sum(row[kind] for row in rows) / 2 for row in rows for kind in row}
        deeper = machine.levels(dofs) / machine.levels(two["dofs"]) if part.on_levels else 1.0
        surface = 6 * (dofs / ranks / 3) ** (2 / 3) / (two["N"] + 1) ** 2
        latency = machine.latency * math.log2(ranks)
        every = counted.get("alltoalls", 0.0)
        neighbours = min(machine.neighbours, ranks - 1)
        messages = counted.get("messages", 0.0) * neighbours * deeper
        return {
            "latency of messages": messages * machine.latency,
            "bytes of messages": counted.get("bytes", 0.0) * surface / machine.bandwidth,
            "reductions": (counted.get("collectives", 0.0) - every) * latency,
            "each rank to all": every * (latency + 8 * ranks / machine.bandwidth),
        }

    def stops(self, ranks: int, dofs: float) -> list[str]:
        """Parts that count and stop scaling, see `STOPS`."""
        found, double = self.seconds(ranks, dofs), self.seconds(2 * ranks, dofs)
        least = COUNTS * sum(found.values())
        return [name for name, s in found.items() if s > least and double[name] > STOPS * s]

    def memory(self, ranks: int, dofs: float) -> dict[str, float]:
        """Peak of each stage on a rank [byte]: a line through two sizes, and a row for each rank.

        Args:
            ranks: Their number.
            dofs: Unknowns of the whole body.
        """
        small, one, found = self.small, self.one, {}
        for name, large in one["peaks"].items():
            less = small["peaks"].get(name, large)
            slope = max(0.0, (large - less) / (one["dofs"] - small["dofs"]))
            found[name] = less + slope * (dofs / ranks - small["dofs"]) + 8 * 20 * ranks
        return found
