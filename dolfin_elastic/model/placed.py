"""`Placed`: what acts on named surfaces, and what results call it."""

from __future__ import annotations

from dolfin_elastic.schema import Record


class Placed(Record):
    """Something on surfaces.

    Attributes:
        on: Name of a surface, or several.
        name: What results call it; the surfaces' names by default.
    """

    on: str | list[str]
    name: str = ""

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Names of its surfaces."""
        return (self.on,) if isinstance(self.on, str) else tuple(self.on)

    @property
    def label(self) -> str:
        """What results call it."""
        return self.name or "+".join(self.surfaces)
