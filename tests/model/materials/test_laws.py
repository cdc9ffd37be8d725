"""The gate that every material law passes: it loops over the table, so a new law is tested at once.

At a point (nothing is compiled): no stress and no energy at rest, frame indifference, stress and
tangent against finite differences, Hooke's law at small strains, closed forms.  Then homogeneous
states through the whole solver.  The constants are those of the law's example.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import ufl
from helpers.laws import (
    FREE,
    LMBDA,
    MU,
    NU,
    ROLLERS,
    SIZE,
    E,
    I,
    differences,
    homogeneous,
    make,
    point,
    random_F,
    rotation,
)
from ufl.algorithms import expand_derivatives
from ufl.utils.stacks import StackDict

from dolfin_elastic import (
    FixedCorotated,
    NeoHookean,
    StVenantKirchhoff,
)
from dolfin_elastic.model.kinematics import cauchy_from_first
from dolfin_elastic.model.materials.registry import MATERIALS

LAWS = pytest.mark.parametrize("name", MATERIALS)
ENERGIES = pytest.mark.parametrize("name", [n for n in MATERIALS if make(n).has_energy])


# --- at rest ---


@LAWS
def test_no_stress_at_rest(name):
    # A few roundings of moduli: lmbda ln(det I) and mu (I - I) leave nothing else.
    assert np.abs(point(name).stress(I)).max() <= 1e-14 * E


@LAWS
def test_what_does_not_see_inversion_has_the_mirror_image_at_rest(name):
    """And nothing else has: linear laws aside, whose rotations are strains, too."""
    law = make(name)
    with np.errstate(all="ignore"):
        stress = np.abs(point(name).stress(np.diag([1.0, 1.0, -1.0]))).max()
    assert law.blind_to_inversion == bool(stress <= 1e-14 * E)
    assert not (law.blind_to_inversion and law.survives_inversion)


@ENERGIES
def test_no_energy_at_rest_and_some_elsewhere(name):
    assert abs(point(name).energy(I)) <= 1e-14 * E
    for seed in range(5):
        assert point(name).energy(random_F(seed)) > 1e-3 * E


# --- derivatives ---


@ENERGIES
@pytest.mark.parametrize("seed", range(3))
def test_stress_is_the_derivative_of_the_energy(name, seed):
    F = random_F(seed)
    P = point(name).stress(F)
    numeric = differences(point(name).energy, F)
    # Truncation h^4 and round-off eps/h, both about 1e-12 of the modulus, with room for the
    # fifth derivative of the logarithm.
    np.testing.assert_allclose(P, numeric, rtol=0, atol=1e-9 * np.abs(P).max())


@LAWS
def test_tangent_is_the_derivative_of_the_stress(name):
    F = random_F(0)
    A = point(name).tangent(F)
    numeric = differences(point(name).stress, F)
    np.testing.assert_allclose(A, numeric, rtol=0, atol=1e-9 * np.abs(A).max())


@LAWS
def test_tangent_is_symmetric_exactly_if_there_is_an_energy(name):
    A = point(name).tangent(random_F(0))
    asymmetry = np.abs(A - A.transpose(2, 3, 0, 1)).max() / np.abs(A).max()
    if make(name).has_energy:
        assert asymmetry < 1e-13
    else:
        assert asymmetry > 1e-2


@LAWS
def test_small_strains_obey_hooke(name):
    """With the moduli the law says it has."""
    moduli = make(name).small_strain()
    if moduli is None:
        return
    A = point(name).tangent(I)
    d = I
    hooke = moduli.lmbda * np.einsum("ij,kl->ijkl", d, d) + moduli.mu * (
        np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    )
    np.testing.assert_allclose(A, hooke, rtol=0, atol=1e-13 * moduli.K)


@LAWS
def test_linear_is_said_truly(name):
    F, far = random_F(0), random_F(1)
    changes = np.abs(point(name).tangent(F) - point(name).tangent(far)).max()
    assert (changes <= 1e-12 * E) == make(name).linear


# --- rotations ---


@LAWS
@pytest.mark.parametrize("seed", range(3))
def test_frame_indifference_is_said_truly(name, seed):
    """P(Q F) = Q P(F) and psi(Q F) = psi(F), or visibly not."""
    F, Q = random_F(seed), rotation(seed + 10)
    P = point(name).stress(F)
    error = np.abs(point(name).stress(Q @ F) - Q @ P).max() / np.abs(P).max()
    if not make(name).frame_indifferent:
        assert error > 0.1
        return
    assert error < 1e-12
    if make(name).has_energy:
        assert point(name).energy(Q @ F) == pytest.approx(point(name).energy(F), rel=1e-12)


@LAWS
@pytest.mark.parametrize("seed", range(3))
def test_isotropic_laws_do_not_see_a_turned_material(name, seed):
    """P(F Q) = P(F) Q."""
    if make(name).small_strain() is None or make(name).linear:
        return  # a linear law knows no large rotation, of the body or of the material
    if not make(name).frame_indifferent:
        return
    F, Q = random_F(seed), rotation(seed + 20)
    P = point(name).stress(F)
    np.testing.assert_allclose(
        point(name).stress(F @ Q), P @ Q, rtol=0, atol=1e-12 * np.abs(P).max()
    )


def test_textbook_law_turns_wrongly_by_a_known_amount():
    """A square compressed to a half and turned by 30 degrees: 37 % error in the Cauchy stress.

    With sigma = lmbda tr(E) I + 2 mu E the stress stays (-3(lmbda + 2 mu)/8, -3 lmbda/8) in the
    fixed axes, whatever the rotation.
    """
    law = make("textbook")
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    U = np.diag([0.5, 1.0, 1.0])

    def sigma(F: np.ndarray) -> np.ndarray:
        f = ufl.as_tensor(F.tolist())
        expression = expand_derivatives(cauchy_from_first(law.stress(f), f))
        return np.array(
            [
                [expression.evaluate(None, {}, (i, j), StackDict()) for j in range(3)]
                for i in range(3)
            ]
        )

    still, turned = sigma(U), sigma(R @ U)
    np.testing.assert_allclose(turned, still, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        np.diag(still), [-3 * (LMBDA + 2 * MU) / 8, -3 * LMBDA / 8, -3 * LMBDA / 8], rtol=1e-13
    )
    plane = slice(0, 2)
    error = np.linalg.norm((turned - R @ still @ R.T)[plane, plane])
    assert error / np.linalg.norm(still[plane, plane]) == pytest.approx(0.371391, abs=1e-6)


def test_textbook_law_gains_energy_over_a_closed_cycle():
    """The work of P over a square loop in (F11, F12): zero if there is an energy."""

    def loop(name: str) -> float:
        corners = np.array([[1, 0], [1.3, 0], [1.3, 0.4], [1, 0.4], [1, 0]])
        total = 0.0
        points, weights = np.polynomial.legendre.leggauss(5)
        for a, b in pairwise(corners):
            for x, w in zip(points, weights, strict=True):
                F = I.copy()
                F[0, :2] = a + (x + 1) / 2 * (b - a)
                total += w / 2 * point(name).stress(F)[0, :2] @ (b - a)
        return float(total)

    assert abs(loop("textbook")) > 1e-3 * E
    for name in ("neo-hookean", "st-venant-kirchhoff", "linear-elastic"):
        assert abs(loop(name)) < 1e-12 * E


@LAWS
def test_laws_without_scruples_warn(name):
    """A law that is wrong as soon as the body turns says so; Hooke's is small-strain by name."""
    law = make(name)
    assert bool(law.warning) == (not law.frame_indifferent and not law.linear)


@LAWS
def test_barrier_is_said_truly(name):
    """Laws with a barrier have an energy that grows without bound as J falls to zero."""
    law = make(name)
    if not law.has_energy:
        assert not law.barrier
        return
    crushed = [point(name).energy(np.diag([1.0, 1.0, J])) for J in (1e-10, 1e-20, 1e-40)]
    growing = crushed[2] - crushed[1] > crushed[1] - crushed[0] > E
    assert (growing or not np.isfinite(crushed[2])) == law.barrier
    inverted = np.diag([1.1, 0.9, -0.5])
    assert np.isfinite(point(name).energy(inverted)) != law.barrier


# --- closed forms at a point (E = 1 MPa, nu = 0.3) ---

F2 = np.array([[1.3, 0.4, 0], [-0.2, 0.9, 0], [0, 0, 1]])


def closed_form(name: str, F: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy and first Piola-Kirchhoff stress typed by hand from the literature.

    Bonet & Wood (2008): neo-Hooke (6.29)-(6.30), St. Venant-Kirchhoff (6.27)-(6.28).
    """
    J, green, eps = np.linalg.det(F), (F.T @ F - I) / 2, (F + F.T) / 2 - I
    if name == "neo-hookean":
        G = np.linalg.inv(F).T
        return (
            MU / 2 * (np.sum(F * F) - 3) - MU * np.log(J) + LMBDA / 2 * np.log(J) ** 2,
            MU * (F - G) + LMBDA * np.log(J) * G,
        )
    strain = green if name == "st-venant-kirchhoff" else eps
    S = LMBDA * np.trace(strain) * I + 2 * MU * strain
    return np.sum(S * strain) / 2, F @ S if name == "st-venant-kirchhoff" else S


@pytest.mark.parametrize("name", ["linear-elastic", "st-venant-kirchhoff", "neo-hookean"])
@pytest.mark.parametrize(
    "F",
    [
        F2,
        random_F(3),
        np.diag([0.4, 2.0, 1.0]),
        np.array([[1.2, 0.3, -0.1], [0.1, 0.9, 0.2], [-0.2, 0.1, 1.1]]),
    ],
)
def test_energy_and_stress_as_in_the_literature(name, F):
    W, P = closed_form(name, F)
    assert point(name).energy(F) == pytest.approx(W, rel=1e-13)
    np.testing.assert_allclose(point(name).stress(F), P, rtol=0, atol=1e-13 * np.abs(P).max())


@pytest.mark.parametrize(
    ("name", "W", "P"),
    [
        (
            "neo-hookean",
            6.315432002140e4,
            (3.1576732132e5, 1.1290555858e5, 4.9581136035e3, 8.0039976942e4),
        ),
        (
            "st-venant-kirchhoff",
            1.088942307692e5,
            (6.7980769231e5, 2.4615384615e5, 2.1153846154e4, 1.4519230769e5),
        ),
        (
            "fixed-corotated",
            7.160511523210e4,
            (3.8768167597e5, 1.3414045708e5, -9.1404570830e3, 1.3768167597e5),
        ),
    ],
)
def test_patch_state_numbers(name, W, P):
    """Numbers of an independent code with complex-step derivatives, printed to 11 digits."""
    assert point(name).energy(F2) == pytest.approx(W, rel=1e-12)
    np.testing.assert_allclose(point(name).stress(F2)[:2, :2].ravel(), P, rtol=2e-10)


@pytest.mark.parametrize(
    ("name", "sigma"),
    [
        ("neo-hookean", (MU, 0, 0, MU)),
        (
            "st-venant-kirchhoff",
            (1.730769230769e6, 6.730769230769e5, 2.884615384615e5, 1.057692307692e6),
        ),
        ("fixed-corotated", (5.064301642309e5, 8.120985307699e4, 0, 4.252203111539e5)),
    ],
)
def test_simple_shear(name, sigma):
    """sigma_11, 22, 33, 12 at F = I + e1 x e2: normal stresses that Hooke's law does not have."""
    F = I + np.outer([1, 0, 0], [0, 1, 0])
    cauchy = point(name).stress(F) @ F.T
    found = cauchy[0, 0], cauchy[1, 1], cauchy[2, 2], cauchy[0, 1]
    np.testing.assert_allclose(found, sigma, rtol=1e-12, atol=1e-12 * E)


def test_fixed_corotated_patch_state_in_space():
    """Numbers of an independent code, printed to 11 digits."""
    F = np.array([[1.2, 0.3, -0.1], [0.1, 0.9, 0.2], [-0.2, 0.1, 1.1]])
    P = [
        [2.1333916289e5, 1.5382426793e5, -9.3473059046e4],
        [1.2663776126e5, 1.7686574503e3, 1.1414765130e5],
        [-1.2041526342e5, 9.4158897996e4, 1.3855124035e5],
    ]
    assert point("fixed-corotated").energy(F) == pytest.approx(9.314583286970e4, rel=1e-12)
    np.testing.assert_allclose(point("fixed-corotated").stress(F), P, rtol=0, atol=2e-10 * 2e5)


@pytest.mark.parametrize("name", ["corotated", "fixed-corotated"])
def test_corotated_laws_go_through_inversion(name):
    """With signed stretches: P = U diag(dpsi/ds) V^T, smooth where J = 0."""
    law, Q, R = make(name), rotation(3), rotation(4)
    s = np.array([1.1, 0.9, -0.3])
    volume = law.lmbda * ((s.prod() - 1) * s.prod() / s if "fixed" in name else s.sum() - 3)
    P = Q @ np.diag(2 * law.mu * (s - 1) + volume) @ R
    np.testing.assert_allclose(point(name).stress(Q @ np.diag(s) @ R), P, rtol=0, atol=1e-9 * E)
    for crushed in (np.diag([1.1, 0.9, 0.0]), np.diag([1.1, 0.9, -1e-9])):
        numeric = differences(point(name).stress, crushed)
        np.testing.assert_allclose(point(name).tangent(crushed), numeric, rtol=0, atol=1e-5 * E)


# --- homogeneous states through the whole solver ---


KINDS = {"svk": StVenantKirchhoff, "nh": NeoHookean, "fcr": FixedCorotated}


@pytest.mark.parametrize(
    ("law", "stretch", "lateral", "P11"),
    [
        ("svk", 0.8, 1.052615789355, -1.440000000000e5),
        ("svk", 1.5, 0.790569415042, 9.375000000000e5),
        ("nh", 0.8, 1.067338369279, -2.400053819880e5),
        ("nh", 1.5, 0.880174591807, 3.782801763943e5),
        ("fcr", 0.8, 1.062133499295, -2.173019913748e5),
        ("fcr", 1.5, 0.869332099770, 4.428686154255e5),
    ],
)
@pytest.mark.sample(2)
def test_uniaxial(comm, law, stretch, lateral, P11):
    """Free sides; svk: P11 = E s (s^2 - 1)/2, lateral^2 = 1 - nu (s^2 - 1)."""
    held = {**ROLLERS, "right": [(stretch - 1) * SIZE[0], FREE, FREE]}
    found, reaction = homogeneous(KINDS[law](E=E, nu=NU), held, SIZE)
    # The references have 13 digits, Newton stops at round-off.
    np.testing.assert_allclose(found, [stretch, lateral, lateral], rtol=1e-11)
    assert reaction["right"][0] == pytest.approx(P11, rel=1e-10)


@pytest.mark.parametrize(
    ("law", "stretch", "lateral", "P11"),
    [
        ("svk", 1.2, 0.789212989539, 3.771428571429e5),
        ("nh", 1.2, 0.842587004051, 2.339894681426e5),
        ("nh", 1.5, 0.652018518357, 4.679158594152e5),
        ("fcr", 1.2, 0.814026299311, 2.508894123980e5),
        ("fcr", 1.5, 0.560260586319, 5.109582880700e5),
    ],
)
def test_equibiaxial(comm, law, stretch, lateral, P11):
    """Stretched in x and y; svk has no such state at 1.5."""
    held = {
        **ROLLERS,
        "right": [(stretch - 1) * SIZE[0], FREE, FREE],
        "back": [FREE, (stretch - 1) * SIZE[1], FREE],
    }
    found, reaction = homogeneous(KINDS[law](E=E, nu=NU), held, SIZE)
    np.testing.assert_allclose(found, [stretch, stretch, lateral], rtol=1e-11)
    assert reaction["right"][0] == pytest.approx(P11, rel=1e-10)


@pytest.mark.parametrize(
    ("law", "stretch", "lateral", "P11"),
    [
        ("svk", 1.5, 0.681385143869, 1.030219780220e6),
        ("svk", 0.8, 1.074376895826, -1.582417582418e5),
        ("nh", 1.5, 0.824923642240, 4.024361498652e5),
        ("nh", 0.8, 1.094876055994, -2.686315278790e5),
        ("fcr", 1.5, 0.790697674419, 4.694845446603e5),
        ("fcr", 0.8, 1.081081081081, -2.381300219138e5),
    ],
)
@pytest.mark.sample(2)
def test_plane_strain_tension(comm, law, stretch, lateral, P11):
    """A sheet that cannot get thinner: in two dimensions, with the same law."""
    held = {"left": [0, FREE], "bottom": [FREE, 0], "right": [stretch - 1, FREE]}
    found, reaction = homogeneous(KINDS[law](E=E, nu=NU), held, (1.0, 0.7))
    np.testing.assert_allclose(found, [stretch, lateral], rtol=1e-11)
    assert reaction["right"][0] == pytest.approx(P11, rel=1e-10)


def test_incompressible_limit_is_approached(comm):
    """nu = 0.4999: neo-Hookean tension comes within O(1 - 2 nu) of mu (s - 1/s^2)."""
    held = {**ROLLERS, "right": [0.5, FREE, FREE]}
    law = NeoHookean(E=3.0, nu=0.4999)
    found, reaction = homogeneous(law, held, SIZE)
    assert np.prod(found) == pytest.approx(1.0, abs=2e-4)
    assert reaction["right"][0] == pytest.approx(law.mu * (1.5 - 1 / 1.5**2), rel=5e-4)
