"""One tetrahedron, squeezed to half its height: every number by hand and by the program.

Problem
    The corners X0 = (1, 1, 0), X1 = (3, 1, 0), X2 = (1, 3, 0), X3 = (1, 1, 1) [m] stay where
    they are, but for X2, which moves to x2 = (1, 2, 0).  Rubber: E = 1e7 Pa, nu = 0.4999.
    Wanted: deformation gradient F, Green strain E, stress, the forces on the four faces and the
    forces of the element on its four corners.

Equations
    In a linear tetrahedron F = I + sum_a u_a (x) grad phi_a is constant.  The first
    Piola-Kirchhoff stress P(F) comes from the law, sigma = P F^T / J is the Cauchy stress, and
    with the reference volume V0

        f_a = - V0 P grad phi_a

    is the force of the element on its corner a (minus the derivative of the energy with respect
    to x_a, where there is an energy).  The program's internal force vector is the opposite: the
    force that must be applied at the corners from outside.

    The force on the face opposite a, from outside, is sigma A_a with the outward area vector A_a
    of the deformed face.  A third of it goes to each of the face's corners.  Nanson's relation
    makes both ways the same, for any sigma(F).

Laws
    textbook             sigma = lambda tr(E) I + 2 mu E, as introductory texts have it
    st-venant-kirchhoff  the same between S and E
    neo-hookean          psi = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2

Signs
    Here a face's normal points outward, and its force is the one on the element from outside: of
    the squeezed rubber they press inward.  The texts that have this example print the forces with
    inward normals, which are those of the element on its surroundings: the opposite ones.  One
    such text prints the force on the slanted face with three minus signs that its own corner
    forces contradict; and it prints f2y and f3z alike (2.08e9) although they differ in the third
    digit.

Result
    All numbers agree with the closed forms to 1e-12; the forces add up to zero.  Any number of
    ranks works; one of them owns the cell.

        python3 demos/tetrahedron/tetrahedron.py
        mpirun -n 2 python3 demos/tetrahedron/tetrahedron.py
"""

from __future__ import annotations

from math import log

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import create_mesh
from mpi4py import MPI

from dolfin_elastic import (
    Body,
    NeoHookean,
    Problem,
    StVenantKirchhoff,
    Textbook,
)
from dolfin_elastic.solvers.assembly.assembler import Assembler

X = np.array([[1, 1, 0], [3, 1, 0], [1, 3, 0], [1, 1, 1]], dtype=float)
X2_MOVED = np.array([1.0, 2.0, 0.0])
RUBBER = {"E": 1e7, "nu": 0.4999}
LAWS = {
    "textbook": Textbook(**RUBBER),
    "st-venant-kirchhoff": StVenantKirchhoff(**RUBBER),
    "neo-hookean": NeoHookean(**RUBBER),
}
TOLERANCE = 1e-12
"""A few hundred roundings: grad phi, F, the stress and one product; nothing is solved."""


# --- the closed forms ---


def by_hand(name, lmbda, mu):
    """Diagonal of P for F = diag(1, 1/2, 1), from which all forces follow."""
    if name == "textbook":
        return np.array([-3 * lmbda / 16, -3 * (lmbda + 2 * mu) / 8, -3 * lmbda / 16])
    if name == "st-venant-kirchhoff":
        return np.array([-3 * lmbda / 8, -3 * (lmbda + 2 * mu) / 16, -3 * lmbda / 8])
    return np.array([-lmbda * log(2), -2 * lmbda * log(2) - 1.5 * mu, -lmbda * log(2)])


def nodal_forces_by_hand(P):
    """f_a = -V0 P grad phi_a with V0 = 2/3 and the gradients below, shape (4, 3)."""
    gradients = np.diag([1 / 2, 1 / 2, 1])  # of phi_1, phi_2, phi_3
    f = -2 / 3 * gradients * P
    return np.vstack([-f.sum(axis=0), f])


# --- the program ---


def tetrahedron(comm):
    """A body of one cell, which rank 0 brings and one rank gets."""
    mine = comm.rank == 0
    cells = np.array([[0, 1, 2, 3]] if mine else np.empty((0, 4)), dtype=np.int64)
    points = X if mine else np.empty((0, 3))
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    return Body(create_mesh(comm, cells, points, element), source="one tetrahedron")


def move(problem):
    """Puts corner 2 to its new place."""
    u = problem.u.x.array.reshape(-1, 3)
    u[corners(problem, X[2])] = X2_MOVED - X[2]


def corners(problem, place):
    """Local nodes at a place: one, or none on a rank that does not have it."""
    nodes = problem.V.tabulate_dof_coordinates()
    return np.flatnonzero(np.linalg.norm(nodes - place, axis=1) < 1e-9)


def nodal_forces(problem):
    """Forces of the element on its corners, minus the internal force vector, shape (4, 3)."""
    assembler = Assembler(problem)
    assembler.residual.assemble()
    balance = assembler.residual.owned.reshape(-1, 3)
    forces = np.zeros((4, 3))
    for a in range(4):
        nodes = corners(problem, X[a])
        forces[a] = -balance[nodes[nodes < len(balance)]].sum(axis=0)
    assembler.destroy()
    return problem.body.comm.allreduce(forces, op=MPI.SUM)


def of_the_cell(problem, expression):
    """Value of a tensor in the only cell, on all ranks."""
    points = np.full((1, 3), 0.25)
    evaluate = fem.Expression(expression, points, comm=problem.body.comm)
    cells = problem.body.owned_cells()
    values = evaluate.eval(problem.body.mesh, cells).reshape(-1, 3, 3).sum(axis=0)
    return problem.body.comm.allreduce(values, op=MPI.SUM)


def face_forces(sigma):
    """Force on each deformed face from outside, keyed by the face's corners."""
    x = np.array([X[0], X[1], X2_MOVED, X[3]])
    forces = {}
    for a in range(4):
        face = [b for b in range(4) if b != a]
        area = np.cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]]) / 2
        outward = area * np.sign(area @ (x[face[0]] - x[a]))
        forces["".join(map(str, face))] = sigma @ outward
    return forces


def shared(faces):
    """What faces give to corners: a third to each of theirs; the sign of the element's force."""
    forces = np.zeros((4, 3))
    for name, force in faces.items():
        for a in map(int, name):
            forces[a] -= force / 3
    return forces


# --- comparing and printing ---


def say(comm, text):
    if comm.rank == 0:
        print(text, flush=True)


def matrix(name, A):
    rows = ["  ".join(f"{number:18.9e}" for number in row) for row in A + 0.0]
    return "\n".join(f"  {name if i == 0 else '':<8}{row}" for i, row in enumerate(rows))


def vectors(name, forces):
    return "\n".join(
        f"  {name}_{key:<5} " + "  ".join(f"{n:18.9e}" for n in f + 0.0)
        for key, f in forces.items()
    )


def distance(found, wanted):
    """Largest difference over the largest number wanted."""
    return np.abs(np.asarray(found) - wanted).max() / max(np.abs(wanted).max(), 1e-300)


def compare(comm, name, law, body):
    """One law: program against hand; returns the largest relative difference."""
    from dolfin_elastic.model.kinematics import cauchy_from_first, deformation_gradient

    problem = Problem(body, law, degree=1)
    move(problem)
    F = deformation_gradient(problem.u)
    P = problem.regions[0].law.stress(F)
    sigma = of_the_cell(problem, cauchy_from_first(P, F))
    P, faces, forces = of_the_cell(problem, P), face_forces(sigma), nodal_forces(problem)
    P_hand = by_hand(name, law.lmbda, law.mu)
    f_hand = nodal_forces_by_hand(P_hand)
    differences = {
        "P": distance(P, np.diag(P_hand)),
        "nodal forces": distance(forces, f_hand),
        "faces shared": distance(shared(faces), f_hand),
        "sum of forces": np.abs(forces.sum(axis=0)).max() / np.abs(f_hand).max(),
    }
    say(
        comm,
        f"\n{name}\n{matrix('P', P)}\n{matrix('sigma', sigma)}\n"
        "  forces on the faces from outside [N]\n"
        + vectors("t", faces)
        + "\n  forces of the element on its corners [N]\n"
        + vectors("f", dict(enumerate(forces)))
        + "\n  relative difference to the hand: "
        + ", ".join(f"{key} {value:.0e}" for key, value in differences.items()),
    )
    return max(differences.values())


def show_deformation(comm, body):
    """F and Green strain, the same for all laws; returns the largest difference."""
    from dolfin_elastic.model.kinematics import deformation_gradient, green_strain

    problem = Problem(body, LAWS["neo-hookean"], degree=1)
    move(problem)
    expression = deformation_gradient(problem.u)
    F, E = of_the_cell(problem, expression), of_the_cell(problem, green_strain(expression))
    say(comm, matrix("F", F) + "\n" + matrix("E", E) + f"\n  J       {np.linalg.det(F):18.9e}")
    return max(distance(F, np.diag([1, 1 / 2, 1])), distance(E, np.diag([0, -3 / 8, 0])))


def main():
    comm = MPI.COMM_WORLD
    body = tetrahedron(comm)
    worst = show_deformation(comm, body)
    worst = max([worst, *(compare(comm, name, law, body) for name, law in LAWS.items())])
    say(comm, f"\nlargest relative difference: {worst:.1e} (allowed {TOLERANCE:.0e})")
    assert worst < TOLERANCE


if __name__ == "__main__":
    main()
