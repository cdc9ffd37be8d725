"""Bearing loads: the pressure of a bolt or pin on the wall of its bore."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.directions import Direction, unit_vector
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.loads.base import Load, LoadContext, LoadPoints
from dolfin_elastic.model.values import Component, checked_area, components

_TILT = 0.03
"""Mean square of the normals' part along the axis above which a surface is no cylinder."""
_TURN = 0.02
"""Mean square of the second part of normals below which a surface is flat: 14 degrees of arc."""
_ROUND = 0.93
"""Mean cosine between normals and radii of a cylinder; that of a hexagon is 0.955."""
_ALONG = 0.02
"""Part of a force along an axis found from facets that is the mesh's."""
_SINGULAR, _ITERATIONS = 1e8, 50


class Bearing(Load):
    """Force [N] of a bolt or pin on the wall of a bore, or of a hub on a shaft: a dead load.

    The pressure on the side that is pressed is p0 cos(angle from the force), and zero on the other;
    it acts along the radius, so it has no moment about the axis.  On a whole bore of radius r and
    length L, p0 = 2 F/(pi r L).  In general p = max(0, d . g) along d, the unit radius into the
    body, with the vector g for which the total over the meshed surface is the force.  In a plane
    that is the force on the whole thickness.

    Where its curve is negative, the other side is pressed.

    Attributes:
        value: One number or text with a unit a component [N]; none along the bore's axis.
        axis: x, y, z or a direction of any length; the axis of the surface by default: least
            squares of its normals.

    Example:
        Bearing(on="hole", value=["1 kN", 0, 0])

    Source: W. D. Pilkey, Peterson's Stress Concentration Factors (1997), section 5.8.
    """

    kind: Literal["bearing"] = "bearing"
    on: str | list[str]
    axis: Direction | None = None
    unit: ClassVar[str] = "N"
    along_normal: ClassVar[bool] = True
    sentence: ClassVar[str] = "bearing force of {}, half-cosine pressure on the pressed side"

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The force [N], numbers only."""
        return plain(components(self.value, self.unit), "value", "a curve for what changes")

    @cached_property
    def _axis(self) -> FloatArray | None:
        return None if self.axis is None else np.array(unit_vector(self.axis))

    @property
    def _reverses(self) -> bool:
        """Its curve may be negative."""
        curve = self.curve
        return curve is not None and (curve.is_formula or any(f < 0 for _, f in curve.table))

    def intensity(self, points: LoadPoints) -> FloatArray:
        """See `Load.intensity`; without weights but for its size."""
        assert points.N is not None
        F = np.array(self.values, dtype=np.float64)
        if points.weights is None:
            return np.asarray(np.maximum(-points.N @ F, 0.0)[..., None] * -points.N)
        bore = _Bore(points, self._axis, F)
        d = bore.directions(points.X)
        g = bore.pressures(points, F)
        return np.asarray(np.maximum(d @ g, 0.0)[..., None] * d)

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        points, area = context.surface(self.parts)
        F = np.array(self.values, dtype=np.float64)
        bore, dim = _Bore(points, self._axis, F), len(F)
        r = context.X - context.constant(bore.centre[:dim])
        if dim == 3:
            axis = context.constant(bore.axis)
            r -= ufl.inner(axis, r) * axis
        d = context.constant(bore.side) * r / ufl.sqrt(ufl.inner(r, r))

        def pressure(force: FloatArray) -> Expr:
            g = context.constant(bore.pressures(points, force))
            return ufl.max_value(ufl.inner(d, g), 0.0)

        factor = context.factor(self.amplitude)
        p = factor * pressure(F)
        if self._reverses:
            p = ufl.conditional(factor < 0, -factor * pressure(-F), p)
        return p * ufl.inner(d, context.v) * area


class _Bore:
    """A cylinder through a surface. Collective.

    Args:
        axis: As it was given, shape (3,).
        force: In whose plane across the axis it presses [N].

    Attributes:
        axis: Unit vector, shape (3,).
        centre: A point on the axis [m], shape (3,).
        side: 1 of a bore, -1 of a shaft: along the radius it points into the body.
    """

    def __init__(self, points: LoadPoints, axis: FloatArray | None, force: FloatArray) -> None:
        assert points.N is not None
        assert points.weights is not None
        if points.axisymmetric:
            raise InputError(
                "a force across the axis of a body of revolution has no sum",
                where="value",
                expected='a body in space, or kind = "pressure"',
            )
        w = points.weights.reshape(-1, 1)
        N, X = (in_space(x.reshape(-1, x.shape[-1])) for x in (points.N, points.X))
        area = checked_area(float(points.total(w.sum())))
        spread = points.total(N.T @ (w * N)) / area
        sizes, directions = np.linalg.eigh(spread)
        flat = sizes[1] < _TURN
        self.axis = directions[:, 0] if axis is None else axis
        if flat or float(self.axis @ spread @ self.axis) > _TILT:
            self._refuse("it is flat" if flat else "its normals are not across one axis")
        self.axis = self._across(force, given=axis is not None)
        # The point with the least squares of distances from the lines along the normals.
        N = N - np.outer(N @ self.axis, self.axis)
        A = area * np.eye(3) - points.total(N.T @ (w * N))
        b = points.total((w * (X - (N * X).sum(axis=1, keepdims=True) * N)).sum(axis=0))
        self.centre, self.side = np.asarray(np.linalg.solve(A, b), dtype=np.float64), 1.0
        cosine = float(points.total((w * self.directions(X) * N).sum())) / area
        if abs(cosine) < _ROUND:
            self._refuse("its normals do not meet in one axis")
        self.side = -np.sign(cosine)

    def _across(self, force: FloatArray, *, given: bool) -> FloatArray:
        """The axis, made exactly across the force where it nearly is."""
        F = in_space(force)
        size = float(np.linalg.norm(F))
        along = float(F @ self.axis)
        if abs(along) > (1e-9 if given else _ALONG) * size:
            a = (self.axis * np.sign(self.axis[np.abs(self.axis).argmax()])).round(3) + 0.0
            raise InputError(
                f"{abs(along):.4g} N of it are along the bore's axis "
                f"({', '.join(f'{x:g}' for x in a)}), where a bolt slides",
                where="value",
                expected='a force across the axis; along it kind = "force" or "traction"',
            )
        a = self.axis - along * F / size**2 if size else self.axis
        return np.asarray(a / np.linalg.norm(a))

    def _refuse(self, why: str) -> None:
        raise InputError(
            f"the surface is no cylinder: {why}",
            where="on",
            expected='one bore or shaft a load; on other surfaces kind = "force"',
        )

    def directions(self, X: FloatArray) -> FloatArray:
        """Unit radii into the body, at places and in their shape [m]."""
        r = in_space(X) - self.centre
        r -= (r @ self.axis)[..., None] * self.axis
        length = np.linalg.norm(r, axis=-1, keepdims=True)
        return np.asarray(self.side * (r / np.where(length > 0, length, 1.0))[..., : X.shape[-1]])

    def pressures(self, points: LoadPoints, force: FloatArray) -> FloatArray:
        """The vector g [Pa] for which max(0, d . g) d has the force as its total. Collective.

        Newton's method for the least of a convex function, the integral of max(0, d . g)^2/2 less
        force . g, whose second derivative is piecewise constant.

        Raises:
            InputError: No pressure on this surface sums up to the force.
        """
        assert points.weights is not None
        dim, size = len(force), float(np.linalg.norm(force))
        w = points.weights.reshape(-1, 1)
        d = self.directions(points.X).reshape(-1, dim)
        free = np.linalg.svd(self.axis[None, :dim])[2][1:] if dim == 3 else np.eye(2)
        d, target = d @ free.T, free @ force
        g = target.copy()
        for _ in range(_ITERATIONS):
            pressed = w * (d @ g > 0)[:, None]
            M = points.total(d.T @ (pressed * d))
            off = float(np.abs(M @ g - target).max(initial=0.0))
            if off <= 1e-13 * size:
                return np.asarray(free.T @ g)
            if not np.linalg.cond(M) < _SINGULAR:
                break
            g = np.linalg.solve(M, target)
        raise InputError(
            "no pressure on this surface sums up to a force in that direction",
            where="value",
            expected="a force into the wall: as much of it on one side as on the other",
        )


def in_space(x: FloatArray) -> FloatArray:
    """Vectors with three components, shape (..., 3)."""
    return np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, 3 - x.shape[-1])])


def plain(values: tuple[Component, ...], key: str, expected: str) -> tuple[Component, ...]:
    """Components that are numbers.

    Raises:
        InputError: One is a formula.
    """
    if not all(isinstance(item, float) for item in values):
        raise InputError("a formula cannot stand here", where=key, expected=expected)
    return values
