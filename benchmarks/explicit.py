"""A step of explicit motion beside what it cannot do without: residual and exchange of ghosts.

    python3 benchmarks/explicit.py [N ...]
    mpirun -n 2 python3 benchmarks/explicit.py [N ...]

A free block of (2N, N, N) cubes of six tetrahedra, neo-Hookean, set spinning.  "bare" is plain
DOLFINx: a vector is emptied, the residual assembled into it, and the ghosts of forces and places
are exchanged.  "statics" is the same by the residual of statics.  "step" is the whole loop of
`central-differences` between two states, estimates of the stable step included.  "bound" is one
estimate by cells, "Lanczos" one of the whole body.  All in microseconds a cell and rank, the best
of several; the ratio is step over statics, to stay below 1.5.  On one core of a busy machine:

| cells | bare | statics | step | bound | Lanczos | ratio |
|---|---|---|---|---|---|---|
| 768 | 0.168 | 0.144 | 0.161 | 0.637 | 2.867 | 1.12 |
| 20736 | 0.108 | 0.030 | 0.033 | 0.376 | 0.673 | 1.09 |
| 165888 | 0.118 | 0.033 | 0.040 | 0.386 | 1.128 | 1.24 |
"""

from __future__ import annotations

import sys
import time

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from dolfin_elastic import NeoHookean, Problem, box_body
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import CentralDifferences

STEPS, TIMES = 200, 8


def best(*actions) -> list[float]:
    """Seconds of the fastest of several runs of each, in turn; the slowest rank's."""
    spent = np.empty((TIMES, len(actions)))
    for row in spent:
        for k, action in enumerate(actions):
            MPI.COMM_WORLD.barrier()
            begin = time.perf_counter()
            action()
            row[k] = MPI.COMM_WORLD.allreduce(time.perf_counter() - begin, op=MPI.MAX)
    return list(spent.min(axis=0))


def measure(n: int) -> None:
    """One line of the table."""
    body = box_body(size=(2, 1, 1), cells=(2 * n, n, n))
    problem = Problem(body, NeoHookean(E=1e6, nu=0.3, density=1000), degree=1)
    v = fem.Function(problem.V)
    v.interpolate(lambda x: np.array([-x[1], x[0], 0.3 * x[2]]))
    march = Explicit(problem, v, CentralDifferences, end=1e6, dt=None, safety=0.9, every=STEPS)
    form = compile_forms(body.comm, [march.assembler.residual.work], problem.jit)[0]
    u = problem.u
    force = la.vector(problem.V.dofmap.index_map, problem.V.dofmap.index_map_bs)

    def bare() -> None:
        for _ in range(STEPS):
            u.x.scatter_forward()
            force.array[:] = 0.0
            fem.assemble_vector(force.array, form)
            force.scatter_reverse(la.InsertMode.add)

    def step() -> None:
        for _ in range(STEPS):
            march.step()

    def statics() -> None:
        for _ in range(STEPS):
            u.x.scatter_forward()
            march.assembler.residual.assemble()

    march.scheme.assemble_forces()
    found = best(bare, statics, step, march.size.cell_bound, march.size.largest_frequency)
    found[:3] = [seconds / STEPS for seconds in found[:3]]
    cells = body.num_cells / body.comm.size
    if body.comm.rank == 0:
        columns = " | ".join(f"{1e6 * seconds / cells:.3f}" for seconds in found)
        ratio = found[2] / found[1]
        print(f"| {body.num_cells} | {columns} | {ratio:.2f} |", flush=True)
    march.assembler.destroy()


def main() -> None:
    if MPI.COMM_WORLD.rank == 0:
        print("| cells | bare | statics | step | bound | Lanczos | ratio |")
        print("|---|---|---|---|---|---|---|")
    for n in [int(argument) for argument in sys.argv[1:]] or (4, 12, 24):
        measure(n)


if __name__ == "__main__":
    main()
