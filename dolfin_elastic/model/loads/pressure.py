"""Follower pressure."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.kinematics import cofactor
from dolfin_elastic.model.loads.base import LoadContext, LoadPoints, ScalarLoad
from dolfin_elastic.model.values import PLACE, number_at


class Pressure(ScalarLoad):
    """Pressure [Pa] on the deformed surface, along its normal; positive pushes on the body.

    The virtual work is the integral of -p (cof F N) . v over the reference surface, N its outward
    normal: n da = cof F N dA.  Where all laws are linear the surface counts as undeformed (F = I),
    so that the problem stays linear.

    The skew part of the load stiffness is the integral of p (v x du) . dx along the deformed edge
    of the surface, and one of grad p over it.  So a uniform pressure has a potential where the
    surface is closed, or its edge fixed.

    Attributes:
        value: A number, a text with a unit, a formula in x, y, z [m] (undeformed) and t, or a
            field of the mesh.

    Source: Bonet & Wood (2008), (4.68) and section 8.5.2; Schweizerhof & Ramm, Computers &
    Structures 18 (1984).

    Example:
        Pressure(on="right", value="0.2 MPa")
    """

    kind: Literal["pressure"] = "pressure"
    on: str | list[str]
    unit: ClassVar[str] = "Pa"
    takes_fields: ClassVar[bool] = True
    along_normal: ClassVar[bool] = True
    follower: ClassVar[bool] = True
    linearises: ClassVar[bool] = True
    conservative: ClassVar[bool] = False

    @property
    def conservative_if_edge_fixed(self) -> bool:
        """The pressure is uniform in space, so that a fixed edge gives it a potential."""
        (p,) = self.values
        return not isinstance(p, Formula) or not p.names & PLACE

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Load.describe`."""
        follows = "" if setting.linear else ", which follows the deformed surface"
        return f"pressure of {given(self.value, self.unit)}{follows}{other_keys(self, 'value')}"

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`."""
        assert points.N is not None
        p = number_at(self.values[0], points.X, points.t, points.fields)
        return np.asarray(-p[..., None] * points.N)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        p = context.scalar(self.values[0], self.amplitude, self.domain)
        return (
            -p
            * ufl.inner(area_vector(context, context.linear), context.v)
            * context.areas(self.parts)
        )


def area_vector(context: LoadContext, linear: bool) -> Expr:
    """Current area vector over reference area, cof F N (Nanson); as many components as the body.

    Args:
        linear: The surface counts as undeformed: N.
    """
    if linear:
        return context.N
    dim = len(context.v)
    N = ufl.as_vector([context.N[i] if i < dim else 0.0 for i in range(3)])
    n = ufl.dot(cofactor(context.F), N)
    return ufl.as_vector([n[i] for i in range(dim)])
