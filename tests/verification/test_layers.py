"""Two nearly incompressible materials that meet: a sphere and a tube of two layers under pressure.

Closed forms: u = A r + B/r^n, n = 2 of the sphere and 1 of the tube, in each layer; radial stress
q - s/r^(n+1), with the constants of both from the pressure inside, none outside, and equal
displacement and radial stress where they meet (S. P. Timoshenko and J. N. Goodier, Theory of
Elasticity (1970), sections 28 and 137).  q = (3K or 2(lmbda + mu)) A is an unknown of its own, so
that nu = 0.5 is no exception.  The pressure of the body jumps at the interface, by 0.6 times the
von Mises stress there: with one continuous field for both it was half of that jump off at any size
of cells, the stress 54 % too low.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from dolfin_elastic import Case, Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.results.recovery.stress import RegionStress, von_mises
from dolfin_elastic.solvers.assembly.assembler import compiled, integral

INNER, BETWEEN, OUTER, PRESSURE = 1.0, 1.5, 2.0, 1e4
QUARTER = """SetFactory("OpenCASCADE");
Disk(1) = {0, 0, 0, 2};
Disk(2) = {0, 0, 0, 1.5};
Disk(3) = {0, 0, 0, 1};
BooleanDifference(4) = { Surface{1}; Delete; }{ Surface{2}; };
BooleanDifference(5) = { Surface{2}; Delete; }{ Surface{3}; Delete; };
Rectangle(6) = {0, 0, 0, 3, 3};
BooleanIntersection(7) = { Surface{4}; Delete; }{ Surface{6}; };
BooleanIntersection(8) = { Surface{5}; Delete; }{ Surface{6}; Delete; };
BooleanFragments{ Surface{7}; Delete; }{ Surface{8}; Delete; }
"""


class Layers:
    """The closed form.

    Args:
        mu: Shear modulus of the inner and the outer layer [Pa].
        nu: Poisson's ratio of both.
        n: 2: sphere; 1: tube in plane strain.
    """

    def __init__(self, mu: tuple[float, float], nu: float, n: int) -> None:
        self.mu, self.n = mu, n
        # A = q compliance: of 3K in the sphere, of 2(lmbda + mu) in the tube.
        shape = (1 - 2 * nu) / (2 * (1 + nu)) if n == 2 else (1 - 2 * nu) / 2
        self.compliance = [shape / m for m in mu]
        a, c, b = (r ** (n + 1) for r in (INNER, BETWEEN, OUTER))
        s = [2 * n * m for m in mu]
        rows = [
            [1, -s[0] / a, 0, 0],
            [1, -s[0] / c, -1, s[1] / c],
            [0, 0, 1, -s[1] / b],
            [self.compliance[0], 1 / c, -self.compliance[1], -1 / c],
        ]
        self.q1, self.B1, self.q2, self.B2 = np.linalg.solve(rows, [-PRESSURE, 0, 0, 0])
        self.nu = nu

    def displacement(self, layer: int, x: Any) -> Any:
        """Of the inner (0) or outer (1) layer, UFL [m]."""
        q, B = ((self.q1, self.B1), (self.q2, self.B2))[layer]
        return x * (q * self.compliance[layer] + B / ufl.sqrt(ufl.dot(x, x)) ** (self.n + 1))

    def von_mises(self, layer: int) -> float:
        """At the interface, in one of the layers [Pa]."""
        q, B = ((self.q1, self.B1), (self.q2, self.B2))[layer]
        shear = 2 * self.mu[layer] * abs(B) / BETWEEN ** (self.n + 1)
        return 3 * shear if self.n == 2 else np.sqrt((q * (1 - 2 * self.nu)) ** 2 + 3 * shear**2)


def layers(folder: Path, size: float, mu: tuple[float, float], nu: float, n: int) -> Any:
    """The case: a quarter of the cross-section, curved cells."""
    file = folder / "layers.geo"
    if MPI.COMM_WORLD.rank == 0:
        file.write_text(QUARTER)
    MPI.COMM_WORLD.barrier()
    around = "sphere" if n == 2 else "cylinder"
    about = {"center": [0, 0, 0]} if n == 2 else {"axis": "z", "point": [0, 0, 0]}
    names, laws = ("inner", "outer"), {"law": "linear-elastic", "nu": nu}
    mesh = {"file": str(file), "unit": "m", "size": size}
    if n == 2:
        mesh["geometry"] = "axisymmetric"
    flat = ["y0"] if n == 2 else ["x0", "y0"]
    return {
        "mesh": mesh,
        "surfaces": {
            "hole": {around: about | {"radius": INNER}},
            **{name: {"plane": name[0], "at": "min"} for name in flat},
        },
        "regions": {"core": {around: about | {"radius": BETWEEN}}},
        "materials": {
            name: laws | {"mu": m} | ({"on": "core"} if name == "inner" else {})
            for name, m in zip(names, mu, strict=True)
        },
        "support": [{"on": flat, "kind": "symmetry"}],
        "load": [{"kind": "pressure", "on": "hole", "value": PRESSURE}],
        "output": {"folder": str(folder / "results")},
    }


def solve(case: dict[str, Any]) -> tuple[Problem, State]:
    read = Case.from_dict(case)
    problem = read.make_problem(read.read_body())
    *_, state = read.make_solver(problem).steps()
    return problem, state


def displacement_error(problem: Problem, exact: Layers) -> float:
    """Root of the integral of its square."""
    off = sum(
        ufl.dot(e, e) * problem.weak_form.volume(region, 8)
        for layer, region in enumerate(problem.regions)
        for e in [problem.u - exact.displacement(layer, problem.X)]
    )
    return float(np.sqrt(integral(problem, compiled(problem, [off])[0])))


def at_interface(problem: Problem, layer: int) -> float:
    """Mean recovered von Mises stress of a layer at the nodes of the interface."""
    values = RegionStress(problem, problem.regions[layer], problem.w).at_owned_nodes()
    size = problem.V.dofmap.index_map.size_local
    r = np.linalg.norm(problem.places[:size], axis=1)
    there = (np.abs(r - BETWEEN) < 1e-9) & (values[:, -1] > 0)
    stress = von_mises(values[there, :6])
    comm = problem.body.comm
    return float(comm.allreduce(stress.sum()) / comm.allreduce(len(stress)))


@pytest.mark.sample(3)
@pytest.mark.parametrize("n", [2, 1], ids=["sphere", "tube"])
@pytest.mark.parametrize("mu", [(1e6, 1e5), (1e5, 1e6)], ids=["stiff core", "soft core"])
@pytest.mark.parametrize("nu", [0.5, 0.4999, 0.49])
def test_closed_forms(folder, nu, mu, n):
    """Displacements converge with the third order; stress where the layers meet is right."""
    exact, off, stress = Layers(mu, nu, n), [], []
    for size in (0.2, 0.1, 0.05):
        problem, state = solve(layers(folder, size, mu, nu, n))
        assert state.audit is not None
        assert state.audit.verdict == "pass"
        off.append(displacement_error(problem, exact))
        stress.append([at_interface(problem, k) / exact.von_mises(k) - 1 for k in (0, 1)])
    # Orders of 2.88 to 2.95 were found, and errors of the stress of 0.7 and 0.05 % at the most.
    assert np.log(off[0] / off[2]) / np.log(4) > 2.85
    assert np.abs(stress[0]).max() < 0.01
    assert np.abs(stress[2]).max() < 0.0006
