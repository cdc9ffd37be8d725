"""Preload of bolts: the shank is shortened until it has the force that is given."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
import ufl
from pydantic import Field, model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import Direction, unit_vector
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import Amplitude, amplitude
from dolfin_elastic.model.kinematics import deformation_from
from dolfin_elastic.model.loads.base import LoadContext, ScalarLoad
from dolfin_elastic.model.loads.eigenstrain import Eigenstrain
from dolfin_elastic.model.values import Component, Parts, at_time, component


class Bolt(ScalarLoad, Eigenstrain):
    """Preload of a bolt [N]: the force in its shank, positive in tension.

    With a vector field g, the shank along its unit axis a gets a free strain, Fg = I - e a x g; its
    size e is an unknown.  Its equation: (1/L) times the integral of a . P g is the preload.

    In a region g = a, and L is its length: a z/L is a virtual displacement where the ends of the
    shank are planes across its axis, so that the force is the resultant in each section of a shank
    that is free at its sides, to the tolerance of the solver.

    On an inner surface (a pretension section) g/L is the gradient of a function that is 1 on the
    surface and 0 at all other nodes, in the elements of one side: the force is the resultant of the
    nodal forces across the section on any mesh, and the two sides overlap by e L.

    Attributes:
        on: The region of the shank, or an inner surface that cuts it.
        value: A number, a text with a unit, or a formula in t.
        axis: x, y, z or a direction along the shank.
        locked_at: Load parameter at which the preload is reached; from there on the shank keeps its
            shortening, and its force follows from the loads.  None: the force is given always.
        name: Its name in results; the regions' names by default.

    Source of the joint's stiffnesses: VDI 2230-1 (2015), section 5.1.

    Example:
        Bolt(on="shank", value="10 kN", axis="z", locked_at=0.5)
    """

    kind: Literal["bolt"] = "bolt"
    on: str | list[str]
    axis: Direction
    locked_at: float | None = Field(default=None, gt=0)
    name: str = ""
    unit: ClassVar[str] = "N"
    sentence: ClassVar[str] = "preload of {} in a bolt"
    part_kinds: ClassVar[tuple[str, ...]] = ("region", "surface")

    @model_validator(mode="after")
    def _read_lock(self) -> Bolt:
        if self.locked_at is not None:
            if self.curve is not None:
                raise InputError(
                    "curve and locked_at are given together",
                    where="locked_at",
                    expected="the preload grows in proportion up to locked_at, without a curve",
                )
            self.__dict__["curve"] = self._up_to(self.locked_at)
        return self

    @staticmethod
    def _up_to(t: float) -> Amplitude:
        return amplitude([[0.0, 0.0], [t, 1.0]])

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The force [N], a number or a formula in t."""
        with keyed("value"):
            force = component(self.value, self.unit)
            if isinstance(force, Formula) and not force.names <= {"t"}:
                raise InputError("a bolt has one preload", expected="a number, or a formula in t")
        return (force,)

    @property
    def domain(self) -> Parts:
        """See `Load`: a volume, that of a region or beside a surface."""
        return Parts("region", self.parts)

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.name or "+".join(self.parts)

    @cached_property
    def direction(self) -> FloatArray:
        """Unit vector of the axis, shape (3,)."""
        return np.array(unit_vector(self.axis))

    def force(self, t: float, default: Amplitude) -> float:
        """The preload at load parameter t [N].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the bolt has no curve.
        """
        (value,) = self.values
        return default.of(self.amplitude, t) * at_time(value, t)

    def growth(self, context: LoadContext, expansion: Expr | None, share: Expr | None) -> Expr:
        """See `Eigenstrain.growth`; the share is the field g."""
        a = ufl.as_vector([*map(float, self.direction)])
        return deformation_from(-context.unknown(self.label) * ufl.outer(a, share))
