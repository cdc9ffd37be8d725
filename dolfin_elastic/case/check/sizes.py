"""Size, centroid and mass of the named parts of a body."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import load_kinds
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, spelling
from dolfin_elastic.problem.terms.edges_points import points_of

WHOLE = "(whole body)"


@dataclass(frozen=True)
class PartSize:
    """How large a named part is.

    Attributes:
        name: Its name.
        count: Cells, facets, mesh edges or nodes on all ranks.
        measure: Area or volume [m^2, m^3], of curved cells too; length or area of a plane body
            [m, m^2]; length of an edge [m]; of points their number.
        use: What refers to it: "support", "contact", "tie", "periodic", names of loads and
            materials; empty if nothing does.
        centroid: Centroid in the undeformed body [m]; empty if the part is empty.
        mass: Mass [kg] of the whole thickness or circumference; None of a surface, and where a
            density is missing.
        centre_of_mass: [m]; on the axis of an axisymmetric body.
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
    for name in sorted(body.surfaces.keys() - body.uncovered.keys()):
        points = integrals.facets([name])
        sums = total(body.comm, _moments(points.X, points.weights).sum(axis=0))
        use = references(case, body, name, "surface")
        sizes.append(PartSize(name, body.count(name), float(sums[0]), use, _centroid(sums)))
    return tuple(sizes)


def lower_sizes(case: Case, integrals: Integrals, kind: str) -> tuple[PartSize, ...]:
    """All named edges, or all points but those sets of nodes that are surfaces. Collective.

    Args:
        kind: "edge" or "point".
    """
    body, sizes = integrals.body, []
    covered = (body.surfaces.keys() | body.edges.keys()) - body.uncovered.keys()
    names = body.edges.keys() if kind == "edge" else body.points.keys() - covered
    for name in sorted(names):
        points = points_of(body, kind, [name], 2 * integrals.problem.context.order)
        sums = total(body.comm, _moments(points.X, points.weights).sum(axis=0))
        count = int(total(body.comm, len(points.cells)))
        use = references(case, body, name, kind)
        sizes.append(PartSize(name, count, float(sums[0]), use, _centroid(sums)))
    return tuple(sizes)


def region_sizes(case: Case, body: Body, integrals: Integrals) -> tuple[PartSize, ...]:
    """The whole body, then all regions that the mesh or the case names. Collective."""
    cells = _CellMoments(integrals)
    return (
        cells.size(WHOLE, body.owned_cells(), ""),
        *(
            cells.size(name, body.owned_cells(name), references(case, body, name, "region"))
            for name in sorted(body.regions)
        ),
    )


def material_sizes(integrals: Integrals) -> tuple[PartSize, ...]:
    """The cells of each material. Collective."""
    cells = _CellMoments(integrals)
    return tuple(
        cells.size(part.name, part.cells, part.law.name()) for part in integrals.problem.regions
    )


def references(case: Case, body: Body, name: str, kind: str) -> str:
    """Kinds of supports, contacts and loads, and names of materials, that refer to a part.

    Args:
        name: Of the part, as the mesh has it.
        kind: "region", "surface", "edge" or "point".
    """

    def among(names: Iterable[str]) -> bool:
        return any(spelling(body, other) == name for other in names)

    loads = [load.kind for load in case.load if kind in load_kinds(load) and among(load.parts)]
    if kind == "region":
        return ", ".join([key for key, m in case.materials.items() if among(m.regions)] + loads)
    supports = [
        "support" if s.kind == "displacement" else s.kind
        for s in case.support
        if kind in s.part_kinds and among(s.surfaces)
    ]
    if kind != "surface":
        return ", ".join(supports + loads)
    contacts = ["contact" for c in case.contact if among(c.surfaces)]
    contacts += ["tie" for tie in case.tie if among((*tie.surfaces, *tie.others))]
    pairs = case.periodic.pairs if case.periodic else ()
    periodic = ["periodic"] if any(map(among, pairs)) else []
    return ", ".join(supports + contacts + loads + periodic)


class _CellMoments:
    """Zeroth and first moments of volume and mass of each owned cell."""

    def __init__(self, integrals: Integrals) -> None:
        self._comm = integrals.body.comm
        points = integrals.cells()
        self._volumes = _moments(points.X, points.weights)
        mass = integrals.full_weights(points) * integrals.density(points)
        self._masses = _moments(points.X, mass)
        if integrals.problem.geometry == "axisymmetric":
            self._masses[:, 1] = 0.0  # radial moments cancel round the axis

    def size(self, name: str, cells: IndexArray, use: str) -> PartSize:
        """Size of a set of cells. Collective.

        Args:
            cells: Local indices of the owned ones.
        """
        volume = total(self._comm, self._volumes[cells].sum(axis=0))
        mass = total(self._comm, self._masses[cells].sum(axis=0))
        count = int(total(self._comm, len(cells)))
        has_mass = bool(np.isfinite(mass[0])) and count > 0
        return PartSize(
            name,
            count,
            float(volume[0]),
            use,
            _centroid(volume),
            float(mass[0]) if has_mass else None,
            _centroid(mass) if has_mass else (),
        )


def _moments(X: FloatArray, weights: FloatArray) -> FloatArray:
    """Integrals of 1 and of X over each entity, shape (entities, 1 + dim)."""
    zeroth = weights.sum(axis=1)
    return np.column_stack([zeroth, np.einsum("ep,epj->ej", weights, X)])


def _centroid(sums: FloatArray) -> tuple[float, ...]:
    """First moments over the zeroth, see `_moments`; empty of nothing."""
    return tuple(float(x) for x in sums[1:] / sums[0]) if sums[0] > 0 else ()
