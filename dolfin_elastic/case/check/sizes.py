"""How large the named parts of a body are, where they lie, and what they weigh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import acts_on_surfaces
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body

WHOLE = "(whole body)"


@dataclass(frozen=True)
class PartSize:
    """How large a named part is.

    Attributes:
        name: Its name.
        count: Facets or cells on all ranks.
        measure: Area or volume [m^2, m^3], of curved cells too; length or area of a plane body
            [m, m^2].
        use: What it is there for: "support", "contact", "periodic", load's and material's names;
            empty: nothing.
        centroid: Its middle in the undeformed body [m]; empty: the part is.
        mass: Its mass [kg], of the whole thickness or circumference; None: a density is missing,
            or it is a surface.
        centre_of_mass: Where the mass is [m]; on the axis of an axisymmetric body.
    """

    name: str
    count: int
    measure: float
    use: str
    centroid: tuple[float, ...] = ()
    mass: float | None = None
    centre_of_mass: tuple[float, ...] = ()


def surface_sizes(case: Case, integrals: Integrals) -> tuple[PartSize, ...]:
    """All named surfaces. Collective."""
    body, sizes = integrals.body, []
    for name in sorted(body.surfaces):
        points = integrals.facets([name])
        sums = total(body.comm, _moments(points.X, points.weights).sum(axis=0))
        use = uses(case, name, surface=True)
        sizes.append(PartSize(name, body.count(name), float(sums[0]), use, _middle(sums)))
    return tuple(sizes)


def region_sizes(case: Case, body: Body, integrals: Integrals) -> tuple[PartSize, ...]:
    """The whole body, then all regions that the mesh or the case names. Collective."""
    cells = _Cells(integrals)
    return (
        cells.size(WHOLE, body.owned_cells(), ""),
        *(
            cells.size(name, body.owned_cells(name), uses(case, name, surface=False))
            for name in sorted(body.regions)
        ),
    )


def material_sizes(integrals: Integrals) -> tuple[PartSize, ...]:
    """What each material fills. Collective."""
    cells = _Cells(integrals)
    return tuple(
        cells.size(part.name, part.cells, part.law.name()) for part in integrals.problem.regions
    )


def uses(case: Case, name: str, *, surface: bool) -> str:
    """What a part is there for."""
    loads = [
        load.kind for load in case.load if acts_on_surfaces(load) == surface and name in load.parts
    ]
    if surface:
        held = [
            "support" if s.kind == "displacement" else s.kind
            for s in case.support
            if name in s.surfaces
        ]
        touching = ["contact" for c in case.contact if name in c.surfaces]
        pairs = case.periodic.pairs if case.periodic else ()
        paired = ["periodic"] if any(name in pair for pair in pairs) else []
        return ", ".join(held + touching + loads + paired)
    return ", ".join([key for key, m in case.materials.items() if name in m.regions] + loads)


class _Cells:
    """Volume, mass and first moments of each owned cell."""

    def __init__(self, integrals: Integrals) -> None:
        self._comm = integrals.body.comm
        points = integrals.cells()
        self._volumes = _moments(points.X, points.weights)
        mass = integrals.whole(points) * integrals.density(points)
        self._masses = _moments(points.X, mass)
        if integrals.problem.geometry == "axisymmetric":
            self._masses[:, 1] = 0.0

    def size(self, name: str, cells: IndexArray, use: str) -> PartSize:
        """One part. Collective."""
        volume = total(self._comm, self._volumes[cells].sum(axis=0))
        mass = total(self._comm, self._masses[cells].sum(axis=0))
        count = int(total(self._comm, len(cells)))
        heavy = bool(np.isfinite(mass[0])) and count > 0
        return PartSize(
            name,
            count,
            float(volume[0]),
            use,
            _middle(volume),
            float(mass[0]) if heavy else None,
            _middle(mass) if heavy else (),
        )


def _moments(X: FloatArray, weights: FloatArray) -> FloatArray:
    """Integrals of 1 and of the place over each entity, shape (entities, 1 + dim)."""
    zeroth = weights.sum(axis=1)
    return np.column_stack([zeroth, np.einsum("ep,epj->ej", weights, X)])


def _middle(sums: FloatArray) -> tuple[float, ...]:
    return tuple(float(x) for x in sums[1:] / sums[0]) if sums[0] > 0 else ()
