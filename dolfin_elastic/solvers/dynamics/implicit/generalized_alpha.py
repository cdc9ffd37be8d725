"""The formulas of implicit schemes for M a + f(u, v) = 0: generalized-alpha and its relatives.

One step from (u0, v0, a0) to (u1, v1, a1) over h:

    u1 = u0 + h v0 + h^2 (start a0 + beta a1)
    v1 = v0 + h ((1 - gamma) a0 + gamma a1)
    M ((1 - alpha_m) a1 + alpha_m a0) + f(u_s, v_s) = 0

with the stage u_s = (1 - alpha_f) u1 + alpha_f u0, v_s alike, at t_s = t0 + (1 - alpha_f) h, where
loads are taken, too: forces are those of the mean displacement, not the mean of two forces, so that
without damping (alpha_m = alpha_f = 1/2) angular momentum is conserved exactly.  There the stress
is that of `model.discrete_gradient`, with which the energy is conserved, too.

Sources: N. M. Newmark, J. Eng. Mech. Div. ASCE 85 (1959) 67; J. Chung & G. M. Hulbert, J. Appl.
Mech. 60 (1993) 371, (9)-(18) and (25); order of a: S. Erlicher, L. Bonaventura & O. S. Bursi,
Comput. Mech. 28 (2002) 83; stage forces: J. C. Simo & N. Tarnow, ZAMP 43 (1992) 757.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray

USUAL = 0.9
"""Spectral radius at infinite frequency if no other is asked for."""

MOST = 0.965
"""Spectral radius of Newmark's method along a constraint with which it has kept its energy over
hundreds of periods of large oscillations (gamma = 0.52); at 0.998 it has not."""


@dataclass(frozen=True)
class GeneralizedAlphaParameters:
    """Coefficients of one step, see the module.

    Attributes:
        alpha_m: Share of the old acceleration in the stage's.
        alpha_f: Share of the old displacement and velocity in the stage's.
        beta: Weight of the new acceleration in the displacement.
        gamma: Weight of the new acceleration in the velocity.
        start: Weight of the old acceleration in the displacement.
        spectral_radius: At infinite frequency, where the others follow from it.
    """

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    start: float
    spectral_radius: float | None = None

    @classmethod
    def generalized_alpha(cls, spectral_radius: float | None) -> GeneralizedAlphaParameters:
        """Of second order, with a spectral radius from 0 to 1 at infinite frequency.

        Source: Chung & Hulbert (1993), (17), (18) and (25).

        Args:
            spectral_radius: 1 keeps the energy of a linear body, 0 removes the highest frequencies
                in one step; None: `USUAL`.
        """
        radius = USUAL if spectral_radius is None else spectral_radius
        alpha_m, alpha_f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
        beta = (1 - alpha_m + alpha_f) ** 2 / 4
        return cls(alpha_m, alpha_f, beta, 0.5 - alpha_m + alpha_f, 0.5 - beta, radius)

    @classmethod
    def midpoint_rule(cls) -> GeneralizedAlphaParameters:
        """Generalized-alpha with a spectral radius of 1: forces in the middle of each step."""
        return cls.generalized_alpha(1.0)

    def without_overshoot(self) -> GeneralizedAlphaParameters:
        """The same with beta = gamma/2, for bodies whose material is damped.

        Where stiff damping does not fit the start, the first acceleration is as large as the
        square of the highest frequency.  For b v + u to follow a force at infinite frequency,
        u1 = u0 + h v0 + h^2 a0 (start - beta (1 - gamma)/gamma) as h/b goes to zero, and alike for
        larger h: bounded only if beta = gamma/2.  That is the smallest beta for which the scheme
        is stable at any step; what it damps less at high frequencies, the material damps.
        """
        return replace(self, beta=self.gamma / 2, start=0.5 - self.gamma / 2)

    @classmethod
    def newmark(cls, beta: float | None, gamma: float | None) -> GeneralizedAlphaParameters:
        """Newmark's method; beta = 1/4 and gamma = 1/2 are the trapezoidal rule.

        Args:
            beta: None: (gamma + 1/2)^2/4, which damps the highest frequencies most.
            gamma: None: 1/2, which damps nothing.
        """
        gamma = gamma or 0.5
        beta = beta or 0.25 * (gamma + 0.5) ** 2
        return cls(0.0, 0.0, beta, gamma, 0.5 - beta)

    @classmethod
    def implicit_euler(cls) -> GeneralizedAlphaParameters:
        """Backward Euler: u1 = u0 + h v1, v1 = v0 + h a1; of first order, damps strongly."""
        return cls(0.0, 0.0, 1.0, 1.0, 0.0)

    @property
    def midpoint(self) -> bool:
        """It is the implicit midpoint rule: of the accelerations, only the mean has a meaning."""
        rule = (self.alpha_m, self.alpha_f, self.beta, self.gamma)
        return rule == (0.5, 0.5, 0.25, 0.5)

    def with_pressure(self) -> GeneralizedAlphaParameters:
        """The same for bodies with a pressure as an unknown, which Newmark's method may not suit.

        Volumes are kept at the ends of steps, so the constraint determines the sum of old and new
        acceleration, and forces at the ends make a recursion of them.  With gamma = 1/2 its
        eigenvalues at infinite frequency have the product 1 and the sum 2 - 1/beta: with beta = 1/4
        -1 twice, so that accelerations and pressures grow from step to step, and with them, in
        large deformations, the energy.  The midpoint rule, which is conjugate to the trapezoidal
        rule and the same in linear problems, needs the mean acceleration and the pressure of the
        middle only: no recursion is left but that of the velocity, bounded.

        Sources: E. Hairer, C. Lubich & G. Wanner, Geometric Numerical Integration (2006), VI.8.1
        (conjugacy); M. Arnold & O. Bruels, BIT 47 (2007) 185 (the recursion).

        Raises:
            InputError: There is no such rule beside these coefficients.
        """
        if self.alpha_f != 0.0 or self.gamma == 1.0:
            return self
        if self.gamma == 0.5 and self.beta == 0.25:
            return replace(self, alpha_m=0.5, alpha_f=0.5)
        if self._radius_of_constraints() <= MOST:
            return self
        raise InputError(
            "with a pressure as an unknown, newmark is unstable at any step with "
            f"beta = {self.beta:g} and gamma = {self.gamma:g}",
            where="dynamics.gamma",
            expected="beta = 1/4 and gamma = 1/2 (the trapezoidal rule), or gamma from 0.52 on and "
            'its own beta, or scheme = "generalized-alpha"',
        )

    def _radius_of_constraints(self) -> float:
        """Spectral radius of that recursion, of velocity and acceleration along a constraint."""
        b, g = self.beta, self.gamma
        rows = [[1 - g / b, 1 - g - g * (0.5 - b) / b], [-1 / b, -(0.5 - b) / b]]
        return float(np.abs(np.linalg.eigvals(np.array(rows))).max())

    @property
    def order(self) -> int:
        """Power of the step with which the error of one step grows: 3 for second order, else 2."""
        return 3 if self.gamma <= 0.5 - self.alpha_m + self.alpha_f else 2

    @property
    def damps(self) -> bool:
        """Whether more is meant to be damped than the highest frequencies."""
        return self.order == 2 or (self.spectral_radius is not None and self.spectral_radius < 0.5)

    @property
    def can_damp_less(self) -> bool:
        """Whether a larger spectral radius would damp less."""
        return self.spectral_radius is not None and self.spectral_radius < 1.0

    @property
    def stability_limit(self) -> str:
        """Why Newmark's method with these is not stable with any step; empty where it is.

        Source: T. J. R. Hughes, The Finite Element Method (2000), section 9.1.
        """
        if self.alpha_m != 0.0 or self.alpha_f != 0.0 or 2 * self.beta >= self.gamma:
            return ""
        most = (self.gamma / 2 - self.beta) ** -0.5
        return (
            f"with beta below gamma/2 newmark is stable for omega dt up to {most:.3g} only, "
            "omega that of the stiffest motion of the mesh"
        )

    def acceleration(self, offset: FloatArray, a0: FloatArray, h: float) -> FloatArray:
        """The new acceleration a1 [m/s^2].

        Args:
            offset: u1 less what was `predicted` [m].
            a0: Old acceleration [m/s^2].
            h: Step [s].
        """
        return np.asarray(a0 + offset / (self.beta * h * h))

    def velocity(self, v0: FloatArray, a0: FloatArray, a1: FloatArray, h: float) -> FloatArray:
        """The new velocity v1 [m/s].

        Args:
            v0: Old velocity [m/s].
            a0: Old acceleration [m/s^2].
            a1: New acceleration [m/s^2].
            h: Step [s].
        """
        return np.asarray(v0 + h * ((1 - self.gamma) * a0 + self.gamma * a1))

    def predicted(self, v0: FloatArray, a0: FloatArray, h: float) -> FloatArray:
        """The predictor u1 - u0 [m], with which the acceleration does not change.

        Args:
            v0: Old velocity [m/s].
            a0: Old acceleration [m/s^2].
            h: Step [s].
        """
        return np.asarray(h * v0 + h * h * (self.start + self.beta) * a0)

    def shifts(self, h: float) -> tuple[float, float]:
        """Derivatives of the stage's velocity [1/s] and acceleration [1/s^2] by its displacement.

        Args:
            h: Step [s].
        """
        rate = 1 / (self.beta * h)
        return self.gamma * rate, (1 - self.alpha_m) / (1 - self.alpha_f) * rate / h

    def at_end(self, a0: FloatArray, a1: FloatArray) -> FloatArray:
        """The acceleration at t1 to second order [m/s^2].

        a1 belongs to the time t1 - (alpha_f - alpha_m) h: Erlicher et al. (2002), section 3.

        Args:
            a0: Old acceleration of the scheme [m/s^2].
            a1: New acceleration of the scheme [m/s^2].
        """
        return np.asarray(a1 + (self.alpha_f - self.alpha_m) * (a1 - a0))

    def error(
        self, v: tuple[FloatArray, FloatArray], a: tuple[FloatArray, FloatArray], h: float
    ) -> FloatArray:
        """Estimate of the error that a step makes in the displacement [m].

        The displacement is compared with that of a linear acceleration, which is of one order more:
        for all schemes but the implicit Euler h^2 (beta - 1/6) (a1 - a0).  Where gamma is not
        what makes the scheme one of second order, the velocity's error times h comes in.
        Source: O. C. Zienkiewicz & Y. M. Xie, Earthq. Eng. Struct. Dyn. 20 (1991) 871, (13).

        Args:
            v: v0 and v1 [m/s].
            a: a0 and a1 [m/s^2].
            h: Step [s].
        """
        first = h * h * ((self.start - 1 / 3) * a[0] + (self.beta - 1 / 6) * a[1])
        lag = self.gamma - 0.5 - self.alpha_f + self.alpha_m
        return np.asarray(first + lag * h * h * (a[1] - a[0]))
