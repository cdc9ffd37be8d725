"""Remote forces: a force and a moment at a point away from the surface that takes them up."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import check_count
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.loads.base import Load, LoadContext, LoadPoints
from dolfin_elastic.model.loads.bearing import in_space
from dolfin_elastic.model.supports.rigid_surface import Rigid
from dolfin_elastic.model.values import (
    Component,
    checked_area,
    component,
    components,
    number_at,
)


class RemoteForce(Load):
    """Force [N] and moment [N m] at a point away from the surface that takes them up.

    The averaging coupling is a dead load on the undeformed surface, the traction
    t = F/A + b x (X - c) with the area A, the centroid c and the vector b for which the moment
    about the centroid is M + (p - c) x F.  It leaves the surface free to deform (RBE3): statically
    equivalent to the force and the moment, whose arm is that of the undeformed body.  The rigid
    coupling (RBE2) makes the surface a rigid plate that turns with the point, by any angle: it is a
    support of kind rigid with this force and moment, and exists in statics only.

    In a plane the moment is one number about z, and both are those of the whole thickness.

    Attributes:
        point: The point p, where they act, in the mesh's unit; the centroid of the surface
            by default.
        force: One number, text with a unit, or formula in t a component; none by default.
        moment: The same, about the axes through the point.
        coupling: How the surface takes them up.
        name: What results call a rigid coupling; its surfaces by default.

    Example:
        RemoteForce(on="top", point=[0, 0, "50 mm"], force=["1 kN", 0, 0])
    """

    kind: Literal["remote-force"] = "remote-force"
    value: list[object] = Field(default=[])
    on: str | list[str]
    point: Point | None = None
    force: list[float | str] | None = None
    moment: float | str | list[float | str] | None = None
    coupling: Literal["averaging", "rigid"] = "averaging"
    name: str = ""
    lengths: ClassVar[tuple[str, ...]] = ("point",)

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """Force and moment, as many components as are given."""
        if self.value:
            raise InputError(
                "a remote force has no value", where="value", expected="force and moment"
            )
        if self.force is None and self.moment is None:
            raise InputError("nothing is given", where="force", expected="force, moment or both")
        return self.components[0] + self.components[1]

    @cached_property
    def components(self) -> tuple[tuple[Component, ...], tuple[Component, ...]]:
        """Force [N] and moment [N m], each empty where it is not given."""
        force = () if self.force is None else components(self.force, "N", key="force")
        moment: tuple[Component, ...] = ()
        if isinstance(self.moment, list | tuple) and len(self.moment) != 1:
            moment = components(self.moment, "N*m", key="moment")
        elif self.moment is not None:
            one = self.moment[0] if isinstance(self.moment, list | tuple) else self.moment
            with keyed("moment"):
                moment = (component(one, "N*m"),)
        for key, values in (("force", force), ("moment", moment)):
            if any(isinstance(item, Formula) and not item.names <= {"t"} for item in values):
                raise InputError(
                    "a force at one point is the same everywhere",
                    where=key,
                    expected="numbers, or formulas in t only",
                )
        return force, moment

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load.vectors`."""
        given = {"force": self.components[0], "point": self.point or ()}
        return {key: values for key, values in given.items() if values}

    @property
    def support(self) -> Rigid | None:
        """See `Load.support`: the rigid plate of a rigid coupling."""
        if self.coupling != "rigid":
            return None
        force, moment = self.components
        dim = 3 if 3 in (len(force), len(moment)) else 2
        return Rigid(
            on=self.on,
            name=self.name,
            point=self.point,
            force=self.force or [0.0] * dim,
            moment=self.moment or [0.0] * (2 * dim - 3),
            curve=self.curve,
        )

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Load.describe`."""
        units = {"force": "N", "moment": "N m"}
        keys = {key: unit for key, unit in units.items() if getattr(self, key) is not None}
        told = " and ".join(f"{key} {given(getattr(self, key), keys[key])}" for key in keys)
        return f"remote {told}{other_keys(self, *units)}"

    def intensity(self, points: LoadPoints) -> FloatArray | None:
        """See `Load.intensity`; None without weights."""
        if points.weights is None:
            return None
        dim, share = points.X.shape[-1], _Sharing(points, self.point)
        force, moment = (_in_space(v) for v in self.components)
        F, M = (
            np.array([number_at(f, np.zeros((1, 3)), points.t)[0] for f in vector])
            for vector in (force, moment)
        )
        about = share.inverse @ (M + np.cross(share.arm, F))
        arms = in_space(points.X) - share.centre
        return np.asarray((F / share.area + np.cross(about, arms))[..., :dim])

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        points, area = context.surface(self.parts)
        share, dim = _Sharing(points, self.point), len(context.v)
        self._check(dim)
        F, M = (self._vector(context, _in_space(values)) for values in self.components)
        about = context.constant(share.inverse) * (M + ufl.cross(context.constant(share.arm), F))
        X = ufl.as_vector([context.X[i] if i < dim else 0.0 for i in range(3)])
        t = F / context.constant(share.area) + ufl.cross(about, X - context.constant(share.centre))
        return sum(t[i] * context.v[i] for i in range(dim)) * area

    def _check(self, dim: int) -> None:
        """As many components as the body has dimensions, or rotations."""
        sizes = {"force": dim, "moment": 2 * dim - 3, "point": dim}
        given = (*self.components, self.point or ())
        for (key, size), values in zip(sizes.items(), given, strict=True):
            if values:
                check_count(values, size, key, f"{size} in a body of {dim} dimensions")

    def _vector(self, context: LoadContext, values: tuple[Component, ...]) -> Expr:
        factors = context.factors(values, self.curve)
        parts = [factor * context.value(v) for factor, v in zip(factors, values, strict=True)]
        return ufl.as_vector(parts)


def _in_space(values: tuple[Component, ...]) -> tuple[Component, ...]:
    """Three components of a force or a moment, of which one alone is about z."""
    if len(values) == 1:
        return (0.0, 0.0, *values)
    return (*values, 0.0, 0.0, 0.0)[:3]


class _Sharing:
    """How a force and a moment are shared over a surface. Collective.

    Attributes:
        area: Of the surface [m^2].
        centre: Its centroid [m], shape (3,).
        arm: From there to the point where they act [m], shape (3,).
        inverse: From the moment about the centroid to b [1/m^4], see `RemoteForce`; shape (3, 3).
    """

    def __init__(self, points: LoadPoints, at: Point | None) -> None:
        assert points.weights is not None
        if points.axisymmetric:
            raise InputError(
                "a body of revolution takes no force at a point",
                where="point",
                expected='kind = "force" along the axis, which is that of the whole ring',
            )
        w, X = points.weights.reshape(-1, 1), in_space(points.X).reshape(-1, 3)
        self.area = checked_area(float(points.total(w.sum())))
        first = points.total((w * X).sum(axis=0))
        self.centre: FloatArray = np.asarray(first / self.area, dtype=np.float64)
        r = X - self.centre
        second = points.total(r.T @ (w * r))
        self.inverse: FloatArray = np.zeros((3, 3))
        tensor = np.trace(second) * np.eye(3) - second
        turning = slice(None) if points.X.shape[-1] == 3 else slice(2, 3)
        self.inverse[turning, turning] = np.linalg.inv(tensor[turning, turning])
        place = in_space(np.array(at, dtype=np.float64)) if at else self.centre
        self.arm: FloatArray = place - self.centre
