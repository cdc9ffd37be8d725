"""Ogden rubber."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import Scalar
from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.materials.isochoric import Isochoric
from dolfin_elastic.model.materials.spectral import (
    Shape,
    isochoric_energy,
    isochoric_stress,
    power_series,
)


class Ogden(Isochoric):
    """Ogden's rubber, in the principal stretches.

    psi = sum_p mu_p/alpha_p (l1^alpha_p + l2^alpha_p + l3^alpha_p - 3) + K/2 g(J)^2, l the
    principal stretches over J^1/3.  For rubber over its full range of stretches: three terms
    fit most tests.  At small strains mu = sum_p mu_p alpha_p / 2.  Some programs write
    2 mu_p/alpha_p^2: their mu_p are alpha_p/2 times these.

    Source: R. W. Ogden, Proc. R. Soc. A 326 (1972) 565; Bonet & Wood (2008), section 6.6.

    Attributes:
        mu: A modulus for each term [Pa].
        alpha: An exponent for each term.
    """

    law: Literal["ogden"] = "ogden"
    mu: Annotated[list[Stress], Field(min_length=1)]
    alpha: Annotated[list[Number], Field(min_length=1)]

    barrier: ClassVar[bool] = True
    example: ClassVar[Mapping[str, object]] = {
        "mu": ["0.63 MPa", "1.2 kPa", "-10 kPa"],
        "alpha": [1.3, 5.0, -2.0],
        "nu": 0.4,
    }

    def model_post_init(self, context: object) -> None:
        """Checks the lists, and fills in K or nu."""
        if len(self.mu) != len(self.alpha) or 0 in self.alpha:
            raise InputError(
                f"{len(self.mu)} moduli mu and exponents alpha = {self.alpha}",
                expected="every term needs one of each, and alpha is not 0",
            )
        super().model_post_init(context)

    def shear(self) -> float:
        """Half the sum of mu_p alpha_p."""
        return sum(mu * alpha for mu, alpha in zip(self.mu, self.alpha, strict=True)) / 2

    def destabilising(self) -> tuple[str, ...]:
        """Moduli of terms that soften, those with mu alpha < 0."""
        return tuple(
            f"mu[{p}] = {mu:.4g} Pa with alpha[{p}] = {alpha:.4g}"
            for p, (mu, alpha) in enumerate(zip(self.mu, self.alpha, strict=True))
            if isinstance(mu, int | float) and isinstance(alpha, int | float) and mu * alpha < 0
        )

    def _psi(self, shape: Shape) -> Expr:
        energy = 0
        for p in range(len(self.mu)):
            half = self.alpha[p] / 2

            def power(square: Expr, half: Scalar = half) -> Expr:
                """A principal stretch to the power of this term's exponent."""
                return square**half

            def volume(d: Expr, half: Scalar = half) -> Expr:
                """What makes the sum of these powers isochoric.

                Args:
                    d: See `Shape`.
                """
                return d ** (-half / 3)

            excess = shape.excess(power, power_series(half))
            factor = shape.of_d(volume, power_series(-half / 3))
            # (3 + excess) (1 + factor) - 3
            energy += self.mu[p] / self.alpha[p] * (excess * (1 + factor) + 3 * factor)
        return energy

    def shape_energy(self, F: Expr) -> Expr:
        """The sum over the terms."""
        return isochoric_energy(self._psi, F)

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return isochoric_stress(self._psi, F)
