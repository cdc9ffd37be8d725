"""What a gradient costs, in Newton steps of the same solve.

    mpirun -n 2 python3 benchmarks/gradient.py [--cells 9 24] [--nu 0.3] [--degree 2] [--linear]

A cantilever of neo-Hookean material, 2 x 1 x 1, under a traction at its end.  The adjoint of each
of three numbers by itself, and of all together; the set-up of multigrid, if the state's first one
needs it; the derivative by a constant of the material at fixed unknowns, and that by the constant
in every cell; medians of three rounds in one state, in processor time of the first rank.  A step is
the whole solve over its iterations.  With --linear the material is linear elastic, and the only
step is solved as exactly as an adjoint.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Fixed, LinearElastic, NeoHookean, Problem, Statics, Traction, box_body
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.study.gradient.functionals import functionals
from dolfin_elastic.study.gradient.parameters import Equilibrium, parameters
from dolfin_elastic.study.gradient.spatial import CellConstant

NUMBERS = ["mean displacement_z on right", "strain_energy", "norm:16 von_mises"]
ROUNDS = 3


def median(work):
    """Median processor time of a few rounds [s], and what the last one has given."""
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        result = work()
        times.append(time.process_time() - begin)
    return float(np.median(times)), result


def measure(n: int, law, key: str, degree: int) -> None:
    body = box_body(size=(2, 1, 1), cells=(2 * n, n, n))
    problem = Problem(
        body,
        law,
        supports=[Fixed(on="left")],
        loads=[Traction(on="right", value=[0, 0, -1e4])],
        degree=degree,
    )
    ours, by = functionals(NUMBERS, problem, {}), parameters([key], problem, None)
    spent, begin = {}, time.process_time()

    def look(newton, state):
        nonlocal begin
        if state.done < 1.0:
            return
        step = (time.process_time() - begin) / state.newton
        here = Equilibrium(newton, lambda _: ours, ours, state.t)
        here.evaluated()
        begin = time.process_time()
        Adjoint(newton)  # may set the preconditioner up anew, which those after it find
        first = time.process_time() - begin
        spent["tangent"], _ = median(lambda: Adjoint(newton))
        spent["set-up"] = first - spent["tangent"]
        slopes = [one.by_unknowns(here.assembler) for one in ours]
        none = np.zeros(0)

        def alone(slope):
            adjoint = Adjoint(newton)
            begin = time.process_time()
            solution = adjoint.solve(slope, none)
            return time.process_time() - begin, solution

        def together():
            adjoint = Adjoint(newton)
            return [adjoint.solve(slope, none).iterations for slope in slopes]

        rounds = [[alone(slope) for slope in slopes] for _ in range(ROUNDS)]
        pairs = rounds[0]
        times = np.median([[seconds for seconds, _ in row] for row in rounds], axis=0)
        spent["adjoint"] = float(np.mean(times))
        whole, shared = median(together)
        spent["together"] = whole - spent["tangent"]
        spent["constant"], _ = median(lambda: by[0].derivative(here))
        cells = CellConstant(key, here.assembler)
        cells.by_logarithm(pairs[1][1], ours[1])  # compiled
        spent["cells"], _ = median(lambda: cells.by_logarithm(pairs[1][1], ours[1]))
        if MPI.COMM_WORLD.rank == 0:
            iterations = [solution.iterations for _, solution in pairs]
            print(
                f"{problem.num_dofs} unknowns, {state.newton} Newton steps, {state.krylov} ", end=""
            )
            print(f"iterations; of the adjoints {iterations}, of all together {shared}")
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
    parser.add_argument("--linear", action="store_true")
    given = parser.parse_args()
    law, key = NeoHookean(mu=3e5, nu=given.nu), "materials.body.mu"
    if given.linear:
        law, key = LinearElastic(E=8e5, nu=given.nu), "materials.body.E"
    for n in given.cells:
        measure(n, law, key, given.degree)


if __name__ == "__main__":
    main()
