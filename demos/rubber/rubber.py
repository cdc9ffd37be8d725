"""Torsion of a rubber cylinder at nu = 0.4999: elements with and without volumetric locking.

Problem
    A cylinder of radius a = 10 mm and length 10 mm whose ends are rotated against each other by
    one radian at a fixed distance.  Rubber is nearly incompressible.

Equations
    Neo-Hookean, in two formulations.  With displacements alone, psi(F) penalises a change
    of volume by its large lmbda; linear tetrahedra, each of constant volume, then lock.
    In the mixed formulation a pressure p is an unknown of its own: the energy is
    mu/2 (tr F^T F - 3) - mu ln J + p ln J - p^2/(2 lmbda).

    An incompressible cylinder twisted by psi per length needs the torque T = pi mu a^4 psi/2 and
    pushes its ends apart with N = pi mu a^4 psi^2/4 (Rivlin 1949; Poynting's effect).

Discretisation
    The same tetrahedra with linear displacements (P1), with linear displacements and pressures
    (P1/P1, stabilised), and with quadratic displacements and linear pressures (P2/P1).

Result
    P1 is many times too stiff, P1/P1 a little, and P2/P1 has the exact torque within 1e-3.

        python3 demos/rubber/rubber.py
        mpirun -n 2 python3 demos/rubber/rubber.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Case, Statics, read_case
from dolfin_elastic.results.evaluate import Evaluator

HERE = Path(__file__).parent
A, MU, PSI = 0.01, 0.5e6, 100.0
"""Radius [m], shear modulus [Pa], twist per length [1/m]."""
TORQUE, PUSH = np.pi * MU * A**4 * PSI / 2, np.pi * MU * A**4 * PSI**2 / 4
TOLERANCE = 1e-3
"""Of the torque.  At nu = 0.4999 instead of 0.5 it changes by 2e-4, the mesh does the rest."""
ELEMENTS = {
    "P1": {"degree": 1, "formulation": "displacement"},
    "P1/P1": {"degree": 1, "formulation": "mixed"},
    "P2/P1": {"degree": 2, "formulation": "mixed"},
}


def solved(element):
    """The case with another element: unknowns, torque and push of the upper end."""
    tables = read_case(HERE / "case.toml").to_dict()
    tables["mesh"] |= element
    case = Case.from_dict(tables, folder=HERE)
    problem = case.make_problem(case.read_body())
    *_, state = Statics(problem, case.statics).steps()
    forces = Evaluator(problem, ["reaction"])(state)["reaction"]
    X = problem.V.tabulate_dof_coordinates()[: len(forces)]
    x = X + problem.u.x.array[: X.size].reshape(X.shape)
    high = X[:, 2] > 0.01 - 1e-9
    torque = np.cross(x[high], forces[high])[:, 2].sum()
    return problem.num_dofs, MPI.COMM_WORLD.allreduce(torque), -state.reactions["high"][2]


def main():
    root = MPI.COMM_WORLD.rank == 0
    if root:
        print("element  unknowns  torque [N m]  exact   push [N]  exact")
    for name, element in ELEMENTS.items():
        unknowns, torque, push = solved(element)
        if root:
            print(f"{name:7} {unknowns:9d} {torque:13.5f} {TORQUE:7.5f} {push:9.3f} {PUSH:7.3f}")
    off = abs(torque / TORQUE - 1)
    if root:
        print(f"P2/P1 torque off by {off:.1e} (allowed {TOLERANCE:.0e})")
    assert off < TOLERANCE


if __name__ == "__main__":
    main()
