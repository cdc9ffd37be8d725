"""Ties: surfaces of two bodies, or of two parts of one, that move together though meshed apart."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.shapes.shapes import PositiveLength
from dolfin_elastic.core.si_text import listed
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.values import OnSurfaces

EXPLICIT_TIES = "explicit schemes have a mass at each node, and tied nodes none of their own"
IMPLICIT = 'dynamics.scheme = "newmark" or "generalized-alpha"'


class Tie(OnSurfaces):
    """Surfaces whose displacement follows that of others that lie opposite.

    The displacement of `on` equals that of `to` in the mean over each node's surroundings
    (mortar method), so that a constant stress passes a flat interface whatever the two meshes are.

    Attributes:
        on: Name of a surface whose nodes are tied, or several; best the finer or the smaller side.
        to: Name of the surface that they follow, or several.
        tolerance: Largest distance between the two that is tied; a tenth of the facets' size
            there by default.  The initial gap remains.

    Example:
        Tie(on="top of the foot", to="bottom of the bar")
    """

    to: str | list[str]
    tolerance: PositiveLength | None = None
    lengths: ClassVar[tuple[str, ...]] = ("tolerance",)

    @model_validator(mode="after")
    def _two_sides(self) -> Self:
        if not self.to:
            raise InputError("no name is given", where="to", expected="a surface's name")
        if both := set(self.surfaces) & set(self.others):
            raise InputError(
                f"'{min(both)}' is tied to itself", where="to", expected="the surface opposite"
            )
        return self

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the surfaces that `on` follows."""
        return (self.to,) if isinstance(self.to, str) else tuple(self.to)

    def describe(self, setting: Setting = ALONE) -> str:
        """What its surfaces follow."""
        return f"moves with {listed(self.others)}{other_keys(self, 'to')}"

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.name or f"tie_{'+'.join(self.surfaces)}"
