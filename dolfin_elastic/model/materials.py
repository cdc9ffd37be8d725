"""The table of material laws.  A new law is one class in one file and one row here."""

from __future__ import annotations

from dolfin_elastic.model.law import Isotropic, Law, SplitLaw
from dolfin_elastic.model.laws.linear_elastic import LinearElastic
from dolfin_elastic.model.laws.neo_hookean import NeoHookean
from dolfin_elastic.model.laws.st_venant_kirchhoff import StVenantKirchhoff
from dolfin_elastic.model.laws.textbook import Textbook

MATERIALS: dict[str, type[Law]] = {
    kind.name(): kind for kind in (LinearElastic, StVenantKirchhoff, NeoHookean, Textbook)
}

__all__ = [
    "MATERIALS",
    "Isotropic",
    "Law",
    "LinearElastic",
    "NeoHookean",
    "SplitLaw",
    "StVenantKirchhoff",
    "Textbook",
]
