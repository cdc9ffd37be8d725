"""A sphere and a tube of two layers under pressure, in closed form and as a case.

u = A r + B/r^n, n = 2 of the sphere and 1 of the tube, in each layer; radial stress q - s/r^(n+1),
with the constants of both from the pressure inside, none outside, and equal displacement and radial
stress where they meet (S. P. Timoshenko and J. N. Goodier, Theory of Elasticity (1970), sections 28
and 137).  q = (3K or 2(lmbda + mu)) A is an unknown of its own, so that nu = 0.5 is no exception.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from dolfin_elastic import Case, Problem
from dolfin_elastic.problem.state import State

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
