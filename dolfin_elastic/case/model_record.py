"""What a run notes of its model, for its report: places, resultants of loads, warnings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.loads import LoadSum
from dolfin_elastic.case.glyphs import glyphs_of
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.mesh.body import Body, extent
from dolfin_elastic.mesh.geometry.curved import cell_volumes, facet_areas
from dolfin_elastic.mesh.geometry.simplices import prepare_facets


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
        "parts": {name: part for name in sorted(names) if (part := _part(body, name))},
        "loads": [asdict(row) for row in sums],
        "glyphs": [one.plain() for one in glyphs_of(case, body, sums)],
        "obstacles": dict(_obstacles(case, body)),
        "warnings": list(notes),
        "petsc": dict(petsc),
    }


def _obstacles(case: Case, body: Body) -> Iterator[tuple[str, dict[str, object]]]:
    """What is drawn of surfaces from files, by the key of their contact."""
    for key, contact in case.pairs.items():
        if contact.mesh is not None and (found := body.obstacles.get(contact.mesh.key)):
            shown = found.to_draw()
            points = [[float(f"{x:.6g}") for x in row] for row in shown.points]
            yield key, {"points": points, "triangles": shown.triangles.tolist()}


def _volume(body: Body) -> float:
    """Volume [m^3], in a plane the area [m^2], also of curved cells. Collective."""
    own = cell_volumes(body.mesh)[body.owned_cells()]
    return float(total(body.comm, float(np.sum(own))))


def _part(body: Body, name: str) -> dict[str, object]:
    """Kind and size of a surface, edge or point; empty for a region. Collective."""
    if name in body.surfaces and name not in body.uncovered:
        prepare_facets(body.mesh)
        areas = facet_areas(body.mesh, body.owned_facets(name))
        return {"kind": "surface", "area": float(total(body.comm, float(np.sum(areas))))}
    return next(({"kind": kind} for kind in ("edge", "point") if name in body.parts[kind]), {})
