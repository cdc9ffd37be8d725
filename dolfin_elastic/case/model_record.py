"""What a run notes of its model, for its report: places, resultants of loads, warnings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.loads import LoadSum
from dolfin_elastic.core.parallel import largest_row, total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import (
    edge_nodes,
    facet_corners,
    outward_normals,
    prepare_edges,
    prepare_facets,
)

SAMPLES = 24
"""Places that are noted of a surface or edge."""
_DIGITS = 6
_SAME = 1e-12
"""Distance over the size of the body that is round-off."""


def model_record(
    case: Case, body: Body, sums: Sequence[LoadSum], notes: Iterable[str], petsc: PetscOptions
) -> dict[str, object]:
    """JSON data about a model, a few kilobytes. Collective.

    Args:
        sums: Resultants of its loads; none where a load has no value at some time.
        petsc: PETSc options from outside the case.
    """
    names = {name for row in (*case.support, *case.contact) for name in row.surfaces}
    names |= {name for load in case.load for name in load.parts}
    return {
        "file": Path(case.file).name,
        "mesh": {
            "source": Path(body.source).name,
            "dim": body.dim,
            "metres": body.unit.metres,  # of its unit of length
            "extent": list(extent(body)),
            "volume": _volume(body),
            "information": list(body.information),
            "fields": sorted(body.fields),
        },
        "parts": {name: found for name in sorted(names) if (found := _part(body, name))},
        "loads": [asdict(row) for row in sums],
        "warnings": list(notes),
        "petsc": dict(petsc),
    }


def _volume(body: Body) -> float:
    """Volume [m^3], in a plane the area [m^2], also of curved cells. Collective."""
    own = cell_volumes(body.mesh)[body.owned_cells()]
    return float(total(body.comm, float(np.sum(own))))


def _part(body: Body, name: str) -> dict[str, object]:
    """Size and some places of a surface, edge or point; empty for a region. Collective."""
    if name in body.surfaces:
        prepare_facets(body.mesh)
        facets = body.owned_facets(name)
        places = facet_corners(body.mesh, facets).mean(axis=1)
        normals = outward_normals(body.mesh, facets)
        areas = facet_areas(body.mesh, facets)
        return {
            "kind": "surface",
            "area": float(total(body.comm, float(np.sum(areas)))),
            **_samples(body, np.hstack([places, normals])),
        }
    if name in body.edges:
        prepare_edges(body.mesh)
        ends = body.mesh.geometry.x[edge_nodes(body.mesh, body.owned_edges(name))]
        return {"kind": "edge", **_samples(body, ends.mean(axis=1))}
    if name in body.points:
        places = body.mesh.geometry.x[body.owned_points(name), : body.dim]
        return {"kind": "point", **_samples(body, places)}
    return {}


def _samples(body: Body, rows: FloatArray) -> dict[str, object]:
    """Rows that are spread over all: places [m], of surfaces with the outward normal. Collective.

    Each is the farthest in space from those before, the first that nearest to the origin, so that
    they are the same on any number of ranks.
    """
    comm, x = body.comm, rows[:, : body.dim]
    size, away, shown = max(extent(body)), np.full(len(rows), np.inf), list[list[float]]()
    while len(shown) < SAMPLES:
        found = largest_row(comm, away, lambda some: x[some], least=_SAME * size)
        if found is None or found.value <= _SAME * size:
            break
        row = comm.bcast(rows[found.row].tolist() if comm.rank == found.rank else None, found.rank)
        away = np.minimum(away, np.linalg.norm(x - np.array(row[: body.dim]), axis=1))
        shown.append([_plain(value, size) for value in row[: body.dim]])
        shown[-1] += [_plain(value, 1.0) for value in row[body.dim :]]
    return {"places": shown}


def _plain(value: float, size: float) -> float:
    """A number without digits that round-off has made."""
    return float(f"{value:.{_DIGITS}g}") if abs(value) > _SAME * size else 0.0
