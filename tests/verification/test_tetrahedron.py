"""One linear tetrahedron: its nodal forces are known in closed form.

X0 = (1, 1, 0), X1 = (3, 1, 0), X2 = (1, 3, 0), X3 = (1, 1, 1); corner 2 moves to (1, 2, 0), so
F = diag(1, 1/2, 1), J = 1/2, the volume is V0 = 2/3 and the Green strain diag(0, -3/8, 0).  The
internal force at corner a is V0 P grad(phi_a); the force of the element on the corner is its
negative.  P is worked out by hand from each law (Bonet & Wood 2008, section 6).
"""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem, la
from helpers.tetrahedron import CORNERS, GRADIENTS, V0
from mpi4py import MPI

from dolfin_elastic import (
    LinearElastic,
    NeoHookean,
    Problem,
    StVenantKirchhoff,
    Textbook,
)
from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.mesh import Body
from dolfin_elastic.mesh.distribute import make_mesh

SHIFT = np.array([[0.0, 0, 0], [0, 0, 0], [0, -1, 0], [0, 0, 0]])
E, NU = 1e7, 0.4999
MU, LMBDA = 5e10 / 14999, 2.4995e14 / 14999
"""The Lame constants of E = 10 MPa, nu = 0.4999 as exact fractions."""
LN2 = np.log(2)

STRESS = {
    Textbook: (-3 * LMBDA / 16, -3 * (LMBDA + 2 * MU) / 8, -3 * LMBDA / 16),
    StVenantKirchhoff: (-3 * LMBDA / 8, -3 * (LMBDA + 2 * MU) / 16, -3 * LMBDA / 8),
    NeoHookean: (-LMBDA * LN2, -2 * LMBDA * LN2 - 3 * MU / 2, -LMBDA * LN2),
    LinearElastic: (-LMBDA / 2, -(LMBDA + 2 * MU) / 2, -LMBDA / 2),
}
ENERGY = {
    StVenantKirchhoff: 7.814583472232e8,
    NeoHookean: 2.669534536679e9,
    LinearElastic: 1.389259283952e9,
}
PRINTED = {  # f1x, f2y, f3z of the element on its corners [N]
    Textbook: (1.041527768518e9, 2.083888925929e9, 2.083055537036e9),
    StVenantKirchhoff: (2.083055537036e9, 1.041944462964e9, 4.166111074072e9),
    NeoHookean: (3.850304193190e9, 7.702275164165e9, 7.700608386380e9),
    LinearElastic: (2.777407382715e9, 2.778518567905e9, 5.554814765429e9),
}
LAWS = pytest.mark.parametrize("law", STRESS, ids=lambda law: law.__name__)


class Tetrahedron:
    """The element under a law; nodal values go in and come out by the corners' numbers."""

    def __init__(self, comm: MPI.Comm, law: type, nu: float = NU) -> None:
        root = comm.rank == 0
        cells = np.array([[0, 1, 2, 3]] if root else np.empty((0, 4)), dtype=np.int64)
        self.mesh = make_mesh(comm, cells, CORNERS if root else np.empty((0, 3)), 1)
        self.comm, self.problem = comm, Problem(Body(self.mesh), law(E=E, nu=nu), degree=1)
        wanted = [self.problem.weak_form.internal]
        if self.problem.has_energy:
            wanted.append(self.problem.weak_form.strain_energy)
        self._forms = compile_forms(comm, wanted, self.problem.jit)
        x = self.problem.V.tabulate_dof_coordinates()
        near = np.linalg.norm(x[:, None] - CORNERS[None], axis=2)
        self._corner = near.argmin(axis=1) if len(x) else np.empty(0, dtype=int)

    def move(self, u: np.ndarray) -> None:
        self.problem.u.x.array[:] = u[self._corner].ravel()

    def forces(self) -> np.ndarray:
        """Internal forces of all corners, the same on every rank."""
        V = self.problem.V.dofmap
        vector = la.vector(V.index_map, V.index_map_bs)
        fem.assemble_vector(vector.array, self._forms[0])
        vector.scatter_reverse(la.InsertMode.add)
        owned, out = V.index_map.size_local, np.zeros((4, 3))
        out[self._corner[:owned]] = vector.array[: 3 * owned].reshape(-1, 3)
        return self.comm.allreduce(out, op=MPI.SUM)

    def energy(self) -> float:
        return self.comm.allreduce(fem.assemble_scalar(self._forms[1]), op=MPI.SUM)


@LAWS
def test_nodal_forces(comm, law):
    element = Tetrahedron(comm, law)
    element.move(SHIFT)
    forces = element.forces()
    exact = V0 * GRADIENTS @ np.diag(STRESS[law])
    # nu = 0.4999 as a float is off by up to half a unit in the last place, which 1 - 2 nu
    # amplifies to 3e-13.
    np.testing.assert_allclose(forces, exact, rtol=1e-12, atol=1e-12 * np.abs(exact).max())
    assert np.abs(forces.sum(axis=0)).max() <= 1e-15 * np.abs(exact).max()
    printed = forces[1, 0], forces[2, 1], forces[3, 2]
    np.testing.assert_allclose(np.negative(printed), PRINTED[law], rtol=1e-12)
    others = forces[1:] * (1 - np.eye(3))
    assert np.abs(others).max() <= 1e-15 * np.abs(exact).max()


@LAWS
def test_strain_energy(comm, law):
    element = Tetrahedron(comm, law)
    element.move(SHIFT)
    if law not in ENERGY:
        assert element.problem.weak_form.strain_energy is None
        return
    assert element.energy() == pytest.approx(ENERGY[law], rel=1e-12)


@LAWS
def test_forces_are_a_third_of_the_tractions_of_the_faces(comm, law):
    """The surface's way to the same numbers: a third of sigma n da of each face to each corner."""
    element = Tetrahedron(comm, law)
    element.move(SHIFT)
    x, F = CORNERS + SHIFT, np.diag([1.0, 0.5, 1.0])
    sigma = np.diag(STRESS[law]) @ F.T / 0.5
    from_faces = np.zeros((4, 3))
    for opposite in range(4):
        a, b, c = (k for k in range(4) if k != opposite)
        area = np.cross(x[b] - x[a], x[c] - x[a]) / 2
        area *= -np.sign(area @ (x[opposite] - x[a]))  # outwards
        for corner in (a, b, c):
            from_faces[corner] += sigma @ area / 3
    forces = element.forces()
    np.testing.assert_allclose(forces, from_faces, rtol=0, atol=1e-12 * np.abs(forces).max())


@LAWS
def test_forces_turn_with_the_body(comm, law):
    """f(Q x + c) = Q f(x) for laws that are frame-indifferent, visibly not for the others.

    With nu = 0.3: next to 0.5 the stress is nearly a pressure, which knows no direction.
    """
    element = Tetrahedron(comm, law, nu=0.3)
    element.move(SHIFT)
    forces = element.forces()
    Q, _ = np.linalg.qr(np.array([[1.0, 2, 0], [-1, 1, 3], [0.5, 1, 1]]))
    Q *= np.linalg.det(Q)
    element.move((CORNERS + SHIFT) @ Q.T + [0.3, -2.0, 1.0] - CORNERS)
    error = np.abs(element.forces() - forces @ Q.T).max() / np.abs(forces).max()
    if law(E=E, nu=NU).frame_indifferent:
        assert error < 1e-14  # a few roundings of the places
    else:
        assert error > 0.1


@LAWS
def test_no_forces_at_rest_or_far_away(comm, law):
    element = Tetrahedron(comm, law)
    element.move(np.zeros((4, 3)))
    assert np.abs(element.forces()).max() == 0.0
    element.move(np.full((4, 3), 5.0))
    # lmbda times the rounding of 5 in the gradient of a constant.
    assert np.abs(element.forces()).max() <= 1e-14 * LMBDA
