"""Rigid surfaces: all nodes of a surface move as one rigid body with a few degrees of freedom."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal

from pydantic import model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import check_count
from dolfin_elastic.core.shapes.shapes import Point
from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.units import is_quantity
from dolfin_elastic.model.amplitude import Amplitude, Curve
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.supports.displacement import Restraint
from dolfin_elastic.model.values import (
    FREE,
    Component,
    amplitude_of,
    at_time,
    component,
    components,
    misspelt_unit,
)

ANGLE, MOMENT = "rad", "N*m"


class Rigid(Restraint):
    """A rigid plate on a surface: u = d + (R(theta) - I)(X - c), with any angle.

    R = I + sin(a)/a K + (1 - cos(a))/a^2 K^2 with a = |theta| and K the cross product with theta.
    Source: O. Rodrigues, J. Math. Pures Appl. 5 (1840) 380; Bonet & Wood (2008), (2.70).

    Each component of d and theta is prescribed or free; on the free ones the given force or moment
    acts.  A moment does work on the rotation vector theta: where theta turns about one axis only
    it is the moment about that axis.

    Attributes:
        point: The reference point c, in the mesh's unit; the middle of the surface by default.
        displacement: One entry a component of d [m]: a number, a text with a unit, a formula in t,
            or "free".  By default free where a force is given, else 0.
        rotation: The same for the rotation vector theta [rad]; in a plane one entry, about z.
        force: One entry a component [N]; where the displacement is free.
        moment: One entry a component of theta [N m]; where the rotation is free.
        curve: Amplitude over time of all that is prescribed and given.

    Example:
        Rigid(on="right", moment=[0, "100 N*m", 0])
    """

    kind: Literal["rigid"] = "rigid"
    point: Point | None = None
    displacement: list[Any] | None = None
    rotation: Any = None
    force: list[Any] | None = None
    moment: Any = None
    curve: Curve | None = None

    part_kinds: ClassVar[tuple[str, ...]] = ("surface",)
    lengths: ClassVar[tuple[str, ...]] = ("point",)
    angles: ClassVar[Mapping[str, str]] = {"rotation": "rad"}

    @model_validator(mode="after")
    def _read(self) -> Rigid:
        for key in ("displacement", "rotation"):
            self._check_pair(key, {"displacement": "force", "rotation": "moment"}[key])
        return self

    def _check_pair(self, moved: str, forced: str) -> None:
        """Forces act on free components only."""
        motion, action = self._parsed[moved], self._parsed[forced]
        if motion and action and len(motion) != len(action):
            raise InputError(
                f"{len(action)} components, but {moved} has {len(motion)}",
                where=forced,
                expected=f"{len(motion)} components",
            )
        for i, (value, applied) in enumerate(zip(motion, action, strict=False)):
            if value is not None and applied != 0.0:
                raise InputError(
                    f"this component of the {moved} is prescribed",
                    where=f"{forced}[{i}]",
                    expected=f'0 here, or "{FREE}" in {moved}[{i}]',
                )

    def describe(self, setting: Setting = ALONE) -> str:
        """See `Restraint`."""
        units = {"displacement": "m", "rotation": ANGLE, "force": "N", "moment": "N m"}
        keys = {key: value for key in units if (value := getattr(self, key)) is not None}
        told = ", ".join(f"{key} {given(value, units[key])}" for key, value in keys.items())
        return f"moves as a rigid plate{f': {told}' if told else ', which is fixed'}" + other_keys(
            self, *units
        )

    @cached_property
    def _parsed(self) -> dict[str, tuple[Component, ...]]:
        rotation, moment = (
            [v] if v is not None and not isinstance(v, list | tuple) else v
            for v in (self.rotation, self.moment)
        )
        return {
            "displacement": self._components("displacement", self.displacement, "m", free=True),
            "rotation": self._components("rotation", rotation, ANGLE, free=True),
            "force": self._components("force", self.force, "N", free=False),
            "moment": self._components("moment", moment, MOMENT, free=False),
        }

    def _components(
        self, key: str, written: object, unit: str, *, free: bool
    ) -> tuple[Component, ...]:
        """Numbers, formulas in t, or None for free components; empty if the key is not given."""
        if written is None:
            return ()
        result: tuple[Component, ...]
        try:
            if isinstance(written, list | tuple) and len(written) == 1:
                result = (_single(written[0], unit, free),)
            else:
                result = components(written, unit, may_be_free=free)
        except InputError as error:
            raise error.at(key) from None
        if any(isinstance(item, Formula) and not item.names <= {"t"} for item in result):
            raise InputError(
                "a rigid motion is the same at all points",
                where=key,
                expected="numbers or formulas in t",
            )
        return result

    @property
    def vectors(self) -> Mapping[str, tuple[Component, ...]]:
        """See `Restraint`."""
        given = {"point": self.point or (), **self._parsed}
        return {key: given[key] for key in ("point", "displacement", "force") if given[key]}

    @property
    def time_functions(self) -> tuple[tuple[Component, ...], ...]:
        """See `Restraint`."""
        return tuple(self._parsed.values())

    @property
    def rotation_components(self) -> tuple[Component, ...]:
        """The rotation vector's components [rad], None where free; empty if it is not given."""
        return self._parsed["rotation"]

    @property
    def at_rest(self) -> bool:
        """See `Restraint`."""
        return all(value in (None, 0.0) for values in self._parsed.values() for value in values)

    def motion(self, dim: int) -> tuple[Component, ...]:
        """Displacement and rotation in a body of 2 or 3 dimensions; None where free.

        Raises:
            InputError: There are fewer or more components.
        """
        return self._joined("displacement", "force", dim) + self._joined(
            "rotation", "moment", 2 * dim - 3
        )

    def _joined(self, key: str, action: str, size: int) -> tuple[Component, ...]:
        free_if_forced: Component = None if self._parsed[action] else 0.0
        return self._sized(key, size) or (free_if_forced,) * size

    def action(self, dim: int) -> tuple[Component, ...]:
        """Force and moment in a body of 2 or 3 dimensions."""
        size = 2 * dim - 3
        return (self._sized("force", dim) or (0.0,) * dim) + (
            self._sized("moment", size) or (0.0,) * size
        )

    def _sized(self, key: str, size: int) -> tuple[Component, ...]:
        values = self._parsed[key]
        if values:
            check_count(values, size, f"support '{self.label}'.{key}")
        return values

    def at_time(
        self, values: tuple[Component, ...], t: float, default: Amplitude
    ) -> tuple[float, ...]:
        """Components at a time, with their amplitudes.

        Args:
            values: Components, from `motion` or `action`.
            t: Time [s], or load parameter.
            default: Amplitude where the support has no curve.

        Returns:
            One number a component, 0 for free ones.
        """
        return tuple(default.of(amplitude_of(v, self.curve), t) * at_time(v, t) for v in values)


def _single(written: object, unit: str, free: bool) -> Component:
    if (
        isinstance(written, str)
        and written != FREE
        and not is_quantity(written)
        and not misspelt_unit(written, ("t",))
    ):
        return Formula.parse(written, allowed=("t",))
    return component(written, unit, may_be_free=free)
