"""Loads whose virtual work is a Python function."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.model.describe import ALONE, Setting
from dolfin_elastic.model.loads.base import Load, LoadContext
from dolfin_elastic.model.values import Component, Parts

_STATE = frozenset("uF")
_ARGUMENTS = ("v", "u", "F", "X", "N", "t")


class OwnLoad(Load):
    """A load that is a Python function: its virtual work per reference area or volume.

    The names of the function's arguments say what it is given, in UFL: v the virtual displacement,
    u the displacement [m], F the 3x3 deformation gradient, X the reference coordinates [m], N the
    outward unit normal of the reference surface, t the time [s] or load parameter.  Of a function
    of u or F the tangent has the derivative, too.

    DOLFINx constants and functions that it uses count with the values that they have at each
    solve: a program that changes them between two states changes the load, and compiles nothing.
    On surfaces they may be functions of any space on `body.mesh`.

    Attributes:
        function: Gives a scalar [N m/m^2, N m/m^3], linear in v.
        surface: Name of a surface, or several; None: it acts on volumes.
        region: Name of a region, or several; None, without a surface: on the whole body.
        curve: Amplitude over time, also a function of t.  Without one the load grows with the load
            steps in statics and acts in full from the start in motion.

    Example:
        OwnLoad(lambda v: -1e3 * v[2], surface="right", curve="constant")
    """

    function: Callable[..., Expr]
    value: list[object] = Field(default=[])
    surface: str | list[str] | None = None
    region: str | list[str] | None = None
    kind: Literal["own"] = "own"
    conservative: ClassVar[bool] = False

    def __init__(self, function: Callable[..., Expr], **keys: object) -> None:
        super().__init__(function=function, **keys)
        self.__dict__["follower"] = bool(_STATE & {*inspect.signature(function).parameters})

    @property
    def values(self) -> tuple[Component, ...]:
        """None: its function has the values."""
        return ()

    @property
    def vectors(self) -> dict[str, tuple[Component, ...]]:
        """None, as of `values`."""
        return {}

    @property
    def parts(self) -> tuple[str, ...]:
        """See `Load.parts`."""
        names = self.region if self.surface is None else self.surface
        return () if names is None else (names,) if isinstance(names, str) else tuple(names)

    @property
    def domain(self) -> Parts:
        """See `Load.domain`."""
        return Parts("region" if self.surface is None else "surface", self.parts)

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Load.describe`."""
        return "load that is a Python function"

    def virtual_work(self, context: LoadContext) -> ufl.Form:
        """See the class."""
        names = inspect.signature(self.function).parameters
        if unknown := [name for name in names if name not in _ARGUMENTS]:
            raise InputError(
                f"the load has no argument '{unknown[0]}'", expected=nearest(unknown[0], _ARGUMENTS)
            )
        result = self.function(**{name: getattr(context, name) for name in names})
        if not isinstance(result, Expr) or result.ufl_shape:
            raise InputError(
                "the function of a load returned no scalar expression",
                expected="for example ufl.inner(f, v)",
            )
        where = context.volumes if self.surface is None else context.areas
        return context.factor(self.curve) * result * where(self.parts)
