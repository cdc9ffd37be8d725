"""Strain energies typed from the literature in extended precision, apart from the program's.

Principal stretches by eigenvalues, derivatives by central differences with 50 digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np

mp.mp.dps = 50
H1, H2 = mp.mpf("1e-16"), mp.mpf("1e-12")
"""Steps of first and second differences: both leave more than 20 digits."""

Matrix = Any


def matrix(A: np.ndarray) -> Matrix:
    return mp.matrix(A.tolist())


def inner(A: Matrix, B: Matrix) -> Any:
    return mp.fsum(A[i, j] * B[i, j] for i in range(3) for j in range(3))


def stretches(F: Matrix) -> list[Any]:
    """Principal stretches of F with a positive determinant."""
    return [mp.sqrt(value) for value in mp.eigsy(F.T * F, eigvals_only=True)]


def isochoric(F: Matrix) -> tuple[Any, Any]:
    squares = [s**2 * mp.det(F) ** (-mp.mpf(2) / 3) for s in stretches(F)]
    a, b, c = squares
    return a + b + c, a * b + b * c + c * a


def volume(law: Any, F: Matrix) -> Any:
    J = mp.det(F)
    return (
        law.K
        * {
            "simo-taylor": (J**2 - 1 - 2 * mp.log(J)) / 4,
            "quadratic": (J - 1) ** 2 / 2,
            "log": mp.log(J) ** 2 / 2,
        }[law.volumetric]
    )


def linear_elastic(law: Any, F: Matrix) -> Any:
    e = (F + F.T) / 2 - mp.eye(3)
    return law.mu * inner(e, e) + law.lmbda / 2 * (e[0, 0] + e[1, 1] + e[2, 2]) ** 2


def axes(first: list[float], towards: list[float]) -> list[Matrix]:
    a, t = (mp.matrix(v) / mp.norm(mp.matrix(v)) for v in (first, towards))
    b = t - (a.T * t)[0] * a
    b /= mp.norm(b)
    c = [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]
    return [a, b, mp.matrix(c)]


def orthotropic(law: Any, F: Matrix) -> Any:
    """Through the inverse of the 6x6 compliance."""
    e = (F + F.T) / 2 - mp.eye(3)
    A = axes(law.axis1, law.axis2)
    m = [[(A[i].T * e * A[j])[0] for j in range(3)] for i in range(3)]
    strain = [m[0][0], m[1][1], m[2][2], 2 * m[1][2], 2 * m[0][2], 2 * m[0][1]]
    S = mp.diag([1 / mp.mpf(x) for x in (law.E1, law.E2, law.E3, law.G23, law.G13, law.G12)])
    for (i, j), nu, E in (
        ((0, 1), law.nu12, law.E1),
        ((0, 2), law.nu13, law.E1),
        ((1, 2), law.nu23, law.E2),
    ):
        S[i, j] = S[j, i] = -mp.mpf(nu) / E
    stress = mp.lu_solve(S, mp.matrix(strain))
    return mp.fsum(s * e for s, e in zip(stress, strain, strict=True)) / 2


def st_venant_kirchhoff(law: Any, F: Matrix) -> Any:
    E = (F.T * F - mp.eye(3)) / 2
    return law.mu * inner(E, E) + law.lmbda / 2 * (E[0, 0] + E[1, 1] + E[2, 2]) ** 2


def corotated(law: Any, F: Matrix) -> Any:
    s = stretches(F)
    return law.mu * sum((x - 1) ** 2 for x in s) + law.lmbda / 2 * (sum(s) - 3) ** 2


def fixed_corotated(law: Any, F: Matrix) -> Any:
    s = stretches(F)
    return law.mu * sum((x - 1) ** 2 for x in s) + law.lmbda / 2 * (mp.det(F) - 1) ** 2


def hencky(law: Any, F: Matrix) -> Any:
    logs = [mp.log(x) for x in stretches(F)]
    return law.mu * sum(x**2 for x in logs) + law.lmbda / 2 * sum(logs) ** 2


def neo_hookean(law: Any, F: Matrix) -> Any:
    ln = mp.log(mp.det(F))
    return law.mu / mp.mpf(2) * (inner(F, F) - 3) - law.mu * ln + law.lmbda / 2 * ln**2


def neo_hookean_split(law: Any, F: Matrix) -> Any:
    return law.mu / mp.mpf(2) * (isochoric(F)[0] - 3) + volume(law, F)


def mooney_rivlin(law: Any, F: Matrix) -> Any:
    I1, I2 = isochoric(F)
    return law.c10 * (I1 - 3) + law.c01 * (I2 - 3) + volume(law, F)


def yeoh(law: Any, F: Matrix) -> Any:
    s = isochoric(F)[0] - 3
    return law.c10 * s + law.c20 * s**2 + law.c30 * s**3 + volume(law, F)


def ogden(law: Any, F: Matrix) -> Any:
    J = mp.det(F)
    s = [x * J ** (-mp.mpf(1) / 3) for x in stretches(F)]
    terms = (
        mp.mpf(m) / a * (sum(x ** mp.mpf(a) for x in s) - 3)
        for m, a in zip(law.mu, law.alpha, strict=True)
    )
    return mp.fsum(terms) + volume(law, F)


def arruda_boyce(law: Any, F: Matrix) -> Any:
    I1, L = isochoric(F)[0], mp.mpf(law.limit)
    return (
        law.mu
        * (
            (I1 - 3) / 2
            + (I1**2 - 9) / (20 * L**2)
            + 11 * (I1**3 - 27) / (1050 * L**4)
            + 19 * (I1**4 - 81) / (7000 * L**6)
            + 519 * (I1**5 - 243) / (673750 * L**8)
        )
    ) + volume(law, F)


def gent(law: Any, F: Matrix) -> Any:
    drawn = (isochoric(F)[0] - 3) / law.limit
    return -law.mu * law.limit / 2 * mp.log(1 - drawn) + volume(law, F)


def blatz_ko(law: Any, F: Matrix) -> Any:
    """In beta = nu/(1 - 2 nu), as the original."""
    a, b, c = (s**2 for s in stretches(F))
    beta = mp.mpf(law.lmbda) / law.mu / 2
    I2, I3 = a * b + b * c + c * a, a * b * c
    return law.mu / mp.mpf(2) * (I2 / I3 - 3 + (I3**beta - 1) / beta)


def guccione(law: Any, F: Matrix) -> Any:
    """In components of a frame along the fibre."""
    E = (mp.det(F) ** (-mp.mpf(2) / 3) * F.T * F - mp.eye(3)) / 2
    A = axes(law.fibre, [0.3, -0.2, 0.9])
    e = [[(A[i].T * E * A[j])[0] for j in range(3)] for i in range(3)]
    Q = (
        law.bf * e[0][0] ** 2
        + law.bt * (e[1][1] ** 2 + e[2][2] ** 2 + e[1][2] ** 2 + e[2][1] ** 2)
        + law.bfs * (e[0][1] ** 2 + e[1][0] ** 2 + e[0][2] ** 2 + e[2][0] ** 2)
    )
    return law.C / mp.mpf(2) * (mp.exp(Q) - 1) + volume(law, F)


def holzapfel_gasser_ogden(law: Any, F: Matrix) -> Any:
    I1 = isochoric(F)[0]
    psi = law.mu / mp.mpf(2) * (I1 - 3)
    for fibre in (law.fibre, law.fibre2):
        if fibre is None:
            continue
        f = F * mp.matrix(fibre) / mp.norm(mp.matrix(fibre))
        I4 = (f.T * f)[0] * mp.det(F) ** (-mp.mpf(2) / 3)
        e = law.kappa * I1 + (1 - 3 * mp.mpf(law.kappa)) * I4 - 1
        if e > 0 or not law.slack:
            psi += law.k1 / (2 * mp.mpf(law.k2)) * (mp.exp(law.k2 * e**2) - 1)
    return psi + volume(law, F)


ENERGIES: dict[str, Callable[[Any, Matrix], Any]] = {
    f.__name__.replace("_", "-"): f
    for f in (
        linear_elastic,
        orthotropic,
        st_venant_kirchhoff,
        corotated,
        fixed_corotated,
        hencky,
        neo_hookean,
        neo_hookean_split,
        mooney_rivlin,
        yeoh,
        ogden,
        arruda_boyce,
        gent,
        blatz_ko,
        guccione,
        holzapfel_gasser_ogden,
    )
} | {"j2": linear_elastic, "j2-logarithmic": hencky}


def energy(law: Any, F: Matrix) -> Any:
    return ENERGIES[law.name()](law, F)


def _units() -> list[tuple[int, int, Matrix]]:
    found = []
    for i in range(3):
        for j in range(3):
            D = mp.zeros(3)
            D[i, j] = 1
            found.append((i, j, D))
    return found


def stress(law: Any, F: np.ndarray) -> np.ndarray:
    """P = dpsi/dF."""
    A, P = matrix(F), np.empty((3, 3))
    for i, j, D in _units():
        P[i, j] = (energy(law, A + H1 * D) - energy(law, A - H1 * D)) / (2 * H1)
    return P


def stress_along(law: Any, F: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Derivative of P in the direction H."""
    A, W, dP = matrix(F), H2 * matrix(H), np.empty((3, 3))
    for i, j, D in _units():
        d = H2 * D
        up, down = energy(law, A + d + W), energy(law, A - d - W)
        across = energy(law, A + d - W) + energy(law, A - d + W)
        dP[i, j] = (up + down - across) / (4 * H2**2)
    return dP


def uniaxial(law: Any, s: float) -> tuple[np.ndarray, float]:
    """Stretches and P11 of a bar with free sides, drawn along x to s times its length."""

    def psi(*stretch: Any) -> Any:
        return energy(law, mp.diag(stretch))

    def sides(a: Any, b: Any) -> list[Any]:
        return [
            (psi(s, a + H1, b) - psi(s, a - H1, b)) / (2 * H1),
            (psi(s, a, b + H1) - psi(s, a, b - H1)) / (2 * H1),
        ]

    start = mp.mpf(s) ** -0.3
    a, b = mp.findroot(sides, (start, start), tol=1e-25, verify=False)
    assert max(map(abs, sides(a, b))) < 1e-9
    axial = (psi(s + H1, a, b) - psi(s - H1, a, b)) / (2 * H1)
    return np.array([s, float(a), float(b)]), float(axial)
