"""Isotropic solids, and their elastic constants from any two of E, nu, K, lmbda, mu.

Source: L. Malvern, Introduction to the Mechanics of a Continuous Medium, 1969, table 6.2;
Landau & Lifshitz, Theory of Elasticity, sections 4 and 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import AliasChoices, Field

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import Scalar
from dolfin_elastic.core.units import Number, SpatialValue, Stress
from dolfin_elastic.model.materials.law import Moduli, placeholder
from dolfin_elastic.model.materials.spatial import Range
from dolfin_elastic.model.materials.viscous import Viscous

NAMES = ("E", "nu", "K", "lmbda", "mu")


def _from_E_lmbda(E: Scalar, lmbda: Scalar) -> tuple[Scalar, Scalar]:
    root = (E * E + 9 * lmbda * lmbda + 2 * E * lmbda) ** 0.5
    return lmbda, (E - 3 * lmbda + root) / 4


# Each pair to (lmbda, mu).
_TO_LAME: dict[tuple[str, ...], Callable[[Scalar, Scalar], tuple[Scalar, Scalar]]] = {
    ("E", "nu"): lambda E, nu: (E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))),
    ("E", "K"): lambda E, K: (3 * K * (3 * K - E) / (9 * K - E), 3 * K * E / (9 * K - E)),
    ("E", "lmbda"): _from_E_lmbda,
    ("E", "mu"): lambda E, mu: (mu * (E - 2 * mu) / (3 * mu - E), mu),
    ("nu", "K"): lambda nu, K: (3 * K * nu / (1 + nu), 3 * K * (1 - 2 * nu) / (2 * (1 + nu))),
    ("nu", "lmbda"): lambda nu, lmbda: (lmbda, lmbda * (1 - 2 * nu) / (2 * nu)),
    ("nu", "mu"): lambda nu, mu: (2 * mu * nu / (1 - 2 * nu), mu),
    ("K", "lmbda"): lambda K, lmbda: (lmbda, 3 * (K - lmbda) / 2),
    ("K", "mu"): lambda K, mu: (K - 2 * mu / 3, mu),
    ("lmbda", "mu"): lambda lmbda, mu: (lmbda, mu),
}


def complete(**given: float) -> Moduli:
    """All constants of a stable isotropic solid from any two.

    Poisson's ratio may be 0.5, for an incompressible solid: K and lmbda are infinite then.

    Args:
        **given: Exactly two of E, nu, K, lmbda, mu (Pa; nu is a pure number).

    Returns:
        The five constants; the two given ones as they were given.

    Raises:
        InputError: Not two constants, or such as no stable compressible solid has.
    """
    names = check_given(given)
    if given.get("nu") == 0.5:
        return _incompressible(given)
    try:
        lmbda, mu = map(float, _TO_LAME[names](given[names[0]], given[names[1]]))
    except ZeroDivisionError:
        raise _unstable(given) from None
    E, nu, K = _engineering(lmbda, mu, given)
    if not (mu > 0 and K > 0 and math.isfinite(K)):
        raise _unstable(given)
    return Moduli(**{**{"E": E, "nu": nu, "K": K, "lmbda": lmbda, "mu": mu}, **given})


def _incompressible(given: dict[str, float]) -> Moduli:
    """Constants of an incompressible solid, nu = 0.5, from E or mu."""
    if "E" not in given and "mu" not in given:
        raise InputError(
            "an incompressible solid has no finite bulk modulus",
            where="nu",
            expected="give E or mu beside nu = 0.5",
        )
    mu = given.get("mu", given.get("E", 0.0) / 3)
    return Moduli(E=given.get("E", 3 * mu), nu=0.5, K=math.inf, lmbda=math.inf, mu=mu)


def check_given(given: Mapping[str, Scalar]) -> tuple[str, ...]:
    """The names of the two constants, in the order of `NAMES`.

    Raises:
        InputError: Not two constants, or a number that is impossible.
    """
    names = tuple(name for name in NAMES if name in given)
    if len(names) != 2 or len(given) != 2:
        raise InputError(
            f"two elastic constants are needed, {len(given)} given"
            + (f" ({', '.join(given)})" if given else ""),
            expected="give any two of " + ", ".join(NAMES),
        )
    _check_each({n: value for n, value in given.items() if isinstance(value, int | float)})
    return names


def is_half(nu: object) -> bool:
    """Whether Poisson's ratio is the number 0.5, or a UFL constant of that value.

    Never for arrays: they differ from rank to rank, and all ranks must take the same branch.
    """
    value = getattr(nu, "value", nu)
    return isinstance(value, float | np.ndarray) and np.ndim(value) == 0 and bool(value == 0.5)


def symbolic(given: Mapping[str, Scalar]) -> dict[str, Any]:
    """All five constants from two that are arrays or UFL expressions, without any check."""
    names = tuple(name for name in NAMES if name in given)
    if is_half(given.get("nu")):
        mu = given["mu"] if "mu" in given else given["E"] / 3
        return {**{"E": 3 * mu, "K": math.inf, "lmbda": math.inf, "mu": mu}, **given}
    lmbda, mu = _TO_LAME[names](given[names[0]], given[names[1]])
    E, nu = mu * (3 * lmbda + 2 * mu) / (lmbda + mu), lmbda / (2 * (lmbda + mu))
    return {**{"E": E, "nu": nu, "K": lmbda + 2 * mu / 3, "lmbda": lmbda, "mu": mu}, **given}


def _engineering(lmbda: float, mu: float, given: dict[str, float]) -> tuple[float, float, float]:
    if lmbda + mu == 0:
        raise _unstable(given)
    return (
        mu * (3 * lmbda + 2 * mu) / (lmbda + mu),
        lmbda / (2 * (lmbda + mu)),
        lmbda + 2 * mu / 3,
    )


def _check_each(given: dict[str, float]) -> None:
    for name in ("E", "K", "mu"):
        if name in given and not given[name] > 0:
            raise InputError(
                f"{given[name]:g} is not a possible {name}",
                where=name,
                expected=f"{name} must be positive",
            )
    if "nu" in given and not -1 < given["nu"] <= 0.5:
        raise InputError(
            f"{given['nu']:g} is not a possible Poisson's ratio",
            where="nu",
            expected="nu must lie above -1 and not above 0.5 (rubber: 0.49 to 0.5)",
        )


def _unstable(given: dict[str, float]) -> InputError:
    pair = ", ".join(f"{name} = {value:g}" for name, value in given.items())
    return InputError(
        f"no stable elastic solid has {pair}",
        expected="shear modulus mu and bulk modulus K must come out positive",
    )


class Isotropic(Viscous):
    """A law with the two constants of an isotropic solid: give any two of the five.

    Attributes:
        E: Young's modulus [Pa].
        nu: Poisson's ratio.
        K: Bulk modulus [Pa].
        lmbda: Lame's first constant [Pa].
        mu: Shear modulus [Pa].
    """

    E: Stress = Field(default_factory=placeholder)
    nu: Number = Field(default_factory=placeholder)
    K: Stress = Field(default_factory=placeholder)
    lmbda: Stress = Field(
        default_factory=placeholder, validation_alias=AliasChoices("lmbda", "lambda")
    )
    mu: Stress = Field(default_factory=placeholder)

    example: ClassVar[Mapping[str, object]] = {"E": "1 MPa", "nu": 0.3}

    def model_post_init(self, context: object) -> None:
        """Fills in the three constants that were not given."""
        given = {name: getattr(self, name) for name in NAMES if name in self.model_fields_set}
        if any(isinstance(value, SpatialValue) for value in given.values()):
            check_given(given)
            self.__dict__.update({**dict.fromkeys(NAMES), **given})
        else:
            self.__dict__.update(vars(complete(**given)))

    def small_strain(self) -> Moduli | None:
        """See `Law.small_strain`."""
        return Moduli(**{name: getattr(self, name) for name in NAMES})

    def complete(self) -> None:
        """See `Law.complete`."""
        given = {name: getattr(self, name) for name in NAMES if name in self.model_fields_set}
        self.__dict__.update(symbolic(given))

    @classmethod
    def ranges(cls) -> dict[str, Range]:
        """See `Law.ranges`."""
        stable = {name: Range(low=0.0) for name in ("E", "K", "mu")}
        return {**super().ranges(), **stable, "nu": Range(low=-1.0, high=0.5)}
