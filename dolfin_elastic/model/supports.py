"""Supports: displacements prescribed on named parts of a body."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from pydantic import model_validator

from dolfin_elastic.errors import InputError
from dolfin_elastic.model.components import Component, components, depends_on_time
from dolfin_elastic.model.curves import CONSTANT, Amplitude, Curve
from dolfin_elastic.schema import Record


class Support(Record):
    """Displacement components prescribed on surfaces.

    Attributes:
        on: Name of a surface, or several.
        displacement: One entry a component [m]: a number, a text with a unit ("2 mm"), a formula
            in the reference coordinates x, y, z [m] and in t, or "free".  None: all components
            are held at 0.
        curve: Amplitude over time.  Without one, constant displacements grow with the load steps
            in statics and hold from the start in motion, and formulas in t are taken as they are.
        name: What results call it; the surface's name by default.
    """

    on: str | list[str]
    displacement: list[Any] | None = None
    curve: Curve | None = None
    name: str = ""

    @model_validator(mode="after")
    def _read_components(self) -> Support:
        _ = self.values  # fails now, not when it is used
        return self

    @cached_property
    def values(self) -> tuple[Component, ...]:
        """The components as numbers, formulas or None (free); none when all are held at 0."""
        if self.displacement is None:
            return ()
        return components(self.displacement, "m", may_be_free=True)

    def values_in(self, dim: int) -> tuple[Component, ...]:
        """The components in a body of 2 or 3 dimensions.

        Raises:
            InputError: There are fewer or more.
        """
        values = self.values or (0.0,) * dim
        if len(values) != dim:
            raise InputError(
                f"{len(values)} components given, the body has {dim}",
                where=f"support '{self.label}'.displacement",
            )
        return values

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Names of its surfaces."""
        return (self.on,) if isinstance(self.on, str) else tuple(self.on)

    @property
    def label(self) -> str:
        """What results call it."""
        return self.name or "+".join(self.surfaces)

    @property
    def amplitude(self) -> Amplitude | None:
        """Its curve; constant where formulas already say how it moves; None: not said."""
        timed = self.curve is None and depends_on_time(self.values)
        return CONSTANT if timed else self.curve
