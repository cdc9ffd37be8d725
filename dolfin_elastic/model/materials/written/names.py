"""Names that a user's energy may use, and the UFL expressions behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from functools import cache

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import (
    green_strain,
    infinitesimal_strain,
    invariants,
    isochoric_invariants,
    right_cauchy_green,
)
from dolfin_elastic.model.materials.spatial import direction

_PAIRS = tuple((i, j) for i in range(3) for j in range(3))
_STRETCHES = ("lambda1", "lambda2", "lambda3")
COMPONENTS = frozenset(f"{tensor}{i + 1}{j + 1}" for tensor in "FCE" for i, j in _PAIRS)
"""F11 to F33, C11 to C33, E11 to E33."""
PLAIN = (*["J", "I1", "I2", "I3", "I1bar", "I2bar"], *_STRETCHES)
"""Scalars of every material."""
ALONG = ("I4", "I5", "I4bar")
"""Scalars along a fibre a: a.C a, a.C^2 a, J^-2/3 a.C a."""
ACROSS = ("I6", "I7", "I6bar", "I8")
"""The same along a second fibre b; and a.C b (a.b) of the two."""
TENSORS = ("F", "C", "E", "Cbar")
"""Tensors of F: Cbar = J^-2/3 C."""
SMALL = "eps"
"""The infinitesimal strain, of laws for small rotations."""
OF_TENSORS = frozenset((*TENSORS, SMALL, "I"))
"""Tensors that a formula may use, with the unit tensor."""
OF_STRAIN = frozenset(
    {name for name in COMPONENTS if name[0] != "F"}
    | {"C", "E", "I"}
    | {"I1", "I2", "I3", "I4", "I5", "I6", "I7", "I8", *_STRETCHES}
)
"""Functions of C alone, which are the same for F and its mirror image."""

ISOCHORIC = frozenset(("I1bar", "I2bar", "I4bar", "I6bar", "Cbar", "I"))
"""Functions of J^-1/3 F alone."""


def known(*, fibre: bool = False, fibre2: bool = False) -> frozenset[str]:
    """Names of the scalars that a formula may use."""
    more = (ALONG if fibre else ()) + (ACROSS if fibre and fibre2 else ())
    return COMPONENTS | {*PLAIN, *more}


def summary(*, fibre: bool, fibre2: bool) -> str:
    """The names of `known` in short, for messages."""
    text = f"F11..F33, C11..C33, E11..E33, {', '.join(PLAIN)}"
    text += f", {', '.join(ALONG)}" if fibre else ""
    return text + (f", {', '.join(ACROSS)}" if fibre and fibre2 else "")


def values(
    F: Expr,
    wanted: Collection[str],
    *,
    fibre: Sequence[float] | None = None,
    fibre2: Sequence[float] | None = None,
) -> dict[str, Expr]:
    """UFL expressions of the names in `wanted`; other names in it are left out.

    I1, I2, I3 are the invariants of C (Bonet & Wood, 6.16), I1bar = I1 J^-2/3 and I2bar = I2 J^-4/3
    (6.51), lambda1 >= lambda2 >= lambda3 the principal stretches, I4 = a.C a, I5 = a.C^2 a
    (G. Holzapfel, Nonlinear Solid Mechanics, 2000, section 6.7) and I8 = (a.C b)(a.b).

    Args:
        F: Deformation gradient, shape (3, 3).
        wanted: Names, also those of `OF_TENSORS` for whole tensors.
        fibre: Direction a, of any length.
    """
    C = right_cauchy_green(F)
    tensors: dict[str, Expr] = {"F": F, "C": C, "E": green_strain(F)}
    makers: dict[str, Callable[[], Expr]] = {
        "Cbar": lambda: ufl.det(F) ** (-2 / 3) * C,
        "I": lambda: ufl.Identity(3),
        "eps": lambda: infinitesimal_strain(F),
        "J": lambda: ufl.det(F),
        "I1": lambda: invariants(C)[0],
        "I2": lambda: invariants(C)[1],
        "I3": lambda: invariants(C)[2],
        "I1bar": lambda: isochoric_invariants(C)[0],
        "I2bar": lambda: isochoric_invariants(C)[1],
        **_fibres(F, C, fibre, fibre2),
    }
    stretches = cache(lambda: principal_stretches(F))
    result: dict[str, Expr] = {}
    for name in wanted:
        if name in tensors:
            result[name] = tensors[name]
        elif name in COMPONENTS:
            result[name] = tensors[name[0]][int(name[1]) - 1, int(name[2]) - 1]
        elif name in _STRETCHES:
            result[name] = stretches()[_STRETCHES.index(name)]
        elif name in makers:
            result[name] = makers[name]()
    return result


def _fibres(
    F: Expr, C: Expr, fibre: Sequence[float] | None, fibre2: Sequence[float] | None
) -> dict[str, Callable[[], Expr]]:
    """Names of invariants of the fibres, with functions that build their expressions."""
    if fibre is None:
        return {}
    a = direction(fibre)
    made = _along(F, C, a, ("I4", "I5", "I4bar"))
    if fibre2 is not None:
        b = direction(fibre2)
        made |= _along(F, C, b, ("I6", "I7", "I6bar"))
        made["I8"] = lambda: ufl.dot(a, C * b) * ufl.dot(a, b)
    return made


def _along(F: Expr, C: Expr, a: Expr, names: Sequence[str]) -> dict[str, Callable[[], Expr]]:
    def square() -> Expr:
        return ufl.dot(a, C * a)

    made = (
        square,
        lambda: ufl.dot(C * a, C * a),
        lambda: ufl.det(F) ** (-2 / 3) * square(),
    )
    return dict(zip(names, made, strict=True))


_SHAPE, _ROOT = 1e-13, 1e-12
"""Added to the square of the deviator and to 1 - r^2: both roots stay differentiable at 0."""


def principal_stretches(F: Expr) -> tuple[Expr, Expr, Expr]:
    """The stretches, from the largest to the smallest: square roots of the eigenvalues of F^T F.

    Eigenvalues by the trigonometric solution of the cubic, with small positive numbers added
    under both roots: at equal stretches the first and second derivatives of a symmetric function
    of them stay right to about 1e-10, where a clamped angle would be wrong by per cents.

    Source: G. Scherzinger and C. Dohrmann, Comput. Methods Appl. Mech. Engrg. 197 (2008) 4007,
    section 2, for the roots in terms of the deviator's invariants.

    Args:
        F: Deformation gradient, shape (3, 3).
    """
    C = F.T * F
    q = ufl.tr(C) / 3
    dev = C - q * ufl.Identity(3)
    p = 2 * ufl.sqrt((ufl.inner(dev, dev) / 2 + _SHAPE * q**2) / 3)
    r = 4 * ufl.det(dev) / p**3
    angle = ufl.atan2(ufl.sqrt(1 - r**2 + _ROOT), r) / 3
    first, last, middle = (ufl.sqrt(q + p * ufl.cos(angle + 2 * math.pi / 3 * k)) for k in range(3))
    return first, middle, last
