"""What a gradient costs, in Newton steps of the same solve.

    mpirun -n 2 python3 benchmarks/gradient.py [--cells 9 24] [--nu 0.3] [--degree 2]

A cantilever of neo-Hookean material, 2 x 1 x 1, under a traction at its end.  The adjoint of each
of three numbers, the derivative by a constant of the material at fixed unknowns, and that by the
constant in every cell; medians of three rounds in one state.  A step is the whole solve over its
iterations.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Fixed, NeoHookean, Problem, Statics, Traction, box_body
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.study.gradient.functionals import functionals
from dolfin_elastic.study.gradient.parameters import Equilibrium, parameters
from dolfin_elastic.study.gradient.spatial import CellConstant

NUMBERS = ["mean displacement_z on right", "strain_energy", "norm:16 von_mises"]
KEY, ROUNDS = "materials.body.mu", 3


def median(work):
    """Median processor time of a few rounds [s], and what the last one has given."""
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        result = work()
        times.append(time.process_time() - begin)
    return float(np.median(times)), result


def measure(n: int, nu: float, degree: int) -> None:
    body = box_body(size=(2, 1, 1), cells=(2 * n, n, n))
    problem = Problem(
        body,
        NeoHookean(mu=3e5, nu=nu),
        supports=[Fixed(on="left")],
        loads=[Traction(on="right", value=[0, 0, -1e4])],
        degree=degree,
    )
    ours, by = functionals(NUMBERS, problem, {}), parameters([KEY], problem, None)
    spent, begin = {}, time.process_time()

    def look(newton, state):
        nonlocal begin
        if state.done < 1.0:
            return
        step = (time.process_time() - begin) / state.newton
        here = Equilibrium(newton, lambda _: ours, ours, state.t)
        here.evaluated()
        spent["tangent"], adjoint = median(lambda: Adjoint(newton))
        slopes = [one.by_unknowns(here.assembler) for one in ours]
        none = np.zeros(0)
        pairs = [median(lambda slope=slope: adjoint.solve(slope, none)) for slope in slopes]
        spent["adjoint"] = float(np.mean([seconds for seconds, _ in pairs]))
        spent["constant"], _ = median(lambda: by[0].derivative(here))
        cells = CellConstant(KEY, here.assembler)
        cells.by_logarithm(pairs[1][1], ours[1])  # compiled
        spent["cells"], _ = median(lambda: cells.by_logarithm(pairs[1][1], ours[1]))
        if MPI.COMM_WORLD.rank == 0:
            iterations = [solution.iterations for _, solution in pairs]
            print(
                f"{problem.num_dofs} unknowns, {state.newton} Newton steps, {state.krylov} ", end=""
            )
            print(f"iterations; of the adjoints {iterations}")
            for name, seconds in spent.items():
                print(f"  {name:10s} {seconds / step:.2f} Newton steps")
        begin = time.process_time()

    solver = Statics(problem)
    solver.observer = look
    for _ in solver.steps():
        begin = begin if spent else time.process_time()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="*", default=[9, 24])
    parser.add_argument("--nu", type=float, default=0.3)
    parser.add_argument("--degree", type=int, default=2)
    given = parser.parse_args()
    for n in given.cells:
        measure(n, given.nu, given.degree)


if __name__ == "__main__":
    main()
