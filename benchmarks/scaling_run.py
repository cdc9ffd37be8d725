"""One run of `benchmarks/scaling` on all ranks, with what they send counted by `counts.c`.

mpirun -n RANKS env LD_PRELOAD=libcounts.so python3 benchmarks/scaling_run.py CASE RESULTS
"""

from __future__ import annotations

import ctypes
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import read_case, run
from dolfin_elastic.core import timing
from dolfin_elastic.mesh import distribute
from dolfin_elastic.solvers.linear.hierarchy import Multigrid

KINDS = ("messages", "bytes", "collectives", "collective_bytes", "alltoalls", "file_bytes")
"""What `counts.c` counts, in its order."""

TABLE = (ctypes.c_double * len(KINDS)).in_dll(ctypes.CDLL(None), "elastic_counts")


class Ledger:
    """What was sent in each stage, and the largest memory there, without stages inside it."""

    def __init__(self) -> None:
        self.counts: dict[str, np.ndarray] = {}
        self.peaks: dict[str, int] = {}
        self._stages = ["other"]
        self._before = np.array(TABLE)

    def book(self) -> None:
        """Gives what happened since the last call to the stage that is on."""
        name, now = self._stages[-1], np.array(TABLE)
        self.counts[name] = self.counts.get(name, np.zeros(len(KINDS))) + now - self._before
        self.peaks[name] = max(self.peaks.get(name, 0), peak())
        self._before = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Everything inside belongs to this stage."""
        self.book()
        self._stages.append(name)
        try:
            yield
        finally:
            self.book()
            self._stages.pop()


def peak() -> int:
    """Largest memory of this process since the last call [byte]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    kib = next(line.split()[1] for line in lines if line.startswith("VmHWM"))
    with suppress(OSError):  # then it is the largest so far
        Path("/proc/self/clear_refs").write_text("5")
    return 1024 * int(kib)


def as_stage(owner: object, name: str, stage: str) -> None:
    """Lets a function or method be a stage of its own, in times as well."""
    plain = getattr(owner, name)

    def timed(*args: object, **more: object) -> object:
        with timing.stage(stage):
            return plain(*args, **more)

    setattr(owner, name, timed)


def observed(ledger: Ledger) -> None:
    """Lets the stages of a run be those of the ledger, partitioning and multigrid's set-up, too."""

    class Counting(timing.Stopwatch):
        @contextmanager
        def stage(self, name: str) -> Iterator[None]:
            with ledger.stage(name), super().stage(name):
                yield

    timing.Stopwatch = Counting
    as_stage(distribute, "create_mesh", "partition")
    as_stage(Multigrid, "setUp", "multigrid")


def main(case: str, results: str) -> None:
    comm, ledger = MPI.COMM_WORLD, Ledger()
    observed(ledger)
    begin = time.perf_counter()
    for _ in run(read_case(case), output=results):
        pass
    wall = time.perf_counter() - begin
    ledger.book()
    counts, peaks = {}, {}
    for name in sorted({name for every in comm.allgather([*ledger.counts]) for name in every}):
        sums = comm.allreduce(ledger.counts.get(name, np.zeros(len(KINDS))))
        counts[name] = dict(zip(KINDS, sums.tolist(), strict=True))
        peaks[name] = comm.allreduce(ledger.peaks.get(name, 0), op=MPI.MAX)
    if comm.rank == 0:
        summary = json.loads(Path(results, "summary.json").read_text())
        found = {
            "ranks": comm.size,
            "wall": wall,
            "counts": counts,
            "peaks": peaks,
            "dofs": summary["dofs"],
            "newton": summary["newton_iterations"],
            "linear": summary["krylov_iterations"],
            "timings": summary["timings"],
            "energy": summary["strain_energy"],
        }
        Path(results, "scaling.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
