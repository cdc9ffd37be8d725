"""The order of the stress where two materials and a surface, or two corners, meet.

Near the edge of two wedges the stress is a sum of terms r^(lambda - 1) f(theta).  With Kolosov's
functions phi = a z^lambda and psi = b z^lambda in each wedge, z = r exp(i theta), the displacement
and the stress on a ray are linear in the real and imaginary parts of a and b.  The exponents lambda
are the zeros of the determinant of the conditions on the faces and at the interface; zeros with a
real part below 1 make the stress unbounded.  They are counted by the argument principle, so that
none is missed where some are complex.

Sources: N. I. Muskhelishvili, Some Basic Problems of the Mathematical Theory of Elasticity (1953),
sections 32 and 39; D. B. Bogy, J. Appl. Mech. 38 (1971) 377.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from dolfin_elastic.core.types import ComplexArray

Face = Literal["free", "held", "roller"]

_LEAST, _MOST, _HIGH = 0.0231, 0.9787, 2.0
"""Part of the plane in which exponents are looked for: translations have 0, rotations 1.  Its
sides, halved again and again, miss the fractions that are exponents of simple wedges."""
_POINTS = 400
_STEPS = 9
_ROWS: dict[Face, tuple[int, int]] = {"free": (2, 3), "held": (0, 1), "roller": (1, 3)}


@dataclass(frozen=True)
class Wedge:
    """One of the materials.

    Attributes:
        angle: Between its faces [rad].
        mu: Shear modulus [Pa].
        kappa: 3 - 4 nu in plane strain, (3 - nu)/(1 + nu) in plane stress.
    """

    angle: float
    mu: float
    kappa: float


@lru_cache(maxsize=4096)
def stress_exponent(first: Wedge, second: Wedge, face: Face | None = "free") -> float:
    """The smallest real part of lambda, to 2e-3; 1 where none is below 0.97. Not collective.

    Args:
        face: Both outer faces: free, held, or held along their normal; None: they are bonded, too,
            and both wedges fill the plane.
    """

    def zeros(most: float) -> int:
        return _zeros(first, second, face, most)

    if not zeros(_MOST):
        return 1.0
    low, high = _LEAST, _MOST
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (low, middle) if zeros(middle) else (middle, high)
    return (low + high) / 2


def _zeros(first: Wedge, second: Wedge, face: Face | None, most: float) -> int:
    """Zeros with a real part from `_LEAST` to `most`.

    Args:
        face: See `stress_exponent`.
    """
    corners = np.array([_LEAST - 1j * _HIGH, most - 1j * _HIGH, most + 1j * _HIGH])
    corners = np.append(corners, [_LEAST + 1j * _HIGH, corners[0]])
    share = np.linspace(0, 1, _POINTS, endpoint=False)[:, None]
    path = (corners[:-1] + share * np.diff(corners)).T.reshape(-1)
    values = np.linalg.det(_conditions(first, second, face, np.append(path, path[0])))
    turns = np.angle(values[1:] / values[:-1]).sum() / (2 * np.pi)
    return round(float(turns))


def _conditions(
    first: Wedge, second: Wedge, face: Face | None, power: ComplexArray
) -> ComplexArray:
    """Matrix of the conditions, shape (n, 8, 8).

    Args:
        first: A wedge, from the angle 0 on.
        face: See `stress_exponent`.
        power: lambda, shape (n,).
    """
    end = first.angle + second.angle
    result = np.zeros((len(power), 8, 8), dtype=np.complex128)
    scale = first.mu
    result[:, 2:6, :4] = _on_ray(first, first.angle, power, scale)
    result[:, 2:6, 4:] = -_on_ray(second, first.angle, power, scale)
    begin, last = _on_ray(first, 0.0, power, scale), _on_ray(second, end, power, scale)
    if face is None:
        result[:, (0, 1, 6, 7), :4], result[:, (0, 1, 6, 7), 4:] = begin, -last
    else:
        rows = list(_ROWS[face])
        result[:, :2, :4], result[:, 6:, 4:] = begin[:, rows], last[:, rows]
    return result


def _on_ray(wedge: Wedge, angle: float, power: ComplexArray, scale: float) -> ComplexArray:
    """u_r, u_theta, sigma_tt and sigma_rt of Re a, Im a, Re b and Im b at r = 1.

    From 2 mu (u_r + i u_t) = exp(-i theta) (kappa phi - z conj(phi') - conj(psi)) and
    sigma_tt + i sigma_rt = 2 Re phi' + exp(2 i theta) (conj(z) phi'' + psi'), the latter over
    lambda.

    Args:
        angle: Of the ray [rad].
        power: lambda, shape (n,).
        scale: Shear modulus that displacements are multiplied with [Pa].

    Returns:
        Shape (n, 4, 4).
    """
    c, s = np.cos((power - 1) * angle), np.sin((power - 1) * angle)
    C, S = np.cos((power + 1) * angle), np.sin((power + 1) * angle)
    k, soft = wedge.kappa, scale / wedge.mu
    rows = [
        [soft * (k - power) * c, -soft * (k - power) * s, -soft * C, soft * S],
        [soft * (k + power) * s, soft * (k + power) * c, soft * S, soft * C],
        [(power + 1) * c, -(power + 1) * s, C, -S],
        [(power - 1) * s, (power - 1) * c, S, C],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
