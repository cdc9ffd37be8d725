"""Corotated linear elasticity."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import SplitLaw, once
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.spectral import Polar, polar


class Corotated(Isotropic, SplitLaw):
    """Hooke's law between the Biot stress and the stretches: linear except for the rotation.

    psi = mu sum_i (s_i - 1)^2 + lmbda/2 (s1 + s2 + s3 - 3)^2, s the singular values of F.  For
    large rotations with strains of a few per cent.  It does not resist inversion.

    Source: M. Mueller and M. Gross, Graphics Interface (2004) 239; E. Sifakis and J. Barbic, FEM
    simulation of 3D deformable solids, SIGGRAPH courses (2012), section 3.4.
    """

    law: Literal["corotated"] = "corotated"

    survives_inversion: ClassVar[bool] = True
    volume_modulus: ClassVar[str] = "lmbda"
    limited: ClassVar[bool] = True

    @once
    def _polar(self, F: Expr) -> Polar:
        return polar(F)

    def shape_energy(self, F: Expr) -> Expr:
        """mu (F - R):(F - R)."""
        stretching = self._polar(F).stretching
        return self.mu * ufl.inner(stretching, stretching)

    def shape_stress(self, F: Expr) -> Expr:
        """2 mu (F - R)."""
        return 2 * self.mu * self._polar(F).stretching

    def stress(self, F: Expr) -> Expr:
        """2 mu (F - R) + lmbda tr(U - I) R, as R is the derivative of tr U."""
        # R and U once, not once a part: equal trees of this size take long to be found equal.
        result = self._polar(F)
        return 2 * self.mu * result.stretching + self.lmbda * result.trace * result.R

    def volume_strain(self, F: Expr) -> Expr:
        """Trace of U - I."""
        return self._polar(F).trace

    def volume_gradient(self, F: Expr) -> Expr:
        """R, as d(tr U)/dF = R."""
        return self._polar(F).R

    def strain(self, F: Expr) -> Expr:
        """Biot's strain U - I."""
        result = self._polar(F)
        return result.R.T * result.stretching
