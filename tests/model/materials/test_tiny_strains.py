"""Every row of the table of laws at strains down to 1e-18, where F - I has no digit left.

At points against the energies of the literature in a hundred digits, and as residuals of bodies of
every kind against the linear law with the same moduli.
"""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from helpers import reference_energies as reference
from helpers.law_at_points import Program, tensor
from helpers.laws import make
from mpi4py import MPI

from dolfin_elastic import Problem, box_body
from dolfin_elastic.core.jit import compile_expression, compile_forms
from dolfin_elastic.model.kinematics import (
    deformation_from,
    displacement_gradient,
    expm1,
    expm1_less,
    gradient_variation,
    log1p,
    log1p_less,
)
from dolfin_elastic.model.loads.eigenstrain import Thermal
from dolfin_elastic.model.materials.growth import GrownLaw
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.ufl_to_numpy import LawAtPoints

LAWS = pytest.mark.parametrize("name", MATERIALS)
SIZES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-16, 1e-18)
"""Of the displacement gradient."""
I = np.eye(3)
SHAPE = np.random.default_rng(5).uniform(-1, 1, (3, 3)) / 2
"""A displacement gradient over its size: strain and rotation."""
ROUNDING = 1e-12
"""Some hundred roundings of a sum without cancellation; that of the laws asks for 1e-10."""


class AtGradients:
    """A law, or one with growth, as a function of H = F - I."""

    def __init__(self, law: Law | GrownLaw) -> None:
        self.H = tensor()
        F = deformation_from(self.H)
        self._psi = Program(law.energy(F)) if law.has_energy else None
        self._P, self._strain = Program(law.stress(F)), Program(law.strain(F))

    def stress(self, H: np.ndarray) -> np.ndarray:
        return self._P({self.H: H[None]})[0]

    def strain(self, H: np.ndarray) -> np.ndarray:
        return self._strain({self.H: H[None]})[0]

    def energy(self, H: np.ndarray) -> float:
        assert self._psi is not None
        return float(self._psi({self.H: H[None]})[0])


def exactly(law: Law, H: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy and stress of the reference, by central differences in a hundred digits."""
    with mp.workdps(100):
        F, h, P = mp.eye(3) + reference.matrix(H), mp.mpf("1e-35"), np.zeros((3, 3))
        if not law.has_energy:  # the textbook's law
            E = (F.T * F - mp.eye(3)) / 2
            sigma = law.lmbda * (E[0, 0] + E[1, 1] + E[2, 2]) * mp.eye(3) + 2 * law.mu * E
            exact = mp.det(F) * sigma * (F**-1).T
            return 0.0, np.array(exact.tolist(), dtype=np.float64)
        for i, j in np.ndindex(3, 3):
            D = mp.zeros(3)
            D[i, j] = h
            P[i, j] = (reference.energy(law, F + D) - reference.energy(law, F - D)) / (2 * h)
        return float(reference.energy(law, F)), P


@pytest.mark.usefixtures("serial_only")
@pytest.mark.sample(4)
@LAWS
def test_energy_and_stress(name):
    law = make(name)
    point = AtGradients(law)
    for size in SIZES:
        H = size * SHAPE
        psi, P = exactly(law, H)
        # Principal stretches that are apart lose some digits about the first size.
        tolerance = 1e-10 if size > 1e-3 else ROUNDING
        assert np.abs(point.stress(H) - P).max() <= tolerance * np.abs(P).max(), size
        if law.has_energy:
            assert point.energy(H) == pytest.approx(psi, rel=tolerance), size


@pytest.mark.usefixtures("serial_only")
@LAWS
def test_strain_is_what_the_stress_follows_from(name):
    """The symmetric gradient, to round-off, at 1e-18; exactly that in linear laws of any size."""
    law = make(name)
    point, symmetric = AtGradients(law), (SHAPE + SHAPE.T) / 2
    np.testing.assert_allclose(point.strain(1e-18 * SHAPE), 1e-18 * symmetric, rtol=1e-14)
    H = 0.1 * SHAPE
    E = (H + H.T + H.T @ H) / 2
    values, axes = np.linalg.eigh(I + 2 * E)
    logarithm = axes @ np.diag(np.log(values) / 2) @ axes.T
    biot = axes @ np.diag(np.sqrt(values) - 1) @ axes.T
    others = {
        "hencky": logarithm,
        "j2-logarithmic": logarithm,
        "corotated": biot,
        "fixed-corotated": biot,
    }
    wanted = 0.1 * symmetric if law.linear else others.get(name, E)
    np.testing.assert_allclose(point.strain(H), wanted, rtol=0, atol=1e-14)


@pytest.mark.usefixtures("serial_only")
@LAWS
@pytest.mark.sample(4)
def test_growth_as_tiny_as_the_strain(name):
    """Growth of 1e-18 within a strain of as much: that of their difference."""
    law, G = make(name), SHAPE[::-1]
    grown = AtGradients(GrownLaw(law, ufl.Identity(3) + ufl.as_matrix((1e-18 * G).tolist())))
    plain = AtGradients(law)
    H = 1e-18 * SHAPE
    np.testing.assert_allclose(
        grown.stress(H), plain.stress(H - 1e-18 * G), rtol=1e-13, atol=1e-13 * 1e-18 * 1e6
    )
    np.testing.assert_allclose(grown.strain(H), plain.strain(H - 1e-18 * G), rtol=1e-13)


@pytest.mark.usefixtures("serial_only")
def test_functions_near_zero():
    """On both sides of where their series end, and at -1 as the logarithm."""
    H = tensor()
    x = H[0, 0]
    program = Program(ufl.as_vector([log1p(x), log1p_less(x), expm1(x), expm1_less(x)]))
    places = [s * v for s in (1, -1) for v in (1e-18, 1e-9, 4.99e-3, 5.01e-3, 0.0999, 0.1001, 0.7)]
    for value in places:
        with mp.workdps(60):
            v = mp.mpf(value)
            wanted = mp.log(1 + v), mp.log(1 + v) - v, mp.exp(v) - 1, mp.exp(v) - 1 - v
            exact = [float(number) for number in wanted]
        found = program({H: np.full((1, 3, 3), value)})[0]
        # ln(1 + x) - x cancels at the end of its series: 1e-16/5e-3^2.
        np.testing.assert_allclose(found, exact, rtol=2e-11)
        np.testing.assert_allclose(found[[0, 2]], [exact[0], exact[2]], rtol=1e-13)
    assert np.isnan(program({H: np.full((1, 3, 3), -1.5)})[0, :2]).all()


def test_gradient_is_found_in_a_sum():
    H = tensor()
    assert displacement_gradient(ufl.Identity(3) + H) is H
    assert displacement_gradient(H + ufl.Identity(3)) is H
    plain = Program(displacement_gradient(H))
    np.testing.assert_array_equal(plain({H: (I + SHAPE)[None]})[0], I + SHAPE - I)


# --- residuals of bodies ---

KINDS = ["plane-strain", "plane-stress", "axisymmetric", "solid"]
BODIES = [
    (name, kind, "displacement")
    for name in MATERIALS
    for kind in KINDS
    if (name, kind) != ("j2-logarithmic", "plane-stress")  # is refused
] + [
    (name, kind, "mixed")
    for name, law in MATERIALS.items()
    for kind in KINDS
    if issubclass(law, SplitLaw) and kind != "plane-stress"
]
"""Laws without a volumetric part have no pressure, and plane stress needs none."""


def linear_form(problem: Problem, law: Law) -> ufl.Form:
    """Virtual work of the linear law with the same moduli, mixed as the problem is."""
    weak, unknowns, region = problem.weak_form, problem.unknowns, problem.regions[0]
    test = ufl.TestFunction(problem.W)

    def gradient(w: Any) -> Any:
        stretch = unknowns.auxiliary("stretch", w) if unknowns.has("stretch") else None
        u = unknowns.displacement(w)
        return gradient_variation(problem.geometry, u, problem.X, stretch)

    H, dH, dx = gradient(problem.w), gradient(test), weak.volume(region, weak.rule(region))
    given = law.model_copy(update={law.volume_modulus: 0.0}) if problem.mixed else law
    A = LawAtPoints(given).tangent(I[None])[0]
    i, j, k, m = ufl.indices(4)
    form = ufl.as_tensor(A.tolist())[i, j, k, m] * H[k, m] * dH[i, j] * dx
    if not problem.mixed:
        return form
    p, q = unknowns.auxiliary("pressure", problem.w), unknowns.auxiliary("pressure", test)
    compliance = 1 / getattr(law, law.volume_modulus)
    return form + p * ufl.tr(dH) * dx + q * (ufl.tr(H) - p * compliance) * dx


def assembled(problem: Problem, form: ufl.Form) -> fem.Form:
    return compile_forms(problem.body.comm, [form], problem.jit)[0]


def nodal(form: fem.Form) -> np.ndarray:
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(la.InsertMode.add)
    imap = form.function_spaces[0].dofmap.index_map
    return np.array(vector.array[: imap.size_local * form.function_spaces[0].dofmap.index_map_bs])


def largest(problem: Problem, values: np.ndarray) -> float:
    return float(problem.body.comm.allreduce(np.abs(values).max(initial=0.0), op=MPI.MAX))


@pytest.mark.sample(3)
@pytest.mark.parametrize(("name", "kind", "formulation"), BODIES)
def test_residual_is_the_linear_one(name, kind, formulation):
    """By the compiled kernels: apart by the curvature of the law, and by rounding below that."""
    law = make(name, slack=False) if name == "holzapfel-gasser-ogden" else make(name)
    mixed = formulation == "mixed"
    dim = 3 if kind == "solid" else 2
    body = box_body(size=(1.0, 0.8, 0.7)[:dim], cells=(2, 1, 1)[:dim])
    body.mesh.geometry.x[:, 0] += 1.0  # off the axis
    problem = Problem(
        body,
        law,
        degree=2 if mixed else 1,
        formulation=formulation,
        geometry="plane-strain" if dim == 3 else kind,
    )
    waves = problem.places @ np.random.default_rng(3).uniform(-3, 3, (3, dim))
    found, wanted = (
        assembled(problem, form) for form in (problem.weak_form.residual, linear_form(problem, law))
    )
    problem.w.x.array[:] = np.sin(1.0 + np.arange(len(problem.w.x.array)))
    problem.w.x.scatter_forward()
    shape = problem.w.x.array.copy()
    shape[problem.unknowns.mixed_dofs(np.arange(waves.size, dtype=np.int32))] = np.sin(
        waves
    ).reshape(-1)
    for size in SIZES[1:]:
        problem.w.x.array[:] = 0.1 * size * shape
        right = nodal(wanted)
        error = largest(problem, nodal(found) - right) / largest(problem, right)
        assert error < 30 * size + (1e-12 if law.linear else 1e-10), size


@pytest.mark.usefixtures("serial_only")
def test_thermal_strain_of_a_linear_law_is_exact():
    """1e-18 K: free expansion has no stress, and a body that is held has -3 K alpha dT."""
    law = make("linear-elastic", expansion=1e-5)
    problem = Problem(
        box_body(size=(1, 1, 1), cells=(1, 1, 1)),
        law,
        degree=1,
        loads=[Thermal(value=1e-18), Thermal(value=2e-18)],
    )
    problem.set_time(1.0)
    F = problem.weak_form.F(problem.w)
    P = problem.weak_form.response(problem.regions[0], problem.w).stress(F)
    stress = compile_expression(
        problem.body.comm, ufl.as_vector([P[0, 0], P[0, 1]]), np.full((1, 3), 0.25), problem.jit
    )
    held = stress.eval(problem.body.mesh, np.arange(1, dtype=np.int32)).ravel()
    np.testing.assert_allclose(held, [-3 * law.K * 3e-23, 0.0], rtol=1e-14, atol=1e-40)
    problem.u.interpolate(lambda x: 3e-23 * x)
    problem.unknowns.u_to_w()
    free = stress.eval(problem.body.mesh, np.arange(1, dtype=np.int32)).ravel()
    np.testing.assert_allclose(free, [0.0, 0.0], atol=1e-14 * law.K * 3e-23)
