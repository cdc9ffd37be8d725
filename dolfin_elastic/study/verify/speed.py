"""How fast the kernels are on this machine, beside what the traffic of memory allows.

A block of (2, 1, 1), fixed at one end and pulled across at the other, as benchmarks/ have it.  The
bound counts what must be read or written at least: of an iteration the stored tangent three times
(operator, residual, smoother), of a tangent itself once, of a residual the cells' nodes, and the
places, displacements and forces of these; of an explicit step velocities and masses, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.timing import timed
from dolfin_elastic.mesh.generate import box_body
from dolfin_elastic.model.loads.forces import Traction
from dolfin_elastic.model.materials.laws.neo_hookean import NeoHookean
from dolfin_elastic.model.supports.displacement import Support
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.dynamics.explicit.explicit import Explicit
from dolfin_elastic.solvers.dynamics.explicit.scheme import CentralDifferences
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose, in_blocks
from dolfin_elastic.solvers.statics.statics import Statics

_CELLS = {1: 24, 2: 12}
"""Cubes across the block by the elements' degree: 91,875 unknowns on one rank."""
_TIMES, _STEPS = 5, 50
"""Evaluations of which the fastest counts, and explicit steps of each."""
_ITERATIVE = LinearSettings(method="iterative")
_TRIAD = 8_000_000
"""Numbers in each array."""


@dataclass(frozen=True)
class Speed:
    """Time of one operation on all ranks.

    Attributes:
        elements: "linear" or "quadratic".
        what: The operation.
        per: Of which there are many: the times are those of one.
        ranks: How many took part.
        nanoseconds: Wall time [ns].
        bound: Wall time that its traffic of memory takes at least [ns].
    """

    elements: str
    what: str
    per: str
    ranks: int
    nanoseconds: float
    bound: float

    def row(self) -> dict[str, object]:
        """As a table's row."""
        return asdict(self)


def triad(comm: MPI.Comm) -> float:
    """Bandwidth of memory of all ranks together [byte/s]. Collective.

    Of a = b + s c as numpy does it, which reads or writes five arrays (J. D. McCalpin, Memory
    Bandwidth and Machine Balance, IEEE TCCA Newsletter, December 1995).
    """
    a, b, c = (np.full(_TRIAD, 1.0 + i) for i in range(3))

    def once() -> None:
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    return 5 * a.nbytes * comm.size / _fastest(comm, once)


def _fastest(comm: MPI.Comm, action: Callable[[], object]) -> float:
    """Seconds of the fastest of some runs, each as long as its slowest rank takes. Collective."""
    found = np.inf
    for _ in range(_TIMES):
        comm.barrier()
        begin = time.perf_counter()
        action()
        found = min(found, largest(comm, time.perf_counter() - begin))
    return float(found)


def speeds(comm: MPI.Comm, bandwidth: float) -> Iterator[Speed]:
    """The kernels of statics and of explicit motion, one after the other. Collective.

    Args:
        bandwidth: See `triad` [byte/s].
    """
    for degree, n in _CELLS.items():
        cubes = max(2, round(n * comm.size ** (1 / 3)))
        body = box_body(size=(2, 1, 1), cells=(2 * cubes, cubes, cubes), comm=comm)
        law = NeoHookean(E=1e6, nu=0.3, density=1000)
        pull = Traction(on="right", value=(0, 0, -13e3))
        problem = Problem(body, law, supports=[Support(on="left")], loads=[pull], degree=degree)
        yield from _statics(problem, bandwidth)
        if degree == 1:
            yield _explicit(Problem(body, law, degree=degree), bandwidth)


def _speed(
    problem: Problem, what: str, per: str, seconds: float, *, count: float, least: float
) -> Speed:
    """Of one of `count` that take so long together, and at least the time of their traffic [s]."""
    elements = "linear" if problem.degree == 1 else "quadratic"
    factor = 1e9 / count
    return Speed(elements, what, per, problem.body.comm.size, seconds * factor, least * factor)


def _statics(problem: Problem, bandwidth: float) -> Iterator[Speed]:
    """Of a nonlinear equilibrium, then its tangent and its residual there."""
    comm, cells = problem.body.comm, problem.body.num_cells
    with timed() as watch:
        (*_, state) = Statics(problem, linear=_ITERATIVE).steps()
    solve = largest(comm, watch.seconds["solve"]) / max(1, state.krylov)
    assembler = Assembler(problem, iterated=in_blocks(choose(problem, _ITERATIVE), {}))
    x = assembler.tangent.matrix.createVecRight()
    tangent = _fastest(comm, lambda: assembler.tangent.assemble(x))
    residual = _fastest(comm, assembler.residual.assemble)
    matrix = total(comm, assembler.tangent.matrix.getPythonContext().nbytes)
    x.destroy()
    assembler.destroy()
    unknowns, nodes = problem.num_dofs, _nodes_of_cells(problem)
    for what, per, seconds, count, traffic in (
        ("multigrid and CG", "unknown and iteration", solve, unknowns, 3 * matrix),
        ("tangent", "cell", tangent, cells, matrix + nodes),
        ("residual", "cell", residual, cells, nodes + 3 * 8 * unknowns),
    ):
        least = traffic / bandwidth
        yield _speed(problem, what, per, seconds, count=count, least=least)


def _explicit(problem: Problem, bandwidth: float) -> Speed:
    rest = fem.Function(problem.V)
    march = Explicit(problem, rest, CentralDifferences, end=1e6, dt=None, safety=0.9, every=_STEPS)
    march.scheme.assemble_forces()

    def steps() -> None:
        for _ in range(_STEPS):
            march.step()

    seconds = _fastest(problem.body.comm, steps) / _STEPS
    least = (_nodes_of_cells(problem) + 7 * 8 * problem.num_dofs) / bandwidth
    march.destroy()
    cells = problem.body.num_cells
    return _speed(problem, "explicit motion", "cell and step", seconds, count=cells, least=least)


def _nodes_of_cells(problem: Problem) -> float:
    """Bytes of the numbers of the cells' nodes, on all ranks."""
    return total(problem.body.comm, problem.V.dofmap.list.nbytes)
