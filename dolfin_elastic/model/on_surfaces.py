"""`OnSurfaces`: base of supports and contacts, which act on named surfaces."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record


class OnSurfaces(Record):
    """A record that acts on surfaces; supports may act on edges and points, too.

    Attributes:
        on: Name of a surface, or several.
        name: Its name in results; the surfaces' names by default.
    """

    on: str | list[str]
    name: str = ""

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not self.on:
            raise InputError("no name is given", where="on", expected="a surface's name")
        return self

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Names of its surfaces, edges and points."""
        return (self.on,) if isinstance(self.on, str) else tuple(self.on)

    @property
    def label(self) -> str:
        """Its name in results."""
        return self.name or "+".join(self.surfaces)
