"""Corotated linear elasticity."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import Isotropic, SplitLaw, once
from dolfin_elastic.model.materials.spectral import polar


class Corotated(Isotropic, SplitLaw):
    """Hooke's law between the Biot stress and the stretches: linear but for the rotation.

    psi = mu sum_i (s_i - 1)^2 + lmbda/2 (s1 + s2 + s3 - 3)^2, s the singular values of F.  For
    large rotations with strains of some per cent; it does not resist inversion.

    Source: M. Mueller and M. Gross, Graphics Interface (2004) 239; E. Sifakis and J. Barbic, FEM
    simulation of 3D deformable solids, SIGGRAPH courses (2012), section 3.4.
    """

    law: Literal["corotated"] = "corotated"

    volume_modulus: ClassVar[str] = "lmbda"

    @once
    def _polar(self, F: Expr) -> tuple[Expr, Expr]:
        return polar(F)

    def shape_energy(self, F: Expr) -> Expr:
        """mu (F:F - 2 tr U + 3)."""
        return self.mu * (ufl.inner(F, F) - 2 * self._polar(F)[1] + 3)

    def shape_stress(self, F: Expr) -> Expr:
        """2 mu (F - R)."""
        return 2 * self.mu * (F - self._polar(F)[0])

    def stress(self, F: Expr) -> Expr:
        """2 mu (F - R) + lmbda tr(U - I) R, as R is the derivative of tr U."""
        # R and U once, not once a part: equal trees of this size take long to be found equal.
        R, x = self._polar(F)
        return 2 * self.mu * (F - R) + self.lmbda * (x - 3) * R

    def volume_strain(self, F: Expr) -> Expr:
        """Trace of U - I."""
        return self._polar(F)[1] - 3

    def volume_gradient(self, F: Expr) -> Expr:
        """R, as d(tr U)/dF = R."""
        return self._polar(F)[0]
