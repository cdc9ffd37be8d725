"""Plane strain, plane stress and axisymmetry: 3x3 deformation gradients, measures, moments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import deformation_from, padded

Geometry = Literal["plane-strain", "plane-stress", "axisymmetric"]
GEOMETRIES: tuple[str, ...] = get_args(Geometry)


@dataclass(frozen=True)
class WeightedMeasure:
    """A measure of a plane mesh times thickness or circumference.

    Attributes:
        weight: Factor of every integrand; None: 1.
        measure: UFL measure of the mesh.
    """

    weight: Expr | None
    measure: ufl.Measure

    def ufl_domain(self) -> ufl.Mesh:
        """The mesh in UFL."""
        return self.measure.ufl_domain()

    def __call__(self, **kwargs: Any) -> WeightedMeasure:
        """The same with another quadrature rule, see `ufl.Measure`."""
        return WeightedMeasure(self.weight, self.measure(**kwargs))

    def __rmul__(self, integrand: Expr) -> ufl.Form:
        """The integral's form."""
        return (integrand if self.weight is None else integrand * self.weight) * self.measure


def weight(geometry: Geometry, x: Expr, thickness: Expr | None) -> Expr | None:
    """Thickness or circumference by which integrals over a plane mesh are multiplied.

    Args:
        x: Reference coordinates; x[0] is the radius of an axisymmetric body, x[1] its axis.
        thickness: Of a plane body; None: 1.
    """
    return 2 * ufl.pi * x[0] if geometry == "axisymmetric" else thickness


def full_gradient(geometry: Geometry, u: Expr, x: Expr, stretch: Expr | None) -> Expr:
    """The 3x3 deformation gradient of a displacement.

    Args:
        geometry: Kind of body, if it is two-dimensional.
        u: Displacement, 2 or 3 components.
        x: Reference coordinates.
        stretch: Displacement gradient out of the plane, F33 - 1, in plane stress.

    In an axisymmetric body F33 is current over reference circumference, 1 + u_r/r.

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 2.4 (gradient in cylindrical
    coordinates).
    """
    return deformation_from(gradient_variation(geometry, u, x, stretch))


def gradient_variation(geometry: Geometry, v: Expr, x: Expr, stretch: Expr | None) -> Expr:
    """Variation of `full_gradient`, linear in v and the virtual stretch.

    Args:
        geometry: Kind of body, if it is two-dimensional.
        v: Virtual displacement, 2 or 3 components.
        x: Reference coordinates.
        stretch: Variation of F33 in plane stress.

    Returns:
        UFL tensor of shape (3, 3).
    """
    if len(v) == 3:
        return ufl.grad(v)
    if geometry == "axisymmetric":
        return padded(ufl.grad(v), v[0] / x[0])
    return padded(ufl.grad(v), 0.0 if stretch is None else stretch)


def moment_of(arms: FloatArray, forces: FloatArray) -> FloatArray:
    """Moments of forces [N m], shape (..., 3), in a plane (..., 1).

    Args:
        arms: From the point of reference to where they act [m], shape (..., dim).
        forces: The forces [N], shape (..., dim).
    """
    if arms.shape[-1] == 2:
        return np.asarray(arms[..., :1] * forces[..., 1:] - arms[..., 1:] * forces[..., :1])
    return np.asarray(np.cross(arms, forces))
