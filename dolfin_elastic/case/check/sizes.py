"""Size, centroid, normal and mass of the named parts of a body."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import load_kinds
from dolfin_elastic.case.check.integrals import Integrals
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.si_text import natural
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, spelling
from dolfin_elastic.mesh.geometry.curved import (
    PointsInCells,
    QuadraturePoints,
    cell_quadrature,
    facet_quadrature,
)
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.problem.terms.edges_points import points_of

WHOLE = "(whole body)"
Use = Callable[[str, str], str]
"""Name and kind of a part to what refers to it."""
_CLOSED = 1e-3
"""Length of the mean normal below which a surface has none."""


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
        normal: Mean outward normal of a surface; empty where they cancel, and of others.
        faces: CAD faces of a surface.
        mass: Mass [kg] of the whole thickness or circumference; None of a surface, and where a
            density is missing.
        centre_of_mass: [m]; on the axis of an axisymmetric body.
    """

    name: str
    count: int
    measure: float
    use: str
    centroid: tuple[float, ...] = ()
    normal: tuple[float, ...] = ()
    faces: tuple[int, ...] = ()
    mass: float | None = None
    centre_of_mass: tuple[float, ...] = ()


def surface_sizes(body: Body, use: Use, faces: Iterable[str] = ()) -> tuple[PartSize, ...]:
    """All named surfaces. Collective.

    Args:
        faces: Further ones without a name, see `faces_used`.
    """
    prepare_facets(body.mesh)
    sizes = []
    for name in (*sorted(body.surfaces.keys() - body.uncovered.keys(), key=natural), *faces):
        facets = body.owned_facets(name)
        measure, centroid, normal = means(body, facet_quadrature(body.mesh, facets, 2))
        numbers: set[int] = set()
        if body.faces is not None:
            own = np.unique(body.faces.numbers_of(facets)).tolist()
            numbers = {int(n) for share in body.comm.allgather(own) for n in share if n}
        result = PartSize(name, body.count(name), measure, use(name, "surface"), centroid, normal)
        sizes.append(replace(result, faces=tuple(sorted(numbers))))
    return tuple(sizes)


def lower_sizes(body: Body, kind: str, use: Use) -> tuple[PartSize, ...]:
    """All named edges, or all points but for sets of nodes that are surfaces or edges. Collective.

    Args:
        kind: "edge" or "point".
    """
    covered = (body.surfaces.keys() | body.edges.keys()) - body.uncovered.keys()
    sizes = []
    names = body.edges.keys() if kind == "edge" else body.points.keys() - covered
    for name in sorted(names, key=natural):
        points = points_of(body, kind, [name], 2)
        measure, centroid, _ = means(body, points)
        count = int(total(body.comm, len(points.cells)))
        sizes.append(PartSize(name, count, measure, use(name, kind), centroid))
    return tuple(sizes)


def region_sizes(body: Body, use: Use, integrals: Integrals | None = None) -> tuple[PartSize, ...]:
    """The whole body, then all regions that the mesh or the case names. Collective.

    Args:
        integrals: Of the problem whose densities give masses.
    """
    cells = _CellMoments(body, integrals)
    return (
        cells.size(WHOLE, body.owned_cells(), "", whole=True),
        *(
            cells.size(name, body.owned_cells(name), use(name, "region"))
            for name in sorted(body.regions, key=natural)
        ),
    )


def material_sizes(integrals: Integrals) -> tuple[PartSize, ...]:
    """The cells of each material. Collective."""
    cells = _CellMoments(integrals.body, integrals)
    return tuple(
        cells.size(part.name, part.cells, part.law.name()) for part in integrals.problem.regions
    )


def references(case: Case, body: Body, name: str, kind: str) -> str:
    """Kinds of supports, contacts and loads, and names of materials, that refer to a part.

    Args:
        name: Of the part, as the mesh has it.
        kind: "region", "surface", "edge" or "point".
    """
    users = _users(case, kind)
    return ", ".join(user for user, names in users if name in _spelled(body, names))


def faces_used(case: Case, body: Body) -> list[str]:
    """CAD faces that the case names by number or size, as "face 3" and "hole r 6", sorted."""
    names = {one for _, names in _users(case, "surface") for one in _spelled(body, names)}
    return sorted((n for n in names - {*body.surfaces} if n in body.surfaces), key=natural)


def _spelled(body: Body, names: Iterable[str]) -> list[str]:
    return [spelling(body, name) for name in names]


def _users(case: Case, kind: str) -> Iterator[tuple[str, Sequence[str]]]:
    """What refers to parts of a kind, each with their names as the case has them."""
    loads = [(load.kind, load.parts) for load in case.load if kind in load_kinds(load)]
    if kind == "region":
        yield from ((key, material.regions) for key, material in case.materials.items())
        yield from loads
        return
    for one in case.support:
        if kind in one.part_kinds:
            yield "support" if one.kind in ("displacement", "fixed") else one.kind, one.surfaces
    if kind == "surface":
        yield from (("contact", contact.surfaces) for contact in case.contact)
        yield from (("tie", (*tie.surfaces, *tie.others)) for tie in case.tie)
        yield from (("mass", mass.surfaces) for mass in case.mass)
        if case.periodic:
            yield "periodic", [name for pair in case.periodic.pairs for name in pair]
    yield from loads


class _CellMoments:
    """Zeroth and first moments of volume and mass of each owned cell."""

    def __init__(self, body: Body, integrals: Integrals | None) -> None:
        self._comm, mesh = body.comm, body.mesh
        points = integrals.cells() if integrals else cell_quadrature(mesh, body.owned_cells(), 1)
        self._volumes = _moments(points.X, points.weights)
        self._masses = np.full_like(self._volumes, np.nan)
        self._mounted: FloatArray = np.zeros((1, 1 + body.dim))
        if integrals is not None:
            mass = integrals.full_weights(points) * integrals.density(points)
            self._masses = _moments(points.X, mass)
            rows = [
                _moments(points.X, density * integrals.full_weights(points))
                for points, density in integrals.mounted()
            ]
            self._mounted = np.concatenate([self._mounted, *rows])
            if integrals.problem.geometry == "axisymmetric":
                self._masses[:, 1] = 0.0  # radial moments cancel round the axis
                self._mounted[:, 1] = 0.0

    def size(self, name: str, cells: IndexArray, use: str, *, whole: bool = False) -> PartSize:
        """Size of a set of cells. Collective.

        Args:
            cells: Local indices of the owned ones.
            whole: It is the body with all that is mounted on it.
        """
        volume = total(self._comm, self._volumes[cells].sum(axis=0))
        own = self._masses[cells].sum(axis=0) + whole * self._mounted.sum(axis=0)
        mass = total(self._comm, own)
        count = int(total(self._comm, len(cells)))
        has_mass = bool(np.isfinite(mass[0])) and count > 0
        return PartSize(
            name,
            count,
            float(volume[0]),
            use,
            _centroid(volume),
            mass=float(mass[0]) if has_mass else None,
            centre_of_mass=_centroid(mass) if has_mass else (),
        )


def means(
    body: Body, points: QuadraturePoints | PointsInCells
) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """Size, centroid [m] and mean normal of entities; empty where there is none. Collective."""
    return mean_of(total(body.comm, moments_of(points).sum(axis=0)), body.dim)


def moments_of(points: QuadraturePoints | PointsInCells) -> FloatArray:
    """Integrals of 1, X and the normal N (or 0) over each entity, shape (entities, 1 + 2 dim)."""
    N = points.N if isinstance(points, QuadraturePoints) else None
    N = np.zeros_like(points.X) if N is None else N
    return np.hstack([_moments(points.X, points.weights), _moments(N, points.weights)[:, 1:]])


def mean_of(sums: FloatArray, dim: int) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """See `means`; of the sums of `moments_of`."""
    normal = sums[1 + dim :] / sums[0] if sums[0] > 0 else np.zeros(dim)
    length = float(np.linalg.norm(normal))
    unit = tuple(float(n) for n in normal / length) if length > _CLOSED else ()
    return float(sums[0]), _centroid(sums[: 1 + dim]), unit


def _moments(X: FloatArray, weights: FloatArray) -> FloatArray:
    """Integrals of 1 and of X over each entity, shape (entities, 1 + dim)."""
    zeroth = weights.sum(axis=1)
    return np.column_stack([zeroth, np.einsum("ep,epj->ej", weights, X)])


def _centroid(sums: FloatArray) -> tuple[float, ...]:
    """First moments over the zeroth, see `_moments`; empty of nothing."""
    return tuple(float(x) for x in sums[1:] / sums[0]) if sums[0] > 0 else ()
