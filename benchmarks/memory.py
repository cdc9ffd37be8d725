"""What memory costs: residual, tangent and commit of laws that remember over those of elastic ones.

    mpirun -n 2 python3 benchmarks/memory.py [--cells 48000 10000]

The rounds of both laws alternate, and the least processor time of each counts.  Whole solves, for
the same number of Newton iterations, are one step that yields everywhere, or relaxes.  Of linear
elements there is a step of explicit motion, too.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import (
    J2,
    Hencky,
    J2Logarithmic,
    LinearElastic,
    NeoHookeanSplit,
    Problem,
    Support,
    box_body,
)
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import CentralDifferences
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose, in_blocks

METAL = {"E": 200e9, "nu": 0.3}
FLOW = {"yield_stress": 250e6, "hardening": 2e9}
VISCOUS = {"viscous": [{"ratio": 0.3, "time": 1.0}, {"ratio": 0.2, "time": 0.1}]}
LARGE = {"viscous": [{"ratio": 0.5, "time": 1.0}], "viscous_deviation": "large"}
PAIRS = {
    "viscous, linear-elastic": (LinearElastic(**METAL), LinearElastic(**METAL, **VISCOUS)),
    "viscous, neo-hookean-split": (
        NeoHookeanSplit(**METAL),
        NeoHookeanSplit(**METAL, **VISCOUS),
    ),
    "a branch far from equilibrium": (NeoHookeanSplit(**METAL), NeoHookeanSplit(**METAL, **LARGE)),
    "j2 over linear-elastic": (LinearElastic(**METAL), J2(**METAL, **FLOW)),
    "j2-logarithmic over hencky": (Hencky(**METAL), J2Logarithmic(**METAL, **FLOW)),
}
ROUNDS, STEPS = 7, 20


class Marching:
    """Central differences of one law, linear elements."""

    def __init__(self, law, n):
        body = box_body(size=(1, 1, 1), cells=(n, n, n))
        problem = Problem(body, law.model_copy(update={"density": 7800.0}), degree=1)
        v = fem.Function(problem.V)
        v.interpolate(lambda x: np.array([-x[1], x[0], 0.3 * x[2]]))
        self.march = Explicit(problem, v, CentralDifferences, end=1e6, dt=None, safety=0.9)
        self.march.scheme.assemble_forces()
        self.seconds = np.inf

    def round(self):
        """The mean of some steps."""
        scheme, begin = self.march.scheme, time.process_time()
        for _ in range(STEPS):
            scheme.advance(scheme.dt)
        self.seconds = min(self.seconds, (time.process_time() - begin) / STEPS)

    def least(self):
        """Seconds of a step, of the slowest rank."""
        return MPI.COMM_WORLD.allreduce(self.seconds, op=MPI.MAX)


def explicit_ratio(laws, n):
    """Explicit steps of the second law over those of the first."""
    both = [Marching(law, n) for law in laws]
    for _ in range(ROUNDS):
        for one in both:
            one.round()
    elastic, other = (one.least() for one in both)
    for one in both:
        one.march.destroy()
    return other / elastic


class Timed:
    """One law on a cube whose nodes are moved by so much that all of it yields."""

    def __init__(self, law, degree, n):
        supports = [Support(on="left"), Support(on="right")]
        self.problem = Problem(
            box_body(size=(1, 1, 1), cells=(n, n, n)), law, supports=supports, degree=degree
        )
        w = self.problem.w.x.array
        w[:] = 0.01 / n * np.random.default_rng(0).standard_normal(len(w))
        blocks = in_blocks(choose(self.problem, LinearSettings()), {})
        self.assembler = Assembler(self.problem, iterated=blocks)
        self.times = {"residual": [], "tangent": [], "commit": []}
        if self.problem.history is not None:
            self.problem.history.begin()
            self.problem.set_time(0.1)

    def round(self):
        """Residual and tangent from the body at rest, then what is kept."""
        history = self.problem.history
        calls = {
            "residual": self.assembler.residual.assemble,
            "tangent": lambda: self.assembler.tangent._renew(1.0),
            "commit": (lambda: None) if history is None else history.commit,
        }
        for name, call in calls.items():
            begin = time.process_time()
            call()
            self.times[name].append(time.process_time() - begin)
        if history is not None:
            history.reset()
            history.begin()
            self.problem.set_time(0.1)

    def least(self, name):
        """Seconds of the slowest rank."""
        return MPI.COMM_WORLD.allreduce(min(self.times[name]), op=MPI.MAX)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--cells", type=int, nargs=2, default=(48_000, 10_000))
    numbers = parser.parse_args().cells
    for degree, count in zip((1, 2), numbers, strict=True):
        n = round((count / 6) ** (1 / 3))
        for name, laws in PAIRS.items():
            both = [Timed(law, degree, n) for law in laws]
            for _ in range(ROUNDS):
                for one in both:
                    one.round()
            elastic, other = both
            ratios = {x: other.least(x) / elastic.least(x) for x in ("residual", "tangent")}
            ratios["commit over residual"] = other.least("commit") / elastic.least("residual")
            if degree == 1:
                ratios["explicit step"] = explicit_ratio(laws, n)
            if MPI.COMM_WORLD.rank == 0:
                told = ", ".join(f"{x} {ratio:.2f}" for x, ratio in ratios.items())
                print(f"P{degree}, {6 * n**3} cells, {name}: {told}", flush=True)


if __name__ == "__main__":
    main()
