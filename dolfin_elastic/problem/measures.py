"""Where integrals are taken: materials, loaded regions and surfaces, each with its number.

Every set of cells or facets that is integrated over has a number of its own.  UFL would join equal
terms on several numbers into one, and DOLFINx 0.9 then takes the wrong kernel for it where a number
carries more than one quadrature degree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.compat import integration_entities
from dolfin_elastic.core.types import IndexArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.dimension import Weighted


class Measures:
    """Volume and surface measures of the reference configuration.

    Args:
        body: The mesh and its names.
        fillings: The cells of each material, in the order of their numbers from 1.
        loaded: Names of the parts of each load.
        weight: Factor of every integrand, see `model.geometry.weight`.
        contacts: Names of the surfaces of each contact, whose integrals have rules of their own.
    """

    def __init__(
        self,
        body: Body,
        fillings: Sequence[IndexArray],
        loaded: Iterable[tuple[str, ...]],
        weight: Expr | None,
        contacts: Iterable[tuple[str, ...]] = (),
    ) -> None:
        self._body, self._fillings, self._weight = body, fillings, weight
        sets = [names for names in dict.fromkeys(loaded) if names]
        regions = [names for names in sets if all(n in body.regions for n in names)]
        surfaces = [names for names in sets if all(n in body.surfaces for n in names)]
        self._regions = {names: len(fillings) + 2 + i for i, names in enumerate(regions)}
        self._surfaces = {names: 1 + i for i, names in enumerate(surfaces)}
        first = 1 + len(surfaces)
        self._contacts = {names: first + i for i, names in enumerate(dict.fromkeys(contacts))}

    @property
    def _plain(self) -> bool:
        """A single material fills the body: one unnumbered measure, for which nothing is packed."""
        return len(self._fillings) == 1 and not self._regions

    @cached_property
    def _dx(self) -> ufl.Measure:
        mesh = self._body.mesh
        if self._plain:
            return ufl.Measure("dx", domain=mesh)
        cells = [(1 + i, filling) for i, filling in enumerate(self._fillings)]
        cells.append((len(self._fillings) + 1, self._body.owned_cells()))
        cells += [
            (marker, np.unique(np.concatenate([self._body.owned_cells(n) for n in names])))
            for names, marker in self._regions.items()
        ]
        return ufl.Measure("dx", domain=mesh, subdomain_data=cells)

    @cached_property
    def _ds(self) -> ufl.Measure:
        mesh = self._body.mesh
        tdim = mesh.topology.dim
        mesh.topology.create_connectivity(tdim, tdim - 1)
        mesh.topology.create_connectivity(tdim - 1, tdim)
        sides = []
        for names, marker in (*self._surfaces.items(), *self._contacts.items()):
            facets = np.unique(np.concatenate([self._body.owned_facets(n) for n in names]))
            sides.append((marker, integration_entities(mesh, facets)))
        return ufl.Measure("ds", domain=mesh, subdomain_data=sides)

    def filled(self, marker: int | None, degree: int) -> Weighted:
        """Volume that a material fills, or the whole body, with a quadrature degree."""
        rule = {"quadrature_degree": degree}
        if self._plain:
            return Weighted(self._weight, self._dx(metadata=rule))
        number = len(self._fillings) + 1 if marker is None else marker
        return Weighted(self._weight, self._dx(number, metadata=rule))

    def regions(self, names: Sequence[str], degree: int) -> Weighted:
        """Volume of loaded regions."""
        rule = {"quadrature_degree": degree}
        return Weighted(self._weight, self._dx(self._regions[tuple(names)], metadata=rule))

    def surfaces(self, names: Sequence[str], degree: int) -> Weighted:
        """Area of loaded surfaces."""
        rule = {"quadrature_degree": degree}
        return Weighted(self._weight, self._ds(self._surfaces[tuple(names)], metadata=rule))

    def contact_area(self, names: Sequence[str], rule: Mapping[str, object]) -> Weighted:
        """Area of surfaces in contact, with a quadrature rule as UFL's metadata."""
        return Weighted(self._weight, self._ds(self._contacts[tuple(names)], metadata=dict(rule)))
