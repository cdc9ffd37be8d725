"""`Look`: bodies, CAD faces and named parts with their sizes, places and directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.case.check.sizes import (
    PartSize,
    Use,
    lower_sizes,
    mean_of,
    moments_of,
    region_sizes,
    surface_sizes,
)
from dolfin_elastic.case.described import Described
from dolfin_elastic.core.parallel import total
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.geometry.curved import facet_quadrature


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
    surfaces: tuple[PartSize, ...]
    regions: tuple[PartSize, ...]
    edges: tuple[PartSize, ...]
    points: tuple[PartSize, ...]
    notes: tuple[str, ...]
    picture: str = ""
    described: tuple[Described, ...] = ()


def listing(body: Body, *, case: str = "", use: Use, notes: Sequence[str]) -> Look:
    """Lists a body. Collective.

    Args:
        case: The case file.
        notes: See `Look`.
    """
    surfaces = surface_sizes(body, use)
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
        regions=region_sizes(body, use),
        edges=lower_sizes(body, "edge", use),
        points=lower_sizes(body, "point", use),
        notes=tuple(notes),
    )


def _faces(body: Body, surfaces: Mapping[str, Sequence[int]]) -> tuple[FaceRow, ...]:
    """All CAD faces. Collective."""
    if body.faces is None:
        return ()
    known = sorted(body.faces.faces)
    size = body.mesh.topology.index_map(body.dim - 1).size_local
    own = body.faces.facets < size
    sums = np.zeros((len(known), 1 + 2 * body.dim))
    points = facet_quadrature(body.mesh, body.faces.facets[own], 2)
    np.add.at(sums, np.searchsorted(known, body.faces.numbers[own]), moments_of(points))
    sums = total(body.comm, sums)
    rows = []
    for number, row in zip(known, sums, strict=True):
        face = body.faces.faces[number]
        area, centroid, normal = mean_of(row, body.dim)
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
