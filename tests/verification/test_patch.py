"""Patch tests: what the elements can represent exactly comes out exactly, on irregular meshes.

An affine displacement has a constant stress, so it is in equilibrium for every law; a quadratic
one is for Hooke's law under gravity.  Sources: Irons & Razzaque (1972); Timoshenko & Goodier,
Theory of Elasticity, section 86 (bar hanging by its own weight).
"""

from __future__ import annotations

from typing import Any

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from helpers import reference_energies
from helpers.laws import make
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    LinearElastic,
    NeoHookean,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)
from dolfin_elastic.mesh import Body
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.solvers.assembly.assembler import Assembler

E, NU = 1e6, 0.3
MU, LMBDA = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
H3 = np.array([[0.2, 0.3, -0.1], [0.1, -0.1, 0.2], [-0.2, 0.1, 0.1]])
H2 = np.array([[0.3, 0.4], [-0.2, -0.1]])
NORMALS = {
    "left": (0, -1),
    "right": (0, 1),
    "front": (1, -1),
    "back": (1, 1),
    "bottom": (2, -1),
    "top": (2, 1),
}


def irregular(body: Body, size: tuple[float, ...]) -> Body:
    """Moves nodes about, along faces on faces; a function of place, so all ranks agree."""
    x, start = body.mesh.geometry.x, body.mesh.geometry.x.copy()
    for i, L in enumerate(size):
        s, others = start[:, i] / L, start @ np.roll([0.0, 3.1, 1.7], i)
        x[:, i] += L / 8 * s * (1 - s) * np.sin(4 * others + i)
    return body


def make_body(dim: int) -> tuple[Body, tuple[float, ...]]:
    size = (1.0, 0.8, 0.6)[:dim]
    return irregular(box_body(size=size, cells=(3, 2, 2)[:dim]), size), size


def affine(H: np.ndarray) -> list[str]:
    return [
        " + ".join(f"({h!r})*{x}" for h, x in zip(map(float, row), "xyz", strict=False))
        for row in H
    ]


def stress(law: Any, F: np.ndarray) -> np.ndarray:
    """P by hand (Bonet & Wood 2008, section 6), or from a reference energy, for a 3x3 F."""
    J, green, I = np.linalg.det(F), (F.T @ F - np.eye(3)) / 2, np.eye(3)
    hooke = lambda e: LMBDA * np.trace(e) * I + 2 * MU * e  # noqa: E731
    G = np.linalg.inv(F).T
    known = {
        "linear-elastic": lambda: hooke((F + F.T) / 2 - I),
        "st-venant-kirchhoff": lambda: F @ hooke(green),
        "neo-hookean": lambda: MU * (F - G) + LMBDA * np.log(J) * G,
        "textbook": lambda: J * hooke(green) @ G,
    }
    return known.get(law.name(), lambda: reference_energies.stress(law, F))()


def largest(comm: MPI.Comm, values: np.ndarray) -> float:
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def off(problem: Problem, exact: Any) -> float:
    """Largest nodal distance from a displacement given as a function of X, shape (n, 3)."""
    dim = problem.body.dim
    x = problem.V.tabulate_dof_coordinates()
    return largest(problem.body.comm, problem.u.x.array.reshape(-1, dim) - exact(x)[:, :dim])


def gradients(problem: Problem) -> np.ndarray:
    """grad u at four (three) points of every owned cell."""
    kind = getattr(basix.CellType, problem.body.mesh.topology.cell_name())
    points, _ = basix.make_quadrature(kind, 2)
    expression = fem.Expression(ufl.grad(problem.u), points, jit_options=problem.jit)
    values = expression.eval(problem.body.mesh, problem.body.owned_cells())
    return values.reshape(-1, problem.body.dim, problem.body.dim)


FULLY = ("linear-elastic", "st-venant-kirchhoff", "neo-hookean", "textbook")
"""Laws that are tried on every element; the others, which take long to compile, in space."""


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    ("name", "dim", "degree"),
    [
        (name, dim, degree)
        for name in MATERIALS
        for dim, degree in ((2, 1), (2, 2), (3, 1), (3, 2))
        if name in FULLY or (dim, degree) == (3, 1)
    ],
)
def test_affine_displacement_of_the_boundary(comm, name, dim, degree):
    """The inside follows exactly, and the reactions are those of the constant stress."""
    body, size = make_body(dim)
    H = np.zeros((3, 3))
    H[:dim, :dim] = H2 if dim == 2 else H3
    law = make(name)
    support = Support(on=list(body.surfaces), displacement=affine(H[:dim, :dim]))
    problem = Problem(body, law, supports=[support], degree=degree)
    *_, state = Statics(problem, rtol=1e-14).steps()
    # Newton stops at the round-off of nodal forces; the inverse tangent takes it to u with the
    # condition of this small mesh.  Measured: 1e-15.
    assert off(problem, lambda X: X @ H.T) < 1e-13
    # Gradients divide the round-off of u by the height of the flattest cell.
    assert largest(comm, gradients(problem) - H[:dim, :dim]) < 1e-12
    # Virtual work in the fields X_j e_i: sum_a R_i X_j = P_ij V, all of them at once.
    assembler = Assembler(problem)
    assembler.residual.assemble()
    owned = assembler.size // dim
    forces = assembler.residual.owned.reshape(-1, dim)
    moments = forces.T @ problem.V.tabulate_dof_coordinates()[:owned, :dim]
    moments = comm.allreduce(moments, op=MPI.SUM)
    assembler.destroy()
    P = stress(law, np.eye(3) + H)
    np.testing.assert_allclose(
        moments / np.prod(size), P[:dim, :dim], rtol=0, atol=1e-12 * np.abs(P).max()
    )
    total = state.reactions[support.label]
    assert np.abs(total).max() < 1e-12 * np.abs(P).max()


@pytest.mark.parametrize("degree", [1, 2])
def test_affine_traction_patch(comm, degree):
    """Tractions P N all round, three faces held in one direction each, neo-Hookean.

    Without the traction of a face in its held direction, the reaction there is P N A.
    """
    body, size = make_body(3)
    law = NeoHookean(E=E, nu=NU)
    P, rows = stress(law, np.eye(3) + H3), affine(H3)
    supports, loads = [], []
    for name, (axis, sign) in NORMALS.items():
        traction = sign * P[:, axis]
        if sign < 0:
            supports.append(
                Support(on=name, displacement=[rows[i] if i == axis else "free" for i in range(3)])
            )
            traction = np.where(np.arange(3) == axis, 0.0, traction)
        loads.append(Traction(on=name, value=traction.tolist()))
    problem = Problem(body, law, supports=supports, loads=loads, degree=degree)
    *_, state = Statics(problem, steps=2, rtol=1e-14).steps()
    # As above; free corners are softer by an order of magnitude.
    assert off(problem, lambda X: X @ H3.T) < 1e-12
    for name, (axis, sign) in NORMALS.items():
        if sign < 0:
            area = np.prod(size) / size[axis]
            reaction = state.reactions[name]
            assert reaction[axis] == pytest.approx(-P[axis, axis] * area, rel=1e-11)
            assert np.count_nonzero(reaction) == 1


def test_quadratic_patch(comm):
    """A bar hanging by its own weight: quadratic elements hold Hooke's solution exactly."""
    L, rho, g = 2.0, 1000.0, 9.81
    size = (0.6, 0.4, L)
    body = irregular(box_body(size=size, cells=(2, 2, 3)), size)
    c = rho * g / E
    exact = [
        f"-{NU * c!r}*x*z",
        f"-{NU * c!r}*y*z",
        f"{c / 2!r}*(z^2 - {L**2!r} + {NU!r}*(x^2 + y^2))",
    ]
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        degree=2,
        supports=[Support(on="top", displacement=exact)],
        loads=[BodyForce(value=[0, 0, -rho * g])],
    )
    *_, state = Statics(problem, rtol=1e-14).steps()

    def solution(X: np.ndarray) -> np.ndarray:
        x, y, z = X.T
        return np.stack(
            [-NU * c * x * z, -NU * c * y * z, c / 2 * (z**2 - L**2 + NU * (x**2 + y**2))], axis=1
        )

    scale = c * L**2 / 2
    assert scale == pytest.approx(0.01962)
    # Nodal forces of the size E u h cancel to rho g h^3: a slender bar, condition about 1e3.
    assert off(problem, solution) < 1e-11 * scale
    weight = rho * g * np.prod(size)
    np.testing.assert_allclose(state.reactions["top"], [0, 0, weight], rtol=0, atol=1e-11 * weight)


def test_linear_elements_do_not_hold_the_quadratic_patch(comm):
    """The check above can fail: linear elements are off by per cents."""
    L, c = 2.0, 9.81e-3
    body = box_body(size=(0.6, 0.4, L), cells=(2, 2, 3))
    top = Support(
        on="top", displacement=[f"-{NU * c * L}*x", f"-{NU * c * L}*y", f"{c / 2 * NU}*(x^2 + y^2)"]
    )
    problem = Problem(
        body,
        LinearElastic(E=E, nu=NU),
        supports=[top],
        loads=[BodyForce(value=[0, 0, -9810])],
        degree=1,
    )
    _ = [*Statics(problem).steps()]
    error = off(
        problem,
        lambda X: np.stack(
            [
                -NU * c * X[:, 0] * X[:, 2],
                -NU * c * X[:, 1] * X[:, 2],
                c / 2 * (X[:, 2] ** 2 - L**2 + NU * (X[:, 0] ** 2 + X[:, 1] ** 2)),
            ],
            axis=1,
        ),
    )
    assert error > 1e-3 * c * L**2 / 2
