"""Sizes of a body and its parts, and quality of its cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.parallel import largest, smallest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.mesh.criteria import bounding_box
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import (
    boundary_facets,
    cell_corners,
    longest_edges,
    prepare_facets,
    qualities,
)


@dataclass(frozen=True)
class CellQuality:
    """Quality and place of one cell.

    Attributes:
        quality: 1 for a regular simplex, 0 for a flat one.
        middle: Its midpoint in metres.
        volume: Its volume (area in 2D).
    """

    quality: float
    middle: tuple[float, ...]
    volume: float


@dataclass(frozen=True)
class MeshStatistics:
    """Sizes in metres and shapes of cells, the same on all ranks.

    Attributes:
        cells: Number of cells.
        points: Number of geometry nodes.
        low: Smallest coordinates.
        high: Largest coordinates.
        volume: Volume of the body (area in 2D).
        boundary: Area of its boundary (length in 2D).
        regions: Volume of each region.
        surfaces: Area of each surface.
        shortest: Smallest longest-edge of a cell.
        longest: Longest edge of all.
        quality_min: Quality of the worst cell.
        quality_mean: Mean quality.
        worst: The worst cells, the worst first.
    """

    cells: int
    points: int
    low: tuple[float, ...]
    high: tuple[float, ...]
    volume: float
    boundary: float
    regions: dict[str, float]
    surfaces: dict[str, float]
    shortest: float
    longest: float
    quality_min: float
    quality_mean: float
    worst: tuple[CellQuality, ...]


def mesh_statistics(body: Body, *, worst: int = 5) -> MeshStatistics:
    """Sizes of a body and shapes of its cells. Collective.

    Args:
        worst: How many of the worst cells to name.
    """
    mesh, comm = body.mesh, body.comm
    prepare_facets(mesh)
    owned = body.owned_cells()
    corners, volumes = cell_corners(mesh, owned), cell_volumes(mesh)
    shape, edges = qualities(corners), longest_edges(corners)
    low, high = bounding_box(mesh)
    regions = {n: total(comm, float(volumes[body.owned_cells(n)].sum())) for n in body.regions}
    surfaces = {
        n: total(comm, float(facet_areas(mesh, body.owned_facets(n)).sum())) for n in body.surfaces
    }
    return MeshStatistics(
        cells=body.num_cells,
        points=int(mesh.geometry.index_map().size_global),
        low=tuple(map(float, low)),
        high=tuple(map(float, high)),
        volume=total(comm, float(volumes[owned].sum())),
        boundary=total(comm, float(facet_areas(mesh, boundary_facets(mesh)).sum())),
        regions=regions,
        surfaces=surfaces,
        shortest=smallest(comm, float(edges.min(initial=np.inf))),
        longest=largest(comm, float(edges.max(initial=0))),
        quality_min=smallest(comm, float(shape.min(initial=np.inf))),
        quality_mean=total(comm, float(shape.sum())) / body.num_cells,
        worst=_worst(body, shape, corners.mean(axis=1), volumes[owned], worst),
    )


def worst_cells(body: Body, count: int) -> tuple[CellQuality, ...]:
    """The cells of the lowest quality, the worst first. Collective."""
    owned = body.owned_cells()
    corners = cell_corners(body.mesh, owned)
    volumes = cell_volumes(body.mesh)[owned]
    return _worst(body, qualities(corners), corners.mean(axis=1), volumes, count)


SLIVER = 0.1
"""Quality up to which a cell is a sliver: a needle of one to ten, or a tetrahedron as flat."""


def quality_at(body: Body, place: Sequence[float]) -> float:
    """Quality of the cell whose midpoint is nearest to a place. Collective.

    Args:
        place: In the undeformed body [m], of as many components as the body has.
    """
    corners = cell_corners(body.mesh, body.owned_cells())
    far = np.linalg.norm(corners.mean(axis=1)[:, : len(place)] - np.asarray(place), axis=1)
    local = (np.inf, 1.0)
    if len(far):
        cell = int(np.argmin(far))
        local = float(far[cell]), float(qualities(corners[cell : cell + 1])[0])
    return min(body.comm.allgather(local))[1]


def _worst(
    body: Body,
    shape: FloatArray,
    middle: FloatArray,
    volumes: FloatArray,
    count: int,
) -> tuple[CellQuality, ...]:
    rows = np.argsort(shape)[:count]
    local = [
        CellQuality(float(shape[i]), tuple(map(float, middle[i])), float(volumes[i])) for i in rows
    ]
    everyone = [cell for cells in body.comm.allgather(local) for cell in cells]
    return tuple(sorted(everyone, key=lambda cell: (cell.quality, cell.middle))[:count])
