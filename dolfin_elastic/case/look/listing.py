"""`Look`: bodies, CAD faces and named parts with their sizes, places and directions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.described import Described
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.geometry.curved import QuadraturePoints, cell_quadrature, facet_quadrature
from dolfin_elastic.mesh.geometry.simplices import prepare_facets
from dolfin_elastic.problem.terms.edges_points import points_of

WHOLE = "(whole body)"
_CLOSED = 1e-3
"""Length of the mean normal below which a surface has none."""


@dataclass(frozen=True)
class FaceRow:
    """A face of the CAD file, of a plane body a curve.

    Attributes:
        number: Its number, for `faces` in [surfaces].
        kind: "plane", "cylinder" ..., see `CadFace`.
        form: "hole", "shaft", "fillet", "round" or empty.
        description: Kind and numbers in words, in the file's unit.
        radius: Of a cylinder or sphere, and of a torus' tube [m].
        major: Of a torus [m].
        angle: Of a cone [degrees].
        axis: Of a cylinder, cone or torus; else empty.
        area: [m^2], in a plane body a length [m]; exact where the CAD library knows it.
        centroid: [m].
        normal: Mean outward normal; empty where they cancel.
        names: Surfaces that it belongs to.
    """

    number: int
    kind: str
    form: str
    description: str
    radius: float | None
    major: float | None
    angle: float | None
    axis: tuple[float, ...]
    area: float
    centroid: tuple[float, ...]
    normal: tuple[float, ...]
    names: tuple[str, ...]


@dataclass(frozen=True)
class PartRow:
    """A named part.

    Attributes:
        name: Its name.
        count: Cells, facets, mesh edges or nodes on all ranks.
        size: Volume, area or length [m^3, m^2, m], one dimension less in a plane body; of points
            their number.
        centroid: [m].
        normal: Mean outward normal of a surface; empty where they cancel, and of others.
        faces: CAD faces of a surface.
        use: What of the case refers to it.
    """

    name: str
    count: int
    size: float
    centroid: tuple[float, ...]
    normal: tuple[float, ...] = ()
    faces: tuple[int, ...] = ()
    use: str = ""


@dataclass(frozen=True)
class Look:
    """What `dolfin-elastic look` tells.

    Attributes:
        source: The mesh or CAD file.
        case: The case file; empty without one.
        information: How the mesh was made.
        unit: Unit of length of the file.
        metres: Its length [m].
        dim: 3, or 2 of a plane body.
        extent: Sides of the bounding box [m].
        cells: Cells on all ranks.
        faces: Of the CAD file.
        surfaces: The named surfaces.
        regions: The whole body, and the named regions.
        edges: The named edges of a solid.
        points: The named points that are no surfaces or edges.
        notes: What is doubtful, and faults of the case.
        picture: The file of the picture; empty: there is none.
        described: Supports, loads, contacts and ties of the case in words.
    """

    source: str
    case: str
    information: tuple[str, ...]
    unit: str
    metres: float
    dim: int
    extent: tuple[float, ...]
    cells: int
    faces: tuple[FaceRow, ...]
    surfaces: tuple[PartRow, ...]
    regions: tuple[PartRow, ...]
    edges: tuple[PartRow, ...]
    points: tuple[PartRow, ...]
    notes: tuple[str, ...]
    picture: str = ""
    described: tuple[Described, ...] = ()


def listing(
    body: Body, *, case: str = "", use: Callable[[str, str], str], notes: Sequence[str] = ()
) -> Look:
    """Lists a body. Collective.

    Args:
        case: The case file.
        use: Name and kind of a part to what refers to it.
    """
    prepare_facets(body.mesh)
    surfaces = tuple(
        _surface(body, name, use(name, "surface"))
        for name in sorted(body.surfaces.keys() - body.uncovered.keys())
    )
    return Look(
        source=body.source,
        case=case,
        information=body.information,
        unit=body.unit.name,
        metres=body.unit.metres,
        dim=body.dim,
        extent=extent(body),
        cells=body.num_cells,
        faces=_faces(body, {row.name: row.faces for row in surfaces}),
        surfaces=surfaces,
        regions=(
            _region(body, WHOLE, body.owned_cells(), ""),
            *(
                _region(body, name, body.owned_cells(name), use(name, "region"))
                for name in sorted(body.regions)
            ),
        ),
        edges=_lower(body, "edge", use),
        points=_lower(body, "point", use),
        notes=(*body.notes, *notes),
    )


# --- rows ---


def _surface(body: Body, name: str, use: str) -> PartRow:
    facets = body.owned_facets(name)
    points = facet_quadrature(body.mesh, facets, 2)
    size, centroid, normal = _mean(total(body.comm, _sums(points).sum(axis=0)), body.dim)
    faces: set[int] = set()
    if body.faces is not None:
        own = np.unique(body.faces.numbers_of(facets)).tolist()
        faces = {int(n) for share in body.comm.allgather(own) for n in share if n}
    return PartRow(name, body.count(name), size, centroid, normal, tuple(sorted(faces)), use)


def _region(body: Body, name: str, cells: IndexArray, use: str) -> PartRow:
    points = cell_quadrature(body.mesh, cells, 1)
    size, centroid, _ = _mean(total(body.comm, _sums(points).sum(axis=0)), body.dim)
    return PartRow(name, int(total(body.comm, len(cells))), size, centroid, use=use)


def _lower(body: Body, kind: str, use: Callable[[str, str], str]) -> tuple[PartRow, ...]:
    """Edges, or points but for sets of nodes that are surfaces or edges. Collective."""
    covered = (body.surfaces.keys() | body.edges.keys()) - body.uncovered.keys()
    names = body.edges.keys() if kind == "edge" else body.points.keys() - covered
    rows = []
    for name in sorted(names):
        points = points_of(body, kind, [name], 2)
        moments = np.einsum("ep,epj->ej", points.weights, points.X)
        own = np.concatenate([[points.weights.sum()], moments.sum(axis=0)])
        sums = np.concatenate([total(body.comm, own), np.zeros(body.dim)])
        size, centroid, _ = _mean(sums, body.dim)
        count = int(total(body.comm, len(points.cells)))
        rows.append(PartRow(name, count, size, centroid, use=use(name, kind)))
    return tuple(rows)


def _faces(body: Body, surfaces: Mapping[str, Sequence[int]]) -> tuple[FaceRow, ...]:
    """All CAD faces. Collective."""
    if body.faces is None:
        return ()
    known = sorted(body.faces.faces)
    size = body.mesh.topology.index_map(body.dim - 1).size_local
    own = body.faces.facets < size
    sums = np.zeros((len(known), 1 + 2 * body.dim))
    points = facet_quadrature(body.mesh, body.faces.facets[own], 2)
    np.add.at(sums, np.searchsorted(known, body.faces.numbers[own]), _sums(points))
    sums = total(body.comm, sums)
    rows = []
    for number, row in zip(known, sums, strict=True):
        face = body.faces.faces[number]
        area, centroid, normal = _mean(row, body.dim)
        rows.append(
            FaceRow(
                number=number,
                kind=face.kind,
                form=face.form,
                description=face.description(body.unit.name, body.unit.metres, body.dim),
                radius=face.radius,
                major=face.major,
                angle=face.angle,
                axis=face.axis if body.dim == 3 else (),
                area=area if face.area is None else face.area,
                centroid=face.centroid[: body.dim] or centroid,
                normal=normal,
                names=tuple(name for name, faces in surfaces.items() if number in faces),
            )
        )
    return tuple(rows)


def _sums(points: QuadraturePoints) -> FloatArray:
    """Integrals of 1, X and N over each entity, shape (entities, 1 + 2 dim)."""
    w, N = points.weights, points.N if points.N is not None else np.zeros_like(points.X)
    moments = [np.einsum("ep,epj->ej", w, vector) for vector in (points.X, N)]
    return np.column_stack([w.sum(axis=1), *moments])


def _mean(sums: FloatArray, dim: int) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    """Size, centroid and mean normal from the integrals of 1, X and N, shape (1 + 2 dim,)."""
    size = float(sums[0])
    if not size > 0:
        return 0.0, (), ()
    normal = sums[1 + dim :] / size
    length = float(np.linalg.norm(normal))
    unit = tuple(float(n) for n in normal / length) if length > _CLOSED else ()
    return size, tuple(float(x) for x in sums[1 : 1 + dim] / size), unit
