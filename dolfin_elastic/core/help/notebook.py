"""`Shown`: what a notebook shows as HTML where it is the value of a cell."""

from __future__ import annotations

from importlib import import_module


class Shown:
    """Has the method that notebooks look for."""

    def _repr_html_(self) -> str | None:
        """The HTML; None: its text is shown. Not collective."""
        # By its name: what draws it stands above it, and is imported only when it is shown.
        html: str | None = import_module("dolfin_elastic.notebook.shown").html_of(self)
        return html
