"""Surface-based fluid cavities: enclosed volumes whose pressure is given or unknown."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.si_text import given
from dolfin_elastic.model.amplitude import Amplitude
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.loads.base import Load, LoadContext
from dolfin_elastic.model.loads.pressure import area_vector
from dolfin_elastic.model.values import Component, at_time, component

UNITS = {"pressure": "Pa", "volume": "m^3", "volume_ratio": "", "added": "m^3"}


class Cavity(Load):
    """A cavity: its pressure is given, or its volume, and then the pressure is an unknown.

    The pressure pushes on the deformed surfaces, as `Pressure` does.  The enclosed volume is
    -1/d times the integral of (x - o) . (cof F N) over the reference surfaces with the outward
    normal N of the body, o the origin, and d = 3 dimensions (2 in plane strain, for the whole
    thickness); flat walls through the origin contribute nothing, so the body may be cut at planes
    of symmetry.  Its derivative is the pressure's virtual work, and the pressure the multiplier of
    the equation volume = given volume.

    Source: divergence theorem with Nanson's formula, Holzapfel, Nonlinear Solid Mechanics (2000),
    (2.54); T. Rumpel and K. Schweizerhof, Int. J. Numer. Meth. Engng 56 (2003) 849.

    Attributes:
        on: The surfaces around it.
        pressure: A number, a text with a unit, or a formula in t.
        volume: The same; without a curve a number is reached from the initial volume as the load
            grows.
        volume_ratio: The same, over the initial volume.
        added: The same, beside the initial volume.
        origin: A point in all planes of symmetry, in the mesh's unit; zero by default.
        curve: Amplitude over time of the pressure, or of the change of volume.
        name: Its name in results; the surfaces' names by default.

    Example:
        Cavity(on="inside", added="2 ml")
    """

    kind: Literal["cavity"] = "cavity"
    on: str | list[str]
    value: Any = None
    pressure: Any = None
    volume: Any = None
    volume_ratio: Any = None
    added: Any = None
    origin: Point | None = None
    name: str = ""
    along_normal: ClassVar[bool] = True
    follower: ClassVar[bool] = True
    linearises: ClassVar[bool] = True
    conservative: ClassVar[bool] = False
    lengths: ClassVar[tuple[str, ...]] = ("origin",)

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.name or "+".join(self.parts)

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Load.describe`."""
        inside = f"{self.key.replace('_', ' ')} {given(getattr(self, self.key), UNITS[self.key])}"
        return f"closed cavity with {inside}{other_keys(self, self.key)}"

    @property
    def key(self) -> str:
        """Which of the four is given.

        Raises:
            InputError: None, or several.
        """
        if self.value is not None:
            raise InputError(
                "a cavity has no value", where="value", expected=f"one of {', '.join(UNITS)}"
            )
        given = [key for key in UNITS if getattr(self, key) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} given together" if given else "nothing is prescribed"
            raise InputError(what, expected=f"exactly one of {', '.join(UNITS)}")
        return given[0]

    @property
    def volume_controlled(self) -> bool:
        """The volume is prescribed, so the pressure is an unknown."""
        return self.key != "pressure"

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The prescribed pressure [Pa] or volume [m^3], a number or formula in t."""
        key = self.key
        with keyed(key):
            parts = component(getattr(self, key), UNITS[key])
        if isinstance(parts, Formula) and not parts.names <= {"t"}:
            raise InputError(
                "a cavity has one pressure and one volume",
                where=key,
                expected="a number, or a formula in t",
            )
        return (parts,)

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """See `Load`."""
        return {} if self.origin is None else {"origin": self.origin}

    @property
    def conservative_if_edge_fixed(self) -> bool:
        """The pressure is the same everywhere."""
        return True

    def prescribed_value(self, t: float, default: Amplitude, initial: float) -> float:
        """The pressure [Pa] or the volume [m^3] at time t.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the cavity has no curve.
            initial: Volume of the undeformed cavity [m^3].
        """
        (value,) = self.values
        number, scale = at_time(value, t), default.of(self.amplitude, t)
        if self.key == "pressure":
            return scale * number
        change = {
            "volume": number - initial,
            "volume_ratio": (number - 1.0) * initial,
            "added": number,
        }
        return initial + scale * change[self.key]

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        p = context.unknown(self.label) if self.volume_controlled else self._given(context)
        return self.work(context, p, linear=context.linear)

    def work(self, context: LoadContext, p: Expr, *, linear: bool) -> ufl.Form:
        """Virtual work of a pressure on the surfaces of the cavity.

        Args:
            p: Pressure [Pa], a UFL scalar.
        """
        return -p * ufl.inner(area_vector(context, linear), context.v) * context.areas(self.parts)

    def _given(self, context: LoadContext) -> Expr:
        return context.scalar(self.values[0], self.amplitude)

    def enclosed(self, context: LoadContext, linear: bool) -> ufl.Form:
        """Form of the enclosed volume in the current configuration [m^3].

        Raises:
            InputError: The origin does not fit the body.
        """
        dim = len(context.v)
        origin = self.origin or (0.0,) * dim
        check_components(origin, dim, "origin")
        if context.axisymmetric and origin[0] != 0.0:
            raise InputError(
                "a body of revolution has its planes of symmetry across the axis",
                where="origin[0]",
                expected="0: a point on the axis",
            )
        o = context.constant(origin)
        d = 3 if context.axisymmetric else dim
        areas = context.areas(self.parts)
        if linear:
            return -ufl.inner((context.X - o) / d + context.u, context.N) * areas
        return -ufl.inner(context.X + context.u - o, area_vector(context, False)) / d * areas
