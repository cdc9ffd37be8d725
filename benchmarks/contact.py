"""A Newton step of a block on a rigid plane, over that of the same block without contact.

    python3 benchmarks/contact.py [12]

Quadratic elements, the number of cells along each edge; a tenth and all of the bottom in contact,
with penalties in units of that by default.  A step is a tangent, a residual and a solve to 1e-8
with multigrid that is there; processor times, the least of five in turn.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from petsc4py import PETSc

from dolfin_elastic import Contact, NeoHookean, Problem, Support, box_body
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.hierarchy import Multigrid

CASES = ((0.0, 1), (0.1, 1), (0.1, 10), (0.1, 100), (1.0, 1), (1.0, 10), (1.0, 100))
"""Share of the bottom in contact, and penalty over that by default."""


class Step:
    """One block, its tangent and its solver."""

    def __init__(self, n: int, share: float, stiffer: float) -> None:
        contacts = [Contact(on="bottom", plane={"axis": "z", "at": 0})]
        self.problem = Problem(
            box_body(size=(1, 1, 1), cells=(n, n, n)),
            NeoHookean(E=1e6, nu=0.3),
            degree=2,
            supports=[Support(on="top")],
            contacts=contacts if share else [],
        )
        self.problem.terms.begin(moving=False)
        for pair in self.problem.contact_pairs:
            pair.eps *= stiffer
            r = np.linalg.norm(pair.places()[:, :2] - 0.5, axis=1)
            pair.lam.x.array[pair.nodes] = np.where(r <= np.quantile(r, share), 1e3, -1e12)
        self.assembler = a = Assembler(self.problem, iterated=True)
        self.x, self.f, self.y, self.b = (a.create_vector() for _ in range(4))
        self.b.array_w[:] = np.sin(1 + np.arange(a.size) ** 1.3)
        self.b.array_w[a.prescribed_dofs] = 0.0
        a.tangent.assemble(self.x)
        self.ksp = PETSc.KSP().create(a.comm)
        self.ksp.setType("cg")
        self.ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self.ksp.setTolerances(rtol=1e-8, max_it=1000)
        self.ksp.setOperators(a.tangent.matrix)
        self.multigrid = Multigrid(self.problem, self.ksp.getPC(), blocks=a.tangent.blocks)
        self.ksp.setUp()
        self.ksp.getPC().setReusePreconditioner(True)
        self.best = np.full(3, np.inf)

    def measure(self) -> None:
        """Times tangent, residual and solve once."""
        a, times = self.assembler, [time.process_time()]
        a.tangent.invalidate()
        a.tangent.assemble(self.x)
        times.append(time.process_time())
        a.residual.evaluate(self.x, self.f)
        times.append(time.process_time())
        self.ksp.solve(self.b, self.y)
        times.append(time.process_time())
        self.best = np.minimum(self.best, np.diff(times))


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    steps = [Step(n, *case) for case in CASES]
    for _ in range(5):
        for step in steps:
            step.measure()
    print("| in contact | penalty | tangent | residual | solve | step | iterations |")
    print("|---" * 7 + "|")
    first = steps[0].best
    for (share, stiffer), step in zip(CASES, steps, strict=True):
        ratios = [*(step.best / first), step.best.sum() / first.sum()]
        shown = " | ".join(f"{ratio:.2f}" for ratio in ratios)
        print(f"| {share:.0%} | {stiffer:g} | {shown} | {step.ksp.getIterationNumber()} |")
    print(
        f"{steps[0].problem.num_dofs} unknowns, without contact {1e3 * first.sum():.0f} ms a step"
    )


if __name__ == "__main__":
    main()
